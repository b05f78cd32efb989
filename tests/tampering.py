# SPDX-License-Identifier: Apache-2.0
"""The other side of the audit-tampering game: whoever can write the robot's log, and change it.

Each attack on the records is a function of the genuine log and a place. `Hands` says what else the
adversary holds: the log's key, where the owner himself cheats, and the keys of some witnesses.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec import Struct

import logs
from auditing import TIME_S, Forged, Genuine, Honest, rows_of
from authguard_r.anchoring.witnesses import request
from authguard_r.audit.checkpoint import Checkpoint, origin_of
from authguard_r.audit.note import Note, NoteKey, NoteSignature
from authguard_r.audit.record import read_record, read_sealed
from authguard_r.audit.tree import MemoryTree, consistency_proof, leaf_hash
from authguard_r.audit.verify import Row
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.keys.notes import cosign, log_key, sign_text
from authguard_r.witness.rules import Finding
from logs import edited, rechained

Rows = list[Row]
#: A key that the adversary made, for a log's checkpoints.
FORGER = Ed25519PrivateKey.generate()
_set = msgspec.structs.replace


def forgers(origin: str) -> NoteKey:
    """Return the adversary's own key under a log's name."""
    return log_key(origin, FORGER.public_key())


def turned(row: Row) -> Row:
    """Return a record that says the opposite of what was decided."""
    decision = read_record(row.record, where="").link.decision
    return edited(row, decision="reject" if decision == "accept" else "accept")


def painted(row: Row) -> Row:
    """Return a record whose open fields say something else."""
    opened = read_record(row.record, where="").open
    return edited(row, open={**opened, "by": "somebody else"})


def _values(row: Row) -> dict[str, Any]:
    return dict(read_sealed(row.sealed, where=""))


def _with(rows: Rows, at: int, row: Row) -> Rows:
    return [*rows[:at], row, *rows[at + 1 :]]


# on the records; each returns None where there is nothing of the kind to be done


def edit_open(rows: Rows, at: int) -> Rows:
    return _with(rows, at, painted(rows[at]))


def edit_decision(rows: Rows, at: int) -> Rows:
    return _with(rows, at, turned(rows[at]))


def edit_and_link(rows: Rows, at: int) -> Rows:
    """The record's own digests and link are made anew, and those after it left."""
    changed = _with(rows, at, painted(turned(rows[at])))
    return [*rechained(changed[: at + 1], at), *rows[at + 1 :]]


def delete(rows: Rows, at: int) -> Rows:
    return [*rows[:at], *rows[at + 1 :]]


def delete_and_number(rows: Rows, at: int) -> Rows:
    return list(rows_of(delete(rows, at)))


def insert_copy(rows: Rows, at: int) -> Rows | None:
    return [*rows[: at + 1], *rows[at:]] if at < len(rows) - 1 else None


def insert_linked(rows: Rows, at: int) -> Rows | None:
    """One record more, with the number and the link of its place."""
    forged = rechained([*rows[:at], painted(rows[at])], at)[at]
    return [*rows[:at], forged, *rows[at:]]


def reorder(rows: Rows, at: int) -> Rows | None:
    if at == len(rows) - 1:
        return None
    return [*rows[:at], rows[at + 1], rows[at], *rows[at + 2 :]]


def reorder_far(rows: Rows, at: int) -> Rows | None:
    other = len(rows) - 1 - at
    if other <= at:
        return None
    return _with(_with(rows, at, rows[other]), other, rows[at])


def truncate(rows: Rows, at: int) -> Rows:
    return rows[:at]


def swap_value(rows: Rows, at: int) -> Rows | None:
    """A value is replaced, under its own salt."""
    values = _values(rows[at])
    if not values:
        return None
    name = sorted(values)[at % len(values)]
    values[name] = _set(values[name], value={"instead": at})
    return _with(rows, at, _set(rows[at], sealed=encode_fast(values)))


def swap_names(rows: Rows, at: int) -> Rows | None:
    """Two values of a record change places."""
    values = _values(rows[at])
    if len(values) < 2:
        return None
    one, two = sorted(values)[:2]
    values[one], values[two] = values[two], values[one]
    return _with(rows, at, _set(rows[at], sealed=encode_fast(values)))


