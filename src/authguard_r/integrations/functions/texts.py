# SPDX-License-Identifier: Apache-2.0
"""What a model wrote as a call's arguments, and every text in what a framework's tool returned.

For frameworks that hand over the model's own text. Spec page: docs/spec/adapters.md#frameworks
"""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Any

from pydantic_core import to_jsonable_python

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.functions.values import words_of
from authguard_r.normalize.parse import read_json

#: How what a framework has for one call reaches the tool, beside what was decided.
BESIDE = "authguard_beside"


def arguments_in(text: str | bytes | bytearray) -> dict[str, Any]:
    """Return the arguments that a model wrote; an empty text is no arguments.

    Args:
        text: JSON; untrusted. What is in it twice is refused: two readers could take one each.

    Raises:
        MalformedError: no object of strict JSON.
    """
    try:
        plain = text if isinstance(text, str) else text.decode()
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where="arguments") from error
    found = read_json(plain, where="arguments") if plain.strip() else {}
    if not isinstance(found, dict):
        raise MalformedError("expected an object", where="arguments")
    arguments: dict[str, Any] = _binary(found)
    return arguments


def left_out(arguments: dict[str, Any], known: frozenset[str]) -> dict[str, None]:
    """Return the arguments that are there as null: how a strict schema leaves one out.

    They are no part of what is proposed; the tool has them as null where the binding gives them no
    value. One that the binding does not know is proposed, and refused.

    Args:
        arguments: as a model wrote them; untrusted.
        known: the arguments of the tool that the binding has.
    """
    return {name: None for name, value in arguments.items() if value is None and name in known}


def _binary(value: Any) -> Any:
    """Return a value with floats for decimals: what is proposed is what is decided on."""
    if isinstance(value, Decimal):
        return float(value)
    if isinstance(value, list):
        return [_binary(item) for item in value]
    if isinstance(value, dict):
        return {name: _binary(item) for name, item in value.items()}
    return value


def words_in(value: Any) -> tuple[str, ...]:
    """Return a value's words as one text, and each text in it as the model is shown it alone.

    Raises:
        Exception: what the value's own code raises.
    """
    plain = to_jsonable_python(value, fallback=str, bytes_mode="base64")
    return tuple(dict.fromkeys((*words_of(value), *words_of(plain), *_texts(plain))))


def _texts(plain: Any) -> Iterable[str]:
    if isinstance(plain, str):
        yield plain
    elif isinstance(plain, list):
        for item in plain:
            yield from _texts(item)
    elif isinstance(plain, dict):
        for name, item in plain.items():
            yield str(name)
            yield from _texts(item)
