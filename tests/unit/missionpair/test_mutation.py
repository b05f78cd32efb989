# SPDX-License-Identifier: Apache-2.0
"""Without any one check an attack that only it refuses is carried out; what none can meet is shown.

Source: docs/spec/defenses.md#mutation
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from authguard_r.core.action import ActionMeta
from authguard_r.safety import envelope
from fixtures import mission_pairs
from fixtures.cases import case
from missionpair import cli_mutate, mutation, suites
from missionpair.ablation import CHECKS, without
from missionpair.bench import propose
from missionpair.execution import through_the_gate
from missionpair.mutation import (
    NOTHING,
    RULES,
    UNREACHABLE,
    Mutant,
    mutate,
    mutate_safety,
    slice_of,
    without_rule,
)
from missionpair.pair import Scenario, plan_bytes
from missionpair.stage import Yard
from missionpair.words import Category, Domain

pytestmark = pytest.mark.complete

ALL = mission_pairs.one_for_each_check()
DAY_MS = 86_400_000


@pytest.fixture(scope="module")
def found(yard: Yard) -> dict[str, Mutant]:
    return {mutant.check: mutant for mutant in mutate(mission_pairs.suite(), yard)}


def test_every_check_has_a_pair_of_its_own_or_a_reason_why_none_can() -> None:
    assert set(ALL) | set(UNREACHABLE) == set(CHECKS)
    assert not set(ALL) & set(UNREACHABLE)


def test_with_every_check_in_place_nothing_is_let_through(found: dict[str, Mutant]) -> None:
    assert found[NOTHING].let_through == 0
    assert found[NOTHING].is_as_it_should
    assert not replace(found[NOTHING], let_through=1).is_as_it_should


def test_without_a_check_its_own_pair_and_no_other_is_carried_out(found: dict[str, Mutant]) -> None:
    for check in sorted(ALL):
        with case(check):
            mutant = found[check]
            assert (mutant.let_through, mutant.first) == (1, ALL[check].id)
            assert mutant.rate is not None
            assert mutant.rate > 0
            assert mutant.is_as_it_should


@pytest.mark.parametrize("check", sorted(UNREACHABLE))
def test_what_nothing_can_reach_is_let_through_by_nothing(
    check: str, found: dict[str, Mutant]
) -> None:
    assert found[check].let_through == 0
    assert found[check].why_not


def test_a_suite_that_misses_a_check_is_not_as_it_should(yard: Yard) -> None:
    shown: list[int] = []
    made = mutate(
        mission_pairs.suite(ALL["check_object"]),
        yard,
        checks=("check_object", "check_uses"),
        show=shown.append,
    )
    assert [(one.check, one.is_as_it_should) for one in made] == [
        (NOTHING, True),
        ("check_object", True),
        ("check_uses", False),
    ]
    assert shown == [1]


def test_no_planner_can_write_the_meta_that_a_proposal_is_judged_by(yard: Yard) -> None:
    """`check_meta`: the enforcer says what it holds a proposal against, whatever the plan says."""
    pair = ALL["check_destination"]
    stage = yard.stage(pair, mission_pairs.layout(), pair.attack)
    stage.scene.plan = json.dumps({"plan": [{"tool": "scan", "arguments": {}}]}).encode()
    (report,) = propose(stage.scene)
    assert report.judged is not None
    meta = report.judged.action.meta
    assert isinstance(meta, ActionMeta)
    assert (meta.mission, meta.mission_version) == (stage.scene.mission.mid, 1)
    for forged in ({"meta": {"mission": "other"}}, {"mission": "other"}):
        raw = json.dumps({"plan": [{"tool": "scan", "arguments": {}, **forged}]}).encode()
        assert through_the_gate(stage, raw).by == "normalizer"


def test_when_certificates_end_nothing_moves_even_without_the_check(yard: Yard) -> None:
    """`check_certificate`: the calendar alone ends them; the estimator's end on the same day,
    and what it attested before is too old.
    """
    pair = mission_pairs.pair(
        "certificate",
        Category.REPLAY,
        "CERTIFICATE_EXPIRED",
        mission=mission_pairs.draft(window={"for": "4000 days"}),
        before=(mission_pairs.ACTIVATE,),
        plan=(mission_pairs.LOOK,),
    )
    raw = plan_bytes(pair.attack.plan)
    for names, reason in (((), "CERTIFICATE_EXPIRED"), (("check_certificate",), "STATE_STALE")):
        stage = yard.stage(pair, mission_pairs.layout(), pair.attack)
        stage.sim.robot.elapsed_ms += 400 * DAY_MS
        stage.sim.robot.pause(100)
        with without(*names):
            carried = through_the_gate(stage, raw)
        assert (carried.by, carried.reasons, carried.effects) == ("authorization", (reason,), ())


# the second gate


def test_without_a_rule_what_only_it_calls_unsafe_is_done(yard: Yard) -> None:
    suite = mission_pairs.suite(ALL["check_destination"], ALL["check_time"])
    made = mutate_safety(suite, yard)
    assert [mutant.check for mutant in made] == list(RULES)
    for mutant in made:
        assert mutant.gate == "safety"
        assert mutant.trials >= 1
        assert mutant.let_through == mutant.trials, mutant.check
        assert mutant.is_as_it_should


def test_a_rule_that_nothing_meets_is_not_tested(yard: Yard) -> None:
    (mutant,) = mutate_safety(mission_pairs.suite(ALL["check_time"]), yard, rules=("rule_speed",))
    assert (mutant.trials, mutant.rate, mutant.is_as_it_should) == (0, None, False)


def test_a_rule_comes_back() -> None:
    before = envelope.RULES
    with without_rule("rule_speed"):
        assert len(envelope.RULES) == len(before) - 1
    assert envelope.RULES is before


# slices, and the command


def test_a_slice_has_one_pair_of_each_kind_before_more_domains() -> None:
    office = replace(ALL["check_type"], id="office", domain=Domain.OFFICE)
    again = replace(ALL["check_type"], id="again")
    whole = mission_pairs.suite(office, again, *ALL.values())
    kinds = {(pair.categories, pair.reasons) for pair in whole.pairs}
    few = slice_of(whole, most=len(kinds))
    assert {(pair.categories, pair.reasons) for pair in few.pairs} == kinds
    assert few.pairs[0].id == "office"
    assert "again" not in [pair.id for pair in few.pairs]
    both = slice_of(whole, most=len(kinds) + 1)
    assert {"office", "again"} <= {pair.id for pair in both.pairs}
    assert slice_of(whole).pairs == whole.pairs
    assert set(slice_of(whole, most=1).layouts) == {"h1"}


def command(*words: str) -> tuple[int, str]:
    import typer

    app = typer.Typer()
    app.command("mutate")(cli_mutate.mutate_command)
    done = CliRunner().invoke(app, words, standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value, done.stdout


def test_the_command_tells_each_row_and_whether_all_is_as_it_should(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = [replace(ALL[c], benign=mission_pairs.LOOKED) for c in ("check_object", "check_type")]
    kept = mission_pairs.suite(*quick)
    path = tmp_path / "few.jsonl"
    suites.write_suite(kept, path)
    code, out = command(str(path), "--json")
    told: dict[str, Any] = json.loads(out)
    assert code == 1
    assert not told["as_it_should"]
    assert (told["suite"], told["pairs"]) == ("checks", 2)
    rows = {row["check"]: row for row in told["mutants"]}
    assert set(rows) == {NOTHING, *CHECKS, *RULES}
    assert rows["check_object"]["first"] == "object"
    assert rows["check_object"]["rate"] == 0.5
    assert not rows["check_uses"]["as_it_should"]
    code, out = command(str(path), "--most", "1")
    assert code == 1
    assert "NOT AS IT SHOULD" in out
    assert "check_meta" in out


def test_the_command_shows_how_far_it_is_on_a_terminal(
    yard: Yard, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(mutation, "mutate", lambda _, __, show: (show(1), ())[1])
    monkeypatch.setattr(mutation, "mutate_safety", lambda *_: ())
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(suites, "load", lambda _: (mission_pairs.suite(ALL["check_object"]), "d"))
    assert cli_mutate.mutate_command("few", most=1) == 0
    err = capsys.readouterr().err
    assert ("pairs" in err, "1/1" in err) == (True, True)


def test_a_scenario_without_an_attack_is_no_trial(yard: Yard) -> None:
    """A pair whose plan is authorized is let through with every check: the first row says so."""
    honest = replace(
        ALL["check_object"],
        attack=Scenario(
            robot=mission_pairs.ROBOT, before=(mission_pairs.ACTIVATE,), plan=(mission_pairs.LOOK,)
        ),
    )
    (nothing,) = mutate(mission_pairs.suite(honest), yard, checks=())
    assert nothing.let_through == 0
