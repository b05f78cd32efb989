# SPDX-License-Identifier: Apache-2.0
"""Time as the gate sees it, and the two spellings of an instant.

Every quantity in the core is an integer with its unit in its name; floats exist only in
`normalize` and `compile`, where they are read as exact decimals and rounded there.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Timestamp
from authguard_r.core.reasons import Reason

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Now(Struct, frozen=True):
    """The instant of one decision, read once by the enforcer and passed to everything.

    Args:
        utc_ms: trusted time, milliseconds since 1970; never earlier than anything committed.
        mono_ms: the gate's monotonic clock in milliseconds; ages and rates are measured on it.
    """

    utc_ms: int
    mono_ms: int


def to_ms(timestamp: Timestamp, *, where: str) -> int:
    """Return the instant in milliseconds since 1970.

    Raises:
        MalformedError: the text has the right shape but names no instant (`2026-02-30T...`).
    """
    try:
        moment = datetime.fromisoformat(timestamp)
    except ValueError as error:
        raise MalformedError("no instant", where=where, reason=Reason.SCHEMA_INVALID) from error
    return (moment - _EPOCH) // timedelta(milliseconds=1)


def to_timestamp(utc_ms: int) -> Timestamp:
    """Return the whole second in which the instant lies, as signed data spells it."""
    return datetime.fromtimestamp(utc_ms // 1_000, tz=UTC).isoformat().replace("+00:00", "Z")
