# SPDX-License-Identifier: Apache-2.0
"""What a stop process holds of its run folder: the socket, and the right to serve it.

The right is a lock on the file with the process's number; the kernel takes it back when the
process dies, however it dies. Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.wire.stop_limits import LIMITS

SOCKET, PID, SPOOL = "stop.sock", "stop-lane.pid", "stops.spool"
#: Stops that suspend the mission have a file of their own: other stops cannot fill it.
FIRST_SPOOL = "operator-stops.spool"
#: Is there while a stop process serves that a gate started.
OF_GATE = "stop-lane.of-gate"
#: Holds the name of the last stop process that served here.
EPOCH = "stop-lane.epoch"


class RunFolder(Struct, frozen=True, kw_only=True):
    """What a stop process holds of its run folder.

    Args:
        run: the folder.
        listener: bound and listening.
        lock: the locked file with the process's number.
    """

    run: Path
    listener: socket.socket
    lock: int


def take_place(run: Path, *, of_gate: bool = False) -> RunFolder:
    """Return the run folder's stop socket, listening, and held against a second stop process.

    A socket without a process behind it is replaced. The folder decides who reaches the socket: its
    group may connect (mode 0660), and who is in it is asked of the kernel.

    Args:
        run: the folder.
        of_gate: a gate started the stop process, and a gate that ends ends it.

    Raises:
        EnvironmentFault: a stop process serves here already, or the folder cannot be used.
    """
    path = run / SOCKET
    if not run.is_dir():
        raise EnvironmentFault(
            f"expected a folder for sockets, got `{run}`",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(run),
        )
    try:
        lock = _hold(run / PID)
        _mark(run / OF_GATE, of_gate=of_gate)
    except OSError as error:
        raise _unusable(error, run / PID) from error
    if is_served(path):
        os.close(lock)
        raise _taken(path)
    try:
        return RunFolder(run=run, listener=_listen(path), lock=lock)
    except OSError as error:
        os.close(lock)
        raise _unusable(error, path) from error


def leave_place(place: RunFolder) -> None:
    """Remove the socket and the file with the process's number."""
    place.listener.close()
    for name in (SOCKET, OF_GATE, PID):
        (place.run / name).unlink(missing_ok=True)
    os.close(place.lock)


def end_stop_process(run: Path) -> None:
    """End the stop process that serves there: ask it to, and kill it when it hangs.

    Raises:
        EnvironmentFault: it is not the caller's to end, or it serves on.
    """
    with contextlib.suppress(FileNotFoundError, ProcessLookupError, ValueError):
        pid = int((run / PID).read_text())
        with _opened(pid) as process:
            for number in (signal.SIGTERM, signal.SIGKILL):
                signal.pidfd_send_signal(process, number)
                if is_readable(process, LIMITS.end_s):  # it has ended
                    break
    if is_served(run / SOCKET):
        raise EnvironmentFault(
            "a stop process serves here and does not end: end it",
            reason=Reason.SERVICE_UNAVAILABLE,
            where=str(run / PID),
        )


def is_of_gate(run: Path) -> bool:
    """True when a stop process serves there that a gate started, this one or one before."""
    return is_served(run / SOCKET) and (run / OF_GATE).exists()


def kill(pid: int) -> None:
    """Kill a process that hangs or was stopped by a signal."""
    with contextlib.suppress(OSError), _opened(pid) as process:
        signal.pidfd_send_signal(process, signal.SIGKILL)


def await_end(pid: int, within_s: float) -> None:
    """Wait until a process has ended; its socket may take connections until then.

    Args:
        pid: the process.
        within_s: the longest wait, seconds.
    """
    # no process has this number any more: it has ended
    with contextlib.suppress(ProcessLookupError), _opened(pid) as process:
        is_readable(process, within_s)


@contextlib.contextmanager
def _opened(pid: int) -> Iterator[int]:
    """Yield a file that stands for this process, and for no later one with its number."""
    process = os.pidfd_open(pid)
    try:
        yield process
    finally:
        os.close(process)


def is_readable(file: int, within_s: float) -> bool:
    """True when an open file has something to read within this time."""
    poll = select.poll()  # `select.select` takes no number above 1023
    poll.register(file, select.POLLIN)
    return bool(poll.poll(within_s * 1_000))


def is_served(path: Path) -> bool:
    """True when a process listens at the socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(0)
        try:
            asking.connect(str(path))
        except BlockingIOError:
            return True  # its queue is full: a process is there
        except OSError:
            return False
    return True


def _mark(path: Path, *, of_gate: bool) -> None:
    if of_gate:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644))
    else:
        path.unlink(missing_ok=True)


def _hold(path: Path) -> int:
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    except BlockingIOError as error:
        os.close(file)
        raise _taken(path) from error
    except BaseException:
        os.close(file)
        raise
    return file


def _listen(path: Path) -> socket.socket:
    with contextlib.suppress(FileNotFoundError):
        if stat.S_ISSOCK(path.lstat().st_mode):
            path.unlink()  # of a stop process that is dead
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.settimeout(0)
        mask = os.umask(0o177)  # no client connects before the group is set
        try:
            listener.bind(str(path))
        finally:
            os.umask(mask)
        with contextlib.suppress(PermissionError):
            os.chown(path, -1, path.parent.stat().st_gid)
        path.chmod(0o660)
        listener.listen(LIMITS.backlog)
    except BaseException:
        listener.close()
        raise
    return listener


def _taken(path: Path) -> EnvironmentFault:
    return EnvironmentFault(
        "a stop process serves here already", reason=Reason.SERVICE_UNAVAILABLE, where=str(path)
    )


def _unusable(error: OSError, path: Path) -> EnvironmentFault:
    return EnvironmentFault(
        f"the stop process cannot serve here: {error.strerror or error}",
        reason=Reason.SERVICE_UNAVAILABLE,
        where=str(path),
    )
