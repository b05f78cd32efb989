# SPDX-License-Identifier: Apache-2.0
"""What a gate's service is made of."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.rotation import Rotation
from authguard_r.core.principals import Signer
from authguard_r.enforcement.emergency_enforcer import EmergencyEnforcer
from authguard_r.normalize import Binder
from authguard_r.server.event_log import EventLog
from authguard_r.server.plan_reader import PlanReader
from authguard_r.server.recovery import Recovery
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.state_inbox import StateInbox
from authguard_r.server.streams import Streams
from authguard_r.server.wiring import Gate


class ServiceParts(Struct, frozen=True, kw_only=True):
    """What a gate's service is made of.

    Args:
        gate: enforcer, management, ledger.
        config: the signed configuration.
        binder: the planner's tools.
        reader: reads long plans.
        channels: the site's own channels, with their labels.
        signer: the gate's own key, for proofs.
        inbox: the estimator's channel, which the gate's input verifier reads.
        controller: the controller's end; None where nothing is connected to anything: shadow
            mode, or a robot in this process.
        streams: what may be sampled while it runs; None where there is no controller.
        recovery: settles what the last run left open.
        journal: for administrators of the machine.
        advance: lets simulated time pass, with whether something moves; None where time is real.
        rotation: moves the oldest records out of the store; None where there is no file.
        emergency: carries out emergencies; None without a signed policy.
        free_bytes: returns what the store's disk has left; None where there is no disk.
        stop_process_alive: returns whether the stop process answers; None where there is none.
    """

    gate: Gate
    config: GateConfig
    binder: Binder
    reader: PlanReader
    channels: dict[str, str]
    signer: Signer
    inbox: StateInbox
    controller: RemoteController | None
    streams: Streams | None
    recovery: Recovery
    journal: EventLog
    advance: Callable[[bool], None] | None = None
    rotation: Rotation | None = None
    emergency: EmergencyEnforcer | None = None
    free_bytes: Callable[[], int] | None = None
    stop_process_alive: Callable[[], bool] | None = None
