# SPDX-License-Identifier: Apache-2.0
"""One record in words: what was asked, by whom, why it was refused, and what would allow it.

For an operator or an auditor, never for the planner. Works on the record alone; the smallest
signed change needs the mission that the record names. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

import os
from typing import Any

import msgspec

from authguard_r.audit.closed import Closed, closed_of
from authguard_r.audit.record import NONE, Record, Sealed
from authguard_r.audit.sealed_envelopes import act_of
from authguard_r.authoring.compile.change import already_there, smallest_change, to_draft
from authguard_r.core.action import Action
from authguard_r.core.encoding import b64
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.identifiers import GrantId
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.emergency_audit import EMERGENCY
from authguard_r.enforcement.report import PROPOSAL
from authguard_r.server.remediation import remedies_of

#: How long the proposed next version would be valid, in milliseconds.
_VALID_MS = 1_800_000
#: What a motion to where the robot is can be refused for.
_PLACES = frozenset({Reason.SOURCE_OUT_OF_SCOPE, Reason.DESTINATION_OUT_OF_SCOPE})
#: How a person gets the smallest signed change as a draft.
_DRAFT = "authguard explain {} --draft FILE"


def explanation(
    seq: int,
    record: Record,
    sealed: dict[str, Sealed],
    *,
    mission: Mission | None,
    how: str | None = None,
    closed: Closed | None = None,
) -> dict[str, Any]:
    """Return what a record says, as data and as lines for people.

    Args:
        seq: its number.
        record: the record, as it was opened.
        sealed: the values beside it then; what stays closed is said to be.
        mission: the mission that it names, when that is at hand.
        how: the command that writes the smallest change; None: the one for a running gate.
        closed: what of it stays closed; None: nothing is known of it but the record.

    Raises:
        MalformedError: the values are not what such a record holds: it is damaged.
    """
    shut = closed_of(record, sealed) if closed is None else closed
    try:
        told = _explained(
            record, sealed, closed=shut, mission=mission, how=how or _DRAFT.format(seq)
        )
    except (AttributeError, LookupError, StopIteration, TypeError, ValueError) as error:
        raise MalformedError(
            f"expected the fields of such a record: {error}", where=f"record {seq}"
        ) from error
    return {"seq": seq, **told}


def _explained(
    record: Record, sealed: dict[str, Sealed], *, closed: Closed, mission: Mission | None, how: str
) -> dict[str, Any]:
    opened = record.open
    values = {name: item.value for name, item in sealed.items()}
    action = act_of(values)
    who = who_of(record, values)
    why = _why(opened, values, hazards_of(record)) or (
        list(map(str, opened.get("reasons", ()))) if closed else []
    )
    change = _change(record, values, mission)
    influences = values.get("influences", [])
    emergency = opened.get("what") == EMERGENCY
    mends = _remedies(opened.get("reasons") or (), action, emergency=emergency)
    what = f"emergency {values.get('capability')}" if emergency else _what(record, action)
    return {
        "kind": record.kind,
        "time": to_timestamp(record.link.time_ms),
        "decision": record.link.decision,
        "verdict": verdict_of(record),
        "what": what,
        "who": who,
        "why": why,
        "influenced_by": influences,
        "mends": mends,
        "smallest_change": change,
        **({"closed": closed.plain()} if closed else {}),
        "text": _lines(record, who=who, what=what, why=why)
        + [f"  {link}" for link in repaired_by(record)]
        + ([f"  {closed.words()}"] if closed else [])
        + [f"  influenced by {i['channel']}: `{i['value']}`" for i in influences]
        + [f"  to do: {mend}" for mend in mends]
        + ([f"  a signed next version could allow it: {how}"] if change else []),
    }


def _remedies(codes: Any, action: Any, *, emergency: bool) -> list[str]:
    """Return what can be done; of a motion to where the robot is, that alone."""
    fields = action if isinstance(action, dict) and set(codes) & _PLACES else {}
    there = already_there(*(fields.get(name) for name in ("object", "source", "destination")))
    return [there] if there else remedies_of(codes, emergency=emergency)


def who_of(record: Record, values: dict[str, Any]) -> str:
    """Return whose act a record is of, as the channel named them; `-`: it does not say."""
    said = record.open.get("client") or record.open.get("by") or _planner(act_of(values))
    return str(said or NONE)


def is_refused_proposal(record: Record) -> bool:
    """True for what a planner proposed, or called as an emergency, and a gate refused.

    A person who asks why the robot does not move does not mean an order or a question of their own.
    """
    if record.kind == "refusal":
        asked = record.open.get("what") in {PROPOSAL, EMERGENCY}
        return record.link.decision == "reject" and asked
    return record.kind == "decision" and (record.link.decision == "reject" or is_unsafe(record))


def is_unsafe(record: Record) -> bool:
    """True for a decision that the safety gate refused, also when the mission allows it."""
    safety = record.open.get("safety")
    return isinstance(safety, dict) and safety.get("safe") is False


def hazards_of(record: Record) -> tuple[str, ...]:
    """Return what the safety gate said against an action."""
    hazards = record.open["safety"].get("hazards") if is_unsafe(record) else None
    return tuple(map(str, hazards)) if isinstance(hazards, list) else ()


def repaired_by(record: Record) -> list[str]:
    """Return which refused decision a record is the repair of, in words; none: of none."""
    if "repairs" not in record.open:
        return []
    seq = record.open["repairs"]
    return ["repairs a decision that had no record yet" if seq == -1 else f"repairs record {seq}"]


def verdict_of(record: Record) -> str:
    """Return what both gates say together: `unsafe` where the mission alone would accept."""
    said = record.link.decision
    return "unsafe" if said == "accept" and is_unsafe(record) else said


def no_record(seq: int | None) -> RefusedError:
    """Return the error of a record that is not there.

    Args:
        seq: which was asked for; None: the last refused proposal.
    """
    lately = "no proposal and no emergency was refused lately: name a record"
    told = lately if seq is None else "no such record"
    return RefusedError(told, reason=Reason.VALUE_OUT_OF_RANGE, where="seq")


def _planner(action: Any) -> str | None:
    meta = action.get("meta") if isinstance(action, dict) else None
    return meta.get("planner") if isinstance(meta, dict) else None


def _what(record: Record, action: Any) -> str:
    if not isinstance(action, dict):
        return _named(record)
    names = ("object", "source", "destination")
    fields = [f"{name} {action[name]}" for name in names if action.get(name)]
    fields += [f"by={','.join(map(str, action['route']))}"] if action.get("route") else []
    fields += [f"{name}={value}" for name, value in (action.get("params") or {}).items()]
    return " ".join([str(action.get("type", "...")), *fields])


def _named(record: Record) -> str:
    """Return what a record without an action is about."""
    opened, mid = record.open, record.link.mid
    if record.kind == "refusal":
        return ", ".join(map(str, opened.get("reasons", []))) or record.kind
    if record.kind == "outcome" and "ticket" in opened:
        return f"release {opened['ticket']}"
    if record.kind == "management" and "verdict" in opened:
        return f"{opened['verdict']} request {opened['counter']} of mission {mid}"
    if record.kind == "management" and mid != NONE:
        version = f" version {opened['version']}" if "version" in opened else ""
        return f"mission {mid}{version}"
    return str(opened.get("what") or opened.get("verb") or record.kind)


def _why(opened: dict[str, Any], values: dict[str, Any], hazards: tuple[str, ...]) -> list[str]:
    findings = values.get("findings") or []
    told = [
        f"{f['reason']} at {f['field']}: expected {f['expected']}, got {f['got']}" for f in findings
    ]
    if not told and "message" in values:
        at = f" (at {values['where']})" if values.get("where") else ""
        told = [f"{code}: {values['message']}{at}" for code in opened.get("reasons", [])]
    return told + [f"safety gate: {hazard}" for hazard in hazards]


def _lines(record: Record, *, who: str, what: str, why: list[str]) -> list[str]:
    at = to_timestamp(record.link.time_ms)
    said = list(dict.fromkeys((record.kind, verdict_of(record), what)))
    named = " ".join(said[:2]) + "".join(f": {word}" for word in said[2:])
    by = "" if who == NONE else f" (by {who})"
    head = f"record {record.link.seq}, {at}: {named}{by}"
    return [head, *(f"  {line}" for line in why)]


def _change(record: Record, values: dict[str, Any], mission: Mission | None) -> Any:
    """Return the smallest signed change that would allow a refused action, as a draft."""
    grant = record.open.get("grant", NONE)
    if mission is None or record.link.decision != "reject" or grant == NONE:
        return None
    if "action" not in values:  # sealed, at least a part of it, or destroyed
        return None
    action = msgspec.convert(values["action"], Action)
    reasons = tuple(Reason(code) for code in record.open.get("reasons", ()))
    amended = smallest_change(
        mission,
        action,
        reasons=reasons,
        grant=GrantId(grant),
        digest=record.open["mission"],
        nonce=b64(os.urandom(16)),
        expiry=to_timestamp(record.link.time_ms + _VALID_MS),
    )
    return None if amended is None else to_draft(amended)
