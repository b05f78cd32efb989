# SPDX-License-Identifier: Apache-2.0
"""Destroying sealed fields: the keys at once, by a signed order or when their time is over.

The order and the loss of the wrapped keys are one commit: from then on the envelopes cannot be
opened. The gate deletes the envelopes themselves in small batches after it, so that no decision
waits, and continues after a crash. What a store holds of the mission beside the log goes with them.
The chain stays whole, and a record says who destroyed what.
Spec page: docs/spec/sealed-fields.md#shredding
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.anchoring.sealing import stored_policy
from authguard_r.approvals.preapprovals import KIND as PREAPPROVALS
from authguard_r.audit.record import (
    BOX,
    NONE,
    WRAP,
    Entry,
    Record,
    Sealed,
    read_record,
    read_sealed,
)
from authguard_r.audit.sealed_envelopes import SEALING, SealedEnvelope
from authguard_r.core.encoding import Tag, b64, encode
from authguard_r.core.errors import AuthGuardError, MalformedError, StoreError
from authguard_r.core.identifiers import Count, MissionId
from authguard_r.core.lifecycle import TERMINAL
from authguard_r.core.mission import DataClass
from authguard_r.core.ports import Turn
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.enforcement.management.activation import end_issued, lapsed
from authguard_r.enforcement.management.answers import LATE
from authguard_r.enforcement.management.parts import ManagementParts, entry, refuse
from authguard_r.enforcement.management.repetition import require_fresh
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.store.transactions import Transaction, read_held
from authguard_r.wire.gate_limits import LIMITS

#: Who may order it: a role that decides who reads, and for how long.
ROLES = frozenset({"site_authority"})
#: Where what is still to be destroyed is held.
_KIND, _JOBS = "shredding", "jobs"
#: Records that one turn looks through, and of how many of them it lets boxes go.
LOOKS, PAGE = 1_024, 64
#: Missions that retention looks at in one turn, and of how many it destroys something.
_MOST_DUE, _MOST_BEGUN = 16, 4
#: How long one set of keys of no mission is used where retention ends.
DAY_MS = 86_400_000


#: Classes of sealed fields.
_Classes = tuple[DataClass, ...]


class Shredding(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is being destroyed.

    Args:
        mid: the mission; `-` for the records of none.
        classes: whose fields go.
        keys: numbers of the records that hold the keys.
        at: where the next turn goes on.
        end: the first record that has other keys, or none.
        order: number of the record of the order.
        boxes: how many were destroyed.
    """

    mid: str
    classes: _Classes
    keys: tuple[int, ...]
    at: Count
    end: Count
    order: Count
    boxes: Count = 0


class _Keys(Struct, frozen=True, kw_only=True):
    """One record that holds keys, and when they were used."""

    seq: int
    since_ms: int
    until_ms: int
    end: int
    names: frozenset[str]


class Retired(Struct, frozen=True, kw_only=True):
    """What one look at retention came to.

    Args:
        begun: what is being destroyed now.
        stuck: missions of which it is unknown whether their time is over: the store is damaged.
    """

    begun: tuple[Shredding, ...] = ()
    stuck: tuple[MissionId, ...] = ()


def shred(act: Transaction, token: bytes, *, parts: ManagementParts) -> Shredding:
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
    act.record_waiting()  # a refusal that comes behind the order would have keys of its own
    mid = _meant(act, command.mid, parts)
    keys = _required(act, mid, command.shreds, parts)
    if mid != NONE:
        _end(act, MissionId(mid), parts)
    act.put("command", command.nonce, b"1")
    told = entry(act, NONE, {"verb": Verb.SHRED, "by": signer.id, "role": signer.role})
    return _begin(act, mid, command.shreds, keys, replace(told, sealed={"command": command}))


