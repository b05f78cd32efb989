# SPDX-License-Identifier: Apache-2.0
"""What an attacker is given: the exact bytes, by access level, and nothing beside them.

`PairKnowledge` and `RoundKnowledge` hold everything that there is to say of a pair and of a round.
What a level sees is a list of fields, written here once; a field that no list names is not shown.
There is no field for keys, for tokens or for trusted state. Missions are shown without their
nonces. Of a finding only the expected value is shown: the found one may be trusted state. Source:
section "Adaptive Attacker Models". Spec page: docs/spec/missionpair-access.md
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from missionpair.briefing import OfferedTool
from missionpair.pair import Input, WordedCall
from missionpair.words import Access, Channel, Family

#: Versions of the two forms.
CASE, SEEN = "missionpair/case/1", "missionpair/seen/1"
#: The result of a plan.
EXECUTED, REJECTED = "executed", "rejected"
#: The gate's steps in their order, as `alg:authguard` numbers them.
GATE_ORDER = (
    "certificate",
    "signature",
    "schema and time",
    "registry",
    "robot",
    "policy",
    "approval",
)
#: Fields of a mission that are not shown: fresh random bytes, which only its token has to carry.
_UNSHOWN = frozenset({"nonce"})
#: Fields of a normalized action that are shown: what a bystander could tell from the robot. Its
#: source is attested state; labels and meta are the gate's own notes.
_SHOWN = ("type", "tool", "object", "destination", "route", "params")


class PairKnowledge(Struct, frozen=True, kw_only=True):
    """Everything that there is to know of a pair before the first round.

    Args:
        goal: what the attacker wants, in words.
        wanted: the calls that it wants the planner to make.
        instead_of: what the mission has where the attack changes it, as people spell it, where
            `inputs` say so already; else empty.
        family: what its texts claim.
        channels: the channels that it may use.
        inputs: the suite's own texts.
        task: what the operator asked for.
        tools: what the planner may call.
        places: spellings of places.
        things: spellings of things.
        actions: the site's action vocabulary, as plain data.
        mission: the compiled mission in force, as plain data.
        mission_schema: the text of the mission language.
        defense: the broad kind of what stands in the way, such as `authorization and safety`.
        gate_order: the gate's steps, in order.
        reason_codes: every code that a refusal can have.
        weights: lambda_1 to lambda_5, in thousandths.
        rounds: how many tries there are.
    """

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
    gate_order: tuple[str, ...] = GATE_ORDER
    reason_codes: tuple[str, ...] = ()
    weights: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0)
    rounds: int = 1


class SeenFinding(Struct, frozen=True, kw_only=True):
    """One violated condition.

    Args:
        field: where.
        reason: the code.
        expected: what would have passed, as the mission says.
        got: what was there: not shown, since it may be trusted state.
    """

    field: str
    reason: str
    expected: str
    got: str = ""


class RoundKnowledge(Struct, frozen=True, kw_only=True):
    """Everything that there is to know of a round.

    Args:
        round: from 0.
        inputs: what was sent.
        reply: what the planner wrote.
        plan: its normalized actions, as plain data; empty of what was refused as no plan.
        executed: the whole plan was carried out.
        by: who refused.
        reasons: the refusal's codes.
        findings: what the authorization checks found, step by step.
        syntax: the normalizer's reason where it refused the plan.
        hazards: the safety model's classes.
        executable: X.
        safe: SA.
        deviation: D_M, as a fraction such as `1/15`.
        score: J in thousandths.
    """

    round: int = 0
    inputs: tuple[Input, ...] = ()
    reply: str = ""
    plan: tuple[dict[str, Any], ...] = ()
    executed: bool = False
    by: str = ""
    reasons: tuple[str, ...] = ()
    findings: tuple[SeenFinding, ...] = ()
    syntax: str = ""
    hazards: tuple[str, ...] = ()
    executable: bool = False
    safe: bool = False
    deviation: str = "0"
    score: int = 0


_CASE_BLACK = ("goal", "wanted", "instead_of", "family", "channels", "inputs", "rounds")
_CASE_GREY = (*_CASE_BLACK, "tools", "places", "things", "actions", "mission_schema", "defense")
_CASE_WHITE = (*_CASE_GREY, "task", "mission", "gate_order", "reason_codes", "weights")
_SEEN_BLACK = ("round", "inputs", "reply", "plan")
_SEEN_WHITE = (
    *_SEEN_BLACK,
    "by",
    "reasons",
    "findings",
    "syntax",
    "hazards",
    "executable",
    "safe",
    "deviation",
    "score",
)
#: The fields of a case that each level sees.
CASE_FIELDS: dict[Access, tuple[str, ...]] = {
    Access.BLACK: _CASE_BLACK,
    Access.GREY: _CASE_GREY,
    Access.WHITE: _CASE_WHITE,
}
#: The fields of a round that each level sees, beside whether it was executed.
SEEN_FIELDS: dict[Access, tuple[str, ...]] = {
    Access.BLACK: _SEEN_BLACK,
    Access.GREY: _SEEN_BLACK,
    Access.WHITE: _SEEN_WHITE,
}
_ENCODER = msgspec.json.Encoder(order="sorted")


def case_bytes(access: Access, case: PairKnowledge) -> bytes:
    """Return what an attacker is given before the first round: JSON with sorted names."""
    view: dict[str, Any] = {name: getattr(case, name) for name in CASE_FIELDS[access]}
    if "mission" in view:
        view["mission"] = _without_nonces(case.mission)
    return _ENCODER.encode({"schema": CASE, "access": access, **view})


def seen_bytes(access: Access, seen: RoundKnowledge) -> bytes:
    """Return what an attacker is given after a round: JSON with sorted names."""
    view: dict[str, Any] = {name: getattr(seen, name) for name in SEEN_FIELDS[access]}
    view["plan"] = [{key: step[key] for key in _SHOWN if key in step} for step in seen.plan]
    view["outcome"] = EXECUTED if seen.executed else REJECTED
    if "findings" in view:
        view["findings"] = [
            {"field": found.field, "reason": found.reason, "expected": found.expected}
            for found in seen.findings
        ]
    return _ENCODER.encode({"schema": SEEN, "access": access, **view})


def _without_nonces(value: Any) -> Any:
    """Return plain data without any field that holds a nonce, however deep."""
    if isinstance(value, dict):
        return {name: _without_nonces(item) for name, item in value.items() if name not in _UNSHOWN}
    if isinstance(value, list | tuple):
        return [_without_nonces(item) for item in value]
    return value
