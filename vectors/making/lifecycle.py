# SPDX-License-Identifier: Apache-2.0
"""The life cycle of a mission version: every event in every status, refusals, and whole lives.

What is expected is written here by hand, from docs/spec/lifecycle.md and docs/spec/standing.md.
"""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]
#: A step: what is done with which version (`name/version`), and the status after it or the reason.
Step = tuple[str, str, str]

EVENTS = (
    "activate",
    "suspend",
    "resume",
    "begin_closing",
    "complete",
    "revoke",
    "expire",
    "supersede",
)
#: The status after each of the events above, in their order; `-`: the event is refused.
TABLE = """
issued     active -         -      -       -         revoked expired superseded
active     -      suspended -      closing completed revoked expired superseded
suspended  -      -         active -       completed revoked expired superseded
closing    -      -         -      -       completed revoked expired -
completed  -      -         -      -       -         -       -       -
revoked    -      -         -      -       -         -       -       -
expired    -      -         -      -       -         -       -       -
superseded -      -         -      -       -         -       -       -
"""
#: Why an action is refused; of a closing mission, one under a grant that is no closing grant.
REFUSALS: dict[str, str | None] = {
    "issued": "MISSION_NOT_ACTIVE",
    "active": None,
    "suspended": "MISSION_SUSPENDED",
    "closing": "GRANT_CLOSED",
    "completed": "MISSION_COMPLETED",
    "revoked": "REVOKED",
    "expired": "EXPIRED",
    "superseded": "SUPERSEDED",
}


def lifecycle_vectors() -> Json:
    """Every pair of status and event, the refusal of each status, and sequences of orders."""
    rows = [line.split() for line in TABLE.strip().splitlines()]
    return {
        "transitions": [
            {"status": status, "event": event, "after": None if after == "-" else after}
            for status, *afters in rows
            for event, after in zip(EVENTS, afters, strict=True)
        ],
        "refusals": [{"status": status, "reason": why} for status, why in REFUSALS.items()],
        "sequences": [
            {"name": name, "steps": [stepped(*one) for one in steps], "registry": registry}
            for name, (steps, registry) in sequences().items()
        ],
    }


def stepped(done: str, version: str, then: str) -> Json:
    """Return a step; a status is written in small letters, a reason in capitals."""
    expect = {"reason": then} if then.isupper() else {"status": then}
    return {"do": done, "version": version, "expect": expect}


def sequences() -> dict[str, tuple[list[Step], Json]]:
    """Orders one after the other, and the registry at the end; null: it has no such version."""
    return {**first_versions(), **updates(), **pairs()}


def first_versions() -> dict[str, tuple[list[Step], Json]]:
    """The first version of one mission."""
    taken, active = ("hand_in", "one/1", "issued"), ("activate", "one/1", "active")
    again, anew = ("hand_in", "one/1", "REVOKED"), ("activate", "one/1", "REVOKED")
    return {
        "hand in, activate": (
            [
                taken,
                ("propose", "one/1", "MISSION_NOT_ACTIVE"),
                active,
                ("propose", "one/1", "active"),
            ],
            {"one/1": "active"},
        ),
        "activate without handing in": ([active], {"one/1": "active"}),
        "hand in twice": ([taken, ("hand_in", "one/1", "MISSION_NOT_ACTIVE")], {"one/1": "issued"}),
        "activate twice": (
            [active, ("activate", "one/1", "TRANSITION_REFUSED")],
            {"one/1": "active"},
        ),
        "hand in what is active": (
            [active, ("hand_in", "one/1", "TRANSITION_REFUSED")],
            {"one/1": "active"},
        ),
        "hand in, revoke, hand in again": (
            [taken, ("revoke", "one/1", "revoked"), again, anew],
            {"one/1": "revoked"},
        ),
        "an issued mission takes no other order": (
            [
                taken,
                ("suspend", "one/1", "TRANSITION_REFUSED"),
                ("resume", "one/1", "TRANSITION_REFUSED"),
                ("complete", "one/1", "TRANSITION_REFUSED"),
                active,
            ],
            {"one/1": "active"},
        ),
        "suspend, resume, complete": (
            [
                active,
                ("suspend", "one/1", "suspended"),
                ("propose", "one/1", "MISSION_SUSPENDED"),
                ("resume", "one/1", "active"),
                ("propose", "one/1", "active"),
                ("complete", "one/1", "completed"),
                ("activate", "one/1", "MISSION_COMPLETED"),
                ("hand_in", "one/1", "MISSION_COMPLETED"),
            ],
            {"one/1": "completed"},
        ),
        "what ended takes no order": (
            [
                active,
                ("revoke", "one/1", "revoked"),
                ("suspend", "one/1", "TRANSITION_REFUSED"),
                ("resume", "one/1", "TRANSITION_REFUSED"),
                ("complete", "one/1", "TRANSITION_REFUSED"),
                ("revoke", "one/1", "TRANSITION_REFUSED"),
                again,
                anew,
            ],
            {"one/1": "revoked"},
        ),
        "resume what is not suspended": (
            [active, ("resume", "one/1", "TRANSITION_REFUSED")],
            {"one/1": "active"},
        ),
        "an order about what is not here": (
            [("revoke", "one/1", "MISSION_UNKNOWN")],
            {"one/1": None},
        ),
        "an issued mission past its expiry": (
            [
                taken,
                ("pass_expiry", "one/1", "issued"),
                ("activate", "one/1", "EXPIRED"),
                ("hand_in", "one/1", "EXPIRED"),
            ],
            {"one/1": "expired"},
        ),
        "an active mission past its expiry": (
            [
                active,
                ("pass_expiry", "one/1", "active"),
                ("propose", "one/1", "EXPIRED"),
                ("activate", "one/1", "EXPIRED"),
            ],
            {"one/1": "expired"},
        ),
    }


