# SPDX-License-Identifier: Apache-2.0
"""`python benchmarks/stop_faults.py`: how far a robot goes when a stop meets a fault.

Real processes: gate, stop process, symbolic robot with brakes, estimator. In each trial the robot
drives at full speed, a fault is put in, and a person stops it right after. Times count from the
stop. Faults take turns. The slow disk needs root: a file system of its own is frozen for a while.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import machine

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests")]

from authguard_r.wire.gate_limits import LIMITS  # noqa: E402
from fixtures.gate_process import until  # noqa: E402
from integration.stop_faults import (  # noqa: E402
    FAULTS,
    Asked,
    disk_frozen,
    leaves_a_stop,
    serves,
)
from integration.test_gate_bounds import (  # noqa: E402
    BRAKING_MM,
    BRAKING_MS,
    SPEED_MM_S,
    Yard,
    mule_folder,
    mule_gate,
    now_ms,
)


@contextmanager
def no_client(yard: Yard) -> Iterator[None]:
    """Leave everything as it is: here the client sends its stop, and is gone."""
    assert yard.gate.alive
    yield


GONE = "the client is gone at once"
DISK = "the disk takes nothing"
#: A disk for the store alone, in bytes.
DISK_BYTES = 64 << 20


def trial(yard: Yard, fault: Callable[[Yard], Any], why: str) -> dict[str, Any]:
    """Return how the robot came to stand, and what the person was told."""
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        with fault(yard):
            asked = None if fault is no_client else Asked(yard.gate.run, why)
            begun_ms = now_ms() if asked is None else asked.at_ms
            if asked is None:
                for path in (yard.gate.stop_socket, yard.gate.socket):
                    leaves_a_stop(path, why)
            rest = trail.rest(begun_ms)
        answer = None if asked is None else asked.confirmed().answer
        until(lambda: [r for r in yard.gate.news() if r.sealed.get("why") == why], "the record")
        time.sleep(0.2)  # another record of the same stop would come now
        records = [r for r in yard.gate.news() if r.sealed.get("why") == why]
        walk.planner_dies()
    return {
        "stands_ms": rest.took_ms,
        "way_mm": rest.way_mm,
        "answered_ms": 0 if asked is None else asked.answered_ms - asked.at_ms,
        "confirmed": answer is not None and answer.stopped,
        "told": [] if asked is None else sorted(set(asked.told)),
        "records": len(records),
    }


@contextmanager
def disk() -> Iterator[Path]:
    """Yield a folder on a file system of its own."""
    with TemporaryDirectory(prefix="ag-disk-") as name:
        image, place = Path(name) / "image", Path(name) / "place"
        place.mkdir()
        with image.open("wb") as file:
            file.truncate(DISK_BYTES)
        subprocess.run(["mkfs.ext4", "-q", str(image)], check=True)
        subprocess.run(["mount", "-o", "loop", str(image), str(place)], check=True)
        try:
            yield place
        finally:
            with suppress(subprocess.CalledProcessError):
                subprocess.run(["umount", "--lazy", str(place)], check=True)


@contextmanager
def yards() -> Iterator[dict[str, tuple[Yard, Callable[[Yard], Any]]]]:
    """Yield each fault with a yard to put it into; the disk's own has its store there."""
    with ExitStack() as stack:
        folder = mule_folder()
        yard = Yard(stack.enter_context(mule_gate(folder)), folder / "mission.yaml")
        found: dict[str, tuple[Yard, Callable[[Yard], Any]]] = {
            name: (yard, fault) for name, fault in {**FAULTS, GONE: no_client}.items()
        }
        if os.geteuid() == 0:
            folder = mule_folder()
            gate = mule_gate(folder)
            gate.store = stack.enter_context(disk()) / "robot.db"
            own = Yard(stack.enter_context(gate), folder / "mission.yaml")
            found[DISK] = (own, disk_frozen)
        yield found


def told(samples: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians and worst values of one fault's trials."""
    names = ("stands_ms", "way_mm", "answered_ms")
    values = {name: [sample[name] for sample in samples] for name in names}
    return {
        **{
            name: {"median": statistics.median(found), "worst": max(found)}
            for name, found in values.items()
        },
        "confirmed": sum(sample["confirmed"] for sample in samples),
        "told": sorted({part for sample in samples for part in sample["told"]}),
        "lost": sum(sample["records"] == 0 for sample in samples),
        "twice": sum(sample["records"] > 1 for sample in samples),
    }


def show(found: dict[str, Any], trials: int) -> None:
    """Print the table of the documents: medians, and the worst in brackets."""
    heads = ("fault", "stands after, ms", "way, mm", "answer after, ms", "confirmed")
    heads += ("named as not confirming", "stops lost")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name, one in found.items():
        values = (one[key] for key in ("stands_ms", "way_mm", "answered_ms"))
        cells = [name, *(f"{value['median']:.0f} ({value['worst']:.0f})" for value in values)]
        cells += [f"{one['confirmed']} of {trials}", ", ".join(one["told"]) or "-"]
        print(f"| {' | '.join((*cells, str(one['lost'])))} |")


def main() -> int:
    """Measure, print a table, write what was asked for."""
    asks = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asks.add_argument("--trials", type=int, default=50)
    asks.add_argument("--fault", choices=[*FAULTS, GONE, DISK], help="this one alone")
    asks.add_argument("--json", type=Path)
    given = asks.parse_args()
    samples: dict[str, list[dict[str, Any]]] = {}
    with yards() as found_yards:
        faults = {n: one for n, one in found_yards.items() if given.fault in {None, n}}
        renew_ms = next(iter(faults.values()))[0].gate.config.renew_within_ms
        for number in range(given.trials):
            for name, (yard, fault) in faults.items():
                one = trial(yard, fault, f"{name} {number}")
                samples.setdefault(name, []).append(one)
                print(f"{number + 1}/{given.trials} {name}: {one}", file=sys.stderr, flush=True)
    found = {name: told(kept) for name, kept in samples.items()}
    show(found, given.trials)
    bound_ms = round(LIMITS.stop_within_s * 1_000) + renew_ms
    result = {
        "schema": "authguard-r/stop-faults/1",
        **machine.describe(Path(__file__).parent),
        "trials": given.trials,
        "load": [round(load, 1) for load in os.getloadavg()],
        "speed_mm_s": SPEED_MM_S,
        "braking": {"ms": BRAKING_MS, "mm": BRAKING_MM},
        "bound_ms": bound_ms,
        "faults": found,
    }
    if given.json is not None:
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
