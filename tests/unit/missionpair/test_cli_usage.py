# SPDX-License-Identifier: Apache-2.0
"""Whatever is typed wrong is one JSON object for a program, with its place, and nothing else."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typer

from fixtures import campaign_records
from fixtures.missionpair_program import told
from missionpair import cli, suites, validation
from missionpair.campaign.log import read_log
from missionpair.campaign.plan import MOST_TURNS, CampaignPlan, PlanError
from missionpair.campaign.run import run
from missionpair.registry import UnknownNameError
from missionpair.words import TrialKind

pytestmark = pytest.mark.complete

HIJACKED = ("--planner", "hijacked")
#: For every command, something that its parser minds, and where.
WRONG: dict[str, tuple[tuple[str, ...], str]] = {
    "validate": (("--without", "nosuch"), "--without"),
    "approvers": (("--gate", "g", "--trust", "t", "--as", "a", "--delay", "x"), "--delay"),
    "run": (("live", "--access", "purple"), "--access"),
    "live": (("out", "--rounds", "0"), "--rounds"),
    "list": (("hand", "--rounds", "0"), "--rounds"),
    "report": ((), "LOG..."),
    "compare": (("one",), "LOG"),
    "require": ((), "LOG..."),
    "mutate": (("live", "--most", "none"), "--most"),
    "perceive": (("live", "--out", "x", "--jobs", "0"), "--jobs"),
    "recorded": (("folder", "--jobs", "0"), "--jobs"),
    "import agentdojo": (("source",), "--out"),
    "import steps": (("log",), "--out"),
    "import openai": (("log", "--out", "/"), "--out"),
    "import mcp": (("--out", "x"), "SOURCE"),
    "import langchain": (("log", "--out", "x", "--form", "y"), ""),
}


def test_there_is_such_a_case_for_every_command() -> None:
    assert set(cli.COMMANDS) == set(WRONG)


@pytest.mark.parametrize("command", sorted(WRONG))
def test_what_a_parser_minds_is_one_object_too(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words, where = WRONG[command]
    code, found = told(capsys, monkeypatch, *command.split(), *words)
    assert (code, set(found)) == (2, {"error"})
    assert set(found["error"]) == {"code", "message", "where"}
    assert (found["error"]["code"], found["error"]["where"]) == ("USAGE", where)
    assert found["error"]["message"]


@pytest.mark.parametrize("words", [("run",), ("run", "--seed", "-1"), ("foo",), ("--all",)])
def test_what_is_no_command_or_lacks_something_is_one_object_too(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, found = told(capsys, monkeypatch, *words)
    assert (code, found["error"]["code"]) == (2, "USAGE")


def ended(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: object
) -> tuple[int, str, str]:
    """Run the program for people; return its exit code and both outputs."""
    monkeypatch.setattr(sys, "argv", ["missionpair", *map(str, words)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    output = capsys.readouterr()
    return int(stopped.value.code or 0), output.out, output.err


def test_people_are_told_on_the_other_output(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = ended(capsys, monkeypatch, "run", "live", "--access", "purple")
    assert (code, out) == (2, "")
    assert err.startswith("USAGE: --access: ")
    code, out, err = ended(capsys, monkeypatch)
    assert (code, err) == (0, "")
    assert "\n  validate " in out  # nothing typed: the help


@pytest.mark.parametrize(
    ("raised", "code", "exit_code"),
    [
        (KeyboardInterrupt(), "ABORTED", 130),
        (typer.Abort(), "ABORTED", 2),
        (PermissionError(13, "Permission denied", "/there"), "FILE_UNAVAILABLE", 5),
    ],
)
def test_an_end_from_without_is_one_object_too(
    raised: BaseException,
    code: str,
    exit_code: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(**_: Any) -> None:
        raise raised

    monkeypatch.setattr(cli, "program", lambda _: fails)
    found, said = told(capsys, monkeypatch, "list")
    assert (found, said["error"]["code"]) == (exit_code, code)


def test_checks_and_trials_are_counted_on_a_terminal_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two self-checks and one attack under three systems: five steps."""
    monkeypatch.setattr(validation, "SELF_CHECKS", validation.SELF_CHECKS[:2])
    monkeypatch.setattr(validation, "ATTACKS", validation.ATTACKS[:1])
    monkeypatch.setattr(validation, "BENIGN", ())
    code, out, err = ended(capsys, monkeypatch, "validate")
    assert (code, out.splitlines()[0], err) == (1, "self-checks: 2/2", "")  # not the paper's tables
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    code, out, err = ended(capsys, monkeypatch, "validate")
    assert (code, out.splitlines()[0]) == (1, "self-checks: 2/2")
    assert "5/5" in err


