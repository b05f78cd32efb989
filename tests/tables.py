# SPDX-License-Identifier: Apache-2.0
"""Tables of the documents that are made from the code: `python tests/tables.py` prints them."""

from __future__ import annotations

import sys

from authguard_r.http import edge
from authguard_r.listening.room import Limits
from authguard_r.mcp import listening
from authguard_r.witness import server

#: Every server of the package that listens on a port.
LISTENERS: dict[str, Limits] = {
    "authguard serve": edge.LIMITS,
    "authguard mcp --listen": listening.LIMITS,
    "authguard witness serve": server.LIMITS,
}
#: What each limit is called, and its unit.
ROWS = {
    "connections": ("connections at one time", ""),
    "first_s": ("from the connection, TLS included, to the first request's head", " s"),
    "idle_s": ("nothing is asked between two requests", " s"),
    "body_s": ("a request's body is whole within", " s"),
    "take_s": ("an answer is taken within", " s"),
    "head": ("head of a request", " bytes"),
    "body": ("body of a request", " bytes"),
    "lines": ("lines about strangers in a second, of each kind", ""),
}


def listeners() -> str:
    """Return the table of every listener's limits."""
    rows = [["", *(f"`{name}`" for name in LISTENERS)], ["---"] * (1 + len(LISTENERS))]
    for field in Limits.__struct_fields__:
        words, unit = ROWS[field]
        values = [f"{getattr(limits, field):,.0f}{unit}" for limits in LISTENERS.values()]
        rows.append([words, *values])
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines[0] = lines[0].replace("|  |", "| |")
    lines[1] = lines[1].replace(" ", "")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(listeners() + "\n")
