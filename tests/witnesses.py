# SPDX-License-Identifier: Apache-2.0
"""A witness as C2SP's tlog-witness says it, small and real: HTTP on this machine, its own key.

with SmallWitness("one", log_keys()) as witness:
    policy((witness,), quorum=1)

It keeps nothing but the newest checkpoint of each log. Nothing of the product's client or server
is in it: only the tree and the signatures, which have vectors of their own.
"""

from __future__ import annotations

import ssl
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

import worlds
from authguard_r.anchoring.counter import Counter
from authguard_r.anchoring.notary import NotaryPolicy
from authguard_r.anchoring.places import WitnessPlace
from authguard_r.anchoring.quorum import WitnessPolicy
from authguard_r.assembly import Simulation, assemble, folder_signer, folder_trust
from authguard_r.audit.checkpoint import origin_of, read_checkpoint
from authguard_r.audit.note import NoteKey, decode64, read_note, signature_lines
from authguard_r.audit.tree import EMPTY_ROOT, verify_consistency
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.ports import Signer, Store
from authguard_r.keys.notes import cosign, leaf_key, log_key, require_all, witness_key
from authguard_r.normalize import Binder
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.sim.robot import SymbolicRobot

ORIGIN = origin_of(worlds.RID)
SIZE = "text/x.tlog.size"
#: Status, content type and body.
Reply = tuple[int, str, bytes]


def log_keys(rid: RobotId = worlds.RID) -> tuple[NoteKey, ...]:
    """Return the keys that sign a robot's checkpoints."""
    signer = folder_signer(worlds.trust_folder(), f"gate-{rid}")
    return (log_key(origin_of(rid), leaf_key(signer.chain)),)


class SmallWitness:
    """A witness; a context manager that listens while it is entered.

    Args:
        name: what it signs as.
        keys: of the one log that it knows.
        tls: certificate and key in one file; plain HTTP without.
    """

    def __init__(
        self, name: str, keys: tuple[NoteKey, ...] | None = None, *, tls: Path | None = None
    ) -> None:
        self._tls = tls
        self.key = Ed25519PrivateKey.generate()
        self.named = witness_key(name, self.key.public_key())
        self.keys = log_keys() if keys is None else keys
        self.size, self.root = 0, EMPTY_ROOT
        self.asked: list[bytes] = []
        #: Answer with this, whatever is asked; once for each, then as it should be.
        self.instead: list[Reply] = []
        #: Requests wait for this before they are answered.
        self.open = threading.Event()
        self.open.set()
        self._lock = threading.Lock()
        self._port = 0
        self._server: ThreadingHTTPServer | None = None

    @property
    def place(self) -> WitnessPlace:
        """Return it as a configuration names it."""
        scheme = "http" if self._tls is None else "https"
        return WitnessPlace(url=f"{scheme}://127.0.0.1:{self._port}/w", key=self.named.text())

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.open.set()
        self.stop()

    def start(self) -> None:
        """Listen, the second time where it listened before."""
        self._server = ThreadingHTTPServer(("127.0.0.1", self._port), self._handler())
        self._server.daemon_threads = True
        if self._tls is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(self._tls)
            self._server.socket = context.wrap_socket(self._server.socket, server_side=True)
        self._port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def stop(self) -> None:
        """Listen no more; what it knows stays."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def forget(self) -> None:
        """Forget the log, as its owner may."""
        with self._lock:
            self.size, self.root = 0, EMPTY_ROOT

    def answer(self, body: bytes) -> Reply:
        """Return the answer to a request (C2SP tlog-witness, in the order of its text)."""
        head, _, note_bytes = body.partition(b"\n\n")
        first, *proof = head.decode().split("\n")
        old = int(first.removeprefix("old "))
        note = read_note(note_bytes, where="request")
        said = read_checkpoint(note.text, where="request")
        if said.origin not in {key.name for key in self.keys}:
            return 404, "text/plain", b""
        try:
            require_all(note, self.keys, where="request")
        except AuthGuardError:
            return 403, "text/plain", b""
        if old > said.size:
            return 400, "text/plain", b""
        with self._lock:
            if old != self.size:
                return 409, SIZE, f"{self.size}\n".encode()
            if old == said.size and said.root != self.root:
                return 409, SIZE, f"{self.size}\n".encode()
            hashes = tuple(decode64(line, where="proof") for line in proof)
            if not verify_consistency(old, said.size, self.root, said.root, hashes):
                return 422, "text/plain", b""
            self.size, self.root = said.size, said.root
        made = cosign(note.text, self.named.name, self.key, int(time.time()))
        return 200, "text/plain", signature_lines((made,)).encode()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        witness = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                witness.asked.append(body)
                witness.open.wait()
                if witness.instead:
                    status, kind, data = witness.instead.pop(0)
                elif self.path != "/w/add-checkpoint":
                    status, kind, data = 404, "text/plain", b""
                else:
                    status, kind, data = witness.answer(body)
                self.send_response(status)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                """Say nothing."""

        return Handler


def policy(
    *witnesses: SmallWitness, quorum: int | None = None, silence_ms: int = 0, **more: int
) -> NotaryPolicy:
    """Return a policy with these witnesses, all of whom have to agree unless it says how many."""
    places = tuple(witness.place for witness in witnesses)
    needed = len(places) if quorum is None else quorum
    asked = WitnessPolicy(places=places, quorum=needed, silence_ms=silence_ms)
    return NotaryPolicy(witnesses=asked, **more)


def begin(
    store: Store,
    notary: NotaryPolicy,
    *,
    counter: Counter | None = None,
    at_ms: int = worlds.START_MS,
    signer: Signer | None = None,
) -> Simulation:
    """Return a gate on the symbolic robot with this policy; nobody calls its timer but the test."""
    own = signer or folder_signer(worlds.trust_folder(), f"gate-{worlds.RID}")
    robot = SymbolicRobot(
        worlds.site(),
        worlds.RID,
        worlds.world("dock"),
        estimator=folder_signer(worlds.trust_folder(), f"estimator-{worlds.RID}"),
        start_ms=at_ms,
        epoch=at_ms,
    )
    gate = assemble(
        trust=folder_trust(worlds.trust_folder()),
        chain=own.chain,
        site=worlds.site(),
        safety=EnvelopeGate(default_config(worlds.site(), worlds.RID)),
        controller=robot,
        source=robot,
        clock=robot,
        store=store,
        genesis={},
        demo=True,
        counter=counter,
        signer=own,
        notary=notary,
    )
    binder = Binder(worlds.site(), worlds.binding())
    return Simulation(gate=gate, robot=robot, binder=binder, signer=own, store=None)
