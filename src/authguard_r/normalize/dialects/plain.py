# SPDX-License-Identifier: Apache-2.0
"""The two dialects of our own: bare JSON and call text. What each says, nothing can say otherwise.

Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from typing import Any

from authguard_r.normalize.dialects.call import Call, expect, expect_fields
from authguard_r.normalize.parse import read_calls


def read_bare(value: Any) -> tuple[Call, ...]:
    """Return the calls of `{"tool", "arguments"}`, a list of these, or `{"plan": ...}` with either.

    Args:
        value: the plan as strict JSON spells it; untrusted.

    Raises:
        MalformedError: any other shape, or any other key.
    """
    where = "input"
    if isinstance(value, dict) and value.keys() == {"plan"}:
        value, where = value["plan"], "plan"
    if isinstance(value, dict):
        return (_bare_call(value, where),)
    items = expect(value, list, where)
    return tuple([_bare_call(item, f"{where}[{n}]") for n, item in enumerate(items)])


def _bare_call(item: Any, where: str) -> Call:
    call = expect(item, dict, where)
    expect_fields(call, {"tool", "arguments"}, where)
    name = expect(call.get("tool"), str, f"{where}.tool")
    return Call(name, expect(call.get("arguments"), dict, f"{where}.arguments"), where)


def read_call_text(text: str) -> tuple[Call, ...]:
    """Return the calls of `navigate_to(destination="Dock", speed=0.8)` text, one after the other.

    Raises:
        MalformedError: with the offset of the first thing that is no such call.
    """
    return tuple(Call(name, arguments, where) for name, arguments, where in read_calls(text))
