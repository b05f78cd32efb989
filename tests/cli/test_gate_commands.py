# SPDX-License-Identifier: Apache-2.0
"""The commands that speak to a gate, against whatever may listen at its sockets."""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import select
import shutil
import socket
import struct
import subprocess
import sys
import termios
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typer

from authguard_r.audit.record import LogRow
from authguard_r.cli import call
from authguard_r.cli.gateway import RUNS, only_run
from authguard_r.cli.status_lines import status_lines
from authguard_r.cli.watch import event_line, picture
from authguard_r.client import stopping
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.token import open_token
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.operations.exposition import exposition
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.wire.messages import ClientRole, Kind, OrderKind
from fixtures import scenarios
from fixtures.scripted_peer import Peer, Talk, listening, welcome_of

SITE = ["--site", "h/site.yaml"]
KEY = ["--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem"]
ON = ["--trust", "trust", *SITE, "--store", "r.db"]

STATUS: dict[str, Any] = {
    "robot": scenarios.RID,
    "mode": "enforce",
    "uptime_ms": 3_725_000,
    "mission": {
        "mid": "carry-7",
        "version": 2,
        "status": "active",
        "issuer": "operator-1",
        "expiry": "2027-01-01T00:00:00Z",
        "grants": [{"id": "pick", "type": "pick", "starts": 1, "of": 2}],
        "open": ["T" * 43],
    },
    "place": ["pharmacy"],
    "holding": "package-7",
    "state_age_ms": 80,
    "last_refusal": {
        "record": 27,
        "ago_ms": 12_000,
        "action": {"type": "navigate", "object": None, "destination": "isolation-room"},
        "reasons": ["DESTINATION_OUT_OF_SCOPE"],
        "findings": [
            {
                "field": "destination",
                "reason": "DESTINATION_OUT_OF_SCOPE",
                "expected": "pharmacy",
                "got": "isolation-room",
                "step": 7,
            }
        ],
    },
    "leases": [{"ticket": "T" * 43, "action": "navigate", "for_ms": 5_000, "left_ms": 20_000}],
    "clients": [{"role": "planner", "client": "llm", "uid": 1000, "idle_ms": 90_000}],
    "heard": {"planner_ms": 90_000, "estimator_ms": 80, "controller_ms": None},
    "stops": 3,
    "alerts": [{"what": "planner silent", "for_ms": 90_000}, {"what": "no progress"}],
    "refusals": {"open": ["GUARD_FALSE"], "folded": 12},
    "disk": {"free_bytes": 5 << 20, "reserve_bytes": 1 << 20},
    "log": {"size": 120, "head": "h"},
}


class Shell:
    """One working folder with the hospital in it, and what the last command printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: Any, folder: Path) -> None:
        self._capsys = capsys
        self._patch = patch
        self.folder = folder

    def __call__(self, *arguments: object) -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"")))
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: object) -> tuple[int, Any]:
        code, out = self(*arguments, "--json")
        return code, json.loads(out)

    def refused(self, *arguments: object) -> tuple[int, str, str]:
        code, answer = self.json(*arguments)
        return code, answer["error"]["code"], answer["error"]["message"]


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("AUTHGUARD_GATE", raising=False)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    return Shell(capsys, monkeypatch, tmp_path)


@pytest.fixture
def token(shell: Shell) -> str:
    assert shell("mission", "compile", "h/mission.yaml", *SITE, "--out", "m.json")[0] == 0
    assert shell("mission", "sign", "m.json", *KEY, *SITE, "--out", "m.token", "--yes")[0] == 0
    return "m.token"


def serving(answers: dict[Kind, Any], seen: list[Any] | None = None) -> Talk:
    """Return a gate that answers each kind of request with an object, or a fault's code."""

    async def talk(peer: Peer) -> None:
        hello = await peer.welcome()
        assert hello.client == "cli"
        while True:
            item = await peer.frame()
            said = answers[item.kind]
            if seen is not None:
                seen.append((hello, item))
            if isinstance(said, str):
                peer.fault(item.id, said, family="refused")
            else:
                peer.reply(item.id, **said)
            if item.kind is Kind.WATCH:
                for event in EVENTS:
                    peer.event(item.id, **event)

    return talk


EVENTS: list[dict[str, Any]] = [
    {
        "event": "decision",
        "time_ms": scenarios.START_MS,
        "client": "llm",
        "outcome": "reject",
        "reasons": ["OBJECT_OUT_OF_SCOPE"],
        "action": {"type": "pick", "object": "package-b", "destination": None},
        "execution": {"outcome": None},
    },
    {"event": "stop", "time_ms": scenarios.START_MS, "by": "cli", "role": "operator"},
    {"event": "alert", "what": "evil\x1b[2Jtext\n"},
]


