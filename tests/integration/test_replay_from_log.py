# SPDX-License-Identifier: Apache-2.0
"""A log holds every input of its decisions: the oracle decides them again from the log alone.

What differs is found though the chain holds, and what cannot be said is counted, never passed over.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from authguard_r.approvals.organization import OrganizationPolicy
from authguard_r.audit.record import (
    Entry,
    LogRow,
    Record,
    Sealed,
    append,
    commit,
    evidence,
    read_record,
    read_sealed,
)
from authguard_r.audit.verify import verify_rows
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.cli import call
from authguard_r.cli.listing import Listing
from authguard_r.cli.replay import LogReplay, replayed
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.chain import link
from authguard_r.core.encoding import Tag, b64, encode_fast
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.site.model import EmergencyPlaces, site_digest
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import approvals, scenarios, templates
from fixtures.gate_process import RunningGate, until
from missionpair.ablation import without
from missionpair.bench import Bench, approve, make_bench, propose
from missionpair.suite import ATTACKS, BENIGN, restricted
from missionpair.systems import System, run_trial

BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
PLAN = b'{"tool": "navigate_to", "arguments": {"destination": "Pharmacy", "speed": 0.5}}'
#: What changes a record: its open part, its sealed values, or what it links.
Change = Callable[[Record, dict[str, Sealed]], Record]


def again(rows: Iterable[LogRow], trust: Path | None = None, *, first: int = 0) -> LogReplay:
    """Replay rows that are whole."""
    made = LogReplay(None if trust is None else read_trust(trust), first=first)
    assert replayed(rows, made, Listing("differences", as_json=False)).whole
    return made


def asked(
    capsys: pytest.CaptureFixture[str], store: Path, *words: object
) -> tuple[int, dict[str, Any]]:
    """Return what `audit replay` says of a store."""
    capsys.readouterr()
    code = call(["audit", "replay", str(store), *map(str, words), "--json"])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return code, told


def rows_of(sim: Simulation) -> list[LogRow]:
    return list(sim.gate.ledger.store.rows())  # type: ignore[attr-defined]


def kinds(rows: list[LogRow], kind: str) -> list[int]:
    return [row.seq for row in rows if read_record(row.record, where="").kind == kind]


def verbs(rows: list[LogRow], verb: str) -> list[int]:
    return [row.seq for row in rows if read_record(row.record, where="").link.decision == verb]


def forged(rows: list[LogRow], seq: int, change: Change) -> list[LogRow]:
    """Return a log in which one record says something else and the whole chain holds."""
    sealed = read_sealed(rows[seq].sealed, where="")
    record = change(read_record(rows[seq].record, where=""), sealed)
    committed = {name: commit(name, item) for name, item in sealed.items()}
    gone = {name: told for name, told in record.committed.items() if name not in committed}
    record = msgspec.structs.replace(record, committed={**committed, **gone})
    row = LogRow(seq, encode_fast(record), encode_fast(sealed), b"")
    return chained([*rows[:seq], row, *rows[seq + 1 :]])


def chained(rows: list[LogRow]) -> list[LogRow]:
    """Return rows whose every number, digest and link was worked out anew."""
    done: list[LogRow] = []
    for seq, row in enumerate(rows):
        record = read_record(row.record, where="")
        linked = msgspec.structs.replace(
            record.link,
            prev=b64(done[-1].link if done else bytes(32)),
            seq=seq,
            evidence=evidence(record.kind, record.open, record.committed),
        )
        record = msgspec.structs.replace(record, link=linked)
        done.append(LogRow(seq, encode_fast(record), row.sealed, link(linked)))
    assert verify_rows(done, terminal=None).whole
    return done


def destroyed(rows: list[LogRow], seq: int, name: str) -> list[LogRow]:
    """Return a log in which one sealed value is gone; the chain is as it was."""
    sealed = read_sealed(rows[seq].sealed, where="")
    del sealed[name]
    rows = [*rows]
    rows[seq] = LogRow(seq, rows[seq].record, encode_fast(sealed), rows[seq].link)
    assert verify_rows(rows, terminal=None).whole
    return rows


def written(path: Path, rows: Iterable[LogRow]) -> Path:
    store = open_store(path)
    for row in rows:
        store.run(lambda turn, r=row: turn.append(r.record, r.sealed, r.link))
    store.close()
    return path


@cache
def walked() -> tuple[LogRow, ...]:
    """A log of accepts and refusals, by a gate whose mission ran out in the end."""
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    for goal in ("station-103", "pharmacy", "office-1", "station-101", "plant-room"):
        scenarios.propose(sim, scenarios.navigate(sim.robot.state.region, goal))
    sim.robot.pause(30 * 60_000)
    scenarios.propose(sim, scenarios.navigate("pharmacy", "station-101"))
    return tuple(rows_of(sim))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return make_bench(tmp_path / "trust")


def without_one(folder: Path, name: str) -> bytes:
    """Return the people's next list, with one more of them on it."""
    revoke(folder, principal=name, serial=None, now=BEGIN, days=30)
    return (folder / "revocations" / "people.json").read_bytes()


