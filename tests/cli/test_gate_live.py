# SPDX-License-Identifier: Apache-2.0
"""The commands and both clients at a gate that runs: every process is the product's own."""

from __future__ import annotations

import asyncio
import json
import os
import select
import subprocess
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import Peer
from authguard_r.cli import call
from authguard_r.client import AsyncGateClient, GateClient
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, RunningGate, until
from fixtures.json_lines import whole_lines

REPLIES = scenarios.HOSPITAL / "replies"
#: Too fast: one bound, which a signature can raise.
FAST = b'navigate_to(destination="Pharmacy", speed=1.2)'
COLLECT, WRONG = ((REPLIES / f"{n}.json").read_bytes() for n in ("01-collect", "06-wrong-package"))
PATIENT_MS = 60_000


class Desk:
    """A person's terminal at one gate."""

    def __init__(self, gate: RunningGate, capsys: pytest.CaptureFixture[str]) -> None:
        self.gate = gate
        self._capsys = capsys
        self.at = ("--gate", gate.run)
        self.on = (
            *("--trust", gate.trust, "--site", scenarios.HOSPITAL / "site.yaml"),
            *("--store", gate.store, "--robot", gate.rid),
        )

    def __call__(self, *arguments: object) -> tuple[int, str]:
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: object) -> tuple[int, Any]:
        self._capsys.readouterr()
        code = call([*(str(a) for a in arguments), "--json"])
        return code, json.loads(self._capsys.readouterr().out)

    def token(self, **changes: Any) -> Path:
        path = self.gate.folder / "mission.token"
        path.write_bytes(self.gate.token(self.gate.mission(**changes)))
        return path

    def status(self) -> dict[str, Any]:
        code, said = self.json("status", *self.at)
        assert code == 0
        return said  # type: ignore[no-any-return]


@pytest.fixture
def session(capsys: pytest.CaptureFixture[str]) -> Iterator[Desk]:
    with RunningGate(robot=True, estimator=True) as gate:
        yield Desk(gate, capsys)


@pytest.fixture
def quick(capsys: pytest.CaptureFixture[str]) -> Iterator[Desk]:
    """A gate whose robot is inside it, in its own time."""
    with RunningGate(simulate=True) as gate:
        yield Desk(gate, capsys)


@pytest.mark.smoke
def test_a_stop_in_mid_motion_then_a_signed_resume(session: Desk) -> None:
    token = session.token()
    code, said = session.json("mission", "activate", token, *session.on)
    assert (code, said["status"]) == (0, "active")  # over the socket: the gate holds the store
    planner = session.gate.client(ClientRole.PLANNER, "llm", proof=True)
    told: list[dict[str, Any]] = []
    moving = threading.Thread(target=lambda: told.append(planner.propose(COLLECT, key="one")))
    moving.start()
    until(lambda: session.status()["leases"], "the motion")
    code, stopped = session.json("stop", *session.at, "--reason", "a child")
    assert (code, stopped["stopped"], stopped["controller"]) == (0, True, True)
    moving.join(60)
    assert [step["execution"]["outcome"] for step in told[0]["steps"]] == ["aborted"]
    assert session.status()["leases"] == []
    until(lambda: session.status()["mission"]["status"] == "suspended", "the suspension")
    assert (
        session.json("resume", token, "--trust", session.gate.trust, *session.at)[1]["status"]
        == "active"
    )
    stops = [record for record in session.gate.records() if record.kind == "stop"]
    assert len(stops) == 1
    assert stops[0].sealed["why"] == "a child"
    again = planner.propose(COLLECT, key="one")  # what became of it, not another try
    assert (again["repeated"], again["steps"]) == (True, told[0]["steps"])


