# SPDX-License-Identifier: Apache-2.0
"""`audit replay` finds every kind of forged record, though the chain is made anew and holds.

Whoever can write a log's file can make any chain; a checkpoint that was kept elsewhere shows that,
and this is for those who have none. Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import LogRow, Record, Sealed, read_record, read_sealed
from authguard_r.cli import call
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.state import Snapshot
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.sim.robot import Faults
from fixtures import scenarios
from integration.test_enforcement import order
from integration.test_replay_from_log import chained, destroyed, forged, rows_of, written

SET = msgspec.structs.replace
GO = scenarios.navigate("dock", "pharmacy")
BACK = scenarios.navigate("pharmacy", "station-101")
PICK = Action(
    type="pick", tool="gripper", object="package-p1", source="pharmacy", params={"force_mn": 12_000}
)
Log = list[LogRow]


@cache
def told() -> tuple[LogRow, ...]:
    """A log with one of each: accepted, refused, unsafe, failed, not begun, stopped, resumed."""
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    scenarios.propose(sim, scenarios.navigate("dock", "station-103"))  # not in the mission
    sim.robot.state = SET(sim.robot.state, human_distance_mm=500)
    sim.robot.pause(100)
    scenarios.propose(sim, GO)  # not safe
    sim.robot.state = SET(sim.robot.state, human_distance_mm=5_000)
    sim.robot.faults = Faults(controller_refuses=True)
    sim.robot.pause(100)
    scenarios.propose(sim, GO)  # not begun
    sim.robot.faults = Faults()
    scenarios.propose(sim, GO)
    sim.robot.faults = Faults(grasp_fails=True)
    scenarios.propose(sim, PICK)  # failed
    sim.robot.faults = Faults()
    sim.robot.pause(1_000)
    sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)  # type: ignore[arg-type]
    scenarios.propose(sim, PICK)  # suspended
    sim.robot.pause(1_000)
    resume = order(Verb.RESUME, "r", issued_ms=sim.robot.wall_ms())
    sim.gate.management.command(resume)
    scenarios.propose(sim, PICK)
    scenarios.propose(sim, BACK)
    return tuple(rows_of(sim))


def record(row: LogRow) -> Record:
    return read_record(row.record, where="")


def of(verdict: str, log: Log, number: int = 0) -> int:
    """Return a record by what it says: a decision, an outcome, or an order."""

    def says(row: LogRow) -> bool:
        found = record(row)
        safety = found.open.get("safety")
        unsafe = isinstance(safety, dict) and not safety["safe"]
        return found.link.decision == verdict if verdict != "unsafe" else unsafe

    return [row.seq for row in log if says(row)][number]


def opened(verdict: str, **changes: Any) -> Callable[[Log], Log]:
    """Change open fields of the first such decision."""

    def forge(log: Log) -> Log:
        return forged(
            log, of(verdict, log), lambda told, _: SET(told, open={**told.open, **changes})
        )

    return forge


def turned(verdict: str, into: str, **changes: Any) -> Callable[[Log], Log]:
    """Turn a decision or an outcome into another."""

    def change(told: Record, _: dict[str, Sealed]) -> Record:
        return SET(told, link=SET(told.link, decision=into), open={**told.open, **changes})

    return lambda log: forged(log, of(verdict, log), change)


def sealed(
    verdict: str, name: str, edit: Callable[[Any], Any], *, number: int = 0, linked: bool = True
) -> Callable[[Log], Log]:
    """Change a sealed value of a decision, and the record's links so that they fit it."""

    def change(told: Record, values: dict[str, Sealed]) -> Record:
        value = edit(json.loads(msgspec.json.encode(values[name].value)))
        values[name] = SET(values[name], value=value)
        link = told.link
        if name == "action" and linked:
            link = SET(link, action=digest_of(Tag.ACTION, msgspec.convert(value, Action)))
        elif name == "state" and linked:
            states = [msgspec.convert(one["snapshot"], Snapshot) for one in value]
            link = SET(link, state=digest_of(Tag.STATE, states[0]) if states else "-")
        elif name == "now" and linked:
            link = SET(link, time_ms=value["utc_ms"])
        return SET(told, link=link)

    return lambda log: forged(log, of(verdict, log, number), change)


def without(verdict: str, number: int = 0) -> Callable[[Log], Log]:
    """Take a record out."""

    def forge(log: Log) -> Log:
        at = of(verdict, log, number)
        return chained([*log[:at], *log[at + 1 :]])

    return forge


def twice(verdict: str, number: int = 0) -> Callable[[Log], Log]:
    """Put a record in a second time."""

    def forge(log: Log) -> Log:
        at = of(verdict, log, number)
        return chained([*log[: at + 1], *log[at:]])

    return forge


def swapped(verdict: str) -> Callable[[Log], Log]:
    """Put a record behind the next one."""

    def forge(log: Log) -> Log:
        at = of(verdict, log)
        return chained([*log[:at], log[at + 1], log[at], *log[at + 2 :]])

    return forge


