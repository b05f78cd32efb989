# SPDX-License-Identifier: Apache-2.0
"""The safety policy S(s, a) of `eq:trace-safe`: the envelope of docs/spec/safety.md."""

from typing import Any

from authguard_reference.place import reading_of, unfit

Json = dict[str, Any]

#: In a rule, the action's own object.
THE_OBJECT = "the-object"
VELOCITY = ("linear_mm_s", "lateral_mm_s")


def believed(config: Json, variable: str, state: Json | None, facts: Json, now: Json) -> Any:
    """Look up a value that is fresh, trusted and of the configuration's robot.

    Args:
        config: The safety configuration.
        variable: The state variable.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The value, or None.
    """
    reading = reading_of(variable, state)
    own = {**facts, "robot": {"rid": config["rid"]}}
    if unfit(reading, config["max_age_ms"], state, own, now) != "" or reading is None:
        return None
    return reading["value"]


def speed_of(config: Json, action: Json, facts: Json) -> int | None:
    """Find how fast an action goes at most.

    Args:
        config: The safety configuration.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        Its speed in mm/s, None when nothing says it.
    """
    params = action.get("params", {})
    if "speed_mm_s" in params:
        return abs(int(params["speed_mm_s"]))
    known = facts["vocabulary"][action["type"]]["params"]
    if all(part in known for part in VELOCITY):
        if any(part not in params for part in VELOCITY):
            return None
        return sum(abs(int(params[part])) for part in VELOCITY)
    pace: int | None = config.get("paced", {}).get(action["type"])
    return pace


def motion_hazards(
    config: Json, action: Json, state: Json | None, facts: Json, now: Json
) -> list[str]:
    """Check the speed and the people near, for a type that moves.

    Args:
        config: The safety configuration.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        Every hazard.
    """
    if not facts["vocabulary"][action["type"]].get("moves", False):
        return []
    found: list[str] = []
    speed = speed_of(config, action, facts)
    if speed is None or speed > config["max_speed_mm_s"]:
        found.append("SPEED")
    distance = believed(config, "human_distance_mm", state, facts, now)
    if type(distance) is not int:
        found.append("STATE_UNKNOWN")
    elif distance > config["human_distance_mm"]:
        return found
    elif speed is None or speed > config["human_speed_mm_s"]:
        found.append("HUMAN_PROXIMITY")
    return found


def thing_hazards(config: Json, action: Json, facts: Json) -> list[str]:
    """Check the force and the load.

    Args:
        config: The safety configuration.
        action: The normalized action.
        facts: The facts of the site and the robot.

    Returns:
        Every hazard.
    """
    found: list[str] = []
    if "force_mn" in facts["vocabulary"][action["type"]]["params"]:
        force = action.get("params", {}).get("force_mn")
        if force is None or force > config["max_force_mn"]:
            found.append("FORCE")
    if "object" in action and action["type"] not in config.get("in_place", []):
        mass = config["masses_g"].get(action["object"])
        if mass is None or mass > config["max_payload_g"]:
            found.append("PAYLOAD")
    return found


def state_hazards(
    config: Json, action: Json, state: Json | None, facts: Json, now: Json
) -> list[str]:
    """Check what can be carried out in which state.

    Args:
        config: The safety configuration.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        NOT_EXECUTABLE for each rule that does not hold.
    """
    found: list[str] = []
    for rule in config.get("executable", []):
        if rule["type"] != action["type"]:
            continue
        wanted = action.get("object") if rule["equals"] == THE_OBJECT else rule["equals"]
        value = believed(config, rule["variable"], state, facts, now)
        if value is None or value != wanted:
            found.append("NOT_EXECUTABLE")
    return found


def hazards(config: Json, action: Json, state: Json | None, facts: Json, now: Json) -> list[str]:
    """Find every hazard of one action in one state.

    Args:
        config: The safety configuration, without rules and checker.
        action: The normalized action.
        state: The snapshot with its arrival, or None.
        facts: The facts of the site and the robot.
        now: The two clocks.

    Returns:
        The hazards, repeats included; none when the action is safe.
    """
    known = action["type"] in facts["vocabulary"]
    if not known or facts["robot"]["profile"] != config["profile"]:
        return ["STATE_UNKNOWN"]
    found = motion_hazards(config, action, state, facts, now)
    found += thing_hazards(config, action, facts)
    ends = [action["destination"]] if "destination" in action else []
    regions = [*ends, *action.get("route", [])]
    found += ["KEEP_OUT" for region in regions if region in config["keep_out"]]
    return found + state_hazards(config, action, state, facts, now)


def safe(config: Json, action: Json, state: Json | None, facts: Json, now: Json) -> bool:
    """Compute S(s, a).

    Args:
        config: As for hazards.
        action: As for hazards.
        state: As for hazards.
        facts: As for hazards.
        now: As for hazards.

    Returns:
        True when there is no hazard.
    """
    return hazards(config, action, state, facts, now) == []
