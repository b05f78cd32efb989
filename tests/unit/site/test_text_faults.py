# SPDX-License-Identifier: Apache-2.0
"""An author sees every fault of a site's text in one round, each where it is written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import yaml

from authguard_r.core.errors import MalformedError
from authguard_r.site.source import read_text, read_yaml
from authguard_r.site.text_faults import text_faults
from fixtures import scenarios

Site = dict[str, Any]


def places(*edits: Callable[[Site], object]) -> list[str]:
    site: Any = read_yaml(read_text(scenarios.HOSPITAL / "site.yaml"), where="site")
    for edit in edits:
        edit(site)
    return [fault.where for fault in text_faults(yaml.safe_dump(site), where="site")]


def test_a_text_without_a_fault_of_form_is_left_to_the_check_of_the_model() -> None:
    assert places() == []
    assert places(lambda s: s["objects"]["sharps-bin"].update(home="cellar")) == []


def test_faults_of_one_entry_of_a_part_in_it_and_of_the_model_come_together() -> None:
    found = places(
        lambda s: s["regions"]["station-101"].update(map=5, floor="one", tagz=[]),
        lambda s: s["robots"]["courier-1"]["profile"].update(max_payload=1, max_speed_mm_s="x"),
        lambda s: s["objects"]["sharps-bin"].update(home="cellar"),
    )
    assert sorted(found) == [
        "objects.sharps-bin.home",
        "regions.station-101",  # `tagz`
        "regions.station-101.floor",
        "regions.station-101.map",
        "robots.courier-1.profile",  # `max_payload`
        "robots.courier-1.profile.max_speed_mm_s",
    ]


def test_a_numbered_entry_keeps_the_number_that_it_has_in_the_text() -> None:
    found = places(
        lambda s: s["doors"][1].update(at="here"),
        lambda s: s["doors"][3].update(at="there"),
        lambda s: s["doors"][4].update(between=["office-1", "moon"]),
    )
    assert [place.partition(".")[0] for place in found] == ["doors[1]", "doors[3]", "doors[4]"]


def test_a_missing_field_is_a_fault_and_one_that_was_cut_is_none() -> None:
    assert places(lambda s: s["objects"]["package-p1"].pop("kind")) == ["objects.package-p1"]
    assert places(lambda s: s["objects"]["package-p1"].update(kind=7)) == [
        "objects.package-p1.kind"
    ]


def test_what_speaks_of_a_part_that_was_cut_only_follows() -> None:
    """Doors and homes name the region; its own fault is the one to correct."""
    assert places(lambda s: s["regions"].update({"station-101": "a room"})) == [
        "regions.station-101"
    ]


@pytest.mark.parametrize("edit", [lambda s: s.update(regions=[]), lambda s: s.pop("robots")])
def test_a_fault_outside_of_entries_is_the_only_one(edit: Callable[[Site], object]) -> None:
    with pytest.raises(MalformedError):
        places(edit, lambda s: s["objects"]["package-p1"].pop("kind"))
