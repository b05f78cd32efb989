# SPDX-License-Identifier: Apache-2.0
"""A mission taken apart into what can be wider or narrower, so that versions can be held together.

Every signed field is in some facet: `difference` shows what differs, and nothing can differ
unshown. How-to: docs/howto/missions.md
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

from msgspec import Struct

from authguard_r.core.identifiers import ActionType
from authguard_r.core.mission import Closing, Grant, Guard, Limit, Mission, RiskPolicy
from authguard_r.core.provenance import WIDEST, Chooser, SourceField
from authguard_r.core.quantities import to_ms
from authguard_r.site import formatting
from authguard_r.site.durations import duration
from authguard_r.site.model import Site


class Bears(IntEnum):
    """Which way more of something bears on authority."""

    NARROWS = -1
    NEITHER = 0
    WIDENS = 1


class Facet(Struct, frozen=True, kw_only=True):
    """One thing that a version says.

    Args:
        owner: the grant that it belongs to, empty for the mission's own.
        label: what it is about; with `value` it is a line for people.
        value: what it says.
        size: its measure, when it has one.
        more: what a greater measure does.
        presence: what being there at all does.
        is_row: it is a row, which says by itself that its grant came or went.
    """

    owner: str
    label: str
    value: str
    size: int = 0
    more: Bears = Bears.NEITHER
    presence: Bears = Bears.NEITHER
    is_row: bool = False

    def text(self) -> str:
        """Return the line."""
        owner = f"{self.owner}: " if self.owner else ""
        return f"{owner}{self.label} {self.value}".rstrip()


#: A facet with the name that the same one has in another version.
Named = tuple[str, Facet]


def facets(mission: Mission, site: Site, listed: frozenset[str]) -> dict[str, Facet]:
    """Return everything that the mission says, by names that are the same in each version.

    Args:
        mission: one version.
        site: says the units.
        listed: names of weights that either version lists.
    """
    found: dict[str, Facet] = {}
    for part in (
        _identity(mission),
        _window(mission),
        _ceilings(mission, site),
        _budgets(mission),
        _policy(mission.risk_policy, site, listed),
        _closing(mission.closing),
        _sources(mission),
        *(_grant(grant, site) for grant in mission.actions),
    ):
        for name, facet in part:
            number = 0
            while f"{name}#{number}" in found:  # the same condition twice
                number += 1
            found[f"{name}#{number}"] = facet
    return found


def listed_weights(policy: RiskPolicy) -> frozenset[str]:
    """Return the names of the weights that a policy lists, with what they weigh."""
    return frozenset(
        f"{group}.{name}" for group, weights in _weight_groups(policy) for name in weights
    )


def _weight_groups(policy: RiskPolicy) -> tuple[tuple[str, dict[str, int]], ...]:
    return (
        ("types", {str(name): weight for name, weight in policy.types.items()}),
        ("region_tags", policy.region_tags),
        ("object_classes", policy.object_classes),
    )


def _identity(mission: Mission) -> Iterator[Named]:
    for label, value in (
        ("mission", mission.mid),
        ("version", str(mission.version)),
        ("supersedes", mission.supersedes or "nothing"),
        ("robot", mission.rid),
        ("profile", mission.profile),
        ("site", mission.site),
        ("issuer", mission.issuer),
        ("task", formatting.quoted(mission.task)),
        ("nonce", mission.nonce),
        ("after a refusal", mission.on_refusal),
    ):
        yield label, Facet(owner="", label=label, value=str(value))


def _window(mission: Mission) -> Iterator[Named]:
    first, last = mission.not_before, mission.expiry
    yield _sized("", "valid from", first, to_ms(first, where="not_before"), Bears.NARROWS)
    yield _sized("", "valid to", last, to_ms(last, where="expiry"), Bears.WIDENS)
    yield _time("", "place read at most this long ago:", mission.place_max_age_ms)


def _ceilings(mission: Mission, site: Site) -> Iterator[Named]:
    for item in mission.objects:
        yield _there("", "may handle", item, Bears.WIDENS)
    for region in mission.regions:
        yield _there("", "may enter", region, Bears.WIDENS)
    yield from _limits("", mission.limits, site, Bears.NARROWS)
    for guard in mission.guards:
        yield _there("", "only while", formatting.condition(guard), Bears.NARROWS)


def _budgets(mission: Mission) -> Iterator[Named]:
    budgets = mission.budgets
    for label, value in (
        ("actions in all:", budgets.actions),
        ("actions in a while:", budgets.rate.count),
        ("requests to people:", budgets.prompts),
        ("stops by the planner before an alert:", budgets.planner_stops),
    ):
        yield _sized("", label, str(value), value, Bears.WIDENS)
    recorded = formatting.quantity(budgets.recorded_bytes, "byte")
    yield _sized("", "recorded in all:", recorded, budgets.recorded_bytes, Bears.WIDENS)
    yield _time("", "in motion in all:", budgets.motion_ms)
    yield _time("", "waiting in all:", budgets.wait_ms)
    yield _time("", "the while is", budgets.rate.per_ms, Bears.NARROWS)


def _policy(policy: RiskPolicy, site: Site, listed: frozenset[str]) -> Iterator[Named]:
    for label, value, more in (
        ("second person from risk", policy.tau_1, Bears.WIDENS),
        ("most people from risk", policy.tau_2, Bears.WIDENS),
        ("most people are", policy.t, Bears.NARROWS),
        ("risk of each step of privacy:", policy.privacy, Bears.NARROWS),
        ("risk of other actions:", policy.otherwise, Bears.NARROWS),
    ):
        yield _sized("", label, str(value), value, more)
    yield _time("", "a request lives", policy.valid_ms)
    for role in policy.roles:
        yield _there("", "may approve:", role, Bears.WIDENS)
    own = listed_weights(policy)
    for group, weights in _weight_groups(policy):
        for name in sorted(
            item.partition(".")[2] for item in listed if item.startswith(f"{group}.")
        ):
            weight = weights.get(name, policy.otherwise)
            unlisted = "" if f"{group}.{name}" in own else " (not listed)"
            yield _sized(
                "", f"risk of {group}.{name}:", f"{weight}{unlisted}", weight, Bears.NARROWS
            )
    for item in policy.parameters:
        scale = formatting.quantity(item.full_scale, formatting.unit_of(item.parameter, site))
        yield _there("", f"risk of {item.parameter}:", f"{item.weight} at {scale}", Bears.NARROWS)
    for state in policy.states:
        text = f"{state.weight} unless not {formatting.condition(state.guard)}"
        yield _there("", "risk of a state:", text, Bears.NARROWS)


def _closing(closing: Closing | None) -> Iterator[Named]:
    if closing is not None:
        for grant in closing.grants:
            yield _there("", "stays open once complete:", grant, Bears.WIDENS)
        yield _time("", "stays open for", closing.for_ms)


def _sources(mission: Mission) -> Iterator[Named]:
    """Yield the labels that may set each field, and how long sealed fields are kept."""
    signed = mission.sources
    for field in SourceField:
        for label in signed.get(field, tuple(sorted(WIDEST[field]))):
            yield _there("", f"{field} may be set by", label, Bears.WIDENS)
    for data, kept_ms in mission.retention.items():
        yield _plain(f"sealed {data} fields are stored for", duration(kept_ms))
    for name, weight in mission.risk_policy.field_weights.items():
        yield _plain(f"weight of {name} in the deviation:", str(weight))


def _grant(grant: Grant, site: Site) -> Iterator[Named]:
    owner = grant.id
    for row in grant.alternatives:
        text = formatting.row(row, site)
        yield (
            f"{owner}|{grant.type}|{text}",
            Facet(owner=owner, label=grant.type, value=text, presence=Bears.WIDENS, is_row=True),
        )
    yield _there(owner, "with tool", grant.tool, Bears.WIDENS)
    yield from _limits(owner, grant.limits, site, Bears.WIDENS, grant.type)
    yield from _conditions(grant)
    by_planner = int(grant.chooser is Chooser.PLANNER)
    yield _sized(owner, "chosen by", grant.chooser, by_planner, Bears.WIDENS)
    yield _sized(owner, "successes:", str(grant.repeat), grant.repeat, Bears.WIDENS)
    yield _sized(owner, "starts:", str(grant.starts), grant.starts, Bears.WIDENS)
    yield _time(owner, "each up to", grant.max_ms)
    for label, held, more in (
        ("irreversible:", grant.irreversible, Bears.NARROWS),
        ("completes the mission:", grant.completes, Bears.NARROWS),
        ("may record sensor data:", grant.data.record, Bears.WIDENS),
        ("may store sensor data:", grant.data.store, Bears.WIDENS),
        ("may transmit sensor data:", grant.data.transmit, Bears.WIDENS),
    ):
        yield _sized(owner, label, "yes" if held else "no", int(held), more)


def _conditions(grant: Grant) -> Iterator[Named]:
    guards: tuple[Guard, ...] = grant.guards
    for guard in guards:
        yield _there(grant.id, "only while", formatting.condition(guard), Bears.NARROWS)
    for before in grant.after:
        yield _there(grant.id, "only after", before, Bears.NARROWS)
    for end in grant.until:
        yield _there(grant.id, "only until", end, Bears.NARROWS)
    for guard in grant.done_when:
        yield _there(grant.id, "counts as done when", formatting.condition(guard), Bears.NEITHER)


def _limits(
    owner: str,
    limits: tuple[Limit, ...],
    site: Site,
    presence: Bears,
    kind: ActionType | None = None,
) -> Iterator[Named]:
    for item in limits:
        unit = formatting.unit_of(item.parameter, site, kind)
        for label, value, more in (
            (f"{item.parameter} at least", item.low, Bears.NARROWS),
            (f"{item.parameter} at most", item.high, Bears.WIDENS),
        ):
            shown = formatting.quantity(value, unit)
            facet = Facet(
                owner=owner, label=label, value=shown, size=value, more=more, presence=presence
            )
            yield f"{owner}|{label}", facet


def _time(owner: str, label: str, value: int, more: Bears = Bears.WIDENS) -> Named:
    return _sized(owner, label, duration(value), value, more)


def _sized(owner: str, label: str, value: str, size: int, more: Bears) -> Named:
    """Return a facet that every version has, with a measure."""
    facet = Facet(
        owner=owner, label=label, value=value, size=size, more=more, presence=Bears.WIDENS
    )
    return f"{owner}|{label}", facet


def _plain(label: str, value: str) -> Named:
    """Return a facet that bears on no authority."""
    return f"|{label}", Facet(owner="", label=label, value=value)


def _there(owner: str, label: str, value: str, presence: Bears) -> Named:
    """Return a facet that is there or not; another value is another facet."""
    return f"{owner}|{label}|{value}", Facet(
        owner=owner, label=label, value=value, presence=presence
    )
