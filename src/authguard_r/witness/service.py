# SPDX-License-Identifier: Apache-2.0
"""The witness itself: one request after the other is judged, written down, and then answered.

Judging and writing are one step under one lock: no request is judged against what another one is
about to change. Spec page: docs/spec/witness.md#answers
"""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from msgspec import Struct

from authguard_r.audit.note import Note, is_name, read_key, signature_lines
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.notes import cosign, witness_key
from authguard_r.keys.signer import open_key_file
from authguard_r.witness.rules import (
    KEPT,
    RequestFinding,
    WitnessRequest,
    WitnessVerdict,
    judge,
    own_part,
    read_request,
    require_log_keys,
)
from authguard_r.witness.state import KEY, Book, Identity, LogFile, make_folder, open_book

TEXT, SIZE = "text/plain; charset=utf-8", "text/x.tlog.size"
#: Longest name of a witness or a log, in bytes; a cosignature counts it in one.
MAX_NAME = 255


class WitnessResponse(Struct, frozen=True, kw_only=True):
    """What is sent back, and what the journal says of it.

    Args:
        status: of HTTP.
        content: the body's type.
        body: what is sent.
        told: the journal's line.
    """

    status: int
    content: str = TEXT
    body: bytes = b""
    told: dict[str, Any]


class Witness:
    """A key and the folder that says what it has signed.

    Args:
        book: the folder, held.
        key: its private key.
    """

    def __init__(self, book: Book, key: PrivateKey) -> None:
        self.book = book
        self.name = book.identity.name
        self._key = key
        self._lock = threading.Lock()

    def answer(self, body: bytes, time_s: int) -> WitnessResponse:
        """Return the answer to a request to cosign a checkpoint.

        Args:
            body: from anyone.
            time_s: now, seconds since 1970.
        """
        try:
            asked = read_request(body)
        except MalformedError as error:
            return _said(
                WitnessVerdict(finding=RequestFinding.MALFORMED, message=error.message), {}
            )
        with self._lock:
            verdict = judge(asked, self.book.log(asked.checkpoint.origin))
            told = _told(asked, verdict)
            try:
                if verdict.finding is RequestFinding.COSIGNED:
                    return self._cosigned(asked, told, time_s)
                if verdict.finding in KEPT:
                    told["kept"] = self._keep(asked, verdict.finding, time_s)
            except EnvironmentFault as error:
                if verdict.finding is RequestFinding.COSIGNED:
                    return _unable(error, told)
                told["fault"] = error.message
            return _said(verdict, told)

    def close(self) -> None:
        """Let go of the folder."""
        self.book.close()

    def _cosigned(
        self, asked: WitnessRequest, told: dict[str, Any], time_s: int
    ) -> WitnessResponse:
        note, origin = self._own(asked), asked.checkpoint.origin
        signature = cosign(note.text, self.name, self._key, time_s)
        kept = Note(note.text, (*note.signatures, signature))
        self.book.advance(origin, kept, time_s)  # before an answer is sent
        lines = signature_lines((signature,)).encode()
        return WitnessResponse(
            status=200, body=lines, told={"event": str(RequestFinding.COSIGNED), **told}
        )

    def _keep(self, asked: WitnessRequest, finding: RequestFinding, time_s: int) -> bool:
        origin = asked.checkpoint.origin
        return self.book.keep(
            finding, self._own(asked), origin=origin, old=asked.old, time_s=time_s
        )

    def _own(self, asked: WitnessRequest) -> Note:
        log = self.book.log(asked.checkpoint.origin)
        return own_part(asked.note, log.keys if log is not None else ())


def make_witness(folder: Path, *, name: str, algorithm: Algorithm, mark: Path | None) -> Identity:
    """Make a witness with a new key in a new folder.

    Args:
        folder: absent, or empty.
        name: what it signs as.
        algorithm: one that there are cosignatures with.
        mark: where the mark will lie, on another medium; None: in the folder.

    Raises:
        MalformedError: the name cannot be a key's.
        AuthenticityError: there are no cosignatures with the algorithm.
        EnvironmentFault: something is there already, or it cannot be written.
    """
    require_name(name, where="--name")
    key = generate(algorithm)
    identity = Identity(
        format=1,
        name=name,
        key=witness_key(name, key.public_key()).text(),
        mark="" if mark is None else str(mark.absolute()),
    )
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    make_folder(folder, identity, pem)
    return identity