# --- status


@pytest.mark.parametrize("way", ["folder", "socket", "other socket", "environment"])
def test_the_gate_is_found_by_its_folder_its_socket_or_the_environment(
    shell: Shell, way: str, monkeypatch: Any
) -> None:
    with listening(serving({Kind.STATUS: STATUS})) as path:
        named = {"folder": path.parent, "socket": path, "other socket": path.parent / "stop.sock"}
        if way == "other socket":
            with socket.socket(socket.AF_UNIX) as lane:
                lane.bind(str(named[way]))
        if way == "environment":
            monkeypatch.setenv("AUTHGUARD_GATE", str(path.parent))
        on = ["--gate", named[way]] if way in named else []
        assert shell.json("status", *on) == (0, STATUS)


def test_the_old_variable_works_for_one_version(shell: Shell, monkeypatch: Any) -> None:
    with listening(serving({Kind.STATUS: STATUS})) as path:
        monkeypatch.setenv("AUTHGUARD_RUN", str(path.parent))
        code, text = shell("status")
        assert (code, "AUTHGUARD_RUN is now AUTHGUARD_GATE" in text) == (0, True)


def test_status_tells_a_person_how_things_stand(shell: Shell) -> None:
    with listening(serving({Kind.STATUS: STATUS})) as path:
        code, text = shell("status", "--gate", path)
    assert code == 0
    assert text.splitlines() == [
        f"{scenarios.RID}: enforce, up 1 h 2 min",
        "ALERT: planner silent (for_ms 90000)",
        "ALERT: no progress",
        "last refusal, 12.0 s ago: navigate isolation-room (authguard explain 27)",
        "  DESTINATION_OUT_OF_SCOPE at destination: expected pharmacy, got isolation-room",
        "robot: at pharmacy, holds package-7 (measured 0.1 s ago)",
        "moving: navigate, for 5.0 s, at most 20.0 s more (lease TTTTTTTTTTTT...)",
        "mission carry-7 version 2: active, by operator-1, until 2027-01-01T00:00:00Z",
        "  pick (pick): 1 of 2 starts",
        f"  open release {'T' * 43}",
        "last message: planner 1 min 30 s ago, estimator 0.1 s ago, controller never",
        "client: planner llm (user 1000), idle 1 min 30 s",
        "refused: open GUARD_FALSE, folded 12",
        "disk: 5 MiB free, 1 MiB reserved",
        "stops: 3; log: 120 records",
    ]


def test_a_gate_in_shadow_mode_says_so_first() -> None:
    assert "SHADOW" in status_lines({**STATUS, "mode": "shadow"})[0]


def test_a_status_that_says_little_is_shown_as_far_as_it_goes() -> None:
    assert "no active mission" in status_lines({})
    assert "disk: free 5" in status_lines({"disk": {"free": 5}})
    assert "DAMAGED: it" in status_lines({"damaged": ["it"]})
    assert "stop process: answers" in status_lines({"lane": {"alive": True}})
    assert "STOP PROCESS: DOES NOT ANSWER" in status_lines({"lane": {"alive": False}})
    assert "up ?" in status_lines({})[0]


def test_status_says_in_words_what_a_mission_is_worth_and_what_stands() -> None:
    mission = {"mid": "first", "version": 1, "status": "active", "void": "CERTIFICATE_REVOKED"}
    assert "  AUTHORIZES NOTHING: CERTIFICATE_REVOKED" in status_lines({"mission": mission})
    plain = status_lines({"mission": {**mission, "void": None}, "stop_stands": False})
    assert not any("AUTHORIZES" in line or "STOPPED BY" in line for line in plain)
    (stop,) = [line for line in status_lines({"stop_stands": True}) if "STOPPED BY" in line]
    assert "activate a mission, then: authguard resume TOKEN" in stop
    standing = {"stop_stands": True, "mission": {"mid": "first"}}
    (stop,) = [line for line in status_lines(standing) if "STOPPED BY" in line]
    assert "OPERATOR; authguard resume TOKEN ends the stop" in stop
    policy = {"policy": "courier", "version": 2, "expiry": "2027-01-01T00:00:00Z"}
    quiet = status_lines({"emergency": {**policy, "under_way": None, "unknown": []}})
    assert "emergency policy: courier version 2, until 2027-01-01T00:00:00Z" in quiet
    assert not any("EMERGENCY" in line for line in quiet)
    loud = status_lines({"emergency": {**policy, "under_way": "go", "unknown": ["drop", "go"]}})
    assert "EMERGENCY UNDER WAY: go" in loud
    assert "EMERGENCY ENDED UNKNOWN: drop, go; go and look" in loud


