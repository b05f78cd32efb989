# SPDX-License-Identifier: Apache-2.0
"""A region is a simple polygon: its edges meet only where neighbors do."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.site.check import faults
from fixtures import scenarios


def found(points: Any, approach: tuple[int, int] = (5, 5)) -> list[str]:
    site = scenarios.site()
    dock = msgspec.structs.replace(site.regions["dock"], points=points, approach=approach)
    changed = msgspec.structs.replace(site, regions={"dock": dock}, doors=())
    return [f.message for f in faults(changed) if f.where == "regions.dock.points"]


SIMPLE = [
    ((0, 0), (10, 0), (10, 10), (0, 10)),
    ((0, 0), (10, 0), (0, 10)),
    ((0, 0), (5, 0), (10, 0), (10, 10), (0, 10)),
    ((0, 0), (20, 0), (20, 20), (10, 20), (10, 10), (0, 10)),
]
CROSSED = {
    "bow tie": ((0, 0), (10, 10), (10, 2), (0, 20)),
    "pentagram": ((0, 3), (10, 3), (2, 9), (5, 0), (8, 9)),
    "a spike back along its edge": ((0, 0), (10, 0), (4, 0), (4, 10)),
    "a spike at the end": ((4, 0), (0, 0), (10, 0), (4, 10)),
    "a corner on another edge": ((0, 0), (10, 0), (10, 10), (5, 0), (0, 10)),
    "a corner twice": ((0, 0), (10, 0), (5, 5), (10, 10), (0, 10), (5, 5)),
}


@pytest.mark.parametrize("points", SIMPLE)
def test_a_simple_polygon_is_a_region(points: Any) -> None:
    assert found(points, (2, 2)) == []


@pytest.mark.parametrize("name", sorted(CROSSED))
def test_edges_that_cross_or_touch_make_no_region(name: str) -> None:
    assert found(CROSSED[name]) == ["expected edges that do not cross or touch"]
