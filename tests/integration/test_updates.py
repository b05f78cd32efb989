# SPDX-License-Identifier: Apache-2.0
"""A mission changes by a signature alone, whole or not at all; and the paper's return to base.

Source: section "Mission Compilation and Clarification" (updates, the unguarded return to base).
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.authoring.compile.answers import apply, compile_plain
from authguard_r.authoring.compile.card import compare
from authguard_r.authoring.compile.lint import LintCode, errors, lint
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest_of, encode_fast
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.mission import Mission
from authguard_r.core.provenance import Label
from authguard_r.core.standing import Outcome
from authguard_r.core.state import Reading, Snapshot
from authguard_r.core.token import sign_object
from authguard_r.sim.robot import snapshot_of
from authguard_r.store.sqlite import read_rows
from authguard_r.store.transactions import Transaction
from fixtures import scenarios

SET = msgspec.structs.replace
#: How the worker that dies in the middle ends.
DEAD = 9
LOW = {"variable": "battery_permille", "le": 200, "max_age": "2 s"}

# the paper's return to base


def homeward(**edits: Any) -> Mission:
    """A mission whose way home is the captured action's; `edits` change its draft."""
    base = {
        "task": "Return to Base when the battery is low.",
        "guards": [],
        "closing": None,
        "grants": [
            {
                "id": "return-to-base",
                "type": "navigate",
                "tool": "base",
                "rows": [
                    {
                        "source": "pharmacy",
                        "destination": "dock",
                        "regions": ["dock", "pharmacy", "public-corridor"],
                    }
                ],
                "limits": {"speed_mm_s": ["0.05 m/s", "0.8 m/s"]},
                "chooser": "trusted_sensor",
                "repeat": 3,
                "starts": 3,
                "max": "3 min",
                "irreversible": False,
            }
        ],
    }
    draft = apply(scenarios.draft(), {**base, **edits})
    return compile_plain(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)


def guarded(before: Mission) -> Mission:
    """Version 2: the same row, and the guard that the sentence speaks of."""
    edits = {"version": 2, "supersedes": digest_of(Tag.MISSION, before), "grants[0].guards": [LOW]}
    return homeward(**edits)


#: One string of bytes, whoever replays it.
CAPTURED = encode_fast(scenarios.navigate("pharmacy", "dock", speed=800))


def captured() -> Action:
    return msgspec.json.decode(CAPTURED, type=Action)


def battery(sim: Any, reading: Reading | None) -> None:
    """Let the estimator attest this reading of the battery from now on, or none at all."""
    robot, count = sim.robot, [1_000]
    estimator = scenarios.folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")

    def latest() -> bytes:
        count[0] += 1
        fence = robot.newest_fence  # what is measured now is from after the last motion
        plain: Snapshot = snapshot_of(
            robot.state, robot=robot.rid, epoch=1, seq=count[0], fence=fence, pose_fence=fence
        )
        readings = {k: v for k, v in plain.readings.items() if k != "battery_permille"}
        if reading is not None:
            readings["battery_permille"] = SET(reading, fence=fence)
        return sign_object(SET(plain, readings=readings), Tag.STATE, estimator)

    robot.latest = latest


def read(value: Any, *, label: Label = Label.TRUSTED_SENSOR, age_ms: int = 0) -> Reading:
    return Reading(value=value, label=label, age_ms=age_ms)


STATES = {
    "full": (read(900), "GUARD_FALSE"),
    "just above": (read(201), "GUARD_FALSE"),
    "absent": (None, "STATE_MISSING"),
    "stale": (read(100, age_ms=2_001), "STATE_STALE"),
    "from a camera": (read(100, label=Label.CAMERA), "STATE_UNTRUSTED"),
    "of another kind": (read("low"), "GUARD_FALSE"),
}


def at_pharmacy() -> Any:
    return scenarios.simulation(start=scenarios.world("pharmacy"))


