# SPDX-License-Identifier: Apache-2.0
"""The profile: what a mission must settle and a sentence does not say, in one file that is shown.

A profile never names an object, a place, a person or a data right; its bounds are upper bounds
that the robot's own profile and the sentence only lower. How-to: docs/howto/drafting.md
"""

from __future__ import annotations

from fractions import Fraction
from importlib.resources import files
from typing import Annotated, Any

from msgspec import Meta, Struct

from authguard_r.authoring.drafting.measures import Measure, read_measure_text
from authguard_r.authoring.drafting.tokens import tokenize
from authguard_r.core.errors import MalformedError
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_yaml

_FILE = "defaults.yaml"
#: The profile that is used unless another one is named.
CONSERVATIVE = "conservative"
_Count = Annotated[int, Meta(ge=0, le=1000)]


class DraftProfile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One named set of defaults; the comments in the shipped file say what each is for."""

    place_max_age: str
    on_refusal: str
    retries: _Count
    looks: Annotated[int, Meta(ge=1, le=1000)]
    max: dict[str, str]
    slack: str
    limits: dict[str, tuple[str, str]]
    careful: dict[str, tuple[str, str]]
    guide_speed: str
    battery_low: Annotated[int, Meta(ge=1, le=1000)]
    guard_max_age: str
    holding_max_age: str
    closing: str
    avoid: tuple[str, ...]
    irreversible: tuple[str, ...]
    classes: dict[str, tuple[str, ...]]
    liquids: dict[str, int]
    budgets: dict[str, Any]
    risk_policy: dict[str, Any]


def read_profile(text: str | None = None, *, name: str = CONSERVATIVE) -> DraftProfile:
    """Return a named profile.

    Args:
        text: YAML, profiles by name, written by the user of the command; None is the shipped file.
        name: which one.

    Raises:
        MalformedError: no such profile, or one that is not whole.
    """
    where = "profile"
    if text is None:
        text, where = files(__package__).joinpath(_FILE).read_text(encoding="utf-8"), _FILE
    plain = read_yaml(text, where=where)
    profiles = convert(plain, dict[str, DraftProfile], where=where)
    if name not in profiles:
        raise MalformedError(f"expected one of {', '.join(sorted(profiles))}", where=where)
    return profiles[name]


def measure(text: str) -> Measure:
    """Return a quantity of a profile.

    Raises:
        MalformedError: not a number with a unit that the grammar knows.
    """
    found = read_measure_text(text, tokenize(text))
    if found is None:
        raise MalformedError(f"expected a number and a unit, got `{text}`", where="profile")
    return found


def bounds(profile: DraftProfile, parameter: str, *, careful: bool) -> tuple[str, str] | None:
    """Return the profile's bounds of a parameter, the tighter ones where care is asked for."""
    found = profile.limits.get(parameter)
    return profile.careful.get(parameter, found) if careful else found


def ceiling(site: Site, robot: str, parameter: str) -> Fraction | None:
    """Return what the robot's own profile allows at most, in the parameter's unit."""
    held = site.robots[robot].profile  # type: ignore[index]
    known = {"speed_mm_s": held.max_speed_mm_s, "force_mn": held.max_force_mn}
    found = known.get(parameter)
    return None if found is None else Fraction(found)
