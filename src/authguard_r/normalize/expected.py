# SPDX-License-Identifier: Apache-2.0
"""What a tool's answer is held to: success is declared and matched, never assumed.

Spec page: docs/spec/binding.md#answers
"""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Any

from msgspec import Struct

from authguard_r.core.identifiers import Integer

#: A number of at most 20 characters with one spelling: `0.1`, `-2.5`.
DECIMAL = re.compile(r"(?=.{1,20}\Z)-?(?:0|[1-9][0-9]*)\.[0-9]*[1-9]")
#: Numbers in a text: at most 40 characters, and no part of a word or of a longer one.
_NUMBERS = re.compile(r"(?<![\w.\u2212-])-?[0-9]{1,20}(?:\.[0-9]{1,20})?(?![\w]|\.[0-9])")
#: What a planner's tool holds constant: a word, a whole number, a truth value.
Constant = bool | Integer | str
#: In the place of a path: the words of a tool's answer, one item after the other.
TEXT = "$text"


class AnswerMatch(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """What a text, or a number, of a tool's answer has to be; all that is said has to hold.

    Args:
        equals: the whole text, without the white space around it.
        starts_with: how it begins, without the white space before it.
        contains: what stands somewhere in it.
        at_least: the least number, as an exact decimal (`0.5`); of a text, the one number in it.
        at_most: the greatest number.
    """

    equals: str = ""
    starts_with: str = ""
    contains: str = ""
    at_least: Integer | str | None = None
    at_most: Integer | str | None = None


class Expected(Struct, frozen=True):
    """What the answer of a call is held to (`ToolBinding.succeeds` and `.fails`)."""

    succeeds: dict[str, Constant | AnswerMatch] = {}
    fails: dict[str, Constant | AnswerMatch] = {}


def same(value: Any, constant: Constant | Decimal | None) -> bool:
    """True when a planner's value is exactly the constant: a truth value is never a number."""
    if isinstance(value, bool) or isinstance(constant, bool | str):
        return type(value) is type(constant) and bool(value == constant)
    return bool(value == constant)


def match_fault(path: str, match: Constant | AnswerMatch) -> str:
    """Return what is wrong with what a path is held to, empty when nothing is."""
    if not isinstance(match, AnswerMatch):
        return "" if path != TEXT else "expected `contains`, `starts_with`, `equals` or a range"
    if match == AnswerMatch():
        return "expected at least one of `contains`, `starts_with`, `equals`, `at_least`, `at_most`"
    if match.equals != match.equals.strip() or match.starts_with != match.starts_with.lstrip():
        return "expected no white space around it: that of the answer is not looked at"
    ends = [end for end in (match.at_least, match.at_most) if isinstance(end, str)]
    if not all(map(DECIMAL.fullmatch, ends)):
        return "expected a whole number, or an exact decimal such as `0.5`"
    return ""


def matches(value: Any, wanted: AnswerMatch) -> bool:
    """True of a text or a number that is as wanted; anything else, and none, is not."""
    text = value.strip() if isinstance(value, str) else None
    if wanted.equals or wanted.starts_with or wanted.contains:
        if text is None or (wanted.equals and text != wanted.equals):
            return False
        if not text.startswith(wanted.starts_with) or wanted.contains not in text:
            return False
    if wanted.at_least is None and wanted.at_most is None:
        return True
    number = _number(value if text is None else text)
    if number is None:
        return False
    low, high = wanted.at_least, wanted.at_most
    return (low is None or number >= Decimal(low)) and (high is None or number <= Decimal(high))


def _number(value: Any) -> Decimal | None:
    """Return a number, or the one number in a text; None for no number, or several."""
    if isinstance(value, str):
        found = _NUMBERS.findall(value)
        return Decimal(found[0]) if len(found) == 1 else None
    if isinstance(value, bool) or not isinstance(value, int | float | Decimal):
        return None
    number = Decimal(str(value))  # a float as it is written
    return number if number.is_finite() else None
