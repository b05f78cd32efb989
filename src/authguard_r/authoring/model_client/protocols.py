# SPDX-License-Identifier: Apache-2.0
"""The two protocols of model servers: what is sent, and the frame of what comes back.

Only the frame of a reply is read here, never a call in it: calls are read by the normalizer.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from msgspec import Struct

from authguard_r.authoring.model_client.exchange import FaultKind, ModelAddress, ModelServerError

Body = dict[str, Any]
#: Seeds that every server of the chat completions protocol takes.
_SEEDS = 1 << 31
#: The version of the Messages protocol, without and with a temperature.
_VERSION, _WITH_TEMPERATURE = "2026-10-21", "2023-06-01"
#: Tokens that were read; those from a cache are counted and paid as the others.
_READ = ("input_tokens", "cache_creation_input_tokens", "cache_read_input_tokens")


class ModelRequest(Struct, frozen=True, kw_only=True):
    """What a model is asked.

    Args:
        system: its instructions.
        messages: who (`user` or `assistant`) wrote what, oldest first.
        tools: what it may call: name, purpose, and the JSON schema of the arguments.
        seed: of its random choices, where the protocol has one; None sends none.
        max_tokens: most that it may write; None leaves it to the server, where the protocol can.
        temperature: of its random choices; None sends none, for models that take none.
        schema: JSON schema that the server holds the answer's text to, where the protocol can; None
            leaves the form to the model.
    """

    system: str
    messages: Sequence[tuple[str, str]]
    tools: Sequence[tuple[str, str, dict[str, Any]]] = ()
    seed: int | None = None
    max_tokens: int | None = None
    temperature: float | None = None
    schema: dict[str, Any] | None = None


class ModelReply(Struct, frozen=True, kw_only=True):
    """One answer of a model.

    Args:
        text: what it wrote, its calls apart.
        raw: the reply's exact body, in which the normalizer reads calls.
        called: it made at least one call.
        declined: its server says that it would not answer.
        cut: it was not finished: it reached `max_tokens`.
        ended: it ended by itself.
        stop: why it ended, in the server's word.
        parts: how many parts it has, thoughts apart.
        model: who answered, as the server says.
        tokens: read and written, as the server counts; zeros where it does not say.
    """

    text: str
    raw: bytes
    called: bool = False
    declined: bool = False
    cut: bool = False
    ended: bool = True
    stop: str = ""
    parts: int = 1
    model: str = ""
    tokens: tuple[int, int] = (0, 0)


class ModelProtocol(ABC):
    """One protocol of model servers."""

    #: The client library's package; it names the protocol too.
    package: ClassVar[str]

    @abstractmethod
    def published(self, temperature: float | None) -> dict[str, Any]:
        """Return what of the protocol shapes an answer, for a report."""

    def headers(self, address: ModelAddress, asked: ModelRequest) -> dict[str, str]:  # noqa: ARG002
        """Return the key as a bearer token, and the protocol's own headers.

        Raises:
            ModelServerError: there is no key.
        """
        return {"authorization": f"Bearer {address.key()}"}

    @abstractmethod
    def body(self, address: ModelAddress, asked: ModelRequest) -> Body:
        """Return what is sent."""

    @abstractmethod
    def post(self, part: Any, web: Any, address: ModelAddress, body: Body) -> bytes:
        """Send a request with the client library and return the reply's exact body."""

    def read(self, raw: bytes) -> ModelReply:
        """Return what a reply says.

        Raises:
            ModelServerError: it is no reply of the protocol.
        """
        try:
            value = json.loads(raw)
        except (ValueError, RecursionError):
            raise _odd("expected JSON") from None
        return self._read(raw, _object(value, "reply"))

    @abstractmethod
    def _read(self, raw: bytes, value: dict[str, Any]) -> ModelReply: ...


