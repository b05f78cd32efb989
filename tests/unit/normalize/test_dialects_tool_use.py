# SPDX-License-Identifier: Apache-2.0
"""Anthropic replies and MCP requests: what is a call, what is prose, what refuses the whole."""

from __future__ import annotations

import json
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from fixtures.cases import case
from unit.normalize.writers import as_anthropic, as_mcp

GO = ("go", {"to": "Dock"})
USE = {"type": "tool_use", "id": "toolu_1", "name": "go", "input": {"to": "Dock"}}


def refused(
    text: str, where: str, dialect: Dialect, reason: Reason = Reason.MALFORMED
) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


# -- Anthropic -------------------------------------------------------------------------------------


def message(*blocks: Any, **changes: Any) -> str:
    return as_anthropic(content=list(blocks), **changes)


def without(name: str) -> str:
    whole = json.loads(as_anthropic(GO))
    del whole[name]
    return json.dumps(whole)


@pytest.mark.parametrize("reason", ["tool_use", "end_turn"])
def test_a_finished_message_is_its_tool_use_blocks_in_order(reason: str) -> None:
    text = message(
        {"type": "thinking", "thinking": "go(to='elsewhere')", "signature": "x"},
        {"type": "redacted_thinking", "data": "x"},
        USE,
        {"type": "text", "text": '{"tool": "stop", "arguments": {}}'},
        {**USE, "id": "toolu_2", "name": "nod", "input": {}, "caller": {"type": "direct"}},
        stop_reason=reason,
    )
    assert read_plan(text, Dialect.AUTO) == (
        Call("go", {"to": "Dock"}, "content[2].input", "content[2].name"),
        Call("nod", {}, "content[4].input", "content[4].name"),
    )


@pytest.mark.parametrize("name", ["type", "role", "model", "usage", "id"])
def test_a_message_may_leave_out_what_says_nothing_about_its_calls(name: str) -> None:
    assert len(read_plan(without(name), Dialect.ANTHROPIC)) == 1


def test_a_message_that_did_not_finish_is_refused() -> None:
    for reason in [
        "max_tokens",
        "stop_sequence",
        "pause_turn",
        "refusal",
        "model_context_window_exceeded",
        "",
        None,
        True,
        1,
        ["tool_use"],
        {},
    ]:
        with case(reason):
            refused(message(USE, stop_reason=reason), "stop_reason", Dialect.ANTHROPIC)


def test_a_message_that_does_not_say_how_it_ended_is_refused() -> None:
    refused(without("stop_reason"), "stop_reason", Dialect.ANTHROPIC)


def test_a_block_of_another_type_refuses_the_good_ones_beside_it() -> None:
    """What a server ran by itself was never judged here (L1)."""
    for kind in [
        "server_tool_use",
        "mcp_tool_use",
        "tool_result",
        "web_search_tool_result",
        "image",
        "Tool_use",
        "tool_use ",
        "",
    ]:
        with case(kind):
            refused(message(USE, {**USE, "type": kind}), "content[1].type", Dialect.ANTHROPIC)


def test_a_message_that_is_no_plan_is_refused_in_its_place() -> None:
    for text, where in [
        ("[]", "input"),
        (without("content"), "content"),
        (as_anthropic(content={}), "content"),
        (as_anthropic(content="go()"), "content"),
        (message(None), "content[0]"),
        (message("go()"), "content[0]"),
        (message({}), "content[0].type"),
        (message({**USE, "type": None}), "content[0].type"),
        (message({**USE, "id": None}), "content[0].id"),
        (message({"type": "tool_use", "name": "go", "input": {}}), "content[0].id"),
        (message({**USE, "name": None}), "content[0].name"),
        (message({**USE, "input": None}), "content[0].input"),
        (message({**USE, "input": []}), "content[0].input"),
        (message({**USE, "input": '{"to": "Dock"}'}), "content[0].input"),
        (message({**USE, "caller": "direct"}), "content[0].caller"),
        (
            message({**USE, "caller": {"type": "code_execution_20250825", "tool_id": "x"}}),
            "content[0].caller",
        ),
        (message(USE, type="error"), "type"),
        (message(USE, type=None), "type"),
        (message(USE, role="user"), "role"),
    ]:
        with case(text, where):
            refused(text, where, Dialect.ANTHROPIC)


