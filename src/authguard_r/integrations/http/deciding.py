# SPDX-License-Identifier: Apache-2.0
"""Questions of the Authorization API as the gate is asked them, and its answers as it gives them.

Nothing is decided here: a permit is what the gate says that it would do, and everything that did
not come to an answer of the gate is no permit. What a request says of who asks, of labels, of time
or state is not read. Spec page: docs/spec/http.md#evaluation
"""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
from msgspec import UNSET
from msgspec.structs import replace

from authguard_r.core.errors import AuthGuardError, RefusedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason, may_pass_later
from authguard_r.integrations.http.gate_connection import AwayError, GateLink, busy
from authguard_r.integrations.http.messages import (
    Carried,
    Decided,
    DecidedAll,
    Evaluation,
    Evaluations,
    MissionName,
    ProposalMessage,
    Said,
    Trouble,
)
from authguard_r.integrations.http.reading import call_of, plan_of, questions_of, single_of
from authguard_r.wire.disclosure import Disclosure, disclosed
from authguard_r.wire.fault_finding import fault_finding

#: How a planner's framework calls its tools: the dialect of `plan_of`.
_DIALECT = "json"
#: What ends a batch: the decision after which nothing more is asked.
_ENDS = {"execute_all": None, "deny_on_first_deny": False, "permit_on_first_permit": True}
#: The parts of a decision that have fields of their own.
_OWN = frozenset(
    {"outcome", "reasons", "retryable", "required_approvals", "mission", "action_digest"}
    | {"findings", "authoritative", "released", "executed", "execution", "seq"}
)


