# SPDX-License-Identifier: Apache-2.0
"""Logs of shadow runs, written record by record into a real store.

The shape of the records is that of docs/spec/audit-record.md#shadow; the entries are made by the
product's own `report`, so that they cannot drift from what a gate writes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

import worlds
from authguard_r.audit.record import Entry, append
from authguard_r.audit.verify import Row
from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.decide import decide
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.state import AttestedState
from authguard_r.normalize.context import Influence
from authguard_r.report import Judged, decision_entry, refusal_entry
from authguard_r.site.model import Site, site_digest
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store, read_rows

SHADOW = {"mode": "shadow"}
EVIDENCE = Digest(b64(bytes(32)))


def genesis(site: Site | None = None, *, robot: str = worlds.RID) -> Entry:
    """Return the first record of a log."""
    model = site or worlds.site()
    opened = {"format": 1, "robot": robot, "site": site_digest(model), "demo": True, **SHADOW}
    return Entry(
        kind="genesis", time_ms=worlds.START_MS, decision="genesis", open=opened, sealed={}
    )


def decided(
    action: Action,
    *,
    at: str = "dock",
    influences: tuple[Influence, ...] = (),
    marks: dict[str, Any] | None = None,
    state: AttestedState | None = None,
) -> Entry:
    """Return the record of a decision on an action, as a gate in shadow mode writes it."""
    verified, facts = worlds.verified(), worlds.facts()
    meta = ActionMeta(
        planner="planner",
        timestamp=to_timestamp(worlds.START_MS),
        evidence=EVIDENCE,
        mission=verified.mission.mid,
        mission_version=verified.mission.version,
    )
    whole = msgspec.structs.replace(
        action, meta=meta, provenance={"destination": Label.MODEL} if action.destination else {}
    )
    standing, seen = worlds.active(verified), state or worlds.state(at)
    judged = Judged(
        action=whole,
        action_digest=digest_of(Tag.ACTION, whole),
        decision=decide(
            verified,
            whole,
            state=seen,
            facts=facts,
            now=worlds.NOW,
            standing=standing,
            approvals=(),
        ),
        safety=None,
        verified=verified,
        standing=standing,
        state=seen,
        now=worlds.NOW,
        ticket=EVIDENCE,
    )
    return marked(decision_entry(judged, influences), marks)


def refused(said: bytes | str, /, *, marks: Any = None, **sealed: Any) -> Entry:
    """Return the record of a plan that was not normalized."""
    data = said if isinstance(said, bytes) else said.encode()
    entry = refusal_entry(MalformedError("expected a bound tool", where="plan"), worlds.START_MS)
    values = {**entry.sealed, "plan": b64(data), "dialect": "auto", **sealed}
    kept = {name: value for name, value in values.items() if value is not None}
    return marked(msgspec.structs.replace(entry, sealed=kept), marks)


def marked(entry: Entry, marks: dict[str, Any] | None = None) -> Entry:
    """Return the entry with what every record of a shadow run says."""
    opened = {**entry.open, **(SHADOW if marks is None else marks)}
    return msgspec.structs.replace(entry, open=opened)


def call(tool: str, **arguments: Any) -> str:
    """Return a plan of one call, in the plainest dialect."""
    return json.dumps({"tool": tool, "arguments": arguments})


def write(path: Path, entries: Iterable[Entry], *, first: Entry | None = None) -> Path:
    """Write a log into a new store."""
    store = open_store(path)
    for entry in (first or genesis(), *entries):
        store.run(lambda turn, e=entry: append(turn, e, salts=os.urandom(16 * len(e.sealed))))
    store.close()
    return path


def rows(folder: Path, *entries: Entry, first: Entry | None = None) -> list[Row]:
    """Return the rows of a log that was written and read back."""
    return list(read_rows(write(folder / "shadow.db", entries, first=first)))


def in_memory(*entries: Entry, first: Entry | None = None) -> tuple[Row, ...]:
    """Return the rows of a log that no disk has seen."""
    store = MemoryStore()
    for entry in (first or genesis(), *entries):
        store.run(lambda turn, e=entry: append(turn, e, salts=os.urandom(16 * len(e.sealed))))
    return tuple(store.rows())


def exported(found: Iterable[Row]) -> str:
    """Return rows as JSON Lines."""
    return "".join(
        json.dumps(
            {
                "seq": row.seq,
                "record": row.record.decode(),
                "sealed": row.sealed.decode(),
                "link": b64(row.link),
            }
        )
        + "\n"
        for row in found
    )
