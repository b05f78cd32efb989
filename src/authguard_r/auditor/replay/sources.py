# SPDX-License-Identifier: Apache-2.0
"""What a log says of everything that a decision is made of, as it was when it was made.

Site and robot are in the first record, and in a further one when they change; missions, the
organization's policy and revocation lists in the record of when they came; the rest beside the
decision. With a trust folder every token is held to its signature again, at its time, under the
lists of that time; without one it is only read.
Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

from collections import OrderedDict
from functools import partial
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.approvals import open_approval, open_preapproval
from authguard_r.approvals.organization import (
    OrganizationPolicy,
    open_policy,
    require_sound_policy,
)
from authguard_r.audit.closed import closed_of
from authguard_r.audit.record import Record, ends_motion
from authguard_r.auditor.claims import as_token, claimed, claimed_mission, is_instance
from authguard_r.auditor.replay.preapproval import PreApprovals
from authguard_r.auditor.replay.safety import SecondGate
from authguard_r.auditor.replay.standing import Standings
from authguard_r.auditor.replay.text import GONE, NEEDED, not_there, plain, plain_facts
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest_of, unb64
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.mission import Mission
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.state import Snapshot
from authguard_r.core.token import VerifiedMission, read_token, verify_mission
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.templates import instantiate, open_template
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.trust import Trust
from authguard_r.site.model import Site, facts_of

#: Later than anything that is signed: where the log does not say when a certificate ended.
FAR_MS = 1 << 52
#: Stands for a list that was in force once and is missing now: it revokes no certificate.
UNKNOWN = RevocationList(number=0, next_update_ms=FAR_MS, serials=frozenset())
#: The number of an authority's first list, which a gate does not record.
_FIRST = 1
#: Missions, and authorities that only tokens name: one at a time counts, so a few are plenty.
_MOST_KEPT = 16


class Lacking(Struct, frozen=True):
    """Why a decision cannot be decided again: something is not there."""

    why: str


class Forged(Struct, frozen=True):
    """What no gate would have written: it does not hold, or does not fit what it lies beside."""

    why: str


class Inputs(Struct, frozen=True, kw_only=True):
    """Everything that one decision was made of, as plain data.

    Args:
        mission: as it was signed.
        digest: the mission's.
        issuer: who signed it, and until when that held; None: no trust folder says.
        facts: site, robot and the organization's policies.
        values: what the record sealed: action, state, now, standing.
        approvals: the answers, opened.
        preapprovals: pre-approvals that decisions rest on, opened.
        ends_known: every revocation list of then is at hand, so the end above is exact.
        safety: the safety gate's configuration; None: it is not in the log.
    """

    mission: dict[str, Any]
    digest: str
    issuer: Principal | None
    facts: dict[str, Any]
    values: dict[str, Any]
    approvals: list[dict[str, Any]]
    preapprovals: list[dict[str, Any]]
    ends_known: bool
    safety: dict[str, Any] | None = None


class _ActivatedMission(Struct, frozen=True, kw_only=True):
    """A mission that was made active, with what it is verified from again."""

    values: dict[str, Any]
    mission: Mission
    plain: dict[str, Any]
    issuer: Principal | None
    lists: int


class _Attachments(Struct, frozen=True, kw_only=True):
    """The types of what a decision seals; anything else is no decision of ours."""

    action: Action
    approvals: tuple[str, ...]
    now: Now
    standing: tuple[Standing, ...]
    state: tuple[_Arrived, ...]


class _Arrived(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A snapshot with its arrival."""

    snapshot: Snapshot
    arrived_mono_ms: int
    fence: int = 0


