# SPDX-License-Identifier: Apache-2.0
"""The rules of a configuration, ready to be followed; a rule that cannot be followed is refused."""

from __future__ import annotations

from functools import lru_cache

from msgspec import Struct

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.reasons import Reason
from authguard_r.safety.config import Rule
from authguard_r.safety.temporal.parse import parse
from authguard_r.safety.temporal.track import FormulaTrack

__all__ = ["MAX_RULES", "Compiled", "Rule", "compile_rules", "rules_digest"]

#: Rules of one configuration.
MAX_RULES = 32


class Compiled(Struct, frozen=True, kw_only=True):
    """One rule and its formula's track."""

    id: Identifier
    says: str
    track: FormulaTrack


@lru_cache(maxsize=16)  # the same rules are compiled once; nothing of it changes
def compile_rules(rules: tuple[Rule, ...]) -> tuple[Compiled, ...]:
    """Return the rules, each parsed and explored.

    Raises:
        MalformedError: more than `MAX_RULES`, two of one name, or a formula that is not valid, that
            nothing satisfies, or that grows past a bound (docs/spec/safety.md#bounds).
    """
    if len(rules) > MAX_RULES:
        message = f"expected at most {MAX_RULES} rules, got {len(rules)}"
        raise MalformedError(message, where="safety.rules", reason=Reason.INPUT_TOO_LARGE)
    if len({rule.id for rule in rules}) != len(rules):
        raise MalformedError("two rules have the same id", where="safety.rules")
    return tuple(_compiled(rule, f"safety.rules[{n}].formula") for n, rule in enumerate(rules))


@lru_cache(maxsize=16)
def rules_digest(rules: tuple[Rule, ...]) -> Digest:
    """Return what a memory names its rules by: a message may change, a formula may not."""
    return digest_of(Tag.SAFETY, {rule.id: rule.formula for rule in rules})


def _compiled(rule: Rule, where: str) -> Compiled:
    track = FormulaTrack(parse(rule.formula, where=where), where=where)
    return Compiled(id=rule.id, says=rule.message or rule.formula, track=track)
