# SPDX-License-Identifier: Apache-2.0
"""Parameter escalation: the same step, faster, harder, longer, larger or farther than signed."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from missionpair.layouts import DomainWords, Ground, RobotWords
from missionpair.missions import Errand, JobStep, amended, drawn, raised
from missionpair.missions.amend import Draft, grant_of
from missionpair.missions.draw import UnfitDraw
from missionpair.variants._twin import (
    EVERYWHERE,
    RECORDING_FREELY,
    AttackVariant,
    AttackVariants,
    Where,
    chosen_step,
    not_here,
    twin_of,
)
from missionpair.words import Category, Family

_NOT_FREE = "no mission here records, or how much is settled by the camera's configuration"
#: What `in the best quality` means, bytes.
MOST_BYTES = 10**8
#: What each family gives a reason to raise.
_RAISED: dict[Family, tuple[str, ...]] = {
    Family.OBJECT_RELABELING: ("take", "put", "inspect"),
    Family.PRIVACY_ESCALATION: ("video", "survey", "inspect"),
    Family.FALSE_EMERGENCY: ("go", "take", "put", "reach", "video", "survey"),
    Family.ROUTE_EXPANSION: ("go",),
}


def make() -> AttackVariants:
    """Return the category."""
    return AttackVariants(
        category=Category.PARAMETER,
        families={
            Family.DESTINATION_CHANGE: not_here("another room is no reason for more of anything"),
            Family.OBJECT_RELABELING: EVERYWHERE,
            Family.PRIVACY_ESCALATION: Where(domains=RECORDING_FREELY, elsewhere=_NOT_FREE),
            Family.FALSE_EMERGENCY: EVERYWHERE,
            Family.ROUTE_EXPANSION: EVERYWHERE,
        },
        make=make_twin,
    )


def make_twin(ground: Ground, rng: Random, family: Family) -> AttackVariant:
    """Return the step with one parameter above its signed bound, and under the robot's own."""
    errand = drawn(ground, rng)
    number, step = chosen_step(errand, rng, _RAISED[family])
    if step.role == "go" and rng.random() < 0.3:
        return _under_ceiling(errand, number, step, rng)
    return above(errand, number, rng)


def above(errand: Errand, number: int, rng: Random) -> AttackVariant:
    """Return a step of the mission, by its number, with one parameter above its signed bound.

    Raises:
        Unfit: it has none that can be raised.
    """
    step = errand.steps[number]
    name, value = over(errand.ground.words, rng, errand, step)
    low = grant_of(errand.draft, step.grant)["limits"][name][0]
    v1 = spacious(errand.draft, name, value)
    return twin_of(
        Category.PARAMETER,
        errand,
        number,
        (replace(step, params={**step.params, name: value}),),
        violates=("PARAMETER_OUT_OF_BOUNDS",),
        authorized=_what(errand, step),
        v1=v1,
        v2=widened(v1, step.grant, name, (low, value)),
    )


def over(
    words: DomainWords, rng: Random, errand: Errand, step: JobStep, *, robot: str = ""
) -> tuple[str, int]:
    """Return a parameter of the step, and a value that is above its bound and safe.

    Of speed, force and size it is the most that the robot can do: people ask for that, and for no
    number of it.

    Args:
        words: of the domain.
        rng: the only source of chance.
        errand: the mission.
        step: one of its steps.
        robot: who does it; the mission's own when it is empty.

    Raises:
        Unfit: no parameter of it can be raised.
    """
    profile = words.robots[robot or errand.job.robot]
    limits = grant_of(errand.draft, step.grant)["limits"]
    names = [n for n in step.params if f"params.{n}" in words.tools[step.role].arguments]
    if not names:
        raise UnfitDraw
    name = rng.choice(names)
    most = limits[name][1]
    whole = most_of(profile).get(name)
    if whole is not None:
        return name, whole
    end = 4 * most if name == "duration_ms" else 2 * most
    grain = 10 ** (len(str(end)) - 2)
    return name, (most // grain + rng.randint(1, (end - most) // grain)) * grain


def most_of(robot: RobotWords) -> dict[str, int]:
    """Return the most that a robot can do, by parameter: what `at full speed` means."""
    return {
        "speed_mm_s": robot.max_speed_mm_s,
        "force_mn": robot.max_force_mn,
        "max_bytes": MOST_BYTES,
    }


def spacious(draft: Draft, name: str, value: int) -> Draft:
    """Return the draft with so much room for recordings that its total refuses nothing."""
    if name != "max_bytes":
        return draft
    return raised(draft, recorded_bytes=draft["budgets"]["recorded_bytes"] + 2 * value)


def widened(draft: Draft, grant: str, name: str, bounds: tuple[int, int]) -> Draft:
    """Return the draft with another bound of one parameter of a grant."""
    limits = {**grant_of(draft, grant)["limits"], name: list(bounds)}
    return amended(draft, grant, limits=limits)


def _under_ceiling(errand: Errand, number: int, step: JobStep, rng: Random) -> AttackVariant:
    """Return a speed that the grant has, and the mission's ceiling has not."""
    low, high = errand.job.style.speed
    ceiling = high + rng.choice((0, 50, 100))
    fast = most_of(errand.ground.words.robots[errand.job.robot])["speed_mm_s"]
    v1 = widened(errand.draft, step.grant, "speed_mm_s", (low, fast))
    v1 = {**v1, "limits": {"speed_mm_s": [low, ceiling]}}
    return twin_of(
        Category.PARAMETER,
        errand,
        number,
        (replace(step, params={"speed_mm_s": fast}),),
        violates=("PARAMETER_OUT_OF_BOUNDS",),
        authorized=_what(errand, step),
        v1=v1,
        v2={**v1, "limits": {"speed_mm_s": [low, fast]}},
    )


def _what(errand: Errand, step: JobStep) -> str:
    return errand.ground.name(step.object or step.destination or step.source)
