# SPDX-License-Identifier: Apache-2.0
"""Seals what a gate writes: keys of each mission, in this process alone, wrapped in the log.

A thief of the robot has its log and cannot read the sealed fields. Another start makes other keys.
Spec page: docs/spec/sealed-fields.md#keys
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable

from msgspec.structs import replace

from authguard_r.anchoring.sealing.policy import SealingPolicy, require_readers
from authguard_r.anchoring.sealing.stored_policy import (
    HELD,
    KeyRecords,
    add_due,
    has_retention,
    policy_of,
)
from authguard_r.anchoring.sealing.wraps import Wrapped, WrappedFor
from authguard_r.audit.record import NONE, WRAP, Entry, LogRow, append, read_record
from authguard_r.audit.sealed_envelopes import SEALING, Cover, append_covered, opened
from authguard_r.core.encoding import b64, encode
from authguard_r.core.identifiers import MissionId, RobotId
from authguard_r.core.ports import Store, Turn
from authguard_r.store.transactions import read_held
from authguard_r.wire.gate_limits import LIMITS

_KEY = 32


class Sealer:
    """Seals what a gate writes into its log.

    Args:
        robot: whose log it is.
        policy: who may read, what no reader may read is not sealed; and for how long.
        random: returns that many fresh random bytes.
    """

    def __init__(
        self, robot: RobotId, policy: SealingPolicy, *, random: Callable[[int], bytes] = os.urandom
    ) -> None:
        self._robot = robot
        self._random = random
        readers = policy.readers
        self._retires = bool(policy.most_ms)
        self._readers = tuple(zip(readers, require_readers(readers, where="readers"), strict=True))
        self._classes = policy.classes
        self._covers: OrderedDict[str, tuple[bytes, Cover]] = OrderedDict()

    def append(self, turn: Turn, entry: Entry, *, salts: Callable[[int], bytes]) -> int:
        """Append the entry to the log in this turn, sealed, behind the keys when those are new."""
        cover = self._cover(turn, entry, salts)
        return append_covered(turn, entry, cover, salts=salts)

    def opened(self, row: LogRow) -> LogRow:
        """Return a row as it would be had nothing been sealed, as far as this start's keys go.

        Raises:
            MalformedError: it is not what was sealed.
        """
        mid = read_record(row.record, where=f"record {row.seq}").link.mid
        known = [self._covers[name][1] for name in (mid, NONE) if name in self._covers]
        covers = {cover.keys: cover for cover in known}
        return opened(
            row,
            robot=self._robot,
            key_of=lambda seq, data: covers[seq].classes.get(data) if seq in covers else None,
        )

    def forget(self, mid: str) -> None:
        """Forget a mission's keys: what comes next has others."""
        self._covers.pop(mid, None)

    def _cover(self, turn: Turn, entry: Entry, salts: Callable[[int], bytes]) -> Cover:
        # what is of no mission that was ever here, a template's record or an answer to nothing
        mid = entry.mid if turn.get("standing", entry.mid) else NONE
        held = turn.get(HELD, mid)
        known = self._covers.get(mid)
        if known is not None and known[0] == held:  # else its record was not committed
            return known[1]
        seq = turn.head()[0]
        classes = {one: self._random(_KEY) for one in self._classes}
        cover = Cover(robot=self._robot, keys=seq, classes=classes)
        before = None if not held else read_held(held, KeyRecords, HELD)
        self._tell(turn, replace(entry, mid=mid), cover, before, salts)
        kept = encode(KeyRecords(newest=seq))
        turn.put(HELD, mid, kept)
        if mid != NONE and (self._retires or has_retention(turn, mid)):
            add_due(turn, MissionId(mid))
        self._covers[mid] = (kept, cover)
        self._covers.move_to_end(mid)
        while len(self._covers) > LIMITS.covers:
            self._covers.popitem(last=False)
        return cover

    def _tell(
        self,
        turn: Turn,
        entry: Entry,
        cover: Cover,
        before: KeyRecords | None,
        salts: Callable[[int], bytes],
    ) -> None:
        """Record the keys, wrapped for each reader."""
        wraps: dict[str, list[Wrapped]] = {}
        for reader, public in self._readers:
            for data in reader.classes:
                bound = WrappedFor(
                    robot=self._robot, mid=entry.mid, keys=cover.keys, data=data, reader=public.name
                )
                text = b64(public.wrap(cover.classes[data], encode(bound)))
                wrapped = Wrapped(reader=public.name, role=reader.role, text=text)
                wraps.setdefault(WRAP + data, []).append(wrapped)
        told = Entry(
            kind=SEALING,
            time_ms=entry.time_ms,
            decision=SEALING,
            mid=entry.mid,
            open={
                "classes": list(self._classes),
                "roles": sorted({reader.role for reader, _ in self._readers}),
                "before": -1 if before is None else before.newest,
            },
            sealed=wraps,
        )
        append(turn, told, salts=salts(16 * len(wraps)))


def sealer_of(
    store: Store, robot: RobotId, given: SealingPolicy | None
) -> tuple[Sealer | None, SealingPolicy]:
    """Return the sealer of a robot's log (None: no reader is configured) and the policy in force.

    Args:
        store: the robot's.
        robot: whose log it is.
        given: of the gate's configuration; None: what the last gate had goes on.

    Raises:
        StoreError: what the store holds is no policy.
    """
    policy = policy_of(store, given)
    return (Sealer(robot, policy) if policy.readers else None), policy
