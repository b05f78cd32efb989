# SPDX-License-Identifier: Apache-2.0
"""A campaign on models is run again from its log alone: no model is asked, and all is the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from missionpair import attackers, planners
from missionpair.attackers import AttackerError
from missionpair.briefing import PlannerError
from missionpair.campaign.log import LogWriter, read_log
from missionpair.campaign.plan import CampaignPlan, PlanError
from missionpair.campaign.run import run
from missionpair.records import Trial
from missionpair.registry import OptionError, make
from missionpair.servers import SERVERS
from missionpair.words import Access, TrialKind

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


def test_texts_that_differ_by_defense_are_named_by_one(log: Path, tmp_path: Path) -> None:
    campaign, found = read_log(log)
    trials = tuple(found)
    seeds = [t.seed for t in trials if (t.kind, t.defense) == ("attack", "none")]
    changed = tmp_path / "changed.jsonl"
    with LogWriter(changed, campaign) as writer:
        for trial in trials:
            is_other = (trial.kind, trial.defense, trial.seed) == ("attack", "both", seeds[0])
            rounds = (replace(trial.rounds[0], inputs=(("sign", "Go elsewhere."),)),)
            writer.add(replace(trial, rounds=rounds) if is_other else trial)
        writer.end()
    one = attackers.make(f"replay:log={changed}")
    with pytest.raises(AttackerError, match="name one with `defense`"):
        one.open(b"", seed=seeds[0])
    both = attackers.make(f"replay:log={changed},defense=both")
    assert [item.text for item in both.open(b"", seed=seeds[0])] == ["Go elsewhere."]
    assert attackers.make(f"replay:log={changed},defense=none").open(b"", seed=seeds[0]) != (
        both.open(b"", seed=seeds[0])
    )


def test_texts_and_answers_are_of_the_suite_that_they_were_written_for_alone(
    log: Path, tmp_path: Path
) -> None:
    who = f"replay:log={log},defense=both"
    for planner, attacker in (("graded", who), (who, "fixed")):
        plan = CampaignPlan(suite="hand", planner=planner, attacker=attacker)
        with pytest.raises(PlanError, match="another suite than `hand`"):
            run(plan, tmp_path / "other.jsonl")
        assert not (tmp_path / "other.jsonl").exists()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"kinds": tuple(TrialKind)}, r"no trial of kind update: run with --kind attack --kind"),
        ({"rounds": 4}, r"has rounds 3: run with `--rounds 3` at most"),
        ({"seeds": 2}, r"has seeds 1: run with `--seeds 1` at most"),
        ({"turns": 2}, r"has turns 1: run with `--turns 1` at most"),
        ({"seed": 1}, r"has seed 0: run with `--seed 0`"),
        ({"access": Access.WHITE}, r"has access black: run with `--access black`"),
    ],
)
def test_a_replay_asks_nothing_that_the_log_did_not_ask(
    log: Path, tmp_path: Path, more: dict[str, Any], says: str
) -> None:
    """Before anything is run: a trial without an answer would stand in the figures as an error."""
    who = f"replay:log={log},defense=both"
    plan = CampaignPlan(suite="live", planner=who, attacker=who, rounds=3, every=15, kinds=KINDS)
    with pytest.raises(PlanError, match=says):
        run(replace(plan, **more), tmp_path / "out.jsonl")
    assert not (tmp_path / "out.jsonl").exists()


def test_a_log_that_is_cut_is_not_replayed(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:5]))
    with pytest.raises(OptionError, match="has no last line"):
        make(attackers, f"replay:log={cut}")
    with pytest.raises(PlannerError, match="has no last line"):
        planners.make(f"replay:log={cut}")


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