def retire(act: Transaction, *, parts: ManagementParts) -> Retired:
    """Destroy what was kept as long as the signed retention says; some of it, at most.

    A mission's own times count in place of the gate's, within the gate's bounds. A mission that
    expired and was not ended lapses before. A mission with an action of unknown outcome waits until
    a person resolves it.
    """
    rules, due = parts.sealing.most_ms, stored_policy.due_missions(act)
    looked = {mid: _ripe(act, mid, parts) for mid in due[:_MOST_DUE]}
    ripe = {mid: classes for mid, classes in looked.items() if classes is not None}
    begin = [mid for mid, classes in ripe.items() if _told(act, mid, classes)][:_MOST_BEGUN]
    begun: list[Shredding] = []
    if begin:
        act.record_waiting()  # else they would come behind it, under keys of their own
    for mid in begin:
        if _end(act, mid, parts):
            begun += _retired(act, mid, _told(act, mid, ripe[mid]), 0)
    over = {mid for mid, classes in ripe.items() if _is_over(act, mid, classes, parts)}
    waits = tuple(mid for mid in stored_policy.due_missions(act) if mid not in over)
    if len(due) > _MOST_DUE:
        waits = (*waits[_MOST_DUE:], *waits[:_MOST_DUE])
    if waits != due:
        stored_policy.hold_due(act, waits)
    for most_ms in sorted(set(rules.values())):
        classes = tuple(data for data, ms in rules.items() if ms == most_ms)
        begun += _retired(act, NONE, classes, act.now.utc_ms - most_ms)
    newest = _keys(act, NONE, tuple(rules), most=1) if rules else ()
    if newest and act.now.utc_ms - newest[0].since_ms >= DAY_MS:
        act.forget_keys(NONE)  # the next record makes others, so that these have an end
    return Retired(begun=tuple(begun), stuck=tuple(mid for mid in looked if mid not in ripe))


def is_shredding(turn: Turn) -> bool:
    """Return whether boxes are left whose keys are gone."""
    return bool(turn.get(_KIND, _JOBS))


def shred_on(act: Transaction) -> bool:
    """Destroy the boxes of some records, of which there are; return whether any are left."""
    job, *rest = _jobs(act)
    at, gone, emptied = job.at, 0, 0
    for row in act.rows(job.at, min(LOOKS, job.end - job.at)):
        found = _emptied(act, job, row)
        at, gone, emptied = at + 1, gone + found, emptied + bool(found)
        if emptied == PAGE:
            break
    job = replace(job, at=at, boxes=job.boxes + gone)
    if job.at < job.end:
        _hold_jobs(act, (job, *rest))
        return True
    _hold_jobs(act, tuple(rest))
    opened: dict[str, object] = {
        "verb": "shredded",
        "of": job.mid,
        "classes": list(job.classes),
        "order": job.order,
        "boxes": job.boxes,
    }
    act.record(entry(act, NONE, opened))
    return bool(rest)


def _meant(act: Transaction, mid: MissionId, parts: ManagementParts) -> str:
    """Return the mission that an order names, `-` for the records of none.

    Raises:
        RefusedError: there is no such mission, or one has the robot's name.
    """
    known = act.standing(mid) is not None
    if str(mid) == parts.facts.robot.rid:
        if known:
            text = "a mission has the robot's name, so the order is ambiguous"
            raise refuse(Reason.TRANSITION_REFUSED, text, "command.mid")
        return NONE
    if not known:
        raise refuse(Reason.MISSION_UNKNOWN, "no such mission is here", "command.mid")
    return mid


def _required(
    act: Transaction, mid: str, classes: _Classes, parts: ManagementParts
) -> tuple[_Keys, ...]:
    """Return the keys that may be destroyed now.

    A value that is destroyed with a class reveals others too, so it is kept as long as any has to
    be.

    Raises:
        RefusedError: the mission did not end, its fields are to be kept, or there are none.
    """
    standing = None if mid == NONE else act.standing(MissionId(mid))
    if standing is not None and standing.status not in TERMINAL:
        text = f"the mission is {standing.status}: end it first"
        raise refuse(Reason.TRANSITION_REFUSED, text, "command.mid")
    if standing is not None and standing.open:
        text = "the end of one of its actions is unknown: `authguard mission resolve` first"
        raise refuse(Reason.TRANSITION_REFUSED, text, "command.mid")
    keys = _keys(act, mid, classes)
    if not keys:
        text = "nothing is sealed there, or it is destroyed already"
        raise refuse(Reason.MISSION_UNKNOWN, text, "command.mid")
    least_ms = parts.sealing.least_ms
    over_ms = 0 if mid == NONE or not least_ms else _over_ms(act, MissionId(mid), parts)
    ends = [key.until_ms if mid == NONE else over_ms for key in keys]
    ripe = tuple(
        key
        for key, end in zip(keys, ends, strict=True)
        if not least_ms or end + least_ms <= act.now.utc_ms
    )
    if not ripe:
        text = f"its fields are stored until {to_timestamp(min(ends) + least_ms)} at least"
        raise refuse(Reason.NOT_YET_VALID, text, "command.shreds")
    return ripe


