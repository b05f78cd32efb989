# SPDX-License-Identifier: Apache-2.0
"""What waits for the disk: decisions until they are on it, plans, revocation, sizes.

Beside a bare insert on the same disk, one for each decision, in turns. The record of the outcome
comes after the dispatch and is not counted.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter_ns
from typing import Any

from authguard_r.core.encoding import encode
from authguard_r.core.identifiers import Digest
from authguard_r.core.principals import Endorsed, Principal
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import decision_entry
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.normalize import Step, read_plan
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.store.transactions import Transaction
from measure import Effort, Subject, Timing, interleave, timed
from scene import HIJACKED, Bench, bench, command, long_mission, reply, scenarios
from yardsticks import BareInsert

MID = "deliver-often"
LENGTHS = (1, 10, 100)


def turns(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time the decision until it is on disk, beside a bare insert of a row of its size.

    `durable.accept` ends when the controller is called; `durable.refuse` when the refusal is
    returned; `durable.accept_new_state` also verifies a new signed snapshot on the way;
    `turn.accept` is the first one over a store in memory.
    """
    held = bench(open_store(folder / "turns.db"))
    held.gate.management.activate(long_mission(MID))
    (step,), evidence = held.steps()
    (wrong,), wrong_evidence = held.steps(HIJACKED)
    bare = BareInsert(folder / "bare.db", row_size(folder))
    forgetful = bench(MemoryStore())
    forgetful.gate.management.activate(long_mission(MID))
    subjects = [
        Subject("durable.accept", _until_dispatch(held, step, evidence)),
        Subject("insert.bare", timed(bare.insert)),
        Subject("durable.accept_new_state", _until_dispatch(held, step, evidence, fresh=True)),
        Subject(
            "durable.refuse",
            timed(lambda: held.propose(wrong, wrong_evidence), before=held.take_in),
        ),
        Subject("T_L.ledger", _ledger(held, step, evidence)),
        Subject("turn.accept", _until_dispatch(forgetful, step, evidence)),
    ]
    try:
        return interleave(subjects, effort)
    finally:
        bare.close()
        held.gate.close()


