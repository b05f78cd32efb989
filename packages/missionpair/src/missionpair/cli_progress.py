# SPDX-License-Identifier: Apache-2.0
"""Progress of long work, on the terminal."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from missionpair.campaign.plan import Progress

T = TypeVar("T")
#: Items between two updates of the display.
_STEP = 64


@contextmanager
def shown(*, hidden: bool, what: str = "trials") -> Iterator[Callable[[Progress], None]]:
    """Give a function that shows progress on standard error, if that is a terminal.

    Args:
        hidden: show nothing.
        what: what is counted.

    Meanwhile SIGTERM counts as an interrupt from the keyboard: finished work is written, and
    temporary files are removed.
    """
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _bar(hidden=hidden, what=what) as show:
            yield show
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _bar(*, hidden: bool, what: str) -> Iterator[Callable[[Progress], None]]:
    if hidden or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda at: bar.update(task, completed=at.done, total=at.trials)


def counted(items: Iterable[T], total: int, show: Callable[[Progress], None]) -> Iterator[T]:
    """Yield the same items, and show how many have passed.

    Args:
        items: what is read.
        total: how many there are.
        show: shows the progress.
    """
    for number, item in enumerate(items, 1):
        if number % _STEP == 0:
            show(Progress(number, total))
        yield item
