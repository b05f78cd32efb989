# SPDX-License-Identifier: Apache-2.0
"""`kill -9` at any moment: what was acknowledged is there, and registry and log tell one story.

The log is folded anew, record by record, by the rules of docs/spec/standing.md, and the standing
that the registry holds must be exactly that. Every round kills a whole gate in a process of its
own; half of the restarts happen here, where they can be looked at, the other half in the next
gate to be killed, so that recovery is killed too.
"""

from __future__ import annotations

import json
import os
import random
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import decode
from authguard_r.core.errors import StoreError
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Standing, Use
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.sqlite import read_held, read_rows
from fixtures import scenarios
from integration.crash_worker import RESOLUTIONS, SCAN, Order, command, gate

SEED = int(os.environ.get("AUTHGUARD_SEED", "20260"))
#: A worker that says nothing for that long has hung, seconds.
PATIENCE = 60.0
#: Simulated time between two lives of a gate: more than any round can use up.
BETWEEN_MS = 600_000
#: Rounds on one store at most: the mission must not end before they do.
LONGEST = 60
#: Its postcondition can be attested, so recovery settles it without a person.
SELF_SETTLING = "tell"


def mission() -> Mission:
    """Return a mission with enough of everything for a long time."""
    forever = {"repeat": 100_000, "starts": 100_000, "max": "5 s", "irreversible": False}
    attested = [{"variable": "battery_permille", "ge": 1, "max_age": "1 h"}]
    look: dict[str, Any] = {"id": "look", "type": "scan_obstacles", "tool": "lidar", **forever}
    tell: dict[str, Any] = {"id": SELF_SETTLING, "type": "announce", "tool": "speaker", **forever}
    everywhere = {"rows": [{}], "chooser": "operator"}
    return scenarios.mission(
        mission="many-looks",
        grants=[{**look, **everywhere}, {**tell, **everywhere, "done_when": attested}],
        window={"for": "20 h"},
        closing=None,
        budgets={
            "actions": 1_000_000,
            "rate": {"count": 1_000_000, "per": "10 s"},
            "motion": "0 s",
            "waiting": "0 s",
            "recorded_bytes": 0,
            "prompts": 0,
            "planner_stops": 0,
        },
    )


class Story:
    """What a log says has happened, folded by the rules and by nothing else."""

    def __init__(self, rows: tuple[LogRow, ...]) -> None:
        self.status: Status | None = None
        self.uses: dict[str, Use] = {}
        self.order = 0
        self.actions = 0
        self.open: dict[str, str] = {}
        self.outcomes: dict[str, str] = {}
        self.released: dict[str, int] = {}
        for row in rows:
            record = json.loads(row.record)
            tell = getattr(self, f"_{record['kind']}")
            tell(row, record["open"], record["link"]["decision"])

    def _genesis(self, row: LogRow, _opened: dict[str, Any], _decision: str) -> None:
        assert row.seq == 0

    def _decision(self, row: LogRow, opened: dict[str, Any], decision: str) -> None:
        if opened["ticket"] == "-":
            return
        assert decision == "accept"
        assert not self.open, "a release was made while another was in flight"
        assert self.status is Status.ACTIVE
        self._use(opened["grant"], starts=1)
        self.actions += 1
        self.open[opened["ticket"]] = opened["grant"]
        self.released[opened["ticket"]] = row.seq

    def _outcome(self, _row: LogRow, opened: dict[str, Any], decision: str) -> None:
        self._end(opened["ticket"], decision)

    def _management(self, row: LogRow, opened: dict[str, Any], decision: str) -> None:
        sealed = json.loads(row.sealed)
        if decision == "issue":
            assert self.status is None
            self.status = Status.ISSUED
        elif decision == "activate":
            assert self.status is Status.ISSUED
            self.status = Status.ACTIVE
        elif decision == "recover":
            self._recover(opened)
        elif decision == "resolve":
            order = sealed["command"]["value"]
            self._end(order["ticket"], order["outcome"])
        elif decision == "resume":
            assert self.status is Status.SUSPENDED
            self.status = Status.ACTIVE
        else:
            pytest.fail(f"nobody ordered `{decision}`")

    def _recover(self, opened: dict[str, Any]) -> None:
        for ticket, grant in list(self.open.items()):
            if grant == SELF_SETTLING:
                self._end(ticket, Outcome.SUCCEEDED)
        if self.open:
            self.status = Status.SUSPENDED
        assert (opened["unknown"], opened["status"]) == (len(self.open), self.status)

    def _end(self, ticket: str, outcome: str) -> None:
        grant = self.open.pop(ticket)
        self.outcomes[ticket] = outcome
        if outcome == Outcome.SUCCEEDED:
            self.order += 1
            self._use(grant, successes=1, last_success=self.order)
        elif outcome == Outcome.NOT_STARTED:
            self._use(grant, starts=-1)
            self.actions -= 1

    def _use(
        self, grant: str, *, starts: int = 0, successes: int = 0, last_success: int = 0
    ) -> None:
        use = self.uses.get(grant, Use())
        self.uses[grant] = Use(
            starts=use.starts + starts,
            successes=use.successes + successes,
            last_success=last_success or use.last_success,
        )


