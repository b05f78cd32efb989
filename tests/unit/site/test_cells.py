# SPDX-License-Identifier: Apache-2.0
"""Areas of a grid: whatever is cut, the same cells are covered, once, by simple outlines."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.site.cells import (
    MOST_CORNERS,
    Area,
    Run,
    components,
    cut_until_simple,
    middle_of,
    outline,
    size_of,
)
from authguard_r.core.errors import MalformedError
from authguard_r.site.shapes import Side, doubled_area, is_simple, side_of
from fixtures.amount import amount
from fixtures.cases import case

Cells = frozenset[tuple[int, int]]


def runs_of(cells: Cells) -> dict[int, tuple[Run, ...]]:
    rows: dict[int, tuple[Run, ...]] = {}
    for row in sorted({row for _, row in cells}):
        columns = sorted(column for column, r in cells if r == row)
        begins = [c for c in columns if c - 1 not in columns]
        ends = [c + 1 for c in columns if c + 1 not in columns]
        rows[row] = tuple(zip(begins, ends, strict=True))
    return rows


def cells_of(area: Area) -> Cells:
    return frozenset(
        (column, row)
        for row, runs in area.rows.items()
        for begin, end in runs
        for column in range(begin, end)
    )


def drawn(*lines: str) -> Cells:
    """Return the cells of a drawing, its last line at the bottom."""
    rows = enumerate(reversed(lines))
    return frozenset((c, r) for r, line in rows for c, mark in enumerate(line) if mark == "#")


def cut(cells: Cells, most: int = 1000) -> tuple[Area, ...]:
    return cut_until_simple(components(runs_of(cells)), most=most, where="x")


def flooded(cells: Cells) -> set[Cells]:
    """Connected cells by the plainest method there is."""
    left, found = set(cells), set()
    while left:
        area, edge = set(), [left.pop()]
        while edge:
            column, row = edge.pop()
            area.add((column, row))
            for near in (
                (column + 1, row),
                (column - 1, row),
                (column, row + 1),
                (column, row - 1),
            ):
                if near in left:
                    left.discard(near)
                    edge.append(near)
        found.add(frozenset(area))
    return found


grids = st.frozensets(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=50)


@settings(max_examples=amount(60, 300))
@given(grids)
def test_components_are_the_connected_cells(cells: Cells) -> None:
    found = components(runs_of(cells))
    assert {cells_of(area) for area in found} == flooded(cells)
    assert sum(map(size_of, found)) == len(cells)


@settings(max_examples=amount(80, 400))
@given(grids)
def test_every_cell_is_in_one_part_and_every_part_is_simple(cells: Cells) -> None:
    """No cell that is not free comes into a region by an outline drawn too far."""
    covered: list[tuple[int, int]] = []
    for part in cut(cells):
        corners = outline(part)
        assert is_simple(corners)
        assert doubled_area(corners) == 2 * size_of(part)  # counterclockwise, nothing else inside
        covered += cells_of(part)
        doubled = tuple((2 * x, 2 * y) for x, y in corners)
        inside = {
            (c, r)
            for c in range(8)
            for r in range(8)
            if side_of((2 * c + 1, 2 * r + 1), doubled) is Side.INSIDE
        }
        assert inside == cells_of(part)
        assert middle_of(part) in cells_of(part)
    assert sorted(covered) == sorted(cells)


def test_an_area_is_cut_where_it_has_a_hole_or_touches_itself() -> None:
    for cells, parts in [
        (drawn("###", "###"), 1),
        (drawn("#..", "###"), 1),
        (drawn("###", "#.#", "###"), 2),
        (drawn("#.#", ".#."), 3),
        (drawn("##.", "#.#", "###"), 2),
        (drawn(".##", "#.#", "###"), 2),
        (drawn("#####", "#.#.#", "#####", "#.#.#", "#####"), 3),
        (frozenset(), 0),
    ]:
        with case(cells, parts):
            assert len(cut(cells)) == parts


def comb(teeth: int, *, upright: bool) -> Cells:
    """A bar with teeth: two corners a side of each tooth."""
    flat = {(2 * tooth + side, 0) for tooth in range(teeth) for side in (0, 1)}
    flat |= {(2 * tooth, 1) for tooth in range(teeth)}
    return frozenset(flat if upright else {(row, column) for column, row in flat})


@pytest.mark.parametrize("upright", [True, False])
def test_an_outline_with_too_many_corners_is_cut_across_its_longer_side(upright: bool) -> None:
    assert len(cut(comb(60, upright=upright))) == 1
    parts = cut(comb(200, upright=upright))
    assert all(len(outline(part)) <= MOST_CORNERS for part in parts)
    assert len(parts) == 4
    assert sum(map(size_of, parts)) == len(comb(200, upright=upright))


def test_a_speckled_map_that_would_be_a_thousand_regions_is_refused() -> None:
    dice = random.Random(1)
    cells = frozenset((c, r) for c in range(60) for r in range(60) if dice.random() < 0.9)
    with pytest.raises(MalformedError) as caught:
        cut(cells, most=20)
    assert caught.value.where == "x"
    assert "20 regions" in caught.value.message


def test_the_middle_of_a_room_is_far_from_its_walls() -> None:
    room = drawn(*["#########"] * 9)
    assert middle_of(components(runs_of(room))[0]) == (4, 4)
    keyhole = drawn("###..", "###..", "###..", "#####")
    column, row = middle_of(components(runs_of(keyhole))[0])
    assert (column, row) in {(1, 1), (1, 2)}
