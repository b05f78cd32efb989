# SPDX-License-Identifier: Apache-2.0
"""What a gate is configured with, over time: no version goes back, and each change is recorded.

Spec page: docs/spec/gate-protocol.md#configuration
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.audit.record import NONE, read_record
from authguard_r.core.encoding import encode_fast
from authguard_r.core.identifiers import Count
from authguard_r.core.lifecycle import Status
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.management.parts import entry, refuse
from authguard_r.store.transactions import STOP, Transaction, read_held

_KIND = "configuration"


class ConfiguredPart(StrEnum):
    """What is configured; the organization's risk policy has a rule of its own (`policy`)."""

    BINDING = "binding"
    EMERGENCY = "emergency"
    GATE = "gate"
    SAFETY = "safety"


class Configuration(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One part of a gate's configuration.

    Args:
        digest: of what was signed, or is in force unsigned; "-" for neither.
        version: its signed version; 0 where it is not signed or has none.
    """

    digest: str
    version: Count = 0


def require_configurations(turn: Turn, parts: dict[ConfiguredPart, Configuration]) -> None:
    """Refuse to go back; this needs no clock.

    Raises:
        RefusedError: a signed part has a lower version than one that was in force here, or the
            same version with another content (`SUPERSEDED`).
    """
    for part, now in sorted(parts.items()):
        seen = _seen(turn, part)
        if seen not in {None, now}:
            _require_newer(part, now, seen)


def _seen(turn: Turn | Transaction, part: ConfiguredPart) -> Configuration | None:
    held = turn.get(_KIND, part)
    return None if held is None else read_held(held, Configuration, _KIND)


def hold_configurations(
    act: Transaction,
    parts: dict[ConfiguredPart, Configuration],
    *,
    sealed: dict[ConfiguredPart, dict[str, object]],
) -> None:
    """Hold what is in force from now on; what has changed since the last start is recorded.

    `require_configurations` comes before.

    Args:
        act: the act.
        parts: what is in force.
        sealed: values that go beside the record of a part's change: what a replay needs of it.
    """
    _stamp(act)
    for part, now in sorted(parts.items()):
        seen = _seen(act, part)
        if now == seen:
            continue
        was = _begun_with(act, part) if seen is None else seen.digest
        if was not in {now.digest, None}:
            opened: dict[str, object] = {
                "verb": "configuration",
                "part": part,
                "version": now.version,
                "digest": now.digest,
                "was": was,
            }
            act.record(entry(act, NONE, opened, sealed.get(part)))
        act.put(_KIND, part, encode_fast(now))


def _stamp(act: Transaction) -> None:
    """In a store from before orders had times, a stop or suspension counts from now."""
    now, mid = str(act.now.utc_ms).encode("ascii"), act.active()
    if act.get(*STOP) == b"1":
        act.put(*STOP, now)
    standing = None if mid is None else act.standing(mid)
    if standing is not None and standing.status is Status.SUSPENDED:
        act.put("suspended", standing.mid, act.get("suspended", standing.mid) or now)


def _begun_with(act: Transaction, part: ConfiguredPart) -> str | None:
    """Return what the log's first record names of a part; None: it names no such part, ever.

    A store that was made without a gate, or by an older version, names another one or none.
    """
    if part not in {ConfiguredPart.BINDING, ConfiguredPart.SAFETY}:
        return None
    (first,) = act.rows(0, 1)
    return str(read_record(first[1], where="record 0").open.get(part, NONE))


def _require_newer(part: ConfiguredPart, now: Configuration, seen: Configuration) -> None:
    """Refuse to go back; what was never versioned may change, and is recorded."""
    if now.version > seen.version or now.version == seen.version == 0:
        return
    if now.version == seen.version:
        told = f"version {seen.version} was another one before: a change is a new version"
    else:
        got = f"version {now.version}" if now.version else "none that is signed"
        told = f"expected version {seen.version} or later, got {got}"
    raise refuse(Reason.SUPERSEDED, told, f"{part}.version")