class Life:
    """One store file through several crashes."""

    def __init__(self, path: Path, mid: str) -> None:
        self.path = path
        self.mid = mid
        self.rounds = 0
        self._rows: tuple[LogRow, ...] = ()

    def order(self, seed: int) -> Order:
        """Return the next round on this store, later than all before."""
        self.rounds += 1
        start = scenarios.START_MS + BETWEEN_MS * self.rounds
        return Order(store=str(self.path), start_ms=start, seed=seed)

    def read(self) -> Story:
        """Return the log's story once it is whole, unchanged so far, and the registry agrees."""
        try:
            rows = tuple(read_rows(self.path))
        except StoreError:
            assert self._rows == (), "a log that was there cannot be read"
            return Story(())  # killed before there was a store
        found = verify_rows(rows, terminal=None)
        assert found.whole, found
        assert rows[: len(self._rows)] == self._rows, "a record was lost or changed"
        self._rows = rows
        story = Story(rows)
        held = read_held(self.path, "standing", self.mid)
        if held is None:
            assert story.status is None
        else:
            self._compare(story, decode(held, Standing))
        return story

    def _compare(self, story: Story, standing: Standing) -> None:
        """No half state: all that the registry holds is what the log says, and the reverse."""
        assert standing.status == story.status
        assert standing.uses == story.uses
        assert standing.order == story.order
        assert standing.actions == story.actions
        assert {release.ticket: release.grant for release in standing.open} == story.open
        assert len(standing.open) <= 1

    def require(self, heard: Heard, story: Story) -> None:
        """Everything that the gate acknowledged, or moved for, is in the log."""
        assert not heard.faults, heard.faults
        for ticket in heard.moving:
            assert ticket in story.released, "the robot moved for a release that is not on disk"
        for seq, outcome in heard.acked:
            opened = json.loads(self._rows[seq].record)["open"]
            if outcome == "-":
                assert opened["ticket"] == "-"
            else:
                assert story.released[opened["ticket"]] == seq
                assert story.outcomes[opened["ticket"]] == outcome


class Heard:
    """What one gate said before it died."""

    def __init__(self) -> None:
        self.moving: list[str] = []
        self.acked: list[tuple[int, str]] = []
        self.faults: list[str] = []
        #: True while a checkpoint was being made.
        self.covering = False

    def take(self, line: str) -> None:
        kind, _, rest = line.partition(" ")
        if kind == "moving":
            self.moving.append(rest)
        elif kind == "acked":
            seq, outcome = rest.split()
            self.acked.append((int(seq), outcome))
        elif kind in {"covering", "covered"}:
            self.covering = kind == "covering"
        else:
            self.faults.append(line)


