# SPDX-License-Identifier: Apache-2.0
"""The keys of sealed fields in a log: each one wrapped for each of its readers.

Spec page: docs/spec/sealed-fields.md#keys
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.identifiers import Base64Url, Digest, Identifier, RobotId
from authguard_r.core.mission import DataClass


class Wrapped(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The key of one class, for one reader.

    Args:
        reader: digest of the reader's public key.
        role: the reader's.
        text: what HPKE made of it, base64url.
    """

    reader: Digest
    role: Identifier
    text: Base64Url


class WrappedFor(Struct, frozen=True, kw_only=True):
    """What a wrapped key is bound to: it is of no other mission, class, log or start."""

    robot: RobotId
    mid: str
    keys: int
    data: DataClass
    reader: Digest
    v: int = 1
