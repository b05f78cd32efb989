# SPDX-License-Identifier: Apache-2.0
"""Approvals: how each answer is taken in, what it is worth, and what is decided with all of them.

What is expected is written here by hand, from docs/spec/approval.md; nothing is asked of the code.
"""

from __future__ import annotations

from typing import Any

from authguard_r.core.encoding import b64
from fixtures import decision_cases, scenarios
from making import approval_faults as faults
from making.answers import (
    DIGEST,
    MEMBERS,
    MISSION,
    NOW_MS,
    OPEN_MS,
    STATES,
    principals,
    request,
    situation,
    trusted,
)
from making.approval_cases import ACTIONS, ASK, ONE, REQUESTS, TWO, Cases

Json = dict[str, Any]

OTHER = b64(bytes([1] * 32))
POLICY = decision_cases.plain(MISSION.risk_policy)


def approval_vectors() -> Json:
    """Requests with answers under one mission, one set of people and one instant."""
    made = Cases()
    enough(made)
    too_few(made)
    denied(made)
    bound(made)
    people(made)
    groups(made)
    distinct(made)
    issued_by_a_group(made)
    faults.in_time(made)
    faults.asked(made)
    faults.policies(made)
    faults.taken_in(made)
    return {
        **trusted(),
        "facts": decision_cases.plain_facts(scenarios.facts()),
        "mission": decision_cases.plain(MISSION),
        "digest": DIGEST,
        "actions": ACTIONS,
        "requests": REQUESTS,
        "states": STATES,
        "now": decision_cases.plain(scenarios.NOW),
        "standing": decision_cases.plain(
            decision_cases.set_(scenarios.active(scenarios.verified(MISSION)), counter=7)
        ),
        "signers": principals(made.answers),
        "answers": made.answers.tokens,
        "vectors": made.vectors,
    }


def enough(made: Cases) -> None:
    """As many as are needed, the issuer included."""
    made.add("nobody has to be asked", [], [], "pharmacy", asked=None)
    made.add("one beside the issuer", [("for the isolation room", "")], [], "isolation-room")
    made.add("two supervisors beside the issuer", TWO, [])
    made.add("a supervisor and a safety officer", [ONE, ("officer-1", "")], [])
    made.add("in another order", TWO[::-1], [])
    made.add("one more than needed", [*TWO, ("supervisor-3", "")], [])
    made.add("one who is confined to robot and places", [("of-courier", ""), ONE], [])


def too_few(made: Cases) -> None:
    """Fewer than are needed, and one who is counted once."""
    made.add("nobody answered", [], ASK)
    made.add("nobody answered where one is needed", [], ASK, "isolation-room")
    made.add("one too few", [ONE], ASK)
    made.add("one answer twice", [ONE, ONE], ASK)
    made.answers.give("supervisor-1 once more", "supervisor-1", expires_ms=NOW_MS + 119_999)
    twice = [ONE, ("supervisor-1 once more", "")]
    made.add("two answers of one person", twice, ASK)
    made.add("two of one person and one of another", [*twice, TWO[1]], [])
    made.answers.give("the issuer as supervisor", "issuer-as-supervisor")
    own = [ONE, ("the issuer as supervisor", "ISSUER_MISMATCH")]
    made.add("the issuer himself, as a supervisor", own, ASK)
    made.answers.give("the issuer as operator", "operator-1")
    role = [ONE, ("the issuer as operator", "ROLE_DENIED")]
    made.add("the issuer himself, as an operator", role, ASK)


def denied(made: Cases) -> None:
    """One who may answer and denies, and some who may not."""
    no = ["APPROVAL_DENIED"]
    made.add("one denies", [*TWO, ("officer-1 denies", "")], no)
    made.add("the first one denies", [("officer-1 denies", ""), *TWO], no)
    made.add("one denies and nobody approves", [("officer-1 denies", "")], no)
    made.add("one person approves and denies", [*TWO, ("supervisor-1 denies", "")], no)
    everybody = [("supervisor-1 denies", ""), ("supervisor-2 denies", "")]
    made.add("everybody denies", everybody, no)
    made.answers.give("a group denies", "board-1", verdict="deny")
    made.add("a group denies", [*TWO, ("a group denies", "")], no)
    bad: dict[str, tuple[str, str, Json]] = {
        "the issuer denies": ("issuer-as-supervisor", "ISSUER_MISMATCH", {}),
        "an operator denies": ("operator-2", "ROLE_DENIED", {}),
        "a denial of an older request": ("supervisor-3", "APPROVAL_TIMEOUT", {"counter": 6}),
        "a denial for another room": ("supervisor-3", "ACTION_OUT_OF_SCOPE", {"scope": OTHER}),
        "a denial that ran out": ("supervisor-3", "EXPIRED", {"expires_ms": NOW_MS - 1}),
        "one denies who has no say there": ("of-no-plant", "SIGNER_OUT_OF_SCOPE", {}),
    }
    for name, (by, why, changes) in bad.items():
        made.answers.give(name, by, verdict="deny", **changes)
        made.add(name, [*TWO, (name, why)], [])
    closed = {"request": "plant-room, denied"}
    late = [(name, "APPROVAL_DENIED") for name, _ in TWO]
    made.add("approvals after a denial, whose signer is gone", late, no, **closed)
    made.add("a denied request that ran out", [], no, now_ms=OPEN_MS + 1, **closed)
    made.add("a second denial", [("officer-1 denies", "")], no, **closed)
    name = "a denial where nobody is asked"
    made.answers.give(name, "officer-1", verdict="deny")
    made.add(name, [(name, "APPROVAL_TIMEOUT")], [], "pharmacy", asked=None)


