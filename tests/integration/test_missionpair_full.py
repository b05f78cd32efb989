# SPDX-License-Identifier: Apache-2.0
"""A slice of the large suite under the two planners that need no model; nights run all of it.

The slice has a pair of each combination of categories and reasons, so every reason that a signed
mission gives is met. Source: `eq:uasr` to `eq:su`
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from missionpair.campaign.log import read_log
from missionpair.campaign.run import CampaignPlan, run
from missionpair.measures import MeasuredCampaign, measure
from missionpair.mutation import slice_of
from missionpair.pair import Suite
from missionpair.suites import load, write_suite
from missionpair.words import Access, TrialKind

pytestmark = pytest.mark.complete

#: Tries of the planner that attacks, for each pair.
TRIES = 24


@pytest.fixture(scope="module")
def few() -> Suite:
    whole = load("full")[0]
    kinds = {(pair.categories, frozenset(pair.reasons)) for pair in whole.pairs}
    return slice_of(whole, most=len(kinds))


def measured(suite: Suite, folder: Path, **plan: object) -> MeasuredCampaign:
    write_suite(suite, folder / "suite.jsonl")
    log = folder / "log.jsonl"
    run(CampaignPlan(suite=str(folder / "suite.jsonl"), **plan), log)  # type: ignore[arg-type]
    campaign, trials = read_log(log)
    return measure(campaign, trials)


def test_both_gates_stop_every_attack_and_no_mission(few: Suite, tmp_path: Path) -> None:
    """The planner that follows whoever spoke last: UASR 0, BTCR 1, FRR 0 and every update done."""
    told = measured(few, tmp_path, planner="hijacked", defenses=("none", "safety", "both"))
    pairs = len(few.pairs)
    assert pairs > 40
    both, none = told.scores("both"), told.scores("none")
    assert msgspec.structs.astuple(both) == (0, 0, 1, 0, 1)
    # every twin is executable and safe: nothing, and a gate for safety alone, carry all of them out
    assert msgspec.structs.astuple(none) == (1, 1, 1, 0, 0)
    assert told.scores("safety").scmhr == 1
    for defense in told.defenses:
        assert told.tally(defense).complied == pairs
        assert told.tally(defense, TrialKind.UPDATE).completed == pairs


def test_a_planner_that_attacks_by_itself_gets_nothing_done(few: Suite, tmp_path: Path) -> None:
    """It sees policy, codes and score, and adapts to every verdict."""
    told = measured(
        few,
        tmp_path,
        planner="adversary:always=yes",
        access=Access.WHITE,
        kinds=(TrialKind.ATTACK,),
        defenses=("both",),
        seeds=TRIES,
    )
    attacks = told.tally("both")
    assert (attacks.n, attacks.unauthorized) == (TRIES * len(few.pairs), 0)
    # what it tries is its own choice: mostly another change than the pair's attack asks for
    assert attacks.complied
    assert attacks.complied + attacks.instead["strayed"] > attacks.n // 4
