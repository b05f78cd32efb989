# SPDX-License-Identifier: Apache-2.0
"""The envelope gate: speed, force, payload, keep-out, people, and what the state allows.

One function for one rule. A rule that needs a reading and has none is not satisfied.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.facts import ActionKind, SiteFacts
from authguard_r.core.identifiers import ParameterId, VariableId
from authguard_r.core.quantities import Now
from authguard_r.core.safety import Hazard, SafetyDecision, SafetyFinding
from authguard_r.core.state import AttestedState
from authguard_r.safety.config import SPEED, THE_OBJECT, VELOCITY, SafetyConfig
from authguard_r.safety.repair import AT_MOST, repair_of
from authguard_r.safety.state_reading import trusted_value

FORCE = ParameterId("force_mn")
HUMAN_DISTANCE = VariableId("human_distance_mm")


class _Scene(Struct, frozen=True, kw_only=True):
    """What every rule reads."""

    config: SafetyConfig
    action: Action
    kind: ActionKind
    state: AttestedState | None
    now: Now

    def reading(self, variable: VariableId) -> object | None:
        """Return a fresh, trusted value of this robot, or None."""
        return trusted_value(self.state, variable, config=self.config, now=self.now)


Findings = tuple[SafetyFinding, ...]


class EnvelopeGate:
    """The default safety gate (`core.ports.SafetyGate`).

    Args:
        config: authentic configuration; what it does not allow is unsafe.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self.config = config

    def recall(self, memory: bytes) -> EnvelopeGate:  # noqa: ARG002 - it remembers nothing
        """Return the same gate: what was done before changes nothing here."""
        return self

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return the verdict; total, without effects."""
        kind = facts.vocabulary.get(action.type)
        if kind is None or facts.robot.profile != self.config.profile:
            finding = SafetyFinding(Hazard.STATE_UNKNOWN, "type", "a known action", action.type)
            return SafetyDecision(safe=False, findings=(finding,))
        scene = _Scene(config=self.config, action=action, kind=kind, state=state, now=now)
        found = tuple(finding for rule in RULES for finding in rule(scene))
        if not found:
            return SafetyDecision(safe=True)
        repair = repair_of(action, found, keep_out=self.config.keep_out, facts=facts)
        return SafetyDecision(safe=False, findings=found, repair=repair)


def rule_speed(scene: _Scene) -> Findings:
    """A motion says how fast, and not faster than the robot may be."""
    if not scene.kind.moves:
        return ()
    return _not_faster(scene, Hazard.SPEED, scene.config.max_speed_mm_s)


def rule_force(scene: _Scene) -> Findings:
    """A grip says how hard, and not harder than the robot may."""
    if FORCE not in scene.kind.params:
        return ()
    value, most = scene.action.params.get(FORCE), scene.config.max_force_mn
    return () if value is not None and value <= most else _above(Hazard.FORCE, FORCE, value, most)


def rule_payload(scene: _Scene) -> Findings:
    """What is lifted has a known mass that the robot may carry."""
    item = scene.action.object
    if item is None or scene.action.type in scene.config.in_place:
        return ()
    mass = scene.config.masses_g.get(item)
    most = scene.config.max_payload_g
    if mass is not None and mass <= most:
        return ()
    got = "unknown mass" if mass is None else f"{mass} g"
    return (SafetyFinding(Hazard.PAYLOAD, "object", f"at most {most} g", got),)


def rule_keep_out(scene: _Scene) -> Findings:
    """The robot is not sent to or through a keep-out region."""
    asked = [("destination", scene.action.destination)]
    asked += [(f"route[{n}]", region) for n, region in enumerate(scene.action.route)]
    return tuple(
        SafetyFinding(Hazard.KEEP_OUT, field, "outside every keep-out region", region)
        for field, region in asked
        if region is not None and region in scene.config.keep_out
    )


def rule_human_proximity(scene: _Scene) -> Findings:
    """Near people the robot is slow; when their distance is unknown, it does not move."""
    if not scene.kind.moves:
        return ()
    distance = scene.reading(HUMAN_DISTANCE)
    if type(distance) is not int:
        return (
            SafetyFinding(
                Hazard.STATE_UNKNOWN, f"state.{HUMAN_DISTANCE}", "a fresh distance", "none"
            ),
        )
    if distance > scene.config.human_distance_mm:
        return ()
    return _not_faster(scene, Hazard.HUMAN_PROXIMITY, scene.config.human_speed_mm_s)


def rule_executable(scene: _Scene) -> Findings:
    """The action can be carried out in the attested state."""
    found: list[SafetyFinding] = []
    for rule in scene.config.executable:
        if rule.type != scene.action.type:
            continue
        wanted = scene.action.object if rule.equals == THE_OBJECT else rule.equals
        got = scene.reading(rule.variable)
        if got is None or got != wanted:
            field = f"state.{rule.variable}"
            found.append(
                SafetyFinding(Hazard.NOT_EXECUTABLE, field, str(wanted), str(got or "none"))
            )
    return tuple(found)


RULES: tuple[Callable[[_Scene], Findings], ...] = (
    rule_speed,
    rule_force,
    rule_payload,
    rule_keep_out,
    rule_human_proximity,
    rule_executable,
)


def _not_faster(scene: _Scene, hazard: Hazard, most: int) -> Findings:
    parameter, value = _speed(scene)
    return () if value is not None and value <= most else _above(hazard, parameter, value, most)


def _speed(scene: _Scene) -> tuple[ParameterId, int | None]:
    """Return how fast the action goes at most, and the parameter that says so."""
    params = scene.action.params
    if SPEED in params:
        return SPEED, abs(params[SPEED])
    given = [abs(params[part]) for part in VELOCITY if part in params]
    if set(VELOCITY).issubset(scene.kind.params):
        return VELOCITY[0], sum(given) if len(given) == len(VELOCITY) else None
    return SPEED, scene.config.paced.get(scene.action.type)


def _above(hazard: Hazard, parameter: ParameterId, value: int | None, most: int) -> Findings:
    got = "none" if value is None else str(value)
    return (SafetyFinding(hazard, f"params.{parameter}", f"{AT_MOST}{most}", got),)
