# SPDX-License-Identifier: Apache-2.0
"""The stop process: a process in which no decision, no fsync and no mission is in a stop's way.

One thread waits for all sockets at once and blocks on none. Trust, key and configuration are read
once, at the start: a change of any of them takes a new stop process. Spec page:
docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
from collections.abc import Callable
from time import monotonic_ns, time_ns

import msgspec

from authguard_r.access.gate_config import GateConfig
from authguard_r.access.peers import peer_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.core.quantities import Now
from authguard_r.estop.protocol import EStopDispatcher, EStopPeer
from authguard_r.estop.run_folder import EPOCH, FIRST_SPOOL, SPOOL, RunFolder
from authguard_r.estop.spool import Spool, left_by, next_epoch
from authguard_r.estop.stop_queue import Backlog, Queue
from authguard_r.wire.stop_limits import LIMITS


class EStopServer:
    """The process's loop: bytes and time in, bytes out.

    Args:
        place: the socket; the caller lets go of it.
        wake: readable when the stop process is to end.
        say: writes a line to the log, or not; must not wait.
    """

    def __init__(
        self,
        place: RunFolder,
        robot: RobotId,
        config: GateConfig,
        *,
        signer: Signer,
        wake: int,
        say: Callable[[bytes], None],
    ) -> None:
        self.spool = Spool(place.run / SPOOL)
        self.first_spool = Spool(place.run / FIRST_SPOOL, most=LIMITS.first_spool_bytes)
        known = left_by(self.first_spool, self.spool)
        self.journal = Backlog(next_epoch(place.run / EPOCH, _now().utc_ms, known), known)
        self._desk = EStopDispatcher(
            robot, config, own_uid=os.geteuid(), signer=signer, journal=self.journal
        )
        self._listener, self._wake, self._say = place.listener, wake, say
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._lines: dict[EStopPeer, socket.socket] = {}
        self._ticked = self._said = 0
        self._fresh_ms: int | None = None

    def serve(self) -> None:
        """Serve until woken; stops that are not in the file yet are written before it returns."""
        try:
            while self._turn():
                pass
        finally:
            now = _now()
            for peer in list(self._lines):
                self._close(peer, now)
            self._write_first(now)
            while self._write_others(now):
                pass
            self._selector.close()
            self.first_spool.close()
            self.spool.close()

    def _turn(self) -> bool:
        """Wait for something, do all of it once; false when woken to end."""
        is_asked = False
        for key, events in self._selector.select(self._patience()):
            if key.fileobj is self._listener:
                is_asked = True
            elif key.fileobj == self._wake:
                return False
            else:
                self._serve(key.data, events)
        if is_asked:
            self._accept()
        now = _now()
        self._desk.work(now)
        if now.mono_ms - self._ticked >= LIMITS.tick_ms:
            self._ticked = now.mono_ms
            self._desk.tick(now)
        self._flush(now)
        self._put_down(now)
        return True

    def _patience(self) -> float | None:
        """Return for how long nothing but a message can happen, in seconds."""
        if self._desk.has_work:
            return 0
        if self._desk.is_lively or self._is_behind or self._desk.dropped:
            return LIMITS.tick_ms / 1_000
        return None

    def _accept(self) -> None:
        for _ in range(LIMITS.accepted_at_once):
            try:
                line, _ = self._listener.accept()
            except OSError:
                return  # no client is left, or the address has no other socket
            line.settimeout(0)
            try:
                uid = peer_of(line).uid
            except AuthGuardError:  # pragma: no cover - the kernel knows who connected
                line.close()
                continue
            now = _now()
            peer = self._desk.open(uid, now)
            self._lines[peer] = line
            self._selector.register(line, selectors.EVENT_READ, peer)
            self._flush(now)

    def _serve(self, peer: EStopPeer, events: int) -> None:
        line, now = self._lines.get(peer), _now()
        if line is None:
            return  # ended by another one's doing in this very turn
        if events & selectors.EVENT_WRITE:
            self._desk.touched.append(peer)
        if events & selectors.EVENT_READ:
            if peer.is_heard:
                self._read(peer, line, now)
            else:
                self._watch(peer, line)
        self._flush(now)

    def _read(self, peer: EStopPeer, line: socket.socket, now: Now) -> None:
        try:
            data = line.recv(LIMITS.chunk_bytes)
        except BlockingIOError:  # pragma: no cover - the kernel said that there is something
            return
        except OSError:
            data = b""  # it closed without reading its message
        if data:
            self._desk.received(peer, data, now)
        else:
            self._close(peer, now)

    def _flush(self, now: Now) -> None:
        """Send waiting bytes, as many as fit, and close connections that are to end."""
        touched = self._desk.touched
        while touched:
            peers, touched[:] = touched[:], []
            for peer in peers:
                line = self._lines.get(peer)
                if line is not None:
                    self._push(peer, line, now)

    def _push(self, peer: EStopPeer, line: socket.socket, now: Now) -> None:
        try:
            if peer.out:
                del peer.out[: line.send(peer.out)]
        except BlockingIOError:
            pass
        except OSError:
            self._close(peer, now)
            return
        if peer.is_ending:
            self._close(peer, now)
            return
        self._watch(peer, line)

    def _watch(self, peer: EStopPeer, line: socket.socket) -> None:
        """Wait for what this client can bring next; a client that has to wait is not read."""
        wanted = selectors.EVENT_READ if peer.is_heard else 0
        wanted |= selectors.EVENT_WRITE if peer.out else 0
        known = self._selector.get_map().get(line)
        if known is None:
            if wanted:
                self._selector.register(line, wanted, peer)
        elif not wanted:
            self._selector.unregister(line)
        elif known.events != wanted:
            self._selector.modify(line, wanted, peer)

    def _close(self, peer: EStopPeer, now: Now) -> None:
        line = self._lines.pop(peer)
        with contextlib.suppress(KeyError):
            self._selector.unregister(line)
        line.close()
        self._desk.close(peer, now)

    @property
    def _is_behind(self) -> bool:
        """True while the files do not hold what is unrecorded, or hold what is recorded."""
        first, others = self.journal.first, self.journal.others
        return (
            first.is_fresh
            or others.is_fresh
            or (self.first_spool.is_used and not first)
            or (self.spool.is_used and not self.journal)
        )

    def _put_down(self, now: Now) -> None:
        """Write to files and log after the answers; suspending stops at once.

        The others seldom while a caller waits, and a gate that listens has its time first: what it
        has recorded needs no file.
        """
        session, others = self._desk, self.journal.others
        self._write_first(now)
        if not self.journal.first:
            self.first_spool.clear()
        if not others.is_fresh:
            self._fresh_ms = None
        elif self._fresh_ms is None:
            self._fresh_ms = now.mono_ms
        is_quiet = not (session.is_waiting or session.has_work)
        is_due = self._fresh_ms is not None and now.mono_ms - self._fresh_ms >= LIMITS.spool_ms
        if is_due or (others.is_fresh and is_quiet and not session.has_gate):
            self._write_others(now)
        if is_quiet and not self.journal:
            self.spool.clear()
        if session.dropped and now.mono_ms - self._said >= LIMITS.log_ms:
            self._said = now.mono_ms
            self._say_dropped()

    def _write_first(self, now: Now) -> None:
        while _write_some(self.journal.first, self.first_spool, now):
            pass

    def _write_others(self, now: Now) -> bool:
        is_written = _write_some(self.journal.others, self.spool, now)
        if is_written:
            self._fresh_ms = None
        return is_written

    def _say_dropped(self) -> None:
        for what, count in self._desk.dropped.items():
            line = {"ended": count, **msgspec.to_builtins(what)}
            self._say(msgspec.json.encode(line) + b"\n")
        self._desk.dropped.clear()


def _write_some(queue: Queue, spool: Spool, now: Now) -> bool:
    """Write what one write may take; false when there is nothing, or the disk takes nothing."""
    stops = queue.to_spool()
    if not stops or now.mono_ms < spool.retry_ms:
        return False
    if not spool.write(stops):
        spool.retry_ms = now.mono_ms + LIMITS.retry_ms
        return False
    queue.spooled(stops)
    return True


def _now() -> Now:
    return Now(time_ns() // 1_000_000, monotonic_ns() // 1_000_000)
