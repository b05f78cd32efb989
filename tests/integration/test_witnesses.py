# SPDX-License-Identifier: Apache-2.0
"""Real gates and their witnesses: no counter, and a restored, deleted or copied store is caught."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
import pytest

from authguard_r.anchoring.places import WitnessPlace
from authguard_r.audit.note import NoteKey
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, RunningGate, order, until
from fixtures.slow_witness import KINDS, SlowWitness
from fixtures.small_witness import ORIGIN, SmallWitness, log_keys
from integration.test_gate_watching import operator
from integration.test_rollback import SCAN, CountedGate, active, resumed


class WitnessedGate(CountedGate):
    """A gate with the robot inside, two witnesses that both have to agree, and no counter."""

    def __init__(self, *witnesses: SmallWitness, **more: Any) -> None:
        places = tuple(witness.place for witness in witnesses)
        super().__init__(simulate=True, witnesses=places, quorum=len(places), **more)

    def start_gate(self, *more: str) -> dict[str, Any]:
        return RunningGate.start_gate(self, *more)

    @property
    def told(self) -> dict[str, Any]:
        """What `status` says of the witnesses."""
        told: dict[str, Any] = self.anchor["witness"]
        return told

    def seen(self) -> None:
        """Wait until the witnesses have seen everything."""
        until(lambda: self.told["unwitnessed"] == 0, "the cosignatures")

    def step(self) -> dict[str, Any]:
        """Propose something and return what became of it."""
        with self.client(ClientRole.PLANNER) as planner:
            step: dict[str, Any] = planner.propose(SCAN)["steps"][0]
        return step


@pytest.fixture
def one() -> Iterator[SmallWitness]:
    with SmallWitness("one") as witness:
        yield witness


@pytest.fixture
def two() -> Iterator[SmallWitness]:
    with SmallWitness("two") as witness:
        yield witness


@pytest.fixture
def gate(one: SmallWitness, two: SmallWitness) -> Iterator[WitnessedGate]:
    with WitnessedGate(one, two, checkpoint_ms=100) as running:
        yield running


def irreversible(gate: RunningGate) -> Mission:
    made = gate.mission()
    grants = tuple(msgspec.structs.replace(grant, irreversible=True) for grant in made.actions)
    return msgspec.structs.replace(made, actions=grants)


def put_back(gate: WitnessedGate, *whys: str) -> None:
    """The gate serves, says why, and decides nothing; a restart is no way round."""
    for why in whys:
        anchor = gate.anchor
        assert (anchor["state"], anchor["why"]) == ("put_back", why)
        assert anchor["by"] in {"one", "two"}
        assert gate.refused() == ["ROLLED_BACK"]
        with operator(gate) as person, pytest.raises(AuthGuardError) as refused:
            person.evaluate(SCAN)
        assert refused.value.reason == "ROLLED_BACK"
        gate.restart()


def test_a_restored_store_is_caught_by_witnesses_alone(gate: WitnessedGate) -> None:
    active(gate)
    snapshot = gate.ended()
    gate.start_gate()
    gate.works()
    gate.seen()
    gate.ended()
    shutil.copy(snapshot, gate.store)
    gate.start_gate()
    size = gate.anchor["counted"]
    put_back(gate, "behind")
    alerts = [r for r in gate.records() if r.open.get("what") == "the store was rolled back"]
    assert alerts[0].open["counted"] == size > alerts[0].open["size"]
    # what it refused has made it longer, but not the log that was seen
    assert gate.anchor["state"] == "put_back"
    assert gate.refused() == ["ROLLED_BACK"]
    assert '"why":"behind"' in gate.said()


def test_a_deleted_store_is_caught_by_witnesses_alone(gate: WitnessedGate) -> None:
    active(gate)
    gate.ended()
    gate.store.unlink()
    gate.start_gate()
    assert gate.anchor["why"] in {"behind", "forked"}
    assert gate.refused() == ["ROLLED_BACK"]


def test_a_copy_that_went_on_elsewhere_is_caught_by_witnesses_alone(
    gate: WitnessedGate, one: SmallWitness, two: SmallWitness
) -> None:
    """The other machine has no witnesses, and makes more records than these have seen."""
    active(gate)
    copy, here = gate.ended(), gate.store
    gate.start_gate()
    gate.works()
    gate.ended()
    told = gate.config
    gate.store = copy
    gate.configure(msgspec.structs.replace(told, witnesses=(), quorum=0))
    gate.start_gate()
    while len(gate.records()) <= max(one.size, two.size) + 1:
        with gate.client(ClientRole.PLANNER) as planner:
            planner.propose(b"scan(")
        gate.restart()
    gate.ended()
    gate.configure(told)
    gate.start_gate()
    put_back(gate, "forked", "forked")
    gate.ended()
    gate.store = here
    gate.start_gate()
    assert gate.anchor["state"] == "uncounted"
    gate.seen()


def test_without_its_witnesses_a_gate_goes_on_and_what_has_no_undo_waits(
    gate: WitnessedGate, one: SmallWitness, two: SmallWitness
) -> None:
    gate.seen()
    one.stop()
    gate.activate(gate.token(irreversible(gate)))
    step = gate.step()
    assert step["released"], step  # both have confirmed since the start
    gate.restart()
    assert gate.anchor["state"] == "uncounted"
    assert (gate.told["confirmed"], two.size > 0) == (1, True)
    with operator(gate) as person:
        person.evaluate(SCAN)
    step = gate.step()
    assert (step["released"], step["reasons"]) == (False, ["STORE_UNAVAILABLE"])
    assert gate.told["unwitnessed"] > 0
    one.start()
    until(lambda: gate.told["confirmed"] == 2, "both witnesses")
    assert gate.step()["released"]
    gate.seen()
    assert one.size == two.size


def test_a_gate_that_was_killed_is_refused_nothing(gate: WitnessedGate) -> None:
    """Whatever it had made of its checkpoint: the store is never behind what a witness saw."""
    active(gate)
    gate.works()
    for _ in range(3):
        gate.kill9()
        gate.start_gate()
        assert gate.anchor["state"] == "uncounted"
    gate.seen()
    assert gate.told["confirmed"] == 2


def test_a_mission_that_ends_is_witnessed_without_waiting_for_more(one: SmallWitness) -> None:
    with WitnessedGate(one, checkpoint_ms=86_400_000, checkpoint_records=1_000_000) as gate:
        mission, digest = active(gate)
        before = one.size
        with operator(gate) as person:
            person.command(order(gate, mission, digest, Verb.REVOKE))
        until(lambda: one.size > before, "the checkpoint")


def test_slow_witnesses_of_every_kind_keep_an_honest_one_from_nothing(one: SmallWitness) -> None:
    """They drip, fall silent or never end: what is new is witnessed, and what has no undo goes."""
    with ExitStack() as held, WitnessedGate(checkpoint_ms=100) as gate:
        slow = [held.enter_context(SlowWitness(kind)) for kind in KINDS]
        places = (*(witness.place for witness in slow), one.place)
        gate.configure(msgspec.structs.replace(gate.config, witnesses=places, quorum=1))
        gate.restart()
        gate.activate(gate.token(irreversible(gate)))
        assert gate.step()["released"]
        gate.seen()
        seen = one.size
        assert gate.step()["released"]
        gate.seen()
        assert one.size > seen
        told = {each["name"]: each for each in gate.told["witnesses"]}
        assert told["one"]["state"] == "cosigned"

        def given_up() -> bool:
            shown = {each["name"]: each["state"] for each in gate.told["witnesses"]}
            return all(shown[kind] == "unreachable" for kind in KINDS)

        until(given_up, "the end of every exchange")
        assert gate.told["confirmed"] == 1
        assert gate.step()["released"]
        gate.seen()


class Program:
    """`authguard witness`, as its owner makes it and lets it serve."""

    def __init__(self, folder: Path, *keys: NoteKey) -> None:
        self._folder, self._keys = folder, keys
        self.key = self.does("init", folder, "--name", "stranger")["key"]
        self.add()
        self._serving: subprocess.Popen[bytes] | None = None

    def does(self, *words: object) -> dict[str, Any]:
        said = [str(AUTHGUARD), "witness", *map(str, words), "--json"]
        done = subprocess.run(said, capture_output=True, check=True, cwd=scenarios.ROOT)
        told: dict[str, Any] = json.loads(done.stdout)
        return told

    def add(self) -> None:
        given = [word for key in self._keys for word in ("--log", key.text())]
        self.does("add", self._folder, *given)

    def forget(self) -> None:
        self.does("forget", self._folder, ORIGIN)

    @property
    def size(self) -> int:
        (log,) = self.does("show", self._folder)["logs"]
        return int(log["size"])

    def serve(self, port: int = 0) -> int:
        """Serve; return the port."""
        said = [str(AUTHGUARD), "witness", "serve", str(self._folder), "--json"]
        said += ["--listen", f"127.0.0.1:{port}"]
        self._serving = subprocess.Popen(
            said, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=scenarios.ROOT
        )
        assert self._serving.stdout is not None
        told = json.loads(self._serving.stdout.readline())
        found = urlsplit(told["url"]).port
        assert found is not None
        return found

    def end(self) -> None:
        if self._serving is not None:
            self._serving.terminate()
            self._serving.wait(PATIENCE_S)
            assert self._serving.stdout is not None
            self._serving.stdout.close()
            self._serving = None


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    running = Program(tmp_path / "witness", *log_keys())
    yield running
    running.end()


def test_the_products_own_witness_catches_it_and_forgets_when_its_owner_says_so(
    program: Program,
) -> None:
    """`authguard witness serve` beside `authguard gate`: a store is restored, then accepted."""
    port = program.serve()
    place = WitnessPlace(url=f"http://127.0.0.1:{port}", key=program.key)
    with WitnessedGate(checkpoint_ms=100) as plain:
        told = msgspec.structs.replace(plain.config, witnesses=(place,), quorum=1)
        plain.configure(told)
        plain.restart()
        mission = irreversible(plain)
        digest = plain.activate(plain.token(mission))["digest"]
        snapshot = plain.ended()
        plain.start_gate()
        plain.works()
        plain.ended()
        assert program.size > 0
        shutil.copy(snapshot, plain.store)
        plain.start_gate()
        assert (plain.anchor["why"], plain.anchor["by"]) == ("behind", "stranger")
        assert plain.refused() == ["ROLLED_BACK"]
        assert plain.recovers()["exit"] == 0
        resumed(plain, mission, digest)
        assert plain.step()["reasons"] == ["STORE_UNAVAILABLE"]
        program.end()
        program.forget()
        program.add()
        program.serve(port)
        until(lambda: plain.told["confirmed"] == 1, "the cosignature")
        assert plain.step()["released"]
        plain.restart()
        assert plain.anchor["state"] == "uncounted"
