# SPDX-License-Identifier: Apache-2.0
"""What the gate's loop does for its log: checkpoints, witnesses, segments, and alerts.

Spec page: docs/spec/rollback.md#checkpoints, docs/spec/store.md#rotation
"""

from __future__ import annotations

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.anchor import WHAT, AnchorNotice, StoreAnchor
from authguard_r.anchoring.checkpoint_scheduler import CheckpointPolicy
from authguard_r.anchoring.quorum import WitnessPolicy
from authguard_r.anchoring.rotation import Rotation, RotationPolicy
from authguard_r.server.event_bus import EventBus
from authguard_r.server.liveness import Liveness


def checkpoint_policy(config: GateConfig) -> CheckpointPolicy:
    """Return when checkpoints are made, and who witnesses them."""
    return CheckpointPolicy(
        records=config.checkpoint_records,
        every_ms=config.checkpoint_ms,
        witnesses=WitnessPolicy(
            places=config.witnesses, quorum=config.quorum, silence_ms=config.witness_ms
        ),
    )


def rotation_policy(config: GateConfig) -> RotationPolicy:
    """Return when the oldest records go into a segment."""
    return RotationPolicy(records=config.segment_records, witnessed=config.quorum > 0)


class LogMaintenance:
    """Watches over what lies outside of the store.

    Args:
        anchor: the store, and what is outside of it.
        liveness: keeps alerts for `status`.
        events: records and publishes them.
        rotation: moves the oldest records out of the store; None where there is no file.
    """

    def __init__(
        self,
        anchor: StoreAnchor,
        liveness: Liveness,
        events: EventBus,
        rotation: Rotation | None = None,
    ) -> None:
        self._anchor = anchor
        self._liveness = liveness
        self._events = events
        self._rotation = rotation

    def begin(self) -> None:
        """Report a store that was put back before the gate started."""
        for told in self._anchor.put_back():
            self._tell(told)

    def look(self) -> None:
        """Make a due checkpoint, see to the witnesses, move records, and report all that."""
        for told in self._anchor.tick():
            self._tell(told)
        if self._anchor.put_back():
            return
        self._liveness.end(WHAT)  # a person has accepted the store, if it was put back
        if self._rotation is not None:
            for told in self._rotation.tick():
                self._tell(told)

    def _tell(self, told: AnchorNotice) -> None:
        if told.over:
            self._liveness.end(told.what)
        elif told.recorded:
            self._liveness.tell(told.what, told.details)
            self._events.publish({"event": "alert", "what": told.what, **told.details})
        else:
            self._liveness.alert(told.what, told.details)