@pytest.mark.parametrize("command", [("report",), ("require",), ("compare",)])
def test_reading_a_log_shows_its_progress_on_a_terminal_alone(
    command: tuple[str], capsys: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    made = campaign_records.campaign(trials=130, kinds=("attack",))
    trials = campaign_records.numbered(campaign_records.kept() for _ in range(130))
    log = campaign_records.written(tmp_path / "log", made, trials)
    logs = (str(log),) * (2 if command == ("compare",) else 1)
    assert ended(capsys, monkeypatch, *command, *logs)[2] == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    err = ended(capsys, monkeypatch, *command, *logs)[2]
    assert ("trials" in err, "128/130" in err) == (True, True)


# what a suite says is usual for it


def test_live_has_the_papers_rounds_and_long_has_turns() -> None:
    """Source: section "Implementation and Experimental Evaluation" (at most three rounds)."""
    assert suites.usual("live") == (3, 1)
    assert suites.usual("long") == (1, MOST_TURNS)
    assert suites.usual("full:each=1") == suites.usual("nowhere.jsonl") == (1, 1)
    with pytest.raises(UnknownNameError, match="no suite is called"):
        suites.usual("nothing")


def test_a_campaign_takes_what_is_usual_or_what_it_is_told(
    few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    only = ("--pairs", "1", "--kind", "attack", "--json")
    for number, (suite, more, wanted) in enumerate(
        (
            ("live", (), (3, 1)),
            ("long", (), (1, 30)),
            (few, (), (1, 1)),
            (few, ("--rounds", "3", "--turns", "2"), (3, 2)),
        )
    ):
        log = tmp_path / str(number)
        words = ("run", suite, "--planner", "hijacked", *only[:-1], *more, "--out", log)
        code, found = told(capsys, monkeypatch, *words)
        assert (code, found["rounds"], found["turns"]) == (0, *wanted)
        campaign, _ = read_log(log)
        assert (campaign.rounds, campaign.turns) == wanted


def test_the_list_and_the_help_say_what_is_usual(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, found = told(capsys, monkeypatch, "list")
    assert found["suites"]["live"].endswith(" (rounds 3)")
    assert found["suites"]["long"].endswith(" (turns 30)")
    assert not found["suites"]["hand"].endswith(")")
    code, out, _ = ended(capsys, monkeypatch, "run", "--help")
    shown = " ".join(out.split())
    assert code == 0
    for suite in found["suites"]:
        usual = suites.usual(suite)
        assert usual.rounds == 1 or f"{usual.rounds} in `{suite}`" in shown
        assert usual.turns == 1 or f"{usual.turns} in `{suite}`" in shown


# weights


def test_weights_that_are_told_stand_in_the_log(
    few: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log, only = tmp_path / "log", ("--pairs", "1", "--kind", "attack")
    words = ("run", few, *HIJACKED, *only, "--weights", "300,300,200,150,50", "--out", log)
    assert told(capsys, monkeypatch, *words)[0] == 0
    campaign, (trial,) = read_log(log)
    assert campaign.weights == (300, 300, 200, 150, 50)
    assert 500 < trial.rounds[0].score < 800  # executable, safe, and off the mission
    code, found = told(capsys, monkeypatch, "run", few, *HIJACKED, *only, "--out", log)
    assert code == 4
    assert "another campaign (weights)" in found["error"]["message"]


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "1,1,1,1,1,1", "400,200,0,100,100", "400,-1,1,1,1", "1,1,1,1,x", "9" * 99]
)
def test_weights_are_five_whole_numbers_above_zero(
    text: str,
    few: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = tmp_path / "log"
    code, found = told(capsys, monkeypatch, "run", few, *HIJACKED, "--weights", text, "--out", log)
    assert (code, found["error"]["code"], found["error"]["where"]) == (2, "USAGE", "--weights")
    assert "five whole thousandths above zero" in found["error"]["message"]
    assert not log.exists()


# campaigns of nothing


@pytest.mark.parametrize("each", ["0", "-1", "x", "1.5", "", "00", "99999"])
def test_a_slice_of_each_cell_is_a_whole_number_from_one(
    each: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "log"
    words = ("run", f"full:each={each}", "--planner", "hijacked", "--out", log)
    code, found = told(capsys, monkeypatch, *words)
    assert (code, found["error"]["code"]) == (2, "USAGE")
    assert "expected a whole number from 1" in found["error"]["message"]
    assert not log.exists()


def test_a_campaign_of_no_trials_is_none(few: str, tmp_path: Path) -> None:
    plan = CampaignPlan(suite=few, planner="hijacked", pairs=1, kinds=(TrialKind.ATTACK,))
    for changes in ({"pairs": 0}, {"seeds": 0}, {"kinds": ()}, {"defenses": ()}):
        with pytest.raises(PlanError, match="nothing would be tried"):
            run(msgspec.structs.replace(plan, **changes), tmp_path / "log")
    assert not (tmp_path / "log").exists()
    assert run(msgspec.structs.replace(plan, every=999), tmp_path / "log").trials == 1


# what a planner is told to be


@pytest.mark.parametrize(
    ("planner", "code", "exit_code", "where"),
    [
        ("replay:log=nosuch", "LOG_INVALID", 4, "nosuch"),
        ("replay:file=nosuch", "FILE_INVALID", 4, "nosuch"),
        ("openai:model=m,base_url=notaurl", "USAGE", 2, "base_url"),
        ("anthropic:model=m,base_url=ftp://127.0.0.1", "USAGE", 2, "base_url"),
        ("qwen:base_url=notaurl", "USAGE", 2, "base_url"),
        ("openai:base_url=http://127.0.0.1:9/v1", "USAGE", 2, "model"),
        ("openai:model=m,base_url=http://127.0.0.1:9/v1,key_env=NO_KEY", "PLANNER_REFUSED", 5, ""),
    ],
)
@pytest.mark.parametrize("role", ["planner", "attacker"])
def test_what_a_planner_cannot_be_is_said_once_with_its_place(
    planner: str,
    code: str,
    exit_code: int,
    where: str,
    role: str,
    few: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("NO_KEY", raising=False)
    log = tmp_path / "log"
    words = ("run", few, "--planner", planner)
    if role == "attacker":
        words = ("run", few, *HIJACKED, "--attacker", f"adaptive:model={planner.replace(',', ';')}")
    found, said = told(capsys, monkeypatch, *words, "--out", log)
    assert (found, said["error"]["code"]) == (exit_code, code)
    assert said["error"]["where"] == (where or "key_env")
    assert "nosuch" not in said["error"]["message"]  # its place says so, once
    assert not log.exists()


def test_a_live_command_refuses_two_models_that_no_log_tells_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    spec = "openai:model=scripted-x,base_url=http://127.0.0.1:{}/v1".format
    words = ("live", out, "--planner", spec(8), "--planner", spec(9))
    code, found = told(capsys, monkeypatch, *words)
    assert (code, found["error"]["code"]) == (2, "USAGE")
    assert "two planners are `openai:scripted-x`" in found["error"]["message"]
    assert not out.exists()