def swap_records(rows: Rows, at: int) -> Rows | None:
    """The values of another record, with salts and all."""
    mine = rows[at].sealed
    other = next((row for row in rows[at + 1 :] if row.sealed not in (b"{}", mine)), None)
    return None if other is None else _with(rows, at, _set(rows[at], sealed=other.sealed))


def add_value(rows: Rows, at: int) -> Rows:
    """A value that nobody committed to."""
    item = {"salt": "A" * 22, "value": "granted"}
    values = {**msgspec.to_builtins(_values(rows[at])), "approved": item}
    return _with(rows, at, _set(rows[at], sealed=encode_fast(values)))


def chain_edit(rows: Rows, at: int) -> Rows:
    return rechained(edit_decision(rows, at), at)


def chain_delete(rows: Rows, at: int) -> Rows | None:
    return rechained(delete(rows, at), at) if at < len(rows) - 1 else None


def chain_insert(rows: Rows, at: int) -> Rows:
    return rechained([*rows[:at], painted(rows[at]), *rows[at:]], at)


def chain_reorder(rows: Rows, at: int) -> Rows | None:
    changed = reorder(rows, at)
    return None if changed is None else rechained(changed, at)


def replace_all(rows: Rows, at: int) -> Rows:
    """The log of another life, as long as this one: from the first record on."""
    return rechained([painted(row) for row in [*rows[at:], *rows[:at]]], 0)


def fork(rows: Rows, at: int) -> Rows:
    """It goes on elsewhere, just as long."""
    return rechained([*rows[:at], *(painted(row) for row in rows[at:])], at)


#: Attacks on records: what is made, and which checks find it.
class Attack(Struct, frozen=True, kw_only=True):
    """An attack on the records.

    Args:
        make: the records after it.
        caught: the checks of `plain` that find it: without them all it wins.
        named: `exact`: the first record that is not what it was; `next`: the one after it, which
            does not follow; `end`: where the log ends too early, and nothing in front shows it;
            `span`: the records between two checkpoints.
    """

    make: Callable[[Rows, int], Rows | None]
    caught: frozenset[str]
    named: str


def _attack(make: Callable[[Rows, int], Rows | None], named: str, *caught: str) -> Attack:
    return Attack(make=make, caught=frozenset(caught), named=named)


ATTACKS = {
    attack.make.__name__: attack
    for attack in (
        _attack(edit_open, "exact", "evidence"),
        _attack(edit_decision, "exact", "link"),
        _attack(edit_and_link, "next", "follows", "head", "root"),
        _attack(delete, "exact", "number", "follows", "length"),
        _attack(delete_and_number, "exact", "number", "follows", "length"),
        _attack(insert_copy, "exact", "number", "follows", "head", "root"),
        _attack(insert_linked, "next", "number", "follows", "head", "root"),
        _attack(reorder, "exact", "number", "follows", "head", "root"),
        _attack(reorder_far, "exact", "number", "follows", "head", "root"),
        _attack(truncate, "exact", "length"),
        _attack(swap_value, "exact", "value"),
        _attack(swap_names, "exact", "value"),
        _attack(swap_records, "exact", "value"),
        _attack(add_value, "exact", "value"),
        _attack(chain_edit, "span", "head", "root"),
        _attack(chain_delete, "end", "length"),
        _attack(chain_insert, "span", "head", "root"),
        _attack(chain_reorder, "span", "head", "root"),
        _attack(replace_all, "span", "head", "root"),
        _attack(fork, "span", "head", "root"),
    )
}


def destroy(rows: Rows, at: int) -> Rows:
    """A value is destroyed, as it may be: nothing was tampered with."""
    values = _values(rows[at])
    for name in sorted(values)[: 1 + at % 3]:
        del values[name]
    return _with(rows, at, _set(rows[at], sealed=encode_fast(values)))


def destroy_all(rows: Rows) -> Rows:
    return [_set(row, sealed=b"{}") for row in rows]


# on the checkpoints


