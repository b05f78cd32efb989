# SPDX-License-Identifier: Apache-2.0
"""Whatever ends a robot's permission in mid-motion: it stands in bounded time, and the log says so.

Real processes; the mule has brakes. Bounds are computed from what is signed or documented: how old
a value may be, how often a lease is looked at, how soon a controller misses its gate, how the mule
brakes. How long it really took is read from the robot's own clock and from the gate's records.
Which cause is bounded by what: docs/spec/gate-protocol.md#how-soon-a-robot-stands
"""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import mkdtemp
from typing import Any, Self

import msgspec
import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.client import GateClient
from authguard_r.client.controller import SAMPLE_MS
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_ms
from authguard_r.core.standing import Outcome
from authguard_r.core.state import Snapshot
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.sensors import LOOK_MS
from authguard_r.sim.sight import MARGIN_MM
from authguard_r.site.source import read_site
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Begun, ClientRole, Ended, Kind, Stood
from fixtures import scenarios
from fixtures.gate_process import Line, RunningGate, Told, order, until
from integration.scripted_gate import Sensors
from integration.test_gate_streams import BINDING, MISSION, SITE
from integration.test_gate_watching import Walk, connected, operator
from integration.trails import Rest, Trail

MULE = RobotId("mule-1")
SPEED_MM_S, BRAKE_MM_S2, REACTION_MS = 400, 2_000, 100
#: v / a and v * v / 2a.
BRAKING_MS = SPEED_MM_S * 1_000 // BRAKE_MM_S2
BRAKING_MM = SPEED_MM_S * SPEED_MM_S // (2 * BRAKE_MM_S2)
DRIVE = b"drive(linear=0.4, lateral=0, turn=0, seconds=50)"
BACK = b"drive(linear=-0.4, lateral=0, turn=0, seconds=50)"
#: How late a machine that does other things may be where nothing but the gate's clock tells.
PATIENCE_MS = 10_000
#: From a new value of the sensors to a snapshot of it: their period and the estimator's.
SNAPSHOT_MS = 2 * LOOK_MS
#: Where the mule starts, in front of a ditch that nobody granted.
HOME_MM = 900
DITCH = """\
  ditch:
    {map: main, floor: 0, points: [[-5000, 0], [0, 0], [0, 4000], [-5000, 4000]],
     approach: [-2000, 2000], tags: [public], names: [Ditch]}
"""
SITE_WITH_BRAKES = (
    SITE.replace("20000", "90000")
    .replace("40000", "99000")
    .replace("30000", "95000")
    .replace("approach: [2000, 2000]", f"approach: [{HOME_MM}, 2000]")
    .replace("doors:", DITCH + "doors:")
    .replace("brake_mm_s2: 1000", f"brake_mm_s2: {BRAKE_MM_S2}")
)


class Yard:
    """A running gate with robot and estimator, and one mission after the other."""

    def __init__(self, gate: RunningGate, mission: Path) -> None:
        self.gate = gate
        self._draft = mission
        self._count = 0
        self._live: list[tuple[Mission, str]] = []
        self._first = 0

    @property
    def age_ms(self) -> int:
        """How old the place may be that a lease relies on."""
        return self._live[-1][0].place_max_age_ms

    def activate(self, mission: Mission | None = None, **changes: Any) -> tuple[Mission, str]:
        """Make a mission active; return it and its digest."""
        self._count += 1
        fresh = {"mission": f"yard-work-{self._count}", **changes}
        value = self.gate.mission(str(self._draft), **fresh) if mission is None else mission
        digest = self.gate.activate(self.gate.token(value))["digest"]
        self._live.append((value, digest))
        return self._live[-1]

    def ready(self, plan: bytes) -> None:
        """Wait until the gate would release a plan: what was started anew has been heard of."""
        with operator(self.gate) as person:

            def accepted() -> bool:
                return bool(person.evaluate(plan)["steps"][0]["outcome"] == "accept")

            until(accepted, "an accepted what-if")

    @contextmanager
    def mission(self, plan: bytes = DRIVE, **changes: Any) -> Iterator[Trail]:
        """Give a mission under which a plan would be released now; it ends with the block."""
        self.gate.mark()
        self.activate(**changes)
        try:
            self.ready(plan)
            with Trail(self.gate) as trail:
                yield trail
        finally:
            self.end()

    @contextmanager
    def walk(self, plan: bytes = DRIVE, **changes: Any) -> Iterator[tuple[Walk, Trail]]:
        """Give a robot at full speed under a mission of its own."""
        with self.mission(plan, **changes) as trail:
            walk = Walk(self.gate, plan, dialect="auto", key=f"walk-{self._count}")
            until(lambda: walk.answer or trail.last.speed_mm_s == SPEED_MM_S, "full speed")
            assert not walk.answer, walk.answer
            yield walk, trail

    def end(self) -> None:
        """Settle what is open and end every mission."""
        with operator(self.gate) as person:
            mission, digest = self._live[-1]
            for ticket in (person.status()["mission"] or {}).get("open", ()):
                said = {"ticket": ticket, "outcome": Outcome.ABORTED}
                person.command(order(self.gate, mission, digest, Verb.RESOLVE, **said))
            for mission, digest in self._live:
                with suppress(AuthGuardError):  # ended already
                    person.command(order(self.gate, mission, digest, Verb.REVOKE))
        self._live.clear()

    def order(self, verb: Verb) -> int:
        """Give a signed order about the mission; return when the gate had answered."""
        with operator(self.gate) as person:
            person.command(order(self.gate, *self._live[-1], verb))
        return now_ms()

    def news(self, kind: str) -> Told:
        """Return the newest record of a kind since the walk began."""
        found = until(lambda: [r for r in self.gate.news() if r.kind == kind], f"a record: {kind}")
        newest: Told = found[-1]
        return newest


