# SPDX-License-Identifier: Apache-2.0
"""What a gate does when it starts: was the last stop a clean one, and what is still open?

Spec page: docs/spec/standing.md#recovery
"""

from __future__ import annotations

from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.identifiers import Digest
from authguard_r.core.lifecycle import TERMINAL, Event
from authguard_r.core.mission import Grant
from authguard_r.core.standing import Outcome, advance, finish, settle
from authguard_r.enforcement.management.parts import ManagementParts, entry
from authguard_r.safety.stored_memory import settle_memory
from authguard_r.store.transactions import Transaction

_KIND, _KEY = "gate", "running"
#: What a clean stop leaves; anything else says that the stop was not clean.
_STOPPED, _RUNNING = b"0", b"1"


def mark_started(act: Transaction) -> bool:
    """Mark this gate as running, and return whether the last one never said that it stopped."""
    held = act.get(_KIND, _KEY)
    act.put(_KIND, _KEY, _RUNNING)
    return held not in {None, _STOPPED}


def mark_stopped(act: Transaction) -> None:
    """Mark that everything was put away."""
    act.put(_KIND, _KEY, _STOPPED)


def recover(act: Transaction, *, unclean: bool, parts: ManagementParts) -> tuple[Digest, ...]:
    """Settle what attested state settles; suspend for the rest, or because of how it stopped."""
    mid = act.active()
    standing = act.standing(mid) if mid is not None else None
    if standing is None or not (standing.open or (unclean and standing.status not in TERMINAL)):
        return ()
    mission = parts.inputs.held(act, standing.digest).mission
    for release in standing.open:
        grant = next((g for g in mission.actions if g.id == release.grant), None)
        if grant is not None and _is_done(grant, act, parts):
            done = Outcome.SUCCEEDED
            settle_memory(act, standing, mission, ticket=release.ticket, outcome=done)
            standing = settle(
                standing, mission, ticket=release.ticket, outcome=done, used=release.reserved
            )
    if standing.open or unclean:
        standing = advance(standing, Event.SUSPEND) or standing
    standing = finish(standing, mission, act.now)
    act.hold(standing)
    opened = {"verb": "recover", "status": standing.status, "unknown": len(standing.open)}
    act.record(entry(act, standing.mid, {**opened, "unclean": True} if unclean else opened))
    return tuple(release.ticket for release in standing.open)


def _is_done(grant: Grant, act: Transaction, parts: ManagementParts) -> bool:
    rid, state = parts.facts.robot.rid, parts.inputs.state
    return bool(grant.done_when) and all(
        guard_finding(guard, state, rid, act.now) is None for guard in grant.done_when
    )
