# SPDX-License-Identifier: Apache-2.0
"""Sealed fields: what is sealed is opened as it was, with every key of its classes or not at all.

Source: docs/spec/sealed-fields.md
"""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.audit.record import (
    BOX,
    NONE,
    Entry,
    LogRow,
    Record,
    Sealed,
    append,
    read_record,
    read_sealed,
)
from authguard_r.audit.sealed_envelopes import (
    ACT,
    LINKS,
    OBJECT,
    PARAMS,
    REGIONS,
    SPOKEN,
    Cover,
    SealedEnvelope,
    act_of,
    append_covered,
    classes_of,
    opened,
)
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import DataClass
from fixtures import scenarios
from fixtures.amount import amount
from unit.test_record import Log

LAW = settings(max_examples=amount(25, 100))
KEYS = {data: bytes([number]) * 32 for number, data in enumerate(DataClass)}
#: Digests as a decision links them.
ACTION, STATE = b64(b"a" * 32), b64(b"s" * 32)
words = st.text("abcdefgh", min_size=1, max_size=8)
actions = st.fixed_dictionaries(
    {"type": words, "tool": words},
    optional={
        "object": words,
        "source": words,
        "destination": words,
        "route": st.lists(words, max_size=2),
        "params": st.dictionaries(words, st.integers(0, 9), max_size=2),
        "meta": st.fixed_dictionaries({"planner": words}),
    },
)
fields = st.fixed_dictionaries(
    {},
    optional={
        "action": actions,
        "state": st.lists(words, max_size=1),
        "now": st.integers(0, 9),
        "why": words,
        "token": words,
        "unheard_of": words,
    },
)
classes = st.sets(st.sampled_from(DataClass), min_size=1)


def entry(sealed: dict[str, Any], **changes: Any) -> Entry:
    plain = {
        "action": ACTION if "action" in sealed else NONE,
        "open": {"by": "anna", "grant": "bring it", "n": 1},
    }
    plain |= {"state": STATE if "state" in sealed else NONE, "mid": "m-1"}
    return Entry(
        kind="decision", time_ms=7, decision="accept", sealed=sealed, **{**plain, **changes}
    )


def cover(*data: DataClass, **changes: Any) -> Cover:
    made = Cover(robot=scenarios.RID, keys=0, classes={one: KEYS[one] for one in data or DataClass})
    return msgspec.structs.replace(made, **changes)


def row_of(log: Log, seq: int = 0) -> LogRow:
    return LogRow(seq, *log.rows[seq])


def sealed_row(sealed: dict[str, Any], *data: DataClass, **changes: Any) -> LogRow:
    log = Log()
    assert (
        append_covered(log, entry(sealed, **changes), cover(*data), salts=scenarios.random_bytes)
        == 0
    )
    row = row_of(log)
    assert verify_rows([row]).whole
    return row


def read(row: LogRow, *data: DataClass, **changes: Any) -> LogRow:
    """Return the row as a reader of these classes, of all without any, has it."""
    known = {one: KEYS[one] for one in data or DataClass}
    told = {"robot": scenarios.RID, "key_of": lambda keys, one: known.get(one), **changes}
    return opened(row, **told)


def record(row: LogRow) -> Record:
    return read_record(row.record, where="")


def values(row: LogRow) -> dict[str, Any]:
    return {name: one.value for name, one in read_sealed(row.sealed, where="").items()}


def boxes(row: LogRow) -> list[str]:
    return [name for name in values(row) if name.startswith(BOX)]


@LAW
@given(sealed=fields, data=classes)
def test_whoever_has_every_key_reads_the_record_as_if_nothing_was_sealed(
    sealed: dict[str, Any], data: set[DataClass]
) -> None:
    log = Log()
    append(log, entry(sealed), salts=bytes(16 * len(sealed)))
    plain, found = row_of(log), read(sealed_row(sealed, *data))
    assert values(found) == values(plain)
    assert record(found).open == record(plain).open
    link, other = record(found).link, record(plain).link
    assert (link.action, link.state, link.mid) == (other.action, other.state, other.mid)


