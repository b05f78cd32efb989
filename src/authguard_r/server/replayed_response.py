# SPDX-License-Identifier: Apache-2.0
"""The report of a step, read from the log: the same answer as the first time.

The log has it already, so nothing else is held. A value that was destroyed since is shown as
absent. Spec page: docs/spec/gate-protocol.md#idempotency
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.audit.deviation import violated_fields
from authguard_r.audit.record import NONE, Record, Sealed
from authguard_r.core.action import Action
from authguard_r.core.errors import StoreError
from authguard_r.core.finding import Finding
from authguard_r.core.reasons import Reason, may_pass_later
from authguard_r.enforcement.json_views import action_json, finding_json
from authguard_r.enforcement.report import NOT_EVALUATED


def replayed_step(
    decision: Record, sealed: dict[str, Sealed], outcome: Record | None, beside: dict[str, Sealed]
) -> dict[str, Any]:
    """Return the report of one step, as `json_views.report_json` made it.

    Args:
        decision: the record of the decision.
        sealed: the values beside it.
        outcome: the record of its outcome; None while it is not recorded.
        beside: the values beside that.

    Raises:
        StoreError: the records do not hold what such records hold.
    """
    opened, link = decision.open, decision.link
    try:
        findings = _findings(sealed)
        return {
            "outcome": link.decision,
            "reasons": opened["reasons"],
            "findings": findings,
            "influenced_by": _value(sealed, "influences"),
            "grant": None if opened.get("grant", NONE) == NONE else opened["grant"],
            "required_approvals": opened["required"],
            "risk": opened["risk"],
            "deviation": opened["deviation"][0] / opened["deviation"][1],
            "violated_fields": list(violated_fields(map(Reason, opened["reasons"]))),
            "weights": opened["weights"],
            "mission": {"mid": link.mid, "version": opened["version"], "digest": opened["mission"]},
            "action_digest": link.action,
            "retryable": may_pass_later(tuple(Reason(f["reason"]) for f in findings)),
            "authoritative": True,
            "action": _action(sealed),
            "safety": _safety(opened["safety"]),
            "released": opened["ticket"] != NONE,
            "executed": outcome is not None and outcome.link.decision != "not_started",
            "execution": {
                "outcome": None if outcome is None else outcome.link.decision,
                "reasons": _findings(beside),
                "recorded": True,
            },
            "seq": link.seq,
            **({"repairs": opened["repairs"]} if "repairs" in opened else {}),
        }
    except (KeyError, IndexError, TypeError, ZeroDivisionError, ValueError) as error:
        raise StoreError(
            f"the answer cannot be repeated from its record: {error}",
            where=f"record {link.seq}",
            reason=Reason.STORE_CORRUPT,
        ) from error


def _value(sealed: dict[str, Sealed], name: str) -> Any:
    return sealed[name].value if name in sealed else []


def _findings(sealed: dict[str, Sealed]) -> list[dict[str, Any]]:
    found = msgspec.convert(_value(sealed, "findings"), tuple[Finding, ...])
    return [finding_json(finding) for finding in found]


def _action(sealed: dict[str, Sealed]) -> dict[str, Any] | None:
    if "action" not in sealed:
        return None
    return action_json(msgspec.convert(sealed["action"].value, Action))


def _safety(told: Any) -> Any:
    """Return the safety gate's verdict; an action with an effect was safe."""
    if told == NOT_EVALUATED:
        return told
    return {"safe": told["safe"], "findings": [], "repair": None}
