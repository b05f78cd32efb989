# SPDX-License-Identifier: Apache-2.0
"""A log for a stranger: from a store, a running gate or an export; unreadable is said as such.

What of it is sealed is opened here and nowhere else, as far as a reader's key goes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from msgspec.structs import replace

from authguard_r.cli.logs import ReadableLog, open_log
from authguard_r.cli.unsealing import LogUnsealer
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.reasons import Reason


@contextmanager
def reading(store: Path, opening: LogUnsealer | None = None) -> Iterator[ReadableLog]:
    """Yield a log to read once.

    Args:
        store: its file.
        opening: what opens its rows; None: they are those that are stored, for who verifies them.

    Raises:
        MalformedError: no such file, or nothing in it that can be read.
        StoreError: another process has it open.
    """
    try:
        with strange(), open_log(store) as log:
            yield log if opening is None else replace(log, rows=opening.rows(log.rows))
    except StoreError as error:
        if store.is_file():
            raise
        raise MalformedError(error.message, where=str(store), reason=error.reason) from error


@contextmanager
def strange() -> Iterator[None]:
    """Tell a file that is no whole store from one that cannot be read now.

    Raises:
        MalformedError: it holds nothing that can be read.
    """
    try:
        yield
    except StoreError as error:
        if error.reason in {Reason.STORE_CORRUPT, Reason.STORE_NEWER}:
            raise MalformedError(error.message, where=error.where, reason=error.reason) from error
        raise
