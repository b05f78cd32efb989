# SPDX-License-Identifier: Apache-2.0
"""Readers of sealed fields, and a gate over the symbolic robot that seals for them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import worlds
from authguard_r.assembly import Simulation, folder_signer
from authguard_r.audit.boxes import DataClass
from authguard_r.audit.record import Record, read_record, read_sealed
from authguard_r.audit.verify import Row, verify_rows
from authguard_r.commands import Command, Verb
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import MissionId
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.keys.readers import ReaderKey, new_reader
from authguard_r.sealing import KeyRing, Reader, Retention, SealingPolicy
from authguard_r.sealing.kept import hold_policy
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.times import committed_ms

EVERY = tuple(sorted(DataClass))
Classes = tuple[DataClass, ...]


@cache
def key_of(role: str) -> ReaderKey:
    """Return a role's key, the same for a whole run; those of `pq-...` are hybrid."""
    return new_reader(hybrid=role.startswith("pq-"))


def reader(role: str, *classes: DataClass) -> Reader:
    """Return a reader of these classes, of all without any."""
    return Reader(role=role, classes=classes or EVERY, key=key_of(role).public.text())


def policy(*readers: Reader, **kept: Any) -> SealingPolicy:
    """Return a policy for these readers, an auditor of everything without any."""
    return SealingPolicy(readers=readers or (reader("auditor"),), **kept)


def rule(data: DataClass, *, least_ms: int = 0, most_ms: int = 0) -> Retention:
    return Retention(data=data, least_ms=least_ms, most_ms=most_ms)


@contextmanager
def sealing(path: Path, what: SealingPolicy | None = None, **more: Any) -> Iterator[Simulation]:
    """Yield a gate on this store, which seals; an old store goes on as it was without a policy."""
    if what is not None:
        store = open_store(path)
        hold_policy(store, what)
        store.close()
    start_ms = max(worlds.START_MS, committed_ms(path))
    sim = worlds.simulation(store=path, **{"start_ms": start_ms, **more})
    try:
        yield sim
    finally:
        sim.gate.close()


def active(sim: Simulation, **changes: Any) -> Mission:
    mission = worlds.mission(**changes)
    sim.gate.management.activate(worlds.token(mission))
    return mission


def command(sim: Simulation, verb: Verb, mission: Mission, *, by: str = "operator-1") -> bytes:
    standing = sim.gate.management.standing(mission.mid)
    assert standing is not None
    return _signed(sim, by, verb=verb, mid=mission.mid, mission=standing.digest)


def shred_order(
    sim: Simulation, of: str, *classes: DataClass, by: str = "site-authority-1", **changes: Any
) -> bytes:
    """Return the order to destroy these classes of a mission, `-` for the records of none."""
    first = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1))[0][3]
    name = str(worlds.RID) if of == "-" else of
    told = {"mid": name, "mission": b64(first), "shreds": tuple(sorted(classes)), **changes}
    return _signed(sim, by, **{"verb": Verb.SHRED, **told})


def _signed(sim: Simulation, by: str, **told: Any) -> bytes:
    fresh = {"version": 1, "nonce": b64(os.urandom(16))}
    expires_ms = sim.gate.ledger.now().utc_ms + 60_000
    command = Command(**{**fresh, "expires_ms": expires_ms, **told, "mid": MissionId(told["mid"])})
    return sign_object(command, Tag.COMMAND, folder_signer(worlds.trust_folder(), by))


def rows_of(path: Path) -> list[Row]:
    """Return a log, which is whole."""
    rows = list(read_rows(path))
    assert verify_rows(rows).whole
    return rows


def opened(rows: Iterable[Row], role: str = "auditor") -> list[Row]:
    """Return what a role reads of a log."""
    ring = KeyRing(key_of(role))
    return [ring.opened(row) for row in rows]


def told(row: Row) -> Record:
    return read_record(row.record, where="")


def values(row: Row) -> dict[str, Any]:
    return {name: one.value for name, one in read_sealed(row.sealed, where="").items()}


def files(path: Path) -> bytes:
    """Return everything that lies beside a store, and the store."""
    return b"".join(file.read_bytes() for file in path.parent.rglob("*") if file.is_file())