def open_witness(folder: Path) -> Witness:
    """Return the witness of a folder that no other process serves.

    Raises:
        EnvironmentFault: as `open_book`; or the key is another witness's.
        AuthenticityError: the key cannot be read.
    """
    book = open_book(folder)
    try:
        key = open_key_file(folder / KEY)[0]
        _require_own_key(book.identity, key, folder)
        return Witness(book, key)
    except BaseException:
        book.close()
        raise


class Registered(Struct, frozen=True, kw_only=True):
    """A log that is known; `changed` is false when it was, with these very keys."""

    origin: str
    keys: tuple[str, ...]
    changed: bool


def register(folder: Path, texts: tuple[str, ...], time_s: int, *, again: bool) -> Registered:
    """Know a log from now on by its verifier keys.

    Args:
        folder: the witness's, which no process serves.
        texts: verifier keys of one log, from a trusted source.
        time_s: now, seconds since 1970.
        again: replace the keys of a log that is known; its newest checkpoint stays.

    Raises:
        MalformedError: one is no verifier key, or they are of several logs.
        AuthenticityError: one cannot sign a log's checkpoints.
        RefusedError: the log is known with other keys, and replacing them was not asked for.
        EnvironmentFault: the folder is held, unsafe, or cannot be written.
    """
    keys = tuple(read_key(text, where="--log") for text in texts)
    origin = require_log_keys(keys)
    require_name(origin, where="--log")
    spelled = tuple(sorted(key.text() for key in keys))
    book = open_book(folder)
    try:
        changed = book.register(origin, spelled, time_s, again=again)
    finally:
        book.close()
    return Registered(origin=origin, keys=spelled, changed=changed)


def forget(folder: Path, origin: str, time_s: int) -> LogFile:
    """Forget a log and return what was known of it.

    Raises:
        RefusedError: it is not known.
        EnvironmentFault: the folder is held, unsafe, or cannot be written.
    """
    book = open_book(folder)
    try:
        return book.forget(origin, time_s)
    finally:
        book.close()


def require_name(name: str, *, where: str) -> None:
    """Require that a text can be the name of a key.

    Raises:
        MalformedError: it cannot.
    """
    if not (is_name(name) and name.isprintable() and len(name.encode()) <= MAX_NAME):
        raise MalformedError(
            f"expected a name of at most {MAX_NAME} bytes without space and `+`", where=where
        )


def _require_own_key(identity: Identity, key: PrivateKey, folder: Path) -> None:
    try:
        fits = witness_key(identity.name, key.public_key()) == read_key(identity.key, where="key")
    except AuthGuardError:
        fits = False
    if not fits:
        raise EnvironmentFault(
            "expected the key that this folder was made with",
            reason=Reason.KEY_INVALID,
            where=str(folder / KEY),
        )


def _told(asked: WitnessRequest, verdict: WitnessVerdict) -> dict[str, Any]:
    """Return what the journal says; of an unknown log no name, because a client could choose it."""
    told: dict[str, Any] = {"old": asked.old, "size": asked.checkpoint.size}
    if verdict.finding not in {RequestFinding.UNKNOWN, RequestFinding.UNSIGNED}:
        told["log"] = asked.checkpoint.origin
    if verdict.size is not None:
        told["known"] = verdict.size
    return told


def _said(verdict: WitnessVerdict, told: dict[str, Any]) -> WitnessResponse:
    line = {"event": str(verdict.finding), **told}
    if verdict.size is not None:
        body = f"{verdict.size}\n".encode()
        return WitnessResponse(status=verdict.status, content=SIZE, body=body, told=line)
    return WitnessResponse(status=verdict.status, body=f"{verdict.message}\n".encode(), told=line)


def _unable(error: EnvironmentFault, told: dict[str, Any]) -> WitnessResponse:
    """Return that nothing was signed: it could not be written down."""
    body = b"what would be signed cannot be written down\n"
    line = {"event": "unable", **told, "fault": error.message}
    return WitnessResponse(status=503, body=body, told=line)
