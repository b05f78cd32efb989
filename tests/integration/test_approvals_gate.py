# SPDX-License-Identifier: Apache-2.0
"""Asking and answering at a running gate: lists, cards, events, both clients, the command line."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals.organization import OrganizationPolicy
from authguard_r.cli import call
from authguard_r.client import AsyncGateClient, GateClient
from authguard_r.client.approvals import shown
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError, RefusedError
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.wire.approval_request import Question
from authguard_r.wire.messages import ClientRole
from fixtures import approvals, scenarios
from fixtures.gate_process import RunningGate, until
from fixtures.guarded_tools import shared_courier
from fixtures.shared_gate import SharedGate

PLAN = b'{"tool": "navigate_to", "arguments": {"destination": "Isolation Room", "speed": 0.8}}'
#: Words that stand nowhere else: what a planner must never read.
WORDS = "zebra-quarantine-told-by-nurse"


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def gate(shared: SharedGate, tmp_path: Path) -> Iterator[RunningGate]:
    """Yield a gate whose robot goes where it is sent and is always said to stand at the dock."""
    with shared_courier(shared, tmp_path, activate=False) as robot, robot.guard(client="drives"):
        yield robot.gate


@pytest.fixture
def own() -> Iterator[RunningGate]:
    """Yield a gate of the test's own, which it starts; it may run beside the shared one."""
    made = RunningGate(simulate=True, refusals=0, trust=scenarios.second_trust_folder())
    try:
        yield made
    finally:
        made.end()


def asking(gate: RunningGate, **risk: Any) -> GateClient:
    """Activate a mission that asks people; return a planner."""
    gate.activate(gate.token(approvals.at_gate(gate, **risk)))
    with gate.client(ClientRole.OPERATOR, "waits") as operator:
        # simulated time may be behind the wall's, in which the mission was compiled
        until(lambda: foreseen(operator) == ["APPROVAL_REQUIRED"], "the mission's first second")
    return gate.client(ClientRole.PLANNER, gate.mid)


def foreseen(operator: GateClient) -> list[str]:
    """Return what a proposal would be refused for; nobody is asked."""
    found: list[str] = operator.evaluate(PLAN)["steps"][0]["reasons"]
    return found


def key(name: str, trust: Path | None = None) -> Any:
    return folder_signer(trust or scenarios.trust_folder(), name)


def reasons(planner: GateClient) -> list[str]:
    found: list[str] = planner.propose(PLAN)["steps"][-1]["reasons"]
    return found


@pytest.mark.smoke
def test_people_are_shown_what_is_asked_answer_it_and_the_robot_moves(gate: RunningGate) -> None:
    planner = asking(gate)
    with gate.client(ClientRole.OPERATOR, "console") as console:
        assert console.approvals() == ()
        events = console.watch()
        assert reasons(planner) == ["APPROVAL_REQUIRED"]
        assert reasons(planner) == ["APPROVAL_REQUIRED"]
        (question,) = console.approvals()
        opened = shown(question)
        assert (opened.scope.type, opened.scope.destination) == ("navigate", "isolation-room")
        assert opened.scope.params == {"speed_mm_s": 800}
        assert opened.situation.tier == 2
        assert (question.risk, question.required, question.behind) == (35, 2, 1)
        assert question.roles == ("safety_officer", "supervisor")
        assert question.places == ("dock", "isolation-room")
        assert question.is_current
        assert 0 < question.left_ms <= 120_000
        assert all(truth.held for truth in question.guards)
        told = console.answer(question, ApprovalVerdict.APPROVE, key("supervisor-1"))
        assert told["why_not"] == ""
        after = console.approval(question.counter)
        assert (after.behind, [a.approver for a in after.answers]) == (2, ["supervisor-1"])
        assert reasons(planner) == []
        with pytest.raises(RefusedError, match="no open request"):
            console.approval(question.counter)
        seen: list[dict[str, Any]] = []
        while not seen or seen[-1].get("what") != "used":
            event = next(events)
            seen += [event] if event["event"] == "approval" else []
    assert [event["what"] for event in seen] == ["asked", "answered", "used"]
    assert seen[0]["required"] == 2
    assert seen[1]["by"] == "supervisor-1"
    assert {event["counter"] for event in seen} == {1}
    decided = [r for r in gate.news() if r.kind == "decision"][-1]
    assert decided.open["approvers"] == [
        {"by": "supervisor-1", "role": "supervisor", "kind": "individual", "verdict": "approve"}
    ]