@LAW
@given(sealed=fields, data=classes, lacks=st.sampled_from(DataClass))
def test_a_class_without_its_key_takes_every_field_that_tells_of_it(
    sealed: dict[str, Any], data: set[DataClass], lacks: DataClass
) -> None:
    row = sealed_row(sealed, *data)
    known = [one for one in DataClass if one is not lacks]
    closed = {name for name in record(row).committed if lacks in classes_of(name) and lacks in data}
    whole, found = values(read(row)), values(read(row, *known))
    parts = {ACT, OBJECT, PARAMS, REGIONS}
    lost = {name for name in closed if not name.startswith(BOX)} - {LINKS, *SPOKEN}
    if lost & parts:
        assert "action" not in found
        told = act_of(found) or {}
        assert told.items() <= whole["action"].items()
    for name in lost - parts:
        assert (name in whole, name in found) == (True, False)
    assert ("by" in record(read(row, *known)).open) is not (
        lacks is DataClass.PERSON and lacks in data
    )


SECRETS = {
    "action": {"type": "zz-type", "tool": "zz-tool", "object": "zz-object", "source": "zz-from"}
    | {"destination": "zz-to", "route": ["zz-way"], "params": {"zz-speed": 1}},
    "approvals": ["zz-token"],
    "findings": ["zz-finding"],
    "state": ["zz-pose"],
    "standing": ["zz-row"],
    "why": "zz-why",
    "command": "zz-command",
}


def test_whoever_has_no_key_finds_no_word_of_what_is_sealed() -> None:
    row = sealed_row(SECRETS, open={"by": "zz-anna", "approvers": ["zz-bert"], "grant": "zz-grant"})
    assert b'"zz-' not in row.record + row.sealed  # without a quote chance could write it
    assert ACTION.encode() not in row.record + row.sealed
    assert STATE.encode() not in row.record + row.sealed
    assert b"zz-anna" in read(row).record


@pytest.mark.parametrize(
    ("data", "reads", "not_reads"),
    [
        (DataClass.OBJECT, {"zz-object"}, {"zz-from", "zz-speed", "zz-type", "zz-anna", "zz-pose"}),
        (DataClass.REGION, {"zz-from", "zz-to", "zz-way"}, {"zz-object", "zz-type", "zz-pose"}),
        (DataClass.PARAMETER, {"zz-speed"}, {"zz-object", "zz-to", "zz-finding"}),
        (DataClass.EVIDENCE, {"zz-type", "zz-tool"}, {"zz-object", "zz-finding", "zz-why"}),
        (DataClass.PERSON, {"zz-anna", "zz-command"}, {"zz-object", "zz-token", "zz-why"}),
    ],
)
def test_a_role_reads_its_own_fields_and_no_others(
    data: DataClass, reads: set[str], not_reads: set[str]
) -> None:
    row = read(sealed_row(SECRETS, open={"by": "zz-anna"}), data)
    seen = (row.record + row.sealed).decode()
    assert {word for word in reads if word in seen} == reads
    assert {word for word in not_reads if word in seen} == set()


def test_equal_fields_are_sealed_into_different_bytes() -> None:
    first, second = (sealed_row({"why": "no"}) for _ in range(2))
    assert values(first).keys() == values(second).keys()
    assert first.sealed != second.sealed
    assert record(first).committed != record(second).committed


def test_a_record_without_secrets_has_no_box() -> None:
    log = Log()
    append_covered(log, entry({"now": 1}, open={"n": 1}), cover(), salts=scenarios.random_bytes)
    row = row_of(log)
    assert read(row) is row


# somebody else's bytes


def with_box(row: LogRow, name: str, value: Any) -> LogRow:
    """Return the row with another value in a box's place; no chain is verified here."""
    items = read_sealed(row.sealed, where="")
    items[name] = Sealed(salt=b64(bytes(16)), value=value)
    return msgspec.structs.replace(row, sealed=encode_fast(items))


def refused(row: LogRow, **changes: Any) -> MalformedError:
    with pytest.raises(MalformedError) as error:
        read(row, **changes)
    assert error.value.where.startswith("record 0: ")
    return error.value


def test_a_box_opens_in_its_own_place_alone() -> None:
    row = sealed_row(SECRETS)
    assert "was not sealed for this place" in refused(row, robot="another").message
    assert "was not sealed for this place" in refused(row, key_of=lambda *_: bytes(32)).message
    other = sealed_row(SECRETS, mid="m-2")
    name = "box.object"
    assert (
        "was not sealed for this place" in refused(with_box(row, name, values(other)[name])).message
    )
    log = Log()
    for _ in range(2):
        append_covered(log, entry(SECRETS), cover(), salts=scenarios.random_bytes)
    box = values(row_of(log, 1))[name]
    assert "was not sealed for this place" in refused(with_box(row_of(log), name, box)).message