def approved(bench: Bench) -> tuple[Simulation, list[LogRow]]:
    """Return a gate whose log has a question, two answers and what they allowed."""
    scene = restricted(bench)
    propose(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    propose(scene)
    return scene.sim, rows_of(scene.sim)


# what a gate wrote is what its inputs call for


def test_every_decision_of_a_log_is_decided_alike_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = written(tmp_path / "robot.db", walked())
    code, told = asked(capsys, store, "--trust", scenarios.trust_folder())
    assert code == 0
    assert told["differences"] == told["why"] == []
    assert (told["decisions"], told["agree"], told["differ"]) == (6, 6, 0)
    assert told["not_replayable"] == told["emergencies"] == 0
    assert told["whole"] is told["verified"] is True
    assert told["size"] == len(walked())
    rows = list(walked())
    assert {
        read_record(rows[n].record, where="").link.decision for n in kinds(rows, "decision")
    } == {
        "accept",
        "reject",
    }


def test_without_a_trust_folder_tokens_are_only_read_and_the_answer_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = written(tmp_path / "robot.db", walked())
    code, told = asked(capsys, store)
    assert (code, told["agree"], told["verified"]) == (0, 6, False)
    assert call(["audit", "replay", str(store)]) == 0
    text = capsys.readouterr().out
    assert "replayed: 6 decisions, 6 agree, 0 differ, 0 not replayable\n" in text
    assert "no signature was verified: name --trust" in text


def test_what_stands_before_the_first_record_asked_for_is_read_and_not_counted() -> None:
    last = kinds(list(walked()), "decision")[-1]
    assert again(walked(), scenarios.trust_folder(), first=last).decisions == 1


def test_approvals_are_among_the_inputs(bench: Bench) -> None:
    _, rows = approved(bench)
    found = again(rows, bench.folder)
    assert (found.decisions, found.agree) == (2, 2)


def test_who_answered_only_a_trust_folder_says(bench: Bench) -> None:
    _, rows = approved(bench)
    found = again(rows)
    assert (found.agree, found.differ, found.not_replayable) == (1, 0, 1)
    assert list(found.left) == ["give --trust to name the person who answered"]


def test_an_approver_who_was_revoked_later_did_answer_then(bench: Bench, tmp_path: Path) -> None:
    shutil.copytree(bench.folder, tmp_path / "auth")
    sim, _ = approved(bench)
    for name in ("supervisor-1", "operator-1"):
        sim.gate.lists.install(without_one(tmp_path / "auth", name))
    rows = rows_of(sim)
    assert len(verbs(rows, "revocation")) == 2
    for folder in (bench.folder, tmp_path / "auth"):  # the list of before, and the newest
        found = again(rows, folder)
        assert (found.agree, found.differ, found.not_replayable) == (2, 0, 0)


def test_a_decision_after_a_new_list_is_made_under_that_list(bench: Bench, tmp_path: Path) -> None:
    shutil.copytree(bench.folder, tmp_path / "auth")
    scene = restricted(bench)
    propose(scene)
    scene.sim.gate.lists.install(without_one(tmp_path / "auth", "safety-officer-1"))
    approve(bench, scene, "supervisor-1", "supervisor-2")
    propose(scene)
    rows = rows_of(scene.sim)
    assert again(rows, bench.folder).agree == again(rows, tmp_path / "auth").agree == 2
    gone = destroyed(rows, verbs(rows, "revocation")[0], "list")
    assert again(gone, bench.folder).agree == 2  # what it revoked is not known: nobody


def denied(bench: Bench, tmp_path: Path) -> list[LogRow]:
    """Return a log in which a denial came in, its signer was revoked, and others approved."""
    shutil.copytree(bench.folder, tmp_path / "auth")
    scene = restricted(bench)
    propose(scene)
    approvals.hand_in(bench, scene, "supervisor-2", verdict=ApprovalVerdict.DENY)
    scene.sim.gate.lists.install(without_one(tmp_path / "auth", "supervisor-2"))
    approve(bench, scene, "supervisor-1", "safety-officer-1")
    right, scene.plan = scene.plan, approvals.plan("plant-room")
    assert "APPROVAL_DENIED" not in approvals.outcome(scene)
    scene.plan = right
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    propose(scene)
    return rows_of(scene.sim)


def test_a_denial_of_one_who_was_revoked_since_is_decided_alike_again(
    bench: Bench, tmp_path: Path
) -> None:
    found = again(denied(bench, tmp_path), bench.folder)
    assert (found.decisions, found.agree, found.differ) == (4, 4, 0)


@pytest.mark.parametrize("is_there", [True, False])
def test_a_denial_that_was_taken_out_or_put_in_is_found(
    bench: Bench, tmp_path: Path, is_there: bool
) -> None:
    rows = denied(bench, tmp_path)
    (answered,) = [
        seq
        for seq in verbs(rows, "answer")
        if "closes" in read_record(rows[seq].record, where="").open
    ]

    def nobody_denied(record: Record, _: dict[str, Sealed]) -> Record:
        opened = {name: told for name, told in record.open.items() if name != "closes"}
        return msgspec.structs.replace(record, open=opened)

    def still_open(record: Record, sealed: dict[str, Sealed]) -> Record:
        standing = sealed["standing"].value[0]
        requests = {
            grant: {name: told for name, told in request.items() if name != "denied"}
            for grant, request in standing["requests"].items()
        }
        told = [{**standing, "requests": requests}]
        sealed["standing"] = msgspec.structs.replace(sealed["standing"], value=told)
        return record

    change, seq = (
        (nobody_denied, answered) if is_there else (still_open, kinds(rows, "decision")[1])
    )
    found = again(forged(rows, seq, change), bench.folder)
    # what is told once goes on as it is told; one standing without the denial is told, and the next
    assert found.differ == (1 if is_there else 2)


def test_a_mission_that_a_group_issued_is_decided_with_its_people(bench: Bench) -> None:
    two = ("supervisor-1", "supervisor-2")
    scene = approvals.scene_of_group(bench, *two, threshold=2, tau_2=31, t=3)
    approvals.outcome(scene)
    for who in (*two, "safety-officer-1"):
        approvals.hand_in(bench, scene, who)
        outcome = approvals.outcome(scene)
    assert outcome == []
    found = again(rows_of(scene.sim), bench.folder)
    assert (found.decisions, found.agree) == (4, 4)


@pytest.mark.parametrize("with_trust", [True, False])
def test_a_mission_that_was_made_of_a_template_is_made_again(with_trust: bool) -> None:
    sim = templates.admitted()
    sim.gate.management.activate(templates.token())
    templates.delivered(sim, templates.instance().fill)
    scenarios.propose(sim, scenarios.navigate("station-101", "plant-room"))
    found = again(rows_of(sim), templates.one_folder() if with_trust else None)
    assert found.decisions == found.agree > 3


def test_a_story_with_a_signed_update_is_decided_alike_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(["demo", "--out", str(tmp_path / "story")]) == 0
    code, told = asked(capsys, tmp_path / "story/robot.db", "--trust", tmp_path / "story/trust")
    assert (code, told["decisions"], told["agree"]) == (0, 7, 7)


@pytest.mark.parametrize("trial", [*BENIGN, *ATTACKS], ids=lambda t: t.name)
def test_every_scene_of_the_suite_is_decided_alike_again(trial: Any, bench: Bench) -> None:
    scene = trial.prepare(bench)
    run_trial(scene, System.BOTH)
    found = again(rows_of(scene.sim), bench.folder)
    # that attack puts a mission into the registry past activation, which no record tells
    is_forced = trial.name == "another robot's mission"
    assert found.differ == (found.decisions if is_forced else 0)
    assert found.agree + found.differ == found.decisions


def test_a_store_that_was_closed_and_opened_goes_on(tmp_path: Path) -> None:
    for start in (0, 600_000):
        sim = scenarios.simulation(store=tmp_path / "robot.db", start_ms=scenarios.START_MS + start)
        if start == 0:
            sim.gate.management.activate(scenarios.token())
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        scenarios.propose(sim, scenarios.navigate("pharmacy", "plant-room"))
        sim.gate.close()
    found = again(read_rows(tmp_path / "robot.db"), scenarios.trust_folder())
    assert found.decisions == found.agree > 3


def test_the_organizations_policy_is_among_the_inputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gate with a policy of its organization: the log has what each decision was held to."""
    policy = OrganizationPolicy(
        schema="authguard-r/risk-policy/1",
        organization="hospital",
        version=1,
        issued="2026-01-01T00:00:00Z",
        policy=msgspec.structs.replace(scenarios.mission().risk_policy, tau_1=10, tau_2=11),
    )
    token = tmp_path / "policy.token"
    signer = folder_signer(scenarios.trust_folder(), "safety-officer-1")
    token.write_bytes(sign_object(policy, Tag.RISK_POLICY, signer))
    with RunningGate(simulate=True) as gate:
        gate.stop_process("gate")
        gate.start_gate("--risk-policy", str(token))
        gate.activate()
        planner = gate.client(ClientRole.PLANNER)
        until(lambda: "APPROVAL_REQUIRED" in planner.propose(PLAN)["steps"][-1]["reasons"])
        with gate.client(ClientRole.OPERATOR) as console:
            (question,) = console.approvals()
            by = folder_signer(scenarios.trust_folder(), "supervisor-1")
            console.answer(question, ApprovalVerdict.APPROVE, by)
        assert planner.propose(PLAN)["steps"][-1]["reasons"] == []
        code, told = asked(capsys, gate.store, "--trust", gate.trust)  # a gate that runs tells it
        assert (code, told["differ"], told["told_by"]) == (0, 0, gate.pid)
        gate.stop_process("gate")
        code, told = asked(capsys, gate.store, "--trust", gate.trust)
        assert (code, told["agree"], told["told_by"]) == (0, told["decisions"], None)
        rows = list(read_rows(gate.store))
    said = [read_record(row.record, where="").link.decision for row in rows]
    assert [v for v in said if v in {"request_approval", "accept"}] == [
        "request_approval",
        "accept",
    ]
    where = verbs(rows, "risk-policy")[0]
    gone = again(destroyed(rows, where, "token"), scenarios.trust_folder())
    assert (gone.agree, gone.differ, gone.not_replayable) == (0, 0, told["decisions"])
    without_it = again(chained([*rows[:where], *rows[where + 1 :]]), scenarios.trust_folder())
    assert without_it.differ >= 1
    assert again(rows).differ == 0


def test_a_shadow_run_is_decided_alike_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trust = tmp_path / "trust"
    init_folder(trust, demo_members(scenarios.site(), (scenarios.RID,)), now=datetime.now(UTC))
    reply = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
    with RunningGate(mode=Mode.SHADOW, simulate=True, trust=trust) as gate:
        gate.activate()
        with gate.client(ClientRole.PLANNER, "old-road", allow_shadow=True) as planner:
            planner.propose(reply, dialect="openai")
            planner.propose(reply, dialect="openai")
        gate.stop_process("gate")
        code, told = asked(capsys, gate.store, "--trust", trust)
    assert (code, told["differ"], told["not_replayable"]) == (0, 0, 0)
    assert told["agree"] == told["decisions"] >= 2


def test_a_log_in_which_nobody_knows_how_an_action_ended_is_decided_alike_again() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    begun = sim.robot.dispatch

    def lost(*given: Any) -> Any:
        handle = begun(*given)
        handle.outcome = lambda: Outcome.UNKNOWN
        return handle

    sim.robot.dispatch = lost  # type: ignore[method-assign]
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome == "unknown"
    refused = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert refused.judged.decision.reasons[0] == "MISSION_SUSPENDED"
    found = again(rows_of(sim), scenarios.trust_folder())
    assert (found.agree, found.differ, found.unchecked) == (2, 0, 0)


def test_an_emergency_is_no_missions_decision_and_is_counted() -> None:
    store = MemoryStore()
    for decision in ("accept", "succeeded"):
        entry = Entry(kind="emergency", time_ms=1, decision=decision, open={"reasons": []})
        store.run(lambda turn, e=entry: append(turn, e, salts=b""))
    assert (again(store.rows()).emergencies, again(store.rows()).decisions) == (1, 0)


# a gate that decided otherwise is found, whatever its chain says


@pytest.mark.parametrize(
    "trial",
    [
        t
        for t in ATTACKS
        if t.category not in {"Capability escalation", "Availability manipulation"}
    ],
    ids=lambda t: t.name,
)
def test_what_a_gate_without_one_of_its_checks_let_through_is_found(
    trial: Any, bench: Bench
) -> None:
    scene = trial.prepare(bench)
    with without(trial.check):
        assert run_trial(scene, System.BOTH).unauthorized
    assert again(rows_of(scene.sim), bench.folder).differ >= 1


def turned(record: Record, _: dict[str, Sealed]) -> Record:
    """Return a refusal as an accept that released, with no reason left."""
    linked = msgspec.structs.replace(record.link, decision="accept")
    opened = {**record.open, "reasons": [], "ticket": "t"}
    return msgspec.structs.replace(record, link=linked, open=opened)


def test_a_verdict_that_was_changed_and_chained_anew_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = list(walked())
    at = verbs(rows, "reject")[0]
    store = written(tmp_path / "forged.db", forged(rows, at, turned))
    assert call(["audit", "verify", str(store)]) == 0  # the chain holds
    code, told = asked(capsys, store, "--trust", scenarios.trust_folder())
    # the standing after it lacks what it would have released; that is told once
    assert (code, told["agree"], told["differ"]) == (1, 4, 2)
    found, later = told["differences"]
    assert "`t` was released before it" in later["why"]
    assert (found["seq"], found["kind"], found["why"]) == (at, "decision", "")
    assert found["recorded"] == {"verdict": "accept", "reasons": [], "released": True}
    assert found["recomputed"]["verdict"] == "reject"
    assert found["recomputed"]["reasons"] == read_record(rows[at].record, where="").open["reasons"]
    assert call(["audit", "replay", str(store)]) == 1
    text = capsys.readouterr().out
    assert f"DIFFERS record {at}\n  verdict: recorded accept, recomputed reject\n" in text
    assert "reasons: recorded none, recomputed " in text


def test_a_release_in_spite_of_a_refusal_is_found() -> None:
    def released(record: Record, _: dict[str, Sealed]) -> Record:
        return msgspec.structs.replace(record, open={**record.open, "ticket": "t"})

    rows = list(walked())
    log = forged(rows, verbs(rows, "reject")[0], released)
    # the standing after it lacks what it would have released; that is told once
    assert again(log, scenarios.trust_folder()).differ == 2


@pytest.mark.parametrize("name", ["action", "state", "now", "approvals", "standing"])
def test_inputs_that_are_not_those_that_the_record_links_are_found(name: str) -> None:
    def other(record: Record, sealed: dict[str, Sealed]) -> Record:
        value = sealed[name].value
        if name == "action":
            value = {**value, "destination": "dock"}
        elif name == "state":
            value = []
        elif name == "now":
            value = {**value, "utc_ms": 1}
        else:
            value = "nothing of the kind"
        sealed[name] = msgspec.structs.replace(sealed[name], value=value)
        return record

    rows = list(walked())
    log = forged(rows, verbs(rows, "accept")[0], other)
    for trust in (scenarios.trust_folder(), None):
        found = again(log, trust)
        assert found.differ + found.not_replayable == 1
        assert found.differ == 1 or (name, trust) == ("approvals", None)


def test_a_mission_that_nobody_signed_is_found_with_a_trust_folder() -> None:
    token = json.loads(scenarios.token())
    token["endorsements"][0]["signature"] = b64(bytes(64))

    def unsigned(record: Record, sealed: dict[str, Sealed]) -> Record:
        sealed["token"] = Sealed(
            salt=sealed["token"].salt,
            value=json.dumps(token, separators=(",", ":"), sort_keys=True),
        )
        return record

    rows = list(walked())
    log = forged(rows, verbs(rows, "activate")[0], unsigned)
    found = again(log, scenarios.trust_folder())
    assert (found.differ, found.agree, found.not_replayable) == (1, 0, 6)
    assert list(found.left) == ["its mission is not valid"]
    assert again(log).agree == 6


def test_another_mission_in_the_place_of_the_one_that_counted_is_found() -> None:
    wide = scenarios.token(
        scenarios.mission(regions=["dock", "pharmacy", "station-101", "station-103"])
    )

    def other(record: Record, sealed: dict[str, Sealed]) -> Record:
        value = wide.decode().strip()
        sealed["token"] = Sealed(salt=sealed["token"].salt, value=value)
        return record

    rows = list(walked())
    log = forged(rows, verbs(rows, "activate")[0], other)
    for trust in (scenarios.trust_folder(), None):
        assert again(log, trust).differ == 1


def test_a_decision_under_a_mission_that_no_record_made_active_is_found() -> None:
    rows = list(walked())
    at = verbs(rows, "activate")[0]
    found = again(chained([*rows[:at], *rows[at + 1 :]]), scenarios.trust_folder())
    assert (found.differ, found.agree) == (6 + len(kinds(rows, "outcome")), 0)


@pytest.mark.parametrize(
    "value", [None, 1, {}, "token", '{"kind":1}'], ids=["null", "number", "object", "text", "json"]
)
def test_tokens_and_sites_that_are_none_are_found_and_never_a_traceback(value: Any) -> None:
    def broken(name: str) -> Change:
        def change(record: Record, sealed: dict[str, Sealed]) -> Record:
            sealed[name] = Sealed(salt=sealed[name].salt, value=value)
            return record

        return change

    rows = list(walked())
    for trust in (scenarios.trust_folder(), None):
        log = forged(rows, verbs(rows, "activate")[0], broken("token"))
        assert again(log, trust).differ == 1
        found = again(forged(rows, 0, broken("site")), trust)
        assert (found.differ, found.not_replayable) == (1, 6)


def test_a_site_that_is_not_the_one_that_the_log_names_is_found() -> None:
    def other(record: Record, sealed: dict[str, Sealed]) -> Record:
        return msgspec.structs.replace(record, open={**record.open, "site": b64(bytes(32))})

    found = again(forged(list(walked()), 0, other))
    assert (found.differ, found.not_replayable) == (1, 6)


def test_a_list_that_no_authority_signed_is_found(bench: Bench, tmp_path: Path) -> None:
    shutil.copytree(bench.folder, tmp_path / "auth")
    sim, _ = approved(bench)
    sim.gate.lists.install(without_one(tmp_path / "auth", "safety-officer-1"))

    def other(record: Record, sealed: dict[str, Sealed]) -> Record:
        plain = json.loads(sealed["list"].value)
        plain["signature"] = b64(os.urandom(64))
        value = json.dumps(plain, separators=(",", ":"), sort_keys=True)
        sealed["list"] = Sealed(salt=sealed["list"].salt, value=value)
        return record

    rows = rows_of(sim)
    log = forged(rows, verbs(rows, "revocation")[0], other)
    assert again(log, bench.folder).differ == 1
    assert again(log).differ == 0


# what cannot be said is counted


@pytest.mark.parametrize("name", ["action", "approvals", "now", "standing", "state"])
def test_a_destroyed_value_is_not_replayable_and_counted(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = list(walked())
    first, *_, last = kinds(rows, "decision")
    log = destroyed(destroyed(rows, last, name), first, name)
    store = written(tmp_path / "shredded.db", log)
    code, told = asked(capsys, store, "--trust", scenarios.trust_folder())
    assert (code, told["agree"], told["differ"], told["not_replayable"]) == (1, 4, 0, 2)
    assert [(one["name"], one["count"], one["first"]) for one in told["missing"]] == [
        (name, 2, first)
    ]
    why = {"why": f"sealed values are gone: {name}", "count": 2, "first": first, "last": last}
    assert told["why"] == [why]
    assert call(["audit", "replay", str(store)]) == 1
    text = capsys.readouterr().out
    assert f"not replayable 2 (record {first} to {last}): sealed" in text
    assert f"MISSING: 2 x `{name}` of mission deliver-p1, first at record {first}" in text


def test_words_that_no_decision_needs_may_be_gone() -> None:
    rows = list(walked())
    at = kinds(rows, "decision")[0]
    log = destroyed(destroyed(rows, at, "findings"), at, "influences")
    assert again(log, scenarios.trust_folder()).agree == 6


def test_without_its_site_or_its_mission_nothing_of_a_log_is_replayable() -> None:
    rows = list(walked())
    for log, why in (
        (destroyed(rows, 0, "site"), "sealed values are gone: site"),
        (
            destroyed(rows, verbs(rows, "activate")[0], "token"),
            "sealed values are gone: the mission's token",
        ),
    ):
        found = again(log, scenarios.trust_folder())
        assert (found.agree, found.differ, found.left[why].count) == (0, 0, 6)


def test_a_gate_that_starts_with_another_site_says_so_in_its_log(tmp_path: Path) -> None:
    """What is decided on the other site is decided alike again, and what comes after it."""
    store, other = (
        tmp_path / "robot.db",
        replace(scenarios.site(), emergency=EmergencyPlaces(places={"dock": "charging"})),
    )
    for number, site in enumerate((scenarios.site(), other, other, scenarios.site())):
        sim = simulate(
            scenarios.trust_folder(),
            site,
            scenarios.binding(),
            rid=scenarios.RID,
            start_ms=scenarios.START_MS + number * 300_000,
            store=store,
        )
        if number == 0:
            sim.gate.management.activate(scenarios.token())
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        sim.gate.close()
    rows = list(read_rows(store))
    records = [read_record(row.record, where="") for row in rows]
    moved = [record.open["site"] for record in records if record.link.decision == "site"]
    assert moved == [site_digest(other), site_digest(scenarios.site())]
    primary = [record.open["reasons"][:1] for record in records if record.kind == "decision"]
    assert primary == [[], ["SITE_MISMATCH"], ["SITE_MISMATCH"], ["REPEAT_EXHAUSTED"]]
    found = again(rows, scenarios.trust_folder())
    assert (found.agree, found.decisions) == (4, 4)


def ended(bench: Bench) -> list[LogRow]:
    """Return the log of a gate that held its issuer's certificates to have ended."""
    scene = restricted(bench)
    kept = scene.sim.gate.enforcer.inputs._verified
    for digest, verified in list(kept.items()):
        issuer = msgspec.structs.replace(verified.issuer, usable_until_ms=1)
        kept[digest] = msgspec.structs.replace(verified, issuer=issuer)
    propose(scene)
    return rows_of(scene.sim)


def test_when_a_certificate_ended_takes_the_list_of_then(bench: Bench, tmp_path: Path) -> None:
    rows = ended(bench)
    assert again(rows, bench.folder).differ == 1  # by its own list it had not
    found = again(rows)
    assert (found.differ, found.not_replayable) == (0, 1)
    shutil.copytree(bench.folder, tmp_path / "later")
    without_one(tmp_path / "later", "supervisor-1")
    found = again(rows, tmp_path / "later")  # which has a newer list only
    assert list(found.left) == ["the revocation list of then is not in the log"]


# what is no log


def test_a_log_that_is_not_whole_says_so_and_what_came_before_is_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = list(walked())
    at = kinds(rows, "decision")[-1]
    rows[at] = LogRow(at, rows[at].record, rows[at].sealed, bytes(32))
    code, told = asked(capsys, written(tmp_path / "cut.db", rows))
    assert (code, told["whole"], told["where"]) == (1, False, f"record {at}")
    assert (told["agree"], told["differ"]) == (5, 0)
    assert call(["audit", "replay", str(tmp_path / "cut.db")]) == 1
    assert f"NOT WHOLE at record {at}: " in capsys.readouterr().out


def test_another_root_is_named_before_anything_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    init_folder(tmp_path / "trust", demo_members(scenarios.site(), (scenarios.RID,)), now=BEGIN)
    store = written(tmp_path / "robot.db", walked())
    code, told = asked(capsys, store, "--trust", tmp_path / "trust")
    assert (code, told["error"]["where"]) == (4, "--trust")


def test_what_is_no_store_is_unreadable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, data in (("junk.db", b"SQLite format 3\x00junk"), ("none.db", None)):
        if data is not None:
            (tmp_path / name).write_bytes(data)
        assert asked(capsys, tmp_path / name)[0] == 4
