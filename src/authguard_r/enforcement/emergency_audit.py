# SPDX-License-Identifier: Apache-2.0
"""Emergencies, written down: in the log, or in the journal until the log can be written again.

Every record goes into the log once: the number of the last one that it has is held in the store,
in the commit that wrote it. Spec page: docs/spec/emergency.md#journal
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.audit.record import NONE, Entry
from authguard_r.core.action import Action
from authguard_r.core.decision import Verdict
from authguard_r.core.encoding import Tag, digest_of, encode_fast
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.finding import Findings
from authguard_r.core.identifiers import Count, Digest, Identifier
from authguard_r.core.quantities import Now
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome
from authguard_r.core.state import AttestedState
from authguard_r.enforcement.emergency.journal import EmergencyJournal, Journaled
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.enforcement.emergency.policy import HOUR_MS, MOST_PER_HOUR, Caller, Missing
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import NOT_EVALUATED
from authguard_r.store.transactions import Held, Ledger, read_held, stop_stands
from authguard_r.wire.gate_limits import LIMITS

#: What a record of a released call says.
ACCEPT = "accept"
#: What the log calls a refused call.
EMERGENCY = "emergency"
_KIND, _KEY = "emergency", "state"


class EmergencyStanding(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the store holds of emergencies.

    Args:
        policy: digest of the policy that the log has.
        uses: when a capability was used within the last hour, on the monotonic clock: by caller
            and capability; with `not_started` behind it, uses that were given back; under the
            capability alone, an older gate's, which count for every caller.
        open: releases whose end is not recorded.
        heard: the last record of the journal that the log has.
        lost: how many that did not fit the log has counted.
    """

    policy: str = ""
    uses: dict[str, tuple[int, ...]] = {}
    open: dict[str, str] = {}
    heard: Count = 0
    lost: Count = 0


class EmergencyStep(Struct, frozen=True, kw_only=True):
    """One step of an emergency: that it was released, or how it ended."""

    decision: str
    at: Now
    opened: OpenedPolicy
    capability: Identifier
    caller: Caller
    by: Identifier
    ticket: Digest
    action: Action | None
    state: AttestedState | None
    safety: SafetyDecision | None
    findings: Findings
    lacked: frozenset[Missing]
    stood_ms: int | None = None


