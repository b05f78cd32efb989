# SPDX-License-Identifier: Apache-2.0
"""One byte string per object, one object per byte string, one tag per kind (L13)."""

from __future__ import annotations

import json
import string
from functools import cache
from hashlib import sha256
from typing import Any

import msgspec
import pytest
import rfc8785
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.core.encoding import (
    MAX_BYTES,
    Tag,
    b64,
    decode,
    digest,
    digest_of,
    encode,
    encode_fast,
    unb64,
)
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.mission import (
    Budgets,
    Closing,
    Comparison,
    DataRights,
    Grant,
    Guard,
    Limit,
    Mission,
    OnRefusal,
    ParameterRisk,
    Rate,
    RiskPolicy,
    Row,
    StateRisk,
)
from authguard_r.core.provenance import Chooser
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Token
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case

replace = msgspec.structs.replace
LAW = settings(max_examples=amount(50, 200))
#: Making a random mission takes far longer than encoding it.
MISSION_LAW = settings(max_examples=amount(15, 60))

#: Any text that UTF-8 can hold: control characters, DEL, quotes, astral, noncharacters.
texts = st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=40) | st.sampled_from(
    [
        "".join(map(chr, range(0x80))),
        "\x7f\x80\x9f\u2028\u2029\ufeff\ufffe\uffff",
        "\U0001f916\U0010ffff",
        '"\\/\b\f\n\r\t\0\x1f',
        "\u00e9 e\u0301",
    ]
)
ascii_keys = st.text(alphabet=st.characters(max_codepoint=0x7F), max_size=12)
integers = st.integers(-MAX_INTEGER, MAX_INTEGER)
plain = st.recursive(
    texts | integers | st.booleans(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(ascii_keys, inner, max_size=5),
    max_leaves=30,
)

identifiers = st.text(string.ascii_lowercase + string.digits, min_size=1, max_size=3).flatmap(
    lambda head: st.text(string.ascii_lowercase + string.digits + "_.:-", max_size=20).map(
        lambda tail: head + tail
    )
)
counts = st.integers(0, MAX_INTEGER)
positive = st.integers(1, MAX_INTEGER)
names = st.lists(identifiers, max_size=3).map(tuple)
maybe = st.none() | identifiers
digests = st.binary(min_size=32, max_size=32).map(b64)
weights = st.dictionaries(identifiers, counts, max_size=3)

rows = st.builds(Row, object=maybe, source=maybe, destination=maybe, regions=names)
limits = st.builds(Limit, parameter=identifiers, low=integers, high=integers)
guards = st.builds(
    Guard,
    variable=identifiers,
    comparison=st.sampled_from(Comparison),
    value=integers | st.booleans() | identifiers,
    max_age_ms=counts,
)
several_guards = st.lists(guards, max_size=2).map(tuple)
grants = st.builds(
    Grant,
    id=identifiers,
    type=identifiers,
    tool=identifiers,
    alternatives=st.lists(rows, min_size=1, max_size=3).map(tuple),
    chooser=st.sampled_from(Chooser),
    repeat=positive,
    starts=positive,
    max_ms=positive,
    irreversible=st.booleans(),
    limits=st.lists(limits, max_size=2).map(tuple),
    guards=several_guards,
    data=st.builds(DataRights, record=st.booleans(), store=st.booleans(), transmit=st.booleans()),
    after=names,
    until=names,
    done_when=several_guards,
    completes=st.booleans(),
)
budgets = st.builds(
    Budgets,
    actions=counts,
    rate=st.builds(Rate, count=positive, per_ms=positive),
    motion_ms=counts,
    wait_ms=counts,
    recorded_bytes=counts,
    prompts=counts,
    planner_stops=counts,
)
policies = st.builds(
    RiskPolicy,
    otherwise=counts,
    tau_1=counts,
    tau_2=counts,
    t=st.integers(2, 64),
    roles=st.lists(identifiers, min_size=1, max_size=3).map(tuple),
    privacy=counts,
    valid_ms=positive,
    types=weights,
    region_tags=weights,
    object_classes=weights,
    parameters=st.lists(
        st.builds(ParameterRisk, parameter=identifiers, full_scale=positive, weight=counts),
        max_size=2,
    ).map(tuple),
    states=st.lists(st.builds(StateRisk, guard=guards, weight=counts), max_size=2).map(tuple),
)
changes = st.fixed_dictionaries(
    {},
    optional={
        "mid": identifiers,
        "rid": identifiers,
        "issuer": identifiers,
        "version": positive,
        "supersedes": st.none() | digests,
        "profile": digests,
        "task": texts.filter(bool),
        "actions": st.lists(grants, min_size=1, max_size=3).map(tuple),
        "objects": names,
        "regions": names,
        "limits": st.lists(limits, max_size=2).map(tuple),
        "guards": several_guards,
        "place_max_age_ms": counts,
        "budgets": budgets,
        "risk_policy": policies,
        "on_refusal": st.sampled_from(OnRefusal),
        "closing": st.none()
        | st.builds(
            Closing,
            grants=st.lists(identifiers, min_size=1, max_size=2).map(tuple),
            for_ms=positive,
        ),
    },
)


@cache
def story() -> Mission:
    return scenarios.mission()


missions = changes.map(lambda fields: replace(story(), **fields))


def refused(
    data: bytes, reason: Reason | None = None, kind: Any = Mission, where: str = "x"
) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        decode(data, kind, where=where)
    assert reason is None or caught.value.reason is reason
    assert caught.value.where.startswith(where)
    return caught.value


# -- one byte string per object --------------------------------------------------------------------


@LAW
@given(plain)
def test_the_fast_encoder_writes_the_bytes_of_the_canonical_one(value: Any) -> None:
    assert encode_fast(value) == encode(value) == rfc8785.dumps(value)


@MISSION_LAW
@given(missions)
def test_both_encoders_agree_on_every_mission(value: Mission) -> None:
    assert encode_fast(value) == encode(value) == rfc8785.dumps(msgspec.to_builtins(value))


@MISSION_LAW
@given(missions)
def test_a_mission_is_decoded_as_it_was_encoded(value: Mission) -> None:
    assert decode(encode(value), Mission) == value


@MISSION_LAW
@given(missions, missions)
def test_two_missions_share_their_bytes_only_when_they_are_one(one: Mission, two: Mission) -> None:
    same = one == two
    assert (encode_fast(one) == encode_fast(two)) == same
    assert (digest_of(Tag.MISSION, one) == digest_of(Tag.MISSION, two)) == same


def test_every_character_that_json_must_escape_is_escaped_as_rfc_8785_says() -> None:
    for text in [chr(code) for code in [*range(0x21), 0x22, 0x5C, 0x7F, 0x80]]:
        with case(text):
            short = {"\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}
            short |= {'"': '\\"', "\\": "\\\\"}
            expected = short.get(text, f"\\u{ord(text):04x}" if text < " " else text)
            assert encode_fast(text) == encode(text) == f'"{expected}"'.encode()


@pytest.mark.parametrize("number", [0, -1, 1, MAX_INTEGER, -MAX_INTEGER, 10**15, 1 << 31])
def test_integers_are_written_plainly_up_to_the_last_exact_one(number: int) -> None:
    assert encode_fast(number) == encode(number) == str(number).encode()


def test_keys_are_sorted_at_every_level() -> None:
    value = {"b": [{"z": 1, "a": 2}], "a": {"~": 1, "_": 2, "A": 3, "": 4}}
    expected = b'{"a":{"":4,"A":3,"_":2,"~":1},"b":[{"a":2,"z":1}]}'
    assert encode_fast(value) == encode(value) == expected


def test_what_signed_data_cannot_hold_is_a_caller_s_mistake() -> None:
    for value in [
        1.0,
        0.5,
        float("nan"),
        float("inf"),
        None,
        [None],
        {"a": {"b": [1.5]}},
        [[[None]]],
    ]:
        with case(value), pytest.raises(TypeError):
            encode(value)


@pytest.mark.parametrize("number", [MAX_INTEGER + 1, -MAX_INTEGER - 1, 2**64, 10**40])
def test_an_integer_that_a_double_cannot_hold_is_never_signed(number: int) -> None:
    with pytest.raises(ValueError, match="safe integer"):
        encode({"a": number})


# -- one object per byte string --------------------------------------------------------------------


@settings(max_examples=amount(100, 500))
@given(st.data())
def test_every_accepted_byte_string_is_the_encoding_of_what_it_says(data: st.DataObject) -> None:
    """Flip, insert, delete, repeat: refused as malformed, or canonical after all."""
    good = encode_fast(story())
    at = data.draw(st.integers(0, len(good) - 1))
    length = data.draw(st.integers(0, 3))
    new = data.draw(
        st.binary(max_size=3)
        | st.sampled_from(
            [b" ", b"\n", b"0", b"-", b'"', b",", b"\\u0061", b"null", b"1.0", b"1e0"]
        )
        | st.just(good[at : at + data.draw(st.integers(0, 40))] * 2)
    )
    changed = good[:at] + new + good[at + length :]
    try:
        found = decode(changed, Mission, where="x")
    except MalformedError as error:
        refusal = error
    else:
        assert encode(found) == changed
        return
    assert refusal.reason in {Reason.MALFORMED, Reason.NOT_CANONICAL}
    assert refusal.where.startswith("x")


@LAW
@given(st.binary(max_size=60), st.sampled_from([Mission, Token, Row, Limit, dict, list, object]))
def test_no_bytes_at_all_raise_anything_but_malformed(data: bytes, kind: Any) -> None:
    try:
        found = decode(data, kind)
    except MalformedError:
        return
    assert encode_fast(found) == data


@LAW
@given(st.text(alphabet='{}[]",:0123456789.eE+-truefalsn \\u', max_size=40))
def test_no_nearly_json_text_raises_anything_but_malformed(text: str) -> None:
    for kind in (Row, dict, object):
        try:
            found = decode(text.encode(), kind)
        except MalformedError:
            continue
        assert encode_fast(found) == text.encode()


LIMIT = b'{"high":9,"low":0,"parameter":"speed_mm_s"}'


def test_the_limit_that_the_next_tests_change_is_accepted_as_it_is() -> None:
    assert decode(LIMIT, Limit) == Limit(parameter="speed_mm_s", low=0, high=9)


def test_a_second_spelling_is_not_canonical() -> None:
    for data in [
        b" " + LIMIT,
        LIMIT + b" ",
        LIMIT + b"\n",
        LIMIT.replace(b":", b": "),
        LIMIT.replace(b",", b"\n,"),
        LIMIT.replace(b"{", b"{\t"),
        b'{"low":0,"high":9,"parameter":"speed_mm_s"}',
        b'{"high":8,"high":9,"low":0,"parameter":"speed_mm_s"}',
        b'{"high":9,"high":9,"low":0,"parameter":"speed_mm_s"}',
        LIMIT.replace(b'"low"', b'"\\u006cow"'),
        LIMIT.replace(b"speed", b"sp\\u0065ed"),
        LIMIT.replace(b"speed", b"sp\\u0065\\u0065d"),
        LIMIT.replace(b'"low":0', b'"low":-0'),
    ]:
        with case(data):
            assert refused(data, Reason.NOT_CANONICAL, Limit).where == "x"


def test_anything_else_is_malformed_in_its_place() -> None:
    for data, where in [
        (LIMIT.replace(b"9", b"9.0"), "x.high"),
        (LIMIT.replace(b"9", b"9e0"), "x.high"),
        (LIMIT.replace(b"9", b"0.9"), "x.high"),
        (LIMIT.replace(b"9", b"null"), "x.high"),
        (LIMIT.replace(b"9", b"true"), "x.high"),
        (LIMIT.replace(b"9", b'"9"'), "x.high"),
        (LIMIT.replace(b"9", b"[9]"), "x.high"),
        (LIMIT.replace(b"9", b"9007199254740992"), "x.high"),
        (LIMIT.replace(b"9", b"9" * 400), "x.high"),
        (LIMIT.replace(b"9", b"1e400"), "x.high"),
        (LIMIT.replace(b"9", b"09"), "x"),
        (LIMIT.replace(b"9", b"+9"), "x"),
        (LIMIT.replace(b"9", b"NaN"), "x"),
        (LIMIT.replace(b"9", b"Infinity"), "x"),
        (LIMIT.replace(b"9", b"-Infinity"), "x"),
        (LIMIT.replace(b"9", b"0x9"), "x"),
        (LIMIT.replace(b'"low":0,', b""), "x"),
        (LIMIT.replace(b'"low":0', b'"low":0,"mean":0'), "x"),
        (LIMIT.replace(b"speed_mm_s", b"Speed"), "x.parameter"),
        (LIMIT.replace(b"speed_mm_s", b"speed\\n"), "x.parameter"),
        (LIMIT.replace(b"speed_mm_s", b"spe\xd0\xb5d"), "x.parameter"),
        (LIMIT.replace(b"speed_mm_s", b"a" * 65), "x.parameter"),
        (LIMIT.replace(b"speed_mm_s", b"speed\n"), "x"),
        (LIMIT.replace(b"speed_mm_s", b"\\ud800"), "x"),
        (LIMIT.replace(b"speed_mm_s", b"\xff"), "x"),
        (LIMIT + b"}", "x"),
        (LIMIT + LIMIT, "x"),
        (LIMIT + b"\0", "x"),
        (LIMIT[:-1], "x"),
        (b"\xef\xbb\xbf" + LIMIT, "x"),
        (LIMIT.decode().encode("utf-16"), "x"),
        (b"[" + LIMIT + b"]", "x"),
        (b"//\n" + LIMIT, "x"),
        (b"", "x"),
        (b"null", "x"),
        (b"[" * 100_000, "x"),
        (b'{"high":' * 100_000, "x.high"),
    ]:
        with case(data, where):
            assert refused(data, Reason.MALFORMED, Limit).where == where


@pytest.mark.parametrize("kind", [object, dict, list])
def test_nesting_that_would_overflow_the_stack_is_malformed(kind: Any) -> None:
    for data in (b"[" * 200_000, b"[" * 200_000 + b"]" * 200_000, b'{"":' * 100_000):
        refused(data, Reason.MALFORMED, kind)


def test_an_absent_field_has_one_spelling_which_is_to_be_left_out() -> None:
    assert decode(b"{}", Row) == Row()
    for data in (b'{"object":null}', b'{"regions":[]}', b'{"source":null}'):
        refused(data, Reason.NOT_CANONICAL, Row)
    assert decode(b'{"object":"p"}', Row) == Row(object="p")


def test_every_default_of_a_mission_written_out_is_not_canonical() -> None:
    """So that no two byte strings mean one mission, whoever writes them."""
    whole = json.loads(encode(story()))
    for number, spelled in enumerate(whole["actions"]):
        for field in ("after", "completes", "done_when", "guards", "limits", "until"):
            default = False if field == "completes" else []
            if field not in spelled:
                changed = json.loads(encode(story()))
                changed["actions"][number][field] = default
                data = rfc8785.dumps(changed)
                assert refused(data, Reason.NOT_CANONICAL).where == "x"


def test_the_longest_object_is_accepted_and_one_byte_more_is_not() -> None:
    assert MAX_BYTES == 1_048_576  # docs/spec/encoding.md
    longest = b'"' + b"a" * (MAX_BYTES - 2) + b'"'
    assert len(decode(longest, str)) == MAX_BYTES - 2
    error = refused(b'"' + b"a" * (MAX_BYTES - 1) + b'"', Reason.MALFORMED, str)
    assert error.where == "x"
    assert str(MAX_BYTES + 1) in error.message


@pytest.mark.parametrize(
    ("where", "data", "place"),
    [
        ("token", b'{"regions":["a",1]}', "token.regions[1]"),
        ("", b'{"regions":["a",1]}', "regions[1]"),
        ("token", b"[]", "token"),
        ("", b"[]", ""),
    ],
)
def test_the_place_is_named_below_the_caller_s_own(where: str, data: bytes, place: str) -> None:
    assert refused(data, Reason.MALFORMED, Row, where=where).where == place


# -- digests ---------------------------------------------------------------------------------------


@LAW
@given(st.binary(max_size=60), st.sampled_from(Tag))
def test_a_digest_is_the_hash_of_tag_zero_and_bytes(data: bytes, tag: Tag) -> None:
    assert unb64(digest(tag, data)) == sha256(tag.value.encode() + b"\x00" + data).digest()


@LAW
@given(plain)
def test_one_value_has_another_digest_under_every_tag(value: Any) -> None:
    found = {digest_of(tag, value) for tag in Tag}
    assert len(found) == len(Tag)
    assert digest_of(Tag.MISSION, value) == digest(Tag.MISSION, encode(value))


def test_no_tag_with_its_zero_is_the_beginning_of_another() -> None:
    marks = [tag.encode() + b"\0" for tag in Tag]
    for one in marks:
        assert one.isascii()
        assert one.count(b"\0") == 1
        assert not any(two.startswith(one) for two in marks if two != one)


# -- base64url -------------------------------------------------------------------------------------


@LAW
@given(st.binary(max_size=80))
def test_base64url_is_read_as_it_was_written(data: bytes) -> None:
    text = b64(data)
    assert unb64(text) == data
    assert set(text) <= set(string.ascii_letters + string.digits + "-_")


@LAW
@given(st.text(alphabet=string.ascii_letters + string.digits + "-_+/= \n", max_size=12))
def test_base64url_has_one_spelling_for_every_byte_string(text: str) -> None:
    try:
        data = unb64(text, where="x")
    except MalformedError as error:
        refusal = error
    else:
        assert b64(data) == text
        return
    assert refusal.where == "x"


@pytest.mark.parametrize("text", ["AB", "AAB", "AAAAAAB"])
def test_a_second_spelling_of_base64url_is_not_canonical(text: str) -> None:
    with pytest.raises(MalformedError) as caught:
        unb64(text, where="token.payload")
    assert caught.value.reason is Reason.NOT_CANONICAL
    assert caught.value.where == "token.payload"


def test_text_that_is_no_base64url_is_malformed() -> None:
    for text in [
        *("A", "AAAAA", "\u0410\u0410", "\ud800", "AA\u00e9", "AA\n", " AA", "A\0AA"),
        *("AA==", "AA=", "AAAA=", "=", "====", "AA+A", "AA/A", "!!!!", "AAAA\n\n\n\n", "    AAAA"),
    ]:
        with case(text):
            with pytest.raises(MalformedError) as caught:
                unb64(text, where="token.payload")
            assert caught.value.reason is Reason.MALFORMED


@LAW
@given(st.binary(min_size=1, max_size=40))
def test_stray_bits_at_the_end_are_refused(data: bytes) -> None:
    assume(len(data) % 3)
    text = b64(data)
    alphabet = string.ascii_uppercase + string.ascii_lowercase + string.digits + "-_"
    for offset in range(1, 4 if len(data) % 3 == 2 else 16):
        twin = text[:-1] + alphabet[alphabet.index(text[-1]) + offset]
        with pytest.raises(MalformedError) as caught:
            unb64(twin)
        assert caught.value.reason is Reason.NOT_CANONICAL