def test_orders_questions_and_counts_at_a_gate_that_runs(quick: Desk) -> None:
    token = quick.token()
    assert quick("mission", "activate", token, *quick.on)[0] == 0
    planner = quick.gate.client(ClientRole.PLANNER, "llm")
    assert planner.propose(FAST)["steps"][0]["reasons"] == ["PARAMETER_OUT_OF_BOUNDS"]
    change = quick.gate.folder / "next.yaml"
    assert quick("explain", *quick.at, "--draft", change)[0] == 0
    words = ("--site", quick.gate.site, "--no-input")
    assert quick("mission", "compile", change, *words)[0] == 0
    assert quick("explain", *quick.at, "--draft", change)[0] == 5  # it takes nothing's place
    assert quick.json("explain", 0, *quick.at, "--draft", "x")[1]["error"]["where"] == "--draft"
    steps: list[int] = []
    told = planner.propose(COLLECT, on_step=lambda step: steps.append(step["step"]))
    assert [step["execution"]["outcome"] for step in told["steps"]] == ["succeeded", "succeeded"]
    assert steps == [0, 1]
    assert planner.propose(WRONG)["steps"][0]["outcome"] == "reject"
    code, why = quick.json("explain", *quick.at)
    assert (code, why["decision"], "OBJECT_OUT_OF_SCOPE" in why["why"][0]) == (0, "reject", True)
    assert quick("explain", why["seq"], *quick.at)[0] == 0
    assert quick.json("explain", 10**6, *quick.at)[0] == 1
    text = quick("metrics", *quick.at)[1]
    assert 'authguard_outcomes_total{kind="succeeded"} 2.0' in text
    assert "package" not in text
    assert quick("mission", "suspend", token, *quick.on)[0] == 0
    assert quick("resume", token, "--trust", quick.gate.trust, *quick.at)[0] == 0
    orders = [r.decision for r in quick.gate.records() if r.kind == "management"]
    assert orders[-3:] == ["activate", Verb.SUSPEND, Verb.RESUME]
    assert quick.json("mission", "revoke", token, *quick.on)[1]["status"] == "revoked"
    assert planner.propose(COLLECT)["steps"][0]["reasons"][0] == "NO_ACTIVE_MISSION"
    code, said = quick.json("mission", "activate", token, *quick.on)
    assert (code, said["error"]["code"]) == (1, "REVOKED")  # as in the process: authentic, refused


def test_a_resume_after_a_crash_names_what_has_to_be_resolved_and_how(session: Desk) -> None:
    token = session.token()
    assert session("mission", "activate", token, *session.on)[0] == 0
    planner = session.gate.client(ClientRole.PLANNER, "llm")

    def propose() -> None:
        with suppress(AuthGuardError):
            planner.propose(COLLECT)

    moving = threading.Thread(target=propose)
    moving.start()
    until(lambda: session.status()["leases"], "the motion")
    session.gate.kill9()
    moving.join(60)
    session.gate.start_gate()
    held = until(lambda: suspended(session), "the recovery")
    until(lambda: "recovery" in [line["event"] for line in journal(session)], "its line")
    code, said = session.json("resume", token, "--trust", session.gate.trust, *session.at)
    assert (code, said["error"]["code"]) == (1, "TRANSITION_REFUSED")
    (ticket,) = held["open"]
    assert ticket in said["error"]["message"]
    assert "authguard mission resolve" in said["error"]["message"]
    told = ("--ticket", ticket, "--outcome", "aborted")
    assert session("mission", "resolve", token, *told, *session.on)[0] == 0
    assert session("resume", token, "--trust", session.gate.trust, *session.at)[0] == 0
    lines = journal(session)
    starts = [line["unclean"] for line in lines if line["event"] == "start"]
    assert starts == [False, True]
    (settled,) = [line for line in lines if line["event"] == "recovery"]
    assert settled["status"] == "suspended"


def suspended(session: Desk) -> dict[str, Any] | None:
    mission: dict[str, Any] = session.status()["mission"]
    return mission if mission["status"] == "suspended" else None


def journal(session: Desk) -> list[dict[str, Any]]:
    """Return what the gates of this desk wrote to standard error, one after the other."""
    texts = session.gate.logs().values()
    return [line for text in texts for line in whole_lines(text, begins='{"time_ms"')]


@pytest.mark.smoke
def test_the_log_is_read_while_the_gate_holds_the_store(quick: Desk) -> None:
    token = quick.token()
    assert quick("mission", "activate", token, *quick.on)[0] == 0
    planner = quick.gate.client(ClientRole.PLANNER, "llm")
    planner.propose(COLLECT)
    planner.propose(WRONG)
    code, shown = quick.json("audit", "show", quick.gate.store)
    assert (code, shown["records"][0]["kind"]) == (0, "genesis")
    code, found = quick.json("audit", "verify", quick.gate.store)
    assert (code, found["whole"], found["told_by"]) == (0, True, quick.gate.pid)
    assert found["anchored"] == "unanchored"
    code, found = quick.json("audit", "verify", quick.gate.store, "--trust", quick.gate.trust)
    assert (code, found["whole"], found["anchored"]) == (0, True, "checkpoint"), found
    code, asked = quick.json("audit", "prompts", quick.gate.store)
    assert (code, asked["missions"], asked["signatures"]) == (0, 1, 1)
    pid = quick.gate.pid
    quick.gate.stop_process("gate")
    after = quick.json("audit", "show", quick.gate.store)[1]["records"]
    assert after[: len(shown["records"])] == shown["records"]  # word for word what is on disk
    assert quick.json("audit", "verify", quick.gate.store)[1]["told_by"] is None
    ends = [line for line in journal(quick) if line["event"] in {"start", "end"}]
    assert [(line["event"], line.get("pid")) for line in ends] == [("start", pid), ("end", None)]


