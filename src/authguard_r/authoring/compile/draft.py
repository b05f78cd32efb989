# SPDX-License-Identifier: Apache-2.0
"""What a person writes: a mission draft in human units, every field's absence visible.

A draft has no authority. Optional here means only that the compiler asks for it by name; a field
that this page does not have is refused. How-to: docs/howto/missions.md
"""

from __future__ import annotations

from msgspec import Struct

#: A quantity as people write it (`0.8 m/s`), or an integer in the target's unit. A decimal alone
#: is read only so that its unit can be asked about.
Quantity = str | int | float


class _DraftStruct(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The manner of every part of a draft: closed and immutable."""


class DraftRow(_DraftStruct, frozen=True, kw_only=True):
    """One alternative; `regions` is everything the robot may touch on the way."""

    object: str | None = None
    source: str | None = None
    destination: str | None = None
    regions: tuple[str, ...] | None = None


class DraftGuard(_DraftStruct, frozen=True, kw_only=True):
    """A condition: exactly one comparison, and how old the reading may be."""

    variable: str
    max_age: Quantity | None = None
    eq: int | bool | str | None = None
    ne: int | bool | str | None = None
    lt: int | None = None
    le: int | None = None
    gt: int | None = None
    ge: int | None = None


class DraftGrant(_DraftStruct, frozen=True, kw_only=True):
    """One permission. What a mission must settle is asked for when it is not here."""

    id: str
    type: str | None = None
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


class DraftClosing(_DraftStruct, frozen=True, kw_only=True, rename={"for_": "for"}):
    """Which grants outlive completion, and for how long."""

    grants: tuple[str, ...] = ()
    for_: Quantity | None = None


class DraftRate(_DraftStruct, frozen=True, kw_only=True):
    """At most `count` releases in `per`."""

    count: int | None = None
    per: Quantity | None = None


class DraftBudgets(_DraftStruct, frozen=True, kw_only=True):
    """Totals of the whole mission; zero is zero."""

    actions: int | None = None
    rate: DraftRate = DraftRate()
    motion: Quantity | None = None
    waiting: Quantity | None = None
    recorded_bytes: Quantity | None = None
    prompts: int | None = None
    planner_stops: int | None = None


class DraftParameterRisk(_DraftStruct, frozen=True, kw_only=True):
    """What a forceful parameter adds."""

    parameter: str
    full_scale: Quantity
    weight: int


class DraftStateRisk(_DraftStruct, frozen=True, kw_only=True):
    """What a state of the world adds."""

    guard: DraftGuard
    weight: int


class DraftRisk(_DraftStruct, frozen=True, kw_only=True):
    """Who must approve what. Weights that are not listed are `otherwise`.

    `field_weights` weigh the deviation of an action (D_M) and authorize nothing.
    """

    types: dict[str, int] = {}
    region_tags: dict[str, int] = {}
    object_classes: dict[str, int] = {}
    parameters: tuple[DraftParameterRisk, ...] = ()
    states: tuple[DraftStateRisk, ...] = ()
    privacy: int | None = None
    otherwise: int | None = None
    tau_1: int | None = None
    tau_2: int | None = None
    t: int | None = None
    roles: tuple[str, ...] | None = None
    valid: Quantity | None = None
    field_weights: dict[str, Quantity] = {}


class Draft(_DraftStruct, frozen=True, kw_only=True):
    """A whole mission as its author sees it.

    `window` is `{not_before, expiry}` with RFC 3339 UTC seconds, or `{for}` from the moment of
    compiling. `objects` and `regions` default to exactly what the rows name. `sources` names the
    labels that may set a field, `retention` how long sealed fields of a class are kept.
    """

    mission: str
    task: str | None = None
    robot: str | None = None
    issuer: str | None = None
    version: int = 1
    supersedes: str | None = None
    window: dict[str, Quantity] | None = None
    place_max_age: Quantity | None = None
    objects: tuple[str, ...] | None = None
    regions: tuple[str, ...] | None = None
    limits: dict[str, tuple[Quantity, Quantity]] = {}
    guards: tuple[DraftGuard, ...] = ()
    grants: tuple[DraftGrant, ...] = ()
    closing: DraftClosing | None = None
    budgets: DraftBudgets = DraftBudgets()
    on_refusal: str | None = None
    risk_policy: DraftRisk = DraftRisk()
    sources: dict[str, tuple[str, ...]] = {}
    retention: dict[str, Quantity] = {}