def test_what_is_not_witnessed_is_said_with_who_cosigns() -> None:
    said = {"quorum": 1, "confirmed": 0, "unwitnessed": 7, "witnessed_ms": 0}
    witness = {**said, "witnesses": [{"name": "w", "state": "unreachable"}]}
    lines = status_lines({"anchor": {"state": "uncounted", "witness": witness}})
    assert "witnesses: 0 of 1 since the start (w unreachable)" in lines
    assert "  not witnessed: 7 records (never yet)" in lines
    later = {**witness, "witnessed_ms": scenarios.START_MS}
    (line,) = (
        one
        for one in status_lines({"anchor": {"state": "counted", "witness": later}})
        if "not witnessed" in one
    )
    assert "last at 20" in line
    assert not [one for one in status_lines({"anchor": {"state": "counted"}}) if "witness" in one]


def test_the_gate_s_words_cannot_drive_the_terminal(shell: Shell) -> None:
    evil = {**STATUS, "robot": "evil\x1b[2J"}
    with listening(serving({Kind.STATUS: evil})) as path:
        assert "\x1b" not in shell("status", "--gate", path)[1]


def test_the_role_is_the_user_s_choice_and_the_gate_s_decision(shell: Shell) -> None:
    seen: list[Any] = []
    with listening(serving({Kind.STATUS: STATUS}, seen)) as path:
        assert shell("status", "--gate", path, "--role", "auditor")[0] == 0
        assert shell("status", "--gate", path, "--role", "king")[0] == 2
    assert [hello.role for hello, _ in seen] == [ClientRole.AUDITOR]


@pytest.mark.parametrize("command", ["status", "watch", "explain", "metrics"])
@pytest.mark.parametrize("role", ["controller", "estimator", "planner", "gate"])
def test_nobody_takes_the_robot_s_place_to_read(shell: Shell, command: str, role: str) -> None:
    code, reason, message = shell.refused(command, "--gate", shell.folder, "--role", role)
    assert (code, reason) == (2, "USAGE")
    assert "'operator', 'auditor'" in message


def test_the_only_gate_of_the_machine_is_found_without_its_folder(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFault, match=r"no folder below .* has a `stop\.sock`"):
        only_run(tmp_path / "nothing", "stop.sock")
    with socket.socket(socket.AF_UNIX) as one, socket.socket(socket.AF_UNIX) as two:
        for name, line in (("r-1", one), ("r-2", two), ("other", None)):
            (tmp_path / name).mkdir()
            if line is not None:
                line.bind(str(tmp_path / name / "stop.sock"))
            found = sorted(path.parent for path in tmp_path.glob("*/stop.sock"))
            if len(found) == 1:
                assert only_run(tmp_path, "stop.sock") == tmp_path / "r-1"
        with pytest.raises(typer.BadParameter) as several:
            only_run(tmp_path, "stop.sock")
    assert all(str(tmp_path / name) in several.value.message for name in ("r-1", "r-2"))
    assert "--gate" in several.value.message
    with pytest.raises(EnvironmentFault):
        only_run(tmp_path, "gate.sock")


def test_without_a_folder_a_command_says_where_it_looked(shell: Shell, monkeypatch: Any) -> None:
    monkeypatch.setattr("authguard_r.cli.gateway.RUNS", shell.folder / "runs")
    code, _, message = shell.refused("stop")
    assert (code, str(shell.folder / "runs") in message, "--gate" in message) == (5, True, True)


def test_the_deployed_units_put_a_gate_where_commands_look() -> None:
    units = scenarios.ROOT / "deploy" / "systemd"
    for name in ("authguard-gate@.service", "authguard-stop-lane@.service"):
        text = (units / name).read_text()
        assert f"RuntimeDirectory={RUNS.name}/%i\n" in text
        assert f"--gate {RUNS}/%i\n" in text


