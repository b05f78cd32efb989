# SPDX-License-Identifier: Apache-2.0
"""A model server on the loopback that speaks chat completions and says what a test wrote.

    with ScriptedModel([("navigate_to", '{"destination": "Pharmacy"}')]) as model:
        ...                     # a client of `model.url`
        model.told              # what each tool's answer was, as the model saw it

Each turn is the calls of one answer, names and raw arguments; after the last turn it says `done`.
Answers whole or as a stream, as it is asked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from typing import Any, Self

#: One call: a tool's name, and its arguments as a model writes them.
Call = tuple[str, str]


class ScriptedModel:
    """The server.

    Args:
        turns: what is answered, in order; a function is called first, before the calls are said.
    """

    def __init__(self, *turns: Sequence[Call] | Callable[[], Sequence[Call]]) -> None:
        self._turns = list(turns)
        self._lock = Lock()
        #: The bodies of the requests, in order.
        self.asked: list[dict[str, Any]] = []
        handler = type("Handler", (_Handler,), {"model": self})
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self._thread = Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def url(self) -> str:
        """The base address for a client."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/v1"

    @property
    def told(self) -> list[str]:
        """What the tools' answers were, as the last request holds them."""
        messages = self.asked[-1]["messages"] if self.asked else []
        return [str(m["content"]) for m in messages if m["role"] == "tool"]

    @property
    def shown(self) -> dict[str, dict[str, Any]]:
        """The tools that the model was shown first, by name."""
        return {t["function"]["name"]: t["function"] for t in self.asked[0].get("tools", ())}

    def answer(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Return the message of the next turn."""
        with self._lock:
            number = len(self.asked)
            self.asked.append(asked)
            turn = self._turns[number] if number < len(self._turns) else ()
        calls = turn() if callable(turn) else turn
        if not calls:
            return {"role": "assistant", "content": "done"}
        made = [
            {
                "id": f"call_{number}_{at}",
                "type": "function",
                "function": {"name": name, "arguments": arguments},
            }
            for at, (name, arguments) in enumerate(calls)
        ]
        return {"role": "assistant", "content": None, "tool_calls": made}


class _Handler(BaseHTTPRequestHandler):
    model: ScriptedModel
    protocol_version = "HTTP/1.0"  # no connection outlives its answer: clients end with their loops

    def do_POST(self) -> None:
        asked = json.loads(self.rfile.read(int(self.headers["content-length"])))
        message = self.model.answer(asked)
        ended = "tool_calls" if "tool_calls" in message else "stop"
        reply = {"id": "chatcmpl-0", "created": 0, "model": "scripted"}
        usage = {"prompt_tokens": 1, "completion_tokens": 1, "total_tokens": 2}
        if asked.get("stream"):
            calls = [{"index": at, **c} for at, c in enumerate(message.get("tool_calls", ()))]
            delta = {**message, **({"tool_calls": calls} if calls else {})}
            reply["object"] = "chat.completion.chunk"
            chunks = [
                {**reply, "choices": [{"index": 0, "delta": delta, "finish_reason": None}]},
                {**reply, "choices": [{"index": 0, "delta": {}, "finish_reason": ended}]},
                {**reply, "choices": [], "usage": usage},
            ]
            text = "".join(f"data: {json.dumps(chunk)}\n\n" for chunk in chunks)
            self._say("text/event-stream", text + "data: [DONE]\n\n")
            return
        choice = {"index": 0, "finish_reason": ended, "message": message}
        reply |= {"object": "chat.completion", "choices": [choice], "usage": usage}
        self._say("application/json", json.dumps(reply))

    def _say(self, kind: str, text: str) -> None:
        body = text.encode()
        self.send_response(200)
        self.send_header("content-type", kind)
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Say nothing."""