@pytest.mark.smoke
def test_what_an_approver_says_reaches_the_log_and_no_planner(gate: RunningGate) -> None:
    planner = asking(gate)
    with gate.client(ClientRole.OPERATOR, "console") as console:
        assert reasons(planner) == ["APPROVAL_REQUIRED"]
        (question,) = console.approvals()
        with pytest.raises(RefusedError, match="needs a reason"):
            console.answer(question, ApprovalVerdict.DENY, key("supervisor-1"))
        console.answer(question, ApprovalVerdict.DENY, key("supervisor-1"), why=WORDS)
        assert console.approval(question.counter).denied
    told = planner.propose(PLAN)
    assert told["steps"][-1]["reasons"] == ["APPROVAL_DENIED"]
    assert WORDS not in json.dumps(told)
    assert "supervisor-1" not in json.dumps(told)
    answered = [r for r in gate.news() if r.open.get("verb") == "answer"]
    assert [r.sealed["why"] for r in answered] == [WORDS]
    assert not [r for r in gate.news() if r.kind != "management" and WORDS in str(r)]
    assert WORDS not in gate.said()


def test_an_answer_that_does_not_count_is_told_so(gate: RunningGate) -> None:
    planner = asking(gate)
    with gate.client(ClientRole.OPERATOR, "console") as console:
        reasons(planner)
        (question,) = console.approvals()
        told = console.answer(question, ApprovalVerdict.APPROVE, key("operator-1"))
        assert told["why_not"] == "ROLE_DENIED"
        assert console.approval(1).behind == 1
    assert reasons(planner) == ["APPROVAL_REQUIRED"]


def test_bytes_that_are_not_those_of_the_digests_are_shown_to_nobody(gate: RunningGate) -> None:
    planner = asking(gate)
    with gate.client(ClientRole.OPERATOR, "console") as console:
        reasons(planner)
        (question,) = console.approvals()
    for changes in (
        {"scope_bytes": (question.scope_bytes or b"").replace(b"isolation-room", b"public-corrid")},
        {"situation_bytes": b'{"guards":[],"tier":1}'},
        {"guards": question.guards[:-1]},
        {"scope_bytes": None},
        {"situation_bytes": None},
    ):
        lied = Question(**{f: getattr(question, f) for f in question.__struct_fields__} | changes)
        with pytest.raises(AuthGuardError):
            shown(lied)
        with (
            gate.client(ClientRole.OPERATOR, "console") as console,
            pytest.raises(AuthGuardError),
        ):
            console.answer(lied, ApprovalVerdict.APPROVE, key("supervisor-1"))
    assert [r for r in gate.news() if r.open.get("verb") == "answer"] == []


def test_two_people_answer_at_once_over_the_event_loop(gate: RunningGate) -> None:
    planner = asking(gate, tau_2=31)
    assert reasons(planner) == ["APPROVAL_REQUIRED"]

    async def both() -> list[dict[str, Any]]:
        clients = [
            await AsyncGateClient.connect(gate.socket, role=ClientRole.OPERATOR, client=f"c{n}")
            for n in (1, 2)
        ]
        (question,) = await clients[0].approvals()
        one, (listed,) = await clients[1].approval(question.counter), await clients[1].approvals()
        assert listed.left_ms <= one.left_ms  # simulated time goes on between the two
        assert msgspec.structs.replace(one, left_ms=listed.left_ms) == listed
        told = await asyncio.gather(
            *(
                client.answer(question, ApprovalVerdict.APPROVE, key(f"supervisor-{n}"))
                for n, client in enumerate(clients, 1)
            )
        )
        for client in clients:
            await client.close()
        return list(told)

    assert [told["why_not"] for told in asyncio.run(both())] == ["", ""]
    assert reasons(planner) == []


