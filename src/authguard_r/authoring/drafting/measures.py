# SPDX-License-Identifier: Apache-2.0
"""Quantities and times of day as people say them, exactly, and never completed.

A number without its unit and a time without its date are returned as what they are, so that the
grammar can ask.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from enum import StrEnum
from fractions import Fraction

from msgspec import Struct

from authguard_r.authoring.drafting.tokens import SentenceToken, TokenKind
from authguard_r.core.quantities import to_timestamp


class QuantityDimension(StrEnum):
    """What a quantity measures; the value is the unit that the mission language counts in."""

    SPEED = "mm/s"
    FORCE = "mN"
    TIME = "ms"
    SHARE = "permille"
    BYTES = "byte"


class Measure(Struct, frozen=True):
    """A quantity with its unit.

    Args:
        text: as the draft spells it (`0.8 m/s`).
        dimension: what it measures.
        amount: exactly, in the dimension's unit.
        size: its length in tokens.
    """

    text: str
    dimension: QuantityDimension
    amount: Fraction
    size: int


class Daytime(Struct, frozen=True):
    """A time of day, perhaps with its day and zone.

    Args:
        hours: the hours that it can mean: `2` is 2 and 14.
        minute: the minute.
        day: days from today, None when it was not said.
        utc: the zone was said.
        size: its length in tokens.
    """

    hours: tuple[int, ...]
    minute: int
    size: int
    day: int | None = None
    utc: bool = False


_UNITS: dict[str, tuple[str, QuantityDimension, Fraction]] = {
    word: (spelled, dimension, Fraction(factor))
    for words, spelled, dimension, factor in (
        (
            "m/s meter/second meters/second metre/second metres/second",
            "m/s",
            QuantityDimension.SPEED,
            1000,
        ),
        ("cm/s centimeters/second", "cm/s", QuantityDimension.SPEED, 10),
        ("mm/s millimeters/second", "mm/s", QuantityDimension.SPEED, 1),
        ("km/h kilometer/hour kilometers/hour", "km/h", QuantityDimension.SPEED, Fraction(2500, 9)),
        ("n newton newtons", "N", QuantityDimension.FORCE, 1000),
        ("mn millinewton millinewtons", "mN", QuantityDimension.FORCE, 1),
        ("ms millisecond milliseconds", "ms", QuantityDimension.TIME, 1),
        ("s sec secs second seconds", "s", QuantityDimension.TIME, 1000),
        ("min mins minute minutes", "min", QuantityDimension.TIME, 60_000),
        ("h hr hrs hour hours", "h", QuantityDimension.TIME, 3_600_000),
        ("% percent", "%", QuantityDimension.SHARE, 10),
        ("permille", "permille", QuantityDimension.SHARE, 1),
        ("b byte bytes", "byte", QuantityDimension.BYTES, 1),
        ("kb", "kB", QuantityDimension.BYTES, 1000),
        ("mb", "MB", QuantityDimension.BYTES, 1_000_000),
    )
    for word in words.split()
}
_ONES = (
    *("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine"),
    *("ten", "eleven", "twelve", "thirteen", "fourteen", "fifteen", "sixteen"),
    *("seventeen", "eighteen", "nineteen"),
)
_TENS = {"twenty": 20, "thirty": 30, "forty": 40, "fifty": 50, "sixty": 60}
_WHOLE_DAYS = {"today": 0, "tonight": 0, "tomorrow": 1}


def read_number(tokens: tuple[SentenceToken, ...], at: int) -> tuple[str, int] | None:
    """Return a number in digits or words as digits, and its length in tokens; or None."""
    if at >= len(tokens):
        return None
    token = tokens[at]
    if token.kind is TokenKind.NUMBER:
        return token.text, 1
    if token.low in _ONES:
        return str(_ONES.index(token.low)), 1
    if token.low in _TENS:
        after = tokens[at + 1].low if at + 1 < len(tokens) else ""
        if after in _ONES[1:10]:
            return str(_TENS[token.low] + _ONES.index(after)), 2
        return str(_TENS[token.low]), 1
    return None


def read_measure(tokens: tuple[SentenceToken, ...], at: int) -> Measure | None:
    """Return the quantity that starts at a token, or None when there is no number with a unit."""
    number = read_number(tokens, at)
    if number is None:
        return None
    digits, size = number
    for length in (3, 1):
        words = [token.low for token in tokens[at + size : at + size + length]]
        unit = _UNITS.get("".join(words).replace("per", "/") if length == 3 else "".join(words))
        if unit is not None and len(words) == length:
            spelled, dimension, factor = unit
            amount = Fraction(digits) * factor
            return Measure(f"{digits} {spelled}", dimension, amount, size + length)
    return None


def read_measure_text(text: str, tokens: tuple[SentenceToken, ...]) -> Measure | None:
    """Return the quantity that is the whole of a text, or None."""
    found = read_measure(tokens, 0)
    return found if found is not None and text and found.size == len(tokens) else None


def read_daytime(tokens: tuple[SentenceToken, ...], at: int) -> Daytime | None:
    """Return the time of day that starts at a token, or None."""
    found = _named_time(tokens, at) or _spoken_time(tokens, at) or _clock_time(tokens, at)
    if found is None:
        return None
    end = at + found.size
    day, utc = found.day, found.utc
    while end < len(tokens):
        if tokens[end].low in _WHOLE_DAYS and day is None:
            day = _WHOLE_DAYS[tokens[end].low]
        elif tokens[end].low in {"utc", "z"} and not utc:
            utc = True
        else:
            break
        end += 1
    return Daytime(found.hours, found.minute, end - at, day, utc)


def instants(time: Daytime, *, now_ms: int) -> tuple[str, ...]:
    """Return every instant still to come that the time can mean, today and tomorrow, in UTC."""
    today = datetime.fromtimestamp(now_ms // 1000, UTC).replace(
        hour=0, minute=0, second=0, microsecond=0
    )
    days = (0, 1) if time.day is None else (time.day,)
    moments = [
        today + timedelta(days=day, hours=hour, minutes=time.minute)
        for day in days
        for hour in time.hours
    ]
    found = [int(moment.timestamp()) * 1000 for moment in moments]
    return tuple(str(to_timestamp(moment)) for moment in sorted(found) if moment > now_ms)


def _named_time(tokens: tuple[SentenceToken, ...], at: int) -> Daytime | None:
    low = tokens[at].low if at < len(tokens) else ""
    hours = {"noon": (12,), "midday": (12,), "midnight": (24,)}.get(low)
    return None if hours is None else Daytime(hours, 0, 1)


def _spoken_time(tokens: tuple[SentenceToken, ...], at: int) -> Daytime | None:
    """Read `half past two`, `quarter to three`, `ten past four`."""
    low = tokens[at].low if at < len(tokens) else ""
    first = {"half": ("30", 1), "quarter": ("15", 1)}.get(low) or read_number(tokens, at)
    if first is None or not first[0].isdigit():
        return None
    middle = at + first[1]
    word = tokens[middle].low if middle < len(tokens) else ""
    hour = read_number(tokens, middle + 1)
    if word not in {"past", "to"} or hour is None or not hour[0].isdigit():
        return None
    whole, minute = int(hour[0]), int(first[0])
    if not (1 <= whole <= 12 and 1 <= minute <= 59):
        return None
    size = first[1] + 1 + hour[1]
    if word == "past":
        return _half_day(tokens, at, Daytime((whole % 12, whole % 12 + 12), minute, size))
    before = (whole - 1) % 12
    return _half_day(tokens, at, Daytime((before, before + 12), 60 - minute, size))


def _clock_time(tokens: tuple[SentenceToken, ...], at: int) -> Daytime | None:
    """Read `14:30`, `2:30 pm`, `2 pm`, `2 o'clock` and a bare `2`."""
    if at < len(tokens) and tokens[at].kind is TokenKind.CLOCK:
        hour, minute = (int(part) for part in tokens[at].text.split(":"))
        size = 1
    else:
        number = read_number(tokens, at)
        if number is None or not number[0].isdigit() or len(number[0]) > 2:
            return None
        hour, minute, size = int(number[0]), 0, number[1]
        if at + size < len(tokens) and tokens[at + size].low.replace("\u2019", "'") == "o'clock":
            size += 1
    if hour > 24 or minute > 59 or (hour == 24 and minute):
        return None
    written = tokens[at].text.startswith("0") or not 1 <= hour <= 12
    hours = (hour,) if written else (hour % 12, hour % 12 + 12)
    return _half_day(tokens, at, Daytime(hours, minute, size))


def _half_day(tokens: tuple[SentenceToken, ...], at: int, time: Daytime) -> Daytime:
    """Take in a following `am` or `pm`."""
    after = [token.low for token in tokens[at + time.size : at + time.size + 4]]
    for words, late in (
        (["pm"], 1),
        (["am"], 0),
        (["p", ".", "m", "."], 1),
        (["a", ".", "m", "."], 0),
    ):
        if after[: len(words)] == words and len(time.hours) == 2:
            return Daytime((time.hours[late],), time.minute, time.size + len(words))
    return time
