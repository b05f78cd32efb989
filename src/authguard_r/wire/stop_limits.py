# SPDX-License-Identifier: Apache-2.0
"""The bounds of the stop process: what it waits for, keeps and takes in, and how much of it.

Each bound is a number of this program; bounds of a signed file or a format stand beside its type.
Source: ADR 0039.
"""

from __future__ import annotations

from msgspec import Struct


class StopLimits(Struct, frozen=True, kw_only=True):
    """The bounds of the stop process: what it waits for, keeps and takes in, and how much of it.

    Args:
        whole_within_ms: a hello, and each message once begun, is whole within this, milliseconds.
        unread_bytes: answers that may wait for one client, bytes; it is dropped beyond.
        unread_gate_bytes: the same for the gate, bytes.
        connections: connections of all users.
        chunk_bytes: bytes read from a client at a time.
        accepted_at_once: connections accepted in one turn.
        backlog: connections that the kernel keeps until the process accepts them.
        halt_again_ms: a `HALT` without an answer is sent again after this, milliseconds.
        stop_answer_ms: a stop is answered within this, confirmed or not, milliseconds.
        window: stops of other roles that are kept one by one and sent ahead of the gate's answer.
        first_window: suspending stops that are sent ahead of the gate's answer.
        first_stops: suspending stops that are kept one by one; further ones are counted.
        batch: stops that are written to disk at once.
        spool_ms: stops that suspend nothing are written to disk after this, milliseconds.
        spool_bytes: longest file of stops, bytes; further ones stay in memory.
        first_spool_bytes: longest file of suspending stops, bytes.
        tick_ms: due work is checked this often, milliseconds.
        retry_ms: a disk that failed is tried again after this, milliseconds.
        log_ms: dropped connections are logged this often, milliseconds.
        end_s: a process that gets a signal to end is gone within this, seconds; then it is killed.
        priority: added to the niceness of the process, where the system allows it.
    """

    # connections
    whole_within_ms: int = 2_000
    unread_bytes: int = 1 << 16
    unread_gate_bytes: int = 1 << 20
    connections: int = 1_024
    chunk_bytes: int = 4_096
    accepted_at_once: int = 256
    backlog: int = 1_024
    # stops
    halt_again_ms: int = 100
    stop_answer_ms: int = 1_000
    window: int = 32
    first_window: int = 256
    first_stops: int = 100_000
    batch: int = 256
    spool_ms: int = 100
    spool_bytes: int = 1 << 23
    first_spool_bytes: int = 1 << 25
    # clocks
    tick_ms: int = 20
    retry_ms: int = 1_000
    log_ms: int = 10_000
    end_s: float = 5.0
    priority: int = -10


#: The bounds in force.
LIMITS = StopLimits()
