# SPDX-License-Identifier: Apache-2.0
"""Approvals in time, under other policies, asked anew, and tokens that are nobody's answer."""

from __future__ import annotations

import json
from typing import Any

from authguard_r.core.encoding import Tag, b64, encode, unb64
from authguard_r.core.token import sign_object
from fixtures import decision_cases
from making.answers import LISTS_MS, MISSION, NOW_MS, OPEN_MS, selection
from making.approval_cases import ASK, ONE, TWO, Cases

Json = dict[str, Any]

LATE = "APPROVAL_TIMEOUT"
FASTER = "plant-room, faster"


def in_time(made: Cases) -> None:
    """Last instants of request, answer, certificate and lists."""
    made.add("the request's last millisecond", TWO, [], now_ms=OPEN_MS)
    over = [(name, LATE) for name, _ in TWO]
    made.add("a millisecond after the request", over, [LATE], now_ms=OPEN_MS + 1)
    denial = [*over, ("officer-1 denies", LATE)]
    made.add("a denial after the request", denial, [LATE], now_ms=OPEN_MS + 1)
    made.add("the request ran out unanswered", [], [LATE], now_ms=OPEN_MS + 1)
    made.answers.give("until now", "supervisor-3", expires_ms=NOW_MS)
    made.add("an answer's last millisecond", [ONE, ("until now", "")], [])
    made.add("a millisecond after it", [ONE, ("until now", "EXPIRED")], ASK, now_ms=NOW_MS + 1)
    long = made.answers.give("beyond the request", "supervisor-3", expires_ms=OPEN_MS + 9_999)
    made.add("an answer longer than its request", [ONE, (long, "")], [])
    both = [("supervisor-1", LATE), (long, LATE)]
    made.add("a longer answer after the request", both, [LATE], now_ms=OPEN_MS + 1)
    short = made.answers.give("of a certificate that ends", "short")
    end = NOW_MS + 60_000
    made.add("the certificate's last millisecond", [ONE, (short, "")], [], now_ms=end)
    given = [ONE, (short, "EXPIRED")]
    made.add("taken in before its certificate ended", given, ASK, now_ms=end + 1, opened_ms=end)
    gone = {short: "CERTIFICATE_EXPIRED"}
    made.add("handed in after it ended", [ONE], ASK, now_ms=end + 1, refused=gone)
    stale = {name: "REVOCATION_STALE" for name, _ in TWO}
    far = LISTS_MS + 1
    made.add("handed in under stale lists", [], ASK, opened_ms=far, refused=stale)


def asked(made: Cases) -> None:
    """What is asked anew: another action, another state, no request, too many questions."""
    room, near = "isolation-room", "somebody near"
    for_none = [(name, LATE) for name, _ in TWO]
    made.add("answers without a request", for_none, ASK, asked=None)
    made.add("the mission's signature where two are needed", [], ASK, room, asked=None)
    made.add("another speed than was asked for", TWO, ASK, action=FASTER)
    yes = [("for the isolation room", "")]
    made.add("somebody came near: another tier", yes, ASK, room, near=near)
    old = [("for the isolation room", "GUARD_FALSE")]
    made.add(
        "an old answer after somebody came near", old, ASK, room, near=near, asked=f"{room}, {near}"
    )
    made.add("somebody came near: the same tier", TWO, [], near=near)
    made.add(
        "somebody near where nobody had to be asked", [], ASK, "pharmacy", near=near, asked=None
    )
    made.add("the last question", [], ASK, asked=None, prompts=4)
    spent = ["BUDGET_EXCEEDED"]
    made.add("one question too many", [], spent, asked=None, prompts=5)
    made.add("another speed after the last question", TWO, spent, action=FASTER, prompts=5)
    made.add("the answers to the last question", TWO, [], prompts=5)
    made.add("no answer to the last question", [], ASK, prompts=5)


