# SPDX-License-Identifier: Apache-2.0
"""Repeat work: one signature, fifty missions, on the symbolic robot; and the log that says so.

Source: the people's side of section "Mission Compilation and Clarification": consent is for a
mission, and whoever is asked too often stops reading.
"""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import msgspec
import pytest

import authguard_reference as oracle
import authguard_reference.templates as oracle_templates
from authguard_r.audit.prompts import Prompts, activated, count_prompts
from authguard_r.audit.record import read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import Tag, b64, digest_of, encode, unb64
from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import read_token, sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.enforcement.templates import combinations, expand
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.site.model import Site, facts_of
from authguard_r.store.sqlite import read_held, read_rows
from authguard_r.store.transactions import Transaction
from fixtures import scenarios, templates
from fixtures.decision_cases import plain_facts
from fixtures.templates import instance, template, token
from missionpair.bench import approve, make_bench, propose
from missionpair.suite import restricted

pytestmark = pytest.mark.complete


def figure(rows: Any, standing: Any) -> Prompts:
    records = [read_record(row.record, where="") for row in rows]
    return count_prompts(records, {mid: standing(mid) for mid in activated(records)})


def next_one(sim: Simulation, number: int, fill: Any, at: Path | None = None) -> str:
    """Carry one instance out, once the template's rate allows it."""
    sim.robot.state = scenarios.world()  # somebody brought the packages back
    sim.robot.pause(10 * templates.MINUTE_MS)
    now = sim.robot.wall_ms()
    window = {"not_before": to_timestamp(now), "expiry": to_timestamp(now + 1_400_000)}
    made = instance(number, fill=fill, **window)
    sim.gate.management.activate(token(made, at=at))
    templates.delivered(sim, fill)
    standing = sim.gate.management.standing(made.mid)
    assert standing is not None
    assert standing.prompts == 0
    return str(standing.status)


def test_one_signature_carries_fifty_missions() -> None:
    """The figure: a fiftieth of a prompt for each mission, where fifty missions cost fifty."""
    sim = templates.admitted()
    fills = islice(cycle(combinations(template())), 50)
    statuses = {next_one(sim, number, fill) for number, fill in enumerate(fills, 1)}
    assert statuses == {"completed"}
    found = figure(sim.gate.ledger.store.rows(), sim.gate.management.standing)  # type: ignore[attr-defined]
    assert found == Prompts(missions=50, signatures=1, requests=0, choices=0)
    assert (found.asked, found.per_mission) == (1, Fraction(1, 50))
    assert verify_rows(sim.gate.ledger.store.rows(), terminal=None).whole  # type: ignore[attr-defined]
    assert len(sim.gate.enforcer.inputs._verified) <= 16


def test_a_mission_that_is_signed_each_time_asks_each_time() -> None:
    sim = scenarios.simulation()
    fill = instance().fill
    for number in (1, 2):
        sim.robot.state = scenarios.world()
        said = instance(number)
        made = expand(
            template(),
            fill,
            mid=said.mid,
            nonce=said.nonce,
            not_before=said.not_before,
            expiry=said.expiry,
        )
        sim.gate.management.activate(scenarios.token(made))
        templates.delivered(sim, fill)
    found = figure(sim.gate.ledger.store.rows(), sim.gate.management.standing)  # type: ignore[attr-defined]
    assert found == Prompts(missions=2, signatures=2, requests=0, choices=0)
    assert found.per_mission == 1


