# SPDX-License-Identifier: Apache-2.0
"""A campaign on models is run again from its log alone: no model is asked, and all is the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from missionpair import attackers
from missionpair.attackers import AttackerError
from missionpair.campaign.log import read_log
from missionpair.campaign.plan import CampaignPlan
from missionpair.campaign.run import run
from missionpair.records import Trial
from missionpair.registry import OptionError, make
from missionpair.servers import SERVERS
from missionpair.words import TrialKind

KINDS = (TrialKind.ATTACK, TrialKind.CONTROL, TrialKind.NEUTRAL, TrialKind.BENIGN)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of an adaptive attacker on a model that resists, so that it writes anew."""
    path = tmp_path_factory.mktemp("replay") / "live.jsonl"
    with SERVERS["openai"]("mixed:3") as server:
        model = f"openai:model=scripted-x;base_url={server.base_url}"
        plan = CampaignPlan(
            suite="live",
            planner=model.replace(";", ","),
            attacker=f"adaptive:model={model}",
            rounds=3,
            every=15,
            kinds=KINDS,
            defenses=("none", "both"),
        )
        run(plan, path)
    return path


def again(log: Path, out: Path, *, defense: str, attacker: str) -> list[dict[str, Any]]:
    plan = CampaignPlan(
        suite="live",
        planner=f"replay:log={log},defense={defense}",
        attacker=attacker,
        rounds=3,
        every=15,
        kinds=KINDS,
        defenses=(defense,),
    )
    run(plan, out)
    return told(out, defense)


def told(log: Path, defense: str) -> list[dict[str, Any]]:
    """Return what each trial under a defense says, but for its number and what it took."""
    return [plain(trial) for trial in read_log(log)[1] if trial.defense == defense]


def plain(trial: Trial) -> dict[str, Any]:
    found: dict[str, Any] = msgspec.to_builtins(trial)
    return {k: v for k, v in found.items() if k not in {"n", "timing", "tokens", "cost_microusd"}}


@pytest.mark.parametrize("defense", ["none", "both"])
def test_a_campaign_of_an_attacker_that_asks_a_model_is_run_again_without_one(
    log: Path, tmp_path: Path, defense: str
) -> None:
    attacker = f"replay:log={log},defense={defense}"
    found = again(log, tmp_path / "again.jsonl", defense=defense, attacker=attacker)
    assert found == told(log, defense)
    rounds = [len(trial["rounds"]) for trial in found if trial["kind"] == "attack"]
    assert max(rounds) > 1  # the attacker was asked for another text
    campaign, _ = read_log(tmp_path / "again.jsonl")
    assert (campaign.attacker.name, campaign.attacker.simulated) == ("replay", True)
    assert campaign.attacker.parameters["attacker"]["name"] == "adaptive"


def test_texts_that_differ_by_defense_are_named_by_one(log: Path) -> None:
    one = attackers.make(f"replay:log={log}")
    sent = {
        d: [t["rounds"] for t in told(log, d) if t["kind"] == "attack"] for d in ("none", "both")
    }
    differ = [
        trial.seed
        for trial in read_log(log)[1]
        if trial.kind == "attack" and trial.defense == "none"
    ]
    faults = 0
    for number, seed in enumerate(differ):
        texts = {d: [one["inputs"] for one in sent[d][number]] for d in sent}
        if texts["none"] == texts["both"]:
            assert one.open(b"", seed=seed)
        else:
            faults += 1
            with pytest.raises(AttackerError, match="name one with `defense`"):
                one.open(b"", seed=seed)
    assert len(differ) == 4
    assert faults < len(differ)


def test_what_the_log_does_not_hold_is_an_error(log: Path, tmp_path: Path) -> None:
    with pytest.raises(AttackerError, match="has no attack with seed 1") as failed:
        attackers.make(f"replay:log={log}").open(b"", seed=1)
    assert (failed.value.code, failed.value.where) == ("protocol", str(log))
    broken = tmp_path / "broken.jsonl"
    broken.write_text("{}\n")
    for spec, says in (
        ("replay", "name the log"),
        (f"replay:log={log},defense=cedar", "has no defense `cedar`: none, both"),
        (f"replay:log={broken}", re.escape(str(broken))),
        (f"replay:log={tmp_path / 'none.jsonl'}", "none.jsonl"),
    ):
        with pytest.raises(OptionError, match=says):
            make(attackers, spec)
