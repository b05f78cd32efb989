# SPDX-License-Identifier: Apache-2.0
"""One gate for one robot: two gates would each use the remaining budget.

Held are things that no other user can take first: an abstract Unix socket's name that cannot be
foreseen and that says whose gate it is, the run folder's lock, the key's own file, and a lock of
the robot's beside its store and its key. A process that is frozen keeps them all; the kernel frees
them when it dies, however it dies. Spec page: docs/spec/gate-protocol.md#one-gate
"""

from __future__ import annotations

import fcntl
import os
import secrets
import socket
import time
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.access.peers import PeerCredentials, peer_of
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.gate_limits import LIMITS

#: The file in the run folder that is locked while a gate serves there.
LOCK_FILE = "gate.lock"
#: A name whose queue stays full for so long is no gate's, in seconds.
_PATIENCE_S = 2.5 * LIMITS.lock_answer_s
#: Every Unix socket of this network namespace, a line each, its name last.
_NAMES = Path("/proc/self/net/unix")


class Lock:
    """The locks of a running gate; `release` or the end of the process frees them."""

    def __init__(self, name: socket.socket, files: tuple[int, ...]) -> None:
        self._name = name
        self._files = files

    def answer(self) -> None:
        """Let those go who asked who holds the robot: a full queue would hide that we do."""
        for _ in range(LIMITS.lock_queue):
            try:
                asking, _ = self._name.accept()
            except OSError:
                return  # no other process asks
            asking.close()

    def release(self) -> None:
        """Let go of the robot, its run folder and its key; a second call does nothing."""
        self._name.close()
        files, self._files = self._files, ()
        for file in files:
            os.close(file)


def root_fingerprint(root: x509.Certificate) -> str:
    """Return which trust root a gate belongs to: robots of two organizations may share a name."""
    return sha256(root.public_bytes(Encoding.DER)).hexdigest()[:16]


def hold_robot(
    rid: RobotId,
    fingerprint: str,
    *,
    run: Path,
    key: Path | None = None,
    store: Path | None = None,
) -> Lock:
    """Return the lock of the robot, of its folders and of the key, all held.

    Args:
        rid: the robot of the gate's certificate.
        fingerprint: of its trust root, from `root_fingerprint`.
        run: the folder of the gate's sockets; must exist and be the gate's to write.
        key: the gate's own key, which only its user can read; None where it is no file.
        store: its store; None where it is no file.

    Raises:
        EnvironmentFault: a gate for this robot runs already, or another one in this folder or with
            this key; nothing is held.
    """
    with ExitStack() as held:
        files: list[int] = []

        def keep(file: int) -> None:
            files.append(file)
            held.callback(os.close, file)

        # by files first: a gate that is frozen cannot be asked, and holds them
        mine = f"authguard-r-{rid}-{fingerprint}.lock"
        for folder in dict.fromkeys(p.absolute().parent for p in (store, key) if p is not None):
            if os.access(folder, os.W_OK):  # else the key's own lock has to do
                keep(_hold_file(folder / mine, f"a gate for `{rid}` is running already"))
        name = held.enter_context(_hold_name(rid, fingerprint))
        keep(_hold_file(run / LOCK_FILE, "another gate serves in this run folder"))
        if key is not None:
            keep(_hold_key(key))
        held.pop_all()
        return Lock(name, tuple(files))


def _hold_name(rid: RobotId, fingerprint: str) -> socket.socket:
    """Take a name first and look for others then: of two that start at once, no two go on."""
    stem = f"\0authguard-r/{rid}/{fingerprint}/".encode()
    own = stem + secrets.token_urlsafe(6).encode()  # a name that is known can be taken before us
    held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        held.bind(own)
        held.listen(LIMITS.lock_queue)
        held.settimeout(0)
        holder = _holder([name for name in _names(stem) if name != own])
    except OSError as error:
        held.close()
        raise _unusable(error, rid) from error
    if holder is not None:
        held.close()
        who = f"pid {holder.pid}, user {holder.uid}"
        raise _taken(f"a gate for `{rid}` is running already", who, rid)
    return held


def _names(stem: bytes) -> list[bytes]:
    """Return the abstract socket names with this prefix, of any process.

    Anyone may take such a name, and even write lines of this list: it says only whom to ask.
    """
    shown = b"@" + stem[1:]
    lines = [line.split(None, 7) for line in _NAMES.read_bytes().splitlines()]
    last = [fields[7] for fields in lines if len(fields) == 8]
    return [b"\0" + name[1:] for name in last if name.startswith(shown)]


def _holder(names: list[bytes]) -> PeerCredentials | None:
    """Return the gate of this user, or of root, that has one of the names; ignore strangers."""
    ours, until = {os.geteuid(), 0}, time.monotonic() + _PATIENCE_S
    while True:
        full: list[bytes] = []
        for name in names:
            try:
                peer = _listener(name)
            except BlockingIOError:
                full.append(name)
                continue
            if peer is not None and peer.uid in ours:
                return peer
        if not full or time.monotonic() >= until:
            return None
        time.sleep(LIMITS.lock_pause_s)
        names = full


def _listener(name: bytes) -> PeerCredentials | None:
    """Return the process that listens there, as the kernel says; None if none does.

    Raises:
        BlockingIOError: its queue is full.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(0)
        try:
            asking.connect(name)
        except BlockingIOError:
            raise
        except OSError:
            return None
        return peer_of(asking)


def _hold_file(path: Path, taken: str) -> int:
    try:
        # never followed, so that a link put there beforehand makes us write nowhere else
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise _unusable(error, path) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        told = os.pread(file, 20, 0).decode("ascii", "replace").strip()
        os.close(file)
        raise _taken(taken, f"pid {told}", path) from error
    os.ftruncate(file, 0)
    os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    return file


def _hold_key(key: Path) -> int:
    """Hold the file that makes a gate this robot's, in every namespace."""
    try:
        file = os.open(key, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise _unusable(error, key) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        why = error.strerror or "unknown"
        raise _taken("a gate with this key is running already", why, key) from error
    return file


def _taken(message: str, who: str, where: object) -> EnvironmentFault:
    return EnvironmentFault(
        f"{message} ({who})", reason=Reason.SERVICE_UNAVAILABLE, where=str(where)
    )


def _unusable(error: OSError, where: object) -> EnvironmentFault:
    return EnvironmentFault(
        f"the gate's lock cannot be taken: {error.strerror or error}",
        reason=Reason.SERVICE_UNAVAILABLE,
        where=str(where),
    )
