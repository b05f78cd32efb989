# SPDX-License-Identifier: Apache-2.0
"""Whether an atom holds of one action in one state: yes, no, or unknown.

Unknown is never no: `!state.door = open` does not hold of a door that was not read, nor does
`!params.speed_mm_s > 500` of an action that does not say how fast.
"""

from __future__ import annotations

from collections.abc import Container

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.facts import ActionKind, SiteFacts
from authguard_r.core.identifiers import ParameterId, VariableId
from authguard_r.core.quantities import Now
from authguard_r.core.state import AttestedState
from authguard_r.safety.config import SafetyConfig
from authguard_r.safety.state_reading import trusted_value
from authguard_r.safety.temporal.formula import TRUTH, Atom, AtomComparison


class AtomScene(Struct, frozen=True, kw_only=True):
    """What every atom reads."""

    config: SafetyConfig
    action: Action
    kind: ActionKind
    state: AttestedState | None
    now: Now


def holds(atom: Atom, scene: AtomScene) -> bool | None:
    """Return whether the atom holds; None when what it asks about is not known."""
    group, _, name = atom.field.partition(".")
    if group == "state":
        value = trusted_value(scene.state, VariableId(name), config=scene.config, now=scene.now)
        return _compared(atom, value)
    if group == "params":
        return _compared(atom, scene.action.params.get(ParameterId(name)))
    value = getattr(scene.action, atom.field)
    if not value:  # an action of another kind has none; one of this kind may do anything
        return None if atom.field in scene.kind.fields else False
    values: tuple[str, ...] = value if atom.test is AtomComparison.CONTAINS else (value,)
    return atom.value in values


def unknown_name(atom: Atom, facts: SiteFacts) -> bool:
    """True when the atom names what this site does not have: it would never hold."""
    group, _, name = atom.field.partition(".")
    if group == "state":
        return False  # the estimator says which variables there are; one without reading refuses
    if group == "params":
        return all(name not in kind.params for kind in facts.vocabulary.values())
    named: dict[str, Container[object]] = {"type": facts.vocabulary, "object": facts.objects}
    return atom.value not in named.get(group, facts.regions)


def _compared(atom: Atom, value: object | None) -> bool | None:
    """Compare like with like; an integer is no word and no truth value."""
    wanted: object = atom.value
    if isinstance(wanted, int) and type(value) is int:
        return value <= wanted if atom.test is AtomComparison.AT_MOST else value == wanted
    if isinstance(wanted, str):
        wanted = TRUTH.get(wanted, wanted)
    return value == wanted if type(value) is type(wanted) else None