def test_a_request_that_runs_out_is_told_once(gate: RunningGate) -> None:
    planner = asking(gate, valid="1 s")
    with gate.client(ClientRole.AUDITOR, "watches") as auditor:
        events = auditor.watch()
        assert reasons(planner) == ["APPROVAL_REQUIRED"]
        seen = []
        while not seen or seen[-1] != "expired":
            event = next(events)
            seen += [event["what"]] if event["event"] == "approval" else []
        (question,) = auditor.approvals()
        assert question.left_ms < 0
        assert seen == ["asked", "expired"]
    assert reasons(planner) == ["APPROVAL_TIMEOUT"]


def test_requests_are_there_after_a_restart(own: RunningGate) -> None:
    own.start_gate()
    reasons(asking(own))
    own.restart()
    with own.client(ClientRole.OPERATOR, "console") as console:
        (question,) = console.approvals()
        assert shown(question).scope.destination == "isolation-room"
        console.answer(question, ApprovalVerdict.APPROVE, key("supervisor-2", own.trust))
    assert reasons(own.client(ClientRole.PLANNER)) == []


# the command line


def authguard(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, Any]:
    code = call([*(str(word) for word in words), "--json"])
    return code, json.loads(capsys.readouterr().out)


def keys(name: str) -> tuple[str, ...]:
    stem = scenarios.trust_folder() / "keys" / name
    return ("--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem")


