# SPDX-License-Identifier: Apache-2.0
"""The gate's process from start to end: what it takes hold of, it lets go of."""

from __future__ import annotations

import os
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record
from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.client import GateClient
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.token import sign_object
from authguard_r.estop.files import EStopFiles
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.safety import default_config as default_safety
from authguard_r.server import service
from authguard_r.server.parts import GateParts
from authguard_r.server.process import SOCKET, Rendezvous, _Pace, run_gate
from authguard_r.server.robot_lock import hold_robot, root_fingerprint
from authguard_r.sim.robot import SymbolicRobot
from authguard_r.site.source import convert
from authguard_r.store.clocks import SIMULATED
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import estop_fixtures, scenarios
from fixtures.limits import bounded
from unit.server.demo_site import GO, PATIENCE_S, SCAN


@pytest.fixture
def journal() -> Iterator[int]:
    read, write = os.pipe()
    yield write
    os.close(read)
    os.close(write)


@pytest.fixture
def files() -> EStopFiles:
    return estop_fixtures.files()


def robot() -> SymbolicRobot:
    return SymbolicRobot(
        scenarios.site(),
        scenarios.RID,
        scenarios.world(),
        estimator=folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}"),
        start_ms=time.time_ns() // 1_000_000,
    )


def parts(files: EStopFiles, journal: int, **changes: Any) -> GateParts:
    made = GateParts(
        run=files.run,
        trust=read_trust(scenarios.trust_folder()),
        signer=folder_signer(scenarios.trust_folder(), gate_name(scenarios.RID)),
        site=scenarios.site(),
        binding=scenarios.binding(),
        safety=default_safety(scenarios.site(), scenarios.RID),
        config=estop_fixtures.config(),
        store=files.run / "robot.db",
        estop=None,
        journal=journal,
        demo=True,
    )
    return msgspec.structs.replace(made, **changes)


def served(made: GateParts, work: Callable[[Rendezvous], None]) -> None:
    """Run a gate here, in the main thread; another does something and then ends it."""
    faults: list[BaseException] = []
    threads: list[threading.Thread] = []

    def act(told: Rendezvous) -> None:
        try:
            work(told)
        except BaseException as error:  # noqa: BLE001 - raised below
            faults.append(error)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def ready(told: Rendezvous) -> None:
        threads.append(threading.Thread(target=act, args=(told,)))
        threads[0].start()

    files = resource.getrlimit(resource.RLIMIT_NOFILE)
    handlers = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT)}
    try:
        run_gate(made, ready)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, files)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for thread in threads:
            thread.join(PATIENCE_S)
    if faults:
        raise faults[0]


def client(told: Rendezvous, role: ClientRole, **more: Any) -> GateClient:
    timeout = int(PATIENCE_S * 1_000)
    return GateClient.connect(Path(told.socket), role=role, timeout_ms=timeout, **more)


def activate(told: Rendezvous) -> dict[str, Any]:
    now = Now(time.time_ns() // 1_000_000, 0)
    drafted = convert(scenarios.draft(), Draft, where="mission")
    mission = compile_draft(drafted, scenarios.site(), now=now, nonce=b64(os.urandom(16)))
    signer = folder_signer(scenarios.trust_folder(), "operator-1")
    with client(told, ClientRole.OPERATOR) as operator:
        return operator.activate(sign_object(mission, Tag.MISSION, signer))


def records(made: GateParts, kind: str) -> list[Any]:
    rows = [read_record(row.record, where="log") for row in read_rows(made.store)]
    return [record for record in rows if record.kind == kind]


def test_what_is_asked_of_a_simulation_is_asked_of_now(
    files: EStopFiles, journal: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mission that begins now by its author's clock has begun, whenever anybody looked last."""
    bounded(monkeypatch, service, look_s=10 * PATIENCE_S)
    made = parts(files, journal, simulated=robot())

    def work(told: Rendezvous) -> None:
        time.sleep(1.0)  # into a second in which nobody has looked
        activate(told)
        with client(told, ClientRole.PLANNER) as planner:
            assert planner.propose(SCAN)["steps"][0]["released"]

    served(made, work)


def test_a_simulation_that_is_ahead_goes_on_as_time_does() -> None:
    ahead = robot()
    ahead.pause(60_000)
    pace, began = _Pace(ahead), time.monotonic()
    before_ms = ahead.wall_ms()
    for _ in range(1_000):
        pace(moving=False)
    passed_ms = (time.monotonic() - began) * 1_000
    assert ahead.wall_ms() - before_ms <= passed_ms + 1


def test_a_gate_says_where_it_is_and_leaves_nothing_behind(files: EStopFiles, journal: int) -> None:
    made = parts(files, journal)
    beside = made.store.with_name("robot.db.gate")

    def work(told: Rendezvous) -> None:
        assert told == Rendezvous(
            socket=str(files.run / SOCKET), pid=os.getpid(), robot=scenarios.RID
        )
        assert msgspec.json.decode(beside.read_bytes(), type=Rendezvous) == told
        assert (files.run / SOCKET).stat().st_mode & 0o777 == 0o660
        with pytest.raises(EnvironmentFault, match="running already"):
            hold_robot(scenarios.RID, root_fingerprint(made.trust.root), run=files.run)
        with client(told, ClientRole.AUDITOR) as auditor:
            assert auditor.status()["mode"] == "enforce"

    served(made, work)
    assert not beside.exists()
    assert not (files.run / SOCKET).exists()
    hold_robot(scenarios.RID, root_fingerprint(made.trust.root), run=files.run).release()


def test_a_gate_holds_its_key_and_lets_those_go_who_ask_for_its_name(
    files: EStopFiles, journal: int, tmp_path: Path
) -> None:
    """A copy of everything but the key, in another name: as from another network namespace."""
    key = tmp_path / "gate.key.pem"
    key.write_bytes(files.key.read_bytes())
    made = parts(files, journal, key=key)
    root = root_fingerprint(made.trust.root)
    told: list[str] = []

    def work(_: Rendezvous) -> None:
        with pytest.raises(EnvironmentFault, match="with this key is running already"):
            hold_robot(scenarios.OTHER, "b" * 16, run=tmp_path, key=key)
        for _ in range(200):  # more than its queue holds: it answers meanwhile
            with pytest.raises(EnvironmentFault) as refused:
                hold_robot(scenarios.RID, root, run=tmp_path)
            told.append(refused.value.message)

    served(made, work)
    assert {f"pid {os.getpid()}" in message for message in told} == {True}
    hold_robot(scenarios.OTHER, "b" * 16, run=tmp_path, key=key).release()


def test_a_simulated_robot_walks_in_the_gates_own_time(files: EStopFiles, journal: int) -> None:
    made = parts(files, journal, simulated=robot())

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.PLANNER) as planner:
            (step,) = planner.propose(GO)["steps"]
            assert step["execution"]["outcome"] == "succeeded"
            assert planner.propose(SCAN)["steps"][0]["executed"]

    served(made, work)
    assert records(made, "genesis")[0].open["clock"] == SIMULATED
    assert made.simulated is not None
    assert made.simulated.state.region == "pharmacy"


def test_a_clean_end_stops_what_moves_and_the_next_start_finds_the_mission_active(
    files: EStopFiles, journal: int
) -> None:
    slow = robot()
    made = parts(files, journal, simulated=slow)
    planners: list[GateClient] = []

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.AUDITOR) as auditor:
            assert auditor.status()["mission"]["status"] == "active"

    served(made, work)
    again = parts(files, journal, simulated=robot())

    def look(told: Rendezvous) -> None:
        with client(told, ClientRole.AUDITOR) as auditor:
            assert auditor.status()["mission"]["status"] == "active"

    served(again, look)
    assert planners == []
    assert [r.link.decision for r in records(made, "management")] == ["issue", "activate"]


