# SPDX-License-Identifier: Apache-2.0
"""The chat completions protocol: OpenAI's own server, Ollama, vLLM, LM Studio and others."""

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

#: Seeds that every server of the protocol takes.
_SEEDS = 1 << 31


class OpenAIClient(SpokenClient):
    """A model behind a server of the chat completions protocol."""

    library = "openai"

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that shapes its answers."""
        return {**super().parameters, "seeded": True}

    def post(self, part: Any, web: Any, body: Body) -> bytes:
        """Send a request and return the reply's exact body."""
        reach = self.reach
        client = part.OpenAI(
            api_key=reach.key(),
            base_url=reach.base_url,
            max_retries=0,
            timeout=reach.timeout_s,
            http_client=web,
        )
        content: bytes = client.chat.completions.with_raw_response.create(**body).content
        return content

    def body(
        self,
        system: str,
        messages: Sequence[tuple[str, str]],
        tools: Sequence[OfferedTool],
        *,
        seed: int,
        max_tokens: int,
    ) -> Body:
        """Return what is sent."""
        said = [("system", system), *messages]
        # OpenAI's newer models take the second name alone, other servers know the first
        limit = "max_tokens" if self.reach.own else "max_completion_tokens"
        body: Body = {
            "model": self.reach.model,
            "messages": [{"role": role, "content": text} for role, text in said],
            "seed": seed % _SEEDS,
            limit: max_tokens,
        }
        if self.reach.temperature is not None:
            body["temperature"] = self.reach.temperature
        if tools:
            body["tools"] = [
                {
                    "type": "function",
                    "function": {
                        "name": tool.name,
                        "description": tool.description,
                        "parameters": tool.parameters,
                    },
                }
                for tool in tools
            ]
        return body

    def read(self, reply: ServerReply) -> Completion:
        """Return what a reply says; its calls are left to the normalizer."""
        choices = expect(reply.value.get("choices"), list, "choices")
        if len(choices) != 1:
            raise self.odd(f"expected one choice, got {len(choices)}")
        choice = object_of(choices[0], "choices[0]")
        message = object_of(choice.get("message"), "choices[0].message")
        calls = expect(message.get("tool_calls") or [], list, "tool_calls")
        usage = reply.value.get("usage")
        stop = choice.get("finish_reason")
        return Completion(
            text=text_of(message.get("content")),
            raw=reply.raw,
            called=bool(calls) or message.get("function_call") is not None,
            declined=bool(message.get("refusal")) or stop == "content_filter",
            cut=stop == "length",
            model=text_of(reply.value.get("model")),
            tokens=(count(usage, "prompt_tokens"), count(usage, "completion_tokens")),
        )
