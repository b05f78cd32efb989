# SPDX-License-Identifier: Apache-2.0
"""The stop process as its gate starts it, sooner than `authguard advanced stop-process`.

The one argument is a `EStopFiles` as JSON; the first line printed says that it serves, or why not.
Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

import sys

import msgspec

from authguard_r.core.errors import AuthGuardError
from authguard_r.estop.files import asked
from authguard_r.estop.startup import EStopReady, run_stop_process


def main(arguments: list[str]) -> int:
    """Serve until SIGTERM; return the exit code."""
    try:
        run_stop_process(asked(arguments[0]), _say, of_gate=True)
    except AuthGuardError as error:
        _say({"error": {"code": error.reason, "message": error.message, "where": error.where}})
        return 5
    return 0


def _say(line: EStopReady | dict[str, object]) -> None:
    sys.stdout.write(msgspec.json.encode(line).decode() + "\n")
    sys.stdout.flush()
