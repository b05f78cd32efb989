# SPDX-License-Identifier: Apache-2.0
"""The hospital of the tests on ROS 2: what its mission grants, and a gate that holds it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from fixtures.gate_process import RunningGate
from fixtures.packaged_robots import gate_of

HERE = Path(__file__).resolve().parent
#: A mission of many short actions.
BUDGETS = {
    "actions": 10_000,
    "rate": {"count": 10_000, "per": "10 s"},
    "motion": "20 min",
    "waiting": "0 s",
    "recorded_bytes": 0,
    "prompts": 5,
    "planner_stops": 30,
}
IN_DOCK = {"source": "dock", "regions": ["dock"]}
#: What a module's tests do together, none by its own lot is kept from.
OFTEN = {"repeat": 1_000, "starts": 1_000}
GRANTS = (
    {
        "id": "wave",
        "type": "gesture",
        "tool": "arm",
        "rows": [IN_DOCK],
        "limits": {"gesture_no": [1, 20]},
        "max": "60 s",
        **OFTEN,
    },
    {"id": "honk", "type": "announce", "tool": "speaker", "rows": [{}], **OFTEN},
    {
        "id": "shine",
        "type": "lamp",
        "tool": "lamps",
        "rows": [{}],
        "limits": {"lamp_no": [0, 5]},
    },
    {
        "id": "creep",
        "type": "drive",
        "tool": "base",
        "rows": [IN_DOCK],
        "limits": {
            "linear_mm_s": ["-0.3 m/s", "0.3 m/s"],
            "lateral_mm_s": ["0 m/s", "0 m/s"],
            "turn_urad_s": ["-1 rad/s", "1 rad/s"],
            "duration_ms": ["1 s", "10 s"],
        },
    },
)
CHIME = {
    "id": "chime",
    "type": "play_sound",
    "tool": "speaker",
    "rows": [{}],
    "limits": {"sound_no": [0, 20]},
    "max": "60 s",
    "repeat": 200,
    "starts": 200,
}
#: Nav2's part: a walk along the corridor, and where goals of that name are and are not.
GO = {
    "id": "go",
    "type": "navigate",
    "tool": "base",
    "rows": [
        {
            "source": "dock",
            "destination": "pharmacy",
            "regions": ["dock", "pharmacy", "public-corridor"],
        }
    ],
    "limits": {"speed_mm_s": ["0.05 m/s", "0.8 m/s"]},
    "max": "3 min",
}
PHARMACY, ISOLATION = (4.2, 5.3), (21.0, -3.0)
TOOLS = {
    "gesture": ["arm"],
    "lamp": ["lamps"],
    "drive": ["base"],
    "play_sound": ["speaker"],
}
BESIDE = ("play_sound", "announce")
BRAKES = {"brake_mm_s2": 1000, "reaction_ms": 20}


#: What a map says beside what is mediated: what planners are shown, and that they write plans.
SHOWN = """
shown:
  sign: {type: std_msgs/msg/String, private: /sign, public: /llm/sign, by: /robot, channel: ocr}
  level: {type: std_msgs/msg/Float64, private: /level, public: /llm/level, by: /robot}
  bytes: {type: std_msgs/msg/UInt8MultiArray, private: /bytes, public: /llm/bytes, by: /robot}
proposals: {}
"""


def map_with_words(folder: Path) -> Path:
    """Return the hospital's map, in which planners write plans and are shown what robots say."""
    path = folder / "words.yaml"
    path.write_text((HERE / "map.yaml").read_text() + SHOWN)
    return path


@contextmanager
def hospital(binding: Path = HERE / "binding.yaml") -> Iterator[RunningGate]:
    """Yield a gate of it, in a folder whose sockets have short names; perhaps of other tools.

    Refusals in a row stop no robot: tests share the gate, and many of them are refused.
    """
    with gate_of(
        Path(mkdtemp(prefix="ag-ros-", dir="/tmp")),
        binding,
        tools=TOOLS,
        grants=(*GRANTS, CHIME),
        profile=BRAKES,
        beside=BESIDE,
        changes={"budgets": BUDGETS},
        fold_ms=0,
        refusals=0,
    ) as made:
        yield made
