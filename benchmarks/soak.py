# SPDX-License-Identifier: Apache-2.0
"""A day's work at one action a second, in simulated time, through the gate's own process.

Every action stands still for a second of the symbolic robot inside the gate: the lease is looked
at ten times, twenty snapshots are signed by the estimator, those that are asked for are verified,
and decision and outcome are two commits. The log's growth is held to what its first thousand
actions foretell, memory to what the gate had when its bounded caches were full.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

from authguard_r.audit.record import LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.messages import Kind
from line import SECOND, Line
from scene import gate_process
from serving import serving

#: Actions that the growth of the log is foretold from.
FORETELL = 1_000
#: Actions after which every bounded cache of the gate is full: it remembers 1,024 answers.
WARM_UP = 1_200


def soak(folder: Path, actions: int) -> dict[str, Any]:
    """Return memory, log and time after so many seconds of simulated work.

    Args:
        folder: on the disk that is measured.
        actions: one a second of simulated time.
    """
    step = max(100, min(1_000, actions // 20))
    samples: list[dict[str, Any]] = []
    with serving(folder, "soaked", simulate=True) as gate:
        line = Line(gate.socket, "soak")
        start = perf_counter()
        samples.append(_sample(gate, 0, start))
        for number in range(1, actions + 1):
            _carry_out(line)
            if number % step == 0 or number in {FORETELL, WARM_UP, actions}:
                samples.append(_sample(gate, number, start))
        line.close()
        with gate.client(gate_process.ClientRole.AUDITOR, "looks") as auditor:
            simulated_s = auditor.status()["uptime_ms"] / 1_000
        gate.stop_process("gate")
        log = _log(gate.store, actions)
    return {
        "actions": actions,
        "simulated_s": simulated_s,
        "took_s": samples[-1]["took_s"],
        **_memory(samples, actions),
        **log,
        "samples": samples,
    }


def _carry_out(line: Line) -> None:
    """Have one action carried out; raise when it was not."""
    line.socket.sendall(line.proposal(SECOND))
    while True:
        kind, _, body = line.next()
        if kind == Kind.EVENT:
            continue
        if kind != Kind.REPLY or b'"succeeded"' not in body:
            raise RuntimeError(f"an action was not carried out: {body!r}")
        return


def _sample(gate: gate_process.RunningGate, actions: int, start: float) -> dict[str, Any]:
    beside = gate.store.with_name(f"{gate.store.name}-wal")
    return {
        "actions": actions,
        "took_s": round(perf_counter() - start, 3),
        "rss_kib": gate.resident_kib(),
        "file_bytes": gate.store.stat().st_size + beside.stat().st_size,
    }


def _memory(samples: list[dict[str, Any]], actions: int) -> dict[str, Any]:
    """Return how memory grew after the warm-up, as a whole and for an action."""
    warm = next(one for one in samples if one["actions"] >= min(WARM_UP, actions // 2))
    last = samples[-1]
    grown = last["rss_kib"] - warm["rss_kib"]
    return {
        "rss_start_mb": samples[0]["rss_kib"] / 1_024,
        "rss_warm_mb": warm["rss_kib"] / 1_024,
        "rss_end_mb": last["rss_kib"] / 1_024,
        "rss_most_mb": max(sample["rss_kib"] for sample in samples) / 1_024,
        "rss_growth_mb": grown / 1_024,
        "rss_growth_bytes_an_action": grown * 1_024 / (last["actions"] - warm["actions"]),
    }


def _log(path: Path, actions: int) -> dict[str, Any]:
    """Return whether the log is whole, and its size beside what its beginning foretold."""
    rows = _Rows(read_rows(path))
    found = verify_rows(rows, terminal=None)
    ahead = min(FORETELL, actions // 2)
    foretold = rows.after[0] + (rows.after[ahead] - rows.after[0]) / ahead * actions
    return {
        "whole": found.whole,
        "records": found.size,
        "foretold_from": ahead,
        "log_bytes": rows.bytes,
        "log_bytes_an_action": (rows.bytes - rows.after[0]) / actions,
        "log_foretold_bytes": foretold,
        "log_error_percent": abs(rows.bytes - foretold) / foretold * 100,
        "carried_out": len(rows.after) - 1,
        "file_bytes_an_action": path.stat().st_size / actions,
    }


class _Rows:
    """The rows of a log, and how many bytes they were after each outcome."""

    def __init__(self, rows: Iterator[LogRow]) -> None:
        self._rows = rows
        self.bytes = 0
        self.after: list[int] = []

    def __iter__(self) -> Iterator[LogRow]:
        for row in self._rows:
            if not self.after and b'"kind":"decision"' in row.record:
                self.after.append(self.bytes)
            self.bytes += len(row.record) + len(row.sealed) + len(row.link)
            if b'"kind":"outcome"' in row.record:
                self.after.append(self.bytes)
            yield row