def now_ms() -> int:
    """Return the clock that the robot's sensors read too."""
    return time.monotonic_ns() // 1_000_000


def within(yard: Yard, rest: Rest, found_ms: int) -> None:
    """Require that the robot stood in bounded time, and that it braked as its profile says.

    Args:
        yard: whose gate it is.
        rest: what the sensors saw since the fault.
        found_ms: by when the cause is to be found; what a robot then has is the configuration's.
    """
    print(f"stood after {rest.took_ms} ms and {rest.way_mm} mm")
    assert rest.took_ms <= found_ms + yard.gate.config.stand_within_ms
    look_mm = SPEED_MM_S * max(rest.gap_ms, LOOK_MS) // 1_000 + 1
    assert rest.braking_mm <= BRAKING_MM + look_mm  # on its own clock, however slow the machine
    assert rest.way_mm <= SPEED_MM_S * rest.took_ms // 1_000 - BRAKING_MM + 2 * look_mm


def aborted(yard: Yard, walk: Walk, reason: str) -> Told:
    """Require that the planner and the log say why it ended, and the log when the robot stood."""
    execution = walk.ended()["execution"]
    assert (execution["outcome"], reason in execution["reasons"]) == ("aborted", True), execution
    record = yard.news("outcome")
    assert record.decision == "aborted"
    assert reason in record.open["reasons"]
    tick = LOOK_MS  # it may have been a moment slower than full speed when it was told
    assert BRAKING_MS - tick <= record.open["stood_ms"] <= yard.gate.config.stand_within_ms
    return record


def mule_folder() -> Path:
    """Return a new folder with the mule's site, binding, mission and keys."""
    made = Path(mkdtemp(prefix="ag-mule-", dir="/tmp"))
    (made / "site.yaml").write_text(SITE_WITH_BRAKES)
    (made / "binding.yaml").write_text(BINDING)
    (made / "mission.yaml").write_text(MISSION)
    site = read_site(made / "site.yaml")
    assert site.robots[MULE].profile.brake_mm_s2 == BRAKE_MM_S2
    assert site.robots[MULE].profile.reaction_ms == REACTION_MS
    init_folder(made / "trust", demo_members(site, (MULE,)), now=datetime.now(UTC))
    return made


def mule_gate(folder: Path) -> RunningGate:
    """Return a gate with the mule and its estimator, which is to be entered."""
    return RunningGate(
        robot=True,
        estimator=True,
        rid=MULE,
        trust=folder / "trust",
        site=folder / "site.yaml",
        binding=folder / "binding.yaml",
    )


@pytest.fixture(scope="module")
def folder() -> Path:
    return mule_folder()


@pytest.fixture(scope="module")
def yard(folder: Path) -> Iterator[Yard]:
    with mule_gate(folder) as running:
        yield Yard(running, folder / "mission.yaml")