class EmergencyAudit:
    """Where emergencies are written down.

    Args:
        ledger: the log, and what is held beside it.
        journal: takes what the log cannot take now; None: nothing is done without the log.
        settle: writes what an operator's stop has to change; True once that is on disk.
    """

    def __init__(
        self, ledger: Ledger, journal: EmergencyJournal | None, *, settle: Callable[[], bool]
    ) -> None:
        self._ledger = ledger
        self._journal = journal
        self._settle = settle
        self._stopped = ledger.peek(stop_stands)
        held = ledger.peek(lambda turn: turn.get(_KIND, _KEY))
        self._kept = (
            EmergencyStanding() if held is None else read_held(held, EmergencyStanding, _KIND)
        )
        self._before = frozenset(self._kept.open)  # of a gate that ended before they did
        #: What ended unknown since this gate started, or was left open by the one before.
        self.unknown: deque[str] = deque(maxlen=LIMITS.shown_emergencies)
        #: What lies in the journal's file that this gate did not write there; empty: nothing.
        self.strange: dict[str, int] = {}
        if journal is not None:
            journal.after(self._kept.heard, self._kept.lost)
            self.strange = _strange(journal, self._kept.heard)
            left = journal.pending(self._kept.heard)
            for record in left:
                self._kept = _after(self._kept, record)
                self._before |= {record.ticket}
            self.unknown += [r.capability for r in left if r.decision == Outcome.UNKNOWN]
        # a power cut may set the clock of uses back: what seems still to come was just now
        now_ms = ledger.mono_ms()
        past = {c: tuple(min(at, now_ms) for at in used) for c, used in self._kept.uses.items()}
        self._kept = replace(self._kept, uses=past)

    @property
    def stopped(self) -> bool:
        """True while an operator's stop stands; as the store last said while it says nothing."""
        settled = self._settle()
        held = quietly(lambda: self._ledger.peek(stop_stands))
        if held is not None:
            self._stopped = held
        return self._stopped or not settled

    def uses(self, caller: Caller, capability: str) -> tuple[int, ...]:
        """Return when a caller used a capability."""
        used = self._kept.uses
        return (*used.get(capability, ()), *used.get(f"{caller} {capability}", ()))

    def tries(self, caller: Caller, capability: str) -> tuple[int, ...]:
        """Return when a caller's use was not started, and so was given back."""
        return self._kept.uses.get(f"{caller} {capability} {Outcome.NOT_STARTED}", ())

    def adopt(self, opened: OpenedPolicy) -> None:
        """Record which policy counts from now on, when it is another one.

        Raises:
            StoreError: it was not recorded.
        """
        if self._kept.policy == opened.digest:
            return
        after = replace(self._kept, policy=opened.digest)
        policy = opened.policy
        told = {"policy": opened.digest, "version": policy.version, "signer": opened.signer}

        def entry(at: int) -> Entry:
            return Entry(
                kind=EMERGENCY,
                time_ms=at,
                decision="policy",
                open={**told, "id": policy.id},
                sealed={"policy": policy},
            )

        self._note(entry, after)

    def write(self, step: EmergencyStep, *, journal: bool) -> None:
        """Put a step on disk before this returns.

        Args:
            step: what happened.
            journal: the journal will do when the log cannot be written.

        Raises:
            StoreError: the log cannot be written, and nothing else will do.
            EnvironmentFault: nor can the journal.
        """
        if step.decision == Outcome.UNKNOWN:
            self.unknown.append(step.capability)
        known = self._journaled(step, 0 if self._journal is None else self._journal.next_n)
        try:
            self._replay()  # what happened before comes first
            self._note(lambda at: _entry(step, at), _after(self._kept, known))
        except StoreError:
            if not journal or self._journal is None:
                raise
            self._journal.append(known, heard=self._kept.heard)
            self._kept = _after(self._kept, known)

    def flush(self) -> None:
        """Bring into the log what waits for it; what cannot be written goes on waiting."""
        self._settle()
        quietly(self._replay)

    def close(self) -> None:
        """Let go of the journal."""
        if self._journal is not None:
            self._journal.close()

    def _replay(self) -> None:
        """Write what the journal has and the log has not, each record once.

        Raises:
            StoreError: the rest goes on waiting.
        """
        journal = self._journal
        if journal is not None:
            for record in journal.pending(self._kept.heard):
                self._note(_told(record), replace(self._kept, heard=record.n))
            lost = journal.lost - self._kept.lost
            if lost > 0:
                self._note(_lost(lost), replace(self._kept, lost=journal.lost))
        for ticket in sorted(self._before & set(self._kept.open)):
            left = {t: c for t, c in self._kept.open.items() if t != ticket}
            capability = self._kept.open[ticket]
            told = _left_open(ticket, capability)
            self._note(told, replace(self._kept, open=left))
            self.unknown.append(capability)
        self._before = frozenset()

    def _note(self, entry: Callable[[int], Entry], after: EmergencyStanding) -> None:
        held: Held = (_KIND, _KEY, encode_fast(after))
        self._ledger.note(entry, essential=True, held=held)
        self._kept = after

    def _journaled(self, step: EmergencyStep, n: int) -> Journaled:
        """Return a step as the journal has it: codes and names, nothing that may be sensitive."""
        return Journaled(
            n=max(n, 1),
            robot=self._ledger.robot,
            decision=Identifier(step.decision),
            at_ms=max(step.at.utc_ms, 0),
            mono_ms=max(step.at.mono_ms, 0),
            policy=step.opened.digest,
            capability=step.capability,
            caller=Identifier(step.caller),
            by=step.by,
            ticket=step.ticket,
            state=NONE if step.state is None else step.state.digest,
            reasons=_reasons(step.findings),
            lacked=tuple(sorted(step.lacked)),
        )


def _strange(journal: EmergencyJournal, heard: int) -> dict[str, int]:
    entries, size = journal.strange(heard), journal.odd_size
    if size is not None:
        return {"entries": entries, "size": size}
    return {"entries": entries} if entries else {}


