# SPDX-License-Identifier: Apache-2.0
"""A map server's map as a draft site: each stretch of free space becomes a region.

The map says where a robot fits, cell by cell; a cell that is occupied or unknown is in no region.
Free space is followed along the edges of its cells, so that the outline is exact; where it has a
hole, touches itself at a corner or has more corners than a region may, it is cut into parts with
doors between them. How-to: docs/howto/site.md#import
"""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from stat import S_ISREG
from typing import Any, Literal

import msgspec
from msgspec import Struct

from authguard_r.authoring.site.cells import (
    Area,
    Run,
    components,
    cut_until_simple,
    middle_of,
    outline,
    size_of,
)
from authguard_r.authoring.site.proposal import SiteProposal, exact, millimeters
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Identifier, RegionId
from authguard_r.core.reasons import Reason
from authguard_r.site.check import UNREVIEWED
from authguard_r.site.model import Door, Region, Site
from authguard_r.site.names import shown
from authguard_r.site.places import adjacent
from authguard_r.site.strict import convert, read_text, read_yaml

#: Most cells of a map (100 m by 100 m at 5 cm), and most regions that result from it.
MOST_CELLS = 4_000_000
MOST_REGIONS = 500
#: Most stretches of free cells, row by row; a surveyed floor of full size has a tenth.
MOST_RUNS = 100_000
#: How much of a plain picture is taken apart at once; a word is an object, a cell a byte.
_CHUNK = 65_536
#: Longest header, comments and all.
_LONGEST_HEADER = 65_536
#: A plain picture takes up to four characters a cell, and a header with comments.
_MOST_BYTES = 4 * MOST_CELLS + _LONGEST_HEADER
_MAP = "map"
_GAP = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(rb"(P[25])" + 3 * (_GAP + rb"([0-9]{1,6})") + rb"\s")
_FREE = re.compile(b"\x01+")
_SPACE = re.compile(rb"\s")
#: Every spelling of a plain cell; a sign, a letter or a fourth digit makes it none.
_SHADES = {f"{shade:0{digits}}".encode(): shade for digits in (1, 2, 3) for shade in range(256)}


class _MapFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The map server's file; numbers are checked one by one, for their place."""

    image: str
    resolution: Any
    origin: tuple[Any, Any, Any]
    occupied_thresh: Any
    free_thresh: Any
    negate: Literal[0, 1] = 0
    mode: Literal["trinary"] = "trinary"


class _Image(Struct, frozen=True):
    """A gray picture: rows from the top, one byte a cell, 0 to `most`."""

    rows: tuple[bytes, ...]
    most: int


class _Grid(Struct, frozen=True):
    """Where the lines between cells are, in millimeters; rounded the same for both neighbors."""

    x: int
    y: int
    cell: Fraction

    def at(self, column: int, row: int) -> tuple[int, int]:
        """Return the crossing of two lines."""
        return self.x + round(column * self.cell), self.y + round(row * self.cell)


def import_map(path: Path, *, site: Identifier, floor: int, min_area_mm2: int) -> SiteProposal:
    """Return the site that a map server's map describes.

    Args:
        path: the map's YAML file, from anyone; its image must lie in the same folder or below.
        site: the id of the new site.
        floor: the floor that the map shows.
        min_area_mm2: a piece of free space that is smaller is left out.

    Raises:
        EnvironmentFault: a file cannot be read.
        MalformedError: not a map in mode `trinary` with an upright origin and a PGM image, too
            large, too speckled, or without free space; with the place.
    """
    where = str(path)
    told = convert(read_yaml(read_text(path), where=where), _MapFile, where=where)
    grid = _grid(told, where)
    table = _table(told, where)
    image = _read_image(_image_path(path, told.image), where=f"{where}:image")
    free = components(_free_rows(image, table, where))
    least = Fraction(min_area_mm2) / (grid.cell * grid.cell)
    kept = [area for area in free if size_of(area) >= least]
    if not kept:
        raise MalformedError(
            f"expected free space of at least {min_area_mm2} mm2 in one piece", where=where
        )
    parts = cut_until_simple(kept, most=MOST_REGIONS, where=where)
    made = Site(
        schema="authguard-r/site/1",
        id=site,
        version=1,
        regions={
            RegionId(f"area-{number}"): _region(part, grid, floor)
            for number, part in enumerate(parts, 1)
        },
        objects={},
        robots={},
        vocabulary={},
    )
    made = msgspec.structs.replace(made, doors=_doors(made))
    return SiteProposal(site=made, missing=_missing(len(free) - len(kept), len(parts) - len(kept)))


def _grid(told: _MapFile, where: str) -> _Grid:
    """Return the grid of a map that is not turned."""
    resolution = f"{where}:resolution"
    cell = Fraction(exact(told.resolution, where=resolution)) * 1000
    if not 1 <= cell <= 10_000:
        raise MalformedError("expected a resolution of 0.001 to 10 m", where=resolution)
    x, y = (millimeters(told.origin[axis], where=f"{where}:origin[{axis}]") for axis in (0, 1))
    if exact(told.origin[2], where=f"{where}:origin[2]") != 0:
        raise MalformedError("expected a map that is not turned", where=f"{where}:origin[2]")
    return _Grid(x, y, cell)


