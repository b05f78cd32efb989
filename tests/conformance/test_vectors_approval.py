# SPDX-License-Identifier: Apache-2.0
"""The published approvals: how answers are taken in, what they are worth, what is decided.

The oracle reads a token's payload by itself and takes its signer from the published table, so that
it leans on nothing that the gate made of them.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import msgspec

import authguard_reference as oracle
from authguard_r.approvals import open_approval
from authguard_r.approvals.requests import OpenRequest, why_not
from authguard_r.core.action import Action
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.decide import decide
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.mission import Mission
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.token import VerifiedMission, index_mission
from fixtures import scenarios
from fixtures.cases import case
from fixtures.vectors import attested, facts_from, load, named, trust_in

Json = dict[str, Any]
APPROVAL = load("approval.json")


def plain_facts(vector: Json) -> Json:
    return {**APPROVAL["facts"], "risk": vector["policies"]}


def facts_of(vector: Json) -> SiteFacts:
    return facts_from(plain_facts(vector))


def standing_of(vector: Json) -> Json:
    """Return the standing with a vector's open request and as many questions asked."""
    if vector["request"] is None:
        return {**APPROVAL["standing"], "prompts": vector["prompts"]}
    requests = {f"to-{vector['asked']}": APPROVAL["requests"][vector["request"]]}
    return {**APPROVAL["standing"], "requests": requests, "prompts": vector["prompts"]}


def now_of(vector: Json) -> Json:
    return {**APPROVAL["now"], "utc_ms": vector["now_ms"]}


def verified(vector: Json) -> VerifiedMission:
    mission, group = msgspec.convert(APPROVAL["mission"], Mission), vector.get("issuer", {})
    issuer = Principal(
        id=mission.issuer,
        role="operator",
        scope=scenarios.EVERYWHERE,
        usable_until_ms=1 << 60,
        threshold=group.get("threshold", 1),
        members=frozenset(group.get("members", ())),
    )
    return index_mission(mission, APPROVAL["digest"], issuer)


def opened(vector: Json) -> list[VerifiedApproval]:
    """Open a vector's answers, and return those that are taken in as they are published to be."""
    now, found = Now(vector["opened_ms"], 0), []
    for given in vector["answers"]:
        data = APPROVAL["answers"][given["answer"]]["token"].encode()
        try:
            found.append(open_approval(data, verifier=trust_in(APPROVAL), now=now))
            got = "ok"
        except AuthGuardError as error:
            got = str(error.reason)
        assert got == given["opened"], given["answer"]
    return found


def plain_answers(vector: Json) -> list[Json]:
    """Return what is published of the answers that are taken in, with who gave them."""
    found = []
    for given in vector["answers"]:
        answer = APPROVAL["answers"][given["answer"]]
        if given["opened"] == "ok":
            payload = json.loads(answer["token"])["payload"]
            approval = json.loads(base64.urlsafe_b64decode(payload + "=" * (-len(payload) % 4)))
            found.append({"approval": approval, "approver": APPROVAL["signers"][answer["by"]]})
    return found


def test_the_gate_takes_answers_in_and_decides_with_them_as_published() -> None:
    for vector in APPROVAL["vectors"]:
        with case(named(vector)):
            facts = facts_of(vector)
            answers = opened(vector)
            assert [msgspec.convert(p, VerifiedApproval) for p in plain_answers(vector)] == answers
            decision = decide(
                verified(vector),
                msgspec.convert(APPROVAL["actions"][vector["action"]], Action),
                state=attested(APPROVAL["states"][vector["state"]], facts),
                facts=facts,
                now=msgspec.convert(now_of(vector), Now),
                standing=msgspec.convert(standing_of(vector), Standing),
                approvals=tuple(answers),
            )
            assert decision.need is not None
            assert {
                "verdict": str(decision.verdict),
                "reasons": [str(reason) for reason in decision.reasons],
                "required": decision.need.required,
                "risk": decision.need.risk,
            } == vector["expect"]


def test_the_oracle_decides_with_the_answers_as_published() -> None:
    for vector in APPROVAL["vectors"]:
        with case(named(vector)):
            verdict = oracle.decide(
                APPROVAL["mission"],
                digest=APPROVAL["digest"],
                usable_until_ms=1 << 60,
                action=APPROVAL["actions"][vector["action"]],
                state=APPROVAL["states"][vector["state"]],
                facts=plain_facts(vector),
                now=now_of(vector),
                standing=standing_of(vector),
                approvals=plain_answers(vector),
                issuer={"id": APPROVAL["mission"]["issuer"], **vector.get("issuer", {})},
            )
            assert {name: verdict[name] for name in vector["expect"]} == vector["expect"]


def test_every_answer_is_worth_what_is_published() -> None:
    for vector in APPROVAL["vectors"]:
        with case(named(vector)):
            mission, standing = verified(vector), msgspec.convert(standing_of(vector), Standing)
            asked = None
            if vector["request"] is not None:
                ((grant, request),) = standing.requests.items()
                asked = OpenRequest(
                    verified=mission,
                    grant=next(g for g in mission.mission.actions if g.id == grant),
                    request=request,
                    action=msgspec.convert(APPROVAL["actions"][vector["asked"]], Action),
                    standing=standing,
                    facts=facts_of(vector),
                )
            now = msgspec.convert(now_of(vector), Now)
            worth = [why_not(asked, answer, now) for answer in opened(vector)]
            assert worth == [a["why_not"] for a in vector["answers"] if a["opened"] == "ok"]


def test_every_answer_and_request_is_one_that_a_vector_speaks_of() -> None:
    given = {a["answer"] for vector in APPROVAL["vectors"] for a in vector["answers"]}
    assert given == set(APPROVAL["answers"])
    assert {v["request"] for v in APPROVAL["vectors"]} == {None, *APPROVAL["requests"]}
