# SPDX-License-Identifier: Apache-2.0
"""Every fault of a site model with its place, so that an author fixes them in one round.

What is wrong with names and with places is found in `names` and `places`; the rest here.
Spec page: docs/spec/site-model.md#soundness
"""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from authguard_r.core.mission import source_faults
from authguard_r.site.channels import channel_faults
from authguard_r.site.model import ActionModel, Site
from authguard_r.site.names import name_faults, shown, twin_faults
from authguard_r.site.places import door_faults, region_faults
from authguard_r.site.units import unit_fault

#: What an import writes where only a person can say; a site that holds it is not signed.
UNREVIEWED = "unreviewed"


class SiteFault(Struct, frozen=True):
    """One thing to fix: where, and what is expected there."""

    where: str
    message: str


def faults(site: Site) -> tuple[SiteFault, ...]:
    """Return every fault of the model, in the order of its parts; none when it is sound."""
    parts = (
        twin_faults,
        name_faults,
        region_faults,
        door_faults,
        _objects,
        _vocabulary,
        _robots,
        _people,
        _emergency,
        _baseline,
        channel_faults,
        _sources,
    )
    return tuple(SiteFault(where, message) for part in parts for where, message in part(site))


def unreviewed(site: Site) -> tuple[str, ...]:
    """Return the places that still say `unreviewed`: what an import left for a person to say."""
    regions = [
        f"regions.{region}.tags" for region, m in site.regions.items() if UNREVIEWED in m.tags
    ]
    objects = [f"objects.{item}.kind" for item, m in site.objects.items() if m.kind == UNREVIEWED]
    return (*regions, *objects)


def _sources(site: Site) -> Iterator[tuple[str, str]]:
    yield from source_faults(site.sources)


def _objects(site: Site) -> Iterator[tuple[str, str]]:
    for item, model in site.objects.items():
        if model.home not in site.regions:
            yield f"objects.{item}.home", f"expected a region of this site, got `{model.home}`"


def _vocabulary(site: Site) -> Iterator[tuple[str, str]]:
    for kind, model in site.vocabulary.items():
        place = f"vocabulary.{kind}"
        if list(model.fields) != sorted(set(model.fields)):
            yield f"{place}.fields", "expected a sorted set"
        for name, parameter in model.params.items():
            told = unit_fault(name, parameter.unit)
            if told is not None:
                yield f"{place}.params.{name}.unit", f"{told}, got `{shown(parameter.unit)}`"
            if parameter.low > parameter.high:
                yield f"{place}.params.{name}.high", "expected at least `low`"
        if model.records and "max_bytes" not in model.params:
            yield f"{place}.params", "expected `max_bytes`: a recording type says how much at most"
        if (model.stores or model.transmits) and not model.records:
            yield f"{place}.records", "expected true for a type that stores or transmits"


def _robots(site: Site) -> Iterator[tuple[str, str]]:
    for rid, robot in site.robots.items():
        if robot.home not in site.regions:
            yield f"robots.{rid}.home", f"expected a region of this site, got `{robot.home}`"
        for kind, tools in robot.profile.tools.items():
            place = f"robots.{rid}.profile.tools.{kind}"
            if kind not in site.vocabulary:
                yield place, "expected an action type of the vocabulary"
            if list(tools) != sorted(set(tools)) or not tools:
                yield place, "expected a sorted set of at least one tool"


def _people(site: Site) -> Iterator[tuple[str, str]]:
    for person, model in site.people.items():
        if list(model.roles) != sorted(set(model.roles)) or not model.roles:
            yield f"people.{person}.roles", "expected a sorted set of at least one role"


def _emergency(site: Site) -> Iterator[tuple[str, str]]:
    for region in site.emergency.places if site.emergency is not None else ():
        if region not in site.regions:
            yield f"emergency.places.{region}", "expected a region of this site"


def _baseline(site: Site) -> Iterator[tuple[str, str]]:
    if list(site.baseline) != sorted(set(site.baseline)):
        yield "baseline", "expected a sorted set"
    for number, kind in enumerate(site.baseline):
        model = site.vocabulary.get(kind)
        if model is None:
            yield f"baseline[{number}]", f"expected an action type of the vocabulary, got `{kind}`"
        elif model != ActionModel(fields=()):
            yield (
                f"baseline[{number}]",
                f"expected a type without fields, parameters and flags, got `{kind}`",
            )