def within(**changes: Any) -> Callable[[Any], Any]:
    """Return a change of fields."""
    return lambda value: {**value, **changes}


def first(**changes: Any) -> Callable[[Any], Any]:
    """Return a change of fields of the one standing or state."""
    return lambda value: [{**value[0], **changes}]


def used(grant: str, **changes: Any) -> Callable[[Any], Any]:
    """Return a change of what a standing says was used of a grant."""

    def edit(value: Any) -> Any:
        uses = value[0].get("uses", {})
        use = {"starts": 0, "successes": 0, "last_success": 0, **uses.get(grant, {}), **changes}
        return [{**value[0], "uses": {**uses, grant: use}}]

    return edit


def seen(**changes: Any) -> Callable[[Any], Any]:
    """Return a change of every value of the state."""

    def edit(value: Any) -> Any:
        (one,) = value
        snapshot = one["snapshot"]
        readings = {name: {**r, **changes} for name, r in snapshot["readings"].items()}
        pose = {**snapshot["pose"], **changes}
        return [{**one, "snapshot": {**snapshot, "readings": readings, "pose": pose}}]

    return edit


def moved(value: Any) -> Any:
    """Let the robot have been elsewhere."""
    (one,) = value
    pose = {**one["snapshot"]["pose"], "x_mm": 36_000, "y_mm": 15_000}
    return [{**one, "snapshot": {**one["snapshot"], "pose": pose}}]


def uncommitted(log: Log, seq: int, name: str) -> Log:
    """Take a value away, and the record's commitment to it."""

    def change(told: Record, values: dict[str, Sealed]) -> Record:
        del values[name]
        return SET(told, committed={n: c for n, c in told.committed.items() if n != name})

    return forged(log, seq, change)


def unfenced(log: Log) -> Log:
    """Let no decision have asked for newer state, and the last rest on older one."""
    for number in range(sum(record(row).kind == "decision" for row in log)):
        seq = [row.seq for row in log if record(row).kind == "decision"][number]
        verdict = record(log[seq]).link.decision
        nth = [row.seq for row in log if record(row).link.decision == verdict].index(seq)
        for edit in (seen(fence=0), first(fence=0)):
            log = sealed(verdict, "state", edit, number=nth)(log)
    return log


def wide(log: Log) -> Log:
    """Put a wider mission, as authentic, in the place of the one that counted."""
    token = scenarios.token(scenarios.mission(regions=["dock", "pharmacy", "station-103"]))
    return sealed("activate", "token", lambda _: token.decode().strip())(log)


def unsigned(log: Log) -> Log:
    """Spoil the mission's signature."""

    def edit(text: str) -> str:
        token = json.loads(text)
        token["endorsements"][0]["signature"] = b64(bytes(64))
        return json.dumps(token, separators=(",", ":"), sort_keys=True)

    return sealed("activate", "token", edit)(log)


