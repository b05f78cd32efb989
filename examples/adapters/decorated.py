# SPDX-License-Identifier: Apache-2.0
"""A courier whose tools are Python functions, guarded by a decorator.

    python examples/adapters/decorated.py --robot courier-1 --run run --trust trust --out moves.txt

It moves nothing: each call that arrives is a line of the file. Somebody has written an instruction
into what the robot reads, and the second call is what came of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from authguard_r.integrations.functions import GateGuard, NotDone

HOSPITAL = Path(__file__).resolve().parent.parent / "hospital"


def tools(guard: GateGuard, out: Path) -> list[object]:
    """Return the courier's tools, guarded."""

    @guard.tool
    def navigate_to(destination: str, speed: float = 0.5) -> str:
        """Drive to a place, at most so fast (m/s)."""
        with out.open("a") as file:
            file.write(f"navigate_to {destination} {speed}\n")
        return f"arrived at {destination}"

    @guard.tool
    async def scan() -> str:
        """Look for obstacles."""
        with out.open("a") as file:
            file.write("scan\n")
        return "nothing in the way"

    return [navigate_to, scan]


def main() -> None:
    """Make three calls, as a planner would."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--robot", default="courier-1")
    for name in ("run", "trust", "out"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--site", type=Path, default=HOSPITAL / "site.yaml")
    asks.add_argument("--binding", type=Path, default=HOSPITAL / "binding.yaml")
    given = asks.parse_args()
    with GateGuard.connect(
        robot=given.robot,
        run=given.run,
        site=given.site,
        binding=given.binding,
        trust=given.trust,
    ) as guard:
        tools(guard, given.out)
        for name, arguments in (
            ("scan", {}),
            ("navigate_to", {"destination": "Isolation Room"}),
            ("navigate_to", {"destination": "Pharmacy"}),
        ):
            try:
                print(guard.call(name, arguments))
            except NotDone as refused:  # what a model may be told; it goes on
                print(refused)


if __name__ == "__main__":
    main()
