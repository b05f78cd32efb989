# SPDX-License-Identifier: Apache-2.0
"""The command line: thin, and never a traceback for input. Exit codes: `wire.output`.

Internal: it may change in any release.
"""

from __future__ import annotations

import sys

import typer
from typer.exceptions import TyperException

from authguard_r.cli.app import AUTHGUARD, program
from authguard_r.core.errors import ClarificationError
from authguard_r.core.reasons import Reason
from authguard_r.operations.command_tree import with_new_names
from authguard_r.operations.usage import message_of, place_of
from authguard_r.wire.output import answered, emit_error

#: A question that a script cannot answer.
_NO_ANSWER = "a question was not answered, and nothing was done; scripts use --yes or --answer"
#: The extra that brings an optional module.
EXTRAS = {
    "OpenSSL": "http",
    "anthropic": "drafting",
    "anyio": "mcp",
    "asn1crypto": "ros",
    "defusedxml": "ros",
    "mcp": "mcp",
    "nacl": "frost",
    "openai": "drafting",
    "pkcs11": "pkcs11",
    "starlette": "http",
    "uvicorn": "http",
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its code."""
    sys.exit(call(sys.argv[1:] if arguments is None else arguments))


def call(arguments: list[str]) -> int:
    """Run one command and return its exit code; print an error instead of raising it."""
    as_json = "--json" in arguments
    arguments, hints = with_new_names(AUTHGUARD, arguments)

    def run() -> int:
        for hint in hints:
            sys.stderr.write(f"{hint}\n")
        try:
            made = program(arguments[0] if arguments else "")
            result = made(args=arguments, prog_name="authguard", standalone_mode=False)
        except typer.Exit as stop:
            return stop.exit_code
        except typer.Abort:
            why = "stopped by the user" if sys.stdin.isatty() else _NO_ANSWER
            return emit_error("ABORTED", why, "", as_json=as_json, code=2)
        except TyperException as error:
            return emit_error("USAGE", message_of(error), place_of(error), as_json=as_json, code=2)
        except ModuleNotFoundError as error:
            return _not_installed(error, as_json=as_json)
        except ClarificationError as error:
            from authguard_r.cli.out import emit_clarification

            return emit_clarification(error, as_json=as_json)
        return result if isinstance(result, int) else 0

    return answered(run, as_json=as_json)


def _not_installed(error: ModuleNotFoundError, *, as_json: bool) -> int:
    """Say which optional package a command needs; every other missing module is a fault of ours.

    Raises:
        ModuleNotFoundError: no extra of ours brings the module.
    """
    module = str(error.name).partition(".")[0]
    if module not in EXTRAS:
        raise error
    message = f"this command needs `{module}`: pip install 'authguard-r[{EXTRAS[module]}]'"
    return emit_error(Reason.SETUP_INVALID, message, module, as_json=as_json, code=5)


__all__ = ["call", "main"]
