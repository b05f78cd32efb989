# SPDX-License-Identifier: Apache-2.0
"""The command line: thin, and never a traceback for input.

Exit codes: 0 done or accepted; 1 authentic but refused; 2 wrong usage; 3 clarification or approval
needed; 4 unparsable or not authentic; 5 the environment is at fault.
"""

from __future__ import annotations

import sys

import typer
from typer.exceptions import TyperException

from authguard_r.cli.app import program
from authguard_r.cli.out import emit_clarification, emit_error, exit_code
from authguard_r.core.errors import AuthGuardError, ClarificationError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.operations.usage import message_of, place_of


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its code."""
    sys.exit(call(sys.argv[1:] if arguments is None else arguments))


def call(arguments: list[str]) -> int:
    """Run one command and return its exit code; whatever happens is said, not thrown."""
    as_json = "--json" in arguments
    try:
        made = program(arguments[0] if arguments else "")
        result = made(args=arguments, prog_name="authguard", standalone_mode=False)
    except typer.Exit as stop:
        return stop.exit_code
    except typer.Abort:
        return emit_error("ABORTED", "stopped by the user", "", as_json=as_json, code=2)
    except TyperException as error:
        return emit_error("USAGE", message_of(error), place_of(error), as_json=as_json, code=2)
    except ClarificationError as error:
        return emit_clarification(error, as_json=as_json)
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
            reason=Reason.STORE_UNAVAILABLE,
            where=error.filename or "",
        )
        return emit_error(fault.reason, fault.message, str(fault.where), as_json=as_json, code=5)
    except Exception as error:  # noqa: BLE001 - a fault of ours is said, not thrown
        name = f"{type(error).__name__}: please report this"
        return emit_error(Reason.INTERNAL_FAULT, name, "", as_json=as_json, code=5)
    return result if isinstance(result, int) else 0


__all__ = ["call", "main"]