def updates() -> dict[str, tuple[list[Step], Json]]:
    """The next version of a mission; `one/2b` is another token of version 2."""
    first, waits = ("activate", "one/1", "active"), ("hand_in", "one/2", "issued")
    second = ("activate", "one/2", "active")
    return {
        "an update is handed in while the version before is active": (
            [first, waits, ("propose", "one/1", "active")],
            {"one/1": "active", "one/2": "issued"},
        ),
        "the update is activated": (
            [
                first,
                waits,
                second,
                ("propose", "one/2", "active"),
                ("activate", "one/2", "TRANSITION_REFUSED"),
            ],
            {"one/2": "active"},
        ),
        "an update that was not handed in": ([first, second], {"one/2": "active"}),
        "an update of what is not here": (
            [("hand_in", "one/2", "MISSION_UNKNOWN"), ("activate", "one/2", "MISSION_UNKNOWN")],
            {"one/1": None, "one/2": None},
        ),
        "an update that leaves a version out": (
            [
                first,
                ("hand_in", "one/3", "SUPERSEDED"),
                ("activate", "one/3", "SUPERSEDED"),
            ],
            {"one/1": "active", "one/3": None},
        ),
        "the update is revoked, and another one is taken in": (
            [
                first,
                waits,
                ("revoke", "one/2", "revoked"),
                ("propose", "one/1", "active"),
                ("hand_in", "one/2", "REVOKED"),
                ("activate", "one/2", "REVOKED"),
                ("hand_in", "one/2b", "issued"),
                ("activate", "one/2b", "active"),
            ],
            {"one/2": "revoked", "one/2b": "active"},
        ),
        "of two updates that wait, the other is superseded": (
            [
                first,
                waits,
                ("hand_in", "one/2b", "issued"),
                ("activate", "one/2b", "active"),
                ("activate", "one/2", "SUPERSEDED"),
            ],
            {"one/2": "superseded", "one/2b": "active"},
        ),
        "the mission is revoked while its update waits": (
            [first, waits, ("revoke", "one/1", "revoked"), ("activate", "one/2", "REVOKED")],
            {"one/1": "revoked", "one/2": "revoked"},
        ),
        "the mission is completed while its update waits": (
            [first, waits, ("complete", "one/1", "completed"), ("activate", "one/2", "SUPERSEDED")],
            {"one/1": "completed", "one/2": "superseded"},
        ),
        "the mission expires while its update waits": (
            [first, waits, ("pass_expiry", "one/1", "active"), ("activate", "one/2", "EXPIRED")],
            {"one/2": "expired"},
        ),
        "a suspended mission is updated": (
            [first, ("suspend", "one/1", "suspended"), ("activate", "one/2", "suspended")],
            {"one/2": "suspended"},
        ),
    }


def pairs() -> dict[str, tuple[list[Step], Json]]:
    """Two missions of one robot: one is active."""
    first, other = ("activate", "one/1", "active"), ("activate", "two/1", "TRANSITION_REFUSED")
    taken = ("hand_in", "two/1", "issued")
    return {
        "another mission is refused while one is active": (
            [first, other],
            {"one/1": "active", "two/1": None},
        ),
        "another mission is refused while one is suspended": (
            [first, ("suspend", "one/1", "suspended"), other],
            {"one/1": "suspended", "two/1": None},
        ),
        "another mission is handed in while one is active": (
            [first, taken, other, ("propose", "one/1", "active")],
            {"one/1": "active", "two/1": "issued"},
        ),
        "the next one when the first has ended": (
            [first, taken, ("complete", "one/1", "completed"), ("activate", "two/1", "active")],
            {"one/1": "completed", "two/1": "active"},
        ),
        "an issued mission keeps no other from its activation": (
            [taken, first],
            {"one/1": "active", "two/1": "issued"},
        ),
    }
