# SPDX-License-Identifier: Apache-2.0
"""One question to a language model, and its whole answer as text.

The text is a stranger's. Nothing here reads it; the callers hold it to a strict schema.
"""

from __future__ import annotations

import time
from typing import ClassVar, Protocol

from msgspec import Struct

from authguard_r.authoring.model_client.exchange import (
    FaultKind,
    ModelAddress,
    ModelServerError,
    exchange,
    library,
    retried,
)
from authguard_r.authoring.model_client.protocols import (
    AnthropicProtocol,
    ModelProtocol,
    ModelReply,
    ModelRequest,
    OpenAIProtocol,
)
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason

#: Longest reply that is read, in characters.
MAX_REPLY = 1 << 18
_MAX_TOKENS = 16_384
#: What to do about each fault of the environment, and where it lies.
_MENDS = {
    FaultKind.MISSING_PACKAGE: ("install `authguard-r[drafting]`", "proposer"),
    FaultKind.KEY: (
        "set it, or leave --api-key-env out for a server that asks for none",
        "api_key_env",
    ),
}


class Chat(Protocol):
    """A model that answers one text with another."""

    @property
    def name(self) -> str:
        """Who answers, for the record."""
        ...

    def ask(self, system: str, user: str) -> str:
        """Return the model's whole answer.

        Raises:
            EnvironmentFault: it does not answer, or a package or the key is missing; the message
                says what to do.
            MalformedError: the answer is cut off, empty, too long or not plain text, or the address
                is not valid.
        """
        ...


class _ServerChat(Struct, frozen=True):
    """A model behind a server.

    Args:
        address: where it is.
        total_s: seconds that the answer may take in all, attempts and pauses included.
    """

    protocol: ClassVar[ModelProtocol]
    address: ModelAddress
    total_s: float = 120.0

    @property
    def name(self) -> str:
        """Who answers, for the record."""
        return f"{self.protocol.package}:{self.address.model}"

    def ask(self, system: str, user: str) -> str:
        """Return the model's whole answer; see `Chat.ask`."""
        try:
            return _whole_text(self._answer(self._request(system, user)))
        except ModelServerError as error:
            raise self._fault(error) from None

    def _request(self, system: str, user: str) -> ModelRequest:
        return ModelRequest(system=system, messages=[("user", user)], temperature=0)

    def _answer(self, asked: ModelRequest) -> ModelReply:
        address, protocol, ends = self.address, self.protocol, time.monotonic() + self.total_s
        part = library(protocol.package)
        address.require()
        body, headers = protocol.body(address, asked), protocol.headers(address, asked)

        def once() -> bytes:
            return exchange(
                address,
                part,
                lambda web: protocol.post(part, web, address, body),
                headers=headers,
                ends=ends,
            )

        raw, _ = retried(once, retries=address.retries, ends=ends)
        return protocol.read(raw)

    def _fault(self, error: ModelServerError) -> AuthGuardError:
        """Return a fault of the server as one of ours."""
        if error.kind is FaultKind.TOO_LARGE:
            return MalformedError(error.message, where="reply", reason=Reason.INPUT_TOO_LARGE)
        if error.kind is FaultKind.PROTOCOL:
            return MalformedError(f"the model server {error.message}", where="reply")
        if error.kind in {FaultKind.ADDRESS, FaultKind.CLEARTEXT}:
            return MalformedError(error.message, where="base_url")
        if error.kind in _MENDS:
            mend, where = _MENDS[error.kind]
            message = error.message
        else:
            mend, where = "check --base-url, --model and the key", "base_url"
            late = f"did not finish its answer within {self.total_s:g} s"
            did = late if error.kind is FaultKind.LATE else error.message
            message = f"the model server at `{self.address.base_url}` {did}"
        return EnvironmentFault(
            f"{message}: {mend}", reason=Reason.SERVICE_UNAVAILABLE, where=where
        )


class OpenAIChat(_ServerChat, frozen=True):
    """A server that speaks the chat completions protocol."""

    protocol: ClassVar[ModelProtocol] = OpenAIProtocol()


class AnthropicChat(_ServerChat, frozen=True):
    """A server that speaks the Messages protocol."""

    protocol: ClassVar[ModelProtocol] = AnthropicProtocol()

    def _request(self, system: str, user: str) -> ModelRequest:
        return ModelRequest(system=system, messages=[("user", user)], max_tokens=_MAX_TOKENS)


def _whole_text(reply: ModelReply) -> str:
    """Return the text of an answer that ended by itself and is nothing but text.

    Raises:
        MalformedError: it is not.
    """
    if not reply.ended:
        message = f"expected a whole answer, got `{ascii(reply.stop or None)[:80]}`"
        raise MalformedError(message, where="reply")
    if reply.called or reply.parts != 1 or not reply.text.strip():
        raise MalformedError("expected text and nothing else", where="reply")
    if len(reply.text) > MAX_REPLY:
        raise MalformedError(
            f"expected at most {MAX_REPLY} characters, got {len(reply.text)}",
            where="reply",
            reason=Reason.INPUT_TOO_LARGE,
        )
    return reply.text
