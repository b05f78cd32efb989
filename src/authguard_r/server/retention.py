# SPDX-License-Identifier: Apache-2.0
"""What the gate's loop does for sealed fields whose time is over, and its alert when it cannot.

Spec page: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from authguard_r.core.errors import AuthGuardError, ClockError
from authguard_r.enforcement.management import Management
from authguard_r.server.liveness import Liveness
from authguard_r.wire.gate_limits import LIMITS

#: The alert while fields stay that were to be destroyed.
STUCK = "sealed fields are not destroyed"


class RetentionWork:
    """Ends what was kept as long as it may be, and destroys what was ordered.

    Args:
        management: does either, a little at a time.
        mono_ms: the monotonic clock.
        liveness: raises the alert, once until it is over.
        ended: called when missions may have ended.
    """

    def __init__(
        self,
        management: Management,
        mono_ms: Callable[[], int],
        liveness: Liveness,
        ended: Callable[[], None],
    ) -> None:
        self._management = management
        self._mono_ms = mono_ms
        self._liveness = liveness
        self._ended = ended
        self._stuck: dict[str, dict[str, Any]] = {}
        self._looked_ms: int | None = None

    def look(self) -> None:
        """Do what is due; while the clock is wrong, nothing is."""
        now_ms = self._mono_ms()
        if self._looked_ms is None or now_ms - self._looked_ms >= LIMITS.retention_ms:
            self._looked_ms = now_ms
            self._try("retention", self._retire)
        self._try("destruction", self._management.shred_on)

    def _retire(self) -> None:
        done = self._management.retire()
        if done.begun:
            self._ended()
        self._tell("missions", {"missions": list(done.stuck)} if done.stuck else None)

    def _try(self, what: str, act: Callable[[], object]) -> None:
        try:
            act()
        except ClockError:  # which has an alert of its own
            return
        except AuthGuardError as error:
            self._tell(what, {"where": error.where, "message": error.message})
        else:
            self._tell(what, None)

    def _tell(self, what: str, details: dict[str, Any] | None) -> None:
        """Raise the alert when something else is wrong than before; end it when nothing is."""
        before = self._stuck.get(what)
        if details is not None and details != before:
            self._stuck[what] = details
            self._liveness.alert(STUCK, details)
        elif details is None and before is not None:
            del self._stuck[what]
            if not self._stuck:
                self._liveness.end(STUCK)
