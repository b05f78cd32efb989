# SPDX-License-Identifier: Apache-2.0
"""The client of a witness: bytes to it and its answer back, in a thread of its own.

C2SP's tlog-witness over HTTP. A thread takes bytes and returns bytes: it has no store and no key,
and the caller chooses how long it waits for the thread. Spec page: docs/spec/rollback.md#witnesses
"""

from __future__ import annotations

import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPException, HTTPResponse
from io import BufferedReader, RawIOBase
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING
from urllib.parse import SplitResult, urlsplit

from msgspec import Struct

from authguard_r.audit.note import Note, NoteKey, encode64, read_signatures
from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.notes import Attested, verify_note
from authguard_r.wire.gate_limits import LIMITS

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

#: The content type of the size in a 409.
SIZE_TYPE = "text/x.tlog.size"
_PATH = "/add-checkpoint"


class WitnessReply(Struct, frozen=True):
    """What came back.

    Args:
        status: HTTP's; 0 when nothing did that could be read.
        kind: the content type.
        body: at most `LIMITS.witness_answer_bytes` bytes.
    """

    status: int
    kind: str = ""
    body: bytes = b""


#: Nothing came back.
NOTHING = WitnessReply(0)


def request(old: int, proof: tuple[bytes, ...], note: Note) -> bytes:
    """Return the body that submits a checkpoint, with the log's own signatures alone.

    Those of other witnesses are many, and a body is short (32 KiB at ours).
    """
    lines = [f"old {old}", *(encode64(node) for node in proof), ""]
    origin = note.text.partition("\n")[0]
    own = tuple(one for one in note.signatures if one.name == origin)
    return "".join(f"{line}\n" for line in lines).encode() + Note(note.text, own).encode()


def cosignature(answer: WitnessReply, note: Note, key: NoteKey) -> Note | None:
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

    def __init__(self, url: str, *, limit_s: float = LIMITS.witness_s) -> None:
        self._url = urlsplit(url)
        self._limit_s = limit_s
        self._until = 0.0
        self._box: SimpleQueue[WitnessReply] | None = None
        self._threads: list[threading.Thread] = []

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
        self._box = SimpleQueue()
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        if len(self._threads) >= LIMITS.witness_exchanges:
            self._box.put(NOTHING)
            return
        given = (self._url, body, self._box, self._until)
        thread = threading.Thread(target=_carry, args=given, daemon=True, name="witness")
        try:
            thread.start()
        except RuntimeError:  # no thread is to be had
            self._box.put(NOTHING)
        else:
            self._threads.append(thread)

    def answer(self, wait_s: float = 0.0) -> WitnessReply | None:
        """Return the answer once it is there; a late one is given up.

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
        self._box = None
        return found


def exchange(url: SplitResult, body: bytes, until: float) -> WitnessReply:
    """Return what a witness answers; any error is `NOTHING`.

    Args:
        url: of the witness.
        body: what it is sent.
        until: the exchange is over by then, on the monotonic clock.
    """
    try:
        with _connected(url, until) as sock:
            head = (
                f"POST {url.path.rstrip('/')}{_PATH} HTTP/1.1",
                f"Host: {url.netloc.rpartition('@')[2]}",
                "Content-Type: text/plain; charset=utf-8",
                f"Content-Length: {len(body)}",
                "Connection: close",
            )
            sock.settimeout(_left(until))
            sock.sendall("\r\n".join(head).encode("ascii") + b"\r\n\r\n" + body)
            answer = HTTPResponse(_Read(sock, until), method="POST")  # type: ignore[arg-type]
            answer.begin()
            data = answer.read(LIMITS.witness_answer_bytes + 1)
            if len(data) > LIMITS.witness_answer_bytes:
                return NOTHING
            return WitnessReply(answer.status, answer.getheader("Content-Type", ""), data)
    except (OSError, HTTPException, ValueError):
        return NOTHING


@contextmanager
def _connected(url: SplitResult, until: float) -> Iterator[socket.socket]:
    host, is_tls = url.hostname or "", url.scheme == "https"
    port = url.port or (443 if is_tls else 80)
    with _reached(host, port, until) as plain:
        if not is_tls:
            yield plain
            return
        context = ssl.create_default_context()
        plain.settimeout(_left(until))
        with context.wrap_socket(plain, server_hostname=host) as secured:
            yield secured


def _reached(host: str, port: int, until: float) -> socket.socket:
    """Return a connection to the first address of a name that answers.

    All of them share the time that is left: the owner of a domain name can give it any number of
    addresses.

    Raises:
        OSError: no process listens there.
    """
    failed: OSError = ConnectionRefusedError()
    for *_, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        try:
            return socket.create_connection((str(place[0]), port), timeout=_left(until))
        except OSError as error:
            failed = error
    raise failed


def _left(until: float) -> float:
    """Return the seconds that are left.

    Raises:
        TimeoutError: none.
    """
    left = until - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


class _Read(RawIOBase):
    """A socket as `HTTPResponse` reads it: for as long as is left, not for so long at each read.

    Args:
        sock: what is read.
        until: nothing is waited for after this.
    """

    def __init__(self, sock: socket.socket, until: float) -> None:
        self._sock = sock
        self._until = until

    def makefile(self, _mode: str) -> BufferedReader:
        """Return what the answer is read from."""
        return BufferedReader(self)

    def readable(self) -> bool:
        """Return True: it is read."""
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Fill a part of a buffer with what comes next; 0: nothing comes any more."""
        self._sock.settimeout(_left(self._until))
        return self._sock.recv_into(buffer)


def _carry(url: SplitResult, body: bytes, box: SimpleQueue[WitnessReply], until: float) -> None:
    box.put(exchange(url, body, until))
