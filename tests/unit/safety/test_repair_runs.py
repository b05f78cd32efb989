# SPDX-License-Identifier: Apache-2.0
"""A repair returns through authorization: only when the client asks, once, with its own record."""

from __future__ import annotations

import asyncio
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import Record, read_record
from authguard_r.cli import call
from authguard_r.client import AsyncGateClient
from authguard_r.core.action import Action
from authguard_r.core.encoding import b64
from authguard_r.core.mission import Grant, Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.safety import Hazard, SafetyDecision, SafetyFinding
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Step
from authguard_r.safety import default_config
from authguard_r.server.explanation import repaired_by
from authguard_r.server.process import Rendezvous
from authguard_r.store.sqlite import open_store
from authguard_r.wire.messages import ClientRole, Kind, Propose
from fixtures import estop_fixtures, scenarios
from missionpair.bench import Bench, BenchScene, approve, make_bench
from missionpair.bench import propose as begin
from missionpair.suite import restricted
from unit.server.demo_site import DemoGate, Guest
from unit.server.test_process import activate, client, parts, robot, served

THROUGH = ("public-corridor", "plant-room", "public-corridor")
AROUND = ("public-corridor", "public-corridor")
GO = scenarios.navigate("dock", "pharmacy", speed=800, route=THROUGH)
VIA = '["Public Corridor", "Plant Room", "Public Corridor"]'
FAST = b'navigate_to(destination="Pharmacy", speed=0.8)'
PLAN = f'navigate_to(destination="Pharmacy", speed=0.8, via={VIA})'.encode()


def mission(**grant: Any) -> Mission:
    """Return the shipped mission, which also lets the robot pass the plant room on its way."""
    plain = scenarios.draft()
    plain["risk_policy"]["region_tags"]["hazardous"] = 0
    go = plain["grants"][0]
    go["rows"][0]["regions"] = ["dock", "pharmacy", "plant-room", "public-corridor"]
    go |= grant
    return scenarios.compiled(plain, at=scenarios.site())


SLOWEST = {"limits": {"speed_mm_s": ["0.4 m/s", "0.8 m/s"]}}


def ready(signed: Mission | None = None, *, human_distance_mm: int = 5_000) -> Any:
    world = msgspec.structs.replace(scenarios.world(), human_distance_mm=human_distance_mm)
    sim = scenarios.simulation(start=world)
    sim.gate.management.activate(scenarios.token(signed or mission()))
    return sim


def propose(sim: Any, action: Action = GO, *, repair: bool = True) -> Report:
    context = sim.binder.context()
    context.add("camera", "go by the Plant Room to the Pharmacy")
    step = Step(action=msgspec.structs.replace(action, source=None), attested=("source",))
    report: Report = sim.gate.enforcer.propose(
        step, planner="planner", evidence=b64(bytes(32)), context=context, repair=repair
    )
    return report


def decisions(sim: Any) -> list[Record]:
    found = [read_record(row.record, where="") for row in sim.gate.ledger.store.rows()]
    return [record for record in found if record.kind == "decision"]


# the symbolic robot


def test_without_the_option_a_repair_is_only_offered() -> None:
    sim = ready()
    report = propose(sim, repair=False)
    assert report.judged is not None
    assert report.judged.safety is not None
    assert report.judged.safety.repair is not None
    assert (report.outcome, report.repairs, sim.robot.trace) == (None, None, [])
    assert [record.open["ticket"] for record in decisions(sim)] == ["-"]
    assert "repairs" not in decisions(sim)[0].open


def test_with_the_option_the_shorter_route_is_authorized_again_and_runs() -> None:
    sim = ready()
    report = propose(sim)
    assert report.outcome is Outcome.SUCCEEDED
    assert [done.action.route for done in sim.robot.trace] == [AROUND]
    assert sim.robot.state.region == "pharmacy"
    refused, released = decisions(sim)
    assert refused.link.decision == released.link.decision == "accept"
    assert (refused.open["safety"]["hazards"], refused.open["ticket"]) == (["KEEP_OUT"], "-")
    assert (released.open["safety"]["safe"], released.open["repairs"]) == (True, refused.link.seq)
    assert released.open["repairs_action"] == refused.link.action
    assert released.open["ticket"] != "-"
    assert report.repairs is not None
    assert (report.repairs.seq, report.seq) == (refused.link.seq, released.link.seq)
    standing = sim.gate.management.standing("deliver-p1")
    assert standing.uses["go-to-pharmacy"].starts == standing.actions == 1


