# SPDX-License-Identifier: Apache-2.0
"""A configuration is one robot's, a site authority's, and has one spelling."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from authguard_r.access.gate_config import (
    GateConfig,
    Peer,
    open_gate_config,
    require_mediator,
    roles_of,
)
from authguard_r.anchoring.places import WitnessPlace
from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.keys.notes import witness_key
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.server.log_maintenance import checkpoint_policy
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.small_witness import SmallWitness
from unit.server.robots import config

ONE, TWO = (Peer(uid=n, roles=(ClientRole.PLANNER,)) for n in (1, 2))


def opened(held: GateConfig, *, by: str = "site-authority-1", tag: Tag = Tag.GATE) -> GateConfig:
    token = sign_object(held, tag, folder_signer(scenarios.trust_folder(), by))
    trust = read_trust(scenarios.trust_folder())
    return open_gate_config(token, verifier=trust, now=scenarios.NOW, robot=scenarios.RID)


def test_what_the_site_authority_signed_is_what_is_read() -> None:
    assert opened(config()) == config()


@pytest.mark.parametrize("by", ["operator-1", "safety-officer-1", f"gate-{scenarios.RID}"])
def test_nobody_else_says_who_may_connect(by: str) -> None:
    with pytest.raises(AuthenticityError) as refused:
        opened(config(), by=by)
    assert refused.value.reason is Reason.ROLE_DENIED


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"peers": (TWO, ONE)}, "gate.peers"),
        ({"peers": (ONE, ONE)}, "gate.peers"),
        (
            {"peers": (Peer(uid=1, roles=(ClientRole.PLANNER, ClientRole.AUDITOR)),)},
            "gate.peers[0].roles",
        ),
        (
            {"peers": (ONE, Peer(uid=2, roles=(ClientRole.PLANNER, ClientRole.PLANNER)))},
            "gate.peers[1].roles",
        ),
        ({"robot": RobotId("lifter-1")}, "gate.robot"),
    ],
)
def test_a_second_spelling_and_another_robot_are_refused(
    changes: dict[str, Any], where: str
) -> None:
    with pytest.raises(MalformedError) as refused:
        opened(config(**changes))
    assert refused.value.where == where


ONES, TWOS = (
    WitnessPlace(url=f"https://{name}.example", key=SmallWitness(name, ()).named.text())
    for name in ("one", "two")
)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"quorum": 1}, "gate.quorum"),
        ({"witnesses": (ONES,)}, "gate.quorum"),
        ({"witnesses": (ONES, TWOS), "quorum": 3}, "gate.quorum"),
        ({"witnesses": (ONES, ONES), "quorum": 2}, "gate.witnesses"),
        (
            {"witnesses": (ONES, replace(ONES, url="http://one.example")), "quorum": 2},
            "gate.witnesses[1].url",
        ),
        ({"witnesses": (replace(ONES, key="one"),), "quorum": 1}, "gate.witnesses[0].key"),
    ],
)
def test_witnesses_that_cannot_agree_or_count_twice_are_refused(
    changes: dict[str, Any], where: str
) -> None:
    with pytest.raises(MalformedError) as refused:
        opened(config(**changes))
    assert refused.value.where == where


def test_one_key_under_two_names_is_one_witness() -> None:
    witness = SmallWitness("one", ())
    again = witness_key("two", witness.key.public_key())
    places = (
        WitnessPlace(url="https://one.example", key=witness.named.text()),
        WitnessPlace(url="https://two.example", key=again.text()),
    )
    with pytest.raises(MalformedError) as refused:
        opened(config(witnesses=places, quorum=2))
    assert refused.value.where == "gate.witnesses"


def test_what_is_said_of_witnesses_is_what_is_asked() -> None:
    said = {"checkpoint_records": 10, "checkpoint_ms": 5_000, "witness_ms": 7, "quorum": 1}
    held = opened(config(witnesses=(ONES, TWOS), **said))
    policy = checkpoint_policy(held)
    assert (policy.records, policy.every_ms) == (10, 5_000)
    asked = policy.witnesses
    assert (asked.places, asked.quorum, asked.silence_ms) == ((ONES, TWOS), 1, 7)


def test_a_configuration_of_before_there_were_witnesses_is_the_same_bytes() -> None:
    plain = encode_fast(config())
    assert b"witness" not in plain
    assert b"checkpoint" not in plain
    assert b"quorum" not in plain


@pytest.mark.parametrize("changes", [{"peers": ()}, {"connections": 0}, {"renew_within_ms": 149}])
def test_a_bound_that_cannot_be_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(MalformedError):
        opened(config(**changes))


def test_another_kind_of_token_is_no_configuration() -> None:
    with pytest.raises(MalformedError) as refused:
        opened(config(), tag=Tag.SAFETY)
    assert refused.value.reason is Reason.WRONG_KIND


def test_a_user_that_is_not_named_may_nothing() -> None:
    held = config(peers=(ONE, TWO))
    assert roles_of(held, 1) == {ClientRole.PLANNER}
    assert roles_of(held, 0) == frozenset()


@pytest.mark.parametrize(
    "roles",
    [
        (ClientRole.PLANNER,),
        (ClientRole.CONTROLLER,),
        (ClientRole.CONTROLLER, ClientRole.ESTIMATOR, ClientRole.PLANNER),
        (ClientRole.CONTROLLER, ClientRole.OPERATOR, ClientRole.PLANNER),
    ],
)
def test_who_mediates_asks_and_drives_and_has_no_other_say(roles: tuple[ClientRole, ...]) -> None:
    with pytest.raises(MalformedError, match="mediates"):
        require_mediator(Peer(uid=1, roles=roles, mediates=True), where="peer")
    require_mediator(Peer(uid=1, roles=roles), where="peer")


def test_a_peer_of_before_there_were_mediators_is_the_same_bytes() -> None:
    peer = Peer(uid=1, roles=(ClientRole.PLANNER,))
    assert msgspec.json.encode(peer) == b'{"uid":1,"roles":["planner"]}'