def _over_ms(act: Transaction, mid: MissionId, parts: ManagementParts) -> int:
    """Return when the newest version of a mission expires.

    Raises:
        StoreError: neither the store nor a token that is still there says so.
    """
    known = stored_policy.expiry_ms(act, mid)
    standing = act.standing(mid)
    if known is not None or standing is None:
        return known or 0
    return parts.inputs.held(act, standing.digest).expiry_ms


def _ripe(act: Transaction, mid: MissionId, parts: ManagementParts) -> _Classes | None:
    """Return the classes of a mission that have no more time; None: the store cannot say it."""
    try:
        times = stored_policy.retention_of(act, mid, parts.sealing)
        over_ms = _over_ms(act, mid, parts) if times else 0
        ripe = tuple(data for data, ms in times.items() if over_ms + ms <= act.now.utc_ms)
        _told(act, mid, ripe)
    except AuthGuardError:  # one damaged mission keeps no other from its end
        return None
    return ripe


def _is_over(act: Transaction, mid: MissionId, ripe: _Classes, parts: ManagementParts) -> bool:
    """Return whether no class of a mission has an end to come; without any time, one may come."""
    every = len(ripe) == len(stored_policy.retention_of(act, mid, parts.sealing))
    return bool(ripe) and every and not _told(act, mid, ripe)


def _told(act: Transaction, mid: MissionId, classes: _Classes) -> _Classes:
    """Return the classes that have keys for this mission."""
    return tuple(data for data in classes if _keys(act, mid, (data,), most=1))


def _end(act: Transaction, mid: MissionId, parts: ManagementParts) -> bool:
    """End a mission that is over or has expired, so that its fields can be destroyed.

    Returns:
        False: it goes on, or the outcome of an action is unknown.
    """
    ended = lapsed(act, act.standing(mid), parts)
    if ended is None or ended.status not in TERMINAL or ended.open:
        return False
    end_issued(act, parts, mid=mid)
    if act.active() == mid:
        act.make_active(None)
        parts.inputs.forget()
    return True


def _retired(act: Transaction, mid: str, classes: _Classes, until_ms: int) -> Iterator[Shredding]:
    """Begin to destroy what has no more time.

    Args:
        act: the act.
        mid: the mission.
        classes: of its fields.
        until_ms: for the records of no mission, keys that were used later are left.
    """
    keys = tuple(
        key
        for key in _keys(act, mid, classes, whole=mid != NONE)
        if mid != NONE or key.until_ms <= until_ms
    )
    if keys:
        told = entry(act, NONE, {"verb": Verb.SHRED, "by": "retention"})
        yield _begin(act, mid, classes, keys, told)


def _keys(
    act: Transaction,
    mid: str,
    classes: _Classes,
    *,
    most: int = LIMITS.shredded_keys,
    whole: bool = True,
) -> tuple[_Keys, ...]:
    """Return the records that tell keys of these classes, the newest first.

    Args:
        act: the act.
        mid: the mission.
        classes: any of them.
        most: so many at most.
        whole: look behind keys that are destroyed, too; else nothing before them is reported.
    """
    found: list[_Keys] = []
    names = {WRAP + data for data in classes}
    seq, until_ms, end = stored_policy.newest_keys(act, mid), act.now.utc_ms, act.head()[0]
    while seq is not None and seq >= 0 and len(found) < most:
        record, sealed = _read(act, seq)
        before = record.open.get("before")
        if record.kind != SEALING or record.link.mid != mid or not isinstance(before, int):
            raise _corrupt("expected a record that names keys", seq)
        wraps = frozenset(names & sealed.keys())
        since_ms = record.link.time_ms
        if wraps:
            found.append(_Keys(seq=seq, since_ms=since_ms, until_ms=until_ms, end=end, names=wraps))
        elif not whole and names & record.committed.keys():
            break
        if before >= seq:
            raise _corrupt("expected the keys of before to lie before", seq)
        seq, until_ms, end = before, since_ms, seq
    return tuple(found)