def policies(made: Cases) -> None:
    """An organization's policy beside the mission's: the stricter counts."""
    own = decision_cases.plain(MISSION.risk_policy)
    more: Json = {"need": (65, 4), "policies": [{**own, "t": 4}]}
    made.add("an organization that wants four", TWO, ASK, **more)
    made.add("an organization that wants four and gets them", [*TWO, ("officer-1", "")], [], **more)
    loose = {**own, "tau_1": 500, "tau_2": 500, "t": 2}
    made.add("an organization that wants nothing", TWO, [], policies=[loose])
    made.add("an organization that wants nothing, and one too few", [ONE], ASK, policies=[loose])
    officers = {**own, "roles": ["safety_officer"]}
    denied = [(name, "ROLE_DENIED") for name, _ in TWO]
    made.add("an organization of safety officers", denied, ASK, policies=[officers])
    mixed = [denied[0], ("officer-1", "")]
    made.add("an organization of safety officers, and one", mixed, ASK, policies=[officers])
    wider = {**own, "roles": ["operator", "safety_officer", "supervisor"]}
    operator = [ONE, ("of an operator", "ROLE_DENIED")]
    made.add("an organization that takes operators", operator, ASK, policies=[wider])


def taken_in(made: Cases) -> None:
    """Tokens that are no answer of anybody: each is refused before it is looked at."""
    for name, (token, reason) in bad_tokens(made).items():
        made.answers.put(name, "supervisor-2", token)
        made.add(f"not taken in: {name}", [ONE], ASK, refused={name: reason})
    signed = {
        "under a foreign root": ("stranger", "CERTIFICATE_INVALID"),
        "of one who was revoked": ("gone", "CERTIFICATE_REVOKED"),
        "of a witness": ("witness", "ROLE_DENIED"),
    }
    for name, (by, reason) in signed.items():
        made.answers.give(name, by)
        made.add(f"not taken in: {name}", [ONE], ASK, refused={name: reason})
        beside = f"not taken in, beside enough others: {name}"
        made.add(beside, TWO, [], refused={name: reason})
    whole = json.loads(made.answers.tokens["supervisor-2"]["token"])
    twice = encode({**whole, "endorsements": whole["endorsements"] * 2}).decode()
    name = made.answers.put("one signature twice", "supervisor-2", twice)
    made.add("one signature twice in a token", [ONE, (name, "")], [])
    made.add("one signature twice is no second person", [TWO[1], (name, "")], ASK)


def bad_tokens(made: Cases) -> dict[str, tuple[str, str]]:
    """Return answers of `supervisor-2` that somebody altered, with the reason."""
    good = made.answers.tokens["supervisor-2"]["token"]
    whole = json.loads(good)
    said = json.loads(unb64(whole["payload"]))
    (own,) = whole["endorsements"]
    (others,) = json.loads(made.answers.tokens["supervisor-3"]["token"])["endorsements"]
    (denial,) = json.loads(made.answers.tokens["supervisor-2 denies"]["token"])["endorsements"]
    choice = sign_object(selection(), Tag.SELECTION, made.answers.signer("supervisor-2")).decode()
    leaf, issuer = own["chain"]

    def over(*endorsements: Json) -> str:
        return encode({**whole, "endorsements": [*endorsements]}).decode() + "\n"

    def saying(**changes: Any) -> str:
        payload = b64(encode({**said, **changes}))
        return encode({**whole, "payload": payload}).decode() + "\n"

    forged = "SIGNATURE_INVALID"
    return {
        "a denial turned into an approval": (over(denial), forged),
        "another counter in the payload": (saying(counter=8), forged),
        "a field more in the payload": (saying(all="yes"), forged),
        "another person's signature": (over({**own, "signature": others["signature"]}), forged),
        "another person's certificate": (over({**own, "chain": others["chain"]}), forged),
        "no signature": (over({**own, "signature": ""}), forged),
        "two signatures, the second over another answer": (over(own, denial), forged),
        "two signatures of two people": (over(own, others), "ISSUER_MISMATCH"),
        "a selection": (choice, "WRONG_KIND"),
        "a selection relabeled": (choice.replace(Tag.SELECTION, Tag.APPROVAL), forged),
        "a space": (good.replace('":', '": ', 1), "NOT_CANONICAL"),
        "a second newline": (good + "\n", "NOT_CANONICAL"),
        "cut off": (good[:-10], "MALFORMED"),
        "nothing": ("", "MALFORMED"),
        "no endorsement": (over(), "MALFORMED"),
        "five endorsements": (over(*[own] * 5), "MALFORMED"),
        "a certificate cut off": (
            over({**own, "chain": [b64(unb64(leaf)[:-1]), issuer]}),
            "CERTIFICATE_INVALID",
        ),
    }
