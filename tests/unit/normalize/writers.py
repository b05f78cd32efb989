# SPDX-License-Identifier: Apache-2.0
"""Writers of every dialect, so that a law can be stated once: what was written is what is read.

Our own sentences and names throughout. A writer writes only what its dialect can say; the
strategies beside it draw only that.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from decimal import Decimal
from typing import Any

from authguard_r.normalize.dialects import Dialect
from unit.normalize.dialogue import as_calls, as_openai

#: A call: the tool's external name and its arguments.
Call = tuple[str, dict[str, Any]]


def dumps(value: Any) -> str:
    """Write JSON with exact decimals."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)}: {dumps(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(dumps, value)) + "]"
    return str(value) if isinstance(value, Decimal) else json.dumps(value)


def positional(arguments: dict[str, Any]) -> list[Any]:
    return [value for name, value in arguments.items() if name.isdigit()]


def as_anthropic(*calls: Call, **changes: Any) -> str:
    """A whole Messages reply; keyword arguments replace fields of it."""
    content: list[Any] = [{"type": "text", "text": "go(to='elsewhere')", "citations": None}]
    content += [
        {"type": "tool_use", "id": f"toolu_{number}", "name": tool, "input": arguments}
        for number, (tool, arguments) in enumerate(calls)
    ]
    whole = {
        "id": "msg_1",
        "type": "message",
        "role": "assistant",
        "model": "local-planner",
        "content": content,
        "stop_reason": "tool_use",
        "stop_sequence": None,
        "usage": {"input_tokens": 9, "output_tokens": 9},
        **changes,
    }
    return dumps(whole)


def as_mcp(*calls: Call) -> str:
    requests = [
        {
            "jsonrpc": "2.0",
            "id": number,
            "method": "tools/call",
            "params": {"name": tool, "arguments": arguments},
        }
        for number, (tool, arguments) in enumerate(calls)
    ]
    return dumps(requests[0] if len(requests) == 1 else requests)


def literal(value: Any) -> str:
    if isinstance(value, str | bool):
        return repr(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k!r}: {literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(literal, value)) + "]"
    return str(value)


def code(call: Call) -> str:
    tool, arguments = call
    parts = [
        literal(value) if name.isdigit() else f"{name}={literal(value)}"
        for name, value in arguments.items()
    ]
    return f"{tool}({', '.join(parts)})"


def as_python(*calls: Call) -> str:
    return "# a plan\n" + "\n".join(map(code, calls))


def as_go2(*calls: Call) -> str:
    return "\n".join(map(code, calls))


def as_badrobot(*calls: Call) -> str:
    return repr({"function": [code(call) for call in calls], "response": "right away"})


def as_badrobot_json(*calls: Call) -> str:
    return json.dumps({"function": [code(call) for call in calls], "response": "right away"})


def spine_list(*calls: Call) -> str:
    return (
        "[" + ", ".join(f"{tool}({', '.join(map(str, positional(a)))})" for tool, a in calls) + "]"
    )


def as_spine(*calls: Call) -> str:
    return json.dumps({"primary_goal": "look", "reasoning": "[go(a)]", "plan": spine_list(*calls)})


def as_spine_tuples(*calls: Call) -> str:
    rows = ", ".join(f"({t!r},{','.join(map(literal, positional(a)))})" for t, a in calls)
    return json.dumps({"plan": f"[{rows}]"})


def as_spine_rows(*calls: Call) -> str:
    return dumps({"plan": [[tool, *positional(a)] for tool, a in calls]})


def as_steps(*calls: Call) -> str:
    return "\n".join(" ".join([tool, *positional(a)]) for tool, a in calls)


def as_numbered(*calls: Call) -> str:
    lines = as_steps(*calls).split("\n")
    return "\n".join(f"{number}. {line}" for number, line in enumerate(lines, 1))


def as_step_list(*calls: Call) -> str:
    return json.dumps(as_steps(*calls).split("\n"))


def as_ros2(*calls: Call) -> str:
    operations = [{"op": tool, "id": "x", **arguments} for tool, arguments in calls]
    return dumps(operations[0] if len(operations) == 1 else operations)


def as_responses(*calls: Call) -> str:
    items: list[Any] = [{"type": "message", "content": [{"text": "go(to='elsewhere')"}]}]
    items += [
        {"type": "function_call", "call_id": "c", "name": tool, "arguments": dumps(arguments)}
        for tool, arguments in calls
    ]
    return json.dumps({"object": "response", "status": "completed", "output": items})


def as_gemini(*calls: Call) -> str:
    parts: list[Any] = [{"text": "go(to='elsewhere')"}]
    parts += [{"functionCall": {"name": tool, "args": arguments}} for tool, arguments in calls]
    return dumps({"candidates": [{"content": {"parts": parts}, "finishReason": "STOP"}]})


def as_bedrock(*calls: Call) -> str:
    blocks: list[Any] = [{"text": "go(to='elsewhere')"}]
    blocks += [{"toolUse": {"toolUseId": "t", "name": tool, "input": a}} for tool, a in calls]
    return dumps({"output": {"message": {"content": blocks}}, "stopReason": "tool_use"})


def as_ollama(*calls: Call) -> str:
    asked = [{"function": {"name": tool, "arguments": arguments}} for tool, arguments in calls]
    return dumps({"message": {"content": "go()", "tool_calls": asked}, "done": True})


def as_langchain(*calls: Call) -> str:
    asked = [{"name": tool, "args": arguments, "id": "1"} for tool, arguments in calls]
    return dumps({"type": "ai", "content": "go()", "tool_calls": asked})


