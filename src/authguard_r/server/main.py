# SPDX-License-Identifier: Apache-2.0
"""The gate's process: `authguard gate` checks the set-up and then becomes this program.

Arguments: `GateFiles` as JSON, and `--json` for answers as JSON. What this module imports is the
trusted code; `tests/layout.toml` bounds its size.
Spec page: docs/spec/gate-protocol.md#start-and-end
"""

from __future__ import annotations

import sys

import msgspec

from authguard_r.server.files import asked, open_parts, require_checked
from authguard_r.server.process import Rendezvous, run_gate
from authguard_r.wire.messages import Mode
from authguard_r.wire.output import answered, emit


def main(arguments: list[str]) -> int:
    """Serve until SIGTERM; return the exit code."""
    as_json = "--json" in arguments

    def run() -> int:
        files = asked(arguments[0])
        parts = open_parts(files)
        require_checked(files, parts)
        run_gate(parts, lambda place: _ready(place, parts.config.mode, as_json=as_json))
        return 0

    return answered(run, as_json=as_json)


def _ready(place: Rendezvous, mode: Mode, *, as_json: bool) -> None:
    shadow = "; SHADOW MODE: nothing is released" if mode is Mode.SHADOW else ""
    line = f"{place.robot}: serving at {place.socket} (pid {place.pid}){shadow}"
    payload = {"ready": True, "mode": str(mode), **msgspec.to_builtins(place)}
    emit(payload, [line], as_json=as_json)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
