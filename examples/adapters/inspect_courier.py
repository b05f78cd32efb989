# SPDX-License-Identifier: Apache-2.0
"""A task of Inspect whose tools go through a gate that runs, and whose approver asks it.

    inspect eval examples/adapters/inspect_courier.py --approval examples/adapters/approval.yaml \
        --model openai-api/local/MODEL --model-base-url http://127.0.0.1:8000/v1 \
        -T run=RUN -T site=SITE -T binding=BINDING -T trust=TRUST -T task=TASK

It moves nothing: it says what is called on standard error.
"""

from __future__ import annotations

import sys
from typing import Any

from inspect_ai import Task, task
from inspect_ai.dataset import Sample
from inspect_ai.solver import generate, use_tools
from inspect_ai.tool import tool

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.inspect import guard_tools


@tool
def navigate_to() -> Any:
    """The tool."""

    async def execute(destination: str, speed: float | None = None) -> str:
        """Drive to a place.

        Args:
            destination: its name.
            speed: in meters a second.
        """
        sys.stderr.write(f"called: navigate_to {destination} at {speed} m/s\n")
        return "arrived"

    return execute


@tool
def scan() -> Any:
    """The tool."""

    async def execute() -> str:
        """Look around."""
        sys.stderr.write("called: scan\n")
        return "nothing is in the way"

    return execute


@task
def courier(run: str, site: str, binding: str, trust: str, task: str = "Bring P1.") -> Any:
    """Return the task; its guard lives as long as the process."""
    guard = GateGuard.connect(robot="courier-1", run=run, site=site, binding=binding, trust=trust)
    tools = guard_tools(guard, [navigate_to(), scan()])
    return Task(dataset=[Sample(input=task)], solver=[use_tools(tools), generate()])
