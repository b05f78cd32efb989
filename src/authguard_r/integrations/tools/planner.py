# SPDX-License-Identifier: Apache-2.0
"""The planner's end: proposes one call after the other, and returns the result of each.

It decides nothing and carries nothing out; its connection is made anew when it was lost.
Spec page: docs/spec/adapters.md#ends
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, TypeVar

from msgspec import Struct

from authguard_r.client import AsyncGateClient
from authguard_r.client.reconnecting import GatePlace, ReconnectingClient
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import UNTOLD
from authguard_r.wire.messages import ClientRole

T = TypeVar("T")

#: Characters that are noted at a time.
MAX_NOTED = 30_000
#: Hazards that may be over at the next try.
_OF_THE_MOMENT = frozenset({"HUMAN_PROXIMITY", "STATE_UNKNOWN", "NOT_EXECUTABLE"})
#: What a planner sees of a step beside its outcome, where the gate discloses it.
SHOWN = ("outcome", "reasons", "findings", "retryable", "required_approvals", "seq")


class CallOutcome(Struct, frozen=True, kw_only=True):
    """The result of one call, as the gate reports it.

    Args:
        step: the report of the one step.
        brought: what came before it: the decision, and the tool's result.
        repeated: the same proposal was made before; its result is not sent twice.
    """

    step: dict[str, Any]
    brought: tuple[dict[str, Any], ...] = ()
    repeated: bool = False

    @property
    def execution(self) -> str | None:
        """How the released action ended; None when nothing was released."""
        outcome: str | None = self.step["execution"]["outcome"]
        return outcome

    @property
    def verdict(self) -> dict[str, Any]:
        """What a planner may know of the decision."""
        told = {name: self.step[name] for name in SHOWN if name in self.step}
        return {**told, "safety": self.step["safety"]} if self._hazards else told

    @property
    def _hazards(self) -> tuple[str, ...]:
        """Why the safety gate does not agree; empty: it does, or was not asked."""
        safety = self.step.get("safety")
        if not isinstance(safety, dict) or safety["safe"]:
            return ()
        found = safety.get("findings", ())  # at full disclosure
        return tuple(safety.get("hazards", ())) or tuple(str(one["hazard"]) for one in found)

    @property
    def refusal(self) -> str:
        """What a model reads of a refusal: the reasons, the disclosed places, and what next."""
        unread = self.step.get("refusal")  # why nothing was decided: of the call's own text
        told = [{"field": unread["where"], "expected": unread["message"]}] if unread else ()
        places = [_place_text(finding) for finding in told or self.step.get("findings") or ()]
        said, later = "refused: " + ", ".join(self.step["reasons"]), self.step.get("retryable")
        if self._hazards and not self.step["reasons"]:
            said = "refused by the safety gate: " + ", ".join(self._hazards)
            places = [_place_text(one) for one in self.step["safety"].get("findings", ())]
            later = _OF_THE_MOMENT.issuperset(self._hazards)
        same = "may" if later else "will not"
        return "\n".join([said, *dict.fromkeys(places), f"the same call {same} pass later"])

    @property
    def results(self) -> tuple[str, ...]:
        """What the tool brought to light, as the gate passed it on; empty: nothing."""
        return tuple(item["result"] for item in self.brought if "result" in item)

    def result(self) -> bytes:
        """Return what the tool brought to light last.

        Raises:
            MalformedError: that cannot be read.
        """
        try:
            return base64.b64decode(self.results[-1], validate=True)
        except (ValueError, binascii.Error) as error:
            raise MalformedError("expected base64", where="result") from error

    @property
    def ticket(self) -> str | None:
        """The release's ticket, where the gate sent it."""
        return next((item["ticket"] for item in reversed(self.brought) if "ticket" in item), None)


def _place_text(finding: dict[str, Any]) -> str:
    """Return a finding as a line: the field as the model wrote it, and what was expected."""
    field = str(finding["field"]).removeprefix("plan[0]").removeprefix(".") or "the call"
    said = [text for text in (finding.get("expected"), finding.get("got")) if text]
    return f"{field}: {', got '.join(map(str, said)) or finding['reason']}"


class LostError(Exception):
    """The connection was lost while the gate was asked: the outcome of the call is unknown.

    Args:
        error: how it went.
    """

    def __init__(self, error: AuthGuardError) -> None:
        super().__init__(str(error))
        self.error = error


