# SPDX-License-Identifier: Apache-2.0
"""What the last run left open, settled once: as soon as there is attested state to settle it with.

A clock that is behind what was committed lets nothing be settled; the gate serves stops meanwhile,
and tries again. Spec page: docs/spec/gate-protocol.md#start-and-end
"""

from __future__ import annotations

from collections.abc import Callable

from authguard_r.core.errors import ClockError
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.management import Management
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Kind

#: Nothing of these is served before.
_AFTER = frozenset({Kind.PROPOSE, Kind.ORDER, Kind.EVALUATE})


class Recovery:
    """The first thing that a gate does.

    Args:
        management: marks that the gate runs, and settles.
        first: what else has to be recorded before anything is decided; it waits for the clock too.
    """

    def __init__(self, management: Management, *, first: Callable[[], None] = lambda: None) -> None:
        self._management = management
        self._first = first
        self._unclean: bool | None = None
        self._done = False

    def begin(self) -> None:
        """Mark on disk that this gate runs; learn whether the one before ended cleanly.

        Raises:
            StoreError: nothing was marked.
            RefusedError: nothing may be decided here at all.
        """
        try:
            self._unclean = self._start()
        except ClockError:
            self._unclean = None  # asked again when it is settled

    def _start(self) -> bool:
        self._first()
        return self._management.started()

    @property
    def unclean(self) -> bool:
        """True once it is known that the last gate did not end cleanly."""
        return self._unclean is True

    def end(self) -> None:
        """Mark a clean end; what cannot be marked makes the next start an unclean one."""
        quietly(self._management.stopped)

    def before(self, kind: Kind) -> bool:
        """Settle before anything new is decided; True when that was now.

        Raises:
            AuthGuardError: it cannot be settled, so nothing new may be decided.
        """
        if kind not in _AFTER or self._done:
            return False
        self._done = self._settle()
        return True

    def after(self, kind: Kind) -> bool:
        """Settle as soon as there is a snapshot of after the start; True when that was now."""
        return kind is Kind.SNAPSHOT and not self._management.is_behind and self.now()

    def late(self, uptime_ms: int) -> bool:
        """Settle without a snapshot when none has come in time; True when that was now."""
        return uptime_ms >= LIMITS.recovery_ms and self.now()

    def now(self) -> bool:
        """Settle, unless it was done; True when that was now. What fails is tried again."""
        if self._done:
            return False
        self._done = quietly(self._settle) is not None
        return self._done

    def _settle(self) -> bool:
        if self._unclean is None:
            self._unclean = self._start()
        self._management.recover(unclean=self._unclean)
        return True
