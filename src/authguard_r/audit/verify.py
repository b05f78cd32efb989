# SPDX-License-Identifier: Apache-2.0
"""Is this log whole, and says who? Reads rows once, in order, and trusts nothing in them.

A chain by itself shows that nothing inside was changed; only a digest that was signed and kept
elsewhere shows that nothing is missing at the end, and that it is the log that was written. The
answer always says which of the two was looked at. Memory is that of one row and of log n hashes.
What a record needs of those before it is their number and the last link: so a piece can be verified
before what lies in front of it, and is joined when it turns out to follow from that.

Source: theorem "Tamper evidence of the anchored log".
Spec page: docs/spec/audit-record.md#verification
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from hashlib import sha256
from typing import Any, Literal

import msgspec
from msgspec import Struct

from authguard_r.audit.checkpoint import Checkpoint
from authguard_r.audit.missing import DestructionOrder, Gone, MissingValues
from authguard_r.audit.record import LogRow, Sealed, Terminal
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.core.chain import GENESIS
from authguard_r.core.encoding import MAX_BYTES, Tag, b64, decode, encode_fast, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Count, Digest, is_identifier

#: Who says that the log is the one that was written.
By = Literal["claimed", "signed-terminal", "checkpoint", "witnessed"]
_SEALED = msgspec.json.Decoder(dict[str, Sealed])
_LINES = msgspec.json.Encoder(order="sorted")
_AUDIT, _EVIDENCE = Tag.AUDIT.prefix, Tag.EVIDENCE.prefix
#: Around a record's link.
_LINK, _OPEN = b',"link":{', b'},"open":'
#: Sets of names that are remembered.
_MOST_NAMED = 256
#: Links whose leaves go into the tree together.
_AT_ONCE = 256
#: Words that need not be looked at letter by letter each time.
_USUAL = frozenset(
    (
        *("genesis", "decision", "outcome", "management", "refusal", "stop", "alert", "intake"),
        *("stream", "revocation", "emergency", "accept", "reject", "request_approval"),
        *("succeeded", "failed", "not_started", "aborted", "unknown", "counted"),
    )
)


class Anchor(Struct, frozen=True, kw_only=True):
    """What is known of a log from outside of it, its signatures verified.

    Args:
        by: what vouches for it; `claimed`: nothing does, and a log that does not match it was not
            written by its gate.
        size: number of records that it speaks of.
        head: L_{size-1}; None when it does not say.
        root: of the tree over those links; None when it does not say.
    """

    by: By
    size: int
    head: bytes | None = None
    root: bytes | None = None


class Verification(Struct, frozen=True, kw_only=True):
    """What was found.

    Args:
        whole: every record follows from the one before and matches its own digests.
        size: records that do.
        head: the last of their links, base64url.
        anchored: `unanchored`, or what vouches for the longest part: see `Anchor.by`.
        anchored_size: how many records that is.
        anchors: everything that was held against the log and fits, the longest last.
        fault: the first thing that is wrong, empty when nothing is.
        where: the record, or the records, that it is wrong at.
        missing: values that no order in the log has let go.
    """

    whole: bool
    size: int
    head: str
    anchored: str = "unanchored"
    anchored_size: int = 0
    anchors: tuple[tuple[str, int], ...] = ()
    fault: str = ""
    where: str = ""
    missing: tuple[MissingValues, ...] = ()


def of_checkpoint(checkpoint: Checkpoint, *, witnessed: bool = False) -> Anchor:
    """Return what an authentic checkpoint says of a log."""
    return Anchor(
        by="witnessed" if witnessed else "checkpoint",
        size=checkpoint.size,
        head=checkpoint.chain,
        root=checkpoint.root,
    )


def of_terminal(terminal: Terminal) -> Anchor:
    """Return what an authentic terminal digest says of a log."""
    head = unb64(terminal.head, where="terminal.head")
    return Anchor(by="signed-terminal", size=terminal.size, head=head)


class Piece(Struct, frozen=True, kw_only=True):
    """Rows of which each follows from the one before, and what the rest of the log needs of them.

    Args:
        first: the first one's number.
        prev: the link that the first one says is before it, base64url.
        size: number of records of a log that ends with the last one.
        link: the last one's.
        subtrees: level and root of each complete subtree that their leaves fall into, in order;
            empty where no root is asked for.
        missing: values that no order in the piece has let go.
        orders: orders in the piece to destroy values.
    """

    first: int
    prev: str
    size: int
    link: bytes
    subtrees: tuple[tuple[int, bytes], ...] = ()
    missing: tuple[MissingValues, ...] = ()
    orders: tuple[DestructionOrder, ...] = ()


def verify_rows(
    rows: Iterable[LogRow], *, terminal: Terminal | None = None, anchors: Sequence[Anchor] = ()
) -> Verification:
    """Return whether the chain holds, and whether it fits what is known from outside.

    Args:
        rows: the log, in order, from an untrusted store.
        terminal: an authentic signed terminal digest, None when there is none.
        anchors: what authentic checkpoints say of it; of two equal ones the later one is reported.
    """
    return LogVerifier(terminal=terminal, anchors=anchors).finish(rows)


def verify_piece(rows: Sequence[LogRow], first: int, *, with_tree: bool) -> Piece | None:
    """Return a piece of a log, verified apart from what lies before it.

    None when anything is wrong with it: what that is and where, says `Verifier.finish` of the same
    rows. A piece is no part of a log until it was joined.

    Args:
        rows: at least one.
        first: the number that the first one has to have.
        with_tree: whether a root is asked for.
    """
    try:
        prev = decode(rows[0].record, _RecordFields).link.prev
    except MalformedError:
        return None
    chain = _Chain(first, prev)
    if any(chain.fault(row) for row in rows):
        return None
    leaves = [leaf_hash(row.link) for row in rows] if with_tree else []
    return Piece(
        first=first,
        prev=prev,
        size=chain.size,
        link=rows[-1].link,
        subtrees=_subtrees(leaves, first),
        missing=chain.gone.left,
        orders=chain.gone.orders,
    )


class LogVerifier:
    """A log as far as it was verified, and what is known of it from outside.

    Args:
        terminal: as in `verify_rows`.
        anchors: as in `verify_rows`.
    """

    def __init__(self, *, terminal: Terminal | None = None, anchors: Sequence[Anchor] = ()) -> None:
        known = [*anchors, *(() if terminal is None else (of_terminal(terminal),))]
        ordered = sorted(known, key=lambda anchor: (anchor.size, anchor.by == "witnessed"))
        #: The sizes at which something is known: no piece goes beyond the next of them.
        self.cuts = tuple(dict.fromkeys(anchor.size for anchor in ordered))
        self._against = _Against(ordered)
        signed = [anchor.size for anchor in ordered if anchor.by != "claimed"]
        #: An order to destroy counts only in the part that is signed for; None: nothing is.
        self._vouched = max(signed, default=None)
        self._chain = _Chain(vouched=self._vouched)
        self._misfit = self._against.fault(GENESIS, 0)

    def join(self, piece: Piece) -> bool:
        """Take in the next piece; False when the log is not whole with it, or may not be.

        Then `finish`, given its rows and all after them, says what is wrong.
        """
        chain, known = self._chain, self._against.next
        follows = (piece.first, piece.prev) == (chain.size, chain.head)
        if self._misfit or not follows or (known is not None and piece.size > known.size):
            return False
        if piece.orders and self._vouched is not None and piece.size > self._vouched:
            return False  # they explain nothing, and nothing of the piece
        chain.size, chain.head = piece.size, b64(piece.link)
        chain.gone.join(piece.orders, piece.missing)
        self._misfit = self._against.joined(piece)
        return not self._misfit

    def finish(self, rows: Iterable[LogRow]) -> Verification:
        """Return what was found, with the rest of the log.

        Args:
            rows: in order, all that were not taken in yet.
        """
        chain, against = self._chain, self._against
        fault = self._misfit
        for row in () if fault else rows:
            fault = chain.fault(row)
            if fault:
                return _broken(chain, fault, f"record {chain.size}")
            if against.next is not None:
                fault = against.grown(row.link, chain.size)
                if fault:
                    break
        if fault:
            return _broken(chain, fault, against.since(chain.size))
        if against.next is not None:
            fault = f"expected at least the {against.next.size} signed records: the log is cut off"
            return _broken(chain, fault, f"record {chain.size}")
        return Verification(
            whole=True,
            size=chain.size,
            head=chain.head,
            anchored=against.fitting[-1][0] if against.fitting else "unanchored",
            anchored_size=against.fitting[-1][1] if against.fitting else 0,
            anchors=tuple(against.fitting),
            missing=chain.gone.left,
        )


class _Against:
    """Holds the links that go by against what is known of the log, each at its size.

    Args:
        anchors: the shortest first.
    """

    def __init__(self, anchors: list[Anchor]) -> None:
        self._left = anchors[::-1]
        self._frontier = Frontier()
        self._links: list[bytes] = []
        self._needs_tree = any(anchor.root is not None for anchor in anchors)
        self.fitting: list[tuple[str, int]] = []

    @property
    def next(self) -> Anchor | None:
        """The shortest that was not come to yet."""
        return self._left[-1] if self._left else None

    def grown(self, head: bytes, size: int) -> str:
        """Take in the next link; return what does not fit it, empty when nothing does."""
        if self._needs_tree:
            self._links.append(head)
            if len(self._links) >= _AT_ONCE:
                self._grow()
        return self.fault(head, size) if self._left[-1].size == size else ""

    def joined(self, piece: Piece) -> str:
        """Take in the links of a piece; return what does not fit at its end."""
        if self._left and self._needs_tree:
            self._grow()
            for level, root in piece.subtrees:
                self._frontier = _with_subtree(self._frontier, level, root)
        return self.fault(piece.link, piece.size)

    def fault(self, head: bytes, size: int) -> str:
        """Return what does not fit at this size; what fits is kept as fitting."""
        while self._left and self._left[-1].size == size:
            anchor = self._left.pop()
            if anchor.head is not None and anchor.head != head:
                return f"expected the signed head {b64(anchor.head)}: changed and chained again"
            if anchor.root is not None and anchor.root != self._root():
                return f"expected the signed root {b64(anchor.root)}: changed and chained again"
            if anchor.by != "claimed":
                self.fitting.append((anchor.by, size))
        return ""

    def since(self, size: int) -> str:
        """Return where a log that does not fit at this size can begin to be another."""
        first, last = self.fitting[-1][1] if self.fitting else 0, max(size - 1, 0)
        return f"record {last}" if first >= last else f"records {first} to {last}"

    def _root(self) -> bytes:
        self._grow()
        return self._frontier.root()

    def _grow(self) -> None:
        self._frontier = self._frontier.grown(map(leaf_hash, self._links))
        self._links = []


class _Linked(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False):
    """`Link`, with words for patterns: what they spell is held against what it has to be."""

    prev: str
    mid: str
    seq: int
    action: str
    state: str
    time_ms: Count
    decision: str
    evidence: str


class _RecordFields(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`Record`, in the same way."""

    link: _Linked
    kind: str
    open: dict[str, Any]
    committed: dict[str, str]


