# SPDX-License-Identifier: Apache-2.0
"""What is left of each rule after the actions of one mission, as bounded canonical bytes.

They lie in the gate's own store; they are read as untrusted all the same. Spec page:
docs/spec/safety.md#memory
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from authguard_r.core.encoding import decode, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Count, Digest, Identifier, MissionId, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.safety.temporal.rules import Compiled
from authguard_r.safety.temporal.track import Left, spelled

#: Longest memory, in bytes.
MAX_MEMORY = 16_384


class Owner(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Whose memory it is.

    Args:
        rules: digest of the rules that it is about.
        rid: the robot.
        mission: the mission; absent in a what-if that names none.
    """

    rules: Digest
    rid: RobotId
    mission: MissionId | None = None


class Memory(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The memory as it is written.

    Args:
        schema: version of this format.
        owner: whose it is.
        left: by rule: the ways in which it can still be satisfied, each the sorted numbers of
            parts of its formula.
    """

    schema: Literal["authguard-r/temporal-memory/1"]
    owner: Owner
    left: dict[Identifier, tuple[tuple[Count, ...], ...]]


def write_memory(owner: Owner, left: dict[Identifier, Left]) -> bytes:
    """Return the bytes of a memory.

    Raises:
        MalformedError: they would be longer than `MAX_MEMORY`.
    """
    ways = {rule: spelled(one) for rule, one in left.items()}
    data = encode_fast(Memory(schema="authguard-r/temporal-memory/1", owner=owner, left=ways))
    if len(data) > MAX_MEMORY:
        message = f"expected a memory of at most {MAX_MEMORY} bytes"
        raise MalformedError(message, where="memory", reason=Reason.INPUT_TOO_LARGE)
    return data


def read_memory(data: bytes, owner: Owner, rules: tuple[Compiled, ...]) -> dict[Identifier, Left]:
    """Return what is left of each rule; a fresh start when there is no memory.

    Args:
        data: from the store.
        owner: whose it has to be; without a mission, that of any of this robot's.
        rules: the rules in force.

    Raises:
        MalformedError: it is not valid, another's, or not about these rules.
    """
    if not data:
        return {rule.id: rule.track.start for rule in rules}
    if len(data) > MAX_MEMORY:
        raise MalformedError("it is too long", where="memory", reason=Reason.INPUT_TOO_LARGE)
    memory = decode(data, Memory, where="memory")
    mission = owner.mission or memory.owner.mission
    if memory.owner != Owner(rules=owner.rules, rid=owner.rid, mission=mission):
        raise MalformedError("it is of other rules, another robot or mission", where="memory")
    if set(memory.left) != {rule.id for rule in rules}:
        raise MalformedError("it is not about each of the rules", where="memory")
    return {rule.id: _left(memory.left[rule.id], rule) for rule in rules}


def _left(ways: tuple[tuple[int, ...], ...], rule: Compiled) -> Left:
    left = frozenset(map(frozenset, ways))
    known = all(place < len(rule.track.parts) for way in ways for place in way)
    if not known or spelled(left) != ways or rule.track.both(left, left) != left:
        raise MalformedError("no ways that a formula can leave", where=f"memory.left.{rule.id}")
    return left
