# SPDX-License-Identifier: Apache-2.0
"""A log that asks, a witness's folder, and a witness as a process; nothing here is a mock.

The log is a real tree with real keys. Its requests are bytes, as anybody could send them.
"""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from authguard_r.audit.checkpoint import Checkpoint
from authguard_r.audit.note import Note, NoteKey, NoteSignature, read_signatures
from authguard_r.audit.tree import (
    EMPTY_ROOT,
    MemoryTree,
    consistency_proof,
    leaf_hash,
    root_of,
)
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.notes import Attested, log_key, verify_note
from authguard_r.witness.desk import Witness, make_witness, open_witness, register

ORIGIN = "authguard-r/courier-1/audit"
NAME = "witness.example/w1"
NOW_S = 1_700_000_000
#: Bound against hanging; nothing is measured against it.
SOON_S = 30.0


class Log:
    """A log with keys of its own that can also say what is not so."""

    def __init__(self, *algorithms: Algorithm, origin: str = ORIGIN) -> None:
        self.origin = origin
        self.signers: list[PrivateKey] = [generate(a) for a in algorithms or (Algorithm.ED25519,)]
        self.tree = MemoryTree()
        self._salt = b""

    @property
    def keys(self) -> tuple[NoteKey, ...]:
        return tuple(log_key(self.origin, key.public_key()) for key in self.signers)

    @property
    def texts(self) -> tuple[str, ...]:
        return tuple(key.text() for key in self.keys)

    @property
    def size(self) -> int:
        return self.tree.size

    def grow(self, count: int = 1) -> Log:
        for _ in range(count):
            self.tree.append(leaf_hash(self._salt + self.size.to_bytes(32, "big")))
        return self

    def fork(self, at: int, salt: bytes = b"other") -> Log:
        """Return the same log, by the same keys, that goes on differently from there."""
        other = Log(origin=self.origin)
        other.signers = self.signers
        for place in range(at):
            other.tree.append(self.tree.node(0, place))
        other._salt = salt
        return other

    def root(self, size: int | None = None) -> bytes:
        size = self.size if size is None else size
        return root_of(self.tree, size) if size else EMPTY_ROOT

    def text(self, size: int | None = None) -> str:
        size = self.size if size is None else size
        return Checkpoint(origin=self.origin, size=size, root=self.root(size)).text()

    def sign(self, text: str, *, but: int = 0) -> Note:
        """Return the text signed by every key; the first `but` of them do not."""
        lines = (
            NoteSignature(key.name, key.id, signer.sign(text.encode()))
            for key, signer in zip(self.keys[but:], self.signers[but:], strict=True)
        )
        return Note(text, tuple(lines))

    def note(self, size: int | None = None) -> Note:
        return self.sign(self.text(size))

    def proof(self, old: int, size: int | None = None) -> tuple[bytes, ...]:
        size = self.size if size is None else size
        return consistency_proof(self.tree, old, size) if 0 < old < size else ()

    def ask(self, old: int, size: int | None = None) -> bytes:
        """Return an honest request."""
        return request(old, self.proof(old, size), self.note(size))


def request(old: int | str, proof: tuple[bytes, ...], note: Note | bytes) -> bytes:
    lines = [f"old {old}\n", *(f"{b64encode(one).decode()}\n" for one in proof), "\n"]
    return "".join(lines).encode() + (note if isinstance(note, bytes) else note.encode())


def make(
    folder: Path, *logs: Log, algorithm: Algorithm = Algorithm.ED25519, mark: Path | None = None
) -> Path:
    """Return the folder of a new witness that knows these logs."""
    make_witness(folder, name=NAME, algorithm=algorithm, mark=mark)
    for log in logs:
        register(folder, log.texts, NOW_S, again=False)
    return folder


@contextmanager
def opened(folder: Path) -> Iterator[Witness]:
    witness = open_witness(folder)
    try:
        yield witness
    finally:
        witness.close()


def attested(log: Log, lines: bytes, key: NoteKey, size: int | None = None) -> Attested:
    """Return what a witness's answer attests of the log's checkpoint."""
    text = log.text(size)
    note = Note(text, (*log.note(size).signatures, *read_signatures(lines, where="answer")))
    (found,) = verify_note(note, (key,), where="answer")
    return found


class Served:
    """A witness in a process of its own."""

    def __init__(self, child: subprocess.Popen[bytes], ready: dict[str, Any]) -> None:
        self.child = child
        self.ready = ready
        _, _, place = str(ready["url"]).partition("//")
        self.host, port = place.partition("/")[0].rsplit(":", 1)
        self.port = int(port)

    def link(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection(self.host, self.port, timeout=SOON_S)

    def post(self, body: bytes) -> tuple[int, bytes, str]:
        """Return status, body and type of an answer on a connection of its own."""
        link = self.link()
        try:
            return post(link, body)
        finally:
            link.close()


def post(link: http.client.HTTPConnection, body: bytes) -> tuple[int, bytes, str]:
    link.request("POST", "/add-checkpoint", body)
    got = link.getresponse()
    return got.status, got.read(), got.headers["Content-Type"]


def command(folder: Path, *words: str, first: str = "") -> list[str]:
    """Return the command that serves a folder; `first` is Python that its process runs before."""
    program = [sys.executable, "-c", f"{first}\nfrom authguard_r.cli import main; main()"]
    return [*program, "witness", "serve", str(folder), *words, "--json"]


@contextmanager
def served(folder: Path, *words: str, first: str = "") -> Iterator[Served]:
    """A witness in a process of its own, killed at the end."""
    with (folder.parent / f"{folder.name}.journal").open("ab") as journal:
        child = subprocess.Popen(
            command(folder, *words, first=first), stdout=subprocess.PIPE, stderr=journal
        )
        assert child.stdout is not None
        try:
            ready = json.loads(child.stdout.readline())
            assert ready.get("ready") is True, ready
            yield Served(child, ready)
        finally:
            child.kill()
            child.wait()
            child.stdout.close()


def journal(folder: Path) -> list[dict[str, Any]]:
    text = (folder.parent / f"{folder.name}.journal").read_text(encoding="utf-8")
    assert "Traceback" not in text
    return [json.loads(line) for line in text.splitlines()]
