# SPDX-License-Identifier: Apache-2.0
"""Approval requests: whose answers count and why not, and where the log has what was asked.

Whether an answer counts, the core says (`core.checks.approval`), asked here with that answer alone:
nothing is decided twice. What was asked is in the decision's record, so only its number is held.
Spec page: docs/spec/approval.md#answers
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from msgspec import Struct, convert, structs

from authguard_r.audit.record import LogRow, Record, Sealed, read_record, read_sealed
from authguard_r.core.action import Action
from authguard_r.core.approval import Approval, ApprovalVerdict, VerifiedApproval
from authguard_r.core.checks.approval import Need, check_approval
from authguard_r.core.checks.case import Case
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import ActionType, Digest, MissionId, ToolId
from authguard_r.core.mission import Grant, RiskPolicy
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import ApprovalRequest, Standing
from authguard_r.core.token import VerifiedMission
from authguard_r.store.transactions import Transaction

_HELD = "question"
#: Stands for a question that is not stored any more: it names no place.
UNTOLD = Action(type=ActionType("untold"), tool=ToolId("untold"))
#: Opens a row of the log (`Ledger.opened`).
Opened = Callable[[tuple[int, bytes, bytes, bytes]], LogRow]


class RecordedQuestion(Struct, frozen=True):
    """What a decision's record says of a request: its link and open part, and its values."""

    record: Record
    sealed: dict[str, Sealed]

    def value(self, name: str, kind: Any) -> Any:
        """Return a sealed value, None when it was destroyed."""
        item = self.sealed.get(name)
        return None if item is None else convert(item.value, kind)


class OpenRequest(Struct, frozen=True, kw_only=True):
    """One open request with everything that says whether an answer to it counts.

    Args:
        verified: the mission.
        grant: the grant that asked.
        request: the request.
        action: what was proposed, from the log; `UNTOLD` when that is gone.
        standing: the registry's entry, with the request in it.
        facts: the signed site, the gate's identity, the organization's policies.
    """

    verified: VerifiedMission
    grant: Grant
    request: ApprovalRequest
    action: Action
    standing: Standing
    facts: SiteFacts

    @property
    def policies(self) -> tuple[RiskPolicy, ...]:
        """The mission's policy and the organization's."""
        return (self.verified.mission.risk_policy, *self.facts.risk)

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles whose holders may answer: those that every policy names."""
        named = [set(policy.roles) for policy in self.policies]
        return tuple(sorted(set.intersection(*named)))


def find_asked(
    act: Transaction,
    said: Approval,
    *,
    mission: Callable[[Transaction, Digest], VerifiedMission],
    facts: SiteFacts,
    opened: Opened,
) -> OpenRequest | None:
    """Return the open request of the active mission that an answer names; None without one.

    Args:
        act: the act.
        said: the answer.
        mission: returns a mission version by its digest (`Intake.mission`).
        facts: the signed site and the gate's identity.
        opened: opens a row of the log.

    Raises:
        AuthGuardError: the mission has no valid signature now.
    """
    standing = act.standing(said.mid)
    if standing is None or act.active() != said.mid:
        return None
    named = {r.counter: grant for grant, r in standing.requests.items()}.get(said.counter)
    if named is None:
        return None
    verified = mission(act, standing.digest)
    action = None
    with suppress(StoreError):
        action = read_told(act, said.mid, said.counter, opened).value("action", Action)
    return OpenRequest(
        verified=verified,
        grant=next(grant for grant in verified.mission.actions if grant.id == named),
        request=standing.requests[named],
        action=action or UNTOLD,
        standing=standing,
        facts=facts,
    )


def is_asked(act: Transaction, approval: Approval) -> bool:
    """True while the mission has an open request of the answer's number."""
    standing = act.standing(approval.mid)
    open_now = () if standing is None else standing.requests.values()
    return any(request.counter == approval.counter for request in open_now)


def read_told(act: Transaction, mid: MissionId, counter: int, opened: Opened) -> RecordedQuestion:
    """Return the record of the decision that opened a request.

    Raises:
        StoreError: there is no such record, or it does not hold what such a record holds.
    """
    number = record_of(act, mid, counter)
    rows = () if number is None else act.rows(number, 1)
    where = f"request {counter}"
    if not rows:
        raise StoreError("its record is gone", where=where, reason=Reason.STORE_CORRUPT)
    row = opened(rows[0])
    try:
        return RecordedQuestion(
            read_record(row.record, where=where), read_sealed(row.sealed, where=where)
        )
    except MalformedError as error:
        raise StoreError(error.message, where=where, reason=Reason.STORE_CORRUPT) from error


