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
#: In front of the classes of a box of sealed values, and of one whose key is wrapped.
BOX, WRAP = "box.", "wrap."
#: How a motion ends (`core.standing.Outcome`), and the orders after which a mission goes on.
_ENDS = frozenset({"succeeded", "failed", "not_started", "aborted", "unknown"})
_GOES_ON = frozenset({"activate", "recover", "resolve", "resume"})


class LogRow(Struct, frozen=True, gc=False):
    """One stored row: number, record, the values beside it, and its link."""

    seq: int
    record: bytes
    sealed: bytes
    link: bytes


class Record(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One record as it is stored: the eight linked fields, the open and the committed ones.

    Args:
        link: what `eq:log` binds; `evidence` is the digest of everything below.
        kind: `genesis`, `decision`, `outcome`, `management`, `refusal`, `stop`, `alert`,
            `intake`.
        open: what every reader of the log may read.
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


def ends_motion(kind: str, decision: str) -> bool:
    """True for a record after which no decision rests on state that was measured before it.

    The robot's motion has ended with it, or the motion until then is unknown: after a stop, and
    before a person says that the mission goes on.
    """
    if kind == "management":
        return decision in _GOES_ON
    return kind in {"outcome", "stop"} or (kind == "emergency" and decision in _ENDS)


def append(turn: Turn, entry: Entry, *, salts: bytes) -> int:
    """Append the entry to the log in this turn and return its sequence number.

    Args:
        turn: the writer's turn.
        entry: what to record; the names of what it seals are identifiers.
        salts: 16 fresh random bytes for each sealed value.
    """
    beside = Attachment()
    for place, name in enumerate(sorted(entry.sealed)):
        beside.add(name, spelled(entry.sealed[name], salts[16 * place : 16 * place + 16]))
    return write(turn, entry, beside)


class Attachment:
    """What is put beside one record, and what the record says of it.

    A name is added once; what is only committed to lies somewhere else, or nowhere.
    """

    def __init__(self) -> None:
        self.committed: dict[str, Digest] = {}
        self._items: dict[str, bytes] = {}

    def commit(self, name: str, item: bytes) -> None:
        """Commit to a value (`spelled`) that does not lie beside the record by itself."""
        head = b'{"name":%b,' % encode_fast(name)
        self.committed[name] = digest(Tag.COMMITMENT, head + item)

    def add(self, name: str, item: bytes) -> None:
        """Commit to a value, and put it there."""
        self.commit(name, item)
        self._items[name] = item

    def encode(self) -> bytes:
        """Return everything that was put there, as it is stored."""
        return joined(self._items)


def spelled(value: Any, salt: bytes) -> bytes:
    """Return a value with its salt as both a `Sealed` and a `Commitment` end: spelled once."""
    return b'"salt":"%b","value":%b}' % (b64(salt).encode(), encode_fast(value))


def joined(items: dict[str, bytes]) -> bytes:
    """Return spelled values (`spelled`) by their names, in canonical form."""
    return b"{" + b",".join(b"%b:{%b" % (encode_fast(n), items[n]) for n in sorted(items)) + b"}"


def write(turn: Turn, entry: Entry, beside: Attachment) -> int:
    """Append the record of an entry whose sealed values were spelled; return its number."""
    seq, prev = turn.head()
    linked = Link(
        prev=Digest(b64(prev)),
        mid=entry.mid,
        seq=seq,
        action=entry.action,
        state=entry.state,
        time_ms=entry.time_ms,
        decision=entry.decision,
        evidence=evidence(entry.kind, entry.open, beside.committed),
    )
    record = Record(link=linked, kind=entry.kind, open=entry.open, committed=beside.committed)
    return turn.append(encode_fast(record), beside.encode(), link(linked))


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
        MalformedError: they are not a record.
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
