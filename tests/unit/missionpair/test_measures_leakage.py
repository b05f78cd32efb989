# SPDX-License-Identifier: Apache-2.0
"""What knowing more is worth: the same campaign with two kinds of access, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from fixtures.campaign_records import KEPT, QWEN, REACHED, campaign, hijacked, kept, numbered
from missionpair.measures import MeasuredCampaign, MeasureError, difference, leakage, measure, wider
from missionpair.records import NamedPart


def tried(access: str, found: int, of: int, tries: int, **changes: Any) -> MeasuredCampaign:
    """Return a campaign in which so many of so many attacks got through, after so many tries."""
    rounds = (KEPT,) * (tries - 1) + (REACHED,)
    trials = [hijacked(rounds=rounds) for _ in range(found)] + [kept() for _ in range(of - found)]
    return measure(campaign(access=access, trials=of, **changes), numbered(trials))


def test_leakage_is_white_less_black_with_newcombes_interval() -> None:
    white, black = tried("white", 30, 60, 1), tried("black", 10, 60, 3)
    (leak,) = leakage(white, black)
    assert (leak.defense, leak.more, leak.less) == ("both", "white", "black")
    assert leak.gain == difference(white.tally("both").scmhr, black.tally("both").scmhr)
    assert leak.gain is not None
    assert leak.gain.value == pytest.approx(20 / 60)
    assert leak.gain.tells
    assert leak.median_rounds == (1, 3)
    assert leak.rounds is not None
    assert leak.rounds.value == -1.0  # 2 of 3 tries in the mean, and all 3: none is left out


def test_leakage_of_what_never_succeeded_is_undefined_in_tries_and_not_in_the_rate() -> None:
    (leak,) = leakage(tried("white", 0, 60, 1), tried("black", 0, 60, 1))
    assert leak.rounds is None
    assert leak.median_rounds == (None, None)
    assert leak.gain is not None
    assert leak.gain.value == 0
    assert not leak.gain.tells


@pytest.mark.parametrize(
    "changes",
    [
        {"suite_digest": "another"},
        {"planner": QWEN},
        {"attacker": NamedPart("adaptive")},
        {"rounds": 9},
        {"pairs": 3},
    ],
)
def test_campaigns_that_differ_in_more_than_access_show_no_leakage(changes: dict[str, Any]) -> None:
    with pytest.raises(MeasureError, match=next(iter(changes))):
        leakage(tried("white", 1, 2, 1, **changes), tried("black", 1, 2, 1))


def test_defenses_that_only_one_campaign_has_are_left_out() -> None:
    both = (NamedPart("none"), NamedPart("both"))
    found = leakage(tried("white", 1, 2, 1, defenses=both), tried("black", 1, 2, 1))
    assert [leak.defense for leak in found] == ["both"]


def test_white_sees_more_than_grey_and_grey_more_than_black() -> None:
    white, grey, black = (tried(access, 1, 2, 1) for access in ("white", "grey", "black"))
    assert [wider(white, grey), wider(grey, black), wider(white, black)] == [True] * 3
    assert [wider(black, white), wider(grey, grey), wider(tried("x", 1, 2, 1), black)] == [
        False
    ] * 3