def test_approvals_count_as_prompts(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "trust")
    scene = restricted(bench)
    propose(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    propose(scene)
    gate = scene.sim.gate
    found = figure(gate.ledger.store.rows(), gate.management.standing)  # type: ignore[attr-defined]
    assert (found.missions, found.signatures, found.requests) == (1, 1, 1)
    assert found.per_mission == 2


def test_an_empty_log_asked_nobody() -> None:
    sim = templates.simulation()
    found = figure(sim.gate.ledger.store.rows(), sim.gate.management.standing)  # type: ignore[attr-defined]
    assert (found.asked, found.per_mission) == (0, 0)
    gone = count_prompts([], {"lost": None})  # type: ignore[dict-item]
    assert gone == found


# restart and replay


def test_a_restart_in_the_middle_of_a_mission_goes_on_and_counts_on(tmp_path: Path) -> None:
    at = templates.folder()
    sim = templates.admitted(at, store=tmp_path / "robot.db")
    sim.gate.management.activate(token(at=at))
    first, *rest = templates.actions(instance().fill)
    assert scenarios.propose(sim, first).outcome == "succeeded"
    end, state = sim.robot.wall_ms(), sim.robot.state
    sim.gate.close()
    again = templates.simulation(at, store=tmp_path / "robot.db", start_ms=end, state=state)
    for action in rest:
        assert scenarios.propose(again, action).outcome == "succeeded"
    assert next_one(again, 2, instance().fill, at) == "completed"
    again.gate.close()
    rows = list(read_rows(tmp_path / "robot.db"))
    numbers = [record.open["instance"] for record in activations(rows)]
    assert numbers == [1, 2]
    held = read_held(tmp_path / "robot.db", "template", templates.digest())
    assert held is not None
    assert msgspec.json.decode(held)["used"] == 2


def activations(rows: Any) -> list[Any]:
    records = [read_record(row.record, where="") for row in rows]
    return [record for record in records if record.link.decision == "activate"]


STEPS = ("keep_token", "hold", "make_active", "put", "record")


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("step", STEPS)
def test_an_activation_that_fails_in_the_middle_counts_nothing(
    tmp_path: Path, step: str, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = templates.admitted(store=tmp_path / "robot.db")
    carried_out = getattr(Transaction, step)

    def fails(act: Transaction, *arguments: Any) -> Any:
        if when == "after":
            carried_out(act, *arguments)
        raise StoreError("the disk is gone")

    with monkeypatch.context() as patch:
        patch.setattr(Transaction, step, fails)
        with pytest.raises(StoreError):
            sim.gate.management.activate(token())
    assert sim.gate.management.standing("deliver.1") is None  # type: ignore[arg-type]
    assert sim.gate.management.activate(token()).status == "active"
    sim.gate.close()
    assert [r.open["instance"] for r in activations(read_rows(tmp_path / "robot.db"))] == [1]


def values(row: Any) -> dict[str, Any]:
    return {name: item["value"] for name, item in json.loads(row.sealed).items()}


def payload(text: str) -> Any:
    return json.loads(unb64(read_token(text.encode()).payload))


def test_the_log_alone_is_enough_to_decide_again(tmp_path: Path) -> None:
    """The oracle fills the template from both tokens in the record, and decides every step."""
    sim = templates.admitted(store=tmp_path / "robot.db")
    sim.gate.management.activate(token())
    go = scenarios.navigate
    for action in (*templates.actions(instance().fill)[:2], go("pharmacy", "station-102")):
        scenarios.propose(sim, action)
    sim.gate.close()
    rows = list(read_rows(tmp_path / "robot.db"))
    genesis = json.loads(rows[0].record)["open"]
    site = msgspec.convert(values(rows[0])["site"], Site)
    facts = plain_facts(facts_of(site, rid=genesis["robot"], profile=genesis["profile"]))
    missions: dict[str, Any] = {}
    verdicts = []
    for row in rows:
        record, sealed = json.loads(row.record), values(row)
        if record["link"]["decision"] == "activate":
            assert set(sealed) == {"template", "token"}
            made = oracle_templates.expand(payload(sealed["template"]), payload(sealed["token"]))
            digest = digest_of(Tag.MISSION, msgspec.convert(made, Mission))
            assert digest == record["open"]["mission"]
            missions[digest] = json.loads(encode(msgspec.convert(made, Mission)))
        if record["kind"] == "decision":
            again = oracle.decide(
                missions[record["open"]["mission"]],
                digest=record["open"]["mission"],
                usable_until_ms=1 << 52,
                action=sealed["action"],
                state=sealed["state"][0],
                facts=facts,
                now=sealed["now"],
                standing=sealed["standing"][0],
                approvals=[],
            )
            assert (record["open"]["reasons"], record["link"]["decision"]) == (
                again["reasons"],
                again["verdict"],
            )
            verdicts.append(again["verdict"])
    assert verdicts == ["accept", "accept", "reject"]


def test_a_scheduler_ends_no_operator_s_stop() -> None:
    """An activation leaves it standing: only a resume that a person signed after it ends it."""
    sim = templates.admitted()
    gate, deliver = sim.gate, templates.actions(instance().fill)[0]
    gate.management.activate(token())
    gate.enforcer.stop(by="hand", is_planner=False, suspends=True)
    gate.management.command(ended_by(gate.management.standing("deliver.1"), Verb.REVOKE))
    sim.robot.pause(10 * templates.MINUTE_MS)
    now = sim.robot.wall_ms()
    window = {"not_before": to_timestamp(now), "expiry": to_timestamp(now + 1_400_000)}
    made = gate.management.activate(token(instance(2, **window)))
    assert made.status == "suspended"
    refused = scenarios.propose(sim, deliver)
    assert refused.outcome is None
    assert "MISSION_SUSPENDED" in refused.judged.decision.reasons
    assert sim.robot.state.region == "dock"
    before = ended_by(made, Verb.RESUME, issued_ms=now - 10 * templates.MINUTE_MS)
    with pytest.raises(RefusedError, match="ORDER_TOO_OLD"):
        gate.management.command(before)
    sim.robot.pause(1)
    made = gate.management.command(ended_by(made, Verb.RESUME, issued_ms=now + 1))
    assert made.status == "active"
    assert scenarios.propose(sim, deliver).outcome == "succeeded"


def ended_by(standing: Any, verb: Verb, **changes: Any) -> bytes:
    """Return an operator's signed order about a mission."""
    order = Command(
        verb=verb,
        mid=standing.mid,
        version=standing.version,
        mission=standing.digest,
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=scenarios.START_MS + 20 * templates.MINUTE_MS,
    )
    signed = msgspec.structs.replace(order, **changes)
    signer = folder_signer(templates.one_folder(), "operator-1")
    return sign_object(signed, Tag.COMMAND, signer)


def test_the_record_names_the_scheduler_the_issuer_and_the_template() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    (record,) = activations(sim.gate.ledger.store.rows())  # type: ignore[attr-defined]
    assert record.link.mid == "deliver.1"
    names = ("by", "scheduler", "issuer", "template", "instance")
    assert {name: record.open[name] for name in names} == {
        "by": "scheduler-0",  # who acted now
        "issuer": "operator-1",
        "scheduler": "scheduler-0",
        "template": templates.digest(),
        "instance": 1,
    }
    assert b64(bytes(16)) != instance().nonce
