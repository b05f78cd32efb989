# SPDX-License-Identifier: Apache-2.0
"""The units that a signed integer can have: how its name ends, and the power of ten to the SI unit.

A reader of a mission sees `speed_mm_s` and 800. What that is in the world must follow from the name
alone, so the unit that the site writes down is held to the name: one table says both.
Spec page: docs/spec/site-model.md#units
"""

from __future__ import annotations

from msgspec import Struct


class Unit(Struct, frozen=True, kw_only=True):
    """One unit of signed data.

    Args:
        ending: how the name of a quantity in this unit ends.
        name: the unit as a site writes it.
        base: the coherent SI unit it is a power of ten of; `1` for a number without dimension,
            `byte` and `L` for what SI has no unit of its own for.
        power: one of the unit is 10^`power` of the base.
    """

    ending: str
    name: str
    base: str
    power: int


def _unit(ending: str, name: str, base: str, power: int) -> Unit:
    return Unit(ending=ending, name=name, base=base, power=power)


#: Every unit; a longer ending comes before one that it ends with (`mm_s2`, `mm_s`).
UNITS: tuple[Unit, ...] = (
    _unit("mm_s2", "mm/s2", "m/s2", -3),
    _unit("mm_s", "mm/s", "m/s", -3),
    _unit("mm", "mm", "m", -3),
    _unit("urad_s", "microradian/s", "rad/s", -6),
    _unit("urad", "microradian", "rad", -6),
    _unit("ms", "ms", "s", -3),
    _unit("mn", "mN", "N", -3),
    _unit("g", "g", "kg", -3),
    _unit("mk", "millikelvin", "K", -3),
    _unit("ml", "milliliter", "L", -3),
    _unit("bytes", "byte", "byte", 0),
    _unit("permille", "permille", "1", -3),
    _unit("milli", "permille", "1", -3),
    _unit("no", "count", "1", 0),
    _unit("count", "count", "1", 0),
)


def unit_of(name: str) -> Unit | None:
    """Return the unit that a parameter's name says it has, None when it says none.

    The ending is a word of the name, after `_`: `max_bytes` has one, `programs` does not end in
    `ms`. The ending alone is a name too (`bytes`).
    """
    return next(
        (unit for unit in UNITS if name == unit.ending or name.endswith(f"_{unit.ending}")), None
    )


def unit_fault(name: str, unit: str) -> str | None:
    """Return what is expected of a parameter's unit, None when it is what the name says.

    Args:
        name: the parameter's id.
        unit: the unit that the site writes for it.
    """
    meant = unit_of(name)
    if meant is None:
        endings = ", ".join(f"_{known.ending}" for known in UNITS)
        return f"expected a name that ends in its unit ({endings})"
    if unit != meant.name:
        return f"expected `{meant.name}`, as the name ends in `{meant.ending}`"
    return None
