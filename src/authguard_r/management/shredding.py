# SPDX-License-Identifier: Apache-2.0
"""Destroying sealed fields: the keys at once, by a signed order or when their time is over.

The order and the loss of the wrapped keys are one commit: from then on nobody opens the boxes. The
boxes themselves go in small turns after it, so that no decision waits, and go on after a crash;
what a store holds of the mission beside the log goes with them. The chain stays whole, and a
record says who destroyed what. Spec page: docs/spec/sealed-fields.md#shredding
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.audit.boxes import BOX, SEALING, WRAP, Box, DataClass
from authguard_r.audit.record import NONE, Entry, Record, read_record, read_sealed
from authguard_r.commands import Command, Verb
from authguard_r.core.encoding import Tag, b64, encode
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.identifiers import Count, MissionId
from authguard_r.core.lifecycle import TERMINAL
from authguard_r.core.quantities import to_ms, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.ledger import Act, read_held
from authguard_r.management.parts import Parts, entry, refuse
from authguard_r.management.repetition import require_fresh
from authguard_r.sealing.kept import due_missions, hold_due, newest_keys

#: Who may order it: whoever says who reads, and for how long.
ROLES = frozenset({"site_authority"})
#: Where what is still to be destroyed is held.
_KIND, _JOBS = "shredding", "jobs"
#: Records that one turn looks through.
PAGE = 64
#: Keys that one order reaches back to: one for each start of the gate.
_MOST_KEYS = 4_096
#: When a mission expired whose token is destroyed.
_OVER = "shredding-over"
#: Missions that one turn looks at, and how long one set of keys of no mission is used.
_MOST_DUE = 64
DAY_MS = 86_400_000


class Shredding(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is being destroyed.

    Args:
        mid: the mission; `-` for the records of none.
        classes: whose fields go.
        keys: numbers of the records that told the keys.
        at: where the next turn goes on.
        end: the first record that has other keys, or none.
        order: number of the record of the order.
        boxes: how many were destroyed.
    """

    mid: str
    classes: tuple[DataClass, ...]
    keys: tuple[int, ...]
    at: Count
    end: Count
    order: Count
    boxes: Count = 0


class _Keys(Struct, frozen=True, kw_only=True):
    """One record that tells keys, and when they were used."""

    seq: int
    since_ms: int
    until_ms: int
    names: frozenset[str]


class _Task(Struct, frozen=True):
    """Whose fields go: a mission's, when that expires, and of which classes."""

    mid: str
    classes: tuple[DataClass, ...]
    over_ms: int


def shred(act: Act, token: bytes, *, parts: Parts) -> Shredding:
    """Carry out a signed order to destroy classes of a mission's sealed fields, once."""
    command, _, signer = open_token(
        token, Command, tag=Tag.COMMAND, roles=ROLES, verifier=parts.verifier, now=act.now
    )
    if command.verb is not Verb.SHRED or sorted(set(command.shreds)) != [*command.shreds]:
        text = f"no {command.verb} of sealed fields: name classes, sorted, each once"
        raise refuse(Reason.TRANSITION_REFUSED, text, "command.verb")
    if not command.shreds:
        raise refuse(Reason.TRANSITION_REFUSED, "no class is named", "command.shreds")
    require_fresh(act, command)
    # as in the configuration that it signs: this role has no scope, the order names the very log
    if b64(act.rows(0, 1)[0][3]) != command.mission:
        raise refuse(Reason.ROLLED_BACK, "another log was signed for", "command.mission")
    mid = NONE if str(command.mid) == parts.facts.robot.rid else str(command.mid)
    least_ms = max((r.least_ms for r in parts.retention if r.data in command.shreds), default=0)
    keys = _required(act, _Task(mid, command.shreds, _over_ms(act, mid, parts)), least_ms)
    act.put("command", command.nonce, b"1")
    told = entry(act, NONE, {"verb": Verb.SHRED, "by": signer.id, "role": signer.role})
    told = replace(told, sealed={"command": command})
    return _begin(act, _Task(mid, command.shreds, _over_ms(act, mid, parts)), keys, told)


