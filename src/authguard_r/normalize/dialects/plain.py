# SPDX-License-Identifier: Apache-2.0
"""The two dialects of our own: bare JSON and call text. What each says, nothing can say otherwise.

Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct

from authguard_r.normalize.dialects.call import Call, expect, expect_fields, items_of, numbered
from authguard_r.normalize.parse import read_calls


class ReplyForm(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Which keys of a planner's JSON mean what, as a binding declares them.

    Args:
        list: the key of the steps, or of one; empty: the reply is the list, or the step, itself.
        tool: the key of a step's tool.
        arguments: the key of its arguments; empty: they stand beside the tool.
        text: keys with free text for people, beside the steps or within them.
    """

    list: str = ""
    tool: str = "tool"
    arguments: str = "arguments"
    text: tuple[str, ...] = ()

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield the place and the message of every fault: each key has one meaning."""
        names = [name for name in (self.list, self.tool, self.arguments, *self.text) if name]
        if not self.tool:
            yield "reply.tool", "expected the key of a step's tool"
        if len(set(names)) < len(names):
            yield "reply", "expected each key once"


def read_bare(value: Any) -> tuple[Call, ...]:
    """Return the calls of `{"tool", "arguments"}`, a list of these, or `{"plan": ...}` with either.

    A call may also be `{"name", "arguments"}` or `{"name", "parameters"}`, as models without tags
    write it.

    Args:
        value: the plan as strict JSON spells it; untrusted.

    Raises:
        MalformedError: any other shape, or any other key.
    """
    where = "input"
    if isinstance(value, dict) and "plan" in value:
        expect_fields(value, {"plan"}, where)
        value, where = value["plan"], "plan"
    if isinstance(value, dict):
        return (_bare_call(value, where),)
    items = expect(value, list, where)
    return tuple([_bare_call(item, f"{where}[{n}]") for n, item in enumerate(items)])


def _bare_call(item: Any, where: str) -> Call:
    call = expect(item, dict, where)
    if "name" in call and "tool" not in call:
        arguments = "parameters" if "parameters" in call else "arguments"
        return _call(call, "name", arguments, where)
    return _call(call, "tool", "arguments", where)


def _call(call: dict[str, Any], tool: str, arguments: str, where: str) -> Call:
    expect_fields(call, {tool, arguments}, where)
    named = f"{where}.{tool}"
    name = expect(call.get(tool), str, named)
    return Call(name, _arguments(call.get(arguments), f"{where}.{arguments}"), where, named)


def _arguments(value: Any, where: str) -> dict[str, Any]:
    """Return arguments by name; those of a list by their positions."""
    found: dict[str, Any] = (
        numbered(value) if isinstance(value, list) else expect(value, dict, where)
    )
    return found


def read_declared(value: Any, form: ReplyForm) -> tuple[Call, ...]:
    """Return the calls of a reply in the form that a binding declares.

    Args:
        value: the reply as strict JSON spells it; untrusted.
        form: which keys mean what.

    Raises:
        MalformedError: another key, or free text that is no text.
    """
    where = "input"
    if isinstance(value, dict) and form.list and form.list in value:
        expect_fields(value, {form.list, *form.text}, where)
        _expect_texts(value, form, where)
        value, where = value[form.list], form.list
    if isinstance(value, dict):
        return (_declared_call(value, form, where),)
    return tuple(_declared_call(item, form, place) for item, place in items_of(value, where))


def _declared_call(item: dict[str, Any], form: ReplyForm, where: str) -> Call:
    named = f"{where}.{form.tool}"
    name = expect(item.get(form.tool), str, named)
    _expect_texts(item, form, where)
    if not form.arguments:
        beside = {form.tool, *form.text}
        return Call(name, {k: v for k, v in item.items() if k not in beside}, where, named)
    expect_fields(item, {form.tool, form.arguments, *form.text}, where)
    place = f"{where}.{form.arguments}"
    return Call(name, _arguments(item.get(form.arguments), place), place, named)


def _expect_texts(item: dict[str, Any], form: ReplyForm, where: str) -> None:
    for name in form.text:
        if item.get(name) is not None:
            expect(item[name], str, f"{where}.{name}")


def read_call_text(text: str) -> tuple[Call, ...]:
    """Return the calls of `navigate_to(destination="Dock", speed=0.8)` text, one after the other.

    Raises:
        MalformedError: with the offset of the first thing that is no such call.
    """
    return tuple(Call(name, arguments, where) for name, arguments, where in read_calls(text))
