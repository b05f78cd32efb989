# SPDX-License-Identifier: Apache-2.0
"""Areas of a grid: connected cells, their outline, and cuts until the outline is simple.

Cells count as connected when they share an edge. An area is kept row by row as runs of columns,
so a map of millions of cells is a few thousand numbers. Nothing here knows millimeters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from msgspec import Struct

from authguard_r.core.errors import MalformedError

#: Columns from the first up to, not including, the second.
Run = tuple[int, int]
#: The crossing of two grid lines: column, row; the cell (c, r) lies above and right of it.
Corner = tuple[int, int]
#: Most corners that a region may have.
MOST_CORNERS = 256
#: How many of an area's widest runs are tried for its middle.
_TRIED = 64


class Area(Struct, frozen=True):
    """Connected cells.

    Args:
        rows: for each row that has cells, its runs in order; rows have no gap.
    """

    rows: dict[int, tuple[Run, ...]]


def size_of(area: Area) -> int:
    """Return the number of cells."""
    return sum(end - begin for runs in area.rows.values() for begin, end in runs)


def components(rows: dict[int, tuple[Run, ...]]) -> tuple[Area, ...]:
    """Return the connected areas of some cells, in the order of their lowest, leftmost cell."""
    parents: dict[tuple[int, Run], tuple[int, Run]] = {}

    def root(item: tuple[int, Run]) -> tuple[int, Run]:
        while parents[item] != item:
            parents[item] = parents[parents[item]]
            item = parents[item]
        return item

    for row in sorted(rows):
        for run in rows[row]:
            parents[row, run] = (row, run)
        for below, above in _meeting(rows.get(row - 1, ()), rows[row]):
            one, other = root((row - 1, below)), root((row, above))
            parents[max(one, other)] = min(one, other)
    found: dict[tuple[int, Run], dict[int, list[Run]]] = {}
    for row, run in sorted(parents):
        found.setdefault(root((row, run)), {}).setdefault(row, []).append(run)
    return tuple(Area({row: tuple(runs) for row, runs in area.items()}) for area in found.values())


def outline(area: Area) -> tuple[Corner, ...]:
    """Return the corners of a simple area, counterclockwise from the lowest, leftmost one."""
    return _loops(area)[0]


def cut_until_simple(areas: Iterable[Area], *, most: int, where: str) -> tuple[Area, ...]:
    """Return areas that cover the same cells, each with one outline of few corners.

    Args:
        areas: connected cells of any shape.
        most: how many areas may result from it.
        where: the place of the map, for messages.

    Raises:
        MalformedError: it would be more areas.
    """
    left, done = list(areas), list[Area]()
    while left:
        if len(left) + len(done) > most:
            raise MalformedError(
                f"expected a map of at most {most} regions; leave small areas out or smooth it",
                where=where,
            )
        area = left.pop()
        halves = _cut(area)
        if halves is None:
            done.append(area)
        else:
            left += halves
    return tuple(sorted(done, key=lambda area: min((row, runs) for row, runs in area.rows.items())))


def middle_of(area: Area) -> Corner:
    """Return a cell of the area that has much room on all four sides."""
    widest = sorted(
        (begin - end, row, begin, end) for row, runs in area.rows.items() for begin, end in runs
    )[:_TRIED]
    best = (0, 0, 0)
    for negative, row, begin, end in widest:
        column = (begin + end - 1) // 2
        room = min(-negative, 2 * _reach(area, column, row, 1), 2 * _reach(area, column, row, -1))
        best = max(best, (room, -row, -column))
    return -best[2], -best[1]


def _reach(area: Area, column: int, row: int, step: int) -> int:
    """Return how many cells of one column lie in the area from a row on."""
    count = 0
    while any(begin <= column < end for begin, end in area.rows.get(row + count * step, ())):
        count += 1
    return count


def _meeting(below: tuple[Run, ...], above: tuple[Run, ...]) -> Iterator[tuple[Run, Run]]:
    """Yield the runs of two rows that share an edge of a cell."""
    start = 0
    for run in above:
        while start < len(below) and below[start][1] <= run[0]:
            start += 1
        for number in range(start, len(below)):
            if below[number][0] >= run[1]:
                break
            yield below[number], run


def _cut(area: Area) -> tuple[Area, ...] | None:
    """Return the parts of an area that is not simple, None for one that is.

    Of several lines that improve something the one nearest to the middle is taken, so that a
    speckled map is halved again and again and not peeled line by line.
    """
    low, high = min(area.rows), max(area.rows) + 1
    lines = _pinches(area)
    loops = () if lines else _loops(area)
    lines += [min(row for _, row in loop) for loop in loops[1:]]
    if lines:
        return _at_row(area, min(lines, key=lambda line: (abs(2 * line - low - high), line)))
    if len(loops[0]) <= MOST_CORNERS:
        return None
    left = min(runs[0][0] for runs in area.rows.values())
    right = max(runs[-1][1] for runs in area.rows.values())
    if right - left > high - low:
        return _at_column(area, (left + right) // 2)
    return _at_row(area, (low + high) // 2)


def _at_row(area: Area, line: int) -> tuple[Area, ...]:
    below = {row: runs for row, runs in area.rows.items() if row < line}
    above = {row: runs for row, runs in area.rows.items() if row >= line}
    return (*components(below), *components(above))


def _at_column(area: Area, line: int) -> tuple[Area, ...]:
    left: dict[int, tuple[Run, ...]] = {}
    right: dict[int, tuple[Run, ...]] = {}
    for row, runs in area.rows.items():
        left[row] = tuple((begin, min(end, line)) for begin, end in runs if begin < line)
        right[row] = tuple((max(begin, line), end) for begin, end in runs if end > line)
    return (*components(left), *components(right))


def _pinches(area: Area) -> list[int]:
    """Return the lines on which two cells of the area meet by a corner alone."""
    found = []
    for row in sorted(area.rows):
        below, above = area.rows.get(row - 1, ()), area.rows[row]
        begins, ends = {b for b, _ in below}, {e for _, e in below}
        if any(b in ends or e in begins for b, e in above):
            found.append(row)
    return found


def _loops(area: Area) -> tuple[tuple[Corner, ...], ...]:
    """Return the outline and then the holes' outlines of an area without pinches.

    On each line the corners are where a run begins or ends on one side only. Taken in order they
    are the ends of the outline's stretches: the first and the second, the third and the fourth.
    """
    across: dict[Corner, Corner] = {}
    columns: dict[int, list[int]] = {}
    low, high = min(area.rows), max(area.rows) + 1
    for line in range(low, high + 1):
        below, above = (
            {end for run in area.rows.get(row, ()) for end in run} for row in (line - 1, line)
        )
        corners = sorted(below ^ above)
        for one, other in zip(corners[::2], corners[1::2], strict=True):
            across[one, line], across[other, line] = (other, line), (one, line)
        for column in corners:
            columns.setdefault(column, []).append(line)
    along: dict[Corner, Corner] = {}
    for column, lines in columns.items():
        for one, other in zip(lines[::2], lines[1::2], strict=True):
            along[column, one], along[column, other] = (column, other), (column, one)
    loops: list[tuple[Corner, ...]] = []
    left = dict.fromkeys(sorted(across, key=lambda corner: (corner[1], corner[0])))
    while left:
        corner = next(iter(left))
        loop: list[Corner] = []
        while corner in left:
            for here in (corner, across[corner]):
                loop.append(here)
                del left[here]
            corner = along[across[corner]]
        loops.append(tuple(loop))
    return tuple(loops)
