# SPDX-License-Identifier: Apache-2.0
"""An MCP server without a library, that answers what it is told to: the odd ones of the world.

    python misbehaving_mcp_server.py KIND [FILE]

`result`: tools/call answers no result of the protocol. `error`: an error of the protocol. `noise`:
lines between that are no JSON. `silent`: no answer to a ping after the first. `no-ping`: it has
none. `endless`: its list of tools does not end. `twins`: two tools of one name. `chatty`: before
each answer but the first it says all that a server can say by itself; the lines are a file's, which
is named after the kind, and what comes back goes to standard error. `flood`: the first of all its
calls has 64 MiB for an answer, and its line does not end; later starts know by the file. `deep`,
`deeper`, `infinite`, `surrogate`, `nothing`: the call's answer nests, nests deeper than anybody
reads, has a number that is none, has text that is none, is no result at all.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

KIND = sys.argv[1]
TOOL = {"name": "scan", "inputSchema": {"type": "object"}}
SAID = {"protocolVersion": "2025-11-25", "capabilities": {"tools": {}}}
ODDITIES = {
    "deep": '{"content":[],"structuredContent":{"a":' + "[" * 150 + "]" * 150 + "}}",
    "deeper": '{"content":[],"structuredContent":{"a":' + "[" * 500 + "]" * 500 + "}}",
    "infinite": '{"content":[],"structuredContent":{"a":1e999,"b":NaN}}',
    "surrogate": '{"content":[{"type":"text","text":"\\ud800"}]}',
    "nothing": "null",
}
CHATTER = Path(sys.argv[2]).read_text() if KIND == "chatty" else ""
_pings = 0


def answer(method: str) -> dict[str, Any] | None:
    """Return the answer to a request; None: none at all."""
    global _pings  # noqa: PLW0603 - a process's own count
    if method == "initialize":
        return {"result": {**SAID, "serverInfo": {"name": "odd", "version": "1"}}}
    if method == "tools/list":
        more = {"nextCursor": "more"} if KIND == "endless" else {}
        return {"result": {"tools": [TOOL] * (2 if KIND == "twins" else 1), **more}}
    if method == "tools/call" and KIND == "result":
        return {"result": {"content": 5}}
    if method == "tools/call" and KIND in {"noise", "chatty", "flood"}:
        return {"result": {"content": [{"type": "text", "text": "seen"}]}}
    if method == "ping" and KIND != "no-ping":
        _pings += 1
        return None if KIND == "silent" and _pings > 1 else {"result": {}}
    return {"error": {"code": -32601, "message": f"no {method}"}}


for line in sys.stdin:
    asked = json.loads(line)
    if "method" not in asked:
        sys.stderr.write(line)
        continue
    if asked["method"] == "tools/call" and KIND in ODDITIES:
        sys.stdout.write(f'{{"jsonrpc":"2.0","id":{asked["id"]},"result":{ODDITIES[KIND]}}}\n')
        sys.stdout.flush()
        continue
    if asked["method"] == "tools/call" and KIND == "flood" and not Path(sys.argv[2]).exists():
        Path(sys.argv[2]).touch()
        for _ in range(64):
            sys.stdout.write("x" * (1 << 20))
    said = answer(asked["method"]) if "id" in asked else None
    if KIND == "noise":
        sys.stdout.write("this is no JSON\n")
    if said is not None and asked["method"] != "initialize":
        sys.stdout.write(CHATTER)
    if said is not None:
        sys.stdout.write(json.dumps({"jsonrpc": "2.0", "id": asked["id"], **said}) + "\n")
    sys.stdout.flush()
