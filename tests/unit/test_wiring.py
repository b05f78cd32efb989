# SPDX-License-Identifier: Apache-2.0
"""The wiring refuses to start unsafe (L7)."""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime

import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.errors import AuthGuardError, ControllerError, StoreError
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.operations.offline import offline_gate
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.server.wiring import LogSettings, assemble
from authguard_r.store.clocks import SystemClock, store_clock
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store
from authguard_r.store.transactions import Ledger
from fixtures import scenarios


def parts(name: str = "gate-courier-1", **changes):  # type: ignore[no-untyped-def]
    sim = scenarios.simulation()
    fields = {
        "trust": read_trust(scenarios.trust_folder()),
        "chain": folder_signer(scenarios.trust_folder(), name).chain,
        "site": scenarios.site(),
        "safety": EnvelopeGate(default_config(scenarios.site(), scenarios.RID)),
        "controller": sim.robot,
        "source": sim.robot,
        "clock": sim.robot,
        "store": MemoryStore(),
    }
    return {**fields, **changes}


def test_a_demo_root_is_refused_outside_a_demo() -> None:
    with pytest.raises(AuthGuardError, match="demonstration only"):
        assemble(**parts())
    assert assemble(**parts(), demo=True).trust.demo


@pytest.mark.parametrize("name", ["operator-1", "estimator-courier-1", "witness-1"])
def test_only_a_gates_certificate_makes_a_gate(name: str) -> None:
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        assemble(**parts(name), demo=True)


def test_a_folder_without_the_key_is_a_fault_with_its_place() -> None:
    with pytest.raises(AuthGuardError, match="holds no key of `nobody`"):
        folder_signer(scenarios.trust_folder(), "nobody")


def test_an_offline_gate_moves_nothing(tmp_path) -> None:  # type: ignore[no-untyped-def]
    gate = offline_gate(
        scenarios.trust_folder(), scenarios.site(), rid=scenarios.RID, store=tmp_path / "robot.db"
    )
    controller = gate.enforcer._watch.controller
    with pytest.raises(ControllerError):
        controller.dispatch(scenarios.navigate("dock", "pharmacy"), None)  # type: ignore[arg-type]
    controller.stop()
    assert gate.enforcer.inputs.refresh() is None
    gate.close()


def test_the_machines_clocks_run_forward() -> None:
    clock = SystemClock()
    before, wall = clock.mono_ms(), clock.wall_ms()
    clock.pause(2)
    assert clock.mono_ms() >= before + 2
    assert abs(wall - time.time() * 1000) < 60_000


def test_simulated_time_goes_on_where_it_was_committed(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "robot.db"
    assert isinstance(store_clock(path), SystemClock)
    ahead = scenarios.START_MS + 10**10
    sim = scenarios.simulation(store=path, start_ms=scenarios.START_MS)
    sim.gate.management.activate(scenarios.token())
    sim.gate.close()
    clock = store_clock(path)
    assert clock.wall_ms() >= scenarios.START_MS
    assert clock.mono_ms() >= 0
    clock.pause(1)
    assert clock.wall_ms() < ahead
    path.write_bytes(b"")
    assert isinstance(store_clock(path), SystemClock)


def test_a_store_of_the_machines_own_time_is_not_simulated(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "robot.db"
    gate = assemble(**parts(store=open_store(path), clock=SystemClock()), demo=True)
    gate.management.started()  # something that is committed
    gate.close()
    assert isinstance(store_clock(path), SystemClock)
    path.write_bytes(b"junk")
    assert isinstance(store_clock(path), SystemClock)


def test_a_store_of_another_robot_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    scenarios.simulation(store=tmp_path / "robot.db").gate.close()
    with pytest.raises(AuthGuardError, match="ROBOT_MISMATCH"):
        scenarios.simulation(store=tmp_path / "robot.db", rid=scenarios.OTHER)


@pytest.fixture
def other_trust(tmp_path):  # type: ignore[no-untyped-def]
    folder = tmp_path / "trust"
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    init_folder(folder, demo_members(scenarios.site(), (scenarios.RID,)), now=begin)
    return folder


def test_a_log_that_began_under_another_root_is_refused_and_let_go(tmp_path, other_trust) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "robot.db"
    assemble(**parts(store=open_store(path)), demo=True).close()
    theirs = {
        "trust": read_trust(other_trust),
        "chain": folder_signer(other_trust, "gate-courier-1").chain,
    }
    with pytest.raises(StoreError, match="another trust root"):
        assemble(**parts(store=open_store(path), **theirs), demo=True)
    assemble(**parts(store=open_store(path)), demo=True).close()  # ours still


@pytest.mark.parametrize(("first", "then"), [("shadow", "enforce"), ("enforce", "shadow")])
def test_each_mode_has_a_store_of_its_own(first: str, then: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    logs = {"shadow": LogSettings(marks={"mode": "shadow"}), "enforce": LogSettings()}
    path = tmp_path / "robot.db"
    assemble(**parts(store=open_store(path)), demo=True, log=logs[first]).close()
    with pytest.raises(StoreError, match=f"began in mode `{first}`"):
        assemble(**parts(store=open_store(path)), demo=True, log=logs[then])
    assemble(**parts(store=open_store(path)), demo=True, log=logs[first]).close()


def test_a_log_that_does_not_say_whose_it_is_goes_on_enforcing_and_nothing_else() -> None:
    clock, store = SystemClock(), MemoryStore()
    Ledger(store, clock, robot=scenarios.RID, salts=os.urandom, genesis={})
    assert assemble(**parts(store=store, clock=clock), demo=True).ledger.store is store
    shadow = LogSettings(marks={"mode": "shadow"})
    with pytest.raises(StoreError, match="mode `enforce`"):
        assemble(**parts(store=store, clock=clock), demo=True, log=shadow)
