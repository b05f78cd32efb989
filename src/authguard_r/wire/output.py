# SPDX-License-Identifier: Apache-2.0
"""How a process answers its caller: one JSON object or text, and an exit code.

Exit codes: 0 done or accepted; 1 authentic but refused; 2 wrong usage; 3 clarification or approval
needed; 4 unparsable or not authentic; 5 the environment is at fault.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable
from typing import Any, TextIO

from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    ClarificationError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
    shown,
)
from authguard_r.core.reasons import Reason


def emit(payload: dict[str, Any], lines: Iterable[str], *, as_json: bool) -> None:
    """Print one JSON object, or the lines."""
    if as_json:
        sys.stdout.write(json.dumps(payload) + "\n")
    else:
        sys.stdout.write("".join(f"{printed(line)}\n" for line in lines))
    sys.stdout.flush()


def printed(lines: str) -> str:
    """Return text without control characters; nothing is cut, and line breaks stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in lines)


def shows_color(stream: TextIO) -> bool:
    """True for a terminal whose user did not refuse colors."""
    return stream.isatty() and "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"


def emit_error(reason: str, message: str, where: str, *, as_json: bool, code: int) -> int:
    """Print an error where it belongs and return the exit code."""
    if as_json:
        error = {"code": str(reason), "message": message, "where": where}
        sys.stdout.write(json.dumps({"error": error}) + "\n")
    else:
        place = f" (at {where})" if where else ""
        named = f"\x1b[1;31m{shown(reason)}\x1b[0m" if shows_color(sys.stderr) else shown(reason)
        sys.stderr.write(f"{named}: {shown(message)}{shown(place)}\n")
    return code


def exit_code(error: AuthGuardError) -> int:
    """Return the exit code of an error."""
    if isinstance(error, RefusedError):
        return 1
    if isinstance(error, ClarificationError):
        return 3
    if isinstance(error, MalformedError | AuthenticityError):
        return 4
    return 5


def answered(run: Callable[[], int], *, as_json: bool) -> int:
    """Run a program and return its exit code; print an error instead of raising it."""
    try:
        return run()
    except AuthGuardError as error:
        return emit_error(
            error.reason, error.message, error.where, as_json=as_json, code=exit_code(error)
        )
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        return emit_error("ABORTED", "stopped by the user", "", as_json=as_json, code=2)
    except OSError as error:
        fault = EnvironmentFault(
            f"{error.strerror or error}",
            reason=Reason.FILE_UNAVAILABLE,
            where=error.filename or "",
        )
        return emit_error(fault.reason, fault.message, str(fault.where), as_json=as_json, code=5)
    except Exception as error:  # noqa: BLE001 - a fault of ours is printed as one
        name = f"{type(error).__name__}: please report this"
        return emit_error(Reason.INTERNAL_FAULT, name, "", as_json=as_json, code=5)
