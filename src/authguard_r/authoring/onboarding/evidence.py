# SPDX-License-Identifier: Apache-2.0
"""What a log of a shadow run holds: proposed actions, and plans that could not be normalized.

The whole log is verified before anything in it counts, and only records that are marked `shadow`
count: what an enforcing gate let through was signed for, and an unmarked record has no author. What
was not used is listed with the reason. Spec page: docs/spec/audit-record.md#shadow
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.audit.closed import closed_of
from authguard_r.audit.record import LogRow, Record, Sealed, read_record, read_sealed
from authguard_r.audit.sealed_envelopes import ACT
from authguard_r.audit.verify import Verification, verify_rows
from authguard_r.core.action import Action
from authguard_r.core.encoding import unb64
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.core.state import Snapshot, place_of
from authguard_r.normalize.dialects import Dialect
from authguard_r.normalize.parse import MAX_TEXT
from authguard_r.provenance.context import Influence
from authguard_r.site.model import Site, facts_of, profile_digest, site_digest
from authguard_r.site.strict import convert

SHADOW = "shadow"
#: Longest plan that a record keeps, in bytes: the longest that is ever looked at.
MAX_PLAN = MAX_TEXT
#: Most bytes of all plans of one log together.
MAX_PLANS = 1 << 26
#: Most records of one log that are learned from; a run that is longer is learned from in parts.
MAX_RECORDS = 100_000
_LEARNED = frozenset({"decision", "refusal"})


class Unused(Struct, frozen=True):
    """One record that was not learned from: its number, and why."""

    seq: int
    why: str


class Proposed(Struct, frozen=True, kw_only=True):
    """One action that the planner proposed, in the site's words.

    Args:
        seq: its record, the first that speaks of it.
        action: without labels and meta; the site knows everything in it.
        place: where the robot was attested to be; empty when it is unknown.
        influences: inputs that had mentioned what the action carries; None when they were not
            searched.
    """

    seq: int
    action: Action
    place: frozenset[RegionId]
    influences: tuple[Influence, ...] | None


class RawPlan(Struct, frozen=True):
    """What a planner wrote, byte for byte, and the dialect that it was read in."""

    seq: int
    data: bytes
    dialect: Dialect


class ShadowEvidence(Struct, frozen=True, kw_only=True):
    """Everything that a shadow run shows.

    Args:
        log: that the log is whole, and how long it is.
        robot: whose log it is, as its first record says; None when it does not.
        proposed: actions, in order.
        plans: plans that were not normalized, in order.
        unused: what was not learned from.
    """

    log: Verification
    robot: RobotId | None
    proposed: tuple[Proposed, ...]
    plans: tuple[RawPlan, ...]
    unused: tuple[Unused, ...]


def gather(
    rows: Iterable[LogRow], site: Site, *, opened: Callable[[LogRow], LogRow] | None = None
) -> ShadowEvidence:
    """Return what a log shows, once it is whole.

    Args:
        rows: the log as it is stored, in order; trusted in nothing.
        site: the site in whose words actions are to be; those of another site do not count.
        opened: opens what of a row is sealed, as far as a reader's key goes; None: nothing is.

    Raises:
        RefusedError: the log is not whole, or no record of it is marked `shadow`.
        MalformedError: more records than are learned from at once, or one is not what was sealed.
        AuthenticityError: a key does not open what was wrapped for it.
    """
    found = _Gathered(site, opened)
    log = verify_rows(found.passing(rows), terminal=None)
    if not log.whole:
        message = f"nothing is learned from a log that is not whole: {log.fault}"
        raise RefusedError(message, where=log.where, reason=Reason.STORE_CORRUPT)
    if not found.proposed and not found.plans and not any(found.marked):
        message = "expected records of a shadow run: no record is marked `shadow`"
        raise RefusedError(message, where="log", reason=Reason.WRONG_KIND)
    return ShadowEvidence(
        log=log,
        robot=found.robot,
        proposed=tuple(found.proposed),
        plans=tuple(found.plans),
        unused=tuple(found.unused),
    )


class _Gathered:
    """Takes out of each row what can be learned from it, once the verifier has let it pass."""

    def __init__(self, site: Site, opened: Callable[[LogRow], LogRow] | None) -> None:
        self._site = site
        self._opened = opened
        self._facts: SiteFacts | None = None
        self._same_site = False
        self.robot: RobotId | None = None
        self.marked: list[bool] = []
        self._heard = 0
        self.proposed: list[Proposed] = []
        self.plans: list[RawPlan] = []
        self.unused: list[Unused] = []

    def passing(self, rows: Iterable[LogRow]) -> Iterator[LogRow]:
        """Yield the rows as they are."""
        for row in rows:
            yield row  # the verifier asks for the next one only when this one was valid
            self._take(row if self._opened is None else self._opened(row))

    def _take(self, row: LogRow) -> None:
        where = f"record {row.seq}"
        record = read_record(row.record, where=where)
        sealed = read_sealed(row.sealed, where=where)
        if record.kind == "genesis":
            self._begin(record)
        elif record.kind in _LEARNED:
            if len(self.marked) >= MAX_RECORDS:
                message = f"expected at most {MAX_RECORDS} records to learn from"
                raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
            self._learn(row.seq, record, sealed)

    def _begin(self, record: Record) -> None:
        """Take in whose log it is; only actions in the words of this very site can be read."""
        name = record.open.get("robot")
        robot = None if not isinstance(name, str) else self._site.robots.get(RobotId(name))
        self._same_site = record.open.get("site") == site_digest(self._site)
        if robot is not None:
            self.robot = RobotId(str(name))
            profile = profile_digest(robot.profile)
            self._facts = facts_of(self._site, rid=self.robot, profile=profile)

    def _learn(self, seq: int, record: Record, sealed: dict[str, Sealed]) -> None:
        marked = record.open.get("mode") == SHADOW
        self.marked.append(marked)
        if not marked:
            self.unused.append(Unused(seq, "not marked `shadow`"))
            return
        if "repeats" in record.open:
            self.unused.append(Unused(seq, "refusals that were counted without a record"))
            return
        acts = record.kind == "decision" or not {"action", ACT}.isdisjoint(record.committed)
        name = "action" if acts else "plan"
        closed = "" if name in sealed else closed_of(record, sealed).why(name)
        if closed:
            self.unused.append(Unused(seq, f"its `{name}` is {closed}"))
            return
        try:
            if acts:
                self.proposed.append(self._proposed(seq, sealed))
            else:
                self.plans.append(self._plan(seq, sealed))
        except MalformedError as error:
            place = f" (at {error.where})" if error.where else ""
            self.unused.append(Unused(seq, f"{error.message}{place}"))

    def _proposed(self, seq: int, sealed: dict[str, Sealed]) -> Proposed:
        if not self._same_site:
            raise MalformedError("its vocabulary is another site model's")
        action = convert(_value(sealed, "action"), Action, where="action")
        action = msgspec.structs.replace(action, provenance={}, meta=None)
        require_known(action, self._site)
        return Proposed(
            seq=seq,
            action=action,
            place=self._place(sealed),
            influences=_influences(sealed),
        )

    def _plan(self, seq: int, sealed: dict[str, Sealed]) -> RawPlan:
        plan = _plan(seq, sealed)
        if self._heard + len(plan.data) > MAX_PLANS:
            raise MalformedError(f"plans of more than {MAX_PLANS} bytes together")
        self._heard += len(plan.data)
        return plan

    def _place(self, sealed: dict[str, Sealed]) -> frozenset[RegionId]:
        """Return where the robot was attested to be; nowhere when nothing readable says so."""
        states: Any = sealed["state"].value if "state" in sealed else ()
        if not isinstance(states, list) or not states or self._facts is None:
            return frozenset()
        said = states[0].get("snapshot") if isinstance(states[0], dict) else None
        return place_of(convert(said, Snapshot, where="state.snapshot"), self._facts)


def _value(sealed: dict[str, Sealed], name: str) -> Any:
    if name not in sealed:
        raise MalformedError(f"its `{name}` is not there (destroyed, or never recorded)")
    return sealed[name].value


def _influences(sealed: dict[str, Sealed]) -> tuple[Influence, ...] | None:
    if "influences" not in sealed:
        return None
    return convert(sealed["influences"].value, tuple[Influence, ...], where="influences")


def _plan(seq: int, sealed: dict[str, Sealed]) -> RawPlan:
    text, dialect = _value(sealed, "plan"), sealed.get("dialect")
    if not isinstance(text, str) or len(text) > MAX_PLAN * 2:
        raise MalformedError(f"expected a plan of at most {MAX_PLAN} bytes", where="plan")
    data = unb64(text, where="plan")
    if len(data) > MAX_PLAN:
        raise MalformedError(f"expected a plan of at most {MAX_PLAN} bytes", where="plan")
    said = Dialect.AUTO if dialect is None else dialect.value
    return RawPlan(seq, data, convert(said, Dialect, where="dialect"))


def require_known(action: Action, site: Site) -> None:
    """Hold an action to the site's words: a proposal can speak of nothing else.

    Raises:
        MalformedError: a type that no grant can have, or a thing or a parameter that the site or
            the type does not have.
    """
    kind = site.vocabulary.get(action.type)
    if kind is None or kind.state_writing:
        raise MalformedError("expected a type that can be granted", where="action.type")
    told = {
        "object": action.object,
        "source": action.source,
        "destination": action.destination,
        "route": action.route or None,
    }
    for field, value in told.items():
        if value is not None and field not in kind.fields:
            raise MalformedError("expected a field of its type", where=f"action.{field}")
    if action.object is not None and action.object not in site.objects:
        raise MalformedError("expected an object of the site", where="action.object")
    for region in (action.source, action.destination, *action.route):
        if region is not None and region not in site.regions:
            raise MalformedError("expected a region of the site", where="action")
    for name in action.params:
        if name not in kind.params:
            raise MalformedError("expected a parameter of its type", where=f"action.params.{name}")