class Sources:
    """What was said so far, in the order of the log.

    Args:
        trust: whose signatures count; None: tokens are read and held to nothing.
    """

    def __init__(self, trust: Trust | None) -> None:
        self._trust = None if trust is None else _as_at_first(trust)
        self._lists = 0
        self._facts: SiteFacts | None = None
        self._plain_facts: dict[str, Any] = {}
        #: The least fence that a decision may name, and whether the log's decisions name any.
        self._fence, self._ended, self._has_fences = 0, 0, False
        self._no_site = "neither site nor mission is in this part of a log"
        self._missions: OrderedDict[str, _ActivatedMission] = OrderedDict()
        self._gone: OrderedDict[str, str] = OrderedDict()
        self._standings, self._preapprovals = Standings(), PreApprovals()
        self.second = SecondGate()

    def note(self, record: Record, values: dict[str, Any]) -> Forged | None:
        """Take in what a record says of later decisions; return what does not hold of it."""
        if ends_motion(record.kind, record.link.decision):
            self._fence, self._ended = self._fence + 1, record.link.seq
        try:
            if record.kind == "genesis":
                self._begin(record, values)
                self._fence = record.link.time_ms
                self.second.configure(record, values, "safety")
            elif record.kind == "management" and record.link.decision == "configuration":
                self.second.configure(record, values, "digest")
            elif record.kind == "revocation":
                self._list(record, values)
            elif record.kind == "management" and record.link.decision == "site":
                self._begin(record, values)
            elif record.kind == "management" and record.link.decision == "activate":
                self._activate(record, values)
            elif record.kind == "management" and record.link.decision == "risk-policy":
                self._policy(record, values)
        except AuthGuardError as error:
            self.pass_by(record, values)
            return Forged(f"{error.reason}: {error.message}")
        wrong = self.pass_by(record, values)
        return Forged(wrong) if wrong else None

    def inputs(self, record: Record, values: dict[str, Any]) -> Inputs | Lacking | Forged:
        """Return everything that a decision was made of, or why that cannot be said."""
        found = self._inputs(record, values)
        wrong = self.pass_by(record, values)
        return Forged(wrong) if wrong and not isinstance(found, Forged) else found

    def pass_by(self, record: Record, values: dict[str, Any]) -> str:
        """Count what a decision released, decided again or not; return what does not hold of it."""
        wrong = self._standings.note(record, values), self._preapprovals.note(record)
        return wrong[0] or wrong[1]

    def _inputs(self, record: Record, values: dict[str, Any]) -> Inputs | Lacking | Forged:
        gone = not_there(record, values)
        if gone:
            return Lacking(gone)  # whether an order explains that, `audit.missing` says
        digest = str(record.open.get("mission"))
        lacking = self._lacking(record, digest, values)
        if lacking is not None:
            return Lacking(lacking)
        kept = self._missions.get(digest)
        if kept is None:  # the log is there from its beginning on, and a gate always writes it
            return Forged("no record before it made its mission active")
        try:
            beside = msgspec.convert({name: values[name] for name in NEEDED}, _Attachments)
            _require_linked(record, beside)
            self._require_fence(beside)
            wrong = "".join(map(self._standings.wrong, beside.standing))
            wrong = wrong or "".join(map(self._preapprovals.wrong, beside.standing))
            if wrong:
                return Forged(wrong)
            return Inputs(
                mission=kept.plain,
                digest=digest,
                issuer=self._issuer(digest, kept, beside.now),
                facts=self._plain_facts,
                values=values,
                approvals=self._answers(beside, is_preapproval=False),
                preapprovals=self._answers(beside, is_preapproval=True),
                ends_known=self._trust is not None and not self._has_unknown_lists(),
                safety=self.second.config,
            )
        except msgspec.ValidationError as error:
            return Forged(f"not the inputs of a decision: {error}")
        except AuthGuardError as error:
            return Forged(f"{error.reason}: {error.message}")

    def _require_fence(self, beside: _Attachments) -> None:
        """Require that a decision asked for state from after the last motion.

        Logs of before there were fences name none; once one is named, each decision names one.

        Raises:
            MalformedError: it did not.
        """
        for state in beside.state:
            # one writer writes both
            self._has_fences = self._has_fences or state.fence > 0 or self.second.is_told
            if state.fence and not self.second.is_told:
                raise MalformedError("no safety configuration comes before it", where="safety")
            if self._has_fences and state.fence < self._fence:
                raise MalformedError(
                    f"a motion ended with record {self._ended}, and state from before it was "
                    f"taken: expected at least fence {self._fence}, got {state.fence}",
                    where="state.fence",
                )
            self._fence = max(self._fence, state.fence)

    def _lacking(self, record: Record, digest: str, values: dict[str, Any]) -> str | None:
        """Return what of the log a decision needs and does not have, None when it has all."""
        if self._facts is None:
            return self._no_site
        kept = self._missions.get(digest)
        if kept is None:
            return self._gone.get(digest)
        said = record.open.get("reasons")
        reasons = said if isinstance(said, list) else []
        if self._trust is None and values["approvals"]:
            return "give --trust to name the person who answered"
        if self._trust is None and reasons == [Reason.CERTIFICATE_EXPIRED]:
            return "when a certificate ended, only --trust says"
        return None

    def _begin(self, record: Record, values: dict[str, Any]) -> None:
        risk = () if self._facts is None else self._facts.risk
        self._facts = None
        if "site" not in values:
            self._no_site = f"{GONE}: site"
            return
        try:
            site = msgspec.convert(values["site"], Site)
            robot, profile = record.open["robot"], record.open["profile"]
            facts = facts_of(site, rid=robot, profile=profile)
        except (msgspec.ValidationError, LookupError, TypeError, ValueError) as error:
            self._no_site = "its site is malformed"
            raise MalformedError(str(error), where="site") from error
        self._no_site = "its site is not the one that it names"
        if facts.digest != record.open.get("site"):
            raise MalformedError("expected the site that the record names", where="site")
        self._put(replace(facts, risk=risk))

    def _put(self, facts: SiteFacts) -> None:
        self._facts, self._plain_facts = facts, plain_facts(facts)

    def _policy(self, record: Record, values: dict[str, Any]) -> None:
        """From here on the organization's policy counts beside every mission's."""
        if self._facts is None:
            return
        if "token" not in values:
            why = closed_of(record, values).why("token") or GONE
            self._facts, self._no_site = None, f"{why}: the organization's policy"
            return
        if self._trust is None:
            found = require_sound_policy(
                claimed(values["token"], OrganizationPolicy, tag=Tag.RISK_POLICY)
            )
        else:
            found = open_policy(
                self._known(values["token"]), verifier=self._trust, now=_at(record)
            ).policy
        self._put(replace(self._facts, risk=(found.policy,)))

    def _list(self, record: Record, values: dict[str, Any]) -> None:
        """From here on this list is in force."""
        if self._trust is None:
            return
        self._lists += 1
        if "list" in values:
            der, found = self._trust.read_newer(as_token(values["list"]), Now(0, 0))
            self._trust.put_in_force({der: found})
            return
        name = record.open.get("authority")
        gone = {d: found for d, found in self._trust.lists.items() if found.authority == name}
        self._trust.put_in_force({d: replace(UNKNOWN, authority=name) for d in gone})

    def _activate(self, record: Record, values: dict[str, Any]) -> None:
        digest = str(record.open.get("mission"))
        if "token" not in values:
            why = closed_of(record, values).why("token") or GONE
            self._note_gone(digest, f"{why}: the mission's token")
            return
        self._note_gone(digest, "its mission is not valid")
        verified = self._verified(values, _at(record))
        mission = claimed_mission(values) if verified is None else verified.mission
        if digest_of(Tag.MISSION, mission) != digest:
            raise MalformedError("expected the mission that the record names", where="token")
        kept = _ActivatedMission(
            values=values,
            mission=mission,
            plain=plain(mission),
            issuer=None if verified is None else verified.issuer,
            lists=self._lists,
        )
        self._missions[digest] = kept
        self._missions.move_to_end(digest)
        while len(self._missions) > _MOST_KEPT:
            self._missions.popitem(last=False)
        final = frozenset(grant.id for grant in mission.actions if grant.irreversible)
        self._standings.irreversible[str(mission.mid)] = final

    def _note_gone(self, digest: str, why: str) -> None:
        self._gone[digest] = why
        while len(self._gone) > _MOST_KEPT:
            self._gone.popitem(last=False)

    def _verified(self, values: dict[str, Any], now: Now) -> VerifiedMission | None:
        """Return the mission of an activation as its signatures hold it; None without trust."""
        if self._trust is None:
            return None
        token = self._known(values["token"])
        if not is_instance(values):
            return verify_mission(token, verifier=self._trust, now=now, roles=ISSUER_ROLES)
        signed = self._known(values.get("template"))
        template = open_template(signed, verifier=self._trust, now=now, roles=ISSUER_ROLES)
        return instantiate(token, template, verifier=self._trust, now=now).mission

    def _issuer(self, digest: str, kept: _ActivatedMission, now: Now) -> Principal | None:
        """Return who issued a mission, and until when that holds; again once lists have changed."""
        if kept.lists != self._lists:
            verified = self._verified(kept.values, now)
            issuer = None if verified is None else verified.issuer
            kept = replace(kept, issuer=issuer, lists=self._lists)
            self._missions[digest] = kept
        return kept.issuer

    def _answers(self, beside: _Attachments, *, is_preapproval: bool) -> list[dict[str, Any]]:
        """Return the answers that were looked at, or the pre-approvals."""
        trust: Any = self._trust
        opened = partial(open_preapproval if is_preapproval else open_approval, verifier=trust)
        return [
            plain(opened(self._known(token), now=beside.now))
            for token in (beside.approvals if trust is not None else ())  # else none counted
            if (read_token(as_token(token)).kind is Tag.PREAPPROVAL) is is_preapproval
        ]

    def _known(self, token: Any) -> bytes:
        """Return a token's bytes, once each authority in it has a list, if only an unknown one.

        An authority whose certificate was renewed since then is not in the folder any more; its
        old one is in the token, and the root's signature on it is held as ever.
        """
        data = as_token(token)
        lists = {} if self._trust is None else self._trust.lists
        for endorsement in read_token(data).endorsements:
            der = unb64(endorsement.chain[1], where="token.chain")
            if self._trust is not None and der not in lists and len(lists) < 4 * _MOST_KEPT:
                lists[der] = UNKNOWN
                self._trust.put_in_force({der: UNKNOWN})
        return data

    def _has_unknown_lists(self) -> bool:
        lists = () if self._trust is None else self._trust.lists.values()
        return UNKNOWN.number in {found.number for found in lists}


def _as_at_first(trust: Trust) -> Trust:
    """Return the same roots with the lists of before the log began.

    A list that is later than an authority's first came into the log when a gate had it, so it is
    not in force before its record.
    """
    lists = {
        der: found if found.number <= _FIRST else replace(UNKNOWN, authority=found.authority)
        for der, found in trust.lists.items()
    }
    return Trust(trust.roots, lists)


def _at(record: Record) -> Now:
    return Now(record.link.time_ms, 0)


def _require_linked(record: Record, beside: _Attachments) -> None:
    """Hold what was sealed to what the record links: both speak of one action and one state.

    Raises:
        MalformedError: they do not.
    """
    states = ["-", *(digest_of(Tag.STATE, item.snapshot) for item in beside.state)]
    fits = {
        "action": record.link.action == digest_of(Tag.ACTION, beside.action),
        "state": record.link.state == states[-1] and len(states) <= 2,
        "time": record.link.time_ms == beside.now.utc_ms,
    }
    for name, holds in fits.items():
        if not holds:
            raise MalformedError(f"expected the {name} that the record links", where=name)
