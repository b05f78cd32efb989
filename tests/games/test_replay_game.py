# SPDX-License-Identifier: Apache-2.0
"""ReplayGame: a mission that ended, its token, its actions and a restart; it stays ended.

Source: section "Replay Game", theorem "Replay resistance".
"""

from __future__ import annotations

from pathlib import Path

import pytest

import worlds
from authguard_r.commands import Command, Verb
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.lifecycle import TERMINAL, TRANSITIONS, Event, Status
from authguard_r.core.token import sign_object

ENDINGS = {Verb.REVOKE: "REVOKED", Verb.COMPLETE: "MISSION_COMPLETED"}


def command(verb: Verb, nonce: str, *, by: str = "operator-1") -> bytes:
    mission = worlds.mission()
    value = Command(
        verb=verb,
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        nonce=b64(nonce.encode()),
        expires_ms=worlds.START_MS + 600_000,
    )
    return sign_object(value, Tag.COMMAND, worlds.folder_signer(worlds.trust_folder(), by))


@pytest.mark.parametrize("verb", sorted(ENDINGS))
def test_a_mission_that_ended_is_never_accepted_again_not_even_after_a_restart(
    verb: Verb, tmp_path: Path
) -> None:
    sim = worlds.simulation(store=tmp_path / "robot.db")
    sim.gate.management.activate(worlds.token())
    first = worlds.propose(sim, worlds.navigate("dock", "pharmacy"))
    assert first.outcome == "succeeded"
    sim.gate.management.command(command(verb, "end"))
    for round_ in range(2):
        with pytest.raises(AuthGuardError) as refused:
            sim.gate.management.activate(worlds.token())
        assert str(refused.value.reason) == ENDINGS[verb]
        again = worlds.propose(sim, worlds.navigate("pharmacy", "station-101"))
        assert again.outcome is None
        assert len(sim.robot.trace) == (1 if round_ == 0 else 0)
        sim.gate.close()
        sim = worlds.simulation(
            store=tmp_path / "robot.db",
            start=worlds.world("pharmacy"),
            start_ms=worlds.START_MS + 120_000,
        )
    sim.gate.close()


def test_a_one_time_action_is_used_up() -> None:
    sim = worlds.simulation()
    sim.gate.management.activate(worlds.token())
    worlds.propose(sim, worlds.navigate("dock", "pharmacy"))
    sim.robot.state = worlds.world("dock")
    sim.robot.pause(100)
    again = worlds.propose(sim, worlds.navigate("dock", "pharmacy"))
    assert again.outcome is None
    assert [str(r) for r in again.judged.decision.reasons] == ["REPEAT_EXHAUSTED"]


def test_a_command_is_carried_out_once_and_only_for_who_may_give_it() -> None:
    sim = worlds.simulation()
    sim.gate.management.activate(worlds.token())
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        sim.gate.management.command(command(Verb.REVOKE, "a", by="operator-2"))
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        sim.gate.management.command(command(Verb.COMPLETE, "b", by="safety-officer-1"))
    sim.gate.management.command(command(Verb.SUSPEND, "c", by="safety-officer-1"))
    with pytest.raises(AuthGuardError, match="EXPIRED"):
        sim.gate.management.command(command(Verb.SUSPEND, "c", by="safety-officer-1"))
    sim.gate.management.command(command(Verb.RESUME, "d"))
    assert worlds.propose(sim, worlds.navigate("dock", "pharmacy")).outcome == "succeeded"


def test_no_event_leads_out_of_a_terminal_status() -> None:
    assert not [pair for pair in TRANSITIONS if pair[0] in TERMINAL]
    assert {Status.COMPLETED, Status.REVOKED, Status.EXPIRED, Status.SUPERSEDED} == TERMINAL
    assert {event for _, event in TRANSITIONS} == set(Event)
