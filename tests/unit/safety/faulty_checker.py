# SPDX-License-Identifier: Apache-2.0
"""A checker that is wrong in the way it is told to be: `faulty_checker.py SOCKET FAULT`."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from typing import Any

#: What the right answer is turned into.
ANSWERS: dict[str, Any] = {
    "right": lambda told: told,
    "wrong version": lambda told: {**told, "protocol": "authguard-r/safety-check/2"},
    "no version": lambda told: {k: v for k, v in told.items() if k != "protocol"},
    "another question": lambda told: {**told, "id": "A" * 22},
    "another action": lambda told: {**told, "action": "A" * 43},
    "a field of its own": lambda told: {**told, "override": True},
    "no verdict": lambda told: {k: v for k, v in told.items() if k != "safe"},
    "a word for a verdict": lambda told: {**told, "safe": "true"},
    "a number for a verdict": lambda told: {**told, "safe": 1},
    "nothing for a verdict": lambda told: {**told, "safe": None},
    "safe with findings": lambda told: {**told, "findings": [FOUND]},
    "unsafe without findings": lambda told: {**told, "safe": False},
    "a finding of no shape": lambda told: {**told, "safe": False, "findings": [{"rule": "x"}]},
    "a terminal's escape": lambda told: {
        **told,
        "safe": False,
        "findings": [{**FOUND, "got": "\x1b[2J"}],
    },
    "too many findings": lambda told: {**told, "safe": False, "findings": [FOUND] * 33},
    "unsafe": lambda told: {**told, "safe": False, "findings": [FOUND, {**FOUND, "field": ""}]},
    "a list": lambda told: [told],
}
FOUND = {"rule": "near-people", "field": "destination", "expected": "elsewhere", "got": "there"}


def spelled(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


#: What becomes of the bytes of the right answer.
BYTES: dict[str, Any] = {
    "another spelling": lambda line: json.dumps(json.loads(line)).encode() + b"\n",
    "a second verdict": lambda line: line[:-2] + b',"safe":true}\n',
    "no JSON": lambda line: b"safe\n",
    "no text": lambda line: b"\xff\xfe\n",
    "an empty line": lambda line: b"\n" + line,
    "closed in the middle": lambda line: line[: len(line) // 2],
    "closed before the end of the line": lambda line: line[:-1],
    "nothing": lambda line: b"",
    "two answers": lambda line: line + line,
    "too long": lambda line: b" " * 20_000 + line,
    "too long for a line": lambda line: line[:-1] + b" " * 20_000,
}


def serve(link: socket.socket, fault: str, served: int) -> None:
    """Answer one connection wrongly."""
    line = link.makefile("rb").readline()
    asked = json.loads(line)
    if fault == "echoed":
        link.sendall(line)
        return
    if fault == "died":
        os._exit(1)
    if fault == "slow":
        time.sleep(3_600)
    right = {
        "protocol": asked["protocol"],
        "id": asked["id"],
        "action": asked["action"],
        "safe": True,
        "findings": [],
    }
    if fault == "the answer of before":
        right = PAST.setdefault("answer", right)
    data = spelled(ANSWERS.get(fault, ANSWERS["right"])(right)) + b"\n"
    if fault == "trickling":
        for number in range(len(data)):
            link.sendall(data[number : number + 1])
            time.sleep(0.05)
    link.sendall(BYTES.get(fault, lambda line: line)(data))


PAST: dict[str, Any] = {}


def main(path: str, fault: str) -> None:
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(path)
        door.listen(4)
        print("ready", flush=True)
        for served in range(1 << 20):
            link, _ = door.accept()
            if fault == "deaf":
                time.sleep(3_600)
            with link:
                if fault == "closed at once":
                    continue
                try:
                    serve(link, fault, served)
                except OSError:
                    continue


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
