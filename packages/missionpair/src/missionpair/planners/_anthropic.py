# SPDX-License-Identifier: Apache-2.0
"""Anthropic's Messages protocol. It has no seed: its dice are its server's.

From its version 2026-10-21 on it refuses a temperature, even the usual one; where one is asked for,
the version before is spoken, which takes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from missionpair.briefing import OfferedTool
from missionpair.planners._client import Completion
from missionpair.planners._protocol import (
    Body,
    ServerReply,
    SpokenClient,
    count,
    expect,
    object_of,
    text_of,
)

#: The version that is spoken, without and with a temperature.
_VERSION, _WITH_TEMPERATURE = "2026-10-21", "2023-06-01"
#: What else was read, beside `input_tokens`: counted and paid as if it were not cached.
_READ = ("input_tokens", "cache_creation_input_tokens", "cache_read_input_tokens")


class AnthropicClient(SpokenClient):
    """A model behind a server of the Messages protocol."""

    library = "anthropic"

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that shapes its answers."""
        return {**super().parameters, "seeded": False, "version": self._version}

    @property
    def _version(self) -> str:
        return _VERSION if self.reach.temperature is None else _WITH_TEMPERATURE

    def post(self, part: Any, web: Any, body: Body) -> bytes:
        """Send a request and return the reply's exact body."""
        reach = self.reach
        client = part.Anthropic(
            api_key=reach.key(),
            base_url=reach.base_url,
            max_retries=0,
            timeout=reach.timeout_s,
            http_client=web,
        )
        reply = client.messages.with_raw_response.create(**body)
        content: bytes = reply.http_response.content
        return content

    def body(
        self,
        system: str,
        messages: Sequence[tuple[str, str]],
        tools: Sequence[OfferedTool],
        *,
        seed: int,  # noqa: ARG002 - the protocol has none
        max_tokens: int,
    ) -> Body:
        """Return what is sent."""
        body: Body = {
            "model": self.reach.model,
            "max_tokens": max_tokens,
            "system": system,
            "messages": [{"role": role, "content": text} for role, text in messages],
            "extra_headers": {"anthropic-version": self._version},
        }
        if self.reach.temperature is not None:
            body["extra_body"] = {"temperature": self.reach.temperature}
        if tools:
            body["tools"] = [
                {
                    "name": tool.name,
                    "description": tool.description,
                    "input_schema": tool.parameters,
                }
                for tool in tools
            ]
        return body

    def read(self, reply: ServerReply) -> Completion:
        """Return what a reply says; its calls are left to the normalizer."""
        if reply.value.get("type") != "message":
            raise self.odd("expected a reply of type `message`")
        blocks = [
            object_of(block, f"content[{n}]")
            for n, block in enumerate(expect(reply.value.get("content"), list, "content"))
        ]
        usage, stop = reply.value.get("usage"), reply.value.get("stop_reason")
        return Completion(
            text="".join(text_of(b.get("text")) for b in blocks if b.get("type") == "text"),
            raw=reply.raw,
            called=any(b.get("type") == "tool_use" for b in blocks),
            declined=stop == "refusal",
            cut=stop == "max_tokens",
            model=text_of(reply.value.get("model")),
            tokens=(sum(count(usage, name) for name in _READ), count(usage, "output_tokens")),
        )