class OwnEstimator:
    """An estimator in the test's hands: signs what the sensors say, the pose as old as it is told.

    Takes the place of the estimator's process for a while; a context manager.
    """

    def __init__(self, gate: RunningGate) -> None:
        self._gate = gate
        self._lost = threading.Event()
        self._over = threading.Event()
        self.lost_ms = 0
        self._thread = threading.Thread(target=self._sign, daemon=True)
        self._ready = threading.Event()

    def __enter__(self) -> Self:
        self._gate.stop_process("estimator")
        self._thread.start()
        assert self._ready.wait(30)
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(30)
        self._gate.start_estimator()

    def lose(self) -> int:
        """Know no newer pose from now on; return when that was."""
        self.lost_ms = now_ms()
        self._lost.set()
        return self.lost_ms

    def _sign(self) -> None:
        signer = folder_signer(self._gate.trust, f"estimator-{self._gate.rid}")
        epoch, seq, last = time.time_ns() // 1_000_000, 0, None
        seen = Sensors(self._gate.run / "sensors.sock")
        with self._gate.client(ClientRole.ESTIMATOR, "own") as client:
            while not self._over.is_set():
                fence = client.fence
                seen.next()  # it may have been measured before the fence came
                snapshot, seq = fenced(seen.next(), fence), seq + 1
                if not self._lost.is_set() or last is None:
                    last = snapshot.pose
                elif last is not None:
                    old = msgspec.structs.replace(last, age_ms=now_ms() - self.lost_ms)
                    snapshot = msgspec.structs.replace(snapshot, pose=old)
                signed = msgspec.structs.replace(snapshot, epoch=epoch, seq=seq)
                client.attest(sign_object(signed, Tag.STATE, signer))
                self._ready.set()
        seen.close()


def fenced(snapshot: Snapshot, fence: int) -> Snapshot:
    """Return a snapshot whose values were all measured after a fence."""
    replace = msgspec.structs.replace
    readings = {name: replace(value, fence=fence) for name, value in snapshot.readings.items()}
    pose = None if snapshot.pose is None else replace(snapshot.pose, fence=fence)
    return replace(snapshot, pose=pose, readings=readings)


# what the gate sees, and by when


def test_a_robot_that_leaves_its_regions_stands(yard: Yard) -> None:
    """It is outside as soon as its margin is: part of where it may be is the ditch."""
    with yard.walk(BACK) as (walk, trail):
        out = trail.first(lambda s: s.x_mm <= MARGIN_MM, "a robot at the edge")
        rest = trail.rest(out.at_ms)
        within(yard, rest, SNAPSHOT_MS + LIMITS.watch_ms)
        aborted(yard, walk, "OUTSIDE_REGIONS")
        trail.stays()
    yard.gate.stop_process("robot")
    yard.gate.start_robot()  # at home again


def test_a_robot_that_does_not_know_where_it_is_stands(yard: Yard) -> None:
    with OwnEstimator(yard.gate) as estimator, yard.walk() as (walk, trail):
        lost_ms = estimator.lose()
        rest = trail.rest(lost_ms)
        within(yard, rest, yard.age_ms + LOOK_MS + LIMITS.watch_ms)
        record = aborted(yard, walk, "STATE_STALE")
        (finding,) = (f for f in record.sealed["findings"] if f["field"] == "state.pose")
        assert int(finding["got"].split()[0]) > yard.age_ms  # and says how old it had become
        trail.stays()


def test_a_dead_estimator_stops_the_robot(yard: Yard) -> None:
    with yard.walk() as (walk, trail):
        died_ms = now_ms()
        yard.gate.stop_process("estimator", sign=signal.SIGKILL)
        within(yard, trail.rest(died_ms), yard.age_ms + LIMITS.watch_ms)
        aborted(yard, walk, "STATE_STALE")
        trail.stays()
    yard.gate.start_estimator()


def test_a_dead_controller_is_given_up(yard: Yard) -> None:
    """Nobody is left who could say that the robot stands: that is what is reported."""
    gate = yard.gate
    with yard.walk() as (walk, _):
        gate.stop_process("robot", sign=signal.SIGKILL)
        given_up(yard, walk)
        assert "STATE_STALE" not in yard.news("outcome").open["reasons"]  # the connection said it
        gate.start_robot()
        until(lambda: connected(gate), "the controller's return")


def test_a_controller_that_hangs_is_given_up(yard: Yard) -> None:
    """Its connection is open and its sensors say nothing new: the pose's age is what tells."""
    gate = yard.gate
    with yard.walk() as (walk, trail):
        os.kill(gate._started["robot"].pid, signal.SIGSTOP)
        try:
            given_up(yard, walk)
            assert "STATE_STALE" in yard.news("outcome").open["reasons"]
        finally:
            os.kill(gate._started["robot"].pid, signal.SIGCONT)
        trail.rest(now_ms())  # whatever it does when it wakes up: it goes nowhere


