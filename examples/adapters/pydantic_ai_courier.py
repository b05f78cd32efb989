# SPDX-License-Identifier: Apache-2.0
"""An agent of Pydantic AI whose tools go through a gate that runs.

    OPENAI_BASE_URL=http://127.0.0.1:8000/v1 OPENAI_API_KEY=none \
        python examples/adapters/pydantic_ai_courier.py RUN SITE BINDING TRUST MODEL TASK

It moves nothing: it says what is called on standard error.
"""

from __future__ import annotations

import sys

from pydantic_ai import Agent, RunContext, UsageLimits
from pydantic_ai.models.openai import OpenAIChatModel

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.pydantic_ai import guard_tools


def navigate_to(ctx: RunContext[str], destination: str, speed: float | None = None) -> str:
    """Drive to a place, at so many meters a second."""
    sys.stderr.write(f"called: navigate_to {destination} at {speed} m/s for {ctx.deps}\n")
    return "arrived"


async def scan() -> str:
    """Look around."""
    sys.stderr.write("called: scan\n")
    return "nothing is in the way"


def main() -> None:
    """Give a task to an agent."""
    run, site, binding, trust, model, task = sys.argv[1:]
    with GateGuard.connect(
        robot="courier-1", run=run, site=site, binding=binding, trust=trust
    ) as guard:
        toolset = guard_tools(guard, [navigate_to, scan])
        agent = Agent(OpenAIChatModel(model), deps_type=str, toolsets=[toolset])
        limits = UsageLimits(request_limit=20)  # how often a model may insist on what is refused
        found = agent.run_sync(task, deps="the ward", usage_limits=limits)
    sys.stdout.write(f"{found.output}\n")


if __name__ == "__main__":
    main()
