# SPDX-License-Identifier: Apache-2.0
"""Four clients that offer ten times what the gate can do, beside one that works and one that stops.

Every client is a process of its own and open loop (`offer.py`). The gate runs as on a robot: with
its stop lane, with the symbolic robot and the estimator as processes, in real time. Phases without
and with the flood take turns; a latency counts from when the request was meant to be sent.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from statistics import median
from time import monotonic
from typing import Any, NamedTuple

from measure import Timing, percentile, timing_of
from scene import gate_process
from serving import serving

_OFFER = Path(__file__).resolve().parent / "offer.py"
#: From when every client of a phase has connected to its begin, in seconds.
_LEAD_S = 0.3
#: What the benign client offers, proposals a second.
BENIGN_RATE = 25
#: How often somebody stops, a second.
STOP_RATE = 50
FLOODERS = 4
#: So many times what the gate can do is offered.
OVERLOAD = 10


#: Name of the timing, whose, which.
_TIMED = (
    ("benign", "benign", "decided_us"),
    ("benign.settled", "benign", "settled_us"),
    ("stop", "stops", "stood_us"),
    ("stop.sent", "stops", "sent_us"),
)
_Round = dict[str, Any]


class Load(NamedTuple):
    """How long.

    Args:
        rounds: how often each phase has its turn.
        seconds: of one phase.
        capacity_s: of the closed loop that says what the gate can do.
    """

    rounds: int
    seconds: float
    capacity_s: float


class Overloaded(NamedTuple):
    """What came of it.

    Args:
        timings: of benign work and of stops, alone and flooded; a block is a round.
        p99_ms: of each round.
        told: rates, what became of the flood, what the log grew by.
    """

    timings: dict[str, Timing]
    p99_ms: dict[str, list[float]]
    told: dict[str, Any]


def overload(folder: Path, load: Load, **bounds: Any) -> Overloaded:
    """Return what benign work and stops take alone and under the flood, and what the log became.

    `benign.*` ends with the decision on disk and the robot told, `benign.settled.*` with the
    outcome on disk too; `stop.*` with the robot's own word that it stands. `stop.sent.*` begins
    when the client had its turn on a core, which the flood's processes take as well.
    """
    rounds: dict[str, list[_Round]] = {"alone": [], "flooded": []}
    with serving(folder, "overloaded", robot=True, estimator=True, **bounds) as gate:
        capacity = _capacity(gate, load.capacity_s)
        for _ in range(load.rounds):
            rounds["alone"].append(_round(gate, load.seconds, 0))
            rounds["flooded"].append(_round(gate, load.seconds, capacity * OVERLOAD))
    blocks = {
        f"{name}.{phase}": [[us * 1_000 for us in one[kind][field]] for one in every]
        for name, kind, field in _TIMED
        for phase, every in rounds.items()
    }
    if not all(samples for block in blocks.values() for samples in block):
        raise RuntimeError("in one of the rounds no work was accepted")
    return Overloaded(
        timings={name: timing_of(block) for name, block in blocks.items()},
        p99_ms={
            name: [percentile(samples, 99) / 1e6 for samples in block]
            for name, block in blocks.items()
        },
        told={
            "capacity_per_s": round(capacity),
            "overload": OVERLOAD,
            "benign_per_s": BENIGN_RATE,
            "stops_per_s": STOP_RATE,
            **{phase: _together(every, load.seconds) for phase, every in rounds.items()},
        },
    )


def _capacity(gate: gate_process.RunningGate, seconds: float) -> float:
    """Return how many refused proposals a second four clients get answered, closed loop."""
    said = _offer([_words(gate, "closed", n, 0, seconds) for n in range(FLOODERS)])
    return sum(one["answered"] for one in said) / seconds


def _round(gate: gate_process.RunningGate, seconds: float, flood_rate: float) -> _Round:
    """Run benign work, then stops, each beside the flood; return what each client said."""
    told: dict[str, Any] = {"flood": Counter()}
    for kind, rate in (("benign", BENIGN_RATE), ("stops", STOP_RATE)):
        before = _log(gate)
        words = [_words(gate, kind, 0, rate, seconds)]
        if flood_rate:
            each = flood_rate / FLOODERS
            words += [_words(gate, "flood", n, each, seconds) for n in range(FLOODERS)]
        told[kind], *floods = _offer(words)
        for one in floods:
            told["flood"].update(one)
        told[f"{kind}_log"] = {name: _log(gate)[name] - was for name, was in before.items()}
    return told


def _words(
    gate: gate_process.RunningGate, kind: str, n: int, rate: float, seconds: float
) -> list[str]:
    path = gate.stop_socket if kind == "stops" else gate.socket
    return [kind, str(path), f"{kind}-{n}", str(rate), str(seconds)]


def _offer(words: list[list[str]]) -> list[dict[str, Any]]:
    """Let every client begin at the same instant; return what each of them said."""
    started = [
        subprocess.Popen(
            [sys.executable, str(_OFFER), *one],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for one in words
    ]
    try:
        for process in started:
            _first_line(process)
        at = f"{monotonic() + _LEAD_S}\n"
        for process in started:
            _say(process, at)
        return [json.loads(process.communicate()[0]) for process in started]
    finally:
        for process in started:
            process.kill()
            process.wait()


def _first_line(process: subprocess.Popen[str]) -> None:
    if process.stdout is None or not process.stdout.readline():
        raise RuntimeError("a client ended before it began")


def _say(process: subprocess.Popen[str], text: str) -> None:
    if process.stdin is not None:
        process.stdin.write(text)
        process.stdin.flush()


def _log(gate: gate_process.RunningGate) -> dict[str, int]:
    """Return how much the gate has written so far."""
    with gate.client(gate_process.ClientRole.AUDITOR, "looks") as auditor:
        records = auditor.status()["log"]["size"]
    lines = dict(line.split(": ") for line in Path(f"/proc/{gate.pid}/io").read_text().splitlines())
    return {"records": records, "written_bytes": int(lines["write_bytes"])}


def _together(rounds: list[_Round], seconds: float) -> dict[str, Any]:
    """Return what else is to be known of one kind of rounds."""
    flood: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    for one in rounds:
        flood.update(one["flood"])
        failed.update(one["benign"]["failed"])
    return {
        "flood_per_s": {name: round(n / len(rounds) / seconds / 2) for name, n in flood.items()},
        "log_per_s": {
            name: round(median(one["benign_log"][name] for one in rounds) / seconds)
            for name in ("records", "written_bytes")
        },
        "benign_failed": dict(failed),
        "stops_failed": sum(one["stops"]["failed"] for one in rounds),
        "late_p99_ms": {
            kind: percentile([us for one in rounds for us in one[kind]["late_us"]], 99) / 1e3
            for kind in ("benign", "stops")
        },
    }
