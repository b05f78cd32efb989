# SPDX-License-Identifier: Apache-2.0
"""The published risks: rho in its parts, tier and Req of a policy, the strictest of several."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

import authguard_reference.approval as oracle_approval
import authguard_reference.risk as oracle_risk
from authguard_r.approvals.organization import open_policy, policy_digest
from authguard_r.core.action import Action
from authguard_r.core.checks.approval import assess_need
from authguard_r.core.checks.case import Case
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import MAX_INTEGER, Digest
from authguard_r.core.mission import Mission, RiskPolicy
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import Now
from authguard_r.core.risk import Tier, required, rho, tier_of
from authguard_r.core.token import index_mission
from fixtures.cases import case
from fixtures.scenarios import EVERYWHERE
from fixtures.vectors import attested, facts_from, load, named, trust_in

Json = dict[str, Any]
RISK = load("risk.json")
DIGEST = Digest("A" * 43)
#: What works rho out: of a policy, an action and a vector's state.
Scored = Callable[[Json, Json, Json], int]


def policies_of(vector: Json) -> list[Json]:
    """Return the mission's policy, then the organization's."""
    return [RISK["policies"][name] for name in vector["policies"]]


def state_of(vector: Json) -> Json | None:
    state: Json | None = RISK["states"][vector["state"]]
    return state


def without(policy: Json, done: Json, part: str) -> tuple[Json, Json]:
    """Return policy and action without what makes up one part of rho."""
    if part in {"parameters", "states"}:
        return {**policy, part: []}, done
    if part == "privacy":
        return {**policy, part: 0}, done
    if part == "type":
        return {**policy, "types": {**policy["types"], done["type"]: 0}}, done
    gone = {"object"} if part == "object" else {"source", "destination", "route"}
    return policy, {field: value for field, value in done.items() if field not in gone}


def gate_rho(policy: Json, done: Json, vector: Json) -> int:
    facts = facts_from(RISK["facts"])
    return rho(
        msgspec.convert(done, Action),
        msgspec.convert(policy, RiskPolicy),
        state=attested(state_of(vector), facts),
        facts=facts,
        now=msgspec.convert(RISK["now"], Now),
    )


def oracle_rho(policy: Json, done: Json, vector: Json) -> int:
    return oracle_risk.rho(policy, done, state_of(vector), RISK["facts"], RISK["now"])


def taken_apart(
    scored: Callable[[Json, Json, Json], int], policy: Json, vector: Json, parts: Json
) -> Json:
    """Return each part of rho: what is missing when it is left out."""
    done = vector["action"]
    whole = scored(policy, done, vector)
    return {part: whole - scored(*without(policy, done, part), vector) for part in parts}


def test_the_gate_scores_each_policy_as_published() -> None:
    for vector in RISK["vectors"]:
        with case(named(vector)):
            for policy, expect in zip(policies_of(vector), vector["expect"]["each"], strict=True):
                own = msgspec.convert(policy, RiskPolicy)
                score = gate_rho(policy, vector["action"], vector)
                tier = tier_of(own, score)
                found = {"rho": score, "tier": int(tier), "required": required(own, tier)}
                assert {**found, "parts": expect["parts"]} == expect
                assert taken_apart(gate_rho, policy, vector, expect["parts"]) == expect["parts"]


def test_the_oracle_scores_each_policy_as_published() -> None:
    for vector in RISK["vectors"]:
        with case(named(vector)):
            done, facts = vector["action"], RISK["facts"]
            for policy, expect in zip(policies_of(vector), vector["expect"]["each"], strict=True):
                score = oracle_rho(policy, done, vector)
                tier = oracle_risk.tier_of(policy, score)
                found = {
                    "rho": score,
                    "tier": tier,
                    "required": oracle_risk.required_of(policy, tier),
                }
                assert {**found, "parts": expect["parts"]} == expect
                assert taken_apart(oracle_rho, policy, vector, expect["parts"]) == expect["parts"]
                assert oracle_risk.region_risk(policy, done, facts) == expect["parts"]["regions"]
                assert oracle_risk.object_risk(policy, done, facts) == expect["parts"]["object"]
                assert oracle_risk.privacy_risk(policy, done, facts) == expect["parts"]["privacy"]


def test_the_strictest_of_the_policies_counts_for_the_gate() -> None:
    for vector in RISK["vectors"]:
        with case(named(vector)):
            expect = vector["expect"]
            facts = facts_from({**RISK["facts"], "risk": policies_of(vector)[1:]})
            plain = {**RISK["mission"], "risk_policy": policies_of(vector)[0]}
            mission = msgspec.convert(plain, Mission)
            issuer = Principal(
                id=mission.issuer, role="operator", scope=EVERYWHERE, usable_until_ms=1 << 60
            )
            judged = Case(
                verified=index_mission(mission, DIGEST, issuer),
                action=msgspec.convert(vector["action"], Action),
                kind=None,
                state=attested(state_of(vector), facts),
                facts=facts,
                now=msgspec.convert(RISK["now"], Now),
                standing=None,
                approvals=(),
            )
            need = assess_need(judged, mission.actions[0])
            assert (need.required, need.risk) == (expect["required"], expect["rho"])
            assert (need.scope, need.situation) == (expect.get("scope"), expect.get("situation"))


def test_the_strictest_of_the_policies_counts_for_the_oracle() -> None:
    for vector in RISK["vectors"]:
        with case(named(vector)):
            expect, grant = vector["expect"], RISK["mission"]["actions"][0]
            mission = {**RISK["mission"], "risk_policy": policies_of(vector)[0]}
            facts = {**RISK["facts"], "risk": policies_of(vector)[1:]}
            found, needed, score, _ = oracle_approval.step_7(
                mission,
                DIGEST,
                grant,
                0,
                action=vector["action"],
                state=state_of(vector),
                facts=facts,
                now=RISK["now"],
                standing=None,
                approvals=[],
                preapprovals=[],
            )
            assert (needed, score) == (expect["required"], expect["rho"])
            assert bool(found) is (expect["required"] > 1)
            if found:
                seen: Json = {"state": state_of(vector), "facts": facts, "now": RISK["now"]}
                digest = oracle_approval.situation_of(mission, grant, expect["tier"], **seen)
                assert digest == expect["situation"]


def test_every_policy_of_an_organization_is_taken_or_refused_as_published() -> None:
    for vector in RISK["organization"]:
        with case(named(vector)):
            try:
                found = open_policy(
                    vector["token"].encode(), verifier=trust_in(RISK), now=Now(RISK["now_ms"], 0)
                )
                got = "ok"
                assert found.digest == policy_digest(found.policy)
            except AuthGuardError as error:
                got = str(error.reason)
            assert got == vector["expect"]


def test_rho_ends_where_the_integers_of_the_encoding_do() -> None:
    """A sum beyond them would be a number in the log that no other reader takes for itself."""
    vector = RISK["vectors"][0]
    heavy = {**policies_of(vector)[0], "types": {}, "otherwise": MAX_INTEGER, "tau_2": MAX_INTEGER}
    for weight in (MAX_INTEGER - 1, MAX_INTEGER):
        policy = {**heavy, "otherwise": weight, "region_tags": {}}
        for scored in (gate_rho, oracle_rho):
            assert scored(policy, vector["action"], vector) == MAX_INTEGER
    assert tier_of(msgspec.convert(heavy, RiskPolicy), MAX_INTEGER) is Tier.HIGH
