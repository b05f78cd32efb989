# SPDX-License-Identifier: Apache-2.0
"""A safety configuration as people write it: quantities with units, the site's own words.

What the form leaves out is as the robot's own envelope has it.
Spec page: docs/spec/safety.md#as-people-write-it
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import yaml
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.names import unknown
from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.gate_peers import user_number
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Identifier,
    ObjectId,
    RegionId,
    RobotId,
)
from authguard_r.core.reasons import Reason
from authguard_r.safety import Rule, SafetyConfig, default_config
from authguard_r.safety.config import Executable, Line, SocketPath
from authguard_r.safety.temporal.atoms import unknown_name
from authguard_r.safety.temporal.rules import compile_rules
from authguard_r.site.formatting import quantity
from authguard_r.site.model import Site, facts_of
from authguard_r.site.source import convert

#: The bounds as people write them: name, the signed field, its unit.
BOUNDS = (
    ("max_speed", "max_speed_mm_s", "mm/s"),
    ("max_force", "max_force_mn", "mN"),
    ("max_payload", "max_payload_g", "g"),
    ("human_distance", "human_distance_mm", "mm"),
    ("human_speed", "human_speed_mm_s", "mm/s"),
    ("max_age", "max_age_ms", "ms"),
)
#: The same by id of a thing: name, the signed field, its unit.
TABLES = (("masses", "masses_g", "g"), ("paced", "paced", "mm/s"))
_PLAIN = ("id", "version", "executable", "rules")
_SETS = ("keep_out", "in_place")


class CheckerForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Another process that has to agree, as people write it.

    Args:
        id: its name in findings.
        socket: where it listens.
        timeout: as `50 ms`.
        uid: the user that it runs as, a name or a number on the gate's machine; left out: the
            gate's own.
    """

    id: Identifier
    socket: SocketPath
    timeout: Quantity
    uid: Line | int | None = None


class SafetyForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A configuration as people write it; see `safety.SafetyConfig`.

    What is left out is as in `safety.default_config`. A list or table that is there is the whole
    of it: nothing is added to the robot's own. The profile is that of the robot at the site.
    """

    robot: RobotId
    id: Identifier | None = None
    version: Count | None = None
    max_speed: Quantity | None = None
    max_force: Quantity | None = None
    max_payload: Quantity | None = None
    human_distance: Quantity | None = None
    human_speed: Quantity | None = None
    max_age: Quantity | None = None
    masses: dict[ObjectId, Quantity] | None = None
    keep_out: tuple[RegionId, ...] | None = None
    executable: tuple[Executable, ...] | None = None
    paced: dict[ActionType, Quantity] | None = None
    in_place: tuple[ActionType, ...] | None = None
    rules: tuple[Rule, ...] | None = None
    checker: CheckerForm | None = None


def own_envelope(site: Site, robot: str, *, where: str) -> SafetyConfig:
    """Return the envelope of the robot's own profile.

    Raises:
        MalformedError: the site has no such robot.
    """
    if robot not in site.robots:
        raise unknown(robot, "robot", site.robots, where=where)
    return replace(default_config(site, RobotId(robot)), version=site.version)  # to be signed


def read_form(form: SafetyForm, site: Site, *, where: str) -> SafetyConfig:
    """Return what people wrote as it is signed: quantities in units, sets sorted.

    Args:
        form: what they wrote.
        site: gives the words their meaning, and the robot its own envelope.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: a word that the site does not know, a bound that cannot be, a rule that
            cannot be followed, a user that this machine does not know.
        ClarificationError: a quantity without its unit.
    """
    own = own_envelope(site, form.robot, where=f"{where}:robot")
    given: dict[str, Any] = {name: getattr(form, name) for name in _PLAIN}
    for name in _SETS:
        listed = getattr(form, name)
        given[name] = None if listed is None else sorted(set(listed))
    for name, field, unit in BOUNDS:
        given[field] = _integer(getattr(form, name), unit, f"{where}:{name}")
    for name, field, unit in TABLES:
        table = getattr(form, name)
        if table is not None:
            given[field] = {
                item: to_integer(value, unit, where=f"{where}:{name}.{item}")
                for item, value in table.items()
            }
    if form.checker is not None:
        given["checker"] = _checker(form.checker, where=f"{where}:checker")
    said = to_builtins({field: value for field, value in given.items() if value is not None})
    config = convert({**to_builtins(own), **said}, SafetyConfig, where=where)
    _require_known(form, site, own, where=where)
    _require_rules(config, site, where=where)
    return config


def written(own: SafetyConfig) -> str:
    """Return an envelope, which has neither rules nor a checker, as people edit it."""
    plain: dict[str, Any] = {"robot": own.rid, "id": own.id, "version": own.version}
    plain |= {name: _spelled(getattr(own, field), unit) for name, field, unit in BOUNDS}
    plain |= {
        name: {item: _spelled(value, unit) for item, value in getattr(own, field).items()}
        for name, field, unit in TABLES
    }
    fields = ("keep_out", "executable", "in_place")
    plain |= {name: to_builtins(getattr(own, name)) for name in fields}
    plain |= {"rules": [], "checker": None}
    return str(yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=100))


def _spelled(value: int, unit: str) -> str:
    """Return a quantity as people write it; a time in the unit that it is signed in."""
    return f"{value} ms" if unit == "ms" else quantity(value, unit)


def _integer(value: Quantity | None, unit: str, where: str) -> int | None:
    return None if value is None else to_integer(value, unit, where=where)


def _checker(form: CheckerForm, *, where: str) -> dict[str, Any]:
    return {
        "id": form.id,
        "socket": form.socket,
        "timeout_ms": to_integer(form.timeout, "ms", where=f"{where}.timeout"),
        "uid": None if form.uid is None else user_number(form.uid, where=f"{where}.uid"),
    }


def _require_known(form: SafetyForm, site: Site, own: SafetyConfig, *, where: str) -> None:
    """Refuse words that the site does not have: a slip of the pen would protect nothing."""
    for place, word, known, what in _named(form, site, own):
        if word not in known:
            raise unknown(word, what, known, where=f"{where}:{place}")


def _named(
    form: SafetyForm, site: Site, own: SafetyConfig
) -> Iterator[tuple[str, str, Collection[str], str]]:
    """Yield each word of the site: where it stands, it, those that there are, what is meant."""
    kinds, what = site.vocabulary, "action type"
    # the robot's own envelope speaks of `pick` and `place`, also at a site that has neither
    able = {*kinds, *(rule.type for rule in own.executable)}
    for region in form.keep_out or ():
        yield "keep_out", region, site.regions, "region"
    for item in form.masses or ():
        yield "masses", item, site.objects, "object"
    for number, rule in enumerate(form.executable or ()):
        yield f"executable[{number}].type", rule.type, able, what
    for kind in form.paced or ():
        yield "paced", kind, kinds, what
    for kind in form.in_place or ():
        yield "in_place", kind, kinds, what


def _require_rules(config: SafetyConfig, site: Site, *, where: str) -> None:
    """Refuse rules that no gate would follow, and those of words that the site does not have."""
    try:
        rules = compile_rules(config.rules)
    except MalformedError as error:
        place = error.where.removeprefix("safety.")
        raise MalformedError(
            error.message, where=f"{where}:{place}", reason=error.reason
        ) from error
    facts = facts_of(site, rid=config.rid, profile=config.profile)
    for number, rule in enumerate(rules):
        for atom in rule.track.atoms:
            if unknown_name(atom, facts):
                raise MalformedError(
                    f"expected names that the site has, got `{atom}`",
                    where=f"{where}:rules[{number}].formula",
                    reason=Reason.NAME_UNKNOWN,
                )
