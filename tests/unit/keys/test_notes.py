# SPDX-License-Identifier: Apache-2.0
"""Who signed a note: the log with every key that it has, and each witness at its time.

Source: C2SP signed-note, tlog-cosignature; docs/spec/checkpoint.md#signatures
"""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1
from cryptography.hazmat.primitives.asymmetric.ec import generate_private_key as generate_ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from authguard_r.audit.checkpoint import Checkpoint, origin_of
from authguard_r.audit.note import Note, NoteKey, NoteSignature, encode64, read_key, read_note
from authguard_r.authoring.keys.setup import Member, init_folder
from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.certificate import Role
from authguard_r.keys.notes import (
    Attested,
    cosign,
    gate_keys,
    leaf_key,
    log_key,
    require_all,
    sign_text,
    verify_note,
    witness_key,
)
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import read_certificates, read_trust
from fixtures.amount import amount
from unit.keys import chains
from unit.keys.chains import NOW, TODAY, key_of

LAW = settings(max_examples=amount(80, 400))
ROBOT = RobotId("courier-1")
ORIGIN = origin_of(ROBOT)
SAID = Checkpoint(origin=ORIGIN, size=3, root=bytes(32), chain=bytes(range(32)))
TEXT = SAID.text()
ALGORITHMS = tuple(Algorithm)
AT = 1_763_620_000


def signer_of(*algorithms: Algorithm) -> FileSigner:
    held = [(chains.leaf_of(algorithm), chains.house_of(algorithm)) for algorithm in algorithms]
    (first, *others) = [(own.key, (own.der, house.people.der)) for own, house in held]
    return FileSigner(*first, *others)


def keys_of(signer: FileSigner, name: str = ORIGIN) -> tuple[NoteKey, ...]:
    return tuple(log_key(name, leaf_key(chain)) for chain, _ in signer.endorse(b""))


def signed(*algorithms: Algorithm) -> tuple[Note, tuple[NoteKey, ...]]:
    signer = signer_of(*algorithms)
    return Note(TEXT, sign_text(TEXT, ORIGIN, signer)), keys_of(signer)


def refused(reason: Reason, note: Note, *keys: NoteKey) -> AuthGuardError:
    with pytest.raises(AuthGuardError) as caught:
        verify_note(note, keys, where="note")
    assert caught.value.reason is reason
    return caught.value


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_log_signs_with_each_algorithm_and_its_key_is_read_from_text(
    algorithm: Algorithm,
) -> None:
    note, (key,) = signed(algorithm)
    assert read_key(key.text(), where="") == key
    read = read_note(note.encode(), where="")
    assert verify_note(read, (key,), where="") == (Attested(key),)
    assert require_all(read, (key,), where="") == SAID


def test_a_hybrid_log_signs_twice_and_both_have_to_hold() -> None:
    note, keys = signed(Algorithm.ED25519, Algorithm.ML_DSA_65)
    assert len(note.signatures) == len({key.kind for key in keys}) == 2
    assert require_all(note, keys, where="") == SAID
    for place in range(2):
        alone = Note(TEXT, (note.signatures[place],))
        with pytest.raises(AuthenticityError) as caught:
            require_all(alone, keys, where="note")
        assert caught.value.reason is Reason.SIGNATURE_MISSING
        other = note.signatures[1 - place]
        broken = replace(other, signature=bytes(len(other.signature)))
        refused(Reason.SIGNATURE_INVALID, Note(TEXT, (alone.signatures[0], broken)), *keys)


def test_a_log_without_a_known_key_has_signed_nothing() -> None:
    note, _ = signed(Algorithm.ED25519)
    with pytest.raises(AuthenticityError) as caught:
        require_all(note, (), where="note")
    assert caught.value.reason is Reason.SIGNATURE_MISSING


def test_signatures_of_strangers_are_not_looked_at() -> None:
    note, (key,) = signed(Algorithm.ED25519)
    junk = (
        NoteSignature("stranger", key.id, b"junk"),
        NoteSignature(key.name, b"\0\0\0\0", b"junk"),
    )
    assert verify_note(Note(TEXT, (*junk, *note.signatures)), (key,), where="") == (Attested(key),)
    assert verify_note(Note(TEXT, junk), (key,), where="") == ()
    # a second signature of one known key counts no more, and has to hold all the same
    twice = Note(TEXT, (*note.signatures, *note.signatures))
    assert verify_note(twice, (key,), where="") == (Attested(key),)
    wrong = replace(note.signatures[0], signature=bytes(64))
    refused(Reason.SIGNATURE_INVALID, Note(TEXT, (*note.signatures, wrong)), key)


