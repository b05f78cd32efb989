# SPDX-License-Identifier: Apache-2.0
"""The published life cycle holds for the gate and for the oracle, and whole lives for a real gate.

Source: docs/spec/lifecycle.md, docs/spec/standing.md#handing-in
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from msgspec.structs import replace

import authguard_reference as oracle
import authguard_reference.standing as oracle_standing
from authguard_r.core.action import Action
from authguard_r.core.decide import decide
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.lifecycle import Event, Status
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_ms
from authguard_r.core.standing import Standing, advance
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.issued_missions import registered
from fixtures import decision_cases, scenarios
from fixtures.cases import case
from fixtures.restarting_gate import Station, go
from fixtures.vectors import load, named

Json = dict[str, Any]
LIFECYCLE = load("lifecycle.json")


def test_every_status_and_every_event_is_published_once() -> None:
    pairs = [(row["status"], row["event"]) for row in LIFECYCLE["transitions"]]
    assert sorted(pairs) == sorted((str(s), str(e)) for s in Status for e in Event)
    assert {row["status"] for row in LIFECYCLE["refusals"]} == set(map(str, Status))


def test_every_event_leads_to_the_published_status_or_nowhere() -> None:
    verified = scenarios.verified()
    for row in LIFECYCLE["transitions"]:
        with case(row["status"], row["event"]):
            before = replace(scenarios.active(verified), status=Status(row["status"]))
            after = advance(before, Event(row["event"]))
            assert row["after"] == (None if after is None else str(after.status))
            assert after is None or after == replace(before, status=after.status)
            known = oracle_standing.TRANSITIONS[row["status"]]
            assert known.get(row["event"]) == row["after"]


def test_an_action_is_refused_with_the_published_reason_of_each_status() -> None:
    verified, action = scenarios.verified(), scenarios.navigate("dock", "pharmacy")
    started = scenarios.active(verified)
    for row in LIFECYCLE["refusals"]:
        with case(row["status"]):
            standing = replace(started, status=Status(row["status"]))
            if standing.status is Status.CLOSING:
                standing = replace(standing, closes_ms=scenarios.NOW.utc_ms + 1)
            expect = [] if row["reason"] is None else [row["reason"]]
            assert gate_reasons(action, standing) == expect
            assert oracle_reasons(action, standing) == expect


def gate_reasons(action: Action, standing: Standing) -> list[str]:
    decision = decide(
        scenarios.verified(),
        action,
        state=scenarios.state(),
        facts=scenarios.facts(),
        now=scenarios.NOW,
        standing=standing,
        approvals=(),
    )
    return [str(reason) for reason in decision.reasons]


def oracle_reasons(action: Action, standing: Standing) -> list[str]:
    verified = scenarios.verified()
    decision = oracle.decide(
        decision_cases.plain(verified.mission),
        digest=verified.digest,
        usable_until_ms=verified.issuer.usable_until_ms,
        action=decision_cases.plain(action),
        state=decision_cases.plain_state(scenarios.state()),
        facts=decision_cases.plain_facts(scenarios.facts()),
        now=decision_cases.plain(scenarios.NOW),
        standing=decision_cases.plain(standing),
        approvals=[],
    )
    reasons: list[str] = decision["reasons"]
    return reasons


class Lived:
    """A gate on its robot, with the tokens of the published sequences."""

    def __init__(self) -> None:
        self.here = Station()

    def mission(self, version: str) -> Mission:
        """Return the mission that a name means; each version supersedes the one before it."""
        name, number = version.split("/")
        changes: Json = {"task": "Something else."} if number.endswith("b") else {}
        count = int(number.rstrip("b"))
        if count > 1:
            before = self.mission(f"{name}/{count - 1}")
            changes["supersedes"] = digest_of(Tag.MISSION, before)
        return scenarios.mission(mission=name, version=count, **changes)

    def status(self, version: str) -> str | None:
        """Return the registry's status of exactly this version."""
        mission = self.mission(version)
        key = mission.mid, digest_of(Tag.MISSION, mission)
        found = self.here.gate.ledger.run(lambda act: registered(act, *key))
        return None if found is None else str(found.status)

    def do(self, verb: str, version: str) -> Json:
        """Return the version's status after a step, or the reason of the refusal."""
        mission, management = self.mission(version), self.here.gate.management
        try:
            if verb == "hand_in":
                management.issue(self.here.token(mission))
            elif verb == "activate":
                management.activate(self.here.token(mission))
            elif verb == "pass_expiry":
                self.here.jump(
                    to_ms(mission.expiry, where="expiry") - self.here.robot.wall_ms() + 1
                )
            elif verb == "propose":
                running = self.here.submit(go("pharmacy"))
                if isinstance(running, Report):
                    return {"reason": refused_with(running)}
                self.here.abort(running)
            else:
                management.command(self.here.order(mission, Verb(verb)))
        except AuthGuardError as error:
            return {"reason": str(error.reason)}
        return {"status": self.status(version)}


def refused_with(report: Report) -> str:
    """Return the one reason of a proposal that was refused."""
    if report.refusal is not None:
        return str(report.refusal.reason)
    assert report.judged is not None
    (reason,) = report.judged.decision.reasons
    return str(reason)


@pytest.mark.parametrize("vector", LIFECYCLE["sequences"], ids=named)
def test_every_sequence_of_orders_leads_to_the_published_registry(vector: Json) -> None:
    lived = Lived()
    for number, step in enumerate(vector["steps"]):
        with case(number, json.dumps(step)):
            assert lived.do(step["do"], step["version"]) == step["expect"]
    assert {name: lived.status(name) for name in vector["registry"]} == vector["registry"]
    lived.here.restart()
    assert {name: lived.status(name) for name in vector["registry"]} == vector["registry"]