def test_a_tool_use_block_has_no_other_field() -> None:
    text = message({**USE, "approved": True})
    refused(text, "content[0].approved", Dialect.ANTHROPIC, Reason.FIELD_UNKNOWN)


def test_a_message_that_only_talks_is_an_empty_plan() -> None:
    for blocks in ([], [{"type": "text", "text": "go()"}]):
        text = message(*blocks, stop_reason="end_turn")
        refused(text, "input", Dialect.ANTHROPIC, Reason.PLAN_EMPTY)


# -- MCP -------------------------------------------------------------------------------------------


def request(**changes: Any) -> str:
    return json.dumps({**json.loads(as_mcp(GO)), **changes})


def params(**changes: Any) -> str:
    return request(params={"name": "go", "arguments": {}, **changes})


def test_one_request_and_a_list_of_them_are_read_with_their_places() -> None:
    def at(request: str) -> Call:
        return Call(*GO, f"{request}.params.arguments", f"{request}.params.name")

    assert read_plan(as_mcp(GO), Dialect.MCP) == (at("input"),)
    assert read_plan(as_mcp(GO, GO), Dialect.MCP) == (at("input[0]"), at("input[1]"))


@pytest.mark.parametrize("name", [{"id": "a-1"}, {"id": 7}, {"id": 0}])
def test_a_request_may_have_any_id_of_the_protocol(name: dict[str, Any]) -> None:
    assert read_plan(request(**name), Dialect.MCP)[0].tool == "go"


@pytest.mark.parametrize("extra", [{}, {"_meta": {}}])
def test_a_request_may_leave_out_arguments_and_say_nothing_beside_them(extra: Any) -> None:
    text = request(params={"name": "nod", **extra})
    assert read_plan(text, Dialect.AUTO)[0].arguments == {}


def test_a_request_that_is_no_tool_call_is_refused_in_its_place() -> None:
    for text, where in [
        ('"tools/call"', "input"),
        ("[[]]", "input[0]"),
        (request(jsonrpc="1.0"), "input.jsonrpc"),
        (request(jsonrpc=2.0), "input.jsonrpc"),
        (request(jsonrpc=None), "input.jsonrpc"),
        (request(method="tools/list"), "input.method"),
        (request(method="Tools/Call"), "input.method"),
        (request(method="resources/read"), "input.method"),
        (request(method=None), "input.method"),
        (request(id=None), "input.id"),
        (request(id=True), "input.id"),
        (request(id=1.5), "input.id"),
        (request(id=[1]), "input.id"),
        (request(params=None), "input.params"),
        (request(params=["go"]), "input.params"),
        (params(name=None), "input.params.name"),
        (params(arguments=False), "input.params.arguments"),
        (params(arguments=[]), "input.params.arguments"),
        (params(arguments="{}"), "input.params.arguments"),
        ("[" + request(id=1) + "," + request(id=1) + "]", "input[1].id"),
    ]:
        with case(text, where):
            refused(text, where, Dialect.MCP)


def test_a_notification_is_refused_because_nobody_would_hear_of_a_refusal() -> None:
    whole = json.loads(as_mcp(GO))
    del whole["id"]
    refused(json.dumps(whole), "input.id", Dialect.MCP)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        (request(tool="go"), "input.tool"),
        (request(result={}), "input.result"),
        (params(task={"ttl": 1}), "input.params.task"),
        (
            params(_meta={"progressToken": 1, "authguard-r/key": "x"}),
            "input.params._meta.authguard-r/key",
        ),
        (params(_meta={"x": 1}), "input.params._meta.x"),
    ],
)
def test_a_request_has_no_other_field(text: str, where: str) -> None:
    refused(text, where, Dialect.MCP, Reason.FIELD_UNKNOWN)


def test_an_empty_list_of_requests_is_an_empty_plan() -> None:
    refused("[]", "input", Dialect.MCP, Reason.PLAN_EMPTY)
