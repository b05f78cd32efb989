# SPDX-License-Identifier: Apache-2.0
"""A safety gate in another process: asked over a Unix socket, trusted only when all is in order.

One connection for one question: one line there, one line back. Every other result (no process
there, another user's process, too late, too long, not this protocol, an answer to another question
or about another action) is unsafe: no checker has said that it is safe. Spec page:
docs/spec/safety.md#checker
"""

from __future__ import annotations

import os
import socket
import struct
import time
from typing import Annotated, Any, Literal

from msgspec import Meta, Raw, Struct

from authguard_r.core.action import Action, scope_of
from authguard_r.core.encoding import Tag, b64, decode, digest_of, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.safety import Hazard, SafetyDecision, SafetyFinding
from authguard_r.core.state import AttestedState
from authguard_r.safety.config import ExternalChecker

#: The protocol's name and version; no other one is supported.
PROTOCOL = "authguard-r/safety-check/1"
#: Longest answer, in bytes, its line end included.
MAX_ANSWER = 16_384
#: Findings of one answer.
MAX_FINDINGS = 32

Text = Annotated[str, Meta(pattern=r"\A[ -~]{0,200}\Z")]
_UCRED = struct.Struct("iII")


class CheckerFinding(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One thing that a checker found: its own rule, where in the action, and two short texts."""

    rule: Identifier
    field: Text
    expected: Text
    got: Text


class CheckerAnswer(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a checker answers.

    Args:
        protocol: has to be ours.
        id: of the question.
        action: digest of the action that it speaks of.
        safe: whether it is safe.
        findings: why not; empty exactly when it is safe.
    """

    protocol: Literal["authguard-r/safety-check/1"]
    id: Annotated[str, Meta(max_length=22)]
    action: Digest
    safe: bool
    findings: Annotated[tuple[CheckerFinding, ...], Meta(max_length=MAX_FINDINGS)]


class NoAnswerError(Exception):
    """No checker said that it is safe; the text says why, for people."""


class ExternalGate:
    """Asks another process (`core.ports.SafetyGate`).

    Args:
        checker: who has to agree, where it listens, as whom it runs, and how long it may take.
    """

    def __init__(self, checker: ExternalChecker) -> None:
        self.checker = checker

    def recall(self, memory: bytes) -> ExternalGate:  # noqa: ARG002 - the checker keeps its own
        """Return the same gate: what the other process remembers is its own affair."""
        return self

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return what the other process says; unsafe when it does not say it as it should."""
        number, about = b64(os.urandom(16)), digest_of(Tag.ACTION, action)
        question = encode_fast(
            {
                "protocol": PROTOCOL,
                "id": number,
                "robot": facts.robot.rid,
                "site": facts.digest,
                "action": about,
                "effect": scope_of(action),
                "state": [] if state is None else [_told(state, now)],
                "time": to_timestamp(now.utc_ms),
            }
        )
        try:
            answer = _answer(self._asked(question), number=number, about=about)
        except NoAnswerError as error:
            text = str(error)
            finding = SafetyFinding(Hazard.STATE_UNKNOWN, self._field, "an answer in time", text)
            return SafetyDecision(safe=False, findings=(finding,))
        return SafetyDecision(safe=answer.safe, findings=tuple(map(self._finding, answer.findings)))

    @property
    def _field(self) -> str:
        return f"checker.{self.checker.id}"

    def _finding(self, found: CheckerFinding) -> SafetyFinding:
        field = f"{self._field}.{found.rule}" + (f" {found.field}" if found.field else "")
        return SafetyFinding(Hazard.RULE, field, found.expected, found.got)

    def _asked(self, question: bytes) -> bytes:
        """Return the line that came back in time from the right process.

        Raises:
            NoAnswerError: none did.
        """
        until = time.monotonic() + self.checker.timeout_ms / 1_000
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
                link.settimeout(_left(until))
                link.connect(self.checker.socket)
                self._require_user(link)
                link.settimeout(_left(until))
                link.sendall(question + b"\n")
                return _line(link, until)
        except TimeoutError:
            raise NoAnswerError(f"none after {self.checker.timeout_ms} ms") from None
        except OSError as error:
            raise NoAnswerError(error.strerror or "no connection") from error

    def _require_user(self, link: socket.socket) -> None:
        wanted = os.geteuid() if self.checker.uid is None else self.checker.uid
        option = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
        _, uid, _ = _UCRED.unpack(option)
        if uid != wanted:
            raise NoAnswerError(f"a process of user {uid}, not {wanted}, listens there")


def _left(until: float) -> float:
    """Return the seconds that are left.

    Raises:
        TimeoutError: none are.
    """
    left = until - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


def _line(link: socket.socket, until: float) -> bytes:
    """Return one line without its end; bytes that trickle in do not get more time."""
    data = b""
    while b"\n" not in data:
        link.settimeout(_left(until))
        got = link.recv(MAX_ANSWER + 1 - len(data))
        if not got:
            raise NoAnswerError("the connection ended in the middle")
        data += got
        if len(data) > MAX_ANSWER:
            raise NoAnswerError(f"more than {MAX_ANSWER} bytes")
    line, _, rest = data.partition(b"\n")
    if rest:
        raise NoAnswerError("more than one line")
    return line


def _answer(line: bytes, *, number: str, about: Digest) -> CheckerAnswer:
    """Return the answer that a line holds, if it is one to this question about this action."""
    try:
        answer = decode(line, CheckerAnswer, where="answer")
    except MalformedError as error:
        raise NoAnswerError(f"no answer: {error.message}"[:200]) from error
    if answer.id != number:
        raise NoAnswerError("an answer to another question")
    if answer.action != about:
        raise NoAnswerError("an answer about another action")
    if answer.safe == bool(answer.findings):
        raise NoAnswerError("safe with findings, or unsafe without")
    return answer


def _told(state: AttestedState, now: Now) -> dict[str, Any]:
    """Return the attested state as a checker sees it: signed values, and how old they are by now.

    The bytes that were signed are passed on as they are; a value's own age comes on top. A value
    with a smaller fence is from before the robot's last motion.
    """
    age = now.mono_ms - state.arrived_mono_ms
    told = {"snapshot": Raw(state.data), "place": sorted(state.place), "age_ms": age}
    return {**told, "fence": state.fence}
