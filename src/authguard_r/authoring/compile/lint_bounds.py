# SPDX-License-Identifier: Apache-2.0
"""Lint rules about how much is granted: parameters, time, recordings, what the robot can do."""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.compile.findings import LintFinding, LintScene, error, warning
from authguard_r.authoring.compile.lint_scope import Rule
from authguard_r.authoring.compile.worst import reach
from authguard_r.core.checks.grant import MAX_BYTES
from authguard_r.core.mission import Grant
from authguard_r.core.quantities import to_ms
from authguard_r.enforcement.confirmation import LintCode
from authguard_r.site import formatting
from authguard_r.site.durations import duration
from authguard_r.site.model import ActionModel

#: Types that bear an object's weight.
_LIFTING = frozenset({"drop", "pick", "place", "pour", "put_in", "throw"})


def unbounded_parameters(scene: LintScene) -> Iterator[LintFinding]:
    """A parameter that actions of the type must carry needs bounds to be held to."""
    for number, grant, model in _known(scene):
        bounded = {item.parameter for item in grant.limits}
        for name, parameter in model.params.items():
            if parameter.required and name not in bounded:
                yield error(
                    LintCode.PARAMETER_UNBOUNDED,
                    f"actions[{number}].limits",
                    f"`{grant.id}` has no bounds for `{name}`",
                    f"bound `{name}`: without bounds no action may carry it",
                )


def wide_bounds(scene: LintScene) -> Iterator[LintFinding]:
    """Bounds that leave out nothing were not thought about."""
    for number, grant, model in _known(scene):
        for index, item in enumerate(grant.limits):
            known = model.params.get(item.parameter)
            if known is None or known.low == known.high:
                continue
            if item.low <= known.low and item.high >= known.high:
                yield warning(
                    LintCode.BOUND_WIDE,
                    f"actions[{number}].limits[{index}]",
                    f"`{grant.id}` allows every `{item.parameter}` that there is",
                    "bound it to what the task needs",
                )


def open_retention(scene: LintScene) -> Iterator[LintFinding]:
    """A recording is settled when its size is bounded, counted, and kept for a bounded time."""
    mission, measures = scene.mission, scene.measures
    length = to_ms(mission.expiry, where="expiry") - to_ms(mission.not_before, where="not_before")
    for number, grant, model in _known(scene):
        if not model.records:
            continue
        place = f"actions[{number}]"
        if all(item.parameter != MAX_BYTES for item in grant.limits):
            yield _retention(f"{place}.limits", grant, "has no bound on `max_bytes`", "bound it")
        if mission.budgets.recorded_bytes == 0:
            text = "records under a budget of nothing"
            yield _retention("budgets.recorded_bytes", grant, text, "say how much in all")
        if grant.data.store and length > measures.retention_ms:
            most = duration(measures.retention_ms)
            yield _retention(
                f"{place}.data.store",
                grant,
                f"keeps recordings until the mission ends, after {duration(length)}",
                f"end the mission within {most}, or do not store",
            )


def _retention(where: str, grant: Grant, message: str, mend: str) -> LintFinding:
    return error(LintCode.RETENTION_OPEN, where, f"`{grant.id}` {message}", mend)


def long_window(scene: LintScene) -> Iterator[LintFinding]:
    """A mission that lasts much longer than its work is authority lying about."""
    mission, measures = scene.mission, scene.measures
    length = to_ms(mission.expiry, where="expiry") - to_ms(mission.not_before, where="not_before")
    needed = sum(grant.max_ms * grant.repeat for grant in mission.actions)
    longest = max(measures.window_factor * needed, measures.window_floor_ms)
    if length > longest:
        yield warning(
            LintCode.WINDOW_LONG,
            "expiry",
            f"the mission is valid for {duration(length)}; all its actions together "
            f"take at most {duration(needed)}",
            f"end it after {duration(longest)} at the latest",
        )


def unbounded_streams(scene: LintScene) -> Iterator[LintFinding]:
    """A velocity leads anywhere: regions and a short lease are all that holds it."""
    longest = scene.measures.stream_ms
    for number, grant, model in _known(scene):
        if not _is_stream(model):
            continue
        for index, row in enumerate(grant.alternatives):
            if not row.regions:
                yield error(
                    LintCode.STREAM_UNBOUNDED,
                    f"actions[{number}].alternatives[{index}].regions",
                    f"`{grant.id}` may drive anywhere",
                    "list the regions that it may touch",
                )
        if grant.max_ms > longest:
            yield error(
                LintCode.STREAM_UNBOUNDED,
                f"actions[{number}].max_ms",
                f"`{grant.id}` may drive for {duration(grant.max_ms)} on one decision",
                f"let one lease last at most {duration(longest)}",
            )


def _is_stream(model: ActionModel) -> bool:
    """True for motion by velocity, without a place that it leads to."""
    return (
        model.moves
        and "destination" not in model.fields
        and any(parameter.unit.endswith("/s") for parameter in model.params.values())
    )


def beyond_profile(scene: LintScene) -> Iterator[LintFinding]:
    """What the robot cannot do is not granted: the effect of trying it is unknown."""
    profile = scene.site.robots[scene.mission.rid].profile
    most = {"mm/s": profile.max_speed_mm_s, "mN": profile.max_force_mn}
    for number, grant, model in _known(scene):
        for index, item in enumerate(grant.limits):
            known = model.params.get(item.parameter)
            if known is not None and reach(item) > most.get(known.unit, reach(item)):
                yield error(
                    LintCode.BEYOND_PROFILE,
                    f"actions[{number}].limits[{index}]",
                    f"`{grant.id}` allows {formatting.quantity(reach(item), known.unit)}; the "
                    f"robot can do {formatting.quantity(most[known.unit], known.unit)}",
                    "lower the bound to what the robot can do",
                )
        for index, row in enumerate(grant.alternatives):
            thing = None if row.object is None else scene.site.objects.get(row.object)
            heavy = thing is not None and thing.mass_g > profile.max_payload_g
            if heavy and grant.type in _LIFTING:
                yield error(
                    LintCode.BEYOND_PROFILE,
                    f"actions[{number}].alternatives[{index}].object",
                    f"`{row.object}` is heavier than the robot's payload of "
                    f"{formatting.quantity(profile.max_payload_g, 'g')}",
                    "use another robot, or leave the object out",
                )


def _known(scene: LintScene) -> Iterator[tuple[int, Grant, ActionModel]]:
    """Return the grants of types that the site knows, with their places."""
    for number, grant in enumerate(scene.mission.actions):
        model = scene.site.vocabulary.get(grant.type)
        if model is not None:
            yield number, grant, model


BOUND_RULES: tuple[Rule, ...] = (
    unbounded_parameters,
    wide_bounds,
    open_retention,
    long_window,
    unbounded_streams,
    beyond_profile,
)