class OpenAIProtocol(ModelProtocol):
    """The chat completions protocol: OpenAI's own server, Ollama, vLLM, LM Studio and others."""

    package = "openai"

    def published(self, temperature: float | None) -> dict[str, Any]:  # noqa: ARG002 - has none
        """Return that answers have a seed."""
        return {"seeded": True}

    def body(self, address: ModelAddress, asked: ModelRequest) -> Body:
        """Return what is sent."""
        said = [("system", asked.system), *asked.messages]
        body: Body = {
            "model": address.model,
            "messages": [{"role": role, "content": text} for role, text in said],
        }
        if asked.seed is not None:
            body["seed"] = asked.seed % _SEEDS
        if asked.max_tokens is not None:
            # OpenAI's newer models take the second name alone, other servers know the first
            body["max_tokens" if address.own else "max_completion_tokens"] = asked.max_tokens
        if asked.temperature is not None:
            body["temperature"] = asked.temperature
        if asked.tools:
            keys = ("name", "description", "parameters")
            functions = [dict(zip(keys, tool, strict=True)) for tool in asked.tools]
            body["tools"] = [{"type": "function", "function": one} for one in functions]
        if asked.schema is not None:
            form = {"name": "answer", "schema": asked.schema}
            body["response_format"] = {"type": "json_schema", "json_schema": form}
        return body

    def post(self, part: Any, web: Any, address: ModelAddress, body: Body) -> bytes:
        """Send a request with the client library and return the reply's exact body."""
        client = part.OpenAI(**_options(address, web))
        content: bytes = client.chat.completions.with_raw_response.create(**body).content
        return content

    def _read(self, raw: bytes, value: dict[str, Any]) -> ModelReply:
        choices = _expect(value.get("choices"), list, "choices")
        if len(choices) != 1:
            raise _odd(f"expected one choice, got {len(choices)}")
        choice = _object(choices[0], "choices[0]")
        message = _object(choice.get("message"), "choices[0].message")
        calls = _expect(message.get("tool_calls") or [], list, "tool_calls")
        usage, stop = value.get("usage"), _word(choice.get("finish_reason"))
        return ModelReply(
            text=_text(message.get("content")),
            raw=raw,
            called=bool(calls) or message.get("function_call") is not None,
            declined=bool(message.get("refusal")) or stop == "content_filter",
            cut=stop == "length",
            ended=stop == "stop",
            stop=stop,
            model=_text(value.get("model")),
            tokens=(_count(usage, "prompt_tokens"), _count(usage, "completion_tokens")),
        )


class AnthropicProtocol(ModelProtocol):
    """Anthropic's Messages protocol. It has no seed: its server makes the random choices.

    From its version 2026-10-21 on it refuses a temperature, also the default one. Where one is
    asked for, the client speaks the version before, which takes it.
    """

    package = "anthropic"

    def published(self, temperature: float | None) -> dict[str, Any]:
        """Return that answers have no seed, and the version."""
        return {"seeded": False, "version": _version(temperature)}

    def headers(self, address: ModelAddress, asked: ModelRequest) -> dict[str, str]:
        """Return the key as a bearer token, and the version."""
        version = {"anthropic-version": _version(asked.temperature)}
        return {**super().headers(address, asked), **version}

    def body(self, address: ModelAddress, asked: ModelRequest) -> Body:
        """Return what is sent."""
        body: Body = {
            "model": address.model,
            "max_tokens": asked.max_tokens,
            "system": asked.system,
            "messages": [{"role": role, "content": text} for role, text in asked.messages],
        }
        if asked.temperature is not None:
            body["extra_body"] = {"temperature": asked.temperature}
        if asked.tools:
            keys = ("name", "description", "input_schema")
            body["tools"] = [dict(zip(keys, tool, strict=True)) for tool in asked.tools]
        return body

    def post(self, part: Any, web: Any, address: ModelAddress, body: Body) -> bytes:
        """Send a request with the client library and return the reply's exact body."""
        reply = part.Anthropic(**_options(address, web)).messages.with_raw_response.create(**body)
        content: bytes = reply.http_response.content
        return content

    def _read(self, raw: bytes, value: dict[str, Any]) -> ModelReply:
        if value.get("type") != "message":
            raise _odd("expected a reply of type `message`")
        blocks = [
            _object(block, f"content[{n}]")
            for n, block in enumerate(_expect(value.get("content"), list, "content"))
        ]
        usage, stop = value.get("usage"), _word(value.get("stop_reason"))
        return ModelReply(
            text="".join(_text(b.get("text")) for b in blocks if b.get("type") == "text"),
            raw=raw,
            called=any(b.get("type") == "tool_use" for b in blocks),
            declined=stop == "refusal",
            cut=stop == "max_tokens",
            ended=stop == "end_turn",
            stop=stop,
            parts=sum(b.get("type") != "thinking" for b in blocks),
            model=_text(value.get("model")),
            tokens=(sum(_count(usage, name) for name in _READ), _count(usage, "output_tokens")),
        )


def _version(temperature: float | None) -> str:
    return _VERSION if temperature is None else _WITH_TEMPERATURE


def _options(address: ModelAddress, web: Any) -> dict[str, Any]:
    return {
        "api_key": address.key(),
        "base_url": address.base_url,
        "max_retries": 0,
        "timeout": address.timeout_s,
        "http_client": web,
    }


def _odd(message: str) -> ModelServerError:
    return ModelServerError(f"sent no reply of its protocol: {message}", FaultKind.PROTOCOL)


def _object(value: Any, where: str) -> dict[str, Any]:
    found: dict[str, Any] = _expect(value, dict, where)
    return found


def _expect(value: Any, kind: type[Any], where: str) -> Any:
    if isinstance(value, kind):
        return value
    raise _odd(f"expected {'an object' if kind is dict else 'a list'} at `{where}`")


def _text(value: Any) -> str:
    """Return a text; the empty one where there is none."""
    if value is None or isinstance(value, str):
        return value or ""
    raise _odd("expected text")


def _word(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _count(usage: Any, name: str) -> int:
    """Return a count of tokens; 0 where the server does not say it."""
    found = usage.get(name) if isinstance(usage, dict) else None
    return found if type(found) is int and found >= 0 else 0
