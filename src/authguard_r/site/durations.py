# SPDX-License-Identifier: Apache-2.0
"""Integers with a unit as people read them: durations and decimals."""

from __future__ import annotations


def duration(value: int) -> str:
    """Return milliseconds as hours, minutes and seconds: 180000 is `3 min`."""
    hours, rest = divmod(abs(value), 3_600_000)
    minutes, rest = divmod(rest, 60_000)
    parts = [f"{hours} h"] * bool(hours) + [f"{minutes} min"] * bool(minutes)
    if rest or not parts:
        parts.append(f"{decimal(rest, 3)} s")
    return "-" * (value < 0) + " ".join(parts)


def decimal(value: int, power: int) -> str:
    """Return the value divided by a power of ten, every digit of it."""
    whole, rest = divmod(abs(value), 10**power)
    digits = f"{rest:0{power}}".rstrip("0") if rest else ""
    return "-" * (value < 0) + str(whole) + (f".{digits}" if digits else "")