def reasons(report: Any) -> list[str]:
    return [str(reason) for reason in report.judged.decision.reasons]


def test_the_unguarded_return_is_found_before_it_is_signed_and_the_guarded_one_is_not() -> None:
    first = homeward()
    assert errors(lint(first, scenarios.site())) == (LintCode.UNGUARDED_RETURN,)
    second = guarded(first)
    assert errors(lint(second, scenarios.site())) == ()
    changes = compare(first, second, scenarios.site())
    assert not [line for line in changes if line.startswith("ADDS")]
    (guard,) = [line for line in changes if line.startswith("removes")]
    assert "only while battery_permille is at most 20 %" in guard


@pytest.mark.parametrize("state", STATES)
def test_signed_anyway_the_unguarded_return_accepts_the_captured_action(state: str) -> None:
    """The gate is faithful to what was signed: no state of the battery is asked about."""
    sim = at_pharmacy()
    sim.gate.management.activate(scenarios.token(homeward()))
    battery(sim, STATES[state][0])
    report = scenarios.propose(sim, captured())
    assert report.outcome is Outcome.SUCCEEDED
    assert sim.robot.state.region == "dock"


@pytest.mark.parametrize("state", STATES)
def test_under_the_guard_the_same_bytes_are_refused(state: str) -> None:
    sim, first = at_pharmacy(), homeward()
    sim.gate.management.activate(scenarios.token(first))
    sim.gate.management.activate(scenarios.token(guarded(first)))
    reading, reason = STATES[state]
    battery(sim, reading)
    report = scenarios.propose(sim, captured())
    assert reasons(report) == [reason]
    assert encode_fast(SET(report.judged.action, meta=None, provenance={})) == CAPTURED
    assert report.outcome is None
    assert sim.robot.trace == []
    assert sim.robot.state.region == "pharmacy"


@pytest.mark.parametrize("value", [200, 0])
def test_under_the_guard_an_attested_low_battery_goes_home(value: int) -> None:
    sim, first = at_pharmacy(), homeward()
    sim.gate.management.activate(scenarios.token(first))
    sim.gate.management.activate(scenarios.token(guarded(first)))
    battery(sim, read(value))
    assert scenarios.propose(sim, captured()).outcome is Outcome.SUCCEEDED


# the paper's pair: unsigned change refused, the same change signed accepted


def collected(**kwargs: Any) -> Any:
    """Return a gate whose robot holds the package in the pharmacy, mission version 1 active."""
    sim = scenarios.simulation(**kwargs)
    sim.gate.management.activate(scenarios.token())
    pick = Action(
        type="pick",
        tool="gripper",
        object="package-p1",
        source="pharmacy",
        params={"force_mn": 9_000},
    )
    assert (
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome is Outcome.SUCCEEDED
    )
    assert scenarios.propose(sim, pick).outcome is Outcome.SUCCEEDED
    return sim


def second() -> Mission:
    return scenarios.mission(
        "mission-v2.yaml", supersedes=digest_of(Tag.MISSION, scenarios.mission())
    )


def test_an_unsigned_change_is_refused_and_the_same_change_signed_is_accepted() -> None:
    sim = collected()
    diverted = scenarios.navigate("pharmacy", "station-103")
    assert reasons(scenarios.propose(sim, diverted))[0] == "DESTINATION_OUT_OF_SCOPE"
    forged = scenarios.token(second()).replace(b'"signature":"', b'"signature":"A', 1)
    for unsigned in (forged, encode_fast(second())):
        with pytest.raises(AuthGuardError):
            sim.gate.management.activate(unsigned)
    assert reasons(scenarios.propose(sim, diverted))[0] == "DESTINATION_OUT_OF_SCOPE"
    sim.gate.management.activate(scenarios.token(second()))
    assert scenarios.propose(sim, diverted).outcome is Outcome.SUCCEEDED
    assert sim.robot.state.region == "station-103"


