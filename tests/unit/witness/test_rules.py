# SPDX-License-Identifier: Apache-2.0
"""Every answer of a witness by itself, in the order of the specification, each with a near miss."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable

import msgspec
import pytest

from authguard_r.audit.checkpoint import Checkpoint
from authguard_r.audit.note import Note, NoteKey, NoteSignature, read_key
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, generate
from authguard_r.keys.notes import cosign, log_key, witness_key
from authguard_r.witness import rules
from authguard_r.witness.rules import (
    RequestFinding,
    judge,
    own_part,
    read_request,
    require_log_keys,
)
from fixtures.cases import case
from fixtures.witness_process import ORIGIN, Log, request

LOG = Log().grow(20)
FORK = LOG.fork(8).grow(12)
STRANGER = Log().grow(20)
KNOWN = rules.WitnessedLog(origin=ORIGIN, keys=LOG.keys, size=10, root=LOG.root(10))
NEW = rules.WitnessedLog(origin=ORIGIN, keys=LOG.keys)


def found(
    body: bytes, known: rules.WitnessedLog | None = KNOWN
) -> tuple[int, RequestFinding, int | None]:
    try:
        verdict = judge(read_request(body), known)
    except MalformedError:
        return 400, RequestFinding.MALFORMED, None
    return verdict.status, verdict.finding, verdict.size


def odd(size: int, root: bytes, old: int = 10, proof: tuple[bytes, ...] = ()) -> bytes:
    """Ask for a checkpoint that the log signed and that its tree does not have."""
    text = Checkpoint(origin=ORIGIN, size=size, root=root).text()
    return request(old, proof, LOG.sign(text))


ANSWERS: dict[str, tuple[bytes, rules.WitnessedLog | None, int, RequestFinding, int | None]] = {
    "the next one": (LOG.ask(10), KNOWN, 200, RequestFinding.COSIGNED, None),
    "the first one": (LOG.ask(0), NEW, 200, RequestFinding.COSIGNED, None),
    "the same one again": (LOG.ask(10, 10), KNOWN, 200, RequestFinding.COSIGNED, None),
    "an empty log": (LOG.ask(0, 0), NEW, 200, RequestFinding.COSIGNED, None),
    "nobody knows it": (LOG.ask(10), None, 404, RequestFinding.UNKNOWN, None),
    "another's keys": (STRANGER.ask(10), KNOWN, 403, RequestFinding.UNSIGNED, None),
    "larger old size": (request(21, (), LOG.note()), KNOWN, 400, RequestFinding.IMPOSSIBLE, None),
    "old size too small": (LOG.ask(9), KNOWN, 409, RequestFinding.STALE, 10),
    "old size too large": (LOG.ask(11), KNOWN, 409, RequestFinding.STALE, 10),
    "asks for the size": (LOG.ask(0), KNOWN, 409, RequestFinding.STALE, 10),
    "of an unknown size": (LOG.ask(5), NEW, 409, RequestFinding.STALE, 0),
    "put back": (LOG.ask(7, 9), KNOWN, 409, RequestFinding.BEHIND, 10),
    "forked, and another old size": (FORK.ask(9, 10), KNOWN, 409, RequestFinding.FORKED, 10),
    "forked at the same size": (FORK.ask(10, 10), KNOWN, 409, RequestFinding.FORKED, None),
    "forked, with a proof": (
        odd(10, bytes(32), 10, (bytes(32),)),
        KNOWN,
        409,
        RequestFinding.FORKED,
        None,
    ),
    "empty, with another root": (odd(0, bytes(32), 0), NEW, 409, RequestFinding.FORKED, None),
    "forked before": (FORK.ask(10), KNOWN, 422, RequestFinding.UNPROVEN, None),
    "without a proof": (request(10, (), LOG.note()), KNOWN, 422, RequestFinding.UNPROVEN, None),
    "a proof too much": (
        request(10, (bytes(32),), LOG.note(10)),
        KNOWN,
        422,
        RequestFinding.UNPROVEN,
        None,
    ),
    "a proof from nothing": (
        request(0, (bytes(32),), LOG.note()),
        NEW,
        422,
        RequestFinding.UNPROVEN,
        None,
    ),
    "a proof of another": (
        request(10, LOG.proof(9), LOG.note()),
        KNOWN,
        422,
        RequestFinding.UNPROVEN,
        None,
    ),
}


def test_every_answer_is_the_specifications() -> None:
    for name, value in ANSWERS.items():
        with case(name):
            body, known, *expected = value
            assert found(body, known) == tuple(expected)


def test_every_finding_has_a_status_and_a_case() -> None:
    assert set(rules.STATUS) == set(RequestFinding)
    assert {case[3] for case in ANSWERS.values()} == set(RequestFinding) - {
        RequestFinding.MALFORMED
    }


@pytest.mark.parametrize(
    ("earlier", "later"),
    [
        # each body is wrong in two ways; the earlier step answers
        ("nobody knows it", (STRANGER.ask(10), None)),
        ("another's keys", (request(21, (), STRANGER.note()), KNOWN)),
        ("larger old size", (request(30, (), LOG.note()), NEW)),
        ("of an unknown size", (request(5, (), LOG.note()), NEW)),
    ],
)
def test_the_first_step_that_fails_answers(
    earlier: str, later: tuple[bytes, rules.WitnessedLog | None]
) -> None:
    assert found(*later)[:2] == ANSWERS[earlier][2:4]


NOTE = LOG.note().encode()
MALFORMED: dict[str, bytes] = {
    "nothing": b"",
    "no note": b"old 0\n",
    "no empty line": b"old 0\n" + NOTE,
    "no old size": b"\n" + NOTE,
    "no `old`": b"new 0\n\n" + NOTE,
    "no number": b"old \n\n" + NOTE,
    "leading zero": b"old 010\n\n" + NOTE,
    "a sign": b"old +1\n\n" + NOTE,
    "two spaces": b"old  1\n\n" + NOTE,
    "a space behind": b"old 1 \n\n" + NOTE,
    "Windows lines": b"old 1\r\n\r\n" + NOTE,
    "no ASCII": "old \u0661\n\n".encode() + NOTE,
    "too large a number": b"old 9007199254740992\n\n" + NOTE,
    "a short hash": b"old 10\n" + b64encode(bytes(31)) + b"\n\n" + NOTE,
    "no base64": b"old 10\n!\n\n" + NOTE,
    "base64url": b"old 10\n" + b"-" * 43 + b"=\n\n" + NOTE,
    "spare bits": b"old 10\n" + b"A" * 42 + b"B=\n\n" + NOTE,
    "64 hashes": request(10, (bytes(32),) * 64, LOG.note()),
    "no signature": request(10, (), LOG.text().encode()),
    "no checkpoint": request(10, (), LOG.sign(f"{ORIGIN}\n")),
    "no UTF-8": request(10, (), b"\xff" + NOTE),
    "too long": request(10, (), LOG.sign(LOG.text() + "x" * rules.MAX_BYTES + "\n")),
    "something behind": request(10, (), NOTE + b"x"),
}


def test_what_is_no_request_is_told_from_what_is_wrong() -> None:
    for name in MALFORMED:
        with case(name):
            assert found(MALFORMED[name])[:2] == (400, RequestFinding.MALFORMED)


def test_the_longest_proof_and_a_note_with_more_lines_are_read() -> None:
    asked = read_request(request(10, (bytes(32),) * 63, LOG.sign(LOG.text() + "more of theirs\n")))
    assert (asked.old, len(asked.proof), asked.checkpoint.size) == (10, 63, 20)


SPOILED: dict[str, Callable[[Note], Note]] = {
    "nobody signed": lambda note: Note(note.text, STRANGER.note().signatures),
    "for another text": lambda note: Note(LOG.text(19), note.signatures),
    "with a bit changed": lambda note: Note(
        note.text,
        tuple(
            msgspec.structs.replace(
                one, signature=bytes([one.signature[0] ^ 1]) + one.signature[1:]
            )
            for one in note.signatures
        ),
    ),
    "by another's name": lambda note: Note(
        note.text, tuple(msgspec.structs.replace(one, name="x") for one in note.signatures)
    ),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_signature_that_does_not_hold_is_no_signature(name: str) -> None:
    note = SPOILED[name](LOG.note())
    assert found(request(10, LOG.proof(10), note))[0] == 403


def test_unknown_keys_are_ignored_beside_the_logs_own() -> None:
    text = LOG.text()
    other = cosign(text, "witness.example/other", generate(Algorithm.ED25519), 5)
    junk = NoteSignature("somebody", b"1234", b"?")
    note = Note(text, (junk, other, *LOG.note().signatures, *LOG.note().signatures))
    assert found(request(10, LOG.proof(10), note))[0] == 200
    assert own_part(note, LOG.keys) == LOG.note()  # what others appended is not kept


def test_of_a_hybrid_log_every_key_has_to_sign() -> None:
    log = Log(Algorithm.ED25519, Algorithm.ML_DSA_65).grow(20)
    known = rules.WitnessedLog(origin=ORIGIN, keys=log.keys, size=10, root=log.root(10))
    assert found(log.ask(10), known)[0] == 200
    for part in (log.sign(log.text()).signatures[:1], log.sign(log.text(), but=1).signatures):
        body = request(10, log.proof(10), Note(log.text(), part))
        assert found(body, known)[0] == 403
    # one of them known alone is not the hybrid that the operator registered
    alone = rules.WitnessedLog(origin=ORIGIN, keys=log.keys[:1], size=10, root=log.root(10))
    assert (
        found(request(10, log.proof(10), Note(log.text(), log.note().signatures[:1])), alone)[0]
        == 200
    )


def test_a_log_is_registered_by_keys_that_can_sign_its_checkpoints() -> None:
    hybrid = Log(Algorithm.ED25519, Algorithm.ML_DSA_44).keys
    assert require_log_keys(hybrid) == ORIGIN
    for keys in ((), (*LOG.keys, *LOG.keys), (*LOG.keys, *Log(origin="other").keys)):
        with pytest.raises(MalformedError):
            require_log_keys(keys)
    public = generate(Algorithm.ED25519).public_key()
    post = generate(Algorithm.ML_DSA_44).public_key()
    for key in (
        witness_key(ORIGIN, public),
        witness_key(ORIGIN, post),
        NoteKey(ORIGIN, b"\x01", bytes(32)),  # low order: everybody can sign
        NoteKey(ORIGIN, b"\x01", b"short"),
        NoteKey(ORIGIN, b"\x02", public.public_bytes_raw()),
        NoteKey(ORIGIN, log_key(ORIGIN, post).kind, bytes(1312)),
    ):
        with pytest.raises(AuthenticityError) as told:
            require_log_keys((read_key(key.text(), where="key"),))
        assert told.value.reason is Reason.KEY_INVALID
