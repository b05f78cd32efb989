# SPDX-License-Identifier: Apache-2.0
"""Open approval requests, sent to those who may answer, and their results.

What was asked is read from the decision's record, so that the bytes are those that were hashed; a
value that was destroyed since is shown as absent, and it cannot be approved any more. Spec page:
docs/spec/gate-protocol.md#approvals
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from authguard_r.approvals import approver_json
from authguard_r.approvals.requests import (
    OpenRequest,
    RecordedQuestion,
    behind,
    find_asked,
    is_denied,
    read_told,
    why_not,
)
from authguard_r.core.action import Action, scope_of
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.checks.approval import Situation, assess_need
from authguard_r.core.checks.case import Case
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.encoding import Tag, digest, encode_fast
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.mission import Grant
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.risk import Tier
from authguard_r.core.standing import ApprovalRequest, Standing
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import Report
from authguard_r.server.wiring import Gate
from authguard_r.store.transactions import Transaction
from authguard_r.wire.approval_request import ApprovalAnswer, Question, Questions, Truth

#: Sends an event to every client that watches.
Publish = Callable[[dict[str, Any]], None]


class OpenQuestions:
    """The open requests of one gate.

    Args:
        gate: ledger, intake and facts.
        publish: sends an event to every client that watches.
    """

    def __init__(self, gate: Gate, publish: Publish) -> None:
        self._gate = gate
        self._publish = publish
        self._open: dict[tuple[MissionId, int], int] | None = None

    def told(self, counter: int | None) -> Questions:
        """Return every open request of the active mission, or the one with this number.

        Raises:
            RefusedError: no open request has this number.
            AuthGuardError: the mission cannot be read, or the clock is behind.
        """

        def job(act: Transaction) -> Questions:
            mid = act.active()
            standing = None if mid is None else act.standing(mid)
            found = () if standing is None else self._all(act, standing, counter)
            robot, now_ms = self._gate.facts.robot.rid, act.now.utc_ms
            return Questions(robot=robot, now_ms=now_ms, requests=tuple(found))

        self._gate.enforcer.inputs.refresh()  # whether a request is current, newest state says
        said = self._gate.ledger.run(job)
        if counter is not None and not said.requests:
            known = ", ".join(str(one.counter) for one in self.told(None).requests) or "none"
            raise RefusedError(
                f"no open request has the number {counter}; open: {known}",
                reason=Reason.VALUE_OUT_OF_RANGE,
                where="counter",
            )
        return said

    def answered(self, item: VerifiedApproval) -> dict[str, Any]:
        """Return what an answer is worth, and tell those who watch; no `why_not`: it counts.

        Args:
            item: an answer that was just taken in.
        """
        said = item.approval

        def job(act: Transaction) -> str:
            gate = self._gate
            asked = find_asked(
                act,
                said,
                mission=gate.enforcer.inputs.mission,
                facts=gate.facts,
                opened=gate.ledger.opened,
            )
            return why_not(asked, item, act.now)

        worth = self._gate.ledger.run(job)
        self._publish(
            {
                "event": "approval",
                "what": "denied" if said.verdict == "deny" else "answered",
                "mid": said.mid,
                "counter": said.counter,
                **approver_json(item.approver),
                "why_not": worth,
            }
        )
        return {
            "counter": said.counter,
            "approver": item.approver.id,
            "verdict": str(said.verdict),
            "why_not": worth,
        }

    def decided(self, report: Report) -> None:
        """Tell those who watch what a decision made of a request: asked, or used."""
        judged = report.judged
        match = None if judged is None else judged.decision.match
        if judged is None or match is None or judged.standing is None:
            return
        mid, before = judged.verified.mission.mid, judged.standing.requests
        old = before.get(match.indexed.grant.id)
        need = judged.decision.need
        if judged.request is not None:
            opened = judged.request
            more = {"required": opened.required, "expires_ms": opened.expires_ms}
            more |= {"risk": 0 if need is None else need.risk, "seq": report.seq or 0}
            more |= {} if old is None else {"replaces": old.counter}
            self._event("asked", mid, opened.counter, more)
            self._known()[mid, opened.counter] = opened.expires_ms
            if old is not None:
                self._known().pop((mid, old.counter), None)
        elif judged.released and old is not None and need is not None and need.required > 1:
            self._event("used", mid, old.counter, {"seq": report.seq or 0})
            self._known().pop((mid, old.counter), None)

    def listen(self) -> None:
        """Tell those who watch of each request that ran out, once."""
        now = quietly(self._gate.ledger.now)
        if now is None:
            return
        over = [key for key, until_ms in self._known().items() if now.utc_ms > until_ms]
        for mid, counter in over:
            del self._known()[mid, counter]
            held = self._gate.ledger.standing(mid)
            if held is not None and any(
                r.counter == counter and not r.denied for r in held.requests.values()
            ):
                self._event("expired", mid, counter, {})

    def _event(self, what: str, mid: MissionId, counter: int, more: dict[str, Any]) -> None:
        told = {"event": "approval", "what": what, "mid": mid, "counter": counter}
        self._publish(told | more)

    def _known(self) -> dict[tuple[MissionId, int], int]:
        """Return when each open request runs out; those of a gate before this one are read once."""
        if self._open is None:
            self._open = quietly(lambda: self._gate.ledger.run(_left_open)) or {}
        return self._open

    def _all(self, act: Transaction, standing: Standing, counter: int | None) -> Iterable[Question]:
        verified = self._gate.enforcer.inputs.mission(act, standing.digest)
        grants = {grant.id: grant for grant in verified.mission.actions}
        for name, request in standing.requests.items():
            if counter in {None, request.counter}:
                yield self._question(act, verified, standing, grants[name], request)

    def _put(
        self, verified: VerifiedMission, standing: Standing, grant: Grant, action: Action
    ) -> OpenRequest:
        return OpenRequest(
            verified=verified,
            grant=grant,
            request=standing.requests[grant.id],
            action=action,
            standing=standing,
            facts=self._gate.facts,
        )

    def _question(
        self,
        act: Transaction,
        verified: VerifiedMission,
        standing: Standing,
        grant: Grant,
        request: ApprovalRequest,
    ) -> Question:
        told = read_told(act, verified.mission.mid, request.counter, self._gate.ledger.opened)
        action = told.value("action", Action)
        asked = None if action is None else self._put(verified, standing, grant, action)
        held = self._gate.enforcer.inputs.answers(act, standing).approvals
        answers = tuple(item for item in held if item.approval.counter == request.counter)
        guards = (*verified.mission.guards, *grant.guards)
        truth = self._truth(told, verified, grant)
        return Question(
            counter=request.counter,
            mid=verified.mission.mid,
            version=verified.mission.version,
            mission=verified.digest,
            rid=verified.mission.rid,
            issuer=verified.mission.issuer,
            task=verified.mission.task,
            grant=grant.id,
            planner="" if action is None or action.meta is None else action.meta.planner,
            asked_ms=told.record.link.time_ms,
            expires_ms=request.expires_ms,
            left_ms=request.expires_ms - act.now.utc_ms,
            scope=request.scope,
            situation=request.situation,
            scope_bytes=None if action is None else encode_fast(scope_of(action)),
            situation_bytes=_situation(truth, request),
            guards=tuple(Truth(guard=g, held=held) for g, held in zip(guards, truth, strict=True)),
            risk=told.record.open["risk"],
            required=request.required,
            behind=1 if asked is None else behind(asked, answers, act.now),
            denied=request.denied or (asked is not None and is_denied(asked, answers, act.now)),
            roles=() if asked is None else asked.roles,
            places=() if action is None else action.places,
            answers=tuple(_answered(asked, item, act.now) for item in answers),
            is_current=asked is not None and self._is_current(asked, act.now),
            influenced_by=tuple(told.value("influences", list[dict[str, Any]]) or ()),
            seq=told.record.link.seq,
        )

    def _truth(
        self, told: RecordedQuestion, verified: VerifiedMission, grant: Grant
    ) -> tuple[bool, ...]:
        """Return which conditions held when people were asked, from the state of that instant."""
        now = told.value("now", Now) or Now(told.record.link.time_ms, 0)
        kept = told.value("state", tuple[dict[str, Any], ...]) or ()
        state = None
        if kept:
            snapshot = msgspec.convert(kept[0]["snapshot"], Snapshot)
            arrived = kept[0]["arrived_mono_ms"]
            state = attest(snapshot, self._gate.facts, arrived_mono_ms=arrived)
            state = msgspec.structs.replace(state, fence=kept[0].get("fence", 0))
        guards = (*verified.mission.guards, *grant.guards)
        return tuple(guard_finding(g, state, verified.mission.rid, now) is None for g in guards)

    def _is_current(self, asked: OpenRequest, now: Now) -> bool:
        """True when the same proposal would meet this request now, and open no other."""
        state: AttestedState | None = self._gate.enforcer.inputs.state
        case = Case(
            verified=asked.verified,
            action=asked.action,
            kind=asked.facts.vocabulary.get(asked.action.type),
            state=state,
            facts=asked.facts,
            now=now,
            standing=asked.standing,
            approvals=(),
        )
        need = assess_need(case, asked.grant)
        return (need.scope, need.situation) == (asked.request.scope, asked.request.situation)


def _left_open(act: Transaction) -> dict[tuple[MissionId, int], int]:
    mid = act.active()
    standing = None if mid is None else act.standing(mid)
    if mid is None or standing is None:
        return {}
    return {(mid, r.counter): r.expires_ms for r in standing.requests.values()}


def _situation(truth: tuple[bool, ...], request: ApprovalRequest) -> bytes | None:
    """Return the bytes of a request's situation: those of the one tier that has its digest."""
    spelled = (encode_fast(Situation(guards=truth, tier=int(tier))) for tier in Tier)
    found = (data for data in spelled if digest(Tag.SITUATION, data) == request.situation)
    return next(found, None)


def _answered(asked: OpenRequest | None, item: VerifiedApproval, now: Now) -> ApprovalAnswer:
    approver = item.approver
    return ApprovalAnswer(
        approver=approver.id,
        role=approver.role,
        kind=approver_json(approver)["kind"],
        threshold=approver.threshold,
        members=tuple(sorted(approver.members)),
        verdict=item.approval.verdict,
        why_not=why_not(asked, item, now),
    )
