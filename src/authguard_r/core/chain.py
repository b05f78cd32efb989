# SPDX-License-Identifier: Apache-2.0
"""The hash chain over decisions.

L_i = H(L_{i-1} || mid || i || a_i || s_i || t_i || d_i || e_i), as the canonical encoding of an
object with exactly these eight fields, so that no two lists of fields spell the same bytes.

Source: `eq:log`. Spec page: docs/spec/audit-record.md
"""

from __future__ import annotations

from hashlib import sha256

from msgspec import Struct

from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.identifiers import Count, Digest, Identifier

#: L_{-1}: what the first record follows.
GENESIS = bytes(32)


class Link(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the chain binds of one record.

    Args:
        prev: L_{i-1}, base64url.
        mid: the mission, `-` when the record is of none.
        seq: i, from 0.
        action: digest of the action, `-` when the record is of none.
        state: digest of the snapshot, `-` when there was none.
        time_ms: trusted time, milliseconds since 1970.
        decision: the verdict, or the kind of a record that decides nothing.
        evidence: e_i, digest of everything else in the record.
    """

    prev: Digest
    mid: str
    seq: Count
    action: str
    state: str
    time_ms: Count
    decision: Identifier
    evidence: Digest


def link(record: Link) -> bytes:
    """Return L_i, 32 bytes."""
    return sha256(Tag.AUDIT.prefix + encode_fast(record)).digest()
