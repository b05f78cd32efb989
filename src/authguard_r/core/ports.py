# SPDX-License-Identifier: Apache-2.0
"""The borders of the core: what siblings offer each other through it.

Protocols only; `server.wiring` alone joins the parts. Spec page: docs/explanation/architecture.md
"""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from authguard_r.core.action import Action
    from authguard_r.core.facts import SiteFacts
    from authguard_r.core.lease import Lease
    from authguard_r.core.quantities import Now
    from authguard_r.core.safety import SafetyDecision
    from authguard_r.core.standing import Outcome, Spend
    from authguard_r.core.state import AttestedState

T = TypeVar("T")


class Clock(Protocol):
    """The only source of time, read once for each decision."""

    def wall_ms(self) -> int:
        """Return the wall clock, milliseconds since 1970; may be wrong, may run backwards."""
        ...

    def mono_ms(self) -> int:
        """Return a clock that never runs backwards, milliseconds since some start."""
        ...

    def pause(self, duration_ms: int) -> None:
        """Return after `duration_ms`; a simulated clock moves its world instead of waiting."""


class Turn(Protocol):
    """What a job sees inside the writer's turn: one consistent store without other writers."""

    def get(self, kind: str, key: str) -> bytes | None:
        """Return the value held under the key, as written before in this or an earlier turn."""
        ...

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold the value under the key when, and only when, the turn commits."""

    def head(self) -> tuple[int, bytes]:
        """Return how many records the log has and the last link, 32 zero bytes at first."""
        ...

    def append(self, record: bytes, sealed: bytes, link: bytes) -> int:
        """Append one record and return its sequence number, from 0."""
        ...

    def rows(self, first: int, count: int) -> tuple[tuple[int, bytes, bytes, bytes], ...]:
        """Return at most `count` rows of the log from `first` on: seq, record, sealed, link."""
        ...

    def forget(self, seq: int, names: Container[str]) -> None:
        """Let the values of these names beside a record go; its commitments to them stay."""


class Store(Protocol):
    """Registry and audit log in one transaction, one writer, durable before it answers."""

    def run(self, job: Callable[[Turn], T], *, essential: bool = False) -> T:
        """Run the job in the writer's turn and return its result after it is on disk.

        An exception from the job undoes everything the job did and is raised here. When the disk
        was full and room was made, the job is run once more from the start.

        Args:
            job: reads, puts and appends.
            essential: may use the room that is kept for what must be written on a full disk.

        Raises:
            StoreError: nothing of the job was committed.
        """
        ...

    def read(self, job: Callable[[Turn], T]) -> T:
        """Run a job that only reads in the writer's turn; what it puts or appends is dropped.

        Raises:
            StoreError: it cannot be read.
        """
        ...

    def restore(self) -> bool:
        """Keep room for essential jobs again if it was used; True while there is room beside it."""
        ...

    def is_here(self) -> bool:
        """True while its file is where it was opened; nothing is committed to one that is not."""
        ...

    def close(self) -> None:
        """Finish what was submitted and let go of the file."""


class SafetyGate(Protocol):
    """The second gate: physical safety, with its own configuration, reasons and evidence."""

    def recall(self, memory: bytes) -> SafetyGate:
        """Return the gate as of this memory, once given by it; empty: nothing was done yet."""
        ...

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return the verdict on one action in one state; total and without effects."""
        ...


class GoalHandle(Protocol):
    """One dispatched action while it runs."""

    def outcome(self) -> Outcome | None:
        """Return how it ended, or None while it runs."""
        ...

    def used(self) -> Spend:
        """Return what it has used so far."""
        ...


class Controller(Protocol):
    """The actuators. Only `enforcement` holds one."""

    def dispatch(self, action: Action, lease: Lease) -> GoalHandle:
        """Begin to carry out a released action.

        Raises:
            ControllerError: it was not begun.
        """
        ...

    def stop(self) -> None:
        """Brake and hold at once; running actions end."""


class StateSource(Protocol):
    """The estimator's channel into the gate."""

    def latest(self) -> bytes | None:
        """Return the newest signed snapshot token, or None when there is none."""
        ...

    def fence(self, number: int) -> None:
        """Have everything measured anew; what is measured after this call carries the number."""
