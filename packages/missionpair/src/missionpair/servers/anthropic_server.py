# SPDX-License-Identifier: Apache-2.0
"""The stand-in behind Anthropic's Messages protocol."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any, ClassVar

from missionpair.briefing import OfferedTool
from missionpair.servers._http import StandInServer
from missionpair.servers._scripted import Behavior, ScriptedAnswer, ScriptedQuestion

#: The last version of the protocol that takes a temperature.
_WITH_TEMPERATURE = "2023-06-01"


class AnthropicServer(StandInServer):
    """Messages, with tools; no streaming."""

    path: ClassVar[str] = "/v1/messages"
    prefix: ClassVar[str] = ""

    def read(self, headers: Any, request: Any) -> ScriptedQuestion:
        """Return what a request asks."""
        _ = int(request["max_tokens"])  # the protocol demands it
        if "temperature" in request and headers.get("anthropic-version") != _WITH_TEMPERATURE:
            raise ValueError("temperature: extra inputs are not permitted")
        return ScriptedQuestion(
            model=request["model"],
            system=request.get("system", ""),
            user=request["messages"][-1]["content"],
            tools=tuple(
                OfferedTool(tool["name"], tool.get("description", ""), tool["input_schema"])
                for tool in request.get("tools", ())
            ),
        )

    def write(self, asked: ScriptedQuestion, answer: ScriptedAnswer, behavior: Behavior) -> str:
        """Return the reply; nothing in it is of a clock."""
        name = sha256(repr((asked, behavior)).encode(errors="replace")).hexdigest()[:16]
        said = [{"type": "text", "text": answer.text}] if answer.text else []
        calls = [
            {
                "type": "tool_use",
                "id": f"toolu_{name}_{number}",
                "name": call.tool,
                "input": f"{name} {number}",
            }
            for number, call in enumerate(answer.calls)
        ]
        stop = "tool_use" if calls else "end_turn"
        stop = "max_tokens" if answer.cut else "refusal" if answer.refusal else stop
        reply = {
            "id": f"msg_{name}",
            "type": "message",
            "role": "assistant",
            "model": behavior.model,
            "content": [*said, *calls],
            "stop_reason": stop,
            "stop_sequence": None,
            "usage": {
                "input_tokens": (len(asked.system + asked.user) + 3) // 4,
                "output_tokens": (len(repr(answer)) + 3) // 4,
            },
        }
        text = json.dumps(reply)
        for number, call in enumerate(answer.calls):  # as they were written, right or wrong
            text = text.replace(f'"{name} {number}"', call.arguments, 1)
        return text

    def error(self, message: str, kind: str) -> Any:
        """Return the reply of a failure."""
        return {"type": "error", "error": {"type": kind, "message": message}}

    def is_allowed(self, headers: Any) -> bool:
        """True when the request brings the key that is asked for."""
        told = (headers.get("authorization"), headers.get("x-api-key"))
        return not self.key or told in {(f"Bearer {self.key}", None), (None, self.key)}