@pytest.mark.parametrize("algorithm", [Algorithm.ED25519, Algorithm.ML_DSA_44])
def test_a_witness_cosigns_at_its_time(algorithm: Algorithm) -> None:
    own = key_of(algorithm, "witness")
    key = witness_key("w.example", own.public_key())
    note = Note(TEXT, (cosign(TEXT, "w.example", own, AT),))
    read = read_note(note.encode(), where="")
    assert verify_note(read, (read_key(key.text(), where=""),), where="") == (Attested(key, AT),)
    # the time is signed
    late = replace(note.signatures[0], signature=(AT + 1).to_bytes(8, "big") + bytes(64))
    stamped = note.signatures[0].signature[8:]
    moved = replace(late, signature=(AT + 1).to_bytes(8, "big") + stamped)
    refused(Reason.SIGNATURE_INVALID, Note(TEXT, (moved,)), key)


def test_what_an_ed25519_cosignature_is_over_is_the_published_message() -> None:
    own = key_of(Algorithm.ED25519, "witness")
    public = own.public_key()
    assert isinstance(public, Ed25519PublicKey)
    line = cosign(TEXT, "w.example", own, AT)
    assert int.from_bytes(line.signature[:8], "big") == AT
    public.verify(line.signature[8:], f"cosignature/v1\ntime {AT}\n{TEXT}".encode())


def test_a_cosignature_of_ml_dsa_names_witness_log_size_and_root() -> None:
    own = key_of(Algorithm.ML_DSA_44, "witness")
    line = cosign(TEXT, "w.example", own, AT)
    message = (
        b"subtree/v1\n\x00"
        b"\x09w.example"
        + AT.to_bytes(8, "big")
        + bytes([len(ORIGIN)])
        + ORIGIN.encode()
        + bytes(8)
        + (3).to_bytes(8, "big")
        + bytes(32)
    )
    own.public_key().verify(line.signature[8:], message)
    with pytest.raises(MalformedError, match="1 to 255 bytes"):
        cosign(TEXT, "w" * 256, own, AT)


def test_a_signature_of_one_kind_is_none_of_the_other() -> None:
    # one Ed25519 key as a log and as a witness: the ids differ, and so does what is signed
    own = key_of(Algorithm.ED25519, "both")
    log, witness = log_key("n", own.public_key()), witness_key("n", own.public_key())
    assert log.id != witness.id
    text_signature = own.sign(TEXT.encode())
    as_witness = NoteSignature("n", witness.id, AT.to_bytes(8, "big") + text_signature)
    refused(Reason.SIGNATURE_INVALID, Note(TEXT, (as_witness,)), witness)
    cosigned = cosign(TEXT, "n", own, AT)
    as_log = NoteSignature("n", log.id, cosigned.signature[8:])
    refused(Reason.SIGNATURE_INVALID, Note(TEXT, (as_log,)), log)


def test_a_cosignature_without_a_time_or_with_one_beyond_is_none() -> None:
    own = key_of(Algorithm.ED25519, "witness")
    key = witness_key("w", own.public_key())
    for signature in (b"1234567", b"\x80" + bytes(71)):
        note = Note(TEXT, (NoteSignature("w", key.id, signature),))
        refused(Reason.MALFORMED, note, key)


def test_only_a_checkpoint_is_cosigned() -> None:
    own = key_of(Algorithm.ED25519, "witness")
    with pytest.raises(MalformedError):
        cosign("a letter\n", "w", own, AT)
    key = witness_key("w", own.public_key())
    note = Note("a letter\n", (NoteSignature("w", key.id, bytes(72)),))
    refused(Reason.MALFORMED, note, key)
    log = log_key("n", own.public_key())
    letter = Note("a letter\n", (NoteSignature("n", log.id, own.sign(b"a letter\n")),))
    assert verify_note(letter, (log,), where="") == (Attested(log),)
    with pytest.raises(MalformedError):
        require_all(letter, (log,), where="")


