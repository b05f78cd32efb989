# SPDX-License-Identifier: Apache-2.0
"""Long answers, item by item: one JSON object whose list is written as it comes, or lines.

Nothing of a log is kept in memory for being printed. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

from authguard_r.core.errors import AuthGuardError
from authguard_r.wire.output import exit_code, printed

#: Records between two signs of life.
_EVERY = 1_000


class Listing:
    """One list on its way out; `listing` makes it and ends it.

    Args:
        name: the list's key in the JSON object.
        as_json: print one JSON object instead of lines.
    """

    def __init__(self, name: str, *, as_json: bool) -> None:
        self._name = name
        self._as_json = as_json
        self.begun = False
        self._shown = False

    def add(self, item: Any, *lines: str) -> None:
        """Print one item of the list: as data, or as lines for people."""
        self.quiet()
        if self._as_json:
            self._write(", " if self.begun else f'{{"{self._name}": [', json.dumps(item))
            self.begun = True
        else:
            self._write(*(f"{printed(line)}\n" for line in lines))

    def end(self, rest: dict[str, Any], lines: Iterable[str] = ()) -> None:
        """Print the object's other keys and end it, or the last lines."""
        self.quiet()
        if self._as_json:
            head = "" if self.begun else f'{{"{self._name}": ['
            more = "".join(f", {json.dumps(key)}: {json.dumps(rest[key])}" for key in rest)
            self._write(f"{head}]{more}}}\n")
        else:
            self._write(*(f"{printed(line)}\n" for line in lines))
        sys.stdout.flush()

    def tick(self, count: int) -> None:
        """Show progress to people at a terminal only."""
        if count % _EVERY == 0 and sys.stderr.isatty():
            sys.stderr.write(f"\r{count} records")
            sys.stderr.flush()
            self._shown = True

    def quiet(self) -> None:
        """Take away what `tick` showed."""
        if self._shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
            self._shown = False

    def _write(self, *texts: str) -> None:
        sys.stdout.writelines(texts)


@contextmanager
def listing(name: str, *, as_json: bool) -> Iterator[Listing]:
    """Yield a list to fill; an error in the middle of it is its last key, and still one object."""
    made = Listing(name, as_json=as_json)
    try:
        yield made
    except AuthGuardError as error:
        made.quiet()
        if not made.begun:
            raise
        told = {"code": str(error.reason), "message": error.message, "where": error.where}
        made.end({"error": told})
        raise typer.Exit(exit_code(error)) from error
