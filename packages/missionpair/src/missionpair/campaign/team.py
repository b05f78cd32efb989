# SPDX-License-Identifier: Apache-2.0
"""Pairs that run at once: processes, or threads where a model is waited for.

The runner of a pair puts each trial into the pair's file (`ahead`); they are taken from there in
order. A process ends with the one that began it, however that one ended.
"""

from __future__ import annotations

import os
import queue
import signal
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree
from threading import Event, Thread
from time import sleep
from types import TracebackType
from typing import Any, Self

from missionpair.campaign.ahead import Ahead, Tail, end, keep
from missionpair.campaign.log import LogError
from missionpair.campaign.worker import ONE, TrialResult, Worker

#: Pairs that are under way at once, for each process.
_AHEAD = 4
#: Seconds between two looks at what the others have done, and at who began them.
_LOOK_S, _PARENT_S = 0.01, 0.25
#: Seconds that a model is waited for when a campaign ends early: what it answers is kept.
_PATIENCE_S = 90.0


class Team:
    """Runs pairs on several processes or threads.

    Args:
        worker: what each of them is a twin of.
        folder: for their keys.
        ahead: where trials wait for their turn.
        jobs: how many.
        forget: lets go of the log in a new process, so that no other process holds its lock.
    """

    def __init__(
        self, worker: Worker, folder: Path, ahead: Ahead, jobs: int, forget: Callable[[], None]
    ) -> None:
        self._worker, self._folder, self._ahead = worker, folder, ahead
        self._jobs, self._forget = jobs, forget
        self._kept: dict[int, tuple[TrialResult, ...]] = {}
        self._over: dict[int, Exception | None] = {}
        self._hands: list[Any] = []
        context = get_context("fork")
        # numbers of pairs go out; who finished which, and with what error, comes back
        kind: Any = queue if worker.is_live else context
        self._tasks, self._told = kind.SimpleQueue(), kind.SimpleQueue()
        self._stop: Any = Event() if worker.is_live else context.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all of them; a paid answer that is under way is waited for, but not by a worker."""
        self._stop.set()
        for _ in self._hands:
            self._tasks.put(None)
        is_stopped = kind is not None and not issubclass(kind, Exception)
        waits = kind is None or (self._worker.is_paid and not is_stopped)
        for hand in self._hands:
            if waits:
                hand.join(_PATIENCE_S)
            if not self._worker.is_live:
                hand.kill()
                hand.join()

    def in_order(self, numbers: Iterator[int]) -> Iterator[TrialResult]:
        """Yield the trials of these pairs, in order, each as soon as it and all before it are run.

        Raises:
            LogError: a process is gone, or the disk is full.
            PlannerError: as `Worker.trials`.
            AttackerError: as `Worker.trials`.
            StageError: as `Worker.trials`.
        """
        if self._worker.is_live:  # the first one alone, so that every decoder was used once
            for number in islice(numbers, 1):
                yield from self._ahead.kept(number) or self._worker.trials(number)
        self._start()
        begun = [self._begun(number) for number in islice(numbers, self._jobs * _AHEAD)]
        while begun:
            number = begun.pop(0)
            yield from self._kept.pop(number, ()) or self._trials(number)
            begun += [self._begun(later) for later in islice(numbers, 1)]

    def _start(self) -> None:
        context, parent = get_context("fork"), os.getpid()
        for number in range(self._jobs):
            if self._worker.is_live:
                hand: Any = Thread(target=self._in_thread, args=(number,), daemon=True)
            else:
                work = partial(self._in_process, number, parent)
                hand = context.Process(target=work, daemon=True)
            hand.start()
            self._hands.append(hand)

    def _begun(self, number: int) -> int:
        kept = self._ahead.kept(number) if self._worker.is_paid else ()
        if kept:
            self._kept[number] = kept
        else:
            self._ahead.path(number).unlink(missing_ok=True)
            self._tasks.put(number)
        return number

    def _trials(self, number: int) -> Iterator[TrialResult]:
        with Tail(self._ahead.path(number)) as tail:
            is_over = False
            while not is_over:
                is_over = self._is_over(number)
                yield from tail.read()
                if not is_over:
                    sleep(_LOOK_S)
        error = self._over.pop(number)
        if error is not None:
            raise error
        self._ahead.path(number).unlink(missing_ok=True)

    def _is_over(self, number: int) -> bool:
        """True when a pair came to its end; its file is whole then."""
        are_here = all(hand.is_alive() for hand in self._hands)
        while not self._told.empty():
            pair, error = self._told.get()
            self._over[pair] = error
        if number not in self._over and not are_here:
            text = (
                "a process that ran pairs was killed; the log has every finished trial; run again"
            )
            raise LogError(text, where=str(self._ahead.path(number)), is_here=True)
        return number in self._over

    def _in_thread(self, name: int) -> None:
        with ONE:
            worker = self._worker.twin(self._folder / f"thread-{name}")
        self._work(worker)

    def _in_process(self, name: int, parent: int) -> None:
        self._forget()
        # a signal to all is for the one that writes; it ends the others
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        Thread(target=_watch, args=(parent, self._folder), daemon=True).start()
        self._work(self._worker.twin(self._folder / f"process-{name}"))

    def _work(self, worker: Worker) -> None:
        while (number := self._tasks.get()) is not None and not self._stop.is_set():
            error: Exception | None = None
            try:
                self._run(worker, number)
            except Exception as failed:  # noqa: BLE001 - told, and raised where the log is written
                error = failed
            self._told.put((number, error))

    def _run(self, worker: Worker, number: int) -> None:
        with self._ahead.begin(number) as file, ONE:
            for ran in worker.trials(number):
                keep(file, ran)
                if self._stop.is_set():
                    break
            else:
                end(file)


def _watch(parent: int, folder: Path) -> None:
    """End this process when the one that began it is gone, and what lies here with it."""
    while os.getppid() == parent:
        sleep(_PARENT_S)
    rmtree(folder, ignore_errors=True)
    os._exit(1)
