# SPDX-License-Identifier: Apache-2.0
"""A log holds every input of its decisions: the oracle decides them again from the log alone."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import msgspec

import authguard_reference as oracle
import worlds
from authguard_r.approvals import open_approval
from authguard_r.approvals.organization import OrganizationPolicy
from authguard_r.assembly import folder_signer
from authguard_r.core.approval import Verdict
from authguard_r.core.encoding import Tag
from authguard_r.core.quantities import Now
from authguard_r.core.token import sign_object
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import Site, facts_of
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.messages import ClientRole
from cases import plain, plain_facts
from gates import RunningGate, until
from missionpair.bench import approve, make_bench, propose
from missionpair.suite import restricted


def values(row: Any) -> dict[str, Any]:
    return {name: item["value"] for name, item in json.loads(row.sealed).items()}


def mission_of(token: str) -> dict[str, Any]:
    payload = json.loads(token)["payload"]
    mission: dict[str, Any] = json.loads(base64.urlsafe_b64decode(payload + "=="))
    return mission


def redecided(path: Path, folder: Path) -> list[tuple[list[str], list[str], str]]:
    """Return, for each decision, its recorded reasons, the oracle's, and its verdict."""
    rows = list(read_rows(path))
    genesis = json.loads(rows[0].record)["open"]
    site = msgspec.convert(values(rows[0])["site"], Site)
    facts = plain_facts(facts_of(site, rid=genesis["robot"], profile=genesis["profile"]))
    missions: dict[str, dict[str, Any]] = {}
    found = []
    for row in rows:
        record, sealed = json.loads(row.record), values(row)
        if record["link"]["decision"] == "activate":
            missions[record["open"]["mission"]] = mission_of(sealed["token"])
        if record["link"]["decision"] == "risk-policy":  # in force from here on
            facts = {**facts, "risk": [mission_of(sealed["token"])["policy"]]}
        if record["kind"] != "decision":
            continue
        now = Now(**sealed["now"])
        trust = read_trust(folder)
        approvals = [
            plain(open_approval(token.encode(), verifier=trust, now=now))
            for token in sealed["approvals"]
        ]
        again = oracle.decide(
            missions[record["open"]["mission"]],
            digest=record["open"]["mission"],
            usable_until_ms=1 << 52,
            action=sealed["action"],
            state=sealed["state"][0] if sealed["state"] else None,
            facts=facts,
            now=sealed["now"],
            standing=sealed["standing"][0] if sealed["standing"] else None,
            approvals=approvals,
        )
        found.append((record["open"]["reasons"], again["reasons"], record["link"]["decision"]))
        assert record["link"]["decision"] == again["verdict"]
    return found


def test_every_decision_of_a_log_is_decided_alike_again(tmp_path: Path) -> None:
    sim = worlds.simulation(store=tmp_path / "robot.db")
    sim.gate.management.activate(worlds.token())
    for goal in ("station-103", "pharmacy", "office-1", "station-101", "plant-room"):
        worlds.propose(sim, worlds.navigate(sim.robot.state.region, goal))
    sim.robot.pause(30 * 60_000)
    worlds.propose(sim, worlds.navigate("pharmacy", "station-101"))
    sim.gate.close()
    found = redecided(tmp_path / "robot.db", worlds.trust_folder())
    assert all(recorded == again for recorded, again, _ in found)
    assert {verdict for *_, verdict in found} == {"accept", "reject"}
    assert len(found) == 6


def test_approvals_are_among_the_inputs(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "trust")
    scene = restricted(bench)
    scene.sim = bench.simulation(store=tmp_path / "robot.db")
    scene.sim.gate.management.activate(bench.sign(scene.mission))
    propose(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    propose(scene)
    scene.sim.gate.close()
    found = redecided(tmp_path / "robot.db", tmp_path / "trust")
    assert [verdict for *_, verdict in found] == ["request_approval", "accept"]
    assert all(recorded == again for recorded, again, _ in found)


def test_the_organizations_policy_is_among_the_inputs(tmp_path: Path) -> None:
    """A gate with a policy of its organization: the log has what each decision was held to."""
    policy = OrganizationPolicy(
        schema="authguard-r/risk-policy/1",
        organization="hospital",
        version=1,
        issued="2026-01-01T00:00:00Z",
        policy=msgspec.structs.replace(worlds.mission().risk_policy, tau_1=10, tau_2=11),
    )
    token = tmp_path / "policy.token"
    signer = folder_signer(worlds.trust_folder(), "safety-officer-1")
    token.write_bytes(sign_object(policy, Tag.RISK_POLICY, signer))
    plan = b'{"tool": "navigate_to", "arguments": {"destination": "Pharmacy", "speed": 0.5}}'
    with RunningGate(simulate=True) as gate:
        gate.stop_process("gate")
        gate.start_gate("--risk-policy", str(token))
        gate.activate()
        planner = gate.client(ClientRole.PLANNER)
        until(lambda: "APPROVAL_REQUIRED" in planner.propose(plan)["steps"][-1]["reasons"])
        with gate.client(ClientRole.OPERATOR) as console:
            (question,) = console.approvals()
            by = folder_signer(worlds.trust_folder(), "supervisor-1")
            console.answer(question, Verdict.APPROVE, by)
        assert planner.propose(plan)["steps"][-1]["reasons"] == []
        gate.stop_process("gate")
        found = redecided(gate.store, worlds.trust_folder())
    assert [verdict for *_, verdict in found][-2:] == ["request_approval", "accept"]
    assert all(recorded == again for recorded, again, _ in found)
