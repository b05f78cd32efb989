# SPDX-License-Identifier: Apache-2.0
"""A configuration is one robot's, a site authority's, and has one spelling."""

from __future__ import annotations

from typing import Any

import pytest

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.gate.config import GateConfig, Peer, open_gate_config, roles_of
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from unit.gate.robots import config

ONE, TWO = (Peer(uid=n, roles=(ClientRole.PLANNER,)) for n in (1, 2))


def opened(held: GateConfig, *, by: str = "site-authority-1", tag: Tag = Tag.GATE) -> GateConfig:
    token = sign_object(held, tag, folder_signer(worlds.trust_folder(), by))
    trust = read_trust(worlds.trust_folder())
    return open_gate_config(token, verifier=trust, now=worlds.NOW, robot=worlds.RID)


def test_what_the_site_authority_signed_is_what_is_read() -> None:
    assert opened(config()) == config()


@pytest.mark.parametrize("by", ["operator-1", "safety-officer-1", f"gate-{worlds.RID}"])
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
