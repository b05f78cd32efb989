# SPDX-License-Identifier: Apache-2.0
"""The first hour of a newcomer: from a tool list to a robot that is held to a signed mission.

Every step is a command as it is typed, in the order of the how-to (docs/howto/onboarding.md); what
goes on serving is a process of its own. What a test writes by hand is what a person writes by hand:
where the places are, what a tool does, and what the TODOs of a proposal ask for.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import pytest

from authguard_r.cli import call
from authguard_r.client import GateClient
from authguard_r.core.identifiers import RobotId
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, until

ROBOT = "courier-7"
LIST = {
    "tools": [
        {
            "name": "go_to",
            "description": "Drive to a named place.",
            "inputSchema": {
                "type": "object",
                "properties": {
                    "place": {"type": "string"},
                    "speed_m_s": {"type": "number"},
                    "reason": {"type": "string"},
                },
                "required": ["place"],
            },
        },
        {
            "name": "pick_up",
            "inputSchema": {
                "type": "object",
                "properties": {"item": {"type": "string"}, "force_n": {"type": "number"}},
            },
        },
        {
            "name": "put_down",
            "inputSchema": {
                "type": "object",
                "properties": {"item": {"type": "string"}, "place": {"type": "string"}},
            },
        },
        {
            "name": "run_script",
            "inputSchema": {"type": "object", "properties": {"path": {"type": "string"}}},
        },
    ]
}
#: One ordinary round, plan by plan.
ROUND: tuple[tuple[tuple[str, dict[str, Any]], ...], ...] = (
    (
        ("go_to", {"place": "Pharmacy", "speed_m_s": 0.8, "reason": "to fetch"}),
        ("pick_up", {"item": "Box A", "force_n": 10}),
    ),
    (
        ("go_to", {"place": "Ward 3", "speed_m_s": 0.5, "reason": "to bring"}),
        ("put_down", {"item": "Box A", "place": "Ward 3"}),
    ),
    (("go_to", {"place": "Dock", "speed_m_s": 0.8, "reason": "back"}),),
)
FORBIDDEN = (("run_script", {"path": "/tmp/x"}),)
TOO_FAST = (("go_to", {"place": "Pharmacy", "speed_m_s": 0.9, "reason": "hurry"}),)

#: Commands that only look, and how many others it takes: the 20 of the how-to's table, a
#: compilation that is to ask, and one more question to the doctor.
LOOKS = frozenset({"audit", "explain", "metrics", "status", "watch"})
COMMANDS = 22

#: What a person knows: where the places are, what may be carried, what the robot can do.
PLACES = """\
  dock: {map: map, floor: 0, points: [[0, 0], [2000, 0], [2000, 2000], [0, 2000]],
    approach: [1000, 1000], tags: [public], names: ["Dock"]}
  pharmacy: {map: map, floor: 0, points: [[2000, 0], [4000, 0], [4000, 2000], [2000, 2000]],
    approach: [3000, 1000], tags: [public], names: ["Pharmacy"]}
  ward-3: {map: map, floor: 0, points: [[4000, 0], [6000, 0], [6000, 2000], [4000, 2000]],
    approach: [5000, 1000], tags: [public], names: ["Ward 3"]}
doors:
  - {between: [dock, pharmacy], at: [2000, 1000]}
  - {between: [pharmacy, ward-3], at: [4000, 1000]}

objects:
  box-a: {kind: medicine, home: pharmacy, mass_g: 500, names: ["Box A"]}