def has_come(process: subprocess.Popen[bytes]) -> bool:
    """Return whether a process has said something that nobody has read yet."""
    return bool(select.select([process.stdout], [], [], 0.1)[0])


def test_watch_ends_with_the_gate(quick: Desk) -> None:
    told: list[tuple[int, str]] = []
    words = [str(AUTHGUARD), "watch", "--verbose", *(str(word) for word in quick.at)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        until(lambda: any(c["client"].endswith(".cli") for c in watchers(quick)), "the watcher")
        until(lambda: quick.status() and has_come(process), "an event: it is here, and watches")
        quick.gate.stop_process("gate")
        out, _ = process.communicate(timeout=60)
        told.append((process.returncode, out.decode()))
    assert told[0][0] == 0, told
    assert told[0][1].splitlines()[-1].endswith("the gate has ended")


def watchers(session: Desk) -> list[dict[str, Any]]:
    with session.gate.client(ClientRole.AUDITOR, "looks") as auditor:
        return auditor.status()["clients"]  # type: ignore[no-any-return]


def test_status_and_metrics_say_what_the_disk_has_and_who_is_there(session: Desk) -> None:
    status = session.status()
    assert status["disk"]["free_bytes"] > 0
    assert status["disk"]["reserve_bytes"] == session.gate.config.reserve_bytes
    metrics = session.json("metrics", *session.at)[1]
    assert metrics["controller_connected"] == 1
    assert metrics["heard_age_seconds"]["estimator"] < 60
    assert metrics["disk_free_bytes"] > 0
    session.gate.stop_process("robot")
    until(
        lambda: not session.json("metrics", *session.at)[1]["controller_connected"], "its absence"
    )


def test_a_refused_order_is_the_error_that_it_is_in_the_process(quick: Desk) -> None:
    """One code, two errors: who may not sign orders at all, and whose order this is not."""
    operator = quick.gate.client(ClientRole.OPERATOR)
    with pytest.raises(MalformedError):
        operator.activate(b"nonsense")
    with pytest.raises(AuthenticityError, match="ROLE_DENIED"):
        operator.activate(quick.gate.token(by="supervisor-1"))
    token = quick.token()
    assert quick("mission", "activate", token, *quick.on)[0] == 0
    stranger = quick.gate.trust / "keys" / "operator-2"
    signed = ("--key", f"{stranger}.key.pem", "--cert", f"{stranger}.cert.pem")
    code, said = quick.json("mission", "complete", token, *quick.on, *signed)
    assert (code, said["error"]["code"]) == (1, "ROLE_DENIED")


def test_a_held_store_whose_gate_cannot_be_reached_says_where_the_gate_is(quick: Desk) -> None:
    token = quick.token()
    quick.gate.socket.unlink()
    code, said = quick.json("mission", "activate", token, *quick.on)
    assert (code, said["error"]["code"]) == (5, "STORE_UNAVAILABLE")
    assert "the gate is running" in said["error"]["message"]
    assert str(quick.gate.socket) in said["error"]["message"]


def test_when_the_gate_has_ended_the_order_is_done_on_the_store(quick: Desk) -> None:
    token = quick.token()
    quick.gate.stop_process("gate")
    assert quick.json("mission", "activate", token, *quick.on)[1]["status"] == "active"


def test_events_reach_who_watches_while_a_plan_goes_on(quick: Desk) -> None:
    quick.gate.activate()
    path, trust = quick.gate.socket, read_trust(quick.gate.trust)

    async def story() -> tuple[list[str], dict[str, Any]]:
        auditor = AsyncGateClient.connect(path, role=ClientRole.AUDITOR, timeout_ms=PATIENT_MS)
        planner = AsyncGateClient.connect(
            path,
            role=ClientRole.PLANNER,
            verifier=trust,
            robot=quick.gate.rid,
            timeout_ms=PATIENT_MS,
        )
        async with await auditor as watching, await planner as llm:
            events = await watching.watch(idle_ms=PATIENT_MS)
            await llm.observe("camera", "two packages")
            told = await llm.propose(COLLECT)
            seen: list[str] = []
            async for event in events:
                seen.append(event["event"])
                if seen.count("outcome") == 2:
                    break
            assert (await watching.status())["mission"]["status"] == "active"
            return seen, told

    seen, told = asyncio.run(story())
    assert told["planned"] == 2
    assert [name for name in seen if name in {"decision", "outcome"}][-1] == "outcome"


def test_a_role_that_the_configuration_does_not_give_is_exit_4(
    capsys: pytest.CaptureFixture[str],
) -> None:
    only = (Peer(uid=os.geteuid(), roles=(ClientRole.AUDITOR,)),)
    with RunningGate(simulate=True, peers=only) as gate:
        session = Desk(gate, capsys)
        code, said = session.json("status", *session.at)
        assert (code, said["error"]["code"]) == (4, "ROLE_DENIED")
        assert session("status", *session.at, "--role", "auditor", "--trust", gate.trust)[0] == 0
        code, said = session.json("mission", "activate", session.token(), *session.on)
        assert (code, said["error"]["code"]) == (4, "ROLE_DENIED")
        auditor = gate.client(ClientRole.AUDITOR)
        with pytest.raises(AuthenticityError):
            auditor.activate(b"t")  # is not even sent
        assert auditor.status()["robot"] == gate.rid


def test_a_gate_in_shadow_mode_is_refused_by_a_planner_unless_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with RunningGate(mode=Mode.SHADOW) as gate:
        with pytest.raises(RefusedError, match="shadow"):
            gate.client(ClientRole.PLANNER)
        assert gate.client(ClientRole.PLANNER, allow_shadow=True).welcome.mode is Mode.SHADOW
        assert "SHADOW" in Desk(gate, capsys)("status", "--gate", gate.run)[1]


def test_more_connections_than_a_user_may_have_are_told_so() -> None:
    with RunningGate(simulate=True, connections=2) as gate:
        held = [gate.client(ClientRole.AUDITOR) for _ in range(2)]
        with pytest.raises(AuthGuardError) as full:
            gate.client(ClientRole.AUDITOR)
        assert full.value.reason is Reason.BUSY
        held.pop().close()
        until(lambda: _fits(gate), "room for another client")


def _fits(gate: RunningGate) -> bool:
    try:
        gate.client(ClientRole.AUDITOR).close()
    except AuthGuardError:
        return False
    return True


def test_a_second_proposal_at_once_is_busy_and_the_first_goes_on(session: Desk) -> None:
    session.gate.activate()

    async def both() -> tuple[BaseException | dict[str, Any], dict[str, Any]]:
        connecting = AsyncGateClient.connect(
            session.gate.socket, role=ClientRole.PLANNER, timeout_ms=PATIENT_MS
        )
        async with await connecting as planner:
            begun = asyncio.Event()
            first = asyncio.create_task(planner.propose(COLLECT, on_step=lambda _: begun.set()))
            await begun.wait()
            second = (await asyncio.gather(planner.propose(WRONG), return_exceptions=True))[0]
            lane = await AsyncGateClient.connect(session.gate.stop_socket, role=ClientRole.PLANNER)
            async with lane:
                assert (await lane.stop("enough"))["stopped"] is True
            return second, await first

    second, first = asyncio.run(both())
    assert isinstance(second, EnvironmentFault)
    assert second.reason is Reason.BUSY
    assert first["steps"][0]["execution"]["outcome"] == "aborted"


def test_a_client_of_another_robot_s_root_does_not_believe_the_gate(
    quick: Desk, tmp_path: Path
) -> None:
    foreign = tmp_path / "foreign"
    assert (
        call(["keys", "init", str(foreign), "--site", str(scenarios.HOSPITAL / "site.yaml")]) == 0
    )
    with pytest.raises(AuthenticityError):
        GateClient.connect(quick.gate.socket, role=ClientRole.PLANNER, verifier=read_trust(foreign))
    code, said = quick.json("status", *quick.at, "--trust", foreign)
    assert code == 4
    assert said["error"]["code"] != "ROLE_DENIED"