def retire(act: Act, *, parts: Parts) -> tuple[Shredding, ...]:
    """Destroy what was kept as long as the signed retention says."""
    rules = {rule.data: rule.most_ms for rule in parts.retention if rule.most_ms}
    if not rules:
        return ()
    begun: list[Shredding] = []
    due = due_missions(act)
    looked, later = due[:_MOST_DUE], due[_MOST_DUE:]
    for mid in (*looked, NONE):
        over_ms = _over_ms(act, mid, parts)
        for data, most_ms in rules.items():
            keys = tuple(
                key
                for key in _keys(act, mid, (data,))
                if (key.until_ms if mid == NONE else over_ms) + most_ms <= act.now.utc_ms
            )
            if keys:
                told = entry(act, NONE, {"verb": Verb.SHRED, "by": "retention"})
                begun.append(_begin(act, _Task(mid, (data,), over_ms), keys, told))
    left = tuple(m for m in looked if any(_keys(act, m, (data,)) for data in rules))
    if (*later, *left) != due:
        hold_due(act, (*later, *left))
    newest = _keys(act, NONE, tuple(rules))[:1]
    if newest and act.now.utc_ms - newest[0].since_ms >= DAY_MS:
        act.forget_keys(NONE)  # the next record makes others, so that these have an end
    return tuple(begun)


def shred_on(act: Act) -> bool:
    """Destroy the boxes of some records; return whether any are left."""
    jobs = _jobs(act)
    if not jobs:
        return False
    job, rest = jobs[0], jobs[1:]
    count = min(PAGE, job.end - job.at)
    gone = sum(_emptied(act, job, row) for row in act.rows(job.at, count))
    job = replace(job, at=job.at + count, boxes=job.boxes + gone)
    if job.at < job.end:
        _hold_jobs(act, (job, *rest))
        return True
    _hold_jobs(act, rest)
    opened: dict[str, object] = {
        "verb": "shredded",
        "of": job.mid,
        "classes": list(job.classes),
        "order": job.order,
        "boxes": job.boxes,
    }
    act.record(entry(act, NONE, opened))
    return bool(rest)


def _over_ms(act: Act, mid: str, parts: Parts) -> int:
    """Return when the newest version of a mission expires, 0 for the records of none.

    Raises:
        RefusedError: there is no such mission.
    """
    if mid == NONE:
        return 0
    standing = act.standing(MissionId(mid))
    if standing is None:
        raise refuse(Reason.MISSION_UNKNOWN, "no such mission is here", "command.mid")
    held = act.get(_OVER, mid)
    if held:  # its token went with the first class that was destroyed
        return int(held)
    mission = parts.intake.held(act, standing.digest).mission
    return to_ms(mission.expiry, where="mission.expiry")


def _required(act: Act, task: _Task, least_ms: int) -> tuple[_Keys, ...]:
    """Return the keys that may be destroyed now.

    Raises:
        RefusedError: the mission goes on, its fields are to be kept, or there are none.
    """
    now_ms, mid = act.now.utc_ms, task.mid
    standing = None if mid == NONE else act.standing(MissionId(mid))
    goes_on = standing is not None and standing.status not in TERMINAL
    if standing is not None and goes_on and now_ms <= task.over_ms:
        text = f"the mission is {standing.status}: end it first"
        raise refuse(Reason.TRANSITION_REFUSED, text, "command.mid")
    keys = _keys(act, mid, task.classes)
    if not keys:
        text = "nothing is sealed there, or it is destroyed already"
        raise refuse(Reason.MISSION_UNKNOWN, text, "command.mid")
    ends = {key.seq: key.until_ms if mid == NONE else task.over_ms for key in keys}
    ripe = tuple(key for key in keys if not least_ms or ends[key.seq] + least_ms <= now_ms)
    if not ripe:
        text = f"its fields are kept until {to_timestamp(min(ends.values()) + least_ms)} at least"
        raise refuse(Reason.NOT_YET_VALID, text, "command.shreds")
    return ripe


