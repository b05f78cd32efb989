# SPDX-License-Identifier: Apache-2.0
"""The mutation run: each check taken out of the gates in turn, over pairs of every category.

What a suite does not notice the loss of, it does not test: without a check, an attack that only it
refuses has to be carried out. The same for the second gate: without a rule, what only that rule
calls unsafe has to be done. Source: `eq:uasr`. Spec page: docs/spec/defenses.md#mutation
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from unittest.mock import patch

from msgspec import Struct
from msgspec.structs import replace

import authguard_reference as oracle
from authguard_r.core.action import Action
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Identifier, RobotId, VariableId
from authguard_r.core.ports import SafetyGate
from authguard_r.core.quantities import Now
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.state import AttestedState
from authguard_r.safety import EnvelopeGate, SafetyConfig, default_config, envelope
from authguard_r.safety.config import Executable
from authguard_r.site.model import Site
from missionpair.ablation import CHECKS, without
from missionpair.execution import Everything, through_the_gate
from missionpair.pair import Layout, Pair, Suite, plan_bytes
from missionpair.stage import Stage, Yard

#: The second gate's rules, by name.
RULES: tuple[str, ...] = tuple(rule.__name__ for rule in envelope.RULES)

#: Checks that nothing which a planner writes can meet alone, and why; each has a test that shows
#: it (tests/unit/missionpair/test_mutation.py).
UNREACHABLE: dict[str, str] = {
    "check_certificate": "a certificate ends by the calendar alone: nothing that a planner writes "
    "moves it, and a trial lasts minutes",
    "check_meta": "the enforcer writes a proposal's meta itself, from the very mission that it is "
    "judged by, in the same turn; a planner's bytes have no place for it",
}

#: The row in which no check is missing: what is let through there, both gates let through.
NOTHING = "nothing"
#: Farther than any person is, in millimeters.
_FAR_MM = 1 << 40


class Mutant(Struct, frozen=True, kw_only=True):
    """What came of one check's absence.

    Args:
        gate: `authorization` or `safety`.
        check: its name; `nothing` for none.
        trials: what was tried; refused, all of it, with every check in place.
        let_through: trials in which something unauthorized (or, of the second gate, unsafe) was
            carried out.
        first: the first such pair.
        why_not: why no trial can reach it; empty where one has to.
    """

    gate: str
    check: str
    trials: int
    let_through: int
    first: str = ""
    why_not: str = ""

    @property
    def rate(self) -> Fraction | None:
        """UASR without the check; None where nothing was tried."""
        return oracle.uasr(self.let_through, self.trials)

    @property
    def is_as_it_should(self) -> bool:
        """True when the suite notices that the check is gone, or nothing ever could."""
        if self.check == NOTHING:
            return self.let_through == 0
        return self.let_through > 0 or bool(self.why_not)


def mutate(
    suite: Suite,
    yard: Yard,
    *,
    checks: Iterable[str] = CHECKS,
    show: Callable[[int], object] = lambda _: None,
) -> tuple[Mutant, ...]:
    """Return what each check of the authorization gate is worth to a suite, after `nothing`.

    Args:
        suite: whose attacks are tried; `slice_of` makes a small one.
        yard: where situations are made.
        checks: names from `ablation.CHECKS`.
        show: called with the number of pairs that are done.

    Raises:
        StageError: a pair cannot be made real.
    """
    through: dict[str, list[str]] = {name: [] for name in (NOTHING, *checks)}
    for number, pair in enumerate(suite.pairs, 1):
        for name in _let_in(pair, suite.layouts[pair.layout], yard, tuple(through)):
            through[name].append(pair.id)
        show(number)
    return tuple(
        Mutant(
            gate="authorization",
            check=check,
            trials=len(suite.pairs),
            let_through=len(found),
            first=found[0] if found else "",
            why_not=UNREACHABLE.get(check, ""),
        )
        for check, found in through.items()
    )


def mutate_safety(suite: Suite, yard: Yard, *, rules: Iterable[str] = RULES) -> tuple[Mutant, ...]:
    """Return what each rule of the second gate is worth.

    Nothing in a suite is unsafe; so the configuration is made so strict, for one rule at a time,
    that a benign run is. What only that rule refuses then has to be done without it.

    Args:
        suite: whose benign runs are tried.
        yard: where situations are made.
        rules: names from `RULES`.

    Raises:
        StageError: a pair cannot be made real.
    """
    counts = {rule: _RuleCount() for rule in rules}
    for pair in suite.pairs:
        _try_rules(pair, suite.layouts[pair.layout], yard, counts)
    return tuple(
        Mutant(
            gate="safety",
            check=rule,
            trials=count.trials,
            let_through=len(count.through),
            first=count.through[0] if count.through else "",
        )
        for rule, count in counts.items()
    )


def slice_of(suite: Suite, *, most: int = 256) -> Suite:
    """Return a few pairs of a suite, as different as they come.

    Args:
        suite: the whole.
        most: pairs at most: first one of each combination of categories and reasons, then one of
            each in every domain, then others from all over the suite.
    """
    kinds: dict[object, Pair] = {}
    cells: dict[object, Pair] = {}
    for pair in suite.pairs:
        kind = (pair.categories, frozenset(pair.reasons))
        kinds.setdefault(kind, pair)
        cells.setdefault((pair.domain, kind), pair)
    step = max(1, len(suite.pairs) // most)
    rest = (suite.pairs[at] for first in range(step) for at in range(first, len(suite.pairs), step))
    chosen = dict.fromkeys(pair.id for pair in (*kinds.values(), *cells.values(), *rest))
    kept = set(tuple(chosen)[:most])
    pairs = tuple(pair for pair in suite.pairs if pair.id in kept)
    layouts = {pair.layout: suite.layouts[pair.layout] for pair in pairs}
    return Suite(name=suite.name, version=suite.version, layouts=layouts, pairs=pairs)


def _let_in(pair: Pair, layout: Layout, yard: Yard, checks: tuple[str, ...]) -> Iterator[str]:
    """Give the checks without which the pair's attack is carried out."""
    raw = plan_bytes(pair.attack.plan)
    stage = yard.stage(pair, layout, pair.attack)
    stage.show(pair.inputs)
    for check in checks:
        stage.again()
        with without(check):
            if _is_hijacked(stage, raw):
                yield check


