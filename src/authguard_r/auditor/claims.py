# SPDX-License-Identifier: Apache-2.0
"""What the tokens in a log claim: read, and held to no signature.

Good enough for words about a record, and for a replay that was given no trust folder; it says so.
Spec page: docs/spec/audit-record.md#kinds
"""

from __future__ import annotations

from typing import Any, TypeVar

from authguard_r.core.encoding import Tag
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.token import read_token
from authguard_r.enforcement.templates import claimed as claimed_token
from authguard_r.enforcement.templates import claimed_mission as mission_of

T = TypeVar("T")


def claimed(token: Any, kind: type[T], *, tag: Tag) -> T:
    """Return what a token says; its signature is not checked.

    Raises:
        MalformedError: no canonical token of this kind.
    """
    return claimed_token(as_token(token), kind, tag=tag)


def as_token(value: Any) -> bytes:
    """Return a token's bytes out of the value that was sealed.

    Raises:
        MalformedError: it is no text.
    """
    if not isinstance(value, str):
        raise MalformedError("expected a token", where="token")
    return value.encode("utf-8")


def is_instance(values: dict[str, Any]) -> bool:
    """True when an activation was that of a template's instance.

    Raises:
        MalformedError: it holds no token.
    """
    return read_token(as_token(values.get("token"))).kind is Tag.INSTANCE


def claimed_mission(values: dict[str, Any]) -> Mission:
    """Return the mission that an activation made active.

    Args:
        values: what the activation's record sealed: `token`, of an instance also `template`.

    Raises:
        AuthGuardError: they make no mission.
    """
    token = as_token(values.get("token"))
    template = as_token(values.get("template")) if is_instance(values) else None
    return mission_of(token, template)