class Hands(Struct, frozen=True):
    """What the adversary holds beside the log's file.

    Args:
        log: what really happened.
        owns: true where the log's own key is his.
        colluders: witnesses that sign whatever he likes.
    """

    log: Genuine
    owns: bool = False
    colluders: tuple[Honest, ...] = ()

    @property
    def honest(self) -> tuple[Honest, ...]:
        """The other witnesses."""
        theirs = {one.name for one in self.colluders}
        return tuple(one for one in self.log.witnesses if one.name not in theirs)

    def says(self, rows: Rows) -> Checkpoint:
        return logs.checkpoint_of(rows, self.log.robot)

    def signed(self, rows: Rows) -> Note:
        """Return a checkpoint of these rows: with the log's key, or with one that he made."""
        said = self.says(rows)
        text, origin = said.text(), said.origin
        if self.owns:
            return Note(text, sign_text(text, origin, self.log.signer))
        signature = FORGER.sign(text.encode())
        return Note(text, (NoteSignature(origin, forgers(origin).id, signature),))

    def under_its_id(self, rows: Rows) -> Note:
        """Return the same, under the id of the log's own key."""
        note = self.signed(rows)
        (own,) = self.log.keys
        return Note(note.text, tuple(_set(one, key_id=own.id) for one in note.signatures))

    def colluded(self, note: Note, *, twice: bool = False) -> Note:
        """Return the note with the colluders' cosignatures."""
        made = [cosign(note.text, one.name, one.key, TIME_S) for one in self.colluders]
        return Note(note.text, (*note.signatures, *made, *(made if twice else ())))

    def asked(self, note: Note, rows: Rows) -> tuple[Note, list[Finding]]:
        """Return the note with what honest witnesses add when they are asked, and their answers."""
        found, made = [], []
        for one in self.honest:
            answer, signature = one.ask(request(one.log.size, _proof(rows, one.log.size), note))
            found.append(answer)
            made += [] if signature is None else [signature]
        return Note(note.text, (*note.signatures, *made)), found

    def transplanted(self, note: Note) -> Note:
        """Return the note with the cosignatures of the newest genuine checkpoint."""
        origin = origin_of(self.log.robot)
        theirs = [s for s in self.log.notes[self.log.size].signatures if s.name != origin]
        return Note(note.text, (*note.signatures, *theirs))

    def resized(self, rows: Rows) -> Note:
        """Return the oldest genuine checkpoint, with another text under its signatures."""
        return Note(self.says(rows).text(), self.log.notes[min(self.log.notes)].signatures)

    def stripped(self) -> Note:
        """Return the newest genuine checkpoint without its cosignatures."""
        note = self.log.notes[self.log.size]
        return Note(note.text, tuple(s for s in note.signatures if s.name == self.log.keys[0].name))


def _proof(rows: Rows, old: int) -> tuple[bytes, ...]:
    """Return the best proof that he has: a true one, of the log that he made."""
    tree = MemoryTree()
    for row in rows:
        tree.append(leaf_hash(row.link))
    return consistency_proof(tree, old, tree.size) if old <= tree.size else ()


# at random


def _flip(rnd: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rnd.choice((1, 1, 2, 9))):
        changed[rnd.randrange(len(changed))] ^= 1 << rnd.randrange(8)
    return bytes(changed)


def bits(rnd: Random, rows: Rows) -> Rows:
    """Some bits of a row."""
    at, field = rnd.randrange(len(rows)), rnd.choice(["record", "sealed", "link"])
    return _with(rows, at, _set(rows[at], **{field: _flip(rnd, getattr(rows[at], field))}))


def shuffled(rnd: Random, rows: Rows) -> Rows:
    """A stretch in another order."""
    first = rnd.randrange(len(rows))
    end = min(len(rows), first + rnd.randrange(2, 9))
    return [*rows[:first], *rnd.sample(rows[first:end], end - first), *rows[end:]]


def cut_out(rnd: Random, rows: Rows) -> Rows:
    """A stretch is missing."""
    first = rnd.randrange(len(rows))
    return [*rows[:first], *rows[first + rnd.randrange(1, 9) :]]


