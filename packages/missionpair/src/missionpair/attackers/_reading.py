# SPDX-License-Identifier: Apache-2.0
"""What attackers read of the bytes that they are given; what a level does not see is empty."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import msgspec
from msgspec import Struct

from missionpair.access import CASE, SEEN
from missionpair.attackers import AttackerError
from missionpair.briefing import OfferedTool
from missionpair.pair import Input, WordedCall
from missionpair.words import Access, Channel, Family


class CaseView(Struct, frozen=True, kw_only=True):
    """A case as one level sees it; see `access.Case` for the fields."""

    schema: str
    access: Access
    goal: str
    wanted: tuple[WordedCall, ...]
    family: Family
    channels: tuple[Channel, ...]
    inputs: tuple[Input, ...] = ()
    instead_of: str = ""
    task: str = ""
    tools: tuple[OfferedTool, ...] = ()
    places: tuple[str, ...] = ()
    things: tuple[str, ...] = ()
    actions: dict[str, Any] = {}
    mission: dict[str, Any] = {}
    mission_schema: str = ""
    defense: str = ""
    gate_order: tuple[str, ...] = ()
    reason_codes: tuple[str, ...] = ()
    weights: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0)
    rounds: int = 1


class SeenView(Struct, frozen=True, kw_only=True):
    """A round as one level sees it; see `access.Seen` for the fields."""

    schema: str
    access: Access
    outcome: str
    round: int = 0
    inputs: tuple[Input, ...] = ()
    reply: str = ""
    plan: tuple[dict[str, Any], ...] = ()
    by: str = ""
    reasons: tuple[str, ...] = ()
    findings: tuple[dict[str, str], ...] = ()
    syntax: str = ""
    hazards: tuple[str, ...] = ()
    executable: bool = False
    safe: bool = False
    deviation: str = "0"
    score: int | None = None


_CASE = msgspec.json.Decoder(CaseView)
_SEEN = msgspec.json.Decoder(SeenView)


@lru_cache(maxsize=1)
def read_case(data: bytes) -> CaseView:
    """Return the case; the last one is kept, as it is opened again for each of its trials.

    Raises:
        AttackerError: the bytes are not valid.
    """
    try:
        found = _CASE.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _broken("case", str(error)) from error
    if found.schema != CASE:
        raise _broken("case", f"is `{found.schema}`, this reads `{CASE}`")
    return found


def read_seen(data: bytes) -> SeenView:
    """Return the round.

    Raises:
        AttackerError: the bytes are not valid.
    """
    try:
        found = _SEEN.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _broken("round", str(error)) from error
    if found.schema != SEEN:
        raise _broken("round", f"is `{found.schema}`, this reads `{SEEN}`")
    return found


def _broken(what: str, message: str) -> AttackerError:
    return AttackerError(f"the {what} cannot be read: {message}", code="protocol", where=what)
