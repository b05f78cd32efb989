# SPDX-License-Identifier: Apache-2.0
"""No trial is counted twice: logs that have trials in common are refused, others are added up."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import typer

from fixtures.campaign_records import GRADED, HAIKU, benign, blocked, campaign, numbered, written
from fixtures.cases import case
from missionpair import cli_report, cli_require
from missionpair.measures.apart import why_not_apart
from missionpair.records import NamedPart, Qualified, Trial

app = typer.Typer(add_completion=False)
app.command("require")(cli_require.require_command)
app.command("report")(cli_report.report_command)
app.command("compare")(cli_report.compare_command)


def call(*words: object) -> int:
    code: Any = app(args=[str(word) for word in words], standalone_mode=False)
    return int(code)


def log(path: Path, *trials: Trial, **changes: Any) -> Path:
    made = numbered(trials or (blocked(), benign(), benign(kind="update")))
    return written(path, campaign(planner=HAIKU, trials=len(made), **changes), made)


@pytest.mark.parametrize("command", ["require", "report"])
def test_a_log_counts_once_under_whatever_name(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other = log(tmp_path / "a.jsonl"), log(tmp_path / "b.jsonl", seed=1)
    copy = tmp_path / "copy.jsonl"
    shutil.copy(path, copy)
    assert call(command, path, other) == 0
    capsys.readouterr()
    for again in (path, copy, tmp_path / "." / "a.jsonl"):
        assert call(command, path, other, again, "--json") == 4
        error = json.loads(capsys.readouterr().out)["error"]
        assert (error["code"], error["where"]) == ("LOG_INVALID", str(again))
        assert f"would count twice, they are in `{path}` too" in error["message"]
        assert "another `--seed`" in error["message"]
    assert call("compare", path, path) == 0  # two columns, and no sum


def test_a_part_of_a_campaign_is_in_the_whole_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = log(tmp_path / "a.jsonl")
    part = log(tmp_path / "b.jsonl", blocked(), pairs=1, kinds=("attack",))
    assert call("require", whole, part) == 4
    assert str(part) in capsys.readouterr().err


def test_what_trials_do_not_follow_from_makes_no_others() -> None:
    for changes in [
        {},
        {"version": "1"},
        {"qualified": (Qualified(defense="both", benign=1, own=1),)},
        {"pairs": 6, "trials": 6},
        {"every": 10},
        {"seeds": 2},
        {"kinds": ("attack",)},
        {"defenses": (NamedPart("none"), NamedPart("both"))},
    ]:
        with case(changes):
            assert why_not_apart(campaign(), campaign(**changes))
            assert why_not_apart(campaign(**changes), campaign())


def test_trials_of_other_dice_or_of_something_else_are_others() -> None:
    for changes in [
        {"seed": 1},
        {"suite_digest": "another"},
        {"planner": HAIKU},
        {"planner": NamedPart(GRADED.name, simulated=True, parameters={"susceptibility": 0.5})},
        {"attacker": NamedPart("search")},
        {"access": "white"},
        {"rounds": 1},
        {"turns": 2},
        {"weights": (1, 1, 1, 1, 1)},
        {"defenses": (NamedPart("none"),)},
        {"defenses": (NamedPart("both", parameters={"other": 1}),)},
    ]:
        with case(changes):
            assert why_not_apart(campaign(), campaign(**changes)) == ""


def test_kinds_that_no_other_log_has_are_others() -> None:
    attacks, rest = campaign(kinds=("attack",)), campaign(kinds=("benign", "update"))
    assert why_not_apart(attacks, rest) == ""
    nothing = campaign(kinds=())
    assert why_not_apart(nothing, nothing)