def given_up(yard: Yard, walk: Walk) -> None:
    """Require an outcome `unknown` after exactly as long as the configuration says."""
    execution = walk.ended()["execution"]
    assert execution["outcome"] == "unknown"
    assert "CONTROLLER_FAILED" in execution["reasons"]
    told_ms, limit_ms = yard.news("outcome").open["stood_ms"], yard.gate.config.stand_within_ms
    assert limit_ms < told_ms <= limit_ms + LIMITS.watch_ms + PATIENCE_MS
    with operator(yard.gate) as person:
        assert person.status()["mission"]["status"] == "suspended"


@pytest.mark.parametrize("how", ["revocation", "supersession"])
def test_a_mission_that_is_taken_away_stops_the_robot(yard: Yard, how: str) -> None:
    with yard.walk() as (walk, trail):
        if how == "revocation":
            answered_ms = yard.order(Verb.REVOKE)
        else:
            first, digest = yard._live[-1]
            told = {"version": 2, "supersedes": Digest(digest)}
            nonce = b64(scenarios.random_bytes(16))
            yard.activate(msgspec.structs.replace(first, **told, nonce=nonce))
            answered_ms = now_ms()
        within(yard, trail.rest(answered_ms), LIMITS.watch_ms)
        record = aborted(yard, walk, "REVOKED" if how == "revocation" else "SUPERSEDED")
        orders = [r for r in yard.gate.news() if r.kind == "management" and r.seq < record.seq]
        assert orders[-1].decision == ("revoke" if how == "revocation" else "activate")
        trail.stays()


def test_a_mission_that_expires_stops_the_robot(yard: Yard) -> None:
    with yard.walk(window={"for": "4 s"}) as (walk, trail):
        expiry_ms = to_ms(yard._live[-1][0].expiry, where="expiry")
        expires_ms = now_ms() + expiry_ms - time.time_ns() // 1_000_000
        within(yard, trail.rest(expires_ms), LIMITS.watch_ms)
        aborted(yard, walk, "EXPIRED")
        trail.stays()


@pytest.mark.parametrize("role", [ClientRole.OPERATOR, ClientRole.PLANNER])
def test_a_stop_is_bounded_by_the_brakes_alone(yard: Yard, role: ClientRole) -> None:
    with yard.walk() as (walk, trail):
        asked_ms = now_ms()
        with GateClient.connect(yard.gate.stop_socket, role=role, client="hand") as hand:
            said = hand.stop("in the way")
        within(yard, trail.rest(asked_ms), 0)
        assert said["stopped"] is True
        # both parts measure: one answered the client first, one told the log first
        for stood_ms in (yard.news("stop").open["stood_ms"], said["after_ms"]):
            assert BRAKING_MS - LOOK_MS <= stood_ms <= yard.gate.config.stand_within_ms
        assert walk.ended()["execution"]["outcome"] == "aborted"
        trail.stays()


# what the robot sees itself


def test_a_gate_that_hangs_leaves_a_robot_that_stands(yard: Yard) -> None:
    with yard.walk() as (walk, trail):
        hung_ms = now_ms()
        os.kill(yard.gate.pid, signal.SIGSTOP)
        try:
            within(yard, trail.rest(hung_ms), yard.gate.config.renew_within_ms)
        finally:
            os.kill(yard.gate.pid, signal.SIGCONT)
        # who was first when it woke up: the controller's word, or a look at a place that is too old
        ended = walk.ended()["execution"]
        assert ended["outcome"] == "aborted"
        assert {"CONTROLLER_FAILED", "STATE_STALE"} & set(ended["reasons"])
        trail.stays()


@pytest.mark.smoke
def test_a_gate_that_is_killed_leaves_a_robot_that_stands(yard: Yard) -> None:
    gate = yard.gate
    with yard.walk() as (_, trail):
        killed_ms = now_ms()
        gate.kill9()
        within(yard, trail.rest(killed_ms), gate.config.renew_within_ms)
        trail.stays()
        gate.start_gate()
        until(lambda: connected(gate), "the controller's return")
        with operator(gate) as person:
            mission = until(
                lambda: (m := person.status()["mission"]) and m["status"] == "suspended" and m,
                "the suspension",
            )
        assert len(mission["open"]) == 1  # what nobody saw the end of