class Worker:
    """The warm process that forks gates (crash_worker.py)."""

    def __init__(self, folder: Path, token: Path, errors: Path) -> None:
        tests = scenarios.ROOT / "tests"
        path = os.pathsep.join(filter(None, (str(tests), os.environ.get("PYTHONPATH"))))
        script = Path(__file__).with_name("crash_worker.py")
        self._errors = errors
        with errors.open("wb") as stderr:
            self._process = subprocess.Popen(
                [sys.executable, str(script), str(folder), str(token)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                bufsize=0,
                env={**os.environ, "PYTHONPATH": path},
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        self._wait = selectors.DefaultSelector()
        self._wait.register(self._stdout, selectors.EVENT_READ)
        self._lines: list[str] = []
        self._rest = b""
        assert self._hear() == "ready"

    def round(self, order: Order, dice: random.Random) -> Heard:
        """Let a gate live for a random while; return what it said, all of it."""
        heard = Heard()
        self._stdin.write(msgspec.json.encode(order) + b"\n")
        assert self._hear(aside=heard) == "born"
        # at once, on the first motion, or some time after the first acknowledgment
        until, longest = dice.choice((("", 0.015), ("moving", 0.001), ("acked", 0.04)))
        while until and not getattr(heard, until) and not heard.faults:
            heard.take(self._hear())
        time.sleep(dice.uniform(0, longest))  # the moment itself; nothing waits for it
        self._stdin.write(b"kill\n")
        assert self._hear(aside=heard, until="died") == "died 9", heard.faults
        return heard

    def close(self) -> None:
        """End the worker: its standard input ends."""
        self._stdin.close()
        self._process.wait(PATIENCE)
        self._wait.close()
        self._stdout.close()

    def _hear(self, *, aside: Heard | None = None, until: str = "born") -> str:
        """Return the next line; with `aside`, the next that starts so, the others set aside."""
        while True:
            while not self._lines:
                ready = self._wait.select(PATIENCE)
                data = os.read(self._stdout.fileno(), 65_536) if ready else b""
                assert data, f"the worker is silent: {self._errors.read_text()}"
                *lines, self._rest = (self._rest + data).split(b"\n")
                self._lines += [line.decode() for line in lines]
            line = self._lines.pop(0)
            if aside is None or line.startswith(until):
                return line
            aside.take(line)


@pytest.fixture
def token(tmp_path: Path) -> Path:
    path = tmp_path / "mission.token"
    path.write_bytes(scenarios.token(mission()))
    return path


@pytest.fixture
def worker(tmp_path: Path, token: Path) -> Iterator[Worker]:
    made = Worker(scenarios.trust_folder(), token, tmp_path / "worker.stderr")
    yield made
    made.close()


def restart(life: Life, story: Story, dice: random.Random) -> None:
    """Start the gate again here: what a person must settle, nothing goes past."""
    folder = scenarios.trust_folder()
    sim = gate(folder, life.order(dice.randrange(2**32)))
    try:
        unsettled = tuple(t for t, grant in story.open.items() if grant != SELF_SETTLING)
        assert sim.gate.management.recover() == unsettled
        standing = sim.gate.management.standing(life.mid)  # type: ignore[arg-type]
        if standing is None:
            return  # killed before it was activated
        suspended = bool(unsettled) or story.status is Status.SUSPENDED
        assert standing.status is (Status.SUSPENDED if suspended else Status.ACTIVE)
        for ticket in unsettled:
            report = scenarios.propose(sim, SCAN)
            assert report.judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
            outcome = dice.choice(RESOLUTIONS)
            order = {"ticket": ticket, "outcome": outcome}
            standing = command(sim, folder, standing, Verb.RESOLVE, **order)
            assert standing.open == ()
        if suspended:
            report = scenarios.propose(sim, SCAN)
            assert report.judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
            assert sim.robot.trace == []
            command(sim, folder, standing, Verb.RESUME)
        assert scenarios.propose(sim, SCAN).outcome is Outcome.SUCCEEDED
    finally:
        sim.gate.close()


def campaign(worker: Worker, folder: Path, *, kills: int, seed: int) -> None:
    """Kill that many gates and hold every one to its word."""
    print(f"AUTHGUARD_SEED={seed}")
    dice = random.Random(seed)
    mid = mission().mid
    in_flight = idle = covering = acknowledged = 0
    life = Life(folder / "store-0.db", mid)
    for kill in range(kills):
        if dice.random() < 0.1 or life.rounds > LONGEST:
            life = Life(folder / f"store-{kill}.db", mid)
        heard = worker.round(life.order(dice.randrange(2**32)), dice)
        story = life.read()
        life.require(heard, story)
        acknowledged += len(heard.acked)
        in_flight += len(story.open)
        idle += not story.open
        covering += heard.covering
        if dice.random() < 0.5:
            restart(life, story, dice)
            assert not life.read().open
    print(f"{kills} kills, {in_flight} in flight, {idle} idle, {acknowledged} acknowledged")
    print(f"{covering} kills while a checkpoint was made")
    # the kills really fell on both sides of a commit, and while a checkpoint was made
    assert in_flight >= kills // 20
    assert idle >= kills // 20
    assert acknowledged >= kills // 5
    assert covering >= 1 + kills // 200


def test_two_hundred_killed_gates_keep_every_promise(worker: Worker, tmp_path: Path) -> None:
    campaign(worker, tmp_path, kills=200, seed=SEED)


@pytest.mark.nightly
def test_two_thousand_killed_gates_keep_every_promise(worker: Worker, tmp_path: Path) -> None:
    campaign(worker, tmp_path, kills=2_000, seed=SEED + 1)