@pytest.mark.parametrize("field", ["text", "nonce"])
def test_a_box_that_was_changed_does_not_open(field: str) -> None:
    row = sealed_row(SECRETS)
    box = values(row)["box.object"]
    changed = {**box, field: ("B" if box[field][0] == "A" else "A") + box[field][1:]}
    assert not verify_rows([with_box(row, "box.object", changed)]).whole
    assert "was not sealed for this place" in refused(with_box(row, "box.object", changed)).message


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("box.nonsense", {"keys": 0, "nonce": "", "text": ""}),
        ("box.", {"keys": 0, "nonce": "", "text": ""}),
        ("box.object", "text"),
        ("box.object", {"keys": 0, "nonce": "", "text": "", "more": 1}),
        ("box.object", {"keys": -1, "nonce": "", "text": ""}),
    ],
)
def test_what_is_no_box_is_refused(name: str, value: Any) -> None:
    assert "expected a box" in refused(with_box(sealed_row(SECRETS), name, value)).message


@pytest.mark.parametrize("nonce", ["", "AAAA", b64(bytes(12)), b64(bytes(200))])
def test_a_nonce_of_any_length_opens_nothing(nonce: str) -> None:
    box = {"keys": 0, "nonce": nonce, "text": b64(bytes(40))}
    assert (
        "was not sealed for this place"
        in refused(with_box(sealed_row(SECRETS), "box.object", box)).message
    )


def forged(sealed: dict[str, Sealed], **changes: Any) -> LogRow:
    """Return a row whose box holds these values, sealed with the right key in the right place."""
    import authguard_r.audit.sealed_envelopes as module

    row = sealed_row({"why": "because"}, DataClass.PERSON)
    place = module._Where(robot=scenarios.RID, mid="m-1", seq=0, classes=(DataClass.PERSON,))
    items = {name: encode_fast(one)[1:] for name, one in sealed.items()}
    made = module._sealed(items, cover(), place, scenarios.random_bytes)
    kept = read_record(row.record, where="")
    changed = msgspec.structs.replace(kept, committed={**kept.committed, **changes})
    row = msgspec.structs.replace(row, record=encode_fast(changed))
    return with_box(row, "box.person", msgspec.to_builtins(made))


def test_a_gate_that_sealed_another_value_than_it_committed_to_is_found() -> None:
    lie = forged({"why": Sealed(salt=b64(bytes(16)), value="another reason")})
    assert "does not match its commitment" in refused(lie).message
    assert (
        "does not match its commitment"
        in refused(forged({"new": Sealed(salt="", value=1)})).message
    )


def test_a_link_that_is_not_the_commitment_to_the_digests_is_found() -> None:
    from authguard_r.audit.record import commit

    links = Sealed(salt=b64(bytes(16)), value={"action": ACTION, "state": NONE})
    said = refused_links(links, commit(LINKS, links))
    assert "commitment to both digests" in said.message
    broken = Sealed(salt=b64(bytes(16)), value=["no", "links"])
    assert refused_links(broken, commit(LINKS, broken)).where == "record 0: links"


def refused_links(links: Sealed, commitment: str) -> MalformedError:
    return refused(forged({LINKS: links}, links=commitment))


def test_what_is_known_of_an_action_is_told() -> None:
    whole = {"type": "grasp", "object": "box-1"}
    assert act_of({"action": whole}) == whole
    assert act_of({"action": "nonsense"}) is None
    assert act_of({OBJECT: {"object": "box-1"}, REGIONS: "nonsense"}) == {"object": "box-1"}
    assert act_of({"now": 1}) is None
    row = sealed_row({"action": ["an", "emergency's"]})
    assert values(read(row))["action"] == ["an", "emergency's"]


def test_a_box_has_a_shape() -> None:
    row = sealed_row({"why": "no"})
    assert boxes(row) == [
        "box.evidence+object+parameter+region",
        "box.evidence+person",
        "box.person",
    ]
    name = "box.person"
    assert len(msgspec.convert(values(row)[name], SealedEnvelope).nonce) == 16
