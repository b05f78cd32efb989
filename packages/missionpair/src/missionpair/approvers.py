# SPDX-License-Identifier: Apache-2.0
"""People who answer by a script, so that waiting for them is separate from machine time.

Each answer waits a drawn time, with a stated distribution and seed, and then does what a console
does: read the request, check its bytes, sign, hand in. What it waited and what it worked is
reported apart. A tool for measuring: its user holds the approvers' keys.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from enum import StrEnum
from heapq import heappop, heappush
from random import Random

from msgspec import Struct

from authguard_r.client import GateClient
from authguard_r.client.approvals import shown
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import RefusedError
from authguard_r.keys.signer import FileSigner
from authguard_r.wire.approval_request import Question

_SPELLED = re.compile(r"(fixed|exponential|lognormal):([0-9.]+)s(?:,([0-9.]+))?")
#: How often the script looks for requests, in seconds.
LOOK_S = 0.05


class DelayKind(StrEnum):
    """The distributions of a delay."""

    FIXED = "fixed"
    EXPONENTIAL = "exponential"
    LOGNORMAL = "lognormal"


class Delay(Struct, frozen=True, kw_only=True):
    """How long a person takes.

    Args:
        kind: the distribution.
        median_s: fixed: the value; exponential: the mean; lognormal: the median; seconds.
        sigma: of the logarithm, for lognormal.
    """

    kind: DelayKind
    median_s: float
    sigma: float = 0.0

    def drawn_s(self, random: Random) -> float:
        """Return the next delay, in seconds."""
        if self.kind is DelayKind.FIXED or self.median_s == 0:
            return self.median_s
        if self.kind is DelayKind.EXPONENTIAL:
            return random.expovariate(1 / self.median_s)
        return random.lognormvariate(math.log(self.median_s), self.sigma)


def read_delay(text: str) -> Delay:
    """Return the delay that a text states: `fixed:2s`, `exponential:3s`, `lognormal:5s,0.8`.

    Raises:
        ValueError: it states none.
    """
    found = _SPELLED.fullmatch(text)
    if found is None or (found[3] is not None) is not (found[1] == DelayKind.LOGNORMAL):
        raise ValueError("expected fixed:2s, exponential:3s or lognormal:5s,0.8")
    sigma = float(found[3]) if found[3] else 0.0
    return Delay(kind=DelayKind(found[1]), median_s=float(found[2]), sigma=sigma)


class GivenAnswer(Struct, frozen=True, kw_only=True):
    """One answer that was given.

    Args:
        counter: the request.
        approver: who signed.
        verdict: what.
        why_not: code of why it does not count; empty when it does.
        waited_ms: how long it waited on purpose: the person.
        machine_us: reading, checking, signing, handing in and hearing back: the machine.
    """

    counter: int
    approver: str
    verdict: ApprovalVerdict
    why_not: str
    waited_ms: float
    machine_us: float


class Policy(Struct, frozen=True, kw_only=True):
    """What the script answers.

    Args:
        most_risk: deny what is riskier.
        never: deny what goes to one of these regions.
    """

    most_risk: int = 1 << 30
    never: frozenset[str] = frozenset()

    def verdict(self, question: Question) -> ApprovalVerdict:
        """Return the answer to a request."""
        risky = question.risk > self.most_risk or not self.never.isdisjoint(question.places)
        return ApprovalVerdict.DENY if risky else ApprovalVerdict.APPROVE


class Script:
    """Answers the requests of one gate; people wait beside each other, not one behind another.

    Args:
        client: connected as an operator.
        people: who answers, with their keys.
        delay: how long each takes.
        seed: of the delays.
        policy: what they answer.
    """

    def __init__(
        self,
        client: GateClient,
        people: dict[str, FileSigner],
        *,
        delay: Delay,
        seed: int,
        policy: Policy,
    ) -> None:
        self._client = client
        self._people = people
        self._delay = delay
        self._random = Random(seed)  # noqa: S311 - a drawn delay
        self._policy = policy
        self._known: set[tuple[str, int]] = set()
        self._waiting: list[tuple[float, float, int, str]] = []

    def answers(self) -> Iterator[GivenAnswer]:
        """Yield each answer once it was given, for ever."""
        while True:
            self._look()
            due_s = self._waiting[0][0] if self._waiting else time.monotonic() + LOOK_S
            left_s = due_s - time.monotonic()
            if left_s > 0:
                time.sleep(min(left_s, LOOK_S))
                continue
            answered = self._answer(*heappop(self._waiting)[1:])
            if answered is not None:
                yield answered

    def _look(self) -> None:
        """Let every approver begin to think about each new request."""
        now_s = time.monotonic()
        for question in self._client.approvals():
            if (question.mid, question.counter) in self._known or question.left_ms < 0:
                continue
            self._known.add((question.mid, question.counter))
            for name in self._people:
                due_s = now_s + self._delay.drawn_s(self._random)
                heappush(self._waiting, (due_s, now_s, question.counter, name))

    def _answer(self, seen_s: float, counter: int, name: str) -> GivenAnswer | None:
        """Answer; None when the request was over before this person had decided."""
        begun_s = time.monotonic()
        try:
            question = self._client.approval(counter)
            shown(question)
            verdict = self._policy.verdict(question)
            why = "the script's policy" if verdict is ApprovalVerdict.DENY else ""
            told = self._client.answer(question, verdict, self._people[name], why=why)
        except RefusedError:
            return None
        return GivenAnswer(
            counter=counter,
            approver=name,
            verdict=verdict,
            why_not=str(told["why_not"]),
            waited_ms=(begun_s - seen_s) * 1_000,
            machine_us=(time.monotonic() - begun_s) * 1_000_000,
        )