class Decider:
    """Asks the gate.

    Args:
        robot: whose gate it is.
        operator: the gate as what-ifs are asked; None in shadow mode.
        planner: the gate as proposals are made; None where nothing is proposed.
        disclosure: how much of a what-if is shown; the gate decides that for a proposal.
    """

    def __init__(
        self,
        robot: RobotId,
        *,
        operator: GateLink | None,
        planner: GateLink | None,
        disclosure: Disclosure,
    ) -> None:
        self._robot = robot
        self._operator, self._planner = operator, planner
        self._disclosure = disclosure
        self._turn = asyncio.Lock()  # a gate takes one proposal of a client at a time

    async def evaluation(self, asked: Evaluation) -> Decided:
        """Return the answer to one question.

        Raises:
            AwayError: the gate gave none.
        """
        if (asked.resource.type, asked.resource.id) != ("robot", self._robot):
            return Decided(decision=False, context=self._refused(Reason.ROBOT_MISMATCH))
        plan = call_of(asked.action)
        return await (self._noted(plan) if self._operator is None else self._judged(plan))

    async def evaluations(self, asked: Evaluations) -> Decided | DecidedAll:
        """Return the answers to several questions, each by itself, or to the one that there is.

        Raises:
            MalformedError: a question is incomplete; none was asked.
            AwayError: the one question has no answer of the gate.
        """
        if not asked.evaluations:
            return await self.evaluation(single_of(asked))
        last = _ENDS[asked.options.evaluations_semantic]
        found: list[Decided] = []
        for question in questions_of(asked):
            try:
                found.append(await self.evaluation(question))
            except AwayError as error:
                found.append(Decided(decision=False, context=self._unanswered(error.fault)))
            if found[-1].decision is last:
                break
        return DecidedAll(evaluations=tuple(found))

    async def proposal(self, asked: ProposalMessage, key: str) -> Carried:
        """Have a call decided and carried out; return its report.

        Args:
            asked: the call.
            key: names it: the same again is answered with what is recorded.

        Raises:
            AwayError: the outcome is unknown; the same key asks again.
            RefusedError: nothing was decided under this key.
        """
        if self._turn.locked():
            # not kept waiting: the call would run even though its caller gave up by then
            raise AwayError(busy("another proposal is being carried out"))
        async with self._turn:
            plan = plan_of(asked.tool, asked.arguments)
            told = await self._proposed(plan, key, refusal=RefusedError)
        (step, *_) = told["steps"]
        released = bool(step["released"])
        said = self._said(step, safe=None)
        return Carried(
            decision=released,
            context=replace(said, authoritative=True, consumes=released),
            executed=bool(step["executed"]),
            execution=step["execution"],
            seq=step["seq"],
            repeated=bool(told["repeated"]),
        )

    async def _proposed(
        self, plan: bytes, key: str | None, *, refusal: type[AuthGuardError] | None = None
    ) -> dict[str, Any]:
        planner = self._planner
        if planner is None:  # pragma: no cover - no such endpoint is served then
            raise RuntimeError("nothing is proposed here")
        return await planner.ask(
            lambda gate: gate.propose(plan, key=key, dialect=_DIALECT), refusal=refusal
        )

    async def _judged(self, plan: bytes) -> Decided:
        operator = self._operator
        if operator is None:  # pragma: no cover - asked by the caller
            raise RuntimeError("nothing is judged here")
        try:
            told = await operator.ask(
                lambda gate: gate.evaluate(plan, dialect=_DIALECT), refusal=AuthGuardError
            )
        except AuthGuardError as error:  # the call means nothing here, or there is no mission
            return Decided(decision=False, context=self._refused(error.reason, error))
        return self._all_of(told["steps"])

    async def _noted(self, plan: bytes) -> Decided:
        """Let a gate in shadow mode note what it would have done, and say to go on."""
        async with self._turn:
            told = await self._proposed(plan, None)  # not noted: nothing goes past it
        (step, *_) = told["steps"]
        said = self._said(step, safe=None)
        return Decided(
            decision=True, context=replace(said, shadow=True, would=bool(step["released"]))
        )

    def _all_of(self, steps: list[dict[str, Any]]) -> Decided:
        """Return one answer for a call: the first refusal of its steps, else the first step."""
        first = next((step for step in steps if not _lets(step)), steps[0])
        step = disclosed(first, self._disclosure)
        named = {name: first[name] for name in ("mission", "action_digest")}
        said = self._said({**step, **named}, safe=_safe(first))
        return Decided(decision=all(map(_lets, steps)), context=said)

    def _said(self, step: dict[str, Any], *, safe: bool | None) -> Said:
        more = {name: said for name, said in step.items() if name not in _OWN and said is not None}
        named = step.get("mission")
        return Said(
            authoritative=False,
            consumes=False,
            holds_ms=0,
            robot=self._robot,
            outcome=step["outcome"],
            reasons=tuple(step["reasons"]),
            safe=safe,
            retryable=step.get("retryable"),
            required_approvals=step.get("required_approvals"),
            mission=None if named is None else msgspec.convert(named, MissionName),
            action_digest=step.get("action_digest"),
            findings=tuple(step["findings"]) if "findings" in step else UNSET,
            detail=more or UNSET,
        )

    def _refused(self, reason: Reason, error: AuthGuardError | None = None) -> Said:
        """Return what is said where the gate decided nothing."""
        told: dict[str, Any] = {
            "outcome": "reject",
            "reasons": [str(reason)],
            "retryable": may_pass_later((reason,)),
        }
        if error is not None:
            told["findings"] = [fault_finding(str(reason), error.where, error.message)]
        return self._said(disclosed(told, self._disclosure), safe=None)

    def _unanswered(self, fault: AuthGuardError) -> Said:
        trouble = Trouble(status=503, code=str(fault.reason), message=fault.message)
        return replace(self._refused(fault.reason), retryable=True, error=trouble)


def _lets(step: dict[str, Any]) -> bool:
    """True for what both gates would release."""
    return step["outcome"] == "accept" and _safe(step) is True


def _safe(step: dict[str, Any]) -> bool | None:
    """Return the safety gate's verdict, None when it was not asked."""
    safety = step["safety"]
    return bool(safety["safe"]) if isinstance(safety, dict) else None