def _begin(
    act: Transaction, mid: str, classes: _Classes, keys: tuple[_Keys, ...], told: Entry
) -> Shredding:
    """Destroy the wrapped keys, and note what is left to do; the record is of no mission."""
    for key in keys:
        act.forget(key.seq, key.names)
    if stored_policy.newest_keys(act, mid) in {key.seq for key in keys}:
        act.forget_keys(mid)
    standing = None if mid == NONE else act.standing(MissionId(mid))
    if standing is not None:  # over: it uses, asks and chooses nothing more, and the log has it
        act.hold(replace(standing, requests={}, selected={}, uses={}, preapproved={}))
        act.put(PREAPPROVALS, mid, b"")
        act.drop_token(standing.digest)
    opened = {"of": mid, "classes": list(classes), "keys": len(keys)}
    job = Shredding(
        mid=mid,
        classes=classes,
        keys=tuple(key.seq for key in keys),
        at=keys[-1].seq,
        end=keys[0].end,
        order=act.record(replace(told, open={**told.open, **opened})),
    )
    _hold_jobs(act, (*_jobs(act), job))
    return job


def _emptied(act: Transaction, job: Shredding, row: tuple[int, bytes, bytes, bytes]) -> int:
    """Let the boxes of one record go, with what the store holds beside the log."""
    seq, written, beside, _ = row
    if BOX.encode() not in beside:
        return 0
    record, sealed = _spelled(seq, written, beside)
    names = {
        name
        for name, one in sealed.items()
        if name.startswith(BOX)
        and not set(job.classes).isdisjoint(name.removeprefix(BOX).split("+"))
        and _box(seq, one).keys in job.keys
    }
    if not names:
        return 0
    act.forget(seq, names)
    for kind, key in (
        ("token", str(record.open.get("mission"))),
        ("approvals", f"{record.link.mid}:{record.open.get('counter')}"),
        (LATE, f"{record.link.mid}:{record.open.get('counter')}"),
    ):
        if act.get(kind, key):
            act.put(kind, key, b"")
    return len(names)


def _read(act: Transaction, seq: int) -> tuple[Record, dict[str, Sealed]]:
    rows = act.rows(seq, 1)
    if not rows:
        raise _corrupt("the log has no such record", seq)
    return _spelled(*rows[0][:3])


def _spelled(seq: int, written: bytes, beside: bytes) -> tuple[Record, dict[str, Sealed]]:
    where = f"store.audit.{seq}"
    try:
        return read_record(written, where=where), read_sealed(beside, where=where)
    except MalformedError as error:
        raise _corrupt(error.message, seq) from error


def _box(seq: int, sealed: Sealed) -> SealedEnvelope:
    try:
        return msgspec.convert(sealed.value, SealedEnvelope)
    except msgspec.ValidationError as error:
        raise _corrupt(f"expected a box: {error}", seq) from error


def _corrupt(text: str, seq: int) -> StoreError:
    return StoreError(text, where=f"store.audit.{seq}", reason=Reason.STORE_CORRUPT)


def _jobs(act: Transaction) -> tuple[Shredding, ...]:
    held = act.get(_KIND, _JOBS)
    jobs = read_held(held, tuple[Shredding, ...], _KIND) if held else ()
    if held and not jobs:  # what there is to destroy is unknown
        text, where = "expected something that is to be destroyed", f"store.{_KIND}"
        raise StoreError(text, where=where, reason=Reason.STORE_CORRUPT)
    return jobs


def _hold_jobs(act: Transaction, jobs: tuple[Shredding, ...]) -> None:
    act.put(_KIND, _JOBS, encode(jobs) if jobs else b"")
