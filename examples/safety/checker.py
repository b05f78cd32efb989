# SPDX-License-Identifier: Apache-2.0

"""A safety checker in a process of its own, on the standard library alone.

    checker.py SOCKET

Put your own check into `findings`. The gate asks over a Unix socket: one connection, one line of
JSON there, one line back. Whatever else comes back, or nothing, is unsafe.
Protocol: docs/spec/safety.md#checker
"""

from __future__ import annotations

import json
import os
import socketserver
import sys
from pathlib import Path

PROTOCOL = "authguard-r/safety-check/1"
#: This checker's own rule: nobody is handed anything faster than that.
MOST_MM_S = 300


def findings(question: dict) -> list[dict]:
    """Return why the action is unsafe; nothing when it is safe."""
    effect = question["effect"]
    speed = effect.get("params", {}).get("speed_mm_s", 0)
    if effect["type"] != "navigate" or speed <= MOST_MM_S:
        return []
    return [
        {
            "rule": "slow",
            "field": "params.speed_mm_s",
            "expected": f"at most {MOST_MM_S}",
            "got": str(speed),
        }
    ]


def answer(line: bytes) -> bytes:
    """Return the answer to one question, in the one spelling that is read."""
    question = json.loads(line)
    if question["protocol"] != PROTOCOL:
        raise ValueError("not my protocol")
    found = findings(question)
    told = {
        "protocol": PROTOCOL,
        "id": question["id"],
        "action": question["action"],
        "safe": not found,
        "findings": found,
    }
    return json.dumps(told, sort_keys=True, separators=(",", ":")).encode() + b"\n"


class Handler(socketserver.StreamRequestHandler):
    """One connection: one question, one answer."""

    def handle(self) -> None:
        """Answer, or let the connection end: that is unsafe, and it is meant to be."""
        self.wfile.write(answer(self.rfile.readline(1 << 21)))


def main(path: str) -> None:
    """Serve until the process is ended."""
    Path(path).unlink(missing_ok=True)
    os.umask(0o177)  # nobody else connects
    with socketserver.UnixStreamServer(path, Handler) as server:
        print("ready", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main(sys.argv[1])