class PlannerTurn:
    """Who may ask the gate now: one after the other, each after the last answer is there.

    A caller may give up. What it asked goes on, and the gate takes one proposal of a client.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()  # first come, first served
        self._going: asyncio.Future[Any] | None = None

    def locked(self) -> bool:
        """True while a caller has the turn, or its request goes on."""
        return self._lock.locked() or self._going is not None

    async def __aenter__(self) -> None:
        await self._lock.acquire()
        try:
            if self._going is not None:
                await asyncio.wait((self._going,))
        except BaseException:
            self._lock.release()
            raise

    async def __aexit__(self, *_: object) -> None:
        self._lock.release()

    async def kept(self, work: Coroutine[Any, Any, T]) -> T:
        """Return the work's result; it goes on, and keeps the turn, when its caller gives up."""
        going = self._going = asyncio.ensure_future(work)
        going.add_done_callback(self._done)
        return await asyncio.shield(going)

    def _done(self, going: asyncio.Future[Any]) -> None:
        self._going = None
        if not going.cancelled():
            going.exception()  # without a waiting caller the error is not needed


class ToolPlanner:
    """Proposes calls to a gate.

    Args:
        place: which gate.
    """

    def __init__(self, place: GatePlace) -> None:
        self.turn = PlannerTurn()
        self._kept = ReconnectingClient(place, ClientRole.PLANNER)
        self._is_over = False

    async def propose(
        self,
        tool: str,
        arguments: dict[str, Any],
        *,
        key: str | None = None,
        told: Callable[[dict[str, Any]], None] | None = None,
    ) -> CallOutcome:
        """Propose a call; the caller holds the `turn`.

        Args:
            tool: its name, as the planner wrote it; untrusted.
            arguments: as it wrote them; untrusted.
            key: names the proposal, so that asking again is the same one.
            told: called with each event of the gate before the answer.

        Raises:
            MalformedError: they are no JSON.
            AuthGuardError: nothing was decided.
            LostError: the gate went after it was asked.
        """
        plan = {"plan": [{"tool": tool, "arguments": arguments}]}
        try:
            data = json.dumps(plan, ensure_ascii=False, allow_nan=False).encode()
        except (ValueError, TypeError, RecursionError) as error:
            raise MalformedError("not JSON", where="arguments") from error
        brought: list[dict[str, Any]] = []

        def hear(item: dict[str, Any]) -> None:
            brought.append(item)
            if told is not None:
                told(item)

        answer = await self.plan(data, key=key, dialect="json", told=hear)
        (step, *_) = answer["steps"]
        return CallOutcome(step=step, brought=tuple(brought), repeated=answer["repeated"])

    async def plan(
        self,
        data: bytes,
        *,
        dialect: str = "auto",
        key: str | None = None,
        told: Callable[[dict[str, Any]], None] | None = None,
    ) -> dict[str, Any]:
        """Propose a plan as it was written; return the gate's answer. The `turn` is held.

        Args:
            data: what the planner wrote, byte for byte; untrusted.
            dialect: how it is written; `auto` leaves that to the gate.
            key: names the proposal, so that asking again is the same one.
            told: called with each event of the gate before the answer.

        Raises:
            AuthGuardError: nothing was decided.
            LostError: the gate went after it was asked.
        """
        gate = await self.connected()
        try:
            return await self.turn.kept(gate.propose(data, key=key, dialect=dialect, on_step=told))
        except AuthGuardError as error:
            if not gate.is_open:
                raise LostError(error) from error
            raise

    async def unreadable(self, tool: str, text: str) -> None:
        """Hand in a text that is no call: the gate refuses it, and logs that.

        Args:
            tool: whose call it was to be; untrusted.
            text: as it was written, of which the log has the beginning; untrusted.

        Raises:
            AuthGuardError: the gate did not answer.
        """
        said = f"unreadable arguments of {tool}: {text}"[:MAX_NOTED]  # never JSON: it begins so
        async with self.turn:
            gate = await self.connected()
            said_bytes = said.encode(errors="backslashreplace")
            await self.turn.kept(gate.propose(said_bytes, dialect="json"))

    async def note(self, texts: Iterable[str], channel: str = UNTOLD) -> None:
        """Tell the gate what the planner is about to see.

        Args:
            texts: untrusted.
            channel: how they arrive; the least trusted of all by default.

        Raises:
            AuthGuardError: it did not take note.
        """
        gate = await self.connected()
        for text in texts:
            for at in range(0, max(len(text), 1), MAX_NOTED):
                await gate.observe(channel, text[at : at + MAX_NOTED])

    async def connected(self) -> AsyncGateClient:
        """Return the gate as a planner reaches it, connected anew where it was lost.

        Raises:
            AuthGuardError: it is not there, or not the one that it has to be.
        """
        if self._is_over:
            raise EnvironmentFault("this end was closed", reason=Reason.CONTROLLER_FAILED)
        return await self._kept.connected()

    async def close(self) -> None:
        """Let go of the gate for good: who still waits for a turn asks nothing."""
        self._is_over = True
        await self._kept.close()