def test_the_old_destination_is_refused_once_the_change_is_signed() -> None:
    sim = collected()
    sim.gate.management.activate(scenarios.token(second()))
    refused = scenarios.propose(sim, scenarios.navigate("pharmacy", "station-101"))
    assert reasons(refused)[0] == "DESTINATION_OUT_OF_SCOPE"


def management(rows: Any) -> list[dict[str, Any]]:
    found = [read_record(row.record, where="") for row in rows]
    return [record.open for record in found if record.kind == "management"]


def test_an_update_is_logged_as_a_relation_between_two_digests() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    sim.gate.management.activate(scenarios.token(second()))
    taken, first, offered, update = management(sim.gate.ledger.store.rows())
    assert taken == {**first, "verb": "issue", "status": "issued"}
    assert offered == {**update, "verb": "issue", "status": "issued"}
    assert first["supersedes"] == "-"
    assert update["supersedes"] == first["mission"] == digest_of(Tag.MISSION, scenarios.mission())
    assert (update["mission"], update["version"]) == (digest_of(Tag.MISSION, second()), 2)


# whole or not at all

STEPS = ("keep_token", "hold", "make_active", "record")


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("step", STEPS)
def test_an_update_that_fails_in_the_middle_leaves_the_old_version_whole(
    tmp_path: Path, step: str, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = scenarios.simulation(store=tmp_path / "robot.db")
    sim.gate.management.activate(scenarios.token())
    before = sim.gate.management.standing("deliver-p1")
    carried_out = getattr(Transaction, step)

    def fails(act: Transaction, *arguments: Any) -> Any:
        if when == "after":
            carried_out(act, *arguments)
        raise StoreError("the disk is gone")

    with monkeypatch.context() as patch:
        patch.setattr(Transaction, step, fails)
        with pytest.raises(StoreError):
            sim.gate.management.activate(scenarios.token(second()))
    assert sim.gate.management.standing("deliver-p1") == before
    assert sim.gate.ledger.run(lambda act: act.token(digest_of(Tag.MISSION, second()))) is None
    assert (
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome is Outcome.SUCCEEDED
    )
    assert sim.gate.management.activate(scenarios.token(second())).version == 2
    sim.gate.close()
    rows = read_rows(tmp_path / "robot.db")
    assert [record["version"] for record in management(rows)] == [1, 1, 2, 2]
    assert verify_rows(rows, terminal=None).whole


@pytest.mark.parametrize("step", [*STEPS, "afterwards"])
def test_a_process_killed_in_the_middle_of_an_update_leaves_one_version_whole(
    tmp_path: Path, step: str
) -> None:
    store = tmp_path / "robot.db"
    sim = scenarios.simulation(store=store)
    sim.gate.management.activate(scenarios.token())
    sim.gate.close()
    token = tmp_path / "v2.token"
    token.write_bytes(scenarios.token(second()))
    worker = [sys.executable, str(Path(__file__).with_name("update_worker.py"))]
    inputs = [str(scenarios.trust_folder()), str(store), str(token), str(scenarios.START_MS), step]
    environment = {**os.environ, "PYTHONPATH": str(scenarios.ROOT / "tests")}
    done = subprocess.run([*worker, *inputs], env=environment, check=False, timeout=60)
    assert done.returncode == DEAD
    again = scenarios.simulation(store=store)
    standing = again.gate.management.standing("deliver-p1")
    whole = scenarios.mission() if step != "afterwards" else second()
    assert (standing.version, standing.digest) == (whole.version, digest_of(Tag.MISSION, whole))
    assert again.gate.ledger.run(lambda act: act.active()) == "deliver-p1"
    again.gate.close()
    rows = read_rows(store)
    twice = sorted([*range(1, whole.version + 1)] * 2)  # issued and active, in one commit
    assert [record["version"] for record in management(rows)] == twice
    assert verify_rows(rows, terminal=None).whole