@pytest.mark.parametrize("command", ["status", "watch", "stop", "explain", "metrics"])
def test_where_no_gate_is_the_environment_is_at_fault(
    shell: Shell, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("authguard_r.client.stopping.GONE_S", 0.3)
    code, text = shell(command, "--gate", shell.folder)
    assert code == 5
    assert "no gate answers" in text
    assert str(shell.folder) in text


def test_with_a_trust_folder_the_gate_has_to_prove_itself(shell: Shell) -> None:
    async def unproved(peer: Peer) -> None:
        await peer.welcome(proof=None)
        await peer.gone()

    with listening(serving({Kind.STATUS: STATUS})) as path:
        assert shell("status", "--gate", path, "--trust", "trust")[0] == 0
    with listening(unproved) as path:
        code, reason, _ = shell.refused("status", "--gate", path, "--trust", "trust")
    assert (code, reason) == (4, "SIGNATURE_INVALID")


# --- watch


def test_watch_prints_one_event_a_line_and_nothing_that_drives_a_terminal(shell: Shell) -> None:
    with listening(serving({Kind.WATCH: {}})) as path:
        code, text = shell("watch", "--gate", path, "--count", 3)
    lines = text.splitlines()
    assert code == 0
    assert len(lines) == 3
    assert lines[0].endswith("decision   llm reject pick package-b OBJECT_OUT_OF_SCOPE")
    assert lines[1].endswith("stop       by=cli role=operator")
    assert lines[2].startswith("- alert")
    assert "\x1b" not in text


def test_watch_prints_json_lines(shell: Shell) -> None:
    with listening(serving({Kind.WATCH: {}})) as path:
        code, text = shell("watch", "--gate", path, "--jsonl", "--count", 3)
        assert shell.json("watch", "--gate", path, "--count", 2) == (0, {"events": EVENTS[:2]})
    assert code == 0
    assert [json.loads(line) for line in text.splitlines()] == EVENTS


def test_an_event_of_any_shape_is_a_line() -> None:
    for event in ({}, {"event": "decision"}, {"event": "outcome", "time_ms": 10**18}):
        assert event_line(event)
    ended = {"event": "outcome", "execution": {"outcome": "succeeded"}}
    assert "-> succeeded" in event_line(ended)
    assert picture(STATUS, ["x"])[-2:] == ["", "x"]


def test_orders_and_requests_are_events_in_words() -> None:
    order = {"event": "management", "act": "command", "by": "u0.cli"}
    after = {"mid": "deliver-p1", "version": 1, "status": "revoked"}
    line = event_line({**order, **after})
    assert line.endswith("command by u0.cli: mission deliver-p1 version 1 is revoked")
    assert event_line(order).endswith("command by u0.cli")
    asked = {"event": "approval", "mid": "deliver-p1", "counter": 1}
    line = event_line({**asked, "what": "asked", "required": 2})
    assert line.endswith("request 1 of mission deliver-p1: asked, needs 2 people")
    line = event_line({**asked, "what": "answered", "by": "operator-1", "why_not": "ROLE_DENIED"})
    assert line.endswith("answered, by operator-1, does not count: ROLE_DENIED")


@pytest.fixture
def program(shell: Shell) -> Iterator[Any]:
    """Start the command as a process of its own; it is ended by its number afterwards."""
    started: list[subprocess.Popen[bytes]] = []

    def start(*arguments: object, **how: Any) -> subprocess.Popen[bytes]:
        command = [Path(sys.executable).parent / "authguard", *map(str, arguments)]
        kept = {name: v for name, v in os.environ.items() if not name.startswith("COV")}
        process = subprocess.Popen(command, env={**kept, "TERM": "xterm"}, **how)
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.wait()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


def test_at_a_terminal_watch_draws_status_and_events_together(program: Any) -> None:
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 120, 0, 0))
    shown = b""
    try:
        with listening(serving({Kind.WATCH: {}, Kind.STATUS: STATUS})) as path:
            process = program(
                "watch", "--gate", path, "--count", 3, stdin=theirs, stdout=theirs, stderr=theirs
            )
            until = time.monotonic() + 60
            while process.poll() is None or select.select([ours], [], [], 0)[0]:
                assert time.monotonic() < until
                if select.select([ours], [], [], 0.1)[0]:
                    shown += os.read(ours, 1 << 16)
    finally:
        os.close(ours)
        os.close(theirs)
    assert process.returncode == 0, shown
    assert b"mission carry-7 version 2" in shown
    assert b"llm reject pick package-b" in shown
    assert b"evil\x1b" not in shown


# --- stop and resume


@pytest.mark.parametrize(
    ("said", "code", "words"),
    [
        ({"stopped": True, "controller": True, "after_ms": 41}, 0, "stands after 41 ms"),
        ({"stopped": False, "controller": True, "after_ms": 9}, 5, "did not confirm that"),
        ({"stopped": False, "controller": False, "after_ms": 0}, 5, "no controller is connected"),
    ],
)
def test_stop_goes_through_the_lane_and_says_whether_the_robot_stands(
    shell: Shell,
    said: dict[str, Any],
    code: int,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stopping, "TOLD_S", 0.2)
    monkeypatch.setattr(stopping, "GONE_S", 0.2)
    seen: list[Any] = []
    with listening(serving({Kind.STOP: said}, seen), "stop.sock") as path:
        got, text = shell("stop", "--gate", path.parent, "--reason", "a child")
        assert (got, words in text) == (code, True)
        told = {**said, "role": "operator"}
        assert shell.json("stop", "--gate", path.parent) == (code, told)
        assert "suspended until `authguard resume`" in text
    bodies = [json.loads(item.body) for _, item in seen]
    assert [body["why"] for body in bodies] == ["a child", ""]
    assert len({body["key"] for body in bodies}) == 2  # each stop has a name of its own


