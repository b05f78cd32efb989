# SPDX-License-Identifier: Apache-2.0
"""One safe gate whose written files are their own; each test gives one of them two names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from msgspec.structs import replace

from authguard_r.core.errors import EnvironmentFault
from authguard_r.operations.checkup import GateSetup, checkup, require_safe
from authguard_r.operations.checkup.advice import Advice, AdviceCode, Level
from unit.server.robots import NOW, mine, robot


@pytest.fixture
def setup(tmp_path: Path) -> GateSetup:
    made = robot(tmp_path)
    (tmp_path / "other").mkdir()
    file = tmp_path / "gate.token"
    file.write_text("signed")
    return replace(
        made,
        counter=tmp_path / "other" / "counter",
        journal=tmp_path / "other" / "journal",
        files=(mine(file, 0o644),),
    )


def same(setup: GateSetup) -> list[Advice]:
    return [found for found in checkup(setup, NOW) if found.code is AdviceCode.SAME_FILE]


def refused(setup: GateSetup) -> None:
    """It is said, and neither a gate nor a demonstration of one starts with it."""
    assert [found.level for found in same(setup)] == [Level.UNSAFE]
    for demo in (False, True):
        with pytest.raises(EnvironmentFault, match="a file of its own"):
            require_safe(replace(setup, demo=demo), NOW)


def test_a_gate_whose_files_are_apart_starts(setup: GateSetup) -> None:
    assert same(setup) == []
    require_safe(setup, NOW)
    require_safe(replace(setup, demo=True, chain=setup.key), NOW)  # read alone: no harm
    assert same(replace(setup, store=None, counter=None, journal=None)) == []
    assert same(replace(setup, trust=None)) == []


@pytest.mark.parametrize("ending", ["", "-wal", "-shm", "-journal", ".gate", ".reserve"])
def test_a_counter_that_is_the_store_would_replace_it(setup: GateSetup, ending: str) -> None:
    assert setup.store is not None
    refused(replace(setup, counter=setup.store.with_name(f"{setup.store.name}{ending}")))


def test_what_is_written_beside_the_counter_is_nobody_elses(setup: GateSetup) -> None:
    assert setup.counter is not None
    refused(replace(setup, journal=setup.counter.with_name("counter.new")))


def test_the_journal_has_a_place_of_its_own_named_or_not(setup: GateSetup) -> None:
    assert setup.store is not None
    beside = setup.store.with_name(f"{setup.store.name}.emergency")
    refused(replace(setup, journal=None, counter=beside))
    refused(replace(setup, journal=setup.counter))
    refused(replace(setup, journal=setup.store))
    assert same(replace(setup, journal=beside)) == []


@pytest.mark.parametrize("read", ["key", "chain", "file", "root"])
@pytest.mark.parametrize("written", ["store", "counter", "journal"])
def test_what_is_only_read_is_written_over_by_nothing(
    setup: GateSetup, written: str, read: str
) -> None:
    assert setup.trust is not None
    path = {
        "key": setup.key,
        "chain": setup.chain,
        "file": setup.files[0],
        "root": setup.trust / "root.pem",
    }[read]
    assert len(same(replace(setup, **{written: path}))) == 1


def test_another_name_of_a_file_is_the_same_file(setup: GateSetup, tmp_path: Path) -> None:
    assert setup.store is not None
    link = tmp_path / "other" / "link"
    link.symlink_to(setup.store)  # the store is not there yet
    refused(replace(setup, counter=link))
    link.unlink()
    setup.store.write_bytes(b"")
    os.link(setup.store, link)
    assert len(same(replace(setup, counter=link))) == 1