def _keys(act: Act, mid: str, classes: tuple[DataClass, ...]) -> tuple[_Keys, ...]:
    """Return the records that tell keys of these classes, the newest first.

    What was destroyed once is not told any more, and nothing before it is.
    """
    found: list[_Keys] = []
    names = {WRAP + data for data in classes}
    seq, until_ms = newest_keys(act, mid), act.now.utc_ms
    while seq is not None and seq >= 0 and len(found) < _MOST_KEYS:
        record, sealed = _read(act, seq)
        wraps = frozenset(names & sealed.keys())
        if record.kind != SEALING or record.link.mid != mid or not wraps:
            break
        since_ms = record.link.time_ms
        found.append(_Keys(seq=seq, since_ms=since_ms, until_ms=until_ms, names=wraps))
        seq, until_ms = int(record.open.get("before", -1)), since_ms
    return tuple(found)


def _begin(act: Act, task: _Task, keys: tuple[_Keys, ...], told: Entry) -> Shredding:
    """Destroy the wrapped keys, and note what is left to do; the record is of no mission."""
    for key in keys:
        act.forget(key.seq, key.names)
    act.forget_keys(task.mid)
    act.put(_OVER, task.mid, str(task.over_ms).encode("ascii"))
    standing = None if task.mid == NONE else act.standing(MissionId(task.mid))
    if standing is not None and standing.status in TERMINAL:
        act.hold(replace(standing, requests={}, selected={}))
    end = act.head()[0]
    opened = {"of": task.mid, "classes": list(task.classes), "keys": len(keys)}
    job = Shredding(
        mid=task.mid,
        classes=task.classes,
        keys=tuple(key.seq for key in keys),
        at=keys[-1].seq,
        end=end,
        order=act.record(replace(told, open={**told.open, **opened})),
    )
    _hold_jobs(act, (*_jobs(act), job))
    return job


def _emptied(act: Act, job: Shredding, row: tuple[int, bytes, bytes, bytes]) -> int:
    """Let the boxes of one record go, with what the store holds beside the log."""
    seq, written, beside, _ = row
    if BOX.encode() not in beside:
        return 0
    where = f"store.audit.{seq}"
    sealed = read_sealed(beside, where=where)
    names = {
        name
        for name, one in sealed.items()
        if name.startswith(BOX)
        and not set(job.classes).isdisjoint(name.removeprefix(BOX).split("+"))
        and msgspec.convert(one.value, Box).keys in job.keys
    }
    if names:
        act.forget(seq, names)
        digest = read_record(written, where=where).open.get("mission")
        if digest is not None and act.get("token", str(digest)):
            act.put("token", str(digest), b"")
    return len(names)


def _read(act: Act, seq: int) -> tuple[Record, dict[str, Any]]:
    where = f"store.audit.{seq}"
    rows = act.rows(seq, 1)
    if not rows:
        raise StoreError("the log has no such record", where=where, reason=Reason.STORE_CORRUPT)
    try:
        return read_record(rows[0][1], where=where), dict(read_sealed(rows[0][2], where=where))
    except MalformedError as error:
        raise StoreError(error.message, where=where, reason=Reason.STORE_CORRUPT) from error


def _jobs(act: Act) -> tuple[Shredding, ...]:
    held = act.get(_KIND, _JOBS)
    return read_held(held, tuple[Shredding, ...], _KIND) if held else ()


def _hold_jobs(act: Act, jobs: tuple[Shredding, ...]) -> None:
    act.put(_KIND, _JOBS, encode(jobs) if jobs else b"")
