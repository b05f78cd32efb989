# SPDX-License-Identifier: Apache-2.0
"""Signed notes: a text, a blank line, and lines that each hold one signature over the text.

The format is C2SP's signed-note, so that a checkpoint is read by software that never heard of
robots. Here is the format alone; signatures are verified in `authguard_r.keys.notes`.
Spec page: docs/spec/checkpoint.md#note
"""

from __future__ import annotations

import binascii
from base64 import b64decode, b64encode
from hashlib import sha256

from msgspec import Struct

from authguard_r.core.errors import MalformedError

#: Longest note, in bytes: 16 signatures of the largest kind, and room for the text.
MAX_BYTES = 1 << 17
#: Most signature lines of one note.
MAX_SIGNATURES = 32
#: Begins a signature line: em dash and space.
_DASH = "\u2014 "
_ID_BYTES = 4


class NoteKey(Struct, frozen=True):
    """A public key that signs notes, under a name.

    Args:
        name: who; no space and no plus.
        kind: what it signs with and over: the signature type's bytes, `0x01` an Ed25519 signature
            over the text, `0x04` a witness's cosignature.
        public: the raw key.
    """

    name: str
    kind: bytes
    public: bytes

    @property
    def id(self) -> bytes:
        """The 4 bytes that stand before its signatures; a hint, not a proof."""
        named = f"{self.name}\n".encode()
        return sha256(named + self.kind + self.public).digest()[:_ID_BYTES]

    def text(self) -> str:
        """Return the verifier key as people hand it on: `name+id+base64`."""
        return f"{self.name}+{self.id.hex()}+{encode64(self.kind + self.public)}"


class NoteSignature(Struct, frozen=True):
    """One signature line.

    Args:
        name: whose it says it is.
        key_id: of which key.
        signature: what the key's kind makes.
    """

    name: str
    key_id: bytes
    signature: bytes


class Note(Struct, frozen=True):
    """A note whose signatures are not checked yet.

    Args:
        text: with its last newline.
        signatures: in their order.
    """

    text: str
    signatures: tuple[NoteSignature, ...]

    def encode(self) -> bytes:
        """Return the note's bytes."""
        return f"{self.text}\n{signature_lines(self.signatures)}".encode()


def signature_lines(signatures: tuple[NoteSignature, ...]) -> str:
    """Return signature lines as they stand in a note."""
    return "".join(
        f"{_DASH}{one.name} {encode64(one.key_id + one.signature)}\n" for one in signatures
    )


def read_note(data: bytes, *, where: str) -> Note:
    """Return the note in the bytes.

    Raises:
        MalformedError: too long, no UTF-8, control characters, no text, no signature, or a line
            behind the text that is no signature.
    """
    if len(data) > MAX_BYTES:
        raise MalformedError(f"expected at most {MAX_BYTES} bytes, got {len(data)}", where=where)
    whole = _text(data, where)
    text, blank, lines = whole.rpartition("\n\n")
    if not blank or not text:
        raise MalformedError("expected a text, a blank line and signatures", where=where)
    return Note(f"{text}\n", read_signatures(lines.encode(), where=where))


def read_signatures(data: bytes, *, where: str) -> tuple[NoteSignature, ...]:
    """Return the signatures in lines as they stand in a note.

    Raises:
        MalformedError: no signature line, or a line that is not a signature.
    """
    whole = _text(data, where)
    if not whole.endswith("\n"):
        raise MalformedError("expected signature lines, each with its newline", where=where)
    lines = whole[:-1].split("\n")
    if len(lines) > MAX_SIGNATURES:
        raise MalformedError(f"expected at most {MAX_SIGNATURES} signatures", where=where)
    return tuple(_signature(line, where) for line in lines)


def read_key(text: str, *, where: str) -> NoteKey:
    """Return the verifier key that a text spells.

    Args:
        text: `name+id+base64`, from a trusted source.
        where: for errors.

    Raises:
        MalformedError: it is no verifier key, or its id is another key's.
    """
    name, _, rest = text.strip().partition("+")
    stated, _, encoded = rest.partition("+")
    raw = decode64(encoded, where=where)
    if not is_name(name) or not raw:
        raise MalformedError("expected a verifier key: name+id+base64", where=where)
    # a kind without a byte of its own is 0xff and a name that ends with a zero
    kind_bytes = raw.find(b"\x00") + 1 if raw[0] == 0xFF else 1
    key = NoteKey(name, raw[:kind_bytes], raw[kind_bytes:])
    if not key.kind or key.id.hex() != stated:
        raise MalformedError("expected the id that belongs to the key", where=where)
    return key


def is_name(name: str) -> bool:
    """Return whether a text may name a key: something, without space or plus."""
    return bool(name) and "+" not in name and not any(sign.isspace() for sign in name)


def encode64(data: bytes) -> str:
    """Return standard base64, as notes have it; everything else here is base64url."""
    return b64encode(data).decode("ascii")


def decode64(text: str, *, where: str) -> bytes:
    """Return the bytes of standard base64 that spells them in the one way.

    Raises:
        MalformedError: it does not.
    """
    try:
        data = b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise MalformedError("expected base64", where=where) from error
    if encode64(data) != text:
        raise MalformedError("expected base64 without bits to spare", where=where)
    return data


def _text(data: bytes, where: str) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=where) from error
    if any(sign < " " and sign != "\n" for sign in text):
        raise MalformedError("expected no control characters", where=where)
    return text


def _signature(line: str, where: str) -> NoteSignature:
    name, _, encoded = line.removeprefix(_DASH).partition(" ")
    if not line.startswith(_DASH) or not is_name(name):
        raise MalformedError("expected a signature line", where=where)
    raw = decode64(encoded, where=where)
    if len(raw) <= _ID_BYTES:
        raise MalformedError("expected a key's id and a signature", where=where)
    return NoteSignature(name, raw[:_ID_BYTES], raw[_ID_BYTES:])
