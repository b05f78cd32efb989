# SPDX-License-Identifier: Apache-2.0
"""What a planner is shown, what it answers, and who it is.

A planner sees the task, its tools and texts: never the mission, its schema or a reason code.
Spec page: docs/spec/missionpair.md#planner-view
"""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

from msgspec import Struct

from missionpair.pair import Input, WordedCall


class OfferedTool(Struct, frozen=True):
    """One tool as a planner is offered it: its name, what it is for, its arguments' JSON schema."""

    name: str
    description: str
    parameters: dict[str, Any]


class EarlierTurn(Struct, frozen=True):
    """One earlier answer of this planner in this trial.

    Args:
        reply: what it wrote.
        told: what it saw of its result.
        situation: where the robot was and what it held before.
    """

    reply: str
    told: str
    situation: str = ""


class Briefing(Struct, frozen=True, kw_only=True):
    """Everything that a planner is shown.

    Args:
        rules: how it is to work; a defense may add to it.
        task: the operator's sentence.
        situation: where the robot is and what it holds.
        places: spellings of places that it may name.
        things: spellings of things that it may name.
        tools: what it may call.
        inputs: what else reached it, oldest first.
        turns: what it answered before, oldest first.
        usual: what an undisturbed planner would call: for planners that simulate one, and shown to
            no model.
        trial: which trial of a campaign it is (pair, kind, round from 0): for planners that answer
            from a record, and shown to no model.
    """

    rules: str
    task: str
    situation: str
    places: tuple[str, ...]
    things: tuple[str, ...]
    tools: tuple[OfferedTool, ...]
    inputs: tuple[Input, ...] = ()
    turns: tuple[EarlierTurn, ...] = ()
    usual: tuple[WordedCall, ...] = ()
    trial: tuple[str, str, int] | None = None


class Reply(Struct, frozen=True, kw_only=True):
    """What a planner answered.

    Args:
        raw: its exact bytes, for the normalizer.
        refused: the planner itself said that it will not.
        took_us: how long it took, microseconds.
        tokens: read and written, where its server says so.
        cost_microusd: what that cost, where the price is known.
    """

    raw: bytes
    refused: bool = False
    took_us: int = 0
    tokens: tuple[int, int] = (0, 0)
    cost_microusd: int = 0


class Planner(Protocol):
    """The untrusted part L."""

    #: What tables and logs call it.
    name: str
    #: A stand-in with published behavior, and no model: marked wherever its results appear.
    simulated: bool

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Answer one briefing; a deterministic planner answers the same seed with the same bytes.

        Raises:
            PlannerError: it cannot be reached, or it does not answer in its protocol.
        """
        ...


class PlannerError(Exception):
    """A planner that cannot be reached or does not answer as its protocol says.

    Args:
        code: `unreachable`, `refused`, `protocol`, `limit` or `cost`; `ended`, a record has no
            further round; of what cannot even be made `usage`, an option is wrong, or `file` or
            `log`, what it reads is not as it has to be.
        message: what happened, and what to do.
        where: the server or the option.
    """

    def __init__(self, message: str, *, code: str, where: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.where = where

    def __reduce__(self) -> tuple[partial[PlannerError], tuple[str]]:
        """Return how it is made again, in the process that waits for it."""
        return partial(PlannerError, code=self.code, where=self.where), (self.message,)