class _NamedValues:
    """Sealed values under these names: what stands around them, beside a record and hashed.

    Args:
        names: in the order in which they were read.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        spelled = [encode_fast(name) for name in names]
        self.names = names
        self.canonical = names == tuple(sorted(names))
        self.around = b"{%b}" % b",".join(n.replace(b"%", b"%%") + b":{%b" for n in spelled)
        self.heads = [Tag.COMMITMENT.prefix + b'{"name":%b,' % name for name in spelled]


class _Chain:
    """The chain as far as it was read: where it ends, and whether the next row follows.

    Everything that is hashed is a part of canonical bytes, so nothing is encoded twice.

    Args:
        size: number of records before the next row.
        head: the last of their links, base64url.
        vouched: orders to destroy count before this record only; None: everywhere.
    """

    def __init__(
        self, size: int = 0, head: str = b64(GENESIS), *, vouched: int | None = None
    ) -> None:
        self._vouched = vouched
        self.size = size
        self.head = head
        self.gone = Gone()
        self._named: dict[tuple[str, ...], _NamedValues] = {}

    def fault(self, row: LogRow) -> str:
        """Return what is wrong with the next row, empty when nothing is and it was taken in."""
        data, seq = row.record, self.size
        try:
            record = decode(data, _RecordFields)
            link = record.link
            _require_words(record.kind, link.decision)
            named, tails = self._sealed(row.sealed)
        except MalformedError as error:
            return f"not a record: {error.message}"
        if row.seq != seq or link.seq != seq:
            return f"expected record {seq}, found {link.seq}: missing, inserted or reordered"
        if link.prev != self.head:
            return "does not follow the record before it"
        # a bare quotation mark only begins or ends a text, and there is no object before the link's
        # or in it: so untrusted text can contain neither mark
        first = data.index(_LINK)
        end = data.index(_OPEN, first) + 1
        linked = sha256(_AUDIT + data[first + len(_LINK) - 1 : end]).digest()
        evidence = sha256(b'%b%b%b,"v":1}' % (_EVIDENCE, data[:first], data[end:-1])).digest()
        parts = zip(named.heads, tails, strict=True)
        hashed = [sha256(head + tail).digest() for head, tail in parts]
        *commitments, stated, head = _spelled([*hashed, evidence, linked])
        if link.evidence != stated:
            return "its fields do not match their digest"
        if row.link != linked:
            return "its link does not match its fields"
        committed = record.committed
        if commitments != [*committed.values()] or named.names != tuple(committed):
            fault = _uncommitted(committed, dict(zip(named.names, commitments, strict=True)))
            if fault:
                return fault
            self.gone.take(seq, link.mid, committed, named.names)
        if record.kind == "management" and (self._vouched is None or seq < self._vouched):
            self.gone.hear(link.decision, record.open)
        self.size, self.head = seq + 1, head
        return ""

    def _sealed(self, sealed: bytes) -> tuple[_NamedValues, list[bytes]]:
        """Return the names of sealed values, and the canonical bytes of each behind its brace.

        Raises:
            MalformedError: the bytes are no canonical sealed values.
        """
        if len(sealed) > MAX_BYTES:
            raise MalformedError(f"expected at most {MAX_BYTES} bytes, got {len(sealed)}")
        try:
            read = _SEALED.decode(sealed)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise MalformedError(str(error)) from error
        names = tuple(read)
        named = self._named.get(names)
        if named is None:
            if len(self._named) >= _MOST_NAMED:
                self._named.clear()
            named = self._named[names] = _NamedValues(names)
        # a line for each; canonical bytes hold no line break
        tails = _LINES.encode_lines([*read.values()])[1:-1].split(b"\n{") if names else []
        if not named.canonical or named.around % tuple(tails) != sealed:
            raise MalformedError("the bytes are not the canonical encoding of their content")
        return named, tails


def _subtrees(leaves: Sequence[bytes], first: int) -> tuple[tuple[int, bytes], ...]:
    """Return level and root of the complete subtrees that leaves from number `first` on fall into.

    Each is as large as its place and what is left allow: so each place is a multiple of its size.
    """
    found: list[tuple[int, bytes]] = []
    at = 0
    while at < len(leaves):
        level = (len(leaves) - at).bit_length() - 1
        if place := first + at:
            level = min(level, (place & -place).bit_length() - 1)
        found.append((level, Frontier().grown(leaves[at : at + (1 << level)]).root()))
        at += 1 << level
    return tuple(found)


def _with_subtree(frontier: Frontier, level: int, root: bytes) -> Frontier:
    """Return the frontier after a subtree of `1 << level` leaves, of which its size is a multiple.

    Above that level the subtrees are leaves of a tree themselves.
    """
    above = Frontier(size=frontier.size >> level, peaks=frontier.peaks).grown((root,))
    return Frontier(size=above.size << level, peaks=above.peaks)


def _spelled(digests: list[bytes]) -> list[str]:
    """Return each digest as base64url; 32 bytes and a zero are 43 letters and one more."""
    text = b64(b"\0".join(digests))
    return [text[at : at + 43] for at in range(0, len(text), 44)]


def _uncommitted(committed: dict[str, str], sealed: dict[str, str]) -> str:
    """Return what is wrong where not every commitment is that to the value beside it."""
    for name, commitment in sealed.items():
        if committed.get(name) != commitment:
            return f"the value `{name}` does not match its commitment"
    for name in committed.keys() - sealed.keys():  # these values are gone
        try:
            msgspec.convert(committed[name], Digest)
        except msgspec.ValidationError:
            return f"not a record: expected a digest at `committed.{name}`"
    return ""


def _require_words(*words: str) -> None:
    for word in words:
        if word not in _USUAL and not is_identifier(word):
            raise MalformedError(f"expected an identifier, got `{word}`")


def _broken(chain: _Chain, fault: str, where: str) -> Verification:
    return Verification(whole=False, size=chain.size, head=chain.head, fault=fault, where=where)