def named(tool: str, arguments: dict[str, Any], key: str = "arguments") -> str:
    return dumps({"name": tool, key: arguments})


def as_hermes(*calls: Call) -> str:
    return "Off.\n" + "\n".join(f"<tool_call>\n{named(*call)}\n</tool_call>" for call in calls)


def as_mistral(*calls: Call) -> str:
    return f"[TOOL_CALLS] [{', '.join(named(*call) for call in calls)}]"


def as_mistral_names(*calls: Call) -> str:
    return "".join(f"[TOOL_CALLS]{tool}[ARGS]{dumps(arguments)}" for tool, arguments in calls)


def as_llama(*calls: Call) -> str:
    return "<|python_tag|>" + "; ".join(named(*call, "parameters") for call in calls)


def as_pythonic(*calls: Call) -> str:
    return "[" + ", ".join(map(code, calls)) + "]"


def as_deepseek(*calls: Call) -> str:
    block = chr(0x2581)

    def tag(words: str) -> str:
        return f"<\uff5c{words.replace(' ', block)}\uff5c>"

    begin, sep, end = tag("tool call begin"), tag("tool sep"), tag("tool call end")
    inner = "".join(f"{begin}{tool}{sep}{dumps(a)}{end}" for tool, a in calls)
    return tag("tool calls begin") + inner + tag("tool calls end")


def as_exact_openai(*calls: Call) -> str:
    whole = json.loads(as_openai(*[(tool, {}) for tool, _ in calls]))
    items = whole["choices"][0]["message"]["tool_calls"]
    for item, (_, arguments) in zip(items, calls, strict=True):
        item["function"]["arguments"] = dumps(arguments)
    return json.dumps(whole)


def as_bare(*calls: Call) -> str:
    return dumps({"plan": [{"tool": tool, "arguments": a} for tool, a in calls]})


def as_exact_calls(*calls: Call) -> str:
    """Call text with exact decimals."""
    return "\n".join(
        f"{tool}({', '.join(f'{name}={_plain(item)}' for name, item in arguments.items())})"
        for tool, arguments in calls
    )


def _plain(value: Any) -> str:
    return str(value) if isinstance(value, Decimal) else as_calls(("", {"": value}))[2:-1]


#: One sample plan a writer, of two calls that its dialect can say.
NAMED: tuple[Call, ...] = (("go", {"to": "Dock", "speed": Decimal("0.8")}), ("scan", {}))
NESTED: tuple[Call, ...] = (("go", {"pose": {"x": Decimal("-1.50"), "via": ["A", True]}}), NAMED[1])
PLACED: tuple[Call, ...] = (("goto", {"1": "dock_1"}), ("map_it", {"1": 3, "2": Decimal("-0.5")}))
HOUSE: tuple[Call, ...] = (("find", {"1": "Blue Cup"}), ("fill_liquid", {"1": "Cup", "2": "milk"}))
DRIVE: tuple[Call, ...] = (("accelerate", {}), ("turn_left", {}))
GOALS: tuple[Call, ...] = (
    (
        "send_action_goal",
        {"action": "/go", "action_type": "m/action/Go", "args": {"pose": {"x": 1}}},
    ),
    ("publish", {"topic": "/cmd", "msg": {"linear": {"x": Decimal("0.25")}}}),
)

#: Every way to write each dialect: (its name, the writer, what it can say).
WAYS: dict[str, tuple[Dialect, Callable[..., str], tuple[Call, ...]]] = {
    "openai": (Dialect.OPENAI, as_exact_openai, NESTED),
    "anthropic": (Dialect.ANTHROPIC, as_anthropic, NESTED),
    "responses": (Dialect.RESPONSES, as_responses, NESTED),
    "gemini": (Dialect.GEMINI, as_gemini, NESTED),
    "bedrock": (Dialect.BEDROCK, as_bedrock, NESTED),
    "ollama": (Dialect.OLLAMA, as_ollama, NESTED),
    "langchain": (Dialect.LANGCHAIN, as_langchain, NESTED),
    "mcp": (Dialect.MCP, as_mcp, NESTED),
    "hermes": (Dialect.HERMES, as_hermes, NESTED),
    "mistral": (Dialect.MISTRAL, as_mistral, NESTED),
    "mistral, names": (Dialect.MISTRAL, as_mistral_names, NESTED),
    "llama": (Dialect.LLAMA, as_llama, NESTED),
    "pythonic": (Dialect.PYTHONIC, as_pythonic, NESTED),
    "deepseek": (Dialect.DEEPSEEK, as_deepseek, NESTED),
    "json": (Dialect.JSON, as_bare, NESTED),
    "calls": (Dialect.CALLS, as_exact_calls, NAMED),
    "python": (Dialect.PYTHON, as_python, NESTED),
    "badrobot": (Dialect.BADROBOT, as_badrobot, NESTED),
    "badrobot in JSON": (Dialect.BADROBOT, as_badrobot_json, NESTED),
    "spine": (Dialect.SPINE, as_spine, PLACED),
    "spine, the bare list": (Dialect.SPINE, spine_list, PLACED),
    "spine, tuples": (Dialect.SPINE, as_spine_tuples, PLACED),
    "spine, rows": (Dialect.SPINE, as_spine_rows, PLACED),
    "go2": (Dialect.GO2, as_go2, NAMED),
    "dolphins": (Dialect.DOLPHINS, as_numbered, DRIVE),
    "steps": (Dialect.STEPS, as_steps, HOUSE),
    "steps, numbered": (Dialect.STEPS, as_numbered, HOUSE),
    "steps in JSON": (Dialect.STEPS, as_step_list, HOUSE),
    "ros2": (Dialect.ROS2, as_ros2, GOALS),
}
