# SPDX-License-Identifier: Apache-2.0
"""The client of a witness: bytes to it and its answer back, in a thread of its own.

C2SP's tlog-witness over HTTP. A thread is given bytes and gives bytes: it knows no store and no
key, and nobody waits for it longer than he wants to. Spec page: docs/spec/rollback.md#witnesses
"""

from __future__ import annotations

import socket
import ssl
import threading
import time
from contextlib import suppress
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from queue import Empty, SimpleQueue
from urllib.parse import SplitResult, urlsplit

from msgspec import Struct

from authguard_r.audit.note import Note, NoteKey, encode64, read_signatures
from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.notes import Attested, verify_note

#: Longest answer, in bytes: an ML-DSA-44 cosignature is 3 KiB.
MAX_ANSWER = 1 << 16
#: An exchange takes no longer, in seconds; then its connection is cut.
LIMIT_S = 5.0
#: The content type of the size in a 409.
SIZE_TYPE = "text/x.tlog.size"
_PATH = "/add-checkpoint"


class Answer(Struct, frozen=True):
    """What came back.

    Args:
        status: HTTP's; 0 when nothing did that could be read.
        kind: the content type.
        body: at most `MAX_ANSWER` bytes.
    """

    status: int
    kind: str = ""
    body: bytes = b""


#: Nothing came back.
NOTHING = Answer(0)


def request(old: int, proof: tuple[bytes, ...], note: Note) -> bytes:
    """Return the body that submits a checkpoint, with the log's own signatures alone.

    Those of other witnesses are many, and a body is short (32 KiB at ours).
    """
    lines = [f"old {old}", *(encode64(node) for node in proof), ""]
    origin = note.text.partition("\n")[0]
    own = tuple(one for one in note.signatures if one.name == origin)
    return "".join(f"{line}\n" for line in lines).encode() + Note(note.text, own).encode()


def cosignature(answer: Answer, note: Note, key: NoteKey) -> Note | None:
    """Return the note with the witness's cosignature that came, once that holds.

    Args:
        answer: from anyone; a 200.
        note: as it was sent.
        key: the witness's.
    """
    try:
        lines = read_signatures(answer.body, where=key.name)
        said = tuple(one for one in lines if (one.name, one.key_id) == (key.name, key.id))[:1]
        found = verify_note(Note(note.text, said), (key,), where=key.name)
    except AuthGuardError:
        return None
    if not found:
        return None
    others = (one for one in note.signatures if (one.name, one.key_id) != (key.name, key.id))
    return Note(note.text, (*others, *said))


def cosigned(note: Note, keys: tuple[NoteKey, ...]) -> tuple[Attested, ...]:
    """Return which of these witnesses' cosignatures a held note has; none when one is forged."""
    try:
        return verify_note(note, keys, where="checkpoint")
    except AuthGuardError:
        return ()


class Courier:
    """Carries one request at a time to one witness.

    Args:
        url: a place that may be asked.
        limit_s: an exchange takes no longer.
    """

    def __init__(self, url: str, *, limit_s: float = LIMIT_S) -> None:
        self._url = urlsplit(url)
        self._limit_s = limit_s
        self._until = 0.0
        self._box: SimpleQueue[Answer] | None = None
        self._opened: list[HTTPConnection] = []

    @property
    def away(self) -> bool:
        """True while a request is on its way."""
        return self._box is not None

    def send(self, body: bytes) -> None:
        """Send a request; its answer is asked for later.

        Raises:
            RuntimeError: one is on its way: a fault of the caller's.
        """
        if self._box is not None:
            raise RuntimeError("a request is on its way")
        self._until = time.monotonic() + self._limit_s
        self._box, self._opened = SimpleQueue(), []
        given = (self._url, body, self._box, self._opened)
        try:
            threading.Thread(target=_carry, args=given, daemon=True, name="witness").start()
        except RuntimeError:  # no thread is to be had
            self._box.put(NOTHING)

    def answer(self, wait_s: float = 0.0) -> Answer | None:
        """Return the answer once it is there; a late one is given up and its connection cut.

        Args:
            wait_s: how long it is waited for.
        """
        if self._box is None:
            return None
        try:
            found = self._box.get(block=wait_s > 0, timeout=wait_s)
        except Empty:
            if time.monotonic() < self._until:
                return None
            found = NOTHING
            for connection in self._opened:
                with suppress(OSError, AttributeError):  # it may not be connected yet, or any more
                    connection.sock.shutdown(socket.SHUT_RDWR)
        self._box = None
        return found


def exchange(url: SplitResult, body: bytes, opened: list[HTTPConnection]) -> Answer:
    """Return what a witness answers; whatever goes wrong is `NOTHING`.

    Args:
        url: of the witness.
        body: what it is sent.
        opened: the connection is put in here, so that somebody else can cut it.
    """
    host = url.hostname or ""
    connection = (
        HTTPSConnection(host, url.port, timeout=LIMIT_S, context=ssl.create_default_context())
        if url.scheme == "https"
        else HTTPConnection(host, url.port, timeout=LIMIT_S)
    )
    opened.append(connection)
    try:
        headers = {"Content-Type": "text/plain; charset=utf-8", "Connection": "close"}
        connection.request("POST", url.path.rstrip("/") + _PATH, body=body, headers=headers)
        answer = connection.getresponse()
        data = answer.read(MAX_ANSWER + 1)
        if len(data) > MAX_ANSWER:
            return NOTHING
        return Answer(answer.status, answer.getheader("Content-Type", ""), data)
    except (OSError, HTTPException, ValueError):
        return NOTHING
    finally:
        connection.close()


def _carry(
    url: SplitResult, body: bytes, box: SimpleQueue[Answer], opened: list[HTTPConnection]
) -> None:
    box.put(exchange(url, body, opened))