def test_a_shadow_gate_releases_nothing_and_marks_every_record(
    files: EStopFiles, journal: int
) -> None:
    made = parts(
        files, journal, config=msgspec.structs.replace(estop_fixtures.config(), mode=Mode.SHADOW)
    )

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.PLANNER, allow_shadow=True) as planner:
            for plan in (GO, GO, b"fly("):
                assert planner.propose(plan)["shadow"] is True

    served(made, work)
    every = [read_record(row.record, where="log") for row in read_rows(made.store)]
    assert all(record.open["mode"] == "shadow" for record in every)
    assert len([r for r in every if r.kind == "decision"]) == 2


def test_a_simulated_robot_of_a_shadow_gate_stands_still_while_its_time_passes(
    files: EStopFiles, journal: int
) -> None:
    here = robot()
    start, began_ms = here.state, here.mono_ms()
    config = msgspec.structs.replace(estop_fixtures.config(), mode=Mode.SHADOW)
    made = parts(files, journal, config=config, simulated=here)

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.PLANNER, allow_shadow=True) as planner:
            (step,) = planner.propose(GO)["steps"]
            assert step["execution"]["outcome"] == "succeeded"  # as is assumed
        before = here.mono_ms()
        estop_fixtures.until(lambda: here.mono_ms() > before + 200, "idle time")

    served(made, work)
    assert here.mono_ms() > began_ms
    assert (here.state.x_mm, here.state.y_mm) == (start.x_mm, start.y_mm)
    assert here.state.region == start.region
    assert {r.open["mode"] for r in records(made, "outcome")} == {"shadow"}


def test_a_stop_lane_is_started_with_the_gate_heard_and_ended_with_it(
    files: EStopFiles, journal: int
) -> None:
    made = parts(files, journal, estop=files)

    def work(told: Rendezvous) -> None:
        hand = estop_fixtures.Client(files.run)
        hand.hello(ClientRole.OPERATOR)
        hand.stop("smoke")
        with client(told, ClientRole.AUDITOR) as auditor:
            estop_fixtures.until(lambda: auditor.status()["stops"] == 1, "the stop's word")

    served(made, work)
    (stop,) = records(made, "stop")
    assert stop.open["by"] == f"u{os.geteuid()}.operator"
    assert not (files.run / "stop.sock").exists()


def test_a_socket_that_cannot_be_is_a_fault_and_nothing_is_held(
    tmp_path: Path, files: EStopFiles, journal: int
) -> None:
    long = tmp_path / ("x" * 120)
    long.mkdir()
    made = parts(files, journal, run=long)
    with pytest.raises(EnvironmentFault, match="cannot listen"):
        served(made, lambda _: None)
    hold_robot(scenarios.RID, root_fingerprint(made.trust.root), run=long).release()
    served(parts(files, journal), lambda _: None)  # the store is free too


def test_a_second_gate_for_the_same_robot_is_refused_before_its_store_is_touched(
    files: EStopFiles, journal: int
) -> None:
    made = parts(files, journal)
    held = hold_robot(scenarios.RID, root_fingerprint(made.trust.root), run=files.run)
    try:
        with pytest.raises(EnvironmentFault, match="running already"):
            served(made, lambda _: None)
    finally:
        held.release()
    assert not made.store.exists()
