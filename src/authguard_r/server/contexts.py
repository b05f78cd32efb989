# SPDX-License-Identifier: Apache-2.0
"""What each connected planner has seen, kept apart; what could not be recorded may be anything.

Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import Identifier
from authguard_r.core.provenance import TRUST
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder
from authguard_r.provenance.context import ContextLedger
from authguard_r.server.fair_queue import ServedClient
from authguard_r.wire.gate_limits import LIMITS


class PlannerContexts:
    """The inputs of every planner, each with its label.

    Args:
        binder: the planner's tools; its names are what texts are searched for.
        channels: the site's own channels, with their labels.
    """

    def __init__(self, binder: Binder, channels: dict[str, str]) -> None:
        self._binder = binder
        self._channels = channels
        self._known: dict[Identifier, ContextLedger] = {}
        # clients whose input could not be recorded, however often they connect anew; a whole user,
        # `u1001.`, in place of more of its names than are kept
        self._unheard: set[str] = set()
        self._nothing = self.empty()  # for a planner that reported no input
        self._anything = self.empty()
        self._anything.add(str(TRUST[-1]), "")

    def observe(self, client: ServedClient, channel: str, text: str) -> None:
        """Note something that the client's planner was shown.

        Raises:
            MalformedError: a channel without a label, or too long a text.
            EnvironmentFault: the inputs of one more planner cannot be kept.
        """
        known = self._known.get(client.name)
        if known is not None:
            known.add(channel, text)
            return
        owner = f"u{client.uid}."
        theirs = sum(name.startswith(owner) for name in self._known)
        if theirs >= LIMITS.contexts_of_user or len(self._known) >= LIMITS.contexts:
            self._could_not_note(client)  # no planner's inputs are forgotten for another's
            raise EnvironmentFault(
                "too many planners were shown something", reason=Reason.BUSY, where="observe"
            )
        fresh = self.empty()
        fresh.add(channel, text)
        self._known[client.name] = fresh

    def of(self, client: ServedClient) -> ContextLedger:
        """Return what the client's planner saw; an input that was not noted counts as anything."""
        unheard = not self._unheard.isdisjoint((client.name, f"u{client.uid}."))
        return self._known.get(client.name, self._anything if unheard else self._nothing)

    def empty(self) -> ContextLedger:
        """Return a context in which nothing was seen."""
        return self._binder.context(self._channels)

    def _could_not_note(self, client: ServedClient) -> None:
        owner = f"u{client.uid}."
        theirs = sum(name.startswith(owner) for name in self._unheard)
        self._unheard.add(client.name if theirs < LIMITS.contexts_of_user else owner)
