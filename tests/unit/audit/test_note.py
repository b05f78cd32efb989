# SPDX-License-Identifier: Apache-2.0
"""Signed notes have one spelling, and what is none is refused for what it is.

Source: C2SP signed-note; docs/spec/checkpoint.md#note
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.audit.note import (
    MAX_BYTES,
    MAX_SIGNATURES,
    Note,
    NoteKey,
    NoteSignature,
    decode64,
    encode64,
    is_name,
    read_key,
    read_note,
    read_signatures,
    signature_lines,
)
from authguard_r.core.errors import MalformedError
from fixtures.amount import amount
from fixtures.cases import case

LAW = settings(max_examples=amount(60, 300))
ONE = NoteSignature("log.example/1", b"\x01\x02\x03\x04", b"signature")
LINE = signature_lines((ONE,))
KEY = NoteKey("log.example/1", b"\x01", bytes(range(32)))
texts = st.text(
    alphabet=st.characters(exclude_categories=["Cs", "Cc"]) | st.just("\n"), max_size=60
)
names = st.text(
    alphabet=st.characters(exclude_categories=["Cs", "Cc", "Z"], exclude_characters="+"),
    min_size=1,
    max_size=12,
).filter(is_name)
signatures = st.builds(
    NoteSignature,
    names,
    st.binary(min_size=4, max_size=4),
    st.binary(min_size=1, max_size=80),
)


def refused(data: bytes, match: str) -> None:
    with pytest.raises(MalformedError, match=match) as caught:
        read_note(data, where="note")
    assert caught.value.where == "note"


@LAW
@given(texts, st.lists(signatures, min_size=1, max_size=4))
def test_a_note_reads_back_as_it_was_written(text: str, signed: list[NoteSignature]) -> None:
    note = Note(f"{text}x\n", tuple(signed))
    data = note.encode()
    assert read_note(data, where="") == note
    assert read_note(data, where="").encode() == data


@LAW
@given(st.binary(max_size=200) | texts.map(lambda text: text.encode() + b"\n\n" + LINE.encode()))
def test_whatever_is_read_has_no_second_spelling(data: bytes) -> None:
    try:
        note = read_note(data, where="")
    except MalformedError:
        return
    assert note.encode() == data


def test_a_text_may_hold_empty_lines_and_is_cut_at_the_last_one() -> None:
    note = read_note(f"a\n\nb\n\n{LINE}".encode(), where="")
    assert note == Note("a\n\nb\n", (ONE,))


def test_what_is_no_note_is_refused() -> None:
    assert read_note(f"a\n\n{LINE}".encode(), where="").signatures == (ONE,)
    refused(b"a\n\n" + LINE.encode() + b"x" * MAX_BYTES, f"at most {MAX_BYTES} bytes")
    refused(b"\xff\n\n" + LINE.encode(), "UTF-8")
    refused(f"a\tb\n\n{LINE}".encode(), "control characters")
    refused(f"a\r\n\n{LINE}".encode(), "control characters")
    refused(f"a\n{LINE}".encode(), "a text, a blank line and signatures")
    refused(f"\n\n{LINE}".encode(), "a text, a blank line and signatures")
    refused(f"a\n\n{LINE}".removesuffix("\n").encode(), "each with its newline")
    refused(b"a\n\n", "each with its newline")
    refused(f"a\n\n{LINE}b\n".encode(), "a signature line")
    refused(f"a\n\n{LINE * (MAX_SIGNATURES + 1)}".encode(), "at most 32 signatures")
    refused(f"a\n\n{LINE.replace('—', '-')}".encode(), "a signature line")
    refused(f"a\n\n{LINE.replace('log.example/1', 'a+b')}".encode(), "a signature line")
    refused("a\n\n— \n".encode(), "a signature line")
    refused("a\n\n— name\n".encode(), "a key's id and a signature")
    refused("a\n\n— name AAAA\n".encode(), "a key's id and a signature")
    refused("a\n\n— name AAAAAA==\n".encode(), "a key's id and a signature")
    refused("a\n\n— name AAAAAAA\n".encode(), "base64")
    refused("a\n\n— name AAAAAAB=\n".encode(), "without bits to spare")
    refused("a\n\n— name AAAA AAAA\n".encode(), "base64")


def test_signatures_are_read_by_themselves_as_a_witness_answers() -> None:
    two = (ONE, NoteSignature("w", b"abcd", b"12345678"))
    assert read_signatures(signature_lines(two).encode(), where="") == two
    with pytest.raises(MalformedError, match="UTF-8"):
        read_signatures(b"\xff\n", where="")
    with pytest.raises(MalformedError, match="each with its newline"):
        read_signatures(b"", where="")


def test_a_verifier_key_reads_back() -> None:
    for key in (KEY, NoteKey("log", b"\xffauthguard-r/ml-dsa-65/1\x00", b"k" * 40)):
        assert read_key(f" {key.text()}\n", where="--key") == key


def test_what_is_no_verifier_key_is_refused() -> None:
    for text in [
        "",
        "name",
        "name+00000000",
        "+00000000+AQAA",
        "na me+00000000+AQAA",
        "name+00000000+",
        "name+00000000+AQA",
        # a long kind that does not end
        "name+00000000+/25vIGVuZA==",
    ]:
        with case(text), pytest.raises(MalformedError):
            read_key(text, where="--key")


def test_a_key_under_another_keys_id_is_refused() -> None:
    other = NoteKey(KEY.name, KEY.kind, bytes(32))
    text = KEY.text().replace(KEY.id.hex(), other.id.hex())
    with pytest.raises(MalformedError, match="the id that belongs to the key"):
        read_key(text, where="--key")
    with pytest.raises(MalformedError, match="the id that belongs to the key"):
        read_key(KEY.text().replace(KEY.id.hex(), KEY.id.hex().upper() + "0"), where="--key")


def test_names_have_neither_spaces_nor_a_plus() -> None:
    assert is_name("authguard-r/courier-1/audit")
    assert [name for name in ("", "a b", "a+b", "a\u2003b", "a\n") if is_name(name)] == []


@LAW
@given(st.binary(max_size=40))
def test_base64_has_one_spelling(data: bytes) -> None:
    assert decode64(encode64(data), where="") == data


def test_other_base64_is_refused() -> None:
    for text in ["A", "AA", "AAA", "AA=", "AB==", "AA\n==", "A-==", "é"]:
        with case(text), pytest.raises(MalformedError, match="base64"):
            decode64(text, where="")
