# SPDX-License-Identifier: Apache-2.0
"""Opens a gate's emergency enforcer; what the last run left goes into the log first.

Spec page: docs/spec/emergency.md#the-road
"""

from __future__ import annotations

from pathlib import Path

from authguard_r.enforcement.emergency.journal import MAGIC, EmergencyJournal
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.enforcement.emergency_audit import EmergencyAudit
from authguard_r.enforcement.emergency_enforcer import EmergencyEnforcer
from authguard_r.keys.signer import FileSigner
from authguard_r.server.wiring import Gate
from authguard_r.store.transactions import Ledger


def open_journal(path: Path, ledger: Ledger, signer: FileSigner) -> EmergencyJournal:
    """Return the emergency journal in a file, under a key for this store and its robot alone.

    Raises:
        EnvironmentFault: the file cannot be used.
    """
    first = ledger.peek(lambda turn: turn.rows(0, 1))[0][3]  # it names the robot, and is no other's
    return EmergencyJournal(path, key=signer.secret(MAGIC + first))


def open_emergency_enforcer(
    gate: Gate, opened: OpenedPolicy, journal: EmergencyJournal | None
) -> EmergencyEnforcer:
    """Return the emergency enforcer of a gate, once what the last run left is in the log.

    Args:
        gate: the gate.
        opened: the policy.
        journal: takes what the store cannot; None: nothing is done without the store.

    Raises:
        StoreError: the policy was not recorded.
    """
    log = EmergencyAudit(gate.ledger, journal, settle=gate.enforcer.settle_stops)
    log.adopt(opened)
    log.flush()
    return EmergencyEnforcer(
        gate.ledger,
        gate.enforcer.inputs,
        opened=opened,
        verifier=gate.trust,
        facts=gate.facts,
        safety=gate.safety,
        watch=gate.watch,
        log=log,
    )
