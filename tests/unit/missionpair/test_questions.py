# SPDX-License-Identifier: Apache-2.0
"""What a suite asks is shown, so that anybody's own model can answer it and be measured.

How-to: docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from missionpair import cli
from missionpair.campaign.log import read_log
from missionpair.campaign.plan import CampaignPlan
from missionpair.campaign.questions import questions
from missionpair.campaign.run import run
from missionpair.pair import plan_bytes
from missionpair.recorded.replies import import_replies
from missionpair.suites import load
from missionpair.words import TrialKind

KINDS = (TrialKind.ATTACK, TrialKind.CONTROL, TrialKind.BENIGN)


def test_answers_to_all_questions_of_a_suite_are_a_whole_campaign(tmp_path: Path) -> None:
    pairs = {pair.id: pair for pair in load("hand")[0].pairs}
    lines = []
    for one in questions("hand", KINDS, rounds=2):
        pair = pairs[one.pair]
        plan = pair.attack.plan if one.kind == TrialKind.ATTACK else pair.benign.plan
        steps = json.loads(plan_bytes(plan))["plan"]
        names = {tool.name for tool in one.tools}
        assert all(step["tool"] in names for step in steps)
        where = {"pair": one.pair, "kind": one.kind, "round": one.round, "inputs": one.inputs}
        lines.append(json.dumps({**where, "steps": steps}) + "\n")
    log = tmp_path / "log.jsonl"
    log.write_text("".join(lines))
    import_replies("steps", log, tmp_path / "replies.jsonl", model="mine", date="2026-11-28")
    plan = CampaignPlan(
        suite="hand",
        planner=f"recorded:file={tmp_path / 'replies.jsonl'}",
        defenses=("none", "both"),
        kinds=KINDS,
        rounds=2,
    )
    run(plan, tmp_path / "out.jsonl")
    campaign, found = read_log(tmp_path / "out.jsonl")
    trials = list(found)
    assert (campaign.skipped, campaign.pairs) == (0, len(pairs))
    assert not any(trial.error for trial in trials)
    attacks = [trial for trial in trials if trial.kind == TrialKind.ATTACK]
    assert all(trial.complied for trial in attacks)
    assert {trial.defense for trial in attacks if trial.unauthorized} == {"none"}
    assert all(trial.completed for trial in trials if trial.kind == TrialKind.BENIGN)


def ended(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str
) -> tuple[int, list[str]]:
    monkeypatch.setattr(sys, "argv", ["missionpair", "list", *words])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return int(stop.value.code or 0), capsys.readouterr().out.splitlines()


def test_the_command_prints_one_question_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, lines = ended(capsys, monkeypatch, "hand", "--kind", "attack", "--json")
    asked: list[dict[str, Any]] = [json.loads(line) for line in lines]
    assert (code, [one["pair"] for one in asked]) == (0, [p.id for p in load("hand")[0].pairs])
    assert {one["round"] for one in asked} == {0}
    assert all(one["task"] and one["tools"] and one["places"] for one in asked)
    code, lines = ended(capsys, monkeypatch, "hand", "--kind", "attack", "--rounds", "2")
    assert code == 0
    assert lines[1].startswith(f"{asked[0]['pair']}  attack  1  {asked[0]['task']}  [")
    assert ended(capsys, monkeypatch, "none-such", "--json")[0] == 2
