# SPDX-License-Identifier: Apache-2.0
"""One question to a language model: sent to the given address alone, bounded, answered whole.

A reply is text from a stranger. Nothing here reads it; the callers hold it to a strict schema.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

    import httpx2

T = TypeVar("T")
#: Longest reply that is looked at, in characters.
MAX_REPLY = 1 << 18
#: Longest body of an HTTP response that is read, in bytes.
MAX_BODY = 1 << 23
_MAX_TOKENS = 16_384
_MEND = "install `authguard-r[drafting]`"


class Chat(Protocol):
    """A model that answers one text with another."""

    @property
    def name(self) -> str:
        """Who answers, for the record."""
        ...

    def ask(self, system: str, user: str) -> str:
        """Return the model's whole answer; call it outside of a running event loop.

        Raises:
            EnvironmentFault: it does not answer, or a part is missing; the message has the mend.
            MalformedError: the answer is cut off, empty, too long or not plain text.
        """
        ...


class ModelAddress(Struct, frozen=True, kw_only=True):
    """Where a model is and how long it may take.

    Args:
        base_url: the only address that is spoken to; redirects and proxies are not followed.
        model: the model's name there.
        api_key_env: name of the environment variable that holds the key; None sends a placeholder,
            for a local server that asks for none.
        timeout_s: seconds that one silence may last.
        retries: further attempts after 429, 5xx and broken connections.
        total_s: seconds that the answer may take in all, attempts and pauses included.
    """

    base_url: str
    model: str
    api_key_env: str | None = None
    timeout_s: float = 60.0
    retries: int = 2
    total_s: float = 120.0

    def key(self) -> str:
        """Return the key.

        Raises:
            EnvironmentFault: the variable is not set.
        """
        if self.api_key_env is None:
            return "none"
        found = os.environ.get(self.api_key_env, "").strip()
        if not found:
            raise EnvironmentFault(
                f"the environment variable `{self.api_key_env}` holds no key: set it, or leave "
                "--api-key-env out for a server that asks for none",
                reason=Reason.STORE_UNAVAILABLE,
                where="api_key_env",
            )
        return found


class OpenAIChat(Struct, frozen=True):
    """A server that speaks the chat completions protocol."""

    reach: ModelAddress

    @property
    def name(self) -> str:
        """Who answers, for the record."""
        return f"openai:{self.reach.model}"

    def ask(self, system: str, user: str) -> str:
        """Return the model's whole answer; see `Chat.ask`."""
        openai = _part(_import_openai)
        reach = self.reach

        async def answer(web: httpx2.AsyncClient) -> str:
            client = openai.AsyncOpenAI(
                api_key=reach.key(),
                base_url=reach.base_url,
                max_retries=reach.retries,
                timeout=reach.timeout_s,
                http_client=web,
            )
            reply = await client.chat.completions.create(
                model=reach.model,
                messages=[
                    {"role": "system", "content": system},
                    {"role": "user", "content": user},
                ],
                temperature=0,
            )
            choices: Any = getattr(reply, "choices", None) or ()
            if len(choices) != 1:
                raise _odd(f"expected one choice, got {len(choices)}")
            if choices[0].finish_reason != "stop":
                raise _odd(f"expected a whole answer, got `{choices[0].finish_reason}`")
            return _text(choices[0].message.content)

        return _in_time(reach, openai, answer)


class AnthropicChat(Struct, frozen=True):
    """A server that speaks the Messages protocol."""

    reach: ModelAddress

    @property
    def name(self) -> str:
        """Who answers, for the record."""
        return f"anthropic:{self.reach.model}"

    def ask(self, system: str, user: str) -> str:
        """Return the model's whole answer; see `Chat.ask`."""
        anthropic = _part(_import_anthropic)
        reach = self.reach

        async def answer(web: httpx2.AsyncClient) -> str:
            client = anthropic.AsyncAnthropic(
                api_key=reach.key(),
                base_url=reach.base_url,
                max_retries=reach.retries,
                timeout=reach.timeout_s,
                http_client=web,
            )
            reply = await client.messages.create(
                model=reach.model,
                max_tokens=_MAX_TOKENS,
                system=system,
                messages=[{"role": "user", "content": user}],
            )
            if getattr(reply, "stop_reason", None) != "end_turn":
                raise _odd(f"expected a whole answer, got `{getattr(reply, 'stop_reason', None)}`")
            blocks = [block for block in reply.content or () if block.type != "thinking"]
            if len(blocks) != 1 or blocks[0].type != "text":
                raise _odd("expected one block of text")
            return _text(blocks[0].text)

        return _in_time(reach, anthropic, answer)


