# SPDX-License-Identifier: Apache-2.0
"""Which kind of file somebody named, where a command takes another kind."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from authguard_r.core.errors import MalformedError

_SCHEMA = re.compile(rb'"?schema"?\s*:\s*"?authguard-r/([a-z]+(?:-[a-z]+)*)/[0-9]')
_DRAFT = re.compile(rb"(?m)^mission\s*:")


@contextmanager
def expecting(path: Path, data: bytes, wanted: str) -> Iterator[None]:
    """Name the kind of a file when it turns out not to be what a command takes.

    Args:
        path: the file.
        data: its bytes.
        wanted: what the command takes, such as `a signed mission`.

    Raises:
        MalformedError: as inside, with the kind of the file where that is another.
    """
    try:
        yield
    except MalformedError as error:
        kind = kind_of(data)
        if not kind or kind == wanted:
            raise
        step = _NEXT.get((kind, wanted))
        then = f"; next: {step} {path}" if step else ""
        message = f"this file is {kind}, expected {wanted}{then}"
        raise MalformedError(message, where=str(path), reason=error.reason) from error


def kind_of(data: bytes) -> str:
    """Return what a file looks like, with its article; empty: nothing known. Proves nothing."""
    if b'"endorsements"' in data:
        return TOKEN
    found = _SCHEMA.search(data)
    if found is None:
        return DRAFT if _DRAFT.search(data) else ""
    name = found[1].decode("ascii")
    return COMPILED if name == "mission" else f"a {name.replace('-', ' ')} file"


#: Kinds of mission files, in the order in which they are made.
DRAFT, COMPILED, TOKEN = "a draft", "a compiled mission", "a signed mission"
_NEXT = {
    (DRAFT, COMPILED): "authguard mission compile",
    (DRAFT, TOKEN): "authguard mission compile",
    (COMPILED, TOKEN): "authguard mission sign",
}
