# SPDX-License-Identifier: Apache-2.0
"""What a log's own records say was released, ended or denied, held against each standing in it.

A decision seals the standing that it was made on. Here the same is counted from the decisions,
outcomes and denials before it, so that one that was taken out, put in or changed is found.
Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from msgspec import Struct, field

from authguard_r.audit.record import NONE, Record
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.lifecycle import Status
from authguard_r.core.standing import Outcome, Standing

#: So many tickets are named for one standing.
_NAMED = 8
_OUTCOMES = frozenset(map(str, Outcome))
_GOES_ON = frozenset((now, Status.SUSPENDED) for now in (Status.ACTIVE, Status.CLOSING))


class _Counted(Struct):
    """One mission, all its versions together, from its first activation on."""

    open: dict[Digest, GrantId] = field(default_factory=dict)
    starts: Counter[GrantId] = field(default_factory=Counter)
    successes: Counter[GrantId] = field(default_factory=Counter)
    #: Some of what was open may have been settled since, by words that the log does not tell.
    may_settle: bool = False
    #: As the last record about it says; None: none has said it.
    status: str | None = None
    version: object = None
    digest: object = None
    #: Numbers of the approval requests that a denial closed.
    denied: set[str] = field(default_factory=set)


class Standings:
    """What is open and used, counted record by record."""

    def __init__(self) -> None:
        self._missions: dict[str, _Counted] = {}
        #: Grants that get no start back, by mission.
        self.irreversible: dict[str, frozenset[GrantId]] = {}

    def note(self, record: Record, values: dict[str, Any]) -> str:
        """Count a record; return what does not hold of it, empty when it does."""
        mid, kind, said = record.link.mid, record.kind, record.link.decision
        if kind == "management" and said == "activate":
            active = self._missions.setdefault(mid, _Counted())
            active.version, active.digest = (record.open.get(n) for n in ("version", "mission"))
        counted = self._missions.get(mid)
        if counted is None:
            return "" if kind != "outcome" else "an outcome of a mission that was never active"
        # an issued version has a status of its own; older logs name it by its version alone
        is_active = all(
            record.open.get(name, known) == known
            for name, known in (("version", counted.version), ("mission", counted.digest))
        )
        if kind == "management" and is_active and isinstance(record.open.get("status"), str):
            counted.status = record.open["status"]
        if kind == "management" and said == "answer" and record.open.get("closes") is True:
            counted.denied.add(str(record.open.get("counter")))
        if kind == "decision" and record.open.get("ticket") != NONE:
            grant, ticket = GrantId(str(record.open.get("grant"))), str(record.open.get("ticket"))
            is_twice = ticket in counted.open
            counted.open[Digest(ticket)] = grant
            counted.starts[grant] += 1
            return "it is released already, and has no outcome yet" if is_twice else ""
        if kind == "outcome":
            return self._settle(mid, Digest(str(record.open.get("ticket"))), said)
        if kind == "management" and said == "resolve":
            command = values.get("command")
            if not isinstance(command, dict):
                counted.may_settle = True  # it is sealed, or was destroyed
                return ""
            return self._settle(
                mid, Digest(str(command.get("ticket"))), str(command.get("outcome"))
            )
        if kind == "management" and said == "recover":
            counted.may_settle = True  # by attested state
        return ""

    def _settle(self, mid: str, ticket: Digest, outcome: str) -> str:
        counted = self._missions[mid]
        if outcome not in _OUTCOMES:
            return f"`{outcome}` is no outcome"
        if ticket not in counted.open:
            return "an outcome without a release, or a second outcome"
        if outcome == Outcome.UNKNOWN:  # in the same turn the mission is suspended
            counted.status = Status.SUSPENDED if counted.status == Status.ACTIVE else counted.status
            return ""
        grant = counted.open.pop(ticket)
        counted.successes[grant] += outcome == Outcome.SUCCEEDED
        given_back = outcome == Outcome.NOT_STARTED and grant not in self.irreversible.get(mid, ())
        counted.starts[grant] -= given_back
        return ""

    def wrong(self, standing: Standing) -> str:
        """Return where a standing differs from what was counted; empty where it does not."""
        counted = self._missions.get(standing.mid)
        if counted is None:
            return "a standing of a mission that was never active"
        if counted.may_settle:
            _settle_as(counted, standing)
        found = "; ".join(_differences(counted, standing))
        if found:
            _adopt(counted, standing)
        return found


def _settle_as(counted: _Counted, standing: Standing) -> None:
    """Take from a standing how those releases ended that it has not open any more."""
    opened = {release.ticket for release in standing.open}
    for ticket in [ticket for ticket in counted.open if ticket not in opened]:
        grant = counted.open.pop(ticket)
        use = standing.uses.get(grant)
        if use is not None:
            counted.successes[grant] += use.successes > counted.successes[grant]
            counted.starts[grant] -= use.starts < counted.starts[grant]
    counted.may_settle = False


def _adopt(counted: _Counted, standing: Standing) -> None:
    """Continue from a standing that differed: it is reported once, for all that follow it."""
    counted.version, counted.status = standing.version, standing.status
    counted.digest = standing.digest
    counted.open = {release.ticket: release.grant for release in standing.open}
    counted.starts = Counter({grant: use.starts for grant, use in standing.uses.items()})
    counted.successes = Counter({grant: use.successes for grant, use in standing.uses.items()})
    counted.denied = {str(r.counter) for r in standing.requests.values() if r.denied}


def _undenied(counted: _Counted, standing: Standing) -> Iterator[str]:
    for request in standing.requests.values():
        was_denied = str(request.counter) in counted.denied
        if request.denied != was_denied:
            told = "it was denied" if was_denied else "no one denied it"
            yield f"request {request.counter}: by the records before it {told}"


def _differences(counted: _Counted, standing: Standing) -> Iterator[str]:
    # a mission ends and closes by itself; only a person suspends and resumes it
    if standing.version != counted.version:
        yield f"version {standing.version}, and by the records before it {counted.version}"
    was, now = counted.status, standing.status
    if was != now and (now, was) in {(Status.SUSPENDED, Status.ACTIVE), *_GOES_ON}:
        yield f"the mission is {now}, and by the records before it {was}"
    yield from _undenied(counted, standing)
    opened = {release.ticket for release in standing.open}
    for ticket in sorted(opened - set(counted.open))[:_NAMED]:
        yield f"the standing has `{ticket}` open, and no record before it released that"
    for ticket in sorted(set(counted.open) - opened)[:_NAMED]:
        yield f"`{ticket}` was released before it and has no outcome, and the standing has it not"
    sums = (standing.actions, counted.starts.total()), (standing.order, counted.successes.total())
    for name, (has, theirs) in zip(("actions", "order"), sums, strict=True):
        if has != theirs:
            yield f"the standing has {name} {has}, and by the records before it {theirs}"
    for name, by_grant in (("starts", counted.starts), ("successes", counted.successes)):
        for grant in sorted({*by_grant, *standing.uses}):
            use = standing.uses.get(grant)
            has = 0 if use is None else getattr(use, name)
            if has != by_grant[grant]:
                told = f"the records before it {by_grant[grant]}"
                yield f"grant `{grant}` has {has} {name}, and {told}"
