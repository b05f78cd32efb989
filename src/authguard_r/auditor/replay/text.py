# SPDX-License-Identifier: Apache-2.0
"""The gate's data in the words of the specification, for an independent decision.

Spec page: docs/spec/decision.md
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.audit.closed import closed_of
from authguard_r.audit.record import Record
from authguard_r.core.facts import ActionKind, RegionFacts, SiteFacts

#: Not sealed for others, and in no box that was destroyed: taken out of the log by themselves.
GONE = "sealed values are gone"
#: What a decision's record seals of the decision's inputs.
NEEDED = ("action", "approvals", "now", "standing", "state")


def not_there(record: Record, values: dict[str, Any]) -> str:
    """Return which parts of a decision are missing, and why; empty when all are there.

    What was destroyed is destroyed for every reader, so it is said before what is only sealed.
    """
    left = [name for name in NEEDED if name not in values]
    closed = closed_of(record, values)
    told: dict[str, list[str]] = {"destroyed": [], "sealed": [], GONE: []}
    for name in left:
        told[closed.why(name) or GONE].append(name)
    return next((f"{why}: {', '.join(names)}" for why, names in told.items() if names), "")


def plain(value: Any) -> Any:
    """Return a struct as the plain JSON data that the specification speaks of."""
    return msgspec.json.decode(msgspec.json.encode(value, order="deterministic"))


def plain_facts(facts: SiteFacts) -> dict[str, Any]:
    """Return facts in the shape of the specification."""
    risk = [plain(policy) for policy in facts.risk]
    sources = {str(field): sorted(labels) for field, labels in facts.sources.items()}
    return {
        "digest": facts.digest,
        "robot": {
            "rid": facts.robot.rid,
            "profile": facts.robot.profile,
            "tools": {kind: sorted(tools) for kind, tools in facts.robot.tools.items()},
        },
        "regions": {region: _region(known) for region, known in facts.regions.items()},
        "objects": dict(facts.objects),
        "vocabulary": {kind: _kind(model) for kind, model in facts.vocabulary.items()},
        **({"risk": risk} if risk else {}),
        **({"sources": sources} if sources else {}),
    }


def _region(known: RegionFacts) -> dict[str, Any]:
    return {
        "map": known.area.map,
        "floor": known.area.floor,
        "points": [list(point) for point in known.area.points],
        "tags": sorted(known.tags),
        **({"around": sorted(known.around)} if known.around else {}),
    }


def _kind(model: ActionKind) -> dict[str, Any]:
    return {
        "fields": sorted(model.fields),
        "params": {name: plain(parameter) for name, parameter in model.params.items()},
        "moves": model.moves,
        "waits": model.waits,
        "records": model.records,
        "stores": model.stores,
        "transmits": model.transmits,
        "privacy": model.privacy,
        "state_writing": model.state_writing,
    }
