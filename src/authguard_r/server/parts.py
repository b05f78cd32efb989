# SPDX-License-Identifier: Apache-2.0
"""What a gate is started with: every part is read and authentic before the process begins."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.counter import Counter
from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.core.ports import Clock, Controller, StateSource
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.estop.files import EStopFiles
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import Trust
from authguard_r.normalize.binding import Binding
from authguard_r.safety import SafetyConfig
from authguard_r.site.model import Site


class SimulatedRobot(Controller, StateSource, Clock, Protocol):
    """A robot in the gate's own process: controller, estimator and clock in one."""

    trace: list[Any]


class EmergencyParts(Struct, frozen=True, kw_only=True):
    """The emergency policy, and where its journal is; None: beside the store."""

    policy: OpenedPolicy
    journal: Path | None = None


class GateParts(Struct, frozen=True, kw_only=True):
    """What a gate is started with, each part read and authentic.

    Args:
        run: the run folder, for the sockets; the gate's user owns it.
        trust: the trust root.
        signer: the gate's own key.
        site: the site model.
        binding: the planner's tools.
        safety: the second gate's configuration.
        config: the gate's own.
        store: the store's file.
        estop: what the stop process is started with; None without one: a robot in this process.
        journal: the file descriptor of the structured log.
        demo: a root that says `demo` will do.
        key: the file of the gate's own key, which is held against a second gate.
        simulated: a symbolic robot in this process, with its own time; for trying out.
        risk: the organization's risk policy; None without one.
        counter: kept outside of the store; None without one.
        emergency: the emergency policy; None without one: only stops work without a mission.
    """

    run: Path
    trust: Trust
    signer: FileSigner
    site: Site
    binding: Binding
    safety: SafetyConfig
    config: GateConfig
    store: Path
    estop: EStopFiles | None
    journal: int
    demo: bool
    key: Path | None = None
    simulated: SimulatedRobot | None = None
    risk: VerifiedPolicy | None = None
    counter: Counter | None = None
    emergency: EmergencyParts | None = None
