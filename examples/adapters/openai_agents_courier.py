# SPDX-License-Identifier: Apache-2.0
"""An agent of the OpenAI Agents SDK whose tools go through a gate that runs.

    OPENAI_BASE_URL=http://127.0.0.1:8000/v1 OPENAI_API_KEY=none \
        python examples/adapters/openai_agents_courier.py RUN SITE BINDING TRUST MODEL TASK

It moves nothing: it says what is called on standard error.
"""

from __future__ import annotations

import asyncio
import sys

from agents import Agent, OpenAIChatCompletionsModel, RunConfig, Runner, function_tool
from openai import AsyncOpenAI

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.openai_agents import guard_agent


@function_tool
def navigate_to(destination: str, speed: float | None = None) -> str:
    """Drive to a place, at so many meters a second."""
    sys.stderr.write(f"called: navigate_to {destination} at {speed} m/s\n")
    return "arrived"


@function_tool
async def scan() -> str:
    """Look around."""
    sys.stderr.write("called: scan\n")
    return "nothing is in the way"


def main() -> None:
    """Give a task to an agent."""
    run, site, binding, trust, model, task = sys.argv[1:]
    client = AsyncOpenAI()
    agent = Agent(
        name="courier",
        model=OpenAIChatCompletionsModel(model, client),
        tools=[navigate_to, scan],
    )
    with GateGuard.connect(
        robot="courier-1", run=run, site=site, binding=binding, trust=trust
    ) as guard:
        guarded = guard_agent(guard, agent)
        config = RunConfig(tracing_disabled=True)
        found = asyncio.run(Runner.run(guarded, task, run_config=config))
    sys.stdout.write(f"{found.final_output}\n")


if __name__ == "__main__":
    main()