def test_a_robot_can_be_stopped_where_the_gate_is_in_shadow_mode(shell: Shell) -> None:
    async def shadow(peer: Peer) -> None:
        await peer.welcome(mode="shadow")
        number, _ = await peer.request()
        peer.reply(number, stopped=True, controller=True, after_ms=1)

    with listening(shadow, "stop.sock") as path:
        assert shell("stop", "--gate", path.parent, "--role", "planner")[0] == 0


def lane(*mine: str, reason: str = "ROLE_DENIED") -> Talk:
    """Return a stop lane at which this user may be nothing but these."""

    async def talk(peer: Peer) -> None:
        number, hello = await peer.request()
        if hello.role not in mine:
            peer.fault(number, reason, family="authenticity")
            return
        peer.send(Kind.WELCOME, 0, welcome_of(hello))
        number, _ = await peer.request()
        peer.reply(number, stopped=True, controller=True, after_ms=1)

    return talk


@pytest.mark.parametrize("role", ["auditor", "planner", "estimator"])
def test_whoever_may_stop_stops_without_naming_a_role(shell: Shell, role: str) -> None:
    with listening(lane(role), "stop.sock") as path:
        code, told = shell.json("stop", "--gate", path.parent)
        assert (code, told["role"]) == (0, role)
        text = shell("stop", "--gate", path.parent)[1]
        other = "auditor" if role == "planner" else "planner"
        denied = shell.refused("stop", "--gate", path.parent, "--role", other)
    article = "a" if role == "planner" else "an"
    assert f"recorded as {article} {role}'s stop" in text
    assert "resume" not in text
    assert denied[:2] == (4, "ROLE_DENIED")  # a role that is named is kept


def test_who_may_be_nothing_is_told_what_was_tried(shell: Shell) -> None:
    with listening(lane(), "stop.sock") as path:
        code, reason, message = shell.refused("stop", "--gate", path.parent)
    assert (code, reason) == (4, "ROLE_DENIED")
    assert "`operator`, `auditor`, `planner`, `estimator`" in message


def test_only_a_denied_role_is_tried_again_as_another(shell: Shell) -> None:
    with listening(lane(reason="SIGNATURE_INVALID"), "stop.sock") as path:
        assert shell.refused("stop", "--gate", path.parent)[:2] == (4, "SIGNATURE_INVALID")


def test_stop_with_a_store_records_there_and_reaches_no_gate(shell: Shell, token: str) -> None:
    assert shell("mission", "activate", token, *ON, "--new")[0] == 0
    told = {"stopped": False, "recorded": True, "by_gate": False}
    assert shell.json("stop", *ON) == (5, told)
    records = shell.json("audit", "show", "r.db")[1]["records"]
    assert [r["kind"] for r in records][-2:] == ["stop", "management"]
    assert shell("stop", "--store", "r.db")[0] == 2
    assert shell("stop", *ON, "--gate", "x")[0] == 2