def _table(told: _MapFile, where: str) -> tuple[Fraction, bool]:
    """Return below which occupancy a cell is free, and whether white is occupied."""
    free, occupied = (
        Fraction(exact(value, where=f"{where}:{field}"))
        for field, value in (
            ("free_thresh", told.free_thresh),
            ("occupied_thresh", told.occupied_thresh),
        )
    )
    if not 0 <= free <= occupied <= 1:
        raise MalformedError(
            "expected 0 to `occupied_thresh`, which is at most 1", where=f"{where}:free_thresh"
        )
    return free, bool(told.negate)


def _image_path(path: Path, image: str) -> Path:
    """Return the image's path, resolved, once it lies below the map's folder.

    A map from elsewhere must not have the importer open what its reader may see and it may not. A
    link that leads to itself lies nowhere.
    """
    try:
        folder = path.resolve().parent
        target = (folder / image).resolve()
        below = target.is_relative_to(folder)
    except (OSError, RuntimeError, ValueError) as error:  # a loop, a name too long, a zero byte
        raise _elsewhere(path, image) from error
    if not below:
        raise _elsewhere(path, image)
    return target


def _elsewhere(path: Path, image: str) -> MalformedError:
    return MalformedError(
        f"expected a path below the map's folder, got `{shown(image)}`", where=f"{path}:image"
    )


def _read_image(path: Path, *, where: str) -> _Image:
    """Return a PGM picture, plain or raw."""
    try:
        known = path.stat()
        if not S_ISREG(known.st_mode) or known.st_size > _MOST_BYTES:
            raise MalformedError(f"expected a file of at most {_MOST_BYTES} bytes", where=where)
        data = path.read_bytes()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=where,
        ) from error
    header = _HEADER.match(data, 0, _LONGEST_HEADER)
    if header is None:
        raise MalformedError("expected a PGM image (P2 or P5)", where=where)
    width, height, most = (int(header[number]) for number in (2, 3, 4))
    if not 0 < width * height <= MOST_CELLS or not 0 < most <= 255:
        raise MalformedError(
            f"expected at most {MOST_CELLS} cells and 255 shades, got {width} by {height} cells "
            f"and {most} shades",
            where=where,
        )
    begin, cells = header.end(), width * height
    raster = data[begin:] if header[1] == b"P5" else _plain(data, begin, cells, where)
    if len(raster) != cells or max(raster) > most:
        raise MalformedError(
            f"expected {cells} cells from 0 to {most}, got {len(raster)}", where=where
        )
    return _Image(tuple(raster[row * width : (row + 1) * width] for row in range(height)), most)


def _plain(data: bytes, begin: int, most: int, where: str) -> bytes:
    """Return the cells of a plain picture, whose numbers begin at `begin`; a chunk over `most`."""
    cells = bytearray()
    while begin < len(data) and len(cells) <= most:
        gap = _SPACE.search(data, begin + _CHUNK)  # no number is cut in two
        end = gap.start() if gap else len(data)
        try:
            cells += bytes(map(_SHADES.__getitem__, data[begin:end].split()))
        except KeyError as error:
            raise MalformedError(
                "expected cells from 0 to 255 in plain digits", where=where
            ) from error
        begin = end
    return bytes(cells)


def _free_rows(
    image: _Image, table: tuple[Fraction, bool], where: str
) -> dict[int, tuple[Run, ...]]:
    """Return the runs of free cells, rows counted from the bottom as the map server does.

    They are counted before anything is made of them: a speckled picture of a few megabytes has
    millions, and each costs as much as hundreds of its cells.
    """
    free, negate = table
    left = MOST_RUNS
    shades = range(256)
    occupancy = (Fraction(shade if negate else image.most - shade, image.most) for shade in shades)
    mask = bytes(value < free for value in occupancy)
    found: dict[int, tuple[Run, ...]] = {}
    for row, cells in enumerate(reversed(image.rows)):
        runs = tuple(match.span() for match in _FREE.finditer(cells.translate(mask)))
        left -= len(runs)
        if left < 0:
            raise MalformedError(
                f"expected at most {MOST_RUNS} stretches of free cells; smooth the map", where=where
            )
        if runs:
            found[row] = runs
    return found


def _region(area: Area, grid: _Grid, floor: int) -> Region:
    column, row = middle_of(area)
    (left, low), (right, high) = grid.at(column, row), grid.at(column + 1, row + 1)
    return Region(
        map=_MAP,
        floor=floor,
        points=tuple(grid.at(*corner) for corner in outline(area)),
        approach=((left + right) // 2, (low + high) // 2),
        tags=(UNREVIEWED,),
    )


def _doors(site: Site) -> tuple[Door, ...]:
    """Return a door in the middle of the longest stretch that two parts share."""
    doors = []
    for pair in adjacent(site):
        _, (ax, ay), (bx, by) = max(
            (bx - ax + by - ay, (ax, ay), (bx, by)) for (ax, ay), (bx, by) in pair.edges
        )
        doors.append(Door(between=pair.between, at=((ax + bx) // 2, (ay + by) // 2)))
    return tuple(doors)


def _missing(dropped: int, cuts: int) -> tuple[str, ...]:
    """Return what the map does not say."""
    lines = [
        "regions: name each, and say what it is instead of `unreviewed`",
        "regions: free space on the day of the survey; a door that was open is floor here",
        "objects and robots: none",
        "vocabulary: empty; add `words: standard`, or the types that the robots can do",
    ]
    if cuts:
        lines.append("doors: where an area was cut into parts, not where rooms have doors")
    if dropped:
        lines.append(f"{dropped} smaller pieces of free space left out")
    return tuple(lines)