def _is_hijacked(stage: Stage, raw: bytes) -> bool:
    return any(not effect.authorized for effect in through_the_gate(stage, raw).effects)


# the second gate


@contextmanager
def without_rule(name: str) -> Iterator[None]:
    """Run with one rule of the envelope gone."""
    kept = tuple(rule for rule in envelope.RULES if rule.__name__ != name)
    with patch.object(envelope, "RULES", kept):
        yield


@dataclass
class _RuleCount:
    """Trials of one rule, and the pairs that its absence let through."""

    trials: int = 0
    through: list[str] = field(default_factory=list)


class _Changing:
    """A second gate that is another one from try to try; a stage is made once for all of them."""

    def __init__(self) -> None:
        self.now: SafetyGate = Everything()

    def recall(self, memory: bytes) -> SafetyGate:
        """Return the gate that stands here now."""
        return self.now.recall(memory)

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return what it says."""
        return self.now.assess(action, state, facts, now)


def _try_rules(pair: Pair, layout: Layout, yard: Yard, counts: dict[str, _RuleCount]) -> None:
    """Carry the pair's benign run out with each rule alone strict, and then without that rule."""
    gate, raw = _Changing(), plan_bytes(pair.benign.plan)
    stage = yard.stage(pair, layout, pair.benign, safety_gate=gate)
    site, rid = stage.bench.site, RobotId(pair.benign.robot)
    for rule, count in counts.items():
        strict = EnvelopeGate(_STRICT[rule](default_config(site, rid), site))
        stage.again()  # puts the gate back, too
        gate.now = strict
        with_it = through_the_gate(stage, raw)
        if with_it.by != "safety":
            continue
        count.trials += 1
        stage.again()
        gate.now = strict
        with without_rule(rule):
            without_it = through_the_gate(stage, raw)
        if len(without_it.effects) > len(with_it.effects):
            count.through.append(pair.id)


def _nothing_executable(config: SafetyConfig, site: Site) -> SafetyConfig:
    rules = tuple(
        Executable(type=kind, variable=_HOLDING, equals=_NOBODYS) for kind in site.vocabulary
    )
    return replace(config, executable=rules)


_HOLDING, _NOBODYS = VariableId("holding"), Identifier("what-nobody-holds")
#: For each rule, what makes work that a mission authorizes unsafe by that rule alone.
_STRICT: dict[str, Callable[[SafetyConfig, Site], SafetyConfig]] = {
    "rule_speed": lambda config, _: replace(config, max_speed_mm_s=0),
    "rule_force": lambda config, _: replace(config, max_force_mn=0),
    "rule_payload": lambda config, _: replace(config, max_payload_g=0),
    "rule_keep_out": lambda config, site: replace(config, keep_out=tuple(sorted(site.regions))),
    "rule_human_proximity": lambda config, _: replace(
        config, human_distance_mm=_FAR_MM, human_speed_mm_s=0
    ),
    "rule_executable": _nothing_executable,
}
