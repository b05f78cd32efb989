# SPDX-License-Identifier: Apache-2.0
"""A witness that keeps whoever asks it: its process says the port, and never answers in full.

    python keeping_witness.py KIND [PEM]

`silent` says nothing. `head` and `body` send an answer a byte each 0.1 s: status and headers, or
what comes after them. `endless` sends a body without an end as fast as it is taken. `handshake`
begins TLS, a byte each 0.1 s. `deaf` takes 4 KiB of a request each 0.1 s. With PEM it speaks TLS.
Whoever goes is let go; nobody is kept for longer than `LONGEST_S`.
"""

from __future__ import annotations

import socket
import ssl
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

#: Longer than a test waits, so that one whose exchange has no end fails.
LONGEST_S = 60.0
EVERY_S = 0.1
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n"
#: A record of TLS: a handshake that has 16 KiB.
HELLO = b"\x16\x03\x03\x40\x00"
SMALL = 4_096


def drip(line: socket.socket, first: bytes) -> None:
    """Send bytes one by one, and then others of them without an end."""
    end = time.monotonic() + LONGEST_S
    for byte in first:
        line.sendall(bytes((byte,)))
        time.sleep(EVERY_S)
    while time.monotonic() < end:
        line.sendall(b"x")
        time.sleep(EVERY_S)


def body(line: socket.socket) -> None:
    """Answer at once that there is an answer."""
    line.sendall(HEAD)
    drip(line, b"")


def endless(line: socket.socket) -> None:
    """Answer without an end."""
    line.sendall(HEAD)
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        line.sendall(bytes(SMALL))


def deaf(line: socket.socket) -> None:
    """Take a request in small pieces."""
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end and line.recv(SMALL):
        time.sleep(EVERY_S)


def silent(line: socket.socket) -> None:
    """Take what comes."""
    line.settimeout(LONGEST_S)
    while line.recv(SMALL):
        pass


KINDS: dict[str, Callable[[socket.socket], None]] = {
    "silent": silent,
    "head": lambda line: drip(line, HEAD[:-2] + b"X-More: "),
    "body": body,
    "endless": endless,
    "handshake": lambda line: drip(line, HELLO),
    "deaf": deaf,
}


def keep(line: socket.socket, kind: str, pem: str | None) -> None:
    """Keep one who asks."""
    with suppress(OSError), line:
        if pem is None:
            KINDS[kind](line)
            return
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(pem)
        with context.wrap_socket(line, server_side=True) as secured:
            KINDS[kind](secured)


def main(kind: str, pem: str | None = None) -> None:
    """Listen until somebody ends this process."""
    with socket.socket() as server:
        if kind == "deaf":  # what is on its way has to be little
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        server.bind(("127.0.0.1", 0))
        server.listen()
        sys.stdout.write(f"{server.getsockname()[1]}\n")
        sys.stdout.flush()
        while True:
            line, _ = server.accept()
            threading.Thread(target=keep, args=(line, kind, pem), daemon=True).start()


if __name__ == "__main__":
    main(*sys.argv[1:])
