# SPDX-License-Identifier: Apache-2.0
"""What one user is, all its roles are: what must be apart is said before anybody signs it."""

from __future__ import annotations

import pytest

from authguard_r.access.gate_config import Peer
from authguard_r.operations.checkup.advice import Advice, AdviceCode, Level, in_demonstration
from authguard_r.operations.checkup.users import config_advice, user_advice, user_name
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import ClientRole, Mode
from unit.server.robots import config, peers

PLANNER = peers()[0].uid


def with_planner(*roles: ClientRole) -> tuple[Peer, ...]:
    return (Peer(uid=PLANNER, roles=(ClientRole.PLANNER, *roles)), *peers()[1:])


def told(found: list[Advice]) -> set[tuple[Level, AdviceCode]]:
    return {(item.level, item.code) for item in found}


def test_users_apart_are_only_unknown_to_this_machine() -> None:
    found = list(user_advice(config(), uid=70_099))
    assert told(found) == {(Level.WARNING, AdviceCode.USER)}
    assert [item.place for item in found] == [f"gate.peers[{n}]" for n in range(4)]


@pytest.mark.parametrize(
    ("role", "level"),
    [
        (ClientRole.CONTROLLER, Level.UNSAFE),
        (ClientRole.ESTIMATOR, Level.UNSAFE),
        (ClientRole.OPERATOR, Level.WARNING),
        (ClientRole.AUDITOR, Level.WARNING),
    ],
)
def test_a_planner_that_is_something_else_too_is_said(role: ClientRole, level: Level) -> None:
    found = list(user_advice(config(peers=with_planner(role)), uid=70_099))
    shared = [item for item in found if item.code is AdviceCode.SHARED_USER]
    assert [(item.level, item.place) for item in shared] == [(level, "gate.peers[0]")]
    assert f"planner and {role}" in shared[0].message


def test_a_planner_that_runs_the_gate_is_unsafe_but_a_trial_goes_on() -> None:
    found = list(user_advice(config(), uid=PLANNER))
    (shared,) = [item for item in found if item.code is AdviceCode.SHARED_USER]
    assert shared.level is Level.UNSAFE
    assert in_demonstration(shared).level is Level.WARNING


def test_root_is_nobodys_user() -> None:
    assert (Level.UNSAFE, AdviceCode.ROOT_USER) in told(list(user_advice(config(), uid=0)))
    for roles, level in (
        ((ClientRole.PLANNER,), Level.UNSAFE),
        ((ClientRole.CONTROLLER,), Level.WARNING),
    ):
        found = list(user_advice(config(peers=(Peer(uid=0, roles=roles),)), uid=None))
        assert (level, AdviceCode.ROOT_USER) in told(found)
        assert (Level.WARNING, AdviceCode.USER) not in told(found)


def test_everybody_unknown_is_no_user_and_nobody_is_made_a_gate() -> None:
    for peer in (
        Peer(uid=65_534, roles=(ClientRole.PLANNER,)),
        Peer(uid=0, roles=(ClientRole.GATE,)),
    ):
        found = list(user_advice(config(peers=(peer,)), uid=None))
        assert (Level.UNSAFE, AdviceCode.USER) in told(found)
        # this is no matter of one folder for everything
        assert all(in_demonstration(i).level is Level.UNSAFE for i in found if i.level == "unsafe")


def test_a_role_that_nobody_has_is_said() -> None:
    found = list(user_advice(config(peers=peers()[:2]), uid=None))
    vacant = [item.message for item in found if item.code is AdviceCode.VACANT_ROLE]
    assert [message.split("`")[1] for message in vacant] == ["estimator", "operator"]


def test_what_is_switched_off_is_said() -> None:
    assert list(config_advice(config())) == []
    off = config(mode=Mode.SHADOW, planner_silence_ms=0, estimator_silence_ms=0, refusals=0)
    (found,) = config_advice(config(disclosure=Disclosure.FULL))
    assert (found.level, found.code, found.place) == (
        Level.WARNING,
        AdviceCode.DISCLOSURE,
        "gate.disclosure",
    )
    assert [item.place for item in config_advice(off)] == [
        "gate.mode",
        "gate.planner_silence_ms",
        "gate.estimator_silence_ms",
        "gate.refusals",
    ]


def test_names_are_the_machines() -> None:
    assert user_name(0) == "root"
    assert user_name(PLANNER) is None


def test_who_mediates_for_other_users_is_planner_and_controller_without_a_finding() -> None:
    roles = (ClientRole.AUDITOR, ClientRole.CONTROLLER, ClientRole.PLANNER)
    for mediates in (True, False):
        peer = Peer(uid=PLANNER, roles=roles, mediates=mediates)
        found = list(user_advice(config(peers=(peer, *peers()[1:])), uid=None))
        assert (AdviceCode.SHARED_USER in {item.code for item in found}) is not mediates
    # and never as the gate's own user, or as root
    for uid, code in ((PLANNER, AdviceCode.SHARED_USER), (0, AdviceCode.ROOT_USER)):
        peer = Peer(uid=uid, roles=roles, mediates=True)
        found = list(user_advice(config(peers=(peer,)), uid=PLANNER))
        assert (Level.UNSAFE, code) in told(found)