def _after(kept: EmergencyStanding, step: Journaled) -> EmergencyStanding:
    """Return what is held after a step; uses older than an hour are forgotten."""
    since_ms, mine = step.mono_ms - HOUR_MS, f"{step.caller} {step.capability}"
    uses = {key: tuple([at for at in used if at > since_ms]) for key, used in kept.uses.items()}
    left = {t: c for t, c in kept.open.items() if t != step.ticket}
    if step.decision == ACCEPT:
        uses[mine] = (*uses.get(mine, ()), step.mono_ms)
        left[step.ticket] = step.capability
    elif step.decision == Outcome.NOT_STARTED and step.ticket in kept.open and uses.get(mine):
        *uses_left, given = uses[mine]  # one at a time: the newest use is this one
        tried = f"{mine} {Outcome.NOT_STARTED}"
        uses |= {mine: tuple(uses_left), tried: (*uses.get(tried, ()), given)}
    recent = {key: used[-MOST_PER_HOUR:] for key, used in uses.items() if used}
    return replace(kept, uses=recent, open=left)


def _entry(step: EmergencyStep, at: int) -> Entry:
    policy = step.opened.policy
    asked = step.safety
    hazards = [] if asked is None else [finding.hazard for finding in asked.findings]
    safety: Any = NOT_EVALUATED if asked is None else {"safe": asked.safe, "hazards": hazards}
    stood = {} if step.stood_ms is None else {"stood_ms": step.stood_ms}
    return Entry(
        kind=EMERGENCY,
        time_ms=at,
        decision=step.decision,
        action=NONE if step.action is None else digest_of(Tag.ACTION, step.action),
        state=NONE if step.state is None else step.state.digest,
        open={
            "policy": step.opened.digest,
            "version": policy.version,
            "capability": step.capability,
            "caller": step.caller,
            "by": step.by,
            "ticket": step.ticket,
            "reasons": list(_reasons(step.findings)),
            "lacked": sorted(step.lacked),
            "safety": safety,
            **stood,
        },
        sealed={
            "action": [] if step.action is None else [step.action],
            "findings": step.findings,
            "state": [] if step.state is None else [msgspec.Raw(step.state.data)],
        },
    )


def _told(record: Journaled) -> Callable[[int], Entry]:
    """Return what makes a journaled step's record; its time is when it was replayed."""
    opened = msgspec.to_builtins(record)
    state = opened.pop("state")
    decision = opened.pop("decision")
    opened["journal"] = opened.pop("n")
    del opened["robot"]
    return lambda at: Entry(kind=EMERGENCY, time_ms=at, decision=decision, state=state, open=opened)


def _lost(count: int) -> Callable[[int], Entry]:
    return lambda at: Entry(kind=EMERGENCY, time_ms=at, decision="counted", open={"lost": count})


def _left_open(ticket: str, capability: str) -> Callable[[int], Entry]:
    """Return what makes the record of an emergency whose gate ended before it did."""
    opened = {"capability": capability, "ticket": ticket, "reasons": [], "recovered": True}
    return lambda at: Entry(kind=EMERGENCY, time_ms=at, decision=Outcome.UNKNOWN, open=opened)


def refused_call(
    error: AuthGuardError,
    *,
    by: Identifier,
    reasons: list[Any],
    hazards: list[Any],
    sealed: dict[str, Any],
) -> Callable[[int], Entry]:
    """Return what makes the record of a refused call.

    Args:
        error: the first thing that was wrong with it.
        by: who called, named by the channel.
        reasons: all reasons, primary first.
        hazards: the second gate's.
        sealed: what the caller said, and every finding.
    """
    safety = {"safe": False, "hazards": hazards} if hazards else NOT_EVALUATED
    return lambda at: Entry(
        kind="refusal",
        time_ms=at,
        decision=Verdict.REJECT,
        open={"reasons": reasons, "safety": safety, "client": by, "what": EMERGENCY},
        sealed={"where": error.where, "message": error.message, **sealed},
    )


def _reasons(findings: Findings) -> tuple[str, ...]:
    return tuple(dict.fromkeys(str(finding.reason) for finding in findings))
