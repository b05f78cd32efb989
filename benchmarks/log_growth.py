# SPDX-License-Identifier: Apache-2.0
"""One log that grows to many records: what an append costs then, memory, and verifying it.

Records are those of a decision and its outcome in turn, through the ledger of a real gate into the
store, many in a commit, with the notary looking after each commit as the gate's loop has it look.
Only what is timed is one record in one commit. Everything runs in a process of its own, so that
memory is the log's and nobody else's; where several verify together, that of the one that reads.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from itertools import islice, pairwise
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from time import perf_counter, perf_counter_ns
from typing import Any, NamedTuple

import msgspec

from authguard_r.anchoring.checkpoint_scheduler import CheckpointScheduler
from authguard_r.anchoring.sealing.policy import Reader, SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import hold_policy
from authguard_r.audit.checkpoint import Checkpoint, origin_of, read_checkpoint
from authguard_r.audit.parallel import usable_jobs, verify_in_pieces
from authguard_r.audit.record import Entry, LogRow
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.audit.verify import Anchor, of_checkpoint, verify_rows
from authguard_r.core.standing import Outcome, Spend
from authguard_r.enforcement.report import decision_entry, outcome_entry
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.store.transactions import Transaction
from durable import MID, row_size
from measure import Effort, Subject, Timing, interleave, timed
from scene import Bench, bench, long_mission, scenarios
from yardsticks import BareInsert

#: The log that a long one is held against.
SHORT = 10_000
#: Records of one commit while a log is only made longer.
BATCH = 256
#: Parts that reading a whole log is timed in; sizes that memory is looked at.
PARTS, LOOKS = 10, 20
_PAGE = os.sysconf("SC_PAGESIZE")


class Plan(NamedTuple):
    """How long a log, and how often.

    Args:
        records: the length that the short log is compared with.
        append: appends to the short log, the long one, and beside them.
        verify: verifications of each size.
        sizes: records that are verified out of memory, the short ones first.
        together: verifications from the disk, by several processes.
        most: records that these read at most.
    """

    records: int
    append: Effort
    verify: Effort
    sizes: tuple[int, int]
    together: Effort
    most: int


class Writer:
    """A gate over a store, its notary, and the entries of one action.

    Args:
        path: of the store, which is made anew.
        readers: for whom fields are sealed; nothing is without any.
    """

    def __init__(self, path: Path, *readers: Reader) -> None:
        store = open_store(path)
        hold_policy(store, SealingPolicy(readers=readers))
        self.held: Bench = bench(store)
        self.ledger = self.held.gate.ledger
        signer = folder_signer(scenarios.trust_folder(), gate_name(scenarios.RID))
        self.notary = CheckpointScheduler(self.ledger, robot=scenarios.RID, signer=signer)
        self.held.gate.management.activate(long_mission(MID))
        (step,), evidence = self.held.steps()
        self.held.take_in()
        judged = self.held.propose(step, evidence).judged
        used = Spend(motion_ms=1_000)
        self.decision = decision_entry(judged, ())
        self.outcome = outcome_entry(judged, Outcome.SUCCEEDED, (), used=used, now=judged.now)

    @property
    def size(self) -> int:
        """How many records there are."""
        return self.ledger.peek(lambda turn: turn.head())[0]

    def append(self) -> None:
        """Append one decision's record; on disk on return."""
        self.ledger.run(lambda act: act.record(self.decision))

    def look(self) -> None:
        """Make a checkpoint if one is due."""
        if self.notary.tick() is not None:
            raise RuntimeError("nothing outside of a benchmark's store should doubt it")

    def add(self, count: int) -> None:
        """Append so many records in one commit."""
        entries = (self.decision, self.outcome)
        pairs: tuple[Entry, ...] = (entries * (count // 2 + 1))[:count]

        def job(act: Transaction) -> None:
            for entry in pairs:
                act.record(entry)

        self.ledger.run(job)

    def fill(self, records: int) -> None:
        """Append until there are so many records, looking after each commit."""
        while (missing := records - self.size) > 0:
            self.add(min(BATCH, missing))
            self.look()

    def close(self) -> Anchor:
        """Close the store; return what its last checkpoint says."""
        self.notary.make()
        note = str(self.notary.shown()["notes"][0])  # type: ignore[index]
        self.held.gate.close()
        return of_checkpoint(read_checkpoint(note.partition("\n\n")[0] + "\n", where="checkpoint"))


class Grown(NamedTuple):
    """What was measured of the log that grew: timings, and everything else in plain data."""

    timings: dict[str, Timing]
    told: dict[str, Any]


def grown(folder: Path, plan: Plan) -> Grown:
    """Return what was measured, in a process of its own.

    Args:
        folder: on the disk that is measured.
        plan: how long, and how often.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_grown, folder, plan).result()


def bare(rows: Iterable[LogRow], parse: Callable[[bytes], object]) -> None:
    """Hash every byte once and parse it once: the least that reading a log could be."""
    for row in rows:
        sha256(row.record).digest()
        sha256(row.sealed).digest()
        parse(row.record)
        parse(row.sealed)


def anchor_of(rows: Iterable[LogRow]) -> Anchor:
    """Return what an authentic checkpoint of exactly these rows says."""
    links = [row.link for row in rows]
    root = Frontier().grown(map(leaf_hash, links)).root()
    made = Checkpoint(origin=origin_of(scenarios.RID), size=len(links), root=root, chain=links[-1])
    return of_checkpoint(made)


def _grown(folder: Path, plan: Plan) -> Grown:
    path = folder / "grown.db"
    size = row_size(folder)
    short, long = Writer(folder / "short.db"), Writer(path)
    short.fill(SHORT)
    filled = _filled(long, plan.records)
    insert = BareInsert(folder / "log-bare.db", size)
    subjects = [
        Subject("log.append.short", timed(short.append, before=short.look)),
        Subject("log.append.long", timed(long.append, before=long.look)),
        Subject("insert.bare.log", timed(insert.insert)),
    ]
    timings = interleave(subjects, plan.append)
    insert.close()
    short.close()
    anchor = long.close()
    whole = _whole(path, anchor)
    together = _together(path, plan)
    resident = (
        *filled["rss_bytes"],
        *whole["rss_verify_bytes"],
        *together.told["rss_together_bytes"],
    )
    most = max(*resident, _resident())
    timings |= together.timings
    timings |= _verified(path, plan)
    told = {
        "records": plan.records,
        "short": SHORT,
        "sizes": list(plan.sizes),
        **filled,
        "rss_most_bytes": most,
        "rss_growth_bytes": most - filled["rss_start_bytes"],
        "file_bytes": path.stat().st_size,
        **whole,
        **together.told,
    }
    return Grown(timings, told)


def _filled(long: Writer, records: int) -> dict[str, Any]:
    """Fill the long log; memory counts from the short log's length on."""
    start = perf_counter()
    long.fill(min(SHORT, records))
    begun = _resident()
    samples = [begun]
    for look in range(1, LOOKS + 1):
        long.fill(max(SHORT, records * look // LOOKS))
        samples.append(_resident())
    return {
        "fill_s": round(perf_counter() - start, 3),
        "rss_start_bytes": begun,
        "rss_bytes": samples,
    }


def _whole(path: Path, anchor: Anchor) -> dict[str, Any]:
    """Verify the whole log from the disk once, part by part of the same length timed."""
    marks: list[int] = []
    resident: list[int] = []
    part = anchor.size // PARTS

    def rows() -> Iterator[LogRow]:
        for row in read_rows(path):
            if row.seq % part == 0:
                marks.append(perf_counter_ns())
                resident.append(_resident())
            yield row

    found = verify_rows(rows(), anchors=(anchor,))
    marks.append(perf_counter_ns())  # the last part, or what is left of it and not used
    spent = [(after - before) / part for before, after in pairwise(marks[: PARTS + 1])]
    return {
        "whole": found.whole and found.anchored_size == anchor.size,
        "verified": found.size,
        "verify_ns_a_record": spent,
        "later_over_earlier": median(spent[PARTS // 2 :]) / median(spent[: PARTS // 2]),
        "rss_verify_bytes": resident,
    }


def _together(path: Path, plan: Plan) -> Grown:
    """Time verifying from the disk as the command does it, beside the bare loop of one process."""
    count = min(plan.most, plan.records)
    jobs = usable_jobs()
    anchor = anchor_of(_first(path, count))
    resident: list[int] = []

    def rows() -> Iterator[LogRow]:
        for row in _first(path, count):
            if row.seq % (count // LOOKS) == 0:
                resident.append(_resident())
            yield row

    def verified() -> None:
        found = verify_in_pieces(rows(), jobs=jobs, anchors=(anchor,))
        if not found.whole or found.anchored_size != count:
            raise RuntimeError("a log that nobody touched does not verify")

    subjects = [
        Subject("log.verify.together", _each(count, verified)),
        Subject(
            "log.bare.disk", _each(count, lambda: bare(_first(path, count), msgspec.json.decode))
        ),
    ]
    timings = interleave(subjects, plan.together)
    told = {"jobs": jobs, "together": count, "rss_together_bytes": resident}
    return Grown(timings, told)


def _first(path: Path, count: int) -> Iterator[LogRow]:
    return islice(read_rows(path), count)


def _verified(path: Path, plan: Plan) -> dict[str, Timing]:
    """Time verifying beside the bare loop, both out of memory; the times are for one record."""
    rows = list(islice(read_rows(path), max(plan.sizes)))
    subjects, some = [], rows
    for name, size in zip(("short", "long"), plan.sizes, strict=True):
        some = rows[:size]
        anchor = anchor_of(some)
        if not verify_rows(some, anchors=(anchor,)).whole:
            raise RuntimeError("a log that nobody touched does not verify")
        subjects += [
            Subject(f"log.verify.{name}", _each(size, _verify(some, anchor))),
            Subject(f"log.bare.{name}", _each(size, _bare(some, msgspec.json.decode))),
        ]
    subjects.append(Subject("log.bare_json.long", _each(len(some), _bare(some, json.loads))))
    return interleave(subjects, plan.verify)


def _verify(rows: list[LogRow], anchor: Anchor) -> Callable[[], object]:
    return lambda: verify_rows(rows, anchors=(anchor,))


def _bare(rows: list[LogRow], parse: Callable[[bytes], object]) -> Callable[[], object]:
    return lambda: bare(rows, parse)


def _each(count: int, act: Callable[[], object]) -> Callable[[], int]:
    """Return what does it and returns its time divided by so many."""
    once = timed(act)
    return lambda: once() // count


def _resident() -> int:
    """Return how much memory this process holds now, in bytes."""
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * _PAGE
