# SPDX-License-Identifier: Apache-2.0
"""Telling a person at the planner's client that a call waits for approval.

An elicitation only asks: what is answered there approves nothing, and makes the same call be
proposed once more. Whether the approvals are there by then, the gate decides by their signatures.
Spec page: docs/spec/mcp.md#approvals
"""

from __future__ import annotations

import asyncio
from enum import Enum
from typing import Any

import mcp_types as types
from mcp import MCPError
from mcp_types.version import MODERN_PROTOCOL_VERSIONS

#: A person is waited for so long, in seconds; a request for approval runs out by itself.
PERSON_S = 600.0
#: Nothing is asked for but a yes.
_FORM: types.ElicitRequestedSchema = {"type": "object", "properties": {}}
_KEY = "approval"


class PersonAnswer(Enum):
    """What a client's person has said to the question before."""

    NO = "no"
    ELSE = "else"  # a yes, or anything: it makes nothing lawful


def said(params: types.CallToolRequestParams) -> PersonAnswer | None:
    """Return what a person has answered; None when no person was asked."""
    if params.input_responses is None:
        return None
    answers = params.input_responses.values()
    declined = any(getattr(answer, "action", "accept") != "accept" for answer in answers)
    return PersonAnswer.NO if declined else PersonAnswer.ELSE


def can_ask(ctx: Any) -> bool:
    """True of a client that says that it can show a form."""
    declared = ctx.session.client_capabilities
    return declared is not None and declared.elicitation is not None


def is_modern(ctx: Any) -> bool:
    """True of a client that is asked by an answer, and asks again itself."""
    return ctx.session.protocol_version in MODERN_PROTOCOL_VERSIONS


def words(tool: str, required: object) -> str:
    """Return the text for a person."""
    people = "approval" if required == 1 else "approvals"
    return (
        f"`{tool}` needs {required} {people}, the issuer's included, and not all are signed "
        "(`authguard approvals list`). Accept to propose it again; accepting approves nothing."
    )


def question(tool: str, required: object) -> types.InputRequiredResult:
    """Return the answer that makes a modern client ask its person, and call again."""
    form = types.ElicitRequestFormParams(message=words(tool, required), requested_schema=_FORM)
    return types.InputRequiredResult(input_requests={_KEY: types.ElicitRequest(params=form)})


async def asked_to_go_on(ctx: Any, tool: str, required: object) -> bool:
    """Ask a legacy client's person; False without a yes."""
    try:
        async with asyncio.timeout(PERSON_S):
            said = await ctx.session.elicit_form(
                words(tool, required), _FORM, related_request_id=ctx.request_id
            )
    except (MCPError, TimeoutError, ValueError):
        return False
    return bool(said.action == "accept")