def bound(made: Cases) -> None:
    """Each field that an answer binds, changed by itself."""
    made.unfit("for another robot", "ROBOT_MISMATCH", rid="lifter-1")
    made.unfit("for another mission", "MISSION_UNKNOWN", mid="deliver-p2")
    made.unfit("for another version", "SUPERSEDED", version=2)
    made.unfit("for another mission of that name", "SUPERSEDED", mission=OTHER)
    made.unfit("for an older request", "APPROVAL_TIMEOUT", counter=6)
    made.unfit("for a request to come", "APPROVAL_TIMEOUT", counter=8)
    made.unfit("for another grant", "ACTION_OUT_OF_SCOPE", grant="to-isolation-room")
    scope = request("isolation-room", 2)["scope"]
    made.unfit("for another room", "ACTION_OUT_OF_SCOPE", scope=scope)
    made.unfit("for another room and grant", "ACTION_OUT_OF_SCOPE", goal="isolation-room")
    lower = situation("plant-room", 2)
    made.unfit("for another tier", "GUARD_FALSE", situation=lower)
    made.unfit("for another situation", "GUARD_FALSE", situation=OTHER)


def people(made: Cases) -> None:
    """Whose answer counts: by role and by what the certificate reaches."""
    made.unfit("of an operator", "ROLE_DENIED", by="operator-2")
    made.unfit("of one for another robot", "SIGNER_OUT_OF_SCOPE", by="of-lifter")
    made.unfit("of one without the destination", "SIGNER_OUT_OF_SCOPE", by="of-no-plant")
    made.unfit("of one without the source", "SIGNER_OUT_OF_SCOPE", by="of-no-dock")
    made.unfit("of one for nothing", "SIGNER_OUT_OF_SCOPE", by="of-nothing")


def groups(made: Cases) -> None:
    """A group's key: as many people as its threshold, of whom the issuer may be one."""
    boards = ("board-2", "board-1", "board-3-issuer", "board-2-issuer", "board-1-issuer")
    for by in boards:
        made.answers.give(by, by)
    made.add("two of a group", [("board-2", "")], [])
    made.add("one of a group", [("board-1", "")], ASK)
    made.add("one of a group and one person", [("board-1", ""), ONE], ASK)
    made.add("one of a group and two people", [("board-1", ""), ONE, ("officer-1", "")], [])
    made.add("two groups of one", [("board-1", ""), ("board-2-issuer", "")], ASK)
    made.add("three of a group with the issuer", [("board-3-issuer", "")], [])
    made.add("two of a group with the issuer", [("board-2-issuer", "")], ASK)
    alone = [ONE, ("board-1-issuer", "ISSUER_MISMATCH")]
    made.add("a group of which the issuer may be the one", alone, ASK)


def distinct(made: Cases) -> None:
    """Who may be behind two signatures counts once, and all others count. Four are needed."""
    made.answers.give("board-2-same", "board-2-same")
    made.answers.give("board-2-others", "board-2-others")
    four: Json = {"policies": [{**POLICY, "t": 4}], "need": (65, 4)}
    same, others = ("board-2-same", ""), ("board-2-others", "")
    made.add("two people and a group of the same two", [*TWO, same], ASK, **four)
    made.add("two groups of the same people", [same, ("board-2", "")], ASK, **four)
    made.add("a group and one person beside it", [same, ("supervisor-3", "")], [], **four)
    made.add("two groups that share nobody", [same, others], [], **four)
    made.add("two groups that may share one person", [("board-2", ""), others], [], **four)
    five: Json = {"policies": [{**POLICY, "t": 5}], "need": (65, 5)}
    made.add("the same where five are needed", [("board-2", ""), others], ASK, **five)
    three = [("board-2", ""), others, ONE]
    made.add("and a person who may be of the one", three, ASK, **five)
    made.add("two groups that share nobody, for five", [same, others], [], **five)


def issued_by_a_group(made: Cases) -> None:
    """Three are needed, and a group has signed the mission: its people are behind it already."""
    two: Json = {"issuer": {"threshold": 2, "members": [*MEMBERS[:2]]}}
    not_again = [(name, "ISSUER_MISMATCH") for name, _ in TWO]
    made.add("the mission's signature alone, of two people", [], ASK, "isolation-room", **two)
    made.add("the issuers themselves", not_again, ASK, **two)
    group = [("board-2-same", "ISSUER_MISMATCH")]
    made.add("the issuers as another group", [*not_again, *group], ASK, **two)
    made.add("one beside two issuers", [("supervisor-3", "")], [], **two)
    made.add("a group of whom one is no issuer", [("board-2-others", "")], [], **two)
    some: Json = {"issuer": {"threshold": 1, "members": [*MEMBERS[:2]]}}
    made.add("one beside one of two issuers", [("supervisor-3", "")], ASK, **some)
    made.add("a group beside one of two issuers", [("board-2-others", "")], [], **some)
    made.add("an issuer who may deny", [("supervisor-1 denies", "")], ["APPROVAL_DENIED"], **two)
    nobody: Json = {"issuer": {"threshold": 2, "members": []}}
    unknown = [("supervisor-3", "ISSUER_MISMATCH"), ("board-2", "ISSUER_MISMATCH")]
    made.add("issuers whom nobody knows", unknown, ASK, **nobody)
