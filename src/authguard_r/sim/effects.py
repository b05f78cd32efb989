# SPDX-License-Identifier: Apache-2.0
"""What the standard words do to things and settings; motion and gripping are `world`'s.

A thing has conditions (`open`, `on`, `broken`, `filled-3`), the robot has settings (its gait, its
lamp). Physics only: whether anything of this is allowed, or wise, is decided elsewhere. Source:
`eq:transition`. How-to: docs/howto/simulator.md
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ObjectId, ParameterId
from authguard_r.sim.state import WorldState

MAX_BYTES = ParameterId("max_bytes")
LIQUID = ParameterId("liquid_no")

Effect = Callable[[WorldState, Action], WorldState | None]

#: For each type that changes a thing at hand: the conditions that it ends, and the one it begins.
_CONDITIONS: dict[str, tuple[frozenset[str], str | None]] = {
    "open": (frozenset(), "open"),
    "close": (frozenset({"open"}), None),
    "turn_on": (frozenset(), "on"),
    "turn_off": (frozenset({"on"}), None),
    "slice": (frozenset(), "sliced"),
    "break": (frozenset(), "broken"),
    "cook": (frozenset(), "cooked"),
    "dirty": (frozenset(), "dirty"),
    "clean": (frozenset({"dirty"}), None),
    "use_up": (frozenset(), "used-up"),
    "door_lock": (frozenset(), None),
}
#: Types that leave the world as it is: they look, speak, or stand still.
_IDLE = frozenset(
    {
        *("announce", "calculate", "describe", "find", "hold", "plan_path", "read_metadata"),
        *("scan_obstacles", "stop_sound", "wait"),
    }
)
#: Types whose parameters are a setting of the robot.
_SETTINGS = frozenset(
    {
        "arm_pose",
        "brake",
        "climate",
        "cruise",
        "door_lock",
        "engine",
        "gait",
        "gesture",
        "grip",
        "headlights",
        "lamp",
        "move_arm",
        "move_joint",
        "parking_brake",
        "play_sound",
        "refuel",
        "set_volume",
        "undock",
    }
)
#: Types whose object need not be near: a topic is read wherever the robot is.
_FAR = frozenset({"describe", "read_sensor"})
_RECORDING = frozenset({"inspect", "read_sensor", "record_video", "survey", "take_photo"})
#: A cabinet, a table or a sink holds many things; what is put in is what the hand held.
_FROM_HAND = frozenset({"drop", "put_in", "throw"})


def effect(state: WorldState, action: Action) -> WorldState | None:
    """Return the state after the action's effect on things and settings, or None for bottom."""
    item = action.object
    if item is not None and action.type not in _FAR and not at_hand(state, item):
        return None
    if action.type in _IDLE:
        return state
    if action.type in _FROM_HAND:
        return _let_go(state, action)
    if action.type in {"fill", "empty", "pour"}:
        return _liquid(state, action)
    if action.type in _RECORDING:
        return recorded(state, action)
    if action.type in _CONDITIONS or action.type in _SETTINGS:
        return _set(_changed(state, action), action)
    return None


def at_hand(state: WorldState, item: ObjectId) -> bool:
    """True when the thing is in the hand or lies in the region where the robot is."""
    return item == state.holding or state.places.get(item) == state.region


def recorded(state: WorldState, action: Action) -> WorldState:
    """Return the state after sensor data of the region was recorded."""
    return msgspec.structs.replace(
        state,
        recorded_bytes=state.recorded_bytes + action.params.get(MAX_BYTES, 0),
        recordings=(*state.recordings, state.region),
    )


def _changed(state: WorldState, action: Action) -> WorldState:
    ends, begins = _CONDITIONS.get(action.type, (frozenset[str](), None))
    if action.object is None:
        return state
    now = {c for c in state.things.get(action.object, ()) if c not in ends}
    return _with_conditions(state, action.object, now | ({begins} if begins else set()))


def _set(state: WorldState, action: Action) -> WorldState:
    """Return the state with the action's parameters as the last setting of their kind."""
    if action.type not in _SETTINGS:
        return state
    settings = {f"{action.type}.{name}": value for name, value in action.params.items()}
    return msgspec.structs.replace(state, settings={**state.settings, **settings})


def _let_go(state: WorldState, action: Action) -> WorldState | None:
    item = state.holding
    if item is None or action.object == item:
        return None
    inside = {thing: there for thing, there in state.inside.items() if thing != item}
    if action.object is not None:
        inside[item] = action.object
    after = msgspec.structs.replace(
        state, holding=None, places={**state.places, item: state.region}, inside=inside
    )
    if action.type != "throw":
        return after
    return _with_conditions(after, item, {*state.things.get(item, ()), "thrown"})


def _liquid(state: WorldState, action: Action) -> WorldState | None:
    """Return the state after a vessel was filled, emptied, or poured from the hand."""
    item = state.holding if action.type == "pour" else action.object
    if item is None:
        return None
    dry = {c for c in state.things.get(item, ()) if not c.startswith("filled-")}
    if action.type == "fill":
        return _with_conditions(state, item, dry | {f"filled-{action.params.get(LIQUID, 0)}"})
    if len(dry) == len(state.things.get(item, ())):
        return None  # there is nothing in it
    return _with_conditions(state, item, dry)


def _with_conditions(state: WorldState, item: ObjectId, conditions: set[str]) -> WorldState:
    things = {thing: held for thing, held in state.things.items() if thing != item}
    if conditions:
        things[item] = tuple(sorted(conditions))
    return msgspec.structs.replace(state, things=things)