def test_keys_that_nobody_can_use_are_refused() -> None:
    key = log_key("n", key_of(Algorithm.ED25519, "log").public_key())
    for unusable in (
        replace(key, kind=b"\x02"),
        replace(key, public=b"short"),
        replace(key, public=bytes(31) + b"\x80"),  # a point of low order: everybody signs for it
    ):
        note = Note(TEXT, (NoteSignature("n", unusable.id, bytes(64)),))
        refused(Reason.KEY_INVALID, note, unusable)
    with pytest.raises(AuthenticityError) as caught:
        witness_key("w", key_of(Algorithm.ML_DSA_65, "witness").public_key())
    assert caught.value.reason is Reason.KEY_INVALID


def test_the_certificate_of_another_kind_of_key_gives_none() -> None:
    own = generate_ec(SECP256R1())
    by = chains.house().people
    certificate = chains.leaf(by, public=own.public_key())
    with pytest.raises(AuthenticityError) as caught:
        leaf_key((certificate.der, by.der))
    assert caught.value.reason is Reason.KEY_INVALID


@LAW
@given(st.data())
def test_no_changed_note_verifies(data: st.DataObject) -> None:
    note, (key,) = signed(Algorithm.ED25519)
    own = key_of(Algorithm.ED25519, "witness")
    witness = witness_key("w.example", own.public_key())
    whole = Note(TEXT, (*note.signatures, cosign(TEXT, "w.example", own, AT))).encode()
    changed = bytearray(whole)
    at = data.draw(st.integers(0, len(whole) - 1))
    trick = data.draw(st.sampled_from(["turn", "drop", "insert"]))
    if trick == "turn":
        changed[at] ^= 1 << data.draw(st.integers(0, 7))
    elif trick == "drop":
        del changed[at]
    else:
        changed.insert(at, data.draw(st.integers(0, 255)))
    try:
        read = read_note(bytes(changed), where="")
        found = verify_note(read, (key, witness), where="")
    except AuthGuardError:
        return
    # a name or an id that was changed makes a signature a stranger's; the text is the signed one
    assert bytes(changed) == whole or len(found) < 2
    assert not found or read.text == TEXT


# the folder of a set-up

MEMBERS = (
    Member(id="gate-courier-1", role=Role.GATE, robots=("courier-1",), profile="A" * 43),
    Member(id="gate-lifter-1", role=Role.GATE, robots=("lifter-1",), profile="A" * 43),
    Member(id="operator-1", role=Role.OPERATOR, robots=None, regions=None),
)


@pytest.fixture(scope="module")
def hybrid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("notes") / "trust"
    algorithms = (Algorithm.ED25519, Algorithm.ML_DSA_65)
    init_folder(folder, MEMBERS, now=TODAY, days=30, algorithms=algorithms)
    return folder


def test_a_gates_certificates_give_the_keys_of_its_log(hybrid: Path) -> None:
    found = read_certificates(hybrid / "keys/gate-courier-1.cert.pem", most=4)
    keys = gate_keys(found, robot=ROBOT, trust=read_trust(hybrid), now=NOW)
    signer = read_signer(
        hybrid / "keys/gate-courier-1.key.pem", hybrid / "keys/gate-courier-1.cert.pem"
    )
    assert keys == keys_of(signer)
    assert require_all(Note(TEXT, sign_text(TEXT, ORIGIN, signer)), keys, where="") == SAID


@pytest.mark.parametrize(
    ("name", "most", "reason"),
    [
        ("gate-lifter-1", 4, Reason.ROBOT_MISMATCH),
        ("operator-1", 4, Reason.ROLE_DENIED),
        ("gate-courier-1", 2, Reason.SIGNATURE_MISSING),
        ("gate-courier-1", 3, Reason.CERTIFICATE_INVALID),
    ],
)
def test_other_certificates_give_none(hybrid: Path, name: str, most: int, reason: Reason) -> None:
    found = read_certificates(hybrid / f"keys/{name}.cert.pem", most=4)[:most]
    with pytest.raises(AuthenticityError) as caught:
        gate_keys(found, robot=ROBOT, trust=read_trust(hybrid), now=NOW)
    assert caught.value.reason is reason


def test_a_key_is_named_with_its_id_and_its_kind() -> None:
    public = key_of(Algorithm.ED25519, "log").public_key()
    assert isinstance(public, Ed25519PublicKey)
    key = log_key("n", public)
    raw = b"\x01" + public.public_bytes_raw()
    assert key.text() == f"n+{key.id.hex()}+{encode64(raw)}"