SAFE, UNSAFE = {"safe": True, "hazards": []}, {"safe": False, "hazards": ["SPEED"]}
FORGERIES: dict[str, Callable[[Log], Log]] = {
    # the verdict of the mission's gate
    "a refusal that accepts and releases": turned("reject", "accept", reasons=[], ticket="t"),
    "a refusal that accepts": turned("reject", "accept", reasons=[], grant="go-to-pharmacy"),
    "a refusal that asks for approval": turned("reject", "request_approval"),
    "an acceptance that refuses": turned("accept", "reject", reasons=["EXPIRED"], ticket="-"),
    "a refusal without its reasons": opened("reject", reasons=[]),
    "a refusal for another reason": opened("reject", reasons=["EXPIRED"]),
    "a refusal with a reason more": opened(
        "reject", reasons=["DESTINATION_OUT_OF_SCOPE", "REVOKED"]
    ),
    "an acceptance by another grant": opened("accept", grant="pick-p1"),
    "an acceptance that wanted another number": opened("accept", required=2),
    "an acceptance at another risk": opened("accept", risk=1_000),
    "a refusal that released": opened("reject", ticket="t"),
    # the verdict of the second gate
    "an unsafe action that was safe and released": opened("unsafe", safety=SAFE, ticket="t"),
    "an unsafe action that was safe": opened("unsafe", safety=SAFE),
    "an unsafe action that was released": opened("unsafe", ticket="t"),
    "a safe action that was not": lambda log: forged(
        log,
        of("accept", log, 1),
        lambda told, _: SET(told, open={**told.open, "safety": UNSAFE, "ticket": "-"}),
    ),
    "a second gate that was not asked": opened("unsafe", safety="not-evaluated", ticket="t"),
    # what was decided about
    "another action": sealed("reject", "action", within(destination="pharmacy")),
    "another action, not linked": sealed(
        "reject", "action", within(destination="pharmacy"), linked=False
    ),
    "a faster action": sealed("accept", "action", within(params={"speed_mm_s": 1_601}), number=1),
    "another place": sealed("accept", "state", moved, number=1),
    "no state": sealed("accept", "state", lambda _: [], number=1),
    "state from before the last motion": sealed("accept", "state", seen(fence=0), number=-1),
    "state of which nothing newer was asked": sealed("accept", "state", first(fence=0), number=-1),
    "state from a camera": sealed("accept", "state", seen(label="camera"), number=-1),
    "old state": sealed("accept", "state", seen(age_ms=600_000), number=-1),
    "another time": sealed("accept", "now", within(utc_ms=scenarios.START_MS + 10**9)),
    "another time, not linked": sealed("accept", "now", within(utc_ms=1), linked=False),
    # what was used before
    "a start that was not counted": sealed(
        "accept", "standing", used("go-to-pharmacy", starts=0, successes=0), number=-1
    ),
    "an action that was not counted": sealed("accept", "standing", first(actions=0), number=-1),
    "successes in another order": sealed("accept", "standing", first(order=0), number=-1),
    "a success that never was": sealed(
        "accept", "standing", used("go-to-101", successes=1), number=-1
    ),
    "a suspended mission that was active": sealed(
        "reject", "standing", first(status="active"), number=-1
    ),
    "an active mission that was suspended": sealed("accept", "standing", first(status="suspended")),
    "another mission's standing": sealed("accept", "standing", first(mid="another")),
    "another version's standing": sealed("accept", "standing", first(version=2)),
    "a release that is still open": sealed(
        "accept",
        "standing",
        first(open=[{"ticket": scenarios.TICKET, "grant": "pick-p1", "reserved": {}}]),
        number=-1,
    ),
    "approvals that nobody gave": sealed("reject", "approvals", lambda _: ["t"]),
    # what became of it
    "a success that failed": turned("succeeded", "failed"),
    "a failure that succeeded": turned("failed", "succeeded"),
    "a release that was not begun": turned("succeeded", "not_started"),
    "a motion that was not begun, and was": turned("not_started", "failed"),
    "an outcome that nobody knows": turned("succeeded", "unknown"),
    "an outcome that is none": turned("succeeded", "done"),
    "an outcome of another release": opened("succeeded", ticket=scenarios.TICKET),
    "an outcome that is gone": without("succeeded"),
    "an outcome that came twice": twice("succeeded"),
    "a release that is gone": without("accept", -1),
    "a release that came twice": twice("accept", 1),
    "an outcome before its release": swapped("accept"),
    # who ordered it
    "an activation that is gone": without("activate"),
    "a suspension that is gone": without("suspend"),
    "a resume that is gone": without("resume"),
    "a wider mission": wide,
    "a mission that nobody signed": unsigned,
    "another site": sealed("genesis", "site", within(version=9)),
    "another site's digest": opened("genesis", site=b64(bytes(32))),
    "another safety configuration": sealed("genesis", "safety", within(max_speed_mm_s=1)),
    "a safety configuration that lets the unsafe pass": lambda log: opened("unsafe", safety=SAFE)(
        sealed("genesis", "safety", within(human_distance_mm=0))(log)
    ),
    "a safety configuration that is none": sealed("genesis", "safety", lambda _: {"a": 1}),
    "a safety configuration that never was": lambda log: opened("unsafe", safety=SAFE)(
        uncommitted(log, 0, "safety")
    ),
    "fences that nobody asked for": unfenced,
    # what was taken away
    "an action that is gone": lambda log: destroyed(log, of("accept", log), "action"),
    "a state that is gone": lambda log: destroyed(log, of("reject", log), "state"),
    "a mission that is gone": lambda log: destroyed(log, of("activate", log), "token"),
    "a site that is gone": lambda log: destroyed(log, 0, "site"),
    "reasons that are gone": lambda log: destroyed(log, of("reject", log), "findings"),
}


def test_the_log_holds_what_is_forged_and_replays() -> None:
    log = list(told())
    said = [record(row).link.decision for row in log]
    for word in ("accept", "reject", "succeeded", "failed", "not_started", "suspend", "resume"):
        assert word in said
    assert of("unsafe", log)
    assert len(FORGERIES) >= 30


def test_the_true_log_agrees(tmp_path: Path) -> None:
    store = written(tmp_path / "true.db", told())
    assert call(["audit", "replay", str(store), "--trust", str(scenarios.trust_folder())]) == 0


@pytest.mark.parametrize("kind", FORGERIES)
def test_every_kind_of_forged_record_is_found(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = FORGERIES[kind](list(told()))
    assert [row.record for row in log] != [row.record for row in told()] or any(
        read_sealed(one.sealed, where="") != read_sealed(two.sealed, where="")
        for one, two in zip(log, told(), strict=True)
    )
    store = written(tmp_path / "forged.db", log)
    words = ["audit", "replay", str(store), "--trust", str(scenarios.trust_folder()), "--json"]
    assert call(words) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["whole"]
    assert found["differ"] or found["missing"]