def _import_openai() -> Any:
    import openai

    return openai


def _import_anthropic() -> Any:
    import anthropic

    return anthropic


def _import_httpx2() -> Any:
    import httpx2

    return httpx2


def _part(load: Callable[[], T]) -> T:
    """Return an optional part.

    Raises:
        EnvironmentFault: it is not installed.
    """
    try:
        return load()
    except ImportError as error:
        raise EnvironmentFault(
            f"a language model needs the part `{error.name}`: {_MEND}",
            reason=Reason.STORE_UNAVAILABLE,
            where="proposer",
        ) from error


def _in_time(
    reach: ModelAddress, part: Any, answer: Callable[[httpx2.AsyncClient], Awaitable[T]]
) -> T:
    """Return the answer, or end the exchange when the time for all of it is over."""

    async def exchange() -> T:
        async with asyncio.timeout(reach.total_s), web:
            return await answer(web)

    web = _client(reach)
    with _faults(reach, part):
        return asyncio.run(exchange())


def _client(reach: ModelAddress) -> httpx2.AsyncClient:
    """Return a client that takes nothing from the environment and goes nowhere else."""
    web: Any = _part(_import_httpx2)
    if not reach.base_url.startswith(("http://", "https://")):
        raise MalformedError(
            "expected an address such as http://127.0.0.1:8000/v1", where="base_url"
        )
    client: httpx2.AsyncClient = web.AsyncClient(
        trust_env=False,
        follow_redirects=False,
        timeout=reach.timeout_s,
        headers={"Accept-Encoding": "identity"},
        event_hooks={"response": [_bound_body]},
    )
    return client


async def _bound_body(response: httpx2.Response) -> None:
    """Refuse a body that is compressed, and let one that is too long be read no further."""
    import httpx2

    class Bounded(httpx2.AsyncByteStream):
        def __init__(self, body: httpx2.AsyncByteStream) -> None:
            self._body = body

        async def __aiter__(self) -> AsyncIterator[bytes]:
            left = MAX_BODY
            async for chunk in self._body:
                left -= len(chunk)
                if left < 0:
                    raise MalformedError(
                        f"expected a response of at most {MAX_BODY} bytes",
                        where="reply",
                        reason=Reason.INPUT_TOO_LARGE,
                    )
                yield chunk

        async def aclose(self) -> None:
            await self._body.aclose()

    if response.headers.get("content-encoding", "identity") != "identity":
        raise _odd("expected a response that is not compressed")
    if isinstance(response.stream, httpx2.AsyncByteStream):
        response.stream = Bounded(response.stream)


@contextmanager
def _faults(reach: ModelAddress, part: Any) -> Iterator[None]:
    """Turn whatever the client raises into one clear fault, without keys and bodies."""
    try:
        yield
    except (MalformedError, EnvironmentFault):
        raise
    except TimeoutError as error:
        raise _silent(reach, f"did not finish its answer within {reach.total_s:g} s") from error
    except part.APITimeoutError as error:
        raise _silent(reach, f"did not answer within {reach.timeout_s:g} s") from error
    except part.APIStatusError as error:
        raise _silent(reach, f"answered with status {error.status_code}") from None
    except part.APIConnectionError as error:
        if isinstance(error.__cause__, MalformedError):  # the client took it for a broken line
            raise error.__cause__ from None
        raise _silent(reach, "cannot be reached") from error
    except Exception as error:  # the client met a reply that is none
        raise _odd("expected a reply of the protocol") from error


def _silent(reach: ModelAddress, what: str) -> EnvironmentFault:
    return EnvironmentFault(
        f"the model server at `{reach.base_url}` {what}: check --base-url, --model and the key",
        reason=Reason.STORE_UNAVAILABLE,
        where="base_url",
    )


def _odd(message: str) -> MalformedError:
    return MalformedError(message, where="reply")


def _text(content: object) -> str:
    if not isinstance(content, str) or not content.strip():
        raise _odd("expected text")
    if len(content) > MAX_REPLY:
        raise MalformedError(
            f"expected at most {MAX_REPLY} characters, got {len(content)}",
            where="reply",
            reason=Reason.INPUT_TOO_LARGE,
        )
    return content
