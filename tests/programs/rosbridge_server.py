# SPDX-License-Identifier: Apache-2.0
"""The socket behind ros-mcp: speaks as much of rosbridge's protocol as its tools ask for.

Run by the environment that ros-mcp is in, which brings `websockets`. What arrives is written down:
what is not in that file never reached the robot.

    python rosbridge_server.py ARRIVED.jsonl

Its port is the first line that it prints.
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from websockets.asyncio.server import ServerConnection, serve

ARRIVED = Path(sys.argv[1])
SERVICES: dict[str, dict[str, Any]] = {
    "/rosapi/get_ros_version": {"version": 2, "distro": "kilted"},
    "/rosapi/topics": {"topics": ["/cmd_vel"], "types": ["geometry_msgs/msg/Twist"]},
}


def answers(asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a robot's rosbridge says to a request."""
    same = {key: asked[key] for key in ("id", "service", "action") if key in asked}
    if asked["op"] == "call_service":
        values = SERVICES.get(asked["service"])
        return [{"op": "service_response", **same, "values": values, "result": values is not None}]
    if asked["op"] == "send_action_goal":
        return [
            {"op": "action_feedback", **same, "values": {"distance_remaining": 1.0}},
            {"op": "action_result", **same, "values": {}, "status": 4, "result": True},
        ]
    return [{"op": "status", "level": "info", "msg": asked["op"]}]


async def _serve(socket: ServerConnection) -> None:
    async for raw in socket:
        asked = json.loads(raw)
        with ARRIVED.open("a") as file:
            file.write(json.dumps(asked) + "\n")
        for answer in answers(asked):
            await socket.send(json.dumps(answer))


async def _main() -> None:
    async with serve(_serve, "127.0.0.1", 9090) as server:
        print(next(iter(server.sockets)).getsockname()[1], flush=True)
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(_main())