def test_a_repair_has_the_labels_and_the_evidence_of_what_was_proposed() -> None:
    report = propose(ready())
    assert report.judged is not None
    assert report.repairs is not None
    assert report.repairs.judged is not None
    repair, asked = report.judged.action, report.repairs.judged.action
    assert repair.provenance == asked.provenance
    assert repair.provenance["route"] == "camera"
    assert repair.meta == asked.meta
    assert {item.value for item in report.influences} <= {
        item.value for item in report.repairs.influences
    }


def test_a_repair_that_the_mission_does_not_allow_runs_nothing() -> None:
    sim = ready(mission(**SLOWEST), human_distance_mm=500)
    report = propose(sim)
    assert (report.outcome, sim.robot.trace) == (None, [])
    refused, again = decisions(sim)
    assert (refused.link.decision, refused.open["safety"]["safe"]) == ("accept", False)
    assert (again.link.decision, again.open["safety"]) == ("reject", "not evaluated")
    assert again.open["reasons"] == ["PARAMETER_OUT_OF_BOUNDS"]
    assert again.open["repairs"] == refused.link.seq
    standing = sim.gate.management.standing("deliver-p1")
    assert (standing.actions, standing.uses) == (0, {})


def test_what_authorization_refuses_is_never_repaired() -> None:
    sim = ready()
    report = propose(sim, scenarios.navigate("dock", "station-103", route=THROUGH))
    assert (report.repairs, len(decisions(sim)), sim.robot.trace) == (None, 1, [])


def test_what_is_safe_runs_as_it_was_proposed() -> None:
    sim = ready()
    report = propose(sim, scenarios.navigate("dock", "pharmacy", route=AROUND))
    assert (report.outcome, report.repairs) == (Outcome.SUCCEEDED, None)
    assert len(decisions(sim)) == 1


ISOLATED = scenarios.navigate("dock", "isolation-room", speed=800)


