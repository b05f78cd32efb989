# SPDX-License-Identifier: Apache-2.0
"""The one tree of exceptions: broken input or a broken world, never an expected refusal.

    AuthGuardError
    ├── MalformedError        bytes that are no canonical object of the kind asked for
    ├── AuthenticityError     an object whose key, certificate or signature does not hold
    ├── RefusedError          an authentic order that may not be carried out now
    ├── ClarificationError    a privileged field is absent or ambiguous; only a person can say
    └── EnvironmentFault      the world is at fault: store, clock, controller, missing part
        ├── StoreError
        ├── ClockError
        └── ControllerError

An expected refusal is a value (`Finding`, `Decision`). A caller's own mistake is `TypeError` or
`RuntimeError`. Only `enforcement` turns one of these exceptions into a refusal.
"""

from __future__ import annotations

from authguard_r.core.reasons import Reason

#: Longest message or place of an error, in characters; what is longer is cut.
MAX_SHOWN = 1_000


def shown(text: str) -> str:
    """Return text that a log can hold and a terminal can print: cut, and escaped where it must be.

    The author of the text chose its length and its control characters too.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:MAX_SHOWN])


class AuthGuardError(Exception):
    """Something that is not a decision went wrong.

    Args:
        message: what was expected and what was found, made printable; holds no secrets.
        reason: the code that a refusal made of this error carries.
        where: the place in the input (`actions[2].limits`), empty when there is none.
    """

    def __init__(self, message: str, *, reason: Reason, where: str = "") -> None:
        super().__init__(message)
        self.message = shown(message)
        self.reason = reason
        self.where = shown(where)

    def __str__(self) -> str:
        place = f" at `{self.where}`" if self.where else ""
        return f"{self.reason}: {self.message}{place}"


class MalformedError(AuthGuardError):
    """The only exception that a decoder raises, on any bytes at all; nothing was changed."""

    def __init__(self, message: str, *, where: str = "", reason: Reason = Reason.MALFORMED) -> None:
        super().__init__(message, reason=reason, where=where)


class AuthenticityError(AuthGuardError):
    """A key, a certificate or a signature did not hold; nothing was changed."""


class ClarificationError(AuthGuardError):
    """A privileged field is absent or ambiguous; the answer is a person's, never a guess.

    Args:
        question: one sentence for the operator.
        field: the draft field that the answer fills.
        candidates: the values the site model knows for it, possibly none.
        others: the further questions that are open beside this one.
    """

    def __init__(
        self,
        question: str,
        *,
        field: str,
        candidates: tuple[str, ...] = (),
        others: tuple[ClarificationError, ...] = (),
    ) -> None:
        super().__init__(question, reason=Reason.CLARIFICATION_NEEDED, where=field)
        self.question, self.field = self.message, self.where
        self.candidates = candidates
        self.others = others


class RefusedError(AuthGuardError):
    """An authentic order that may not be carried out now; nothing was changed."""


class EnvironmentFault(AuthGuardError):  # noqa: N818 - the exit code's own word
    """The environment is at fault; the same input may be accepted once it is mended."""


class StoreError(EnvironmentFault):
    """The store is locked, full, read-only, corrupt, newer or gone; nothing was committed."""

    def __init__(
        self, message: str, *, where: str = "", reason: Reason = Reason.STORE_UNAVAILABLE
    ) -> None:
        super().__init__(message, reason=reason, where=where)


class ClockError(EnvironmentFault):
    """The wall clock is behind what was already committed by more than the allowed skew."""

    def __init__(self, message: str) -> None:
        super().__init__(message, reason=Reason.CLOCK_BEHIND, where="now")


class ControllerError(EnvironmentFault):
    """The controller did not take or did not answer a command."""

    def __init__(self, message: str) -> None:
        super().__init__(message, reason=Reason.CONTROLLER_FAILED, where="controller")
