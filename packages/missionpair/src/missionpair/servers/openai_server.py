# SPDX-License-Identifier: Apache-2.0
"""The stand-in behind the chat completions protocol."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any, ClassVar

from missionpair.briefing import OfferedTool
from missionpair.servers._http import StandInServer
from missionpair.servers._scripted import Behavior, ScriptedAnswer, ScriptedQuestion


class OpenAIServer(StandInServer):
    """Chat completions, with tools; no streaming."""

    path: ClassVar[str] = "/v1/chat/completions"
    prefix: ClassVar[str] = "/v1"

    def read(self, headers: Any, request: Any) -> ScriptedQuestion:  # noqa: ARG002 - all is in the body
        """Return what a request asks."""
        messages = request["messages"]
        system = [m["content"] for m in messages if m["role"] == "system"]
        return ScriptedQuestion(
            model=request["model"],
            system="\n".join(system),
            user=messages[-1]["content"],
            tools=tuple(
                OfferedTool(f["name"], f.get("description", ""), f["parameters"])
                for f in (tool["function"] for tool in request.get("tools", ()))
            ),
            seed=int(request.get("seed", 0)),
        )

    def write(self, asked: ScriptedQuestion, answer: ScriptedAnswer, behavior: Behavior) -> str:
        """Return the reply; nothing in it is of a clock."""
        name = sha256(repr((asked, behavior)).encode(errors="replace")).hexdigest()[:16]
        calls = [
            {
                "id": f"call_{name}_{number}",
                "type": "function",
                "function": {"name": call.tool, "arguments": call.arguments},
            }
            for number, call in enumerate(answer.calls)
        ]
        stop = "length" if answer.cut else "tool_calls" if calls else "stop"
        message: dict[str, Any] = {"role": "assistant", "content": answer.text or None}
        message |= {"refusal": answer.text} if answer.refusal else {}
        message |= {"tool_calls": calls} if calls else {}
        read, written = _tokens(asked.system + asked.user), _tokens(repr(answer))
        reply = {
            "id": f"chatcmpl-{name}",
            "object": "chat.completion",
            "created": 0,
            "model": behavior.model,
            "choices": [{"index": 0, "finish_reason": stop, "message": message}],
            "usage": {
                "prompt_tokens": read,
                "completion_tokens": written,
                "total_tokens": read + written,
            },
        }
        return json.dumps(reply)

    def error(self, message: str, kind: str) -> Any:
        """Return the reply of a failure."""
        return {"error": {"message": message, "type": kind, "param": None, "code": None}}

    def is_allowed(self, headers: Any) -> bool:
        """True when the request brings the key that is asked for."""
        return not self.key or headers.get("authorization") == f"Bearer {self.key}"


def _tokens(text: str) -> int:
    """Return a count that stands for tokens: every four characters."""
    return (len(text) + 3) // 4
