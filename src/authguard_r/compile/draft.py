# SPDX-License-Identifier: Apache-2.0
"""What a person writes: a mission draft in human units, every field's absence visible.

A draft has no authority. Optional here means only that the compiler asks for it by name.
How-to: docs/howto/missions.md
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

#: A quantity as people write it (`0.8 m/s`), or an integer in the target's unit.
Quantity = str | int


class _Draft(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The manner of every part of a draft: closed and immutable."""


class DraftRow(_Draft, frozen=True, kw_only=True):
    """One alternative; `regions` is everything the robot may touch on the way."""

    object: str | None = None
    source: str | None = None
    destination: str | None = None
    regions: tuple[str, ...] = ()


class DraftGuard(_Draft, frozen=True, kw_only=True):
    """A condition: exactly one comparison, and how old the reading may be."""

    variable: str
    max_age: Quantity
    eq: int | bool | str | None = None
    ne: int | bool | str | None = None
    lt: Quantity | None = None
    le: Quantity | None = None
    gt: Quantity | None = None
    ge: Quantity | None = None


class DraftGrant(_Draft, frozen=True, kw_only=True):
    """One permission. What a mission must settle is asked for when it is not here."""

    id: str
    type: str
    tool: str | None = None
    rows: tuple[DraftRow, ...] | None = None
    limits: dict[str, tuple[Quantity, Quantity]] = {}
    guards: tuple[DraftGuard, ...] = ()
    data: dict[str, bool] = {}
    chooser: str | None = None
    after: tuple[str, ...] = ()
    until: tuple[str, ...] = ()
    repeat: int | None = None
    starts: int | None = None
    max: Quantity | None = None
    irreversible: bool | None = None
    completes: bool = False
    done_when: tuple[DraftGuard, ...] = ()


class Draft(_Draft, frozen=True, kw_only=True):
    """A whole mission as its author sees it.

    `window` is `{not_before, expiry}` with RFC 3339 UTC seconds, or `{for}` from the moment of
    compiling. `objects` and `regions` default to exactly what the rows name.
    """

    mission: str
    task: str
    robot: str | None = None
    issuer: str | None = None
    version: int = 1
    supersedes: str | None = None
    window: dict[str, str] | None = None
    place_max_age: Quantity | None = None
    objects: tuple[str, ...] | None = None
    regions: tuple[str, ...] | None = None
    limits: dict[str, tuple[Quantity, Quantity]] = {}
    guards: tuple[DraftGuard, ...] = ()
    grants: tuple[DraftGrant, ...] = ()
    closing: dict[str, Any] | None = None
    budgets: dict[str, Any] | None = None
    on_refusal: str | None = None
    risk_policy: dict[str, Any] | None = None
