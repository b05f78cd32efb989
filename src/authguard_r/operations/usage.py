# SPDX-License-Identifier: Apache-2.0
"""What the parser of a command line minds, in our words: what is wrong, and where.

Spec page: docs/reference/cli.md#exit-codes
"""

from __future__ import annotations

from typer.exceptions import TyperException

_NO_INTEGER = "Input should be a valid integer, unable to parse string as an integer"


def message_of(error: TyperException) -> str:
    """Return what is wrong with the usage, on one line and without the parser's own words."""
    show = getattr(error, "format_message", error.__str__)
    text = " ".join(show().split()).replace(": Value error, ", ": ")
    return text.replace(_NO_INTEGER, "expected a whole number")


def place_of(error: TyperException) -> str:
    """Return the option as it is typed, or the argument as `--help` calls it."""
    param = getattr(error, "param", None)
    if param is None:
        return str(getattr(error, "param_hint", None) or "")
    spelled = [name for name in param.opts if name.startswith("--")]
    return spelled[0] if spelled else str(param.metavar or param.name or "").upper()