def fits(asked: OpenRequest, item: VerifiedApproval, now: Now) -> bool:
    """True when the check, with this answer alone, says another thing than with none."""
    in_time = now.utc_ms <= asked.request.expires_ms
    return in_time and bool(_checked(asked, (item,), now) != _checked(asked, (), now))


def behind(asked: OpenRequest, items: tuple[VerifiedApproval, ...], now: Now) -> int:
    """Return how many people stand behind the action, the issuer included, as the check counts."""
    enough = [n for n in range(1, asked.request.required + 1) if not _checked(asked, items, now, n)]
    return max(enough, default=1)


def why_not(asked: OpenRequest | None, item: VerifiedApproval, now: Now) -> str:
    """Return the code of why an answer does not count; empty when it does.

    The check decides; this only names what is wrong, for the person who answered and for the log.

    Args:
        asked: the open request of its number; None when there is none.
        item: the answer.
        now: the instant to ask about.
    """
    if asked is None or (
        asked.action is UNTOLD and item.approval.verdict is ApprovalVerdict.APPROVE
    ):
        return str(Reason.APPROVAL_TIMEOUT)
    if fits(asked, item, now):
        too_late = asked.request.denied and item.approval.verdict is ApprovalVerdict.APPROVE
        return str(Reason.APPROVAL_DENIED) if too_late else ""
    said, signer, verified = item.approval, item.approver, asked.verified
    wrong = (
        (said.rid != asked.facts.robot.rid, Reason.ROBOT_MISMATCH),
        (said.mid != verified.mission.mid, Reason.MISSION_UNKNOWN),
        ((said.version, said.mission) != _named(verified), Reason.SUPERSEDED),
        (said.counter != asked.request.counter, Reason.APPROVAL_TIMEOUT),
        (said.grant != asked.grant.id, Reason.ACTION_OUT_OF_SCOPE),
        (said.scope != asked.request.scope, Reason.ACTION_OUT_OF_SCOPE),
        (said.situation != asked.request.situation, Reason.GUARD_FALSE),
        (now.utc_ms > asked.request.expires_ms, Reason.APPROVAL_TIMEOUT),
        (now.utc_ms > min(said.expires_ms, signer.usable_until_ms), Reason.EXPIRED),
        (signer.role not in asked.roles, Reason.ROLE_DENIED),
        (signer.id == verified.mission.issuer, Reason.ISSUER_MISMATCH),
        (not signer.scope.covers(said.rid, asked.action.places), Reason.SIGNER_OUT_OF_SCOPE),
    )
    found = [reason for is_wrong, reason in wrong if is_wrong]
    # a person who may be behind the mission's signature already, or a group of such people
    return str(found[0] if found else Reason.ISSUER_MISMATCH)


def note_request(act: Transaction, mid: MissionId, counter: int, seq: int) -> None:
    """Note the number of the record in which a request was opened."""
    act.put(_HELD, _key(mid, counter), str(seq).encode("ascii"))


def record_of(act: Transaction, mid: MissionId, counter: int) -> int | None:
    """Return the number of the record in which a request was opened; None when there is none."""
    held = act.get(_HELD, _key(mid, counter))
    return int(held) if held is not None and held.isdigit() else None


def is_denied(asked: OpenRequest, items: tuple[VerifiedApproval, ...], now: Now) -> bool:
    """True when a person who may answer denied."""
    return any(
        item.approval.verdict is ApprovalVerdict.DENY and not why_not(asked, item, now)
        for item in items
    )


def _key(mid: MissionId, counter: int) -> str:
    return f"{mid}:{counter}"


def _named(verified: VerifiedMission) -> tuple[int, str]:
    return verified.mission.version, verified.digest


def _checked(
    asked: OpenRequest, items: tuple[VerifiedApproval, ...], now: Now, required: int | None = None
) -> Any:
    """Return what step 7 says of the request with these answers and no others.

    The request may be over or denied by now; whether an answer to it fits is asked apart from that,
    and with a number of people that no answers reach, so that each that fits is seen.
    """
    undenied = structs.replace(asked.request, denied=False)
    at = structs.replace(now, utc_ms=min(now.utc_ms, asked.request.expires_ms))
    case = Case(
        verified=asked.verified,
        action=asked.action,
        kind=None,
        state=None,
        facts=asked.facts,
        now=at,
        standing=structs.replace(asked.standing, requests={asked.grant.id: undenied}),
        approvals=tuple(i for i in items if required is None or i.approval.verdict != "deny"),
    )
    need = Need(
        risk=0,
        required=_NEVER if required is None else required,
        tier=asked.request.required,
        scope=asked.request.scope,
        situation=asked.request.situation,
    )
    return check_approval(case, asked.grant, need)


#: More people than there are.
_NEVER = 1 << 20
