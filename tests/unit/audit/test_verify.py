# SPDX-License-Identifier: Apache-2.0
"""Whatever was done to a log, the first record that is not what it was is named.

Source: theorem "Tamper evidence of the anchored log"; docs/spec/audit-record.md#verification
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from hashlib import sha256
from random import Random
from typing import Any

import msgspec
import pytest

from authguard_r.audit import verify
from authguard_r.audit.record import (
    Entry,
    LogRow,
    Record,
    Terminal,
    commit,
    evidence,
    read_record,
    read_sealed,
)
from authguard_r.audit.verify import Anchor, Verification, of_checkpoint, verify_rows
from authguard_r.core.chain import GENESIS, Link, link
from authguard_r.core.encoding import MAX_BYTES, b64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from fixtures.small_logs import ROBOT, checkpoint_of, edited, entry, log_of, rechained, root_of

SIZE = 9
ROWS = log_of(SIZE)
set_ = msgspec.structs.replace


def checkpoint(size: int, *, witnessed: bool = False, rows: list[LogRow] = ROWS) -> Anchor:
    return of_checkpoint(checkpoint_of(rows[:size]), witnessed=witnessed)


def broken(rows: list[LogRow], where: str, fault: str, *anchors: Anchor) -> Verification:
    found = verify_rows(rows, anchors=anchors)
    assert not found.whole
    assert (found.where, found.anchored, found.anchored_size) == (where, "unanchored", 0)
    assert fault in found.fault
    return found


def with_row(at: int, **fields: bytes | int) -> list[LogRow]:
    return [set_(row, **fields) if row.seq == at else row for row in ROWS]


def with_record(at: int, **fields: Any) -> list[LogRow]:
    return [edited(row, **fields) if row.seq == at else row for row in ROWS]


# the second opinion: the definition, word for word, with every object encoded by itself


def literal(rows: list[LogRow]) -> int | None:
    """Return the number of the first record that is not sound, None when all are."""
    prev = GENESIS
    for seq, row in enumerate(rows):
        try:
            record = read_record(row.record, where="")
            sealed = read_sealed(row.sealed, where="")
        except MalformedError:
            return seq
        sound = (
            row.seq == record.link.seq == seq
            and record.link.prev == b64(prev)
            and record.link.evidence == evidence(record.kind, record.open, record.committed)
            and link(record.link) == row.link
            and all(record.committed.get(n) == commit(n, item) for n, item in sealed.items())
        )
        if not sound:
            return seq
        prev = row.link
    return None


def agreed(rows: list[LogRow]) -> None:
    found, first = verify_rows(rows), literal(rows)
    assert found.whole is (first is None), found
    assert found.where == ("" if first is None else f"record {first}")


def test_the_fast_reading_has_the_fields_of_the_definition() -> None:
    assert verify._RecordFields.__struct_fields__ == Record.__struct_fields__
    assert verify._Linked.__struct_fields__ == Link.__struct_fields__


# whole


def test_a_whole_log_is_whole_and_says_that_nothing_vouches_for_its_end() -> None:
    found = verify_rows(ROWS)
    assert found == Verification(whole=True, size=SIZE, head=b64(ROWS[-1].link))
    assert found.anchored == "unanchored"
    assert verify_rows([]) == Verification(whole=True, size=0, head=b64(GENESIS))
    agreed(ROWS)


def test_a_checkpoint_anchors_what_it_covers_and_the_rest_is_only_chained() -> None:
    found = verify_rows(ROWS, anchors=(checkpoint(5),))
    assert found.whole
    assert (found.anchored, found.anchored_size, found.size) == ("checkpoint", 5, SIZE)
    assert found.anchors == (("checkpoint", 5),)


def test_of_several_checkpoints_the_longest_is_told_and_of_equal_ones_the_witnessed() -> None:
    several = (checkpoint(9), checkpoint(0), checkpoint(9, witnessed=True), checkpoint(2))
    found = verify_rows(ROWS, anchors=several)
    assert (found.anchored, found.anchored_size) == ("witnessed", 9)
    assert found.anchors == (
        *(("checkpoint", 0), ("checkpoint", 2), ("checkpoint", 9)),
        ("witnessed", 9),
    )
    found = verify_rows(ROWS, anchors=(checkpoint(2, witnessed=True), checkpoint(7)))
    assert (found.anchored, found.anchored_size) == ("checkpoint", 7)


def test_a_terminal_digest_anchors_by_the_head_alone() -> None:
    terminal = Terminal(log=ROBOT, size=4, head=Digest(b64(ROWS[3].link)), time_ms=0)
    found = verify_rows(ROWS, terminal=terminal)
    assert (found.anchored, found.anchored_size) == ("signed-terminal", 4)
    forged = set_(terminal, head=Digest(b64(ROWS[4].link)))
    assert verify_rows(ROWS, terminal=forged).where == "records 0 to 3"
    empty = set_(terminal, size=0, head=Digest(b64(GENESIS)))
    assert verify_rows(ROWS, terminal=empty).whole


def test_a_checkpoint_across_many_records_holds_at_each_size() -> None:
    rows = log_of(600)
    for size in (1, 255, 256, 257, 511, 512, 600):
        assert verify_rows(rows, anchors=(checkpoint(size, rows=rows),)).anchored_size == size
    every = tuple(checkpoint(size, rows=rows) for size in range(601))
    assert len(verify_rows(iter(rows), anchors=every).anchors) == 601


# changed, missing, inserted, reordered


def test_a_changed_record_is_named() -> None:
    for at in range(SIZE):
        broken(with_record(at, open={"changed": 1}), f"record {at}", "do not match their digest")
        broken(with_record(at, time_ms=1), f"record {at}", "its link does not match")
        broken(with_row(at, link=bytes(32)), f"record {at}", "its link does not match")
        broken(with_row(at, link=b""), f"record {at}", "its link does not match")


def test_a_changed_value_beside_a_record_is_named() -> None:
    at = 2
    beside = ROWS[at].sealed.replace(b"room-2", b"room-7")
    broken(with_row(at, sealed=beside), "record 2", "value `action` does not match")
    salted = ROWS[at].sealed.replace(b'"salt":"AAAA', b'"salt":"BAAA', 1)
    broken(with_row(at, sealed=salted), "record 2", "value `action` does not match")
    more = ROWS[at].sealed.removesuffix(b"}") + b',"x":{"salt":"","value":0}}'
    broken(with_row(at, sealed=more), "record 2", "value `x` does not match")
    agreed(with_row(at, sealed=more))


def test_a_value_that_was_destroyed_is_not_missed() -> None:
    values = json.loads(ROWS[2].sealed)
    for gone in ("action", "now", "who"):
        left = {name: item for name, item in values.items() if name != gone}
        sealed = msgspec.json.encode(left, order="sorted")
        assert verify_rows(with_row(2, sealed=sealed)).whole
        agreed(with_row(2, sealed=sealed))
    assert verify_rows(with_row(2, sealed=b"{}")).whole


def test_a_missing_record_is_named() -> None:
    for at in range(SIZE - 1):
        broken(ROWS[:at] + ROWS[at + 1 :], f"record {at}", "missing, inserted or reordered")
    numbered = [set_(row, seq=n) for n, row in enumerate(ROWS[:3] + ROWS[4:])]
    broken(numbered, "record 3", "missing, inserted or reordered")


def test_an_inserted_record_is_named() -> None:
    for at in range(SIZE):
        broken([*ROWS[: at + 1], *ROWS[at:]], f"record {at + 1}", "missing, inserted or reordered")
    # with the number and the link of its place: it follows from what was before it
    forged = rechained([*ROWS[:4], ROWS[2], *ROWS[4:]], 4)[4]
    broken([*ROWS[:4], forged, *ROWS[4:]], "record 5", "missing, inserted or reordered")


def test_reordered_records_are_named_at_the_first() -> None:
    for at in range(SIZE - 1):
        rows = [*ROWS[:at], ROWS[at + 1], ROWS[at], *ROWS[at + 2 :]]
        broken(rows, f"record {at}", "missing, inserted or reordered")


def test_a_record_of_another_log_does_not_follow() -> None:
    other = log_of(SIZE, lambda number: set_(entry(number), time_ms=number))
    broken([*ROWS[:4], *other[4:]], "record 4", "does not follow the record before it")


# truncated, chained again, forked


def test_a_log_that_was_cut_off_is_named_at_the_first_record_that_is_gone() -> None:
    for size in range(SIZE):
        broken(ROWS[:size], f"record {size}", "cut off", checkpoint(SIZE))
        found = verify_rows(ROWS[:size], anchors=(checkpoint(size),))
        assert (found.whole, found.anchored_size) == (True, size)


def test_a_log_that_was_chained_anew_is_named_from_the_last_record_that_is_vouched_for() -> None:
    changed = rechained([edited(row, decision="accept") if row.seq == 5 else row for row in ROWS])
    assert verify_rows(changed).whole  # nothing outside, nothing seen
    broken(changed, "records 0 to 8", "chained again", checkpoint(9))
    broken(changed, "records 3 to 8", "chained again", checkpoint(9), checkpoint(3))
    broken(changed, "records 5 to 6", "chained again", *map(checkpoint, (1, 5, 7, 9)))
    # a checkpoint after every record names the one
    broken(changed, "record 5", "chained again", *map(checkpoint, range(SIZE + 1)))


def test_a_log_that_went_on_elsewhere_is_named() -> None:
    forked = log_of(SIZE, lambda n: set_(entry(n), time_ms=n) if n >= 6 else entry(n))
    assert forked[:6] == ROWS[:6]
    broken(forked, "records 6 to 8", "signed head", checkpoint(6), checkpoint(9))
    root_alone = Anchor(by="checkpoint", size=9, root=root_of(ROWS))
    broken(forked, "records 6 to 8", "signed root", checkpoint(6), root_alone)


def test_a_head_without_the_root_that_belongs_to_it_does_not_fit() -> None:
    lying = set_(checkpoint(9), root=bytes(32))
    broken(ROWS, "records 0 to 8", "signed root", lying)
    nothing = Anchor(by="checkpoint", size=0, root=bytes(32))
    broken(ROWS, "record 0", "signed root", nothing)


def test_the_first_fault_comes_before_a_later_checkpoint() -> None:
    broken(with_record(2, open={}), "record 2", "match their digest", checkpoint(9))


# bytes that are no record


def spelled(row: LogRow) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(row.record)
    return plain


def as_record(plain: dict[str, Any]) -> bytes:
    return msgspec.json.encode(plain, order="sorted")


def test_bytes_that_are_no_canonical_record_are_named() -> None:
    plain = spelled(ROWS[2])
    wrong = [
        b"",
        b"{",
        b"\xff",
        b"[" * 100_000,
        ROWS[2].record + b" ",
        ROWS[2].record.replace(b":", b": ", 1),
        b" " * (MAX_BYTES + 1),
        as_record({**plain, "more": 1}),
        as_record({name: plain[name] for name in ("kind", "link", "open")}),
        as_record({**plain, "link": {**plain["link"], "more": 1}}),
        as_record({**plain, "link": {**plain["link"], "time_ms": -1}}),
        as_record({**plain, "kind": "Not An Identifier"}),
        as_record({**plain, "link": {**plain["link"], "decision": "é"}}),
    ]
    for record in wrong:
        broken(with_row(2, record=record), "record 2", "not a record")
        agreed(with_row(2, record=record))


def test_bytes_that_are_no_canonical_values_are_named() -> None:
    sealed = ROWS[2].sealed
    first, second = b'{"salt":"","value":1}', b'{"salt":"","value":2}'
    wrong = [
        b"",
        b"[]",
        b"\xff",
        b"[" * 100_000,
        sealed + b"\n",
        sealed.replace(b",", b", ", 1),
        sealed.replace(b"navigate", b"n\\u0061vigate"),
        sealed.replace(b'"value":', b'"more":1,"value":', 1),
        b'{"b":%b,"a":%b}' % (first, second),
        b'{"a":%b,"a":%b}' % (first, second),
        b'{"a":{"value":1,"salt":""}}',
        b'{"a":{"salt":""}}',
        b'{"a":{"salt":"","value":1.0e1}}',
        b" " * (MAX_BYTES + 1),
    ]
    for beside in wrong:
        broken(with_row(2, sealed=beside), "record 2", "not a record")
        agreed(with_row(2, sealed=beside))


def test_a_commitment_that_is_none_is_named_when_its_value_is_gone() -> None:
    plain = spelled(ROWS[2])
    for lost in ("", "A" * 42, "A" * 44, "A" * 42 + "!"):
        committed = {**plain["committed"], "gone": lost}
        rows = with_row(2, record=as_record({**plain, "committed": committed}))
        found = verify_rows(rows)
        assert (found.whole, found.where) == (False, "record 2")
    # and when it was chained so, by whoever wrote the log
    forged = msgspec.json.decode(ROWS[2].record, type=verify._RecordFields)
    told = set_(forged, committed={**forged.committed, "gone": "A"})
    body = {"kind": told.kind, "open": told.open, "committed": told.committed, "v": 1}
    stated = b64(sha256(verify._EVIDENCE + as_record(body)).digest())
    linked = set_(told.link, evidence=stated)
    record = as_record(msgspec.to_builtins(set_(told, link=linked)))
    own = sha256(verify._AUDIT + as_record(msgspec.to_builtins(linked))).digest()
    broken([*ROWS[:2], LogRow(2, record, ROWS[2].sealed, own)], "record 2", "expected a digest")


def test_a_text_that_spells_the_marks_of_a_record_moves_no_bytes() -> None:
    nasty = '","link":{"action":"-"},"open":{},"v":1}'

    def marked(number: int) -> Entry:
        return set_(
            entry(number),
            open={nasty: nasty, "link": {"open": {}}, "open": [nasty]},
            sealed={"%b": {nasty: nasty, "salt": {}}, "%%": "%", "x": '\n{"y":{}'},
            mid=nasty,
            action=nasty,
        )

    rows = log_of(4, marked)
    assert verify_rows(rows).whole
    agreed(rows)
    for at in range(4):
        agreed([edited(row, open={}) if row.seq == at else row for row in rows])
        beside = set_(rows[at], sealed=rows[at].sealed.replace(b"%", b"+", 1))
        agreed([beside if row.seq == at else row for row in rows])


def test_more_sets_of_names_than_are_remembered_are_read_all_the_same() -> None:
    rows = log_of(300, lambda n: set_(entry(1), time_ms=n, sealed={f"n{n}": n}))
    assert verify_rows(rows).whole
    assert (
        verify_rows([*rows[:299], set_(rows[299], sealed=rows[298].sealed)]).where == "record 299"
    )


def test_the_fast_reading_and_the_definition_agree_on_random_damage() -> None:
    rnd = Random(6)
    for _ in range(4_000):
        at = rnd.randrange(SIZE)
        field = rnd.choice(["record", "sealed"])
        data = bytearray(getattr(ROWS[at], field))
        for _ in range(rnd.randrange(1, 3)):
            place = rnd.randrange(len(data))
            trick = rnd.randrange(3)
            if trick == 0:
                data[place] ^= 1 << rnd.randrange(8)
            elif trick == 1:
                del data[place : place + rnd.randrange(1, 4)]
            else:
                data[place:place] = rnd.choice([b" ", b"0", b'"', b"{}", b",", b"\\u0041"])
            if not data:
                break
        agreed(with_row(at, **{field: bytes(data)}))


@pytest.mark.parametrize("size", [0, 1, SIZE])
def test_rows_are_read_once_in_order_and_none_is_kept(size: int) -> None:
    seen: list[int] = []

    def passing() -> Iterator[LogRow]:
        for row in ROWS[:size]:
            seen.append(row.seq)
            yield row

    assert verify_rows(passing()).size == size
    assert seen == list(range(size))
