# SPDX-License-Identifier: Apache-2.0
"""Opens a gate's emergency road: what the last run left comes into the log, then calls may come.

Spec page: docs/spec/emergency.md#the-road
"""

from __future__ import annotations

from pathlib import Path

from authguard_r.enforcement.emergency.journal import MAGIC, EmergencyJournal
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.enforcement.emergency_audit import EmergencyAudit
from authguard_r.enforcement.emergency_enforcer import EmergencyEnforcer
from authguard_r.keys.signer import FileSigner
from authguard_r.server.emergencies import EmergencyCalls
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.service import Service
from authguard_r.store.transactions import Ledger

#: What is told of a journal that holds what this gate did not write there.
STRANGE = "the emergency journal is not authentic"


def open_journal(path: Path, ledger: Ledger, signer: FileSigner) -> EmergencyJournal:
    """Return the emergency journal in a file, under a key for this store and its robot alone.

    Raises:
        EnvironmentFault: the file cannot be used.
    """
    first = ledger.peek(lambda turn: turn.rows(0, 1))[0][3]  # it names the robot, and is no other's
    return EmergencyJournal(path, key=signer.secret(MAGIC + first))


def open_road(
    service: Service,
    opened: OpenedPolicy,
    journal: EmergencyJournal | None,
    *,
    controller: RemoteController | None,
) -> EmergencyEnforcer:
    """Return the emergency road of a gate; its clients are served from now on.

    Args:
        service: the gate.
        opened: the policy.
        journal: takes what the store cannot; None: nothing is done without the store.
        controller: the controller's end; None where nothing is connected to anything.

    Raises:
        StoreError: the policy was not recorded.
    """
    gate = service.gate
    log = EmergencyAudit(gate.ledger, journal, settle=gate.enforcer.settle_stops)
    log.adopt(opened)
    log.flush()
    if log.strange:
        service.liveness.alert(STRANGE, log.strange)
    road = EmergencyEnforcer(
        gate.ledger,
        gate.enforcer.intake,
        opened=opened,
        verifier=gate.trust,
        facts=gate.facts,
        safety=gate.safety,
        watch=gate.watch,
        log=log,
    )
    rescues = EmergencyCalls(
        road,
        enforcer=gate.enforcer,
        motions=service.motions,
        controller=controller,
        liveness=service.liveness,
        publish=service.notices.publish,
        state_wait_ms=service.config.state_wait_ms,
    )
    service.desk.rescues = rescues
    service.motions.beside.append(rescues.look)
    service.view.emergency = rescues.shown
    return road
