# SPDX-License-Identifier: Apache-2.0
"""How late it is at least, where the machine's clock does not say."""

from __future__ import annotations

from pathlib import Path

import pytest

from authguard_r.keys.clock_floor import began_ms, boot_ms, chain_ms, token_ms
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.store.clocks import SystemClock, committed_ms, last_epoch, store_clock
from authguard_r.store.sqlite import open_store
from fixtures import scenarios

DAY_MS = 86_400_000


def test_a_certificate_that_exists_says_how_late_it_is() -> None:
    trust = read_trust(scenarios.trust_folder())
    began = began_ms(trust.roots)
    assert scenarios.START_MS - 2 * DAY_MS < began <= scenarios.START_MS
    chain = folder_signer(scenarios.trust_folder(), "gate-courier-1").chain
    assert chain_ms(chain) >= began
    assert token_ms(scenarios.token()) >= began


@pytest.mark.parametrize("data", [b"", b"{}", b"nonsense"])
def test_what_is_no_certificate_says_nothing(data: bytes) -> None:
    assert chain_ms((data,)) == 0
    assert token_ms(data) == 0
    assert began_ms(()) == 0


def test_only_a_clock_that_is_before_everything_is_not_believed() -> None:
    trust = read_trust(scenarios.trust_folder())
    began = began_ms(trust.roots)
    for wall_ms in (began, began + 1, scenarios.START_MS):
        # one that is merely behind is: what waits for it is every decision
        assert boot_ms(wall_ms, trust, wall_ms + DAY_MS) == wall_ms
    assert boot_ms(0, trust) == began
    assert boot_ms(began - 1, trust, began + 5, 7) == began + 5


def test_a_store_says_when_it_was_committed(tmp_path: Path) -> None:
    store = tmp_path / "robot.db"
    assert (committed_ms(store), last_epoch(store)) == (0, -1)
    store.touch()
    assert committed_ms(store) == 0
    sim = scenarios.simulation(store=store)
    sim.gate.management.activate(scenarios.token())
    late_ms = sim.gate.ledger.last_ms()
    sim.gate.close()
    assert 0 < committed_ms(store) <= late_ms
    store.write_bytes(b"no store at all, but long enough to be one" * 100)
    assert (committed_ms(store), last_epoch(store)) == (0, -1)


def test_a_store_that_nobody_used_says_nothing(tmp_path: Path) -> None:
    store = tmp_path / "robot.db"
    open_store(store).close()
    assert (committed_ms(store), last_epoch(store)) == (0, -1)
    assert isinstance(store_clock(store), SystemClock)
