# SPDX-License-Identifier: Apache-2.0
"""The normalizer N: planner output to actions with provenance; it refuses, it never guesses.

Internal: it may change in any release.
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.identifiers import Digest
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.dialects import Dialect, read_reply
from authguard_r.normalize.parse import read_text


class Step(Struct, frozen=True, kw_only=True):
    """One action of a plan, and what attested state must still fill in.

    Args:
        action: without provenance and meta.
        attested: fields to fill when the step's turn comes.
        around: what stood around the plan's calls and was not looked at, for the record.
    """

    action: Action
    attested: tuple[str, ...]
    around: str = ""


class Plan(Struct, frozen=True, kw_only=True):
    """A whole plan that was read and bound; nothing of it is decided.

    Args:
        steps: in order.
        dialect: the one that the plan was read in; never `auto`.
        evidence: digest of the planner's exact bytes.
    """

    steps: tuple[Step, ...]
    dialect: Dialect
    evidence: Digest


def read_plan(data: bytes, *, binder: Binder, dialect: Dialect = Dialect.AUTO) -> Plan:
    """Return the plan that a planner's bytes mean.

    One unknown anything refuses the whole plan: judging the rest would judge another plan (L11).

    Raises:
        MalformedError: with the reason and the place.
    """
    reading = read_reply(read_text(data), dialect, binder.reply)
    steps = tuple(
        [
            Step(
                action=binder.bind(call),
                attested=binder.way(call).attested,
                around=reading.around,
            )
            for call in reading.calls
        ]
    )
    return Plan(steps=steps, dialect=reading.dialect, evidence=digest(Tag.RAW, data))


__all__ = ["Binder", "Dialect", "Plan", "Step", "read_plan"]
