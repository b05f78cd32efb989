# SPDX-License-Identifier: Apache-2.0
"""What a log's own records say was pre-approved and used up, compared with each standing in it.

A decision seals the standing that it was made on, and names the pre-approval that it rests on. Here
the same is counted from the records before it, so that one used too often is found.
Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct, field

from authguard_r.audit.record import NONE, Record
from authguard_r.core.standing import Standing


class _Taken(Struct):
    """One pre-approval: whose, of which grant, and how many releases it still covers."""

    by: str
    grant: str
    left: int


class _Mission(Struct):
    """What is pre-approved of one mission version, and which grant asked which request."""

    taken: dict[str, _Taken] = field(default_factory=dict)
    asked: dict[str, str] = field(default_factory=dict)

    def drop(self, *, grant: str, by: str | None = None) -> None:
        """Drop what one person, or with None every person, pre-approved of a grant."""
        self.taken = {
            digest: one
            for digest, one in self.taken.items()
            if one.grant != grant or by not in {None, one.by}
        }


class PreApprovals:
    """What is pre-approved, counted record by record."""

    def __init__(self) -> None:
        self._missions: dict[str, _Mission] = {}

    def note(self, record: Record) -> str:
        """Count a record; return what does not hold of it, empty when it does."""
        told, said = record.open, record.link.decision
        mission = self._missions.setdefault(record.link.mid, _Mission())
        if record.kind == "decision":
            if "asks" in told:
                mission.asked[str(told["asks"])] = str(told.get("grant"))
            return self._used(mission, told)
        if record.kind != "management":
            return ""
        if said == "preapprove":
            by, grant = str(told.get("by")), str(told.get("grant"))
            mission.drop(grant=grant, by=by)
            if _number(told.get("uses")):
                taken = _Taken(by=by, grant=grant, left=_number(told.get("uses")))
                mission.taken[str(told.get("preapproval"))] = taken
        elif said == "answer" and told.get("closes") is True:
            mission.drop(grant=mission.asked.get(str(told.get("counter")), ""))
        elif said in {"activate", "accept_store"}:
            mission.taken = {}
        elif said == "shred":
            self._missions.pop(str(told.get("of")), None)
        return ""

    def _used(self, mission: _Mission, told: dict[str, Any]) -> str:
        digest = told.get("preapproved")
        if digest is None or told.get("ticket") == NONE:
            return ""
        taken = mission.taken.get(str(digest))
        if taken is None:
            return f"it rests on the pre-approval `{digest}`, and no record before it took that in"
        taken.left -= 1
        return "" if taken.left >= 0 else f"the pre-approval `{digest}` was used up before it"

    def wrong(self, standing: Standing) -> str:
        """Return where a standing differs from what was counted; empty where it does not."""
        mission = self._missions.get(standing.mid, _Mission())
        counted = {digest: one.left for digest, one in mission.taken.items() if one.left}
        held = {str(digest): left for digest, left in standing.preapproved.items() if left}
        if held == counted:
            return ""
        return f"the standing has pre-approvals {held}, and by the records before it {counted}"


def _number(value: object) -> int:
    return value if type(value) is int and value > 0 else 0