def test_resume_is_a_signed_order_over_the_socket(shell: Shell, token: str) -> None:
    seen: list[Any] = []
    standing = {"mid": "m", "version": 1, "status": "active"}
    ahead_ms = time.time_ns() // 1_000_000 + 45_000  # a simulated robot has moved meanwhile
    answers = {Kind.STATUS: {"simulated_ms": ahead_ms}, Kind.ORDER: {"standing": standing}}
    with listening(serving(answers, seen)) as path:
        code, answer = shell.json("resume", token, "--trust", "trust", "--gate", path)
    assert (code, answer) == (0, {"standing": standing, "status": "active"})
    order = json.loads(seen[1][1].body)
    assert order["act"] == OrderKind.COMMAND
    opened, _, signer = open_token(
        msgspec.convert(order["token"], bytes),
        Command,
        tag=Tag.COMMAND,
        roles=frozenset({"operator"}),
        verifier=read_trust(Path("trust")),
        now=Now(time.time_ns() // 1_000_000, 0),
    )
    assert (opened.verb, signer.id) == (Verb.RESUME, "operator-1")
    assert opened.issued_ms == ahead_ms


def test_only_a_demonstrations_root_takes_time_from_a_gate(
    shell: Shell, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gate of a real robot that claims to be simulated gets no order for later."""
    seen: list[Any] = []
    monkeypatch.setattr(Trust, "demo", False)
    answers = {Kind.STATUS: {"simulated_ms": 2**50}, Kind.ORDER: {"standing": {"mid": "m"}}}
    with listening(serving(answers, seen)) as path:
        assert shell("resume", token, "--trust", "trust", "--gate", path)[0] == 0
    assert [item.kind for _, item in seen] == [Kind.ORDER]


def test_a_resume_that_the_gate_refuses_is_exit_1(shell: Shell, token: str) -> None:
    with listening(serving({Kind.STATUS: {}, Kind.ORDER: "TRANSITION_REFUSED"})) as path:
        code, reason, _ = shell.refused("resume", token, "--trust", "trust", "--gate", path)
    assert (code, reason) == (1, "TRANSITION_REFUSED")


def test_a_release_ends_in_a_known_way_or_is_left_open(shell: Shell, token: str) -> None:
    words = ("mission", "resolve", token, *ON, "--ticket", "T" * 43, "--outcome", "unknown")
    code, _, message = shell.refused(*words)
    assert code == 2
    assert "'aborted'" in message


# --- the log of a gate that runs


def telling(
    rows: list[LogRow], *, mine: str = "auditor", status: dict[str, Any] | None = None
) -> Talk:
    """Return a gate that tells these rows, two at a time, to one role alone."""

    async def talk(peer: Peer) -> None:
        number, hello = await peer.request()
        if hello.role != mine:
            peer.fault(number, "ROLE_DENIED", family="authenticity")
            return
        peer.send(Kind.WELCOME, 0, welcome_of(hello))
        while True:
            item = await peer.frame()
            if item.kind is Kind.STATUS:
                peer.reply(
                    item.id, **{"log": {"size": len(rows)}, "mission": None, **(status or {})}
                )
                continue
            first = json.loads(item.body)["first"]
            page = [
                {
                    "seq": row.seq,
                    "record": msgspec.Raw(row.record),
                    "sealed": msgspec.Raw(row.sealed),
                    "link": b64(row.link),
                }
                for row in rows[first : first + 2]
            ]
            peer.send(Kind.REPLY, item.id, {"records": page})

    return talk


@pytest.mark.parametrize("role", ["auditor", "operator"])
def test_the_log_of_a_gate_that_runs_is_told_by_it(shell: Shell, token: str, role: str) -> None:
    plan = ["--binding", "h/binding.yaml", "--plan", "h/replies/06-wrong-package.json"]
    assert shell("run", "--token", token, *ON, *plan)[0] == 1
    from_file = [shell.json("audit", name, "r.db")[1] for name in ("show", "verify", "prompts")]
    rows = list(read_rows(Path("r.db")))
    assert len(rows) > 2  # more than one page
    with listening(telling(rows, mine=role)) as path:
        beside(path)
        told = [shell.json("audit", name, "r.db")[1] for name in ("show", "verify", "prompts")]
        text = shell("audit", "verify", "r.db")[1]
        held = ("--checkpoint", "r.checkpoint", "--trust", "trust")
        assert "signed-terminal" in shell("audit", "verify", "r.db", *held)[1]
    assert told[0] == from_file[0]
    # the file holds a checkpoint that nobody's key was named for; a gate tells records alone
    assert told[1] == {**from_file[1], "told_by": 4711, "not_verified": [], "held_to": []}
    assert told[2] == from_file[2]
    assert "read from the running gate (process 4711)" in text


def test_a_gate_that_tells_another_log_is_not_whole(shell: Shell, token: str) -> None:
    assert shell("mission", "activate", token, *ON, "--new")[0] == 0
    rows = list(read_rows(Path("r.db")))
    with listening(telling([rows[0], rows[0]])) as path:
        beside(path)
        assert shell.json("audit", "verify", "r.db")[0] == 1
    with listening(telling(rows, status={"log": {"size": 99}})) as path:
        beside(path)
        assert shell.refused("audit", "show", "r.db")[:2] == (4, "MALFORMED")


def test_who_may_not_read_at_the_gate_does_not_read(shell: Shell) -> None:
    with listening(telling([], mine="planner")) as path:
        beside(path)
        assert shell.refused("audit", "show", "r.db")[:2] == (4, "ROLE_DENIED")


def test_no_missions_yet_is_no_figure(shell: Shell) -> None:
    open_store(Path("r.db")).close()
    assert shell.json("audit", "prompts", "r.db")[1]["per_mission"] is None
    assert shell("audit", "prompts", "r.db")[1].startswith("no missions yet\n")


# --- what is wrong with the words


def test_wrong_usage_is_one_line_and_names_the_option(shell: Shell) -> None:
    code, text = shell("init", "x", "--out", "y")
    assert code == 2
    assert text == "USAGE: Missing option '--from'. Choose from: mcp, openai, ros (at --from)\n"
    code, text = shell("init", "x", "--from", "king", "--out", "y")
    assert "Value error" not in text
    assert text.endswith("(at --from)\n")
    assert shell("init", "--from", "mcp", "--out", "y")[1].endswith("(at LIST)\n")


@pytest.mark.parametrize("command", ["gate", "advanced stop-process", "robot", "estimator"])
def test_a_run_folder_that_is_a_file_is_said_to_be_one(shell: Shell, command: str) -> None:
    Path("file").write_text("")
    config = gate_config(shell)
    name = f"trust/keys/{'estimator' if command == 'estimator' else 'gate'}-{scenarios.RID}"
    signer = ("--key", f"{name}.key.pem", "--cert", f"{name}.cert.pem")
    words = {
        "gate": (
            *("--demo", *SITE, "--binding", "h/binding.yaml"),
            *("--config", config, "--store", "r.db"),
        ),
        "advanced stop-process": ("--config", config, *signer),
        "robot": tuple(SITE),
        "estimator": signer,
    }[command]
    on = ("--robot", scenarios.RID, "--trust", "trust", "--gate", "file")
    code, reason, message = shell.refused(*command.split(), *on, *words)
    assert (code, reason) == (5, "FILE_UNAVAILABLE")
    assert "expected a folder" in message


def gate_config(shell: Shell) -> str:
    words = ("--demo", "--robot", scenarios.RID, "--trust", "trust", "--out", "gate.token")
    assert shell("gate-config", "make", *words)[0] == 0
    return "gate.token"


# --- explain


def test_explain_asks_the_gate(shell: Shell) -> None:
    seen: list[Any] = []
    told = {"seq": 7, "text": ["record 7: because", "  of\x1bthat"]}
    with listening(serving({Kind.EXPLAIN: told, Kind.STATUS: {}}, seen)) as path:
        assert shell("explain", 7, "--gate", path) == (0, "record 7: because\n  of\\x1bthat\n")
        assert shell.json("explain", "--gate", path) == (0, told)
    asked = [json.loads(item.body)["seq"] for _, item in seen if item.kind is Kind.EXPLAIN]
    assert asked == [7, None]


def test_explain_reads_a_store_that_no_gate_holds(shell: Shell, token: str) -> None:
    plan = ["--binding", "h/binding.yaml", "--plan", "h/replies/06-wrong-package.json"]
    assert shell("run", "--token", token, *ON, *plan)[0] == 1
    code, told = shell.json("explain", "--store", "r.db")
    assert code == 0
    assert told["kind"] == "decision"
    assert any("OBJECT_OUT_OF_SCOPE" in line for line in told["why"])
    code, text = shell("explain", told["seq"], "--store", "r.db")
    assert (code, "OBJECT_OUT_OF_SCOPE" in text) == (0, True)
    assert shell.refused("explain", 99_999, "--store", "r.db")[:2] == (1, "VALUE_OUT_OF_RANGE")
    assert shell("explain", "--store", "r.db", "--gate", "x")[0] == 2
    assert shell("explain", "--store", "nothing.db")[0] == 5


# --- metrics


METRICS = {
    "decisions_total": {"accept": 2, "reject": 1, "carry the medicine to room 101": 9},
    "mission_active": 1,
    "uptime_seconds": 1.5,
    "Bad Name": 3,
    "mission": "carry the medicine",
    "flag": True,
}


def test_metrics_are_numbers_and_codes_never_words_of_a_mission(shell: Shell) -> None:
    with listening(serving({Kind.METRICS: METRICS})) as path:
        code, text = shell("metrics", "--gate", path)
        assert shell.json("metrics", "--gate", path) == (0, METRICS)
    assert code == 0
    samples = [line for line in text.splitlines() if not line.startswith("#")]
    assert samples == [
        'authguard_decisions_total{kind="accept"} 2.0',
        'authguard_decisions_total{kind="reject"} 1.0',
        "authguard_mission_active 1.0",
        "authguard_uptime_seconds 1.5",
    ]
    assert "# TYPE authguard_decisions_total counter" in text
    assert "medicine" not in text
    assert exposition({}) == b""


@pytest.mark.parametrize(
    "listen", ["0.0.0.0:9100", "192.168.1.5:9100", "[::]:9100", "localhost:9100", "9100", "x"]
)
def test_metrics_listen_on_loopback_and_nowhere_else(shell: Shell, listen: str) -> None:
    code, text = shell("metrics", "--gate", "x", "--listen", listen)
    assert (code, "127.0.0.1:PORT" in text) == (2, True)


def test_metrics_are_served_fresh_and_a_gate_that_is_away_is_seen(program: Any) -> None:
    with listening(serving({Kind.METRICS: METRICS})) as path:
        process = program(
            "metrics", "--gate", path, "--listen", "127.0.0.1:0", stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        url = process.stdout.readline().decode().strip()
        with urllib.request.urlopen(url, timeout=30) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            assert b'authguard_decisions_total{kind="accept"} 2.0' in answer.read()
        with pytest.raises(urllib.error.HTTPError) as elsewhere:
            urllib.request.urlopen(url.replace("metrics", "records"), timeout=30)
        elsewhere.value.close()
    with pytest.raises(urllib.error.HTTPError) as away:
        urllib.request.urlopen(url, timeout=30)
    away.value.close()
    assert (elsewhere.value.code, away.value.code) == (404, 503)
    assert process.poll() is None


# --- orders go to the gate that holds the store


def beside(path: Path, **changes: Any) -> None:
    said = {"socket": str(path), "pid": 4711, "robot": scenarios.RID, **changes}
    Path("r.db.gate").write_text(json.dumps(said))


def standing() -> dict[str, Any]:
    made: dict[str, Any] = msgspec.to_builtins(scenarios.active(scenarios.verified()))
    assert msgspec.convert(made, Standing)
    return made


def test_an_order_goes_to_the_gate_that_holds_the_store(shell: Shell, token: str) -> None:
    seen: list[Any] = []
    with listening(serving({Kind.STATUS: {}, Kind.ORDER: {"standing": standing()}}, seen)) as path:
        beside(path)
        code, answer = shell.json("mission", "activate", token, *ON, "--new")
        assert (code, answer["status"]) == (0, "active")
        assert shell("mission", "suspend", token, *ON)[0] == 0
        chosen = ("--grant", "pick", "--row", 0, "--yes")
        assert shell("mission", "choose", token, *ON, *chosen)[0] == 0
    orders = [json.loads(item.body) for _, item in seen if item.kind is Kind.ORDER]
    assert [order["act"] for order in orders] == [
        OrderKind.ACTIVATE,
        OrderKind.COMMAND,
        OrderKind.SELECT,
    ]
    assert msgspec.convert(orders[0]["token"], bytes) == Path(token).read_bytes()
    assert orders[0]["confirmation"] is not None
    assert {hello.role for hello, _ in seen} == {ClientRole.OPERATOR}
    assert all(hello.nonce is not None for hello, _ in seen)
    assert not Path("r.db").exists()  # nothing was done behind the gate's back


def test_an_order_that_the_gate_refuses_is_not_tried_on_the_store(shell: Shell, token: str) -> None:
    with listening(serving({Kind.ORDER: "EXPIRED"})) as path:
        beside(path)
        assert shell.refused("mission", "activate", token, *ON, "--new")[:2] == (1, "EXPIRED")
    assert not Path("r.db").exists()


def test_no_order_goes_to_a_gate_that_cannot_prove_whose_it_is(shell: Shell, token: str) -> None:
    """Whoever may write beside the store could name a socket of his own."""
    asked: list[Any] = []

    async def liar(peer: Peer) -> None:
        await peer.welcome(signer="operator-1")
        asked.append(await peer.request())

    with listening(liar) as path:
        beside(path)
        assert shell.refused("mission", "activate", token, *ON, "--new")[:2] == (4, "ROLE_DENIED")
    assert asked == []
    assert not Path("r.db").exists()


def test_where_the_gate_went_away_the_order_is_done_on_the_store(shell: Shell, token: str) -> None:
    beside(Path("gone.sock"))
    assert shell.json("mission", "activate", token, *ON, "--new")[1]["status"] == "active"


def test_a_held_store_names_the_gate_s_socket(shell: Shell, token: str) -> None:
    beside(Path("gone.sock"))
    held = open_store(Path("r.db"))
    try:
        code, reason, message = shell.refused("mission", "activate", token, *ON, "--new")
    finally:
        held.close()
    assert (code, reason) == (5, "STORE_UNAVAILABLE")
    assert "the gate is running" in message
    assert "gone.sock" in message


@pytest.mark.parametrize("said", ["", "{", '{"socket": 1}', "\xff"])
def test_a_damaged_note_beside_the_store_is_said(shell: Shell, token: str, said: str) -> None:
    Path("r.db.gate").write_text(said, encoding="latin-1")
    code, reason, _ = shell.refused("mission", "activate", token, *ON, "--new")
    assert (code, reason) == (4, "MALFORMED")


def test_an_answer_that_is_no_standing_is_malformed(shell: Shell, token: str) -> None:
    with listening(serving({Kind.ORDER: {"standing": {"mid": 3}}})) as path:
        beside(path)
        assert shell.refused("mission", "activate", token, *ON, "--new")[:2] == (4, "MALFORMED")
