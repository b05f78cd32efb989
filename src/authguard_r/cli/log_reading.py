# SPDX-License-Identifier: Apache-2.0
"""A log for a stranger: from a store, a running gate or an export; unreadable is said as such."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from authguard_r.cli.logs import Log, open_log
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.reasons import Reason


@contextmanager
def reading(store: Path) -> Iterator[Log]:
    """Yield a log to read once.

    Raises:
        MalformedError: no such file, or nothing in it that can be read.
        StoreError: another process has it open.
    """
    try:
        with open_log(store) as log:
            yield log
    except StoreError as error:
        if error.reason in {Reason.STORE_CORRUPT, Reason.STORE_NEWER} or not store.is_file():
            raise MalformedError(error.message, where=str(store), reason=error.reason) from error
        raise