def moved(rnd: Random, rows: Rows) -> Rows:
    """A stretch comes again elsewhere."""
    first, to = rnd.randrange(len(rows)), rnd.randrange(len(rows) + 1)
    return [*rows[:to], *rows[first : first + rnd.randrange(1, 9)], *rows[to:]]


def chained(rnd: Random, rows: Rows) -> Rows:
    """Numbers and links are made anew, from some record on."""
    return rechained(rows, rnd.randrange(len(rows)))


def structured(rnd: Random, rows: Rows) -> Rows:
    """One of the attacks above."""
    made = ATTACKS[rnd.choice(sorted(ATTACKS))].make(rows, rnd.randrange(len(rows)))
    return rows if made is None else made


def destroyed(rnd: Random, rows: Rows) -> Rows:
    """A value that is destroyed beside it."""
    return destroy(rows, rnd.randrange(len(rows)))


def gone_on(rnd: Random, rows: Rows) -> Rows:
    """More records at the end, which nobody vouches for."""
    more = [painted(rnd.choice(rows)) for _ in range(rnd.randrange(1, 5))]
    return rechained([*rows, *more], len(rows))


TRICKS = (structured, structured, bits, shuffled, cut_out, moved, chained, destroyed, gone_on)


def random_rows(rnd: Random, log: Genuine) -> tuple[Rows, list[str]]:
    """Return records after one to three tricks, perhaps on an older copy, and which they were."""
    if rnd.random() >= 0.1:
        return changed_rows(rnd, list(log.rows))
    older = list(log.rows[: rnd.choice(sorted(log.notes))])
    rows, names = changed_rows(rnd, older, least=0)
    return rows, ["older", *names]


def changed_rows(rnd: Random, rows: Rows, *, least: int = 1) -> tuple[Rows, list[str]]:
    """Return records after some tricks, and which they were."""
    names: list[str] = []
    for _ in range(rnd.choice((least, 1, 1, 2, 3))):
        if not rows:
            break
        trick = rnd.choice(TRICKS)
        try:
            rows = trick(rnd, rows)
        except MalformedError:  # its bytes were broken before, and are no record any more
            continue
        names.append(trick.__name__)
    return rows, names


def random_notes(rnd: Random, hands: Hands, rows: Rows) -> tuple[tuple[bytes, ...], str]:
    """Return the notes that lie with them, and of which kind they are."""
    log = hands.log
    kind = rnd.choice(("newest", "older", "none", "made", "made", "id", "size", "bits", "stripped"))
    if kind == "none":
        return (), kind
    if kind in {"newest", "older", "bits"}:
        size = log.size if kind == "newest" else rnd.choice(sorted(log.notes))
        data = log.notes[size].encode()
        return (_flip(rnd, data) if kind == "bits" else data,), kind
    if kind == "stripped":
        return (hands.stripped().encode(),), kind
    try:
        if kind == "size":
            return (hands.resized(rows).encode(),), kind
        note = hands.under_its_id(rows) if kind == "id" else hands.signed(rows)
    except (MalformedError, ValueError):  # a link that is none
        return (), "none"
    note = hands.colluded(note, twice=rnd.random() < 0.3)
    if rnd.random() < 0.5 and rows:
        note, _ = hands.asked(note, rows)
    if rnd.random() < 0.2:
        note = hands.transplanted(note)
    also = (log.notes[rnd.choice(sorted(log.notes))].encode(),) if rnd.random() < 0.3 else ()
    return (note.encode(), *also), kind


def random_hands(rnd: Random, log: Genuine, *, most: int) -> Hands:
    """Return an adversary with the keys of at most so many witnesses."""
    colluders = rnd.sample(log.witnesses, rnd.randrange(most + 1))
    return Hands(log, rnd.random() < 0.5, tuple(colluders))


def random_forgery(rnd: Random, hands: Hands) -> tuple[Forged, tuple[str, ...]]:
    """Return a log as this adversary might hand it over, and what was done to it."""
    rows, names = random_rows(rnd, hands.log)
    notes, kind = random_notes(rnd, hands, rows)
    return Forged(tuple(rows), notes), (*names, f"note:{kind}")