def test_approvals_from_the_command_line(
    gate: RunningGate, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = asking(gate)
    at = ("--gate", gate.socket)
    assert authguard(capsys, "approvals", "list", *at) == (0, {"requests": []})
    reasons(planner)
    code, told = authguard(capsys, "approvals", "list", *at)
    assert (code, [r["tier"] for r in told["requests"]]) == (3, [2])
    assert told["requests"][0]["action"]["destination"] == "isolation-room"
    site = ("--site", scenarios.HOSPITAL / "site.yaml")
    code, told = authguard(capsys, "approvals", "show", 1, *at, *site)
    card = "\n".join(told["card"])
    assert code == 0
    assert "to isolation-room" in card
    assert "speed_mm_s 0.8 m/s" in card
    assert "RESTRICTED: isolation-room" in card
    assert "may answer: safety_officer, supervisor; not operator-1" in card
    trust = ("--trust", scenarios.trust_folder())
    words = ("approvals", "approve", 1, *at, *trust, "--yes")
    code, told = authguard(capsys, *words, *keys("operator-1"))
    assert (code, told["counts"], told["why_not"]) == (1, False, "ROLE_DENIED")
    code, told = authguard(capsys, *words, *keys("supervisor-1"))
    assert (code, told["counts"], told["behind"]) == (0, True, 2)
    assert reasons(planner) == []
    code, told = authguard(capsys, *words, *keys("supervisor-1"))
    assert (code, told["error"]["code"]) == (1, "VALUE_OUT_OF_RANGE")


def test_a_denial_from_the_command_line_needs_a_reason(
    gate: RunningGate, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = asking(gate)
    reasons(planner)
    words = ("approvals", "deny", 1, "--gate", gate.socket, *keys("supervisor-2"), "--yes")
    assert authguard(capsys, *words)[0] == 2
    assert authguard(capsys, *words, "--reason", "  ")[0] == 2
    code, told = authguard(capsys, *words, "--reason", WORDS)
    assert (code, told["verdict"]) == (0, "deny")
    assert reasons(planner) == ["APPROVAL_DENIED"]


def test_an_approval_behind_a_denial_is_told_that_it_moves_nothing(
    gate: RunningGate, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = asking(gate)
    reasons(planner)
    at = ("--gate", str(gate.socket))
    no = ("approvals", "deny", 1, *at, *keys("supervisor-2"), "--yes", "--reason", WORDS)
    code, told = authguard(capsys, *no)
    assert (code, told.get("verdict")) == (0, "deny"), told
    yes = ("approvals", "approve", "1", *at, *keys("supervisor-1"), "--yes")
    code, told = authguard(capsys, *yes)
    assert (code, told["counts"], told["denied"]) == (1, False, True)
    assert told["why_not"] == "APPROVAL_DENIED"
    assert call(list(yes)) == 1
    said = capsys.readouterr().out
    assert "another approver denied: the request is closed" in said
    assert "people are behind it" not in said
    assert call(["approvals", "list", *at]) == 3
    listed = capsys.readouterr().out
    assert ("DENIED" in listed, "2 of 2 people" in listed) == (True, False)
    assert reasons(planner) == ["APPROVAL_DENIED"]


def test_approvals_in_words(gate: RunningGate, capsys: pytest.CaptureFixture[str]) -> None:
    planner = asking(gate)
    reasons(planner)
    at = ("--gate", str(gate.socket))
    assert call(["approvals", "list", *at]) == 3
    assert "navigate with base, from dock, to isolation-room" in capsys.readouterr().out
    words = ["approvals", "approve", "1", *at, *keys("supervisor-1"), "--yes"]
    assert call(words) == 0
    assert "2 of 2 people are behind it" in capsys.readouterr().out


def test_approvals_watch_says_what_becomes_of_a_request(gate: RunningGate) -> None:
    planner = asking(gate)
    words = ["approvals", "watch", "--gate", str(gate.socket), "--jsonl", "--count", "2"]
    watching = subprocess.Popen(
        [Path(sys.executable).parent / "authguard", *words], stdout=subprocess.PIPE
    )
    try:
        with gate.client(ClientRole.OPERATOR, "console") as console:
            until(
                lambda: [c for c in console.status()["clients"] if c["client"].endswith(".cli")],
                "the watcher's connection",
            )
            reasons(planner)
            (question,) = console.approvals()

            def answered() -> bool:
                """Answer until two events were seen: it may begin to watch late."""
                console.answer(question, ApprovalVerdict.APPROVE, key("supervisor-1"))
                return watching.poll() is not None

            until(answered, "the watcher's end")
        out, _ = watching.communicate(timeout=60)
    finally:
        watching.kill()
    said = [json.loads(line) for line in out.splitlines()]
    assert [event["what"] for event in said][-1:] == ["answered"]
    assert watching.returncode == 0


def test_scripted_people_wait_apart_from_the_machine(gate: RunningGate) -> None:
    planner = asking(gate, tau_2=31)
    reasons(planner)
    words = ["approvers", "--gate", str(gate.socket), "--trust", str(scenarios.trust_folder())]
    words += ["--as", "supervisor-1", "--as", "supervisor-2", "--count", "2"]
    words += ["--delay", "lognormal:0.2s,0.3", "--seed", "7"]
    done = subprocess.run(
        [Path(sys.executable).parent / "missionpair", *words],
        capture_output=True,
        timeout=120,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert sorted(a["approver"] for a in answers) == ["supervisor-1", "supervisor-2"]
    assert all(a["why_not"] == "" and a["waited_ms"] > 50 for a in answers)
    assert all(a["machine_us"] > 0 for a in answers)
    assert reasons(planner) == []


# the organization's policy


def policy(version: int, *, organization: str = "hospital", **changes: Any) -> OrganizationPolicy:
    """Return an organization that wants three people for what is restricted."""
    plain: dict[str, Any] = {
        "types": {"navigate": 5, "scan_obstacles": 0},
        "region_tags": {"restricted": 60, "public": 0, "staff": 0},
        "otherwise": 60,
        "privacy": 0,
        "tau_1": 30,
        "tau_2": 60,
        "t": 3,
        "roles": ("safety_officer", "supervisor"),
        "valid_ms": 60_000,
    }
    return OrganizationPolicy(
        schema="authguard-r/risk-policy/1",
        organization=organization,
        version=version,
        issued="2026-01-01T00:00:00Z",
        policy=RiskPolicy(**{**plain, **changes}),
    )


def write(gate: RunningGate, made: OrganizationPolicy, by: str = "safety-officer-1") -> str:
    path = gate.folder / f"{made.organization}-{made.version}-{by}.token"
    path.write_bytes(sign_object(made, Tag.RISK_POLICY, key(by, gate.trust)))
    return str(path)


def refuses(gate: RunningGate, *words: str) -> dict[str, Any]:
    """Start the gate, which refuses; return the error that it says."""
    if gate.alive:
        gate.stop_process("gate")
    with pytest.raises(AssertionError):
        gate.start_gate(*words)
    gate._started["gate"].wait(60)
    out = max(gate.folder.glob("*-gate.out"), key=lambda p: int(p.name.split("-")[0]))
    error: dict[str, Any] = json.loads(out.read_bytes())["error"]
    return error


def test_the_organizations_policy_over_time(own: RunningGate) -> None:
    own.start_gate("--risk-policy", write(own, policy(2)))
    assert reasons(asking(own)) == ["APPROVAL_REQUIRED"]
    with own.client(ClientRole.OPERATOR, "console") as console:
        (question,) = console.approvals()
        assert (question.required, question.risk) == (3, 65)
        assert shown(question).situation.tier == 3
        assert question.left_ms <= 60_000  # the shorter of the two
    # rollback: an older one, another of this version, another organization's, none at all
    for made, code in (
        (policy(1), "SUPERSEDED"),
        (policy(2, t=2), "SUPERSEDED"),
        (policy(3, organization="clinic"), "ISSUER_MISMATCH"),
    ):
        assert refuses(own, "--risk-policy", write(own, made))["code"] == code
    assert refuses(own)["code"] == "SUPERSEDED"
    told = [r for r in own.records() if r.kind == "refusal" and "SUPERSEDED" in r.reasons]
    assert len(told) >= 2
    held = [r.open for r in own.records() if r.open.get("verb") == "risk-policy"]
    assert [(item["version"], item["organization"]) for item in held] == [(2, "hospital")]
    # whoever may not say so says nothing
    foreign = refuses(own, "--risk-policy", write(own, policy(9), by="operator-1"))
    assert foreign["code"] == "ROLE_DENIED"
    # the next version counts, and is recorded
    own.start_gate("--risk-policy", write(own, policy(3)))
    held = [r.open for r in own.records() if r.open.get("verb") == "risk-policy"]
    assert [item["version"] for item in held] == [2, 3]


def test_a_role_has_to_be_in_both_policies(own: RunningGate) -> None:
    only = policy(1, roles=("safety_officer",), tau_2=1_000)
    own.start_gate("--risk-policy", write(own, only))
    planner = asking(own)
    reasons(planner)
    with own.client(ClientRole.OPERATOR, "console") as console:
        (question,) = console.approvals()
        assert question.roles == ("safety_officer",)
        said = console.answer(question, ApprovalVerdict.APPROVE, key("supervisor-1", own.trust))
        assert said["why_not"] == "ROLE_DENIED"
        assert reasons(planner) == ["APPROVAL_REQUIRED"]
        console.answer(question, ApprovalVerdict.APPROVE, key("safety-officer-1", own.trust))
    assert reasons(planner) == []


def test_a_stricter_mission_stays_stricter(own: RunningGate) -> None:
    mild = policy(1, tau_1=1_000, tau_2=1_000)
    own.start_gate("--risk-policy", write(own, mild))
    reasons(asking(own, tau_2=31))
    with own.client(ClientRole.OPERATOR, "console") as console:
        (question,) = console.approvals()
        assert (question.required, question.risk) == (3, 35)


def test_a_risk_policy_is_made_signed_and_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "policy.yaml"
    site = ("--site", scenarios.HOSPITAL / "site.yaml")
    words = ("risk-policy", "make", "--organization", "hospital", *site, "--out", file)
    assert authguard(capsys, *words)[0] == 0
    sign = ("risk-policy", "sign", file, *site, "--yes", "--trust", scenarios.trust_folder())
    assert authguard(capsys, *sign, *keys("operator-1"))[0] == 1
    code, told = authguard(capsys, *sign, *keys("safety-officer-1"))
    assert code == 0
    token = Path(told["file"])
    code, told = authguard(
        capsys, "risk-policy", "show", token, "--trust", scenarios.trust_folder()
    )
    assert (code, told["valid"], told["signer"]) == (0, True, "safety-officer-1")
    assert authguard(capsys, "risk-policy", "show", token)[1]["valid"] is None
    plain = file.read_text()
    file.write_text(plain.replace("tau_1: 30", "tau_1: 99"))
    assert authguard(capsys, *sign, *keys("safety-officer-1"))[0] == 4
    file.write_text(plain.replace("tau_1: 30\n", ""))
    assert authguard(capsys, *sign, *keys("safety-officer-1"))[0] == 4
