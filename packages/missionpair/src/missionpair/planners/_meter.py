# SPDX-License-Identifier: Apache-2.0
"""Caps: requests a minute, and money. A cap is never exceeded, also by several processes.

Before a request goes out, the most that it can cost is set aside; what is over comes back with the
answer. Several processes, or a run that is resumed, share caps through one file.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from missionpair.briefing import PlannerError

_MINUTE = 60.0


class _State(Struct, forbid_unknown_fields=True):
    """What was used.

    Args:
        spent_microusd: millionths of a dollar, what is set aside included.
        sent: when requests went out within the last minute, seconds since 1970, oldest first.
    """

    spent_microusd: Annotated[int, Meta(ge=0)] = 0
    sent: list[float] = []


#: Made here, and not by the first thread that needs it: msgspec resolves types without a lock.
_STATE = msgspec.json.Decoder(_State)


class Meter:
    """What may still be used.

    Args:
        per_minute: most requests within any minute; None for any number.
        most_microusd: most that all requests together may cost; None for any amount.
        ledger: a file that holds what was used; without one it ends with this process, and a
            process forked from it may not go on.
        now: seconds since 1970.
        sleep: waits so many seconds.
    """

    def __init__(
        self,
        *,
        per_minute: int | None = None,
        most_microusd: int | None = None,
        ledger: Path | None = None,
        now: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._per_minute, self._most, self._ledger = per_minute, most_microusd, ledger
        self._now, self._sleep = now, sleep
        self._state, self._lock, self._pid = _State(), Lock(), os.getpid()

    @property
    def capped(self) -> bool:
        """True when there is a cap of either kind."""
        return self._per_minute is not None or self._most is not None

    @property
    def spent_microusd(self) -> int:
        """Millionths of a dollar so far."""
        with self._held() as state:
            return state.spent_microusd

    def published(self) -> dict[str, Any]:
        """Return the caps."""
        return {"per_minute": self._per_minute, "max_cost_microusd": self._most}

    def set_aside(self, microusd: int) -> None:
        """Take what a request can cost at most from what is left.

        Raises:
            PlannerError: less is left (`cost`), or the ledger cannot be used.
        """
        with self._held() as state:
            if self._most is not None and state.spent_microusd + microusd > self._most:
                raise PlannerError(
                    f"the next request may cost {dollars(microusd)}, and of {dollars(self._most)} "
                    f"{dollars(state.spent_microusd)} are spent: raise `max_cost`",
                    code="cost",
                    where="max_cost",
                )
            state.spent_microusd += microusd

    def give_back(self, microusd: int) -> None:
        """Return what a request did not cost."""
        with self._held() as state:
            state.spent_microusd -= microusd

    def take_turn(self) -> None:
        """Return when a request may go out; waits for its turn.

        Raises:
            PlannerError: the ledger cannot be used.
        """
        while self._per_minute is not None:
            with self._held() as state:
                now = self._now()
                state.sent = [at for at in state.sent if now - _MINUTE < at <= now]
                if len(state.sent) < self._per_minute:
                    state.sent.append(now)
                    return
                wait = state.sent[0] + _MINUTE - now
            self._sleep(max(wait, 0.001))

    @contextmanager
    def _held(self) -> Iterator[_State]:
        """Yield the state to one holder at a time; a ledger keeps its result."""
        with self._lock:
            if self._ledger is not None:
                with _locked(self._ledger) as (state, keep):
                    yield state
                    keep(state)
                return
            if self.capped and os.getpid() != self._pid:
                raise PlannerError(
                    "several processes would each have the whole cap: share it with `ledger=FILE`",
                    code="limit",
                    where="ledger",
                )
            yield self._state


@contextmanager
def _locked(path: Path) -> Iterator[tuple[_State, Callable[[_State], None]]]:
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise _unusable(path, error.strerror or "cannot be opened") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
        held = os.pread(file, 1 << 20, 0)
        try:
            state = _STATE.decode(held) if held else _State()
        except msgspec.DecodeError as error:
            raise _unusable(path, "holds something else") from error

        def keep(changed: _State) -> None:
            data = msgspec.json.encode(changed)
            try:
                os.pwrite(file, data.ljust(len(held)), 0)  # whole before it is made shorter
                os.ftruncate(file, len(data))
            except OSError as error:
                raise _unusable(path, error.strerror or "cannot be written") from error

        yield state, keep
    finally:
        os.close(file)


def _unusable(path: Path, why: str) -> PlannerError:
    return PlannerError(
        f"the caps' ledger `{path}` {why}: name a file of its own with `ledger`",
        code="limit",
        where="ledger",
    )


def dollars(microusd: int) -> str:
    """Return an amount as people read it."""
    return f"${microusd / 1_000_000:.6f}"
