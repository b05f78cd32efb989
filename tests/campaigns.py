# SPDX-License-Identifier: Apache-2.0
"""Campaigns as records, without running any: trials whose fields agree with each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from missionpair.campaign.log import LogWriter
from missionpair.measures import Measured, measure
from missionpair.records import SCHEMA, Campaign, Named, Round, Timing, Trial

HAIKU = Named("haiku", parameters={"model": "claude-haiku-4-5-20251001"})
QWEN = Named("qwen", parameters={"model": "qwen2.5:7b"})
GRADED = Named("graded", simulated=True, parameters={"susceptibility": 0.4})
FIXED, ADAPTIVE = Named("fixed"), Named("adaptive")
REACHED = Round(
    reply="{}",
    executable=True,
    safe=True,
    deviation="2/44",
    violated=("OBJECT_OUT_OF_SCOPE",),
    complied=True,
)
KEPT = Round(reply="{}", executable=True, safe=True)

#: The paper's live experiments: how many of ten complied, by category.
PAPER: dict[tuple[str, str], dict[str, int]] = {
    ("haiku", "fixed"): {
        "goal": 0, "capability": 0, "object": 10, "provenance": 0, "area": 0, "parameter": 1,
    },
    ("haiku", "adaptive"): {
        "goal": 1, "capability": 0, "object": 7, "provenance": 2, "area": 0, "parameter": 2,
    },
    ("qwen", "fixed"): {
        "goal": 10, "capability": 0, "object": 10, "provenance": 10, "area": 10, "parameter": 10,
    },
    ("qwen", "adaptive"): {
        "goal": 6, "capability": 0, "object": 2, "provenance": 10, "area": 8, "parameter": 10,
    },
}  # fmt: skip


def campaign(**changes: Any) -> Campaign:
    """Return a campaign's first line with some fields replaced."""
    made = Campaign(
        schema=SCHEMA,
        suite="live",
        suite_version=1,
        suite_digest="digest-of-live",
        pairs=60,
        planner=GRADED,
        attacker=FIXED,
        access="black",
        defenses=(Named("both"),),
        seed=0,
        seeds=1,
        rounds=3,
        turns=1,
        kinds=("attack", "benign", "update"),
        weights=(1000, 500, 500, 500, 500),
        trials=60,
        version="0",
    )
    return replace(made, **changes)


def kept(n: int = 0, **changes: Any) -> Trial:
    """Return an attack in which the planner kept to its mission, with some fields replaced."""
    made = Trial(
        n=n,
        pair=f"pair-{n}",
        kind="attack",
        defense="both",
        seed=n,
        domain="hospital",
        categories=("goal",),
        family="destination-change",
        channels=("sign",),
        rounds=(KEPT,),
        complied=False,
        instead="authorized",
        blocked=None,
        by="",
        reasons=(),
        planned=1,
        executed=1,
        unauthorized=0,
        hijacked=False,
        violated=(),
        deviation="0",
        completed=False,
        prompts=0,
        stalled_ms=0,
        false_stop=False,
        error="",
        tokens=(0, 0),
        cost_microusd=0,
        timing=Timing(planner=100, normalize=20, decide=300, defense=330, total=900),
    )
    return replace(made, **changes)


def blocked(n: int = 0, **changes: Any) -> Trial:
    """Return an attack that reached the defense and went no further."""
    given: dict[str, Any] = {
        "rounds": (REACHED,),
        "complied": True,
        "instead": "",
        "blocked": True,
        "by": "authorization",
        "reasons": ("OBJECT_OUT_OF_SCOPE",),
        "executed": 0,
    }
    return kept(n, **(given | changes))


def hijacked(n: int = 0, **changes: Any) -> Trial:
    """Return an attack that was carried out."""
    given: dict[str, Any] = {
        "blocked": False,
        "by": "",
        "reasons": (),
        "executed": 1,
        "unauthorized": 1,
        "hijacked": True,
        "violated": ("OBJECT_OUT_OF_SCOPE",),
        "deviation": "2/44",
    }
    return blocked(n, **(given | changes))


def benign(n: int = 0, **changes: Any) -> Trial:
    """Return a benign run that came to its end."""
    given: dict[str, Any] = {"kind": "benign", "instead": "", "completed": True}
    return kept(n, **(given | changes))


def numbered(trials: Iterable[Trial]) -> list[Trial]:
    """Return trials numbered as a log numbers them."""
    return [replace(trial, n=number) for number, trial in enumerate(trials)]


def live(planner: Named, attacker: Named, complied: Mapping[str, int]) -> Measured:
    """Return the measures of a live campaign of ten trials a category, as the paper ran them."""
    trials = numbered(
        (blocked if number < count else kept)(categories=(category,))
        for category, count in complied.items()
        for number in range(10)
    )
    made = campaign(planner=planner, attacker=attacker, kinds=("attack",), trials=len(trials))
    return measure(made, trials)


def the_papers() -> Iterator[Measured]:
    """Yield the measures of four campaigns that came out as the paper's."""
    planners, attackers = {"haiku": HAIKU, "qwen": QWEN}, {"fixed": FIXED, "adaptive": ADAPTIVE}
    for (planner, attacker), complied in PAPER.items():
        yield live(planners[planner], attackers[attacker], complied)


def files_of(made: Iterable[tuple[str, Iterable[str]]]) -> dict[str, str]:
    """Return what a writer yields, each file whole."""
    return {name: "".join(content) for name, content in made}


def written(path: Path, made: Campaign, trials: Iterable[Trial]) -> Path:
    """Write a whole log and return its path."""
    with LogWriter(path, made) as log:
        for trial in trials:
            log.add(trial)
        log.end()
    return path
