# SPDX-License-Identifier: Apache-2.0
"""The mission that is active at a gate, as `status` shows it; read anew when it may have changed.

Spec page: docs/spec/gate-protocol.md#reading
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.core.errors import ClockError, StoreError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Turn
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing, use_of
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.server.liveness import MissionPhase
from authguard_r.store.issued_missions import damaged, issued
from authguard_r.store.transactions import Ledger, Transaction


class ActiveMission:
    """What may be read of the active mission, and of those that are issued.

    Args:
        ledger: the store.
        inputs: verifies and keeps missions.
    """

    def __init__(self, ledger: Ledger, inputs: InputVerifier) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self._known: dict[str, Any] | None = None
        self._is_old = True
        self.issued: list[dict[str, Any]] = []
        self.damaged: tuple[str, ...] = ()

    @property
    def runs(self) -> bool:
        """True while a mission is active."""
        phase = self.phase()
        return phase is not None and phase.runs

    def phase(self) -> MissionPhase | None:
        """Return how the active mission stands; None once it has ended."""
        try:
            mission = self.shown()
        except StoreError:  # a disk that is gone does not suppress alerts
            mission = self._known
        if mission is None or mission["status"] in TERMINAL:
            return None
        return MissionPhase(mission["mid"], mission["version"], Status(mission["status"]))

    @property
    def status(self) -> str | None:
        """How the active mission stands, None without one."""
        mission = self.shown()
        return None if mission is None else str(mission["status"])

    def changed(self) -> None:
        """Say that what is known of the active mission is old."""
        self._is_old = True

    def shown(self) -> dict[str, Any] | None:
        """Return what `status` says of the active mission; None without one.

        Raises:
            StoreError: the store cannot be read.
        """
        if self._is_old:
            try:
                self._known = self._ledger.run(self._mission)
            except (ClockError, StoreError) as error:  # behind, or moved away
                void = error.reason
                return self._ledger.peek(lambda turn: self._as_held(turn, void))
            self._is_old = False
        return self._known

    def _as_held(self, turn: Turn, void: Reason) -> dict[str, Any] | None:
        """Return the active mission as it is held: showing it needs no clock, verifying it does."""
        mid = turn.get("active", "mission")
        if not mid:
            return None
        standing = self._ledger.standing(MissionId(mid.decode("ascii")))
        kept = None if standing is None else self._inputs.kept(standing.digest)
        if standing is None or kept is None:  # of a gate before this one
            return self._known
        return _shown(standing, kept.mission, void=void)

    def _mission(self, act: Transaction) -> dict[str, Any] | None:
        inputs = self._inputs
        self.issued = [_shown_issued(act, inputs, one) for one in issued(act)]
        self.damaged = damaged(act)
        mid = act.active()
        standing = None if mid is None else act.standing(mid)
        if standing is None:
            return None
        held = inputs.held(act, standing.digest)
        return _shown(standing, held.mission, void=inputs.lost(act, standing.digest))


def _shown_issued(act: Transaction, inputs: InputVerifier, standing: Standing) -> dict[str, Any]:
    """Return what `status` says of an issued mission; a damaged token says nothing of itself."""
    try:
        mission = inputs.held(act, standing.digest).mission
    except StoreError:
        mission = None
    return {
        "mid": standing.mid,
        "version": standing.version,
        "issuer": None if mission is None else mission.issuer,
        "not_before": None if mission is None else mission.not_before,
        "expiry": None if mission is None else mission.expiry,
    }


def _shown(standing: Standing, mission: Mission, *, void: Reason | None) -> dict[str, Any]:
    """Return what `status` says of a mission, and why it authorizes nothing in its status."""
    return {
        "mid": standing.mid,
        "version": standing.version,
        "status": str(standing.status),
        "void": None if void is None else str(void),
        "issuer": mission.issuer,
        "expiry": mission.expiry,
        "closes": to_timestamp(standing.closes_ms) if standing.closes_ms else None,
        "open": [release.ticket for release in standing.open],
        "requests": msgspec.to_builtins(standing.requests),
        "prompts": standing.prompts,
        "grants": [
            {
                "id": grant.id,
                "type": grant.type,
                "starts": use_of(standing, grant.id).starts,
                "of": grant.starts,
            }
            for grant in mission.actions
        ],
    }
