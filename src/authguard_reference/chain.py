# SPDX-License-Identifier: Apache-2.0
"""Canonical bytes, tagged digests (`eq:signature`) and the audit link (`eq:log`)."""

import base64
import hashlib
import json
from typing import Any

#: RFC 8785 writes numbers as ECMAScript doubles do; beyond this an int is not exact there.
LARGEST_INT = 2**53 - 1


def canonical(value: Any) -> bytes:
    """Encode a value as RFC 8785 does, for the restricted domain.

    Args:
        value: A dict with ASCII text keys, list, int, bool or text, nested at will.

    Returns:
        The canonical JSON in UTF-8.

    Raises:
        ValueError: If the value holds anything else (a float, None, a tuple, a huge int).
    """
    return _text(value).encode("utf-8")


def _text(value: Any) -> str:
    if type(value) is bool:
        return "true" if value else "false"
    if type(value) is int:
        if abs(value) > LARGEST_INT:
            raise ValueError("an int outside the exact range of RFC 8785")
        return str(value)
    if type(value) is str:
        # Python's escapes are those of RFC 8785 once non-ASCII text is left as it is.
        return json.dumps(value, ensure_ascii=False)
    if type(value) is list:
        return "[" + ",".join(_text(item) for item in value) + "]"
    if type(value) is dict:
        return "{" + ",".join(_member(key, value) for key in _sorted_keys(value)) + "}"
    raise ValueError(f"{type(value).__name__} has no place in the restricted domain")


def _sorted_keys(value: dict[Any, Any]) -> list[str]:
    for key in value:
        if type(key) is not str or not key.isascii():
            raise ValueError("a key that is not ASCII text")
    # For ASCII keys the UTF-16 order of RFC 8785 is the plain order.
    return sorted(value)


def _member(key: str, value: dict[Any, Any]) -> str:
    return _text(key) + ":" + _text(value[key])


def digest(tag: str, data: bytes) -> str:
    """Digest data under a domain-separating tag.

    Args:
        tag: The tag, ASCII.
        data: The bytes.

    Returns:
        SHA-256(tag, 0x00, data) in base64url without padding.
    """
    raw = hashlib.sha256(tag.encode("ascii") + b"\x00" + data).digest()
    return base64.urlsafe_b64encode(raw).decode("ascii").rstrip("=")


def link(fields: dict[str, Any]) -> str:
    """Compute one link L_i of the audit chain, `eq:log`.

    Args:
        fields: The record's fields, the previous link among them.

    Returns:
        SHA-256("authguard-r/audit/1", 0x00, canonical(fields)) in hexadecimal.
    """
    return hashlib.sha256(b"authguard-r/audit/1" + b"\x00" + canonical(fields)).hexdigest()
