# SPDX-License-Identifier: Apache-2.0
"""Replies of planners in every format, with the calls that each means."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import msgspec

from fixtures.reply_formats import READ, REFUSED, Reply

Json = dict[str, Any]


def reply_vectors() -> Json:
    """Whole replies, with the calls that they mean or the refusal and its place."""
    return {"vectors": [_vector(one) for one in (*READ, *REFUSED)]}


def _vector(one: Reply) -> Json:
    if one.calls is None:
        expect: Json = {"refusal": {"reason": str(one.reason), "where": one.where}}
    else:
        calls = [{"tool": tool, "arguments": _plain(arguments)} for tool, arguments in one.calls]
        expect = {"dialect": one.dialect, "around": one.around, "calls": calls}
    form = {} if one.form is None else {"reply": msgspec.to_builtins(one.form)}
    return {"name": one.name, "raw": one.text, **form, "expect": expect}


def _plain(arguments: Json) -> Json:
    """Return arguments with each exact decimal as `{"decimal": TEXT}`."""
    return {n: {"decimal": str(v)} if isinstance(v, Decimal) else v for n, v in arguments.items()}