def approved_near_a_person(bench: Bench, scene: BenchScene) -> BenchScene:
    """Return the scene with its plan approved, and a person who came near after that."""
    begin(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    place_person(scene, 500)
    return scene


def place_person(scene: BenchScene, distance_mm: int) -> None:
    robot = scene.sim.robot
    robot.state = msgspec.structs.replace(robot.state, human_distance_mm=distance_mm)
    robot.pause(100)


def test_a_repair_opens_no_request_in_place_of_the_one_that_its_step_needs(
    tmp_path: Path,
) -> None:
    bench = make_bench(tmp_path / "trust")
    scene = approved_near_a_person(bench, restricted(bench))
    before = scene.standing()
    for _ in range(2):
        report = propose(scene.sim, ISOLATED)
        assert (report.outcome, scene.sim.robot.trace) == (None, [])
        assert scene.standing() == before  # the request, its number and the prompts
    _, refused, again, *_ = decisions(scene.sim)
    assert (refused.link.decision, refused.open["safety"]["safe"]) == ("accept", False)
    assert (again.link.decision, again.open["repairs"]) == ("request_approval", refused.link.seq)
    assert again.open["reasons"] == ["APPROVAL_REQUIRED"]
    assert "asks" not in again.open
    place_person(scene, 5_000)
    report = propose(scene.sim, ISOLATED)  # with the approvals of before
    assert (report.outcome, report.repairs) == (Outcome.SUCCEEDED, None)
    (done,) = scene.sim.robot.trace
    assert done.action.params == {"speed_mm_s": 800}


def test_a_repair_that_another_grant_allows_asks_for_approvals_of_its_own(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "trust")
    scene = restricted(bench)
    replace = msgspec.structs.replace

    def limited(grant: Grant, low: int, high: int, **changes: Any) -> Grant:
        (limit,) = grant.limits
        return replace(grant, limits=(replace(limit, low=low, high=high),), **changes)

    go, *others = scene.mission.actions
    slowly = limited(go, 50, 400, id="go-slowly")
    scene.mission = replace(scene.mission, actions=(limited(go, 401, 800), *others, slowly))
    scene.sim = bench.simulation()
    scene.sim.gate.management.activate(bench.sign(scene.mission))
    approved_near_a_person(bench, scene)
    before = scene.standing()
    assert propose(scene.sim, ISOLATED).outcome is None
    again, standing = decisions(scene.sim)[-1], scene.standing()
    assert (again.open["grant"], again.open["asks"]) == ("go-slowly", 2)
    assert set(standing.requests) == {"go-to-pharmacy", "go-slowly"}
    assert standing.requests["go-to-pharmacy"] == before.requests["go-to-pharmacy"]


class Offering:
    """A safety gate that finds everything unsafe and offers the next repair of a list."""

    def __init__(self, *repairs: Action) -> None:
        self.repairs = list(repairs)

    def recall(self, memory: bytes) -> Offering:
        del memory
        return self

    def assess(self, *asked: Any) -> SafetyDecision:
        del asked
        found = (SafetyFinding(Hazard.RULE, "type", "nothing", "something"),)
        return SafetyDecision(safe=False, findings=found, repair=self.repairs.pop(0))


@pytest.mark.parametrize(
    ("changes", "decided"),
    [
        ({"route": ("public-corridor",)}, 2),  # its own repair, which is offered too, is not tried
        ({"route": ()}, 1),
        ({"destination": "public-corridor"}, 1),
        ({"params": {"speed_mm_s": 801}}, 1),
        ({"params": {"speed_mm_s": -5_000}}, 1),
    ],
)
def test_one_repair_at_most_and_only_a_narrower_one(changes: dict[str, Any], decided: int) -> None:
    sim = ready()
    offered = msgspec.structs.replace(GO, **changes)
    sim.gate.enforcer._safety = Offering(offered, msgspec.structs.replace(GO, route=AROUND))
    report = propose(sim)
    assert (report.outcome, sim.robot.trace) == (None, [])
    assert len(decisions(sim)) == decided


# `authguard run`


@pytest.fixture
def run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that runs the plan on a store of its own and returns code and answer."""
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))
    (tmp_path / "plan.txt").write_bytes(PLAN)
    (tmp_path / "m.token").write_bytes(scenarios.token(mission()))
    trust, site = scenarios.trust_folder(), scenarios.HOSPITAL / "site.yaml"

    def asked(*words: object) -> tuple[int, str]:
        code = call([*map(str, words)])
        out = capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out

    def again(*more: str) -> tuple[int, str]:
        return asked(
            *("run", "--token", tmp_path / "m.token", "--trust", trust, "--site", site),
            *("--binding", scenarios.HOSPITAL / "binding.yaml", "--plan", tmp_path / "plan.txt"),
            *("--store", tmp_path / "r.db", "--robot", scenarios.RID),
            *("--now", to_timestamp(scenarios.START_MS), *more),
        )

    again.asked, again.store, again.trust = asked, tmp_path / "r.db", trust  # type: ignore[attr-defined]
    return again


def test_a_run_repairs_only_when_it_is_told_to_and_its_log_replays(run: Any) -> None:
    code, told = run("--json")
    (step,) = json.loads(told)["steps"]
    assert (code, step["released"]) == (1, False)
    assert step["safety"]["repair"]["route"] == list(AROUND)
    assert "repairs" not in step
    code, told = run("--repair", "--json")
    (step,) = json.loads(told)["steps"]
    assert (code, step["execution"]["outcome"]) == (0, "succeeded")
    assert step["action"]["route"] == list(AROUND)
    assert step["repairs"] == step["seq"] - 1
    code, told = run.asked("audit", "replay", run.store, "--trust", run.trust, "--json")
    again = json.loads(told)
    assert (code, again["decisions"], again["agree"], again["differ"]) == (0, 3, 3, 0)


def test_a_person_reads_what_was_refused_and_what_ran_instead(run: Any) -> None:
    code, told = run("--repair")
    assert code == 0
    lines = told.splitlines()
    first = next(n for n, line in enumerate(lines) if f"by={','.join(THROUGH)}" in line)
    assert lines[first + 1].startswith("  safety gate: KEEP_OUT at route[1]")
    assert lines[first + 2] == "repaired:"
    assert f"by={','.join(AROUND)}" in lines[first + 3]
    assert lines[first + 4] == "  -> succeeded"


def test_an_auditor_reads_both_routes_and_which_record_the_repair_repairs(run: Any) -> None:
    run("--repair")
    _, told = run.asked("audit", "show", run.store, "--kind", "decision")
    first, second = told.splitlines()
    seq = int(first.split()[0])
    assert f"dock -> pharmacy by={','.join(THROUGH)} speed_mm_s=800: KEEP_OUT" in first
    assert f"by={','.join(AROUND)} speed_mm_s=800, repairs record {seq} -> succeeded" in second
    assert "repairs" not in first
    _, told = run.asked("audit", "explain", run.store, seq)
    assert f"destination pharmacy by={','.join(THROUGH)} speed_mm_s=800" in told
    assert "repairs" not in told
    _, told = run.asked("audit", "explain", run.store, seq + 1)
    assert f"destination pharmacy by={','.join(AROUND)} speed_mm_s=800" in told
    assert f"\n  repairs record {seq}\n" in told


# a gate's process and its clients


def asks(house: DemoGate, client: Guest, *, repair: bool, key: str = "walk") -> dict[str, Any]:
    asked = Propose(key=key, plan=PLAN, repair=repair)
    number = client.say(Kind.PROPOSE, asked)
    house.pump()
    return house.rest(client, number)


def test_a_client_that_does_not_ask_gets_no_repair_decided() -> None:
    assert Propose(key="walk", plan=PLAN).repair is False
    with DemoGate(mission=mission()) as house:
        client = house.enter(ClientRole.PLANNER)
        house.activate()
        (step,) = asks(house, client, repair=False)["steps"]
        assert (step["outcome"], step["executed"]) == ("accept", False)
        assert house.robot.trace == []


def test_a_repair_over_the_socket_is_told_with_the_number_of_what_it_repairs(
    tmp_path: Path,
) -> None:
    with DemoGate(mission=mission(), store=open_store(tmp_path / "robot.db")) as house:
        client = house.enter(ClientRole.PLANNER)
        house.activate()
        first = asks(house, client, repair=True)
        (step,) = first["steps"]
        refused, released = house.log("decision")
        assert released.open["repairs"] == step["repairs"] == refused.link.seq
        assert (step["seq"], step["executed"]) == (released.link.seq, True)
        clock = house.clock
    with DemoGate(
        mission=mission(), store=open_store(tmp_path / "robot.db"), clock=clock
    ) as house:  # from the log alone
        again = asks(house, house.enter(ClientRole.PLANNER), repair=True)
        assert again["repeated"] is True
        assert again["steps"][0]["repairs"] == step["repairs"]
        assert house.robot.trace == []


def test_both_clients_say_whether_they_want_a_repair() -> None:
    made = parts(estop_fixtures.files(), os.open(os.devnull, os.O_WRONLY), simulated=robot())
    slow = default_config(scenarios.site(), scenarios.RID)
    slow = msgspec.structs.replace(slow, max_speed_mm_s=700)

    async def proposed(told: Rendezvous) -> dict[str, Any]:
        role, path = ClientRole.PLANNER, Path(told.socket)
        async with await AsyncGateClient.connect(path, role=role) as planner:
            return await planner.propose(FAST, key="b", repair=True)

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.PLANNER) as planner:
            (asked,) = planner.propose(FAST, key="a")["steps"]
        assert (asked["executed"], "repairs" in asked) == (False, False)
        (step,) = asyncio.run(proposed(told))["steps"]
        assert (step["executed"], "repairs" in step) == (True, True)
        with client(told, ClientRole.PLANNER) as planner:
            again = planner.propose(FAST, key="b", repair=True)
        assert (again["repeated"], again["steps"]) == (True, [step])

    served(msgspec.structs.replace(made, safety=slow), work)
    os.close(made.journal)


def test_a_flood_of_repairs_that_are_refused_costs_no_commit_each() -> None:
    with DemoGate(mission=mission(**SLOWEST), fold_ms=60_000) as house:
        house.robot.state = msgspec.structs.replace(house.robot.state, human_distance_mm=500)
        client = house.enter(ClientRole.PLANNER)
        house.activate()
        for n in range(9):
            (step,) = asks(house, client, repair=True, key=f"k{n}")["steps"]
            assert (step["reasons"], step["repairs"]) == (["PARAMETER_OUT_OF_BOUNDS"], None)
        house.advance(1_000)
        refused, again = house.log("decision")
        assert (refused.link.decision, again.link.decision) == ("accept", "reject")
        assert again.open["repairs"] == -1  # what it repairs waited for the same commit
        assert again.open["repairs_action"] == refused.link.action
        assert repaired_by(again) == ["repairs a decision that had no record yet"]
        assert house.robot.trace == []
