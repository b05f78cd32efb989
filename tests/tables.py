# SPDX-License-Identifier: Apache-2.0
"""Tables of the documents that come from the code: `python tests/tables.py` prints them."""

from __future__ import annotations

import sys

from authguard_r.integrations.http import edge
from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.integrations.mcp import http_front
from authguard_r.witness import server

#: Every server of the package that listens on a port.
LISTENERS: dict[str, AdmissionLimits] = {
    "authguard serve": edge.LIMITS,
    "authguard mcp --listen": http_front.LIMITS,
    "authguard witness serve": server.LIMITS,
}
#: What each limit is called, and its unit.
ROWS = {
    "connections": ("connections at one time", ""),
    "first_s": ("time to the first request's head, TLS included", " s"),
    "idle_s": ("idle time between two requests", " s"),
    "body_s": ("time to receive a body", " s"),
    "take_s": ("time for the client to read an answer", " s"),
    "head": ("longest head of a request", " bytes"),
    "body": ("longest body of a request", " bytes"),
    "lines": ("log lines of each kind per second", ""),
}


def listeners() -> str:
    """Return the table of every listener's limits."""
    rows = [["", *(f"`{name}`" for name in LISTENERS)], ["---"] * (1 + len(LISTENERS))]
    for field in AdmissionLimits.__struct_fields__:
        words, unit = ROWS[field]
        values = [f"{getattr(limits, field):,.0f}{unit}" for limits in LISTENERS.values()]
        rows.append([words, *values])
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines[0] = lines[0].replace("|  |", "| |")
    lines[1] = lines[1].replace(" ", "")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(listeners() + "\n")