"""
ABLE = {
    "home: home": "home: dock",
    "tools: {}": "tools: {navigate: [base], pick: [gripper], place: [gripper]}",
    "max_speed_mm_s: 0": "max_speed_mm_s: 1000",
    "max_force_mn: 0": "max_force_mn: 20000",
    "max_payload_g: 0": "max_payload_g: 2000",
}
#: What a person answers, by the draft path of each TODO, in the order of the proposal.
SAID = {
    "task": "Bring Box A from the Pharmacy to Ward 3 and go back to the Dock",
    "issuer": "operator-1",
    "window": "{for: 25 min}",
    "place_max_age": "1 s",
    "on_refusal": "hold",
    "grants[0].rows[0].source": "dock",
    "grants[0].rows[0].regions": "[dock, pharmacy]",
    "grants[0].rows[1].source": "pharmacy",
    "grants[0].rows[1].regions": "[pharmacy, ward-3]",
    "grants[1].rows[0].source": "pharmacy",
    "grants[1].rows[0].regions": "[pharmacy]",
    "grants[2].rows[0].source": "ward-3",
    "grants[2].rows[0].regions": "[ward-3]",
    "grants[3].rows[0].source": "ward-3",
    "grants[3].rows[0].regions": "[ward-3, pharmacy, dock]",
    **{
        f"grants[{n}].{field}": value
        for n in range(4)
        for field, value in (("chooser", "planner"), ("max", "2 min"), ("irreversible", "false"))
    },
    "budgets.rate.count": "10",
    "budgets.rate.per": "1 min",
    "budgets.motion": "10 min",
    "budgets.prompts": "0",
    "budgets.planner_stops": "3",
    "risk_policy.privacy": "10",
    "risk_policy.otherwise": "0",
    "risk_policy.tau_1": "50",
    "risk_policy.tau_2": "90",
    "risk_policy.t": "2",
    "risk_policy.roles": "[supervisor]",
    "risk_policy.valid": "1 min",
}


class Terminal:
    """A folder in which commands are typed, and counted.

    Args:
        folder: where; the working directory too.
        capsys: what they print.
    """

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self.typed: list[str] = []
        self._capsys = capsys
        self._started: list[subprocess.Popen[bytes]] = []
        self._env = {k: v for k, v in os.environ.items() if not k.startswith("COV")}

    def __call__(self, line: str, *more: str, code: int = 0) -> str:
        """Run one command to its end and return what it printed."""
        self.typed.append(line)
        self._capsys.readouterr()
        ended = call([*line.split(), *more])
        told = self._capsys.readouterr()
        said = told.out + told.err
        assert ended == code, f"{line}: {ended}\n{said}"
        assert "Traceback" not in said
        return said

    def start(self, line: str, ready: str) -> subprocess.Popen[bytes]:
        """Start a command that goes on, and wait until it says that it is ready."""
        self.typed.append(line)
        log = self.folder / f"{len(self.typed)}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                [str(AUTHGUARD), *line.split()],
                cwd=self.folder,
                env=self._env,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
            )
        self._started.append(process)

        def has_said() -> bool:
            text = log.read_text()
            assert process.poll() is None, f"{line} ended:\n{text}"
            return ready in text

        until(has_said, line)
        return process

    def end(self) -> None:
        """End what was started here, the newest first, and remove the folder."""
        for process in reversed(self._started):
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        rmtree(self.folder, ignore_errors=True)

    def edit(self, name: str, *changes: tuple[str, str]) -> None:
        """Change a file as a person does: every text that is replaced has to be there."""
        text = (self.folder / name).read_text()
        for old, new in changes:
            assert old in text, f"{name} has no `{old}`:\n{text}"
            text = text.replace(old, new)
        (self.folder / name).write_text(text)

    def ask(self, run: str, trust: str, plan: Any, **more: Any) -> list[dict[str, Any]]:
        """Propose a plan as the planner; return what became of each step."""
        calls = [{"tool": tool, "arguments": arguments} for tool, arguments in plan]
        with GateClient.connect(
            self.folder / run / "gate.sock",
            role=ClientRole.PLANNER,
            client="llm",
            verifier=read_trust(self.folder / trust),
            robot=RobotId(ROBOT),
            timeout_ms=int(PATIENCE_S * 1_000),
            **more,
        ) as planner:
            steps: list[dict[str, Any]] = planner.propose(json.dumps(calls).encode())["steps"]
            return steps


@pytest.fixture
def shell(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Terminal]:
    folder = Path(mkdtemp(prefix="ag-", dir="/tmp"))  # short enough for the paths of sockets
    monkeypatch.chdir(folder)
    terminal = Terminal(folder, capsys)
    try:
        yield terminal
    finally:
        terminal.end()


def test_from_a_tool_list_to_a_robot_that_is_held_to_its_mission(shell: Terminal) -> None:
    refuse_everything(shell)
    listen(shell)
    learn(shell)
    sign(shell)
    enforce(shell)
    commands = [line for line in shell.typed if line.split()[0] not in LOOKS]
    assert len(commands) == COMMANDS, "\n".join(commands)


def refuse_everything(shell: Terminal) -> None:
    """A set-up that the doctor finds nothing unsafe in, and that allows nothing."""
    (shell.folder / "tools.json").write_text(json.dumps(LIST))
    assert "all refused" in shell(f"init --from mcp tools.json --out cell --robot {ROBOT}")
    shell(
        "binding check cell/binding.yaml --site cell/site.yaml --interface cell/interface.yaml "
        "--strict"
    )
    shell(
        f"gate-config make --demo --mode shadow --robot {ROBOT} --trust cell/trust "
        "--out cell/gate.token"
    )
    told = shell("doctor cell")
    assert "unsafe" not in told
    assert "every field bound" in told
    assert "unreviewed" in told
    assert "can do nothing yet" in told


def listen(shell: Terminal) -> None:
    """A round on the old road: everything is refused, recorded, and marked."""
    gate = shell.start(
        "gate --demo --trust cell/trust --site cell/site.yaml --binding cell/binding.yaml "
        "--config cell/gate.token --store cell/robot.db --run cell/run",
        "SHADOW MODE",
    )
    for plan in ROUND:
        steps = shell.ask("cell/run", "cell/trust", plan, allow_shadow=True)
        assert {step["outcome"] for step in steps} == {"reject"}
        assert not any(step["executed"] for step in steps)
    assert "authguard binding check" in shell("explain --gate cell/run")
    assert "SHADOW" in shell("status --gate cell/run")
    gate.terminate()
    assert gate.wait(PATIENCE_S) == 0
    records = json.loads(shell("audit verify cell/robot.db --json"))["size"]
    assert records >= len(ROUND)


def learn(shell: Terminal) -> None:
    """A person says what is real and what the tools do; the proposals are taken by what follows."""
    shell(
        "learn cell/robot.db --site cell/site.yaml --binding cell/binding.yaml --out cell/learned"
    )
    wanted = (shell.folder / "cell/learned/site.proposed.yaml").read_text()
    assert all(f'"{name}"' in wanted for name in ("Dock", "Pharmacy", "Ward 3", "Box A"))
    text = (shell.folder / "cell/site.yaml").read_text()
    start, end = text.index("  home:\n    map"), text.index("objects: {}") + len("objects: {}\n")
    (shell.folder / "cell/site.yaml").write_text(text[:start] + PLACES + text[end:])
    shell.edit("cell/site.yaml", *ABLE.items())
    assert "sound, 3 regions, 1 objects" in shell("site check cell/site.yaml")
    shell("learn cell/robot.db --site cell/site.yaml --binding cell/binding.yaml --out cell/second")
    proposed = shell.folder / "cell/second/binding.proposed.yaml"
    assert "nearest: place if params.force_mn were fixed" in proposed.read_text()
    proposed.rename(shell.folder / "cell/mine.yaml")
    text = (shell.folder / "cell/mine.yaml").read_text()
    start, end = text.index('  "put_down":'), text.index('  "run_script":')
    place = (
        '  "put_down":\n    {type: place, tool: gripper, attested: [source], fixed: '
        "{params.force_mn: 5000},\n     arguments: {item: {use: mapped, to: object}, "
        "place: {use: mapped, to: destination}}}\n"
    )
    (shell.folder / "cell/mine.yaml").write_text(text[:start] + place + text[end:])
    shell.edit("cell/mine.yaml", ('"reason": {use: "refused"}', '"reason": {use: "noted"}'))
    shell(
        "binding check cell/mine.yaml --site cell/site.yaml --interface cell/interface.yaml "
        "--strict"
    )
    told = shell("doctor cell", code=5)
    assert "authguard keys init FOLDER --site cell/site.yaml" in told  # the profile is another now


def sign(shell: Terminal) -> None:
    """The log becomes a mission: its TODOs are answered, the lint is heeded, a person signs."""
    shell("learn cell/robot.db --site cell/site.yaml --binding cell/mine.yaml --out cell/third")
    draft = "cell/third/mission.proposed.yaml"
    told = shell(f"mission compile {draft} --site cell/site.yaml --no-input", code=3)
    page = (shell.folder / draft).read_text()
    todo = [line.split(": ")[0] for line in page.split("# TODO ")[1:]]
    assert set(todo) <= SAID.keys()
    assert all(f"(at {field})" in told for field in todo)
    guard = "    guards: [{variable: holding, eq: nothing, max_age: 1 s}]\n"
    page = page.replace('  - id: "navigate-base-home"\n', f'  - id: "navigate-base-home"\n{guard}')
    (shell.folder / draft).write_text(page)
    answers = [word for field, said in SAID.items() for word in ("--answer", f"{field}={said}")]
    shell(f"mission compile {draft} --site cell/site.yaml --no-input --out v1.json", *answers)
    assert "It grants every action type of this robot" in shell(
        "mission review v1.json --site cell/site.yaml"
    )
    shell("keys init real --site cell/site.yaml")
    shell(
        "mission sign v1.json --key real/keys/operator-1.key.pem "
        "--cert real/keys/operator-1.cert.pem --site cell/site.yaml --out v1.token --yes"
    )


def enforce(shell: Terminal) -> None:
    """The same round is carried out whole; what nobody signed for is refused, and says why."""
    shell(f"gate-config make --demo --robot {ROBOT} --trust real --out real/gate.token")
    shell(
        "doctor --trust real --site cell/site.yaml --binding cell/mine.yaml "
        "--interface cell/interface.yaml --config real/gate.token"
    )
    gate = shell.start(
        "gate --demo --trust real --site cell/site.yaml --binding cell/mine.yaml "
        "--config real/gate.token --store real/robot.db --run run",
        "serving",
    )
    shell.start(
        f"robot --robot {ROBOT} --site cell/site.yaml --trust real --run run --speed-up 8",
        "ready",
    )
    shell.start(
        f"estimator --robot {ROBOT} --trust real --run run "
        f"--key real/keys/estimator-{ROBOT}.key.pem --cert real/keys/estimator-{ROBOT}.cert.pem",
        "ready",
    )
    shell("mission activate v1.token --trust real --site cell/site.yaml --store real/robot.db")
    assert "no proposal and no emergency was refused" in shell("explain --gate run", code=1)
    for plan in ROUND:
        steps = until(lambda plan=plan: carried_out(shell, plan), str(plan))
        ended = [(step["outcome"], step["execution"]["outcome"]) for step in steps]
        assert ended == [("accept", "succeeded")] * len(plan), steps
    refused(shell)
    status = shell("status --gate run")
    assert "navigate-base (navigate): 2 of 2 starts" in status
    assert "ALERT" not in status
    metrics = shell("metrics --gate run")
    assert 'authguard_outcomes_total{kind="succeeded"} 5.0' in metrics
    gate.terminate()
    assert gate.wait(PATIENCE_S) == 0
    assert "whole" in shell("audit verify real/robot.db")


def carried_out(shell: Terminal, plan: Any) -> list[dict[str, Any]] | None:
    """Propose a plan; None when it may be tried again, for the state is not attested yet."""
    steps = shell.ask("run", "real", plan)
    waits = steps[0]["outcome"] == "reject" and steps[0]["retryable"]
    print([(step["outcome"], step["reasons"]) for step in steps])
    return None if waits else steps


def refused(shell: Terminal) -> None:
    """Whoever watches sees each refusal; `explain` says what to do, and its draft compiles."""
    watching = shell.start("watch --gate run --jsonl --role auditor --trust real", "")
    log = shell.folder / f"{len(shell.typed)}.log"
    clients = 'authguard_clients{kind="auditor"} 1.0'
    until(lambda: clients in shell("metrics --gate run"), "the watcher")
    (step,) = shell.ask("run", "real", FORBIDDEN)
    assert (step["reasons"], step["executed"]) == (["STATE_WRITING_REFUSED"], False)
    assert "say in the binding what it means" in shell("explain --gate run")
    (step,) = shell.ask("run", "real", TOO_FAST)
    assert (step["outcome"], step["executed"]) == ("reject", False)
    assert "PARAMETER_OUT_OF_BOUNDS" in step["reasons"]
    until(lambda: "PARAMETER_OUT_OF_BOUNDS" in log.read_text(), "the event")
    watching.terminate()
    watching.wait(PATIENCE_S)
    told = shell("explain --gate run")
    assert "expected 500 to 800, got 900" in told
