# SPDX-License-Identifier: Apache-2.0
"""One byte string per object, one object per byte string, one tag per kind.

`Encode` is RFC 8785. Signers call `encode`; the hot path calls `encode_fast`, which a property
test holds byte-equal to `encode` on everything that signed data can hold. A decoder accepts
exactly the bytes that the encoder writes: it decodes, encodes again and compares.

Source: `eq:signature`, section "Hash Function". Spec page: docs/spec/encoding.md
"""

from __future__ import annotations

from binascii import b2a_base64
from enum import StrEnum
from hashlib import sha256
from typing import Any, TypeVar, cast

import msgspec
import rfc8785

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason

#: Longest accepted object, in bytes: far above any mission, far below a memory problem.
MAX_BYTES = 1 << 20

T = TypeVar("T")
_FAST = msgspec.json.Encoder(order="sorted")
_URL_SAFE = bytes.maketrans(b"+/", b"-_")


class Tag(StrEnum):
    """Domain separation: a signature made for one kind of object never verifies for another."""

    def __init__(self, spelled: str) -> None:
        """Keep what is hashed in front of every object of this kind: tag || 0x00."""
        self.prefix = spelled.encode("ascii") + b"\0"

    MISSION = "authguard-r/mission/1"
    SELECTION = "authguard-r/selection/1"
    APPROVAL = "authguard-r/approval/1"
    PREAPPROVAL = "authguard-r/preapproval/1"
    REVOCATION = "authguard-r/revocation/1"
    COMMAND = "authguard-r/command/1"
    SITE = "authguard-r/site/1"
    BINDING = "authguard-r/binding/1"
    PROFILE = "authguard-r/profile/1"
    SAFETY = "authguard-r/safety/1"
    RISK_POLICY = "authguard-r/risk-policy/1"
    EMERGENCY_POLICY = "authguard-r/emergency-policy/1"
    STATE = "authguard-r/state/1"
    AUDIT = "authguard-r/audit/1"
    CHECKPOINT = "authguard-r/checkpoint/1"
    GATE = "authguard-r/gate/1"
    HANDSHAKE = "authguard-r/handshake/1"
    TEMPLATE = "authguard-r/template/1"
    INSTANCE = "authguard-r/instance/1"
    # digests that are compared or chained but never signed by themselves
    ACTION = "authguard-r/action/1"
    SCOPE = "authguard-r/action-scope/1"
    SITUATION = "authguard-r/situation/1"
    EVIDENCE = "authguard-r/evidence/1"
    COMMITMENT = "authguard-r/commitment/1"
    RAW = "authguard-r/raw/1"


def encode(value: object) -> bytes:
    """Return the RFC 8785 bytes of a struct or of plain data.

    Raises:
        TypeError: the value holds something that signed data cannot (a float, a null).
    """
    return rfc8785.dumps(_plain(msgspec.to_builtins(value)))


def encode_fast(value: object) -> bytes:
    """Return the same bytes as `encode`, an order of magnitude sooner."""
    return _FAST.encode(value)


def digest(tag: Tag, data: bytes) -> Digest:
    """Return H(tag || 0x00 || data), the value that is signed, bound and chained."""
    return Digest(b64(sha256(tag.prefix + data).digest()))


def digest_of(tag: Tag, value: object) -> Digest:
    """Return the digest of an object's canonical bytes under its tag."""
    return digest(tag, encode_fast(value))


def decode(data: bytes, kind: type[T], *, where: str = "") -> T:
    """Return the object whose canonical encoding is exactly `data`.

    Args:
        data: bytes from anyone.
        kind: the struct that they must spell; unknown fields are refused by its declaration.
        where: prefix of the place in messages.

    Raises:
        MalformedError: on any other bytes at all, with the place; duplicate keys, white space,
            escapes, explicit defaults and the like are `NOT_CANONICAL`.
    """
    if len(data) > MAX_BYTES:
        raise MalformedError(f"expected at most {MAX_BYTES} bytes, got {len(data)}", where=where)
    try:
        value = msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        message, place = _place(str(error), where)
        raise MalformedError(message, where=place) from error
    if _FAST.encode(value) != data:
        message = "the bytes are not the canonical encoding of their content"
        raise MalformedError(message, where=where, reason=Reason.NOT_CANONICAL)
    return value


def b64(data: bytes) -> str:
    """Return base64url without padding."""
    return b2a_base64(data, newline=False).translate(_URL_SAFE, b"=").decode("ascii")


def unb64(text: str, *, where: str = "") -> bytes:
    """Return the bytes that `text` spells, refusing every second spelling of the same bytes.

    Raises:
        MalformedError: not base64url, padded, or with stray bits at the end.
    """
    fault = "expected base64url without padding"
    # what only base64 has becomes a space, which the reader refuses like anything else
    spelled = text.replace("+", " ").replace("/", " ").replace("=", " ")
    spelled = spelled.replace("-", "+").replace("_", "/") + "=" * (-len(text) % 4)
    try:
        data = msgspec.convert(spelled, bytes)
    except (msgspec.ValidationError, UnicodeEncodeError) as error:
        raise MalformedError(fault, where=where) from error
    odd = len(data) % 3  # only the bytes of an unfinished group of three have a second spelling
    if odd and b64(data[-odd:]) != text[-odd - 1 :]:
        raise MalformedError(fault, where=where, reason=Reason.NOT_CANONICAL)
    return data


def _place(message: str, where: str) -> tuple[str, str]:
    """Split msgspec's ``... - at `$.a[2].b` `` into the text and the place."""
    text, _, place = message.partition(" - at ")
    place = place.strip("`").removeprefix("$").removeprefix(".")
    joined = f"{where}.{place}" if where and place else where or place
    return (text if text[1:2].isupper() else text[:1].lower() + text[1:]), joined


def _plain(value: Any) -> Any:
    """Refuse what RFC 8785 would spell but signed data must not hold."""
    if isinstance(value, dict):
        items = cast("dict[str, Any]", value).items()
        return {key: _plain(item) for key, item in items}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in cast("list[Any]", value)]
    if isinstance(value, str | bool | int):
        return value
    raise TypeError(f"signed data cannot contain a {type(value).__name__}")
