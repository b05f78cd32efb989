# SPDX-License-Identifier: Apache-2.0
"""Run in another package's environment: which of its tools are guarded, and which are refused.

python list_robot_tools.py EXAMPLE --run run --trust trust --site site.yaml --binding binding
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.langchain import GuardedTool, guard_tools

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "adapters"))

#: All that a package has, by the example of it.
EVERY: dict[str, Any] = {
    "rosa_courier": lambda example, _: example.ROSATools(ros_version=2).get_tools(),
    "rai_courier": lambda example, connector: example.every_tool(connector),
}
#: What the example's agent can call; of ROSA the executor's own list.
AGENT: dict[str, Any] = {
    "rosa_courier": lambda example, guard, _: example.agent(guard)._ROSA__executor.tools,
    "rai_courier": lambda example, guard, connector: example.agent_tools(guard, connector),
}


def main() -> None:
    """Print a JSON object: `guarded` and `refused` by name, and `given`, what the agent has."""
    asks = argparse.ArgumentParser()
    asks.add_argument("example")
    for name in ("robot", "run", "trust", "site", "binding"):
        asks.add_argument(f"--{name}", required=True)
    given = vars(asks.parse_args())
    name = given.pop("example")
    example = import_module(name)
    connector = example.ROS2Connector() if name == "rai_courier" else None
    guarded, refused = [], {}
    with GateGuard.connect(**given) as guard:
        for tool in EVERY[name](example, connector):
            try:
                (made,) = guard_tools(guard, [tool])
            except MalformedError as error:
                refused[tool.name] = error.reason
            else:
                assert isinstance(made, GuardedTool)
                guarded.append(made.name)
    with GateGuard.connect(**given) as guard:
        tools = AGENT[name](example, guard, connector)
        assert all(isinstance(tool, GuardedTool) for tool in tools)
        names = sorted(tool.name for tool in tools)
    print(json.dumps({"guarded": sorted(guarded), "refused": refused, "given": names}))
    if connector is not None:
        connector.shutdown()


if __name__ == "__main__":
    main()
