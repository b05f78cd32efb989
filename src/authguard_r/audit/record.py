# SPDX-License-Identifier: Apache-2.0
"""Audit record v1: what the chain binds, what lies open, what is only committed to.

A decision's inputs may be sensitive, so the chain holds salted commitments to them and the values
lie beside it: destroying a value later leaves the chain whole. Everything that a replay of the
decision needs is one of those values. Source: `eq:log`. Spec page: docs/spec/audit-record.md
"""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from msgspec import Struct

from authguard_r.core.chain import Link, link
from authguard_r.core.encoding import Tag, b64, decode, digest, digest_of, encode_fast
from authguard_r.core.identifiers import Count, Digest, Identifier
from authguard_r.core.ports import Turn

#: Stands where a record is of no mission, action or state.
NONE = "-"


class Record(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One record as it is stored: the eight linked fields, the open and the committed ones.

    Args:
        link: what `eq:log` binds; `evidence` is the digest of everything below.
        kind: `genesis`, `decision`, `outcome`, `management`, `refusal`, `stop`, `alert`,
            `intake`.
        open: what anybody with the log may read.
        committed: commitment by name.
    """

    link: Link
    kind: Identifier
    open: dict[str, Any]
    committed: dict[str, Digest]


class Commitment(Struct, frozen=True, kw_only=True):
    """What a commitment is the digest of."""

    name: str
    salt: str
    value: Any


class Sealed(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A committed value with its salt, as it lies beside the chain."""

    salt: str
    value: Any


class Entry(Struct, frozen=True, kw_only=True):
    """What a part of the enforcer wants recorded; the log adds place, salt and chain.

    Args:
        kind: see `Record`.
        time_ms: trusted time.
        decision: the verdict, or the kind of a record that decides nothing.
        open: see `Record`.
        sealed: values to commit to.
        mid: the mission.
        action: digest of the action.
        state: digest of the snapshot.
    """

    kind: str
    time_ms: int
    decision: str
    open: dict[str, Any]
    sealed: dict[str, Any] = {}
    mid: str = NONE
    action: str = NONE
    state: str = NONE


def append(turn: Turn, entry: Entry, *, salts: bytes) -> int:
    """Append the entry to the log in this turn and return its sequence number.

    Args:
        turn: the writer's turn.
        entry: what to record; the names of what it seals are identifiers.
        salts: 16 fresh random bytes for each sealed value.
    """
    seq, prev = turn.head()
    committed: dict[str, Digest] = {}
    beside: list[bytes] = []
    for place, name in enumerate(sorted(entry.sealed)):
        # `Sealed` and `Commitment` end alike: spelled once, around a value that is encoded once
        salt = b64(salts[16 * place : 16 * place + 16])
        item = f'"salt":"{salt}","value":'.encode() + encode_fast(entry.sealed[name]) + b"}"
        committed[name] = digest(Tag.COMMITMENT, f'{{"name":"{name}",'.encode() + item)
        beside.append(f'"{name}":{{'.encode() + item)
    linked = Link(
        prev=Digest(b64(prev)),
        mid=entry.mid,
        seq=seq,
        action=entry.action,
        state=entry.state,
        time_ms=entry.time_ms,
        decision=entry.decision,
        evidence=evidence(entry.kind, entry.open, committed),
    )
    record = Record(link=linked, kind=entry.kind, open=entry.open, committed=committed)
    return turn.append(encode_fast(record), b"{" + b",".join(beside) + b"}", link(linked))


def evidence(kind: str, open_fields: dict[str, Any], committed: dict[str, Digest]) -> Digest:
    """Return e_i: the digest of everything in a record that is not linked by itself."""
    body = {"kind": kind, "open": open_fields, "committed": committed, "v": 1}
    return digest_of(Tag.EVIDENCE, body)


def commit(name: str, item: Sealed) -> Digest:
    """Return the commitment to a value: it hides even a value that could be guessed."""
    return digest_of(Tag.COMMITMENT, Commitment(name=name, salt=item.salt, value=item.value))


def read_record(data: bytes, *, where: str) -> Record:
    """Return the record that the bytes spell.

    Raises:
        MalformedError: they spell none.
    """
    return decode(data, Record, where=where)


def read_sealed(data: bytes, *, where: str) -> dict[str, Sealed]:
    """Return the sealed values that lie beside a record.

    Raises:
        MalformedError: they are none.
    """
    return decode(data, dict[str, Sealed], where=where)


def without(sealed: bytes, names: Container[str], *, where: str) -> bytes:
    """Return what lies beside a record once the values of these names are gone.

    Raises:
        MalformedError: the bytes are no sealed values.
    """
    left = {
        name: one for name, one in read_sealed(sealed, where=where).items() if name not in names
    }
    return encode_fast(left)


class Terminal(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The signed terminal digest: how long the log was and where its chain ended.

    Args:
        log: the robot whose log it is.
        size: number of records.
        head: L_{size-1}, base64url.
        time_ms: trusted time when it was signed.
    """

    log: Identifier
    size: Count
    head: Digest
    time_ms: Count
