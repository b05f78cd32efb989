# SPDX-License-Identifier: Apache-2.0
"""The second safety gate: every rule can still be satisfied after the action, or it is unsafe.

The gate holds no state: what was done before comes in as a memory and goes out as one, so that the
caller commits it together with the release. Spec page: docs/spec/safety.md#temporal-rules
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Identifier
from authguard_r.core.quantities import Now
from authguard_r.core.safety import Hazard, SafetyDecision, SafetyFinding
from authguard_r.core.state import AttestedState
from authguard_r.safety.config import SafetyConfig
from authguard_r.safety.temporal.atoms import AtomScene, holds, unknown_name
from authguard_r.safety.temporal.memory import Owner, read_memory, write_memory
from authguard_r.safety.temporal.rules import Compiled, compile_rules, rules_digest
from authguard_r.safety.temporal.track import Left, Letter, unknown_atoms


class _Step(Struct, frozen=True):
    """One rule after one action: what is wrong, or what is left if it succeeds, and if not."""

    findings: tuple[SafetyFinding, ...] = ()
    succeeded: Left = frozenset()
    doubted: Left = frozenset()


class TemporalGate:
    """Judges an action by what was released before it (`core.ports.SafetyGate`).

    Args:
        config: authentic configuration.
        memory: what the gate gave out when the mission's last action was released; empty before
            the first.

    Raises:
        MalformedError: a rule of the configuration cannot be followed.
    """

    def __init__(self, config: SafetyConfig, memory: bytes = b"") -> None:
        self.config = config
        self._memory = memory
        self._rules = compile_rules(config.rules)

    def recall(self, memory: bytes) -> TemporalGate:
        """Return the gate as of this memory."""
        return TemporalGate(self.config, memory)

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return the verdict; total, without effects."""
        kind = facts.vocabulary.get(action.type)
        if kind is None or facts.robot.rid != self.config.rid:
            return _unsafe(_unknown("type", "a known action of this robot", action.type))
        owner = self._owner(action)
        try:
            left = read_memory(self._memory, owner, self._rules)
        except MalformedError as error:
            return _unsafe(_unknown("memory", "what was done in this mission", error.message))
        scene = AtomScene(config=self.config, action=action, kind=kind, state=state, now=now)
        steps = {rule.id: _step(rule, left[rule.id], scene, facts) for rule in self._rules}
        found = tuple(finding for step in steps.values() for finding in step.findings)
        if found or not steps:
            return SafetyDecision(safe=not found, findings=found)
        try:
            doubted = write_memory(owner, {name: step.doubted for name, step in steps.items()})
            succeeded = write_memory(owner, {name: step.succeeded for name, step in steps.items()})
        except MalformedError as error:
            return _unsafe(_unknown("memory", error.message, "a longer one"))
        return SafetyDecision(safe=True, memory=(doubted, succeeded))

    def unfulfilled(self) -> tuple[Identifier, ...]:
        """Return the rules that do not hold if the mission ends here: reported, never refused.

        All of them when the memory is not of this gate: it is unknown whether one holds.
        """
        try:
            left = read_memory(self._memory, self._owner(None), self._rules)
        except MalformedError:
            return tuple(rule.id for rule in self._rules)
        return tuple(rule.id for rule in self._rules if not rule.track.may_end(left[rule.id]))

    def _owner(self, action: Action | None) -> Owner:
        meta = None if action is None else action.meta
        return Owner(
            rules=rules_digest(self.config.rules),
            rid=self.config.rid,
            mission=None if meta is None else meta.mission,
        )


def _step(rule: Compiled, left: Left, scene: AtomScene, facts: SiteFacts) -> _Step:
    """Follow one rule; a place that is unknown is a finding, never a guess."""
    field, track = f"rules.{rule.id}", rule.track
    strange = [atom for atom in track.atoms if unknown_name(atom, facts)]
    if strange:
        return _Step((_unknown(field, "names that this site has", str(strange[0])),))
    told = {number: holds(atom, scene) for number, atom in enumerate(track.atoms)}
    letter = Letter(
        true=frozenset(number for number, value in told.items() if value),
        unknown=frozenset(number for number, value in told.items() if value is None),
    )
    try:
        after = track.after(left, letter)
        unknown = {track.atoms[number].field: number for number in unknown_atoms(after)}
        if unknown:
            wanted = f"what rule `{rule.id}` asks about"
            return _Step(tuple(_unknown(name, wanted, "unknown") for name in unknown))
        if not track.can_hold(after):
            broken = SafetyFinding(Hazard.RULE, field, rule.says, scene.action.type)
            return _Step((broken,))
        return _Step((), after, track.both(left, after))
    except MalformedError as error:
        return _Step((_unknown(field, error.message, "more"),))


def _unsafe(finding: SafetyFinding) -> SafetyDecision:
    return SafetyDecision(safe=False, findings=(finding,))


def _unknown(field: str, expected: str, got: str) -> SafetyFinding:
    return SafetyFinding(Hazard.STATE_UNKNOWN, field, expected, got)