def plans(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time whole plans, cold: token verified, plan read, each step decided and on disk.

    The time is divided by the plan's length (`eq:amortized`); outcomes, the simulated pause
    between steps and the estimator's own work are not counted.
    """
    held = bench(open_store(folder / "plans.db"))
    held.gate.management.activate(long_mission(MID))
    bare = BareInsert(folder / "plans-bare.db", row_size(folder))
    timings: dict[str, Timing] = {}
    try:
        for length in LENGTHS:
            calls = max(1, effort.calls // length)
            subjects = [
                Subject(f"plan.{length}", _plan(held, length)),
                Subject(f"insert.bare.{length}", _inserts(bare, length)),
            ]
            timings |= interleave(subjects, Effort(effort.blocks, calls, warm_up=1))
    finally:
        bare.close()
        held.gate.close()
    return timings


def revocations(folder: Path, count: int) -> dict[str, Any]:
    """Revoke an active, kept mission so many times; the very next proposal must be refused.

    Returns:
        Times, and whether each revocation evicted the kept mission: before it a proposal
        verifies no mission, after it the mission's own token has to be verified anew.
    """
    trust = _counting(scenarios.trust_folder())
    held = bench(open_store(folder / "revoked.db"), trust=trust)
    (step,), evidence = held.steps()
    kept, refused, evicted = [], [], []
    revoke_ns, refuse_ns = [], []
    try:
        for number in range(count):
            mid = f"revoked-{number}"
            standing = held.gate.management.activate(long_mission(mid))
            held.take_in()
            before = trust.verifications
            report = held.propose(step, evidence)
            kept.append(report.outcome is Outcome.SUCCEEDED and trust.verifications == before)
            order = command(held, mid, standing.digest, "revoke")
            held.take_in()
            dispatches = held.machine.dispatches
            start = perf_counter_ns()
            held.gate.management.command(order)
            revoked = perf_counter_ns()
            report = held.propose(step, evidence)
            refuse_ns.append(perf_counter_ns() - revoked)
            revoke_ns.append(revoked - start)
            refused.append(
                report.refusal is not None
                and report.refusal.reason is Reason.NO_ACTIVE_MISSION
                and held.machine.dispatches == dispatches
            )
            evicted.append(_verifies_anew(held, trust, standing.digest))
    finally:
        held.gate.close()
    if not (all(kept) and all(refused) and all(evicted)):
        raise RuntimeError("a revoked mission was still kept or obeyed")
    return {
        "count": count,
        "kept_before": all(kept),
        "refused_next": all(refused),
        "evicted": all(evicted),
        "command_p50_us": median(revoke_ns) / 1_000,
        "next_refusal_p50_us": median(refuse_ns) / 1_000,
    }


def sizes(folder: Path) -> dict[str, int]:
    """Return bytes of token and log: raw, compressed, for each decision and for 100 actions."""
    token = scenarios.token()
    path = folder / "sizes.db"
    _run_actions(folder / "empty.db", 0)
    _run_actions(path, 100)
    rows = [(row, len(row.record) + len(row.sealed) + len(row.link)) for row in read_rows(path)]
    decided = [size for row, size in rows if b'"kind":"decision"' in row.record]
    settled = [size for row, size in rows if b'"kind":"outcome"' in row.record]
    log = b"".join(row.record + row.sealed + row.link for row, _ in rows)
    return {
        "token_bytes": len(token),
        "token_zlib_bytes": len(zlib.compress(token, 9)),
        "mission_payload_bytes": len(encode(scenarios.mission())),
        "decision_record_bytes": round(median(decided)),
        "outcome_record_bytes": round(median(settled)),
        "log_bytes_100_actions": sum(decided) + sum(settled),
        "log_zlib_bytes_100_actions": len(zlib.compress(log, 9)),
        "file_growth_bytes_100_actions": path.stat().st_size - (folder / "empty.db").stat().st_size,
    }


class _Counting(Trust):
    """The trust root, counting what it verifies."""

    verifications = 0

    def verify(self, message: bytes, endorsements: tuple[Endorsed, ...], now: Now) -> Principal:
        self.verifications += 1
        return super().verify(message, endorsements, now)


def _counting(folder: Path) -> _Counting:
    read = read_trust(folder)
    made = _Counting(read.roots, {})
    vars(made).update(vars(read))
    return made


def _verifies_anew(held: Bench, trust: _Counting, digest: Digest) -> bool:
    """True when the mission is not among the kept ones: asking for it verifies a token."""
    before = trust.verifications
    held.gate.ledger.run(lambda act: held.gate.enforcer.inputs.mission(act, digest))
    return trust.verifications == before + 1


def _run_actions(path: Path, count: int) -> None:
    """Leave a closed store with so many accepted actions in it."""
    held = bench(open_store(path))
    held.gate.management.activate(long_mission(MID))
    (step,), evidence = held.steps()
    for _ in range(count):
        held.take_in()
        held.propose(step, evidence)
    held.gate.close()


def _until_dispatch(
    held: Bench, step: Step, evidence: Digest, *, fresh: bool = False
) -> Callable[[], int]:
    """Return what proposes the step; it counts until the controller is called."""
    before = held.machine.look if fresh else held.take_in

    def once() -> int:
        before()
        start = perf_counter_ns()
        report = held.propose(step, evidence)
        if report.outcome is not Outcome.SUCCEEDED:
            raise RuntimeError(f"expected an accepted step, got {report}")
        return held.machine.dispatched_ns - start

    return once


def _ledger(held: Bench, step: Step, evidence: Digest) -> Callable[[], int]:
    """Return what commits one decision's standing and record, with nothing decided."""
    held.take_in()
    judged = held.propose(step, evidence).judged

    def job(act: Transaction) -> int:
        standing = act.standing(judged.verified.mission.mid)
        if standing is not None:
            act.hold(standing)
        return act.record(decision_entry(judged, ()))

    return timed(lambda: held.gate.ledger.run(job), before=held.take_in)


def _plan(held: Bench, length: int) -> Callable[[], int]:
    data = reply(length=length)
    inputs = held.gate.enforcer.inputs

    def once() -> int:
        inputs.forget()
        start = perf_counter_ns()
        plan = read_plan(data, binder=held.binder)
        total = perf_counter_ns() - start
        for step in plan.steps:
            total += _until_dispatch(held, step, plan.evidence)()
        return total // length

    return once


def _inserts(bare: BareInsert, length: int) -> Callable[[], int]:
    """Return what inserts as many rows as a plan has actions; the mean, as a plan's is."""
    once = timed(bare.insert)
    return lambda: sum(once() for _ in range(length)) // length


def row_size(folder: Path) -> tuple[int, int, int]:
    """Return the bytes of an accepted decision's row: record, sealed values, link."""
    path = folder / "row.db"
    if not path.exists():
        _run_actions(path, 20)
    row = [row for row in read_rows(path) if b'"kind":"decision"' in row.record][-1]
    return len(row.record), len(row.sealed), len(row.link)