def test_a_stream_whose_client_dies_ends(yard: Yard) -> None:
    gate = yard.gate
    with yard.mission() as trail:
        planner = gate.client(ClientRole.PLANNER, "driver")
        ticket = planner.open_stream(DRIVE, key="stream")
        params = {"linear_mm_s": SPEED_MM_S, "lateral_mm_s": 0, "turn_urad_s": 0}
        until(lambda: planner.sample(ticket, params) and trail.last.speed_mm_s, "a moving stream")
        died_ms = now_ms()
        planner.close()  # as the end of its process would
        within(yard, trail.rest(died_ms), min(LIMITS.watch_ms, SAMPLE_MS))
        assert yard.news("outcome").decision == "succeeded"
        record = yard.news("stream")
        assert (record.open["last"], record.open["closed"]) == (True, "planner gone")
        assert 0 <= record.open["stood_ms"] <= gate.config.stand_within_ms


# the timer alone


def lone_mission(gate: RunningGate, **changes: Any) -> None:
    """Activate a mission whose one action needs no place and no value."""
    (scan,) = (g for g in scenarios.draft("mission.yaml")["grants"] if g["id"] == "look-out")
    lease = {"max": changes.pop("max", "5 s")}
    grants = [{**scan, **lease}]
    gate.activate(gate.token(gate.mission(guards=[], grants=grants, closing=None, **changes)))


@pytest.fixture(scope="module")
def lone() -> Iterator[RunningGate]:
    """Yield a gate without an estimator; it raises no alert about that."""
    with RunningGate(estimator_silence_ms=0, planner_silence_ms=0) as made:
        yield made


@pytest.mark.parametrize(("number", "reason"), [(1, "EXPIRED"), (2, "LEASE_ENDED")])
def test_the_timer_alone_sees_what_nobody_tells(
    lone: RunningGate, number: int, reason: str
) -> None:
    """No estimator, no order, no stop, and a controller that says nothing after it began."""
    with lone.one_test(number) as gate, Line(gate.socket) as robot:
        robot.hello(ClientRole.CONTROLLER)
        ends = {"window": {"for": "3 s"}} if reason == "EXPIRED" else {"max": "1 s"}
        lone_mission(gate, **ends)
        planner = gate.client(ClientRole.PLANNER, "looks")
        answer: dict[str, Any] = {}
        asking = threading.Thread(
            target=lambda: answer.update(planner.propose(b"scan()")), daemon=True
        )
        asking.start()
        ticket = Digest(robot.told(Kind.DISPATCH)["ticket"])
        robot.say(Kind.BEGUN, Begun(ticket=ticket))
        looks = [time.monotonic()]
        while (item := robot.next()) is not None and item.kind is Kind.RENEW:
            looks.append(time.monotonic())
        assert item is not None
        assert item.kind is Kind.HALT
        looks.append(time.monotonic())
        robot.say(Kind.ENDED, Ended(ticket=ticket, outcome=Outcome.ABORTED, why="STOPPED"))
        robot.say(Kind.STOOD, Stood(stops=1), item.id)
        asking.join(30)
        assert answer["steps"][0]["execution"]["reasons"] == [reason]
        first, last = gate.news()[-2:]
        assert (first.kind, last.kind) == ("decision", "outcome")  # and nothing in between
        assert last.open["stood_ms"] <= gate.config.stand_within_ms
        gaps = [1_000 * (b - a) for a, b in pairwise(looks)]
        assert LIMITS.look_s * 1_000 <= LIMITS.watch_ms
        assert (
            median(gaps) <= LIMITS.watch_ms
        )  # one late look is the machine's, every second one is ours
        (finding,) = last.sealed["findings"]
        if reason == "LEASE_ENDED":  # the gate's own word: found at the first look after its end
            assert int(finding["got"].split()[0]) <= max(LIMITS.watch_ms, *gaps)


def test_the_table_of_bounds_names_each_cause_and_its_test() -> None:
    spec = (scenarios.ROOT / "docs" / "spec" / "gate-protocol.md").read_text()
    section = spec.split("\n### How soon a robot stands\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    named = [re.findall(r"`(test_\w+)`", row) for row in rows]
    assert all(named), rows
    here = Path(__file__)
    others = ("test_gate_streams.py", "test_gate_watching.py", "test_stop_faults.py")
    files = (here, *map(here.with_name, others))
    there = {
        name for f in files for name in re.findall(r"^def (test_\w+)", f.read_text(), re.MULTILINE)
    }
    own = set(re.findall(r"^def (test_\w+)", here.read_text(), re.MULTILINE))
    told = {name for names in named for name in names}
    assert told <= there, told - there
    assert own - told <= {"test_the_table_of_bounds_names_each_cause_and_its_test"}, own - told
    for number in (
        f"{LIMITS.watch_ms} ms",
        f"{SAMPLE_MS} ms",
        f"{round(LIMITS.look_s * 1_000)} ms",
    ):
        assert number in section
