# SPDX-License-Identifier: Apache-2.0
"""A map server's map: what is free is in a region, what is not is in none, exactly."""

from __future__ import annotations

import os
import random
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.site.nav2 import MOST_CELLS, import_map
from authguard_r.authoring.site.proposal import SiteProposal, to_yaml
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.site.check import faults, unreviewed
from authguard_r.site.model import Site
from authguard_r.site.shapes import Side, side_of
from authguard_r.site.source import parse_site
from fixtures.amount import amount
from fixtures.time_bounds import at_most

FREE, WALL, UNKNOWN = 254, 0, 205
YAML = """image: hall.pgm
resolution: 0.05
origin: [-1.0, 2.5, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def hall(width: int = 20, height: int = 10) -> list[list[int]]:
    """A free hall with a wall around it."""
    edge = {0, height - 1}
    return [
        [WALL if row in edge or column in {0, width - 1} else FREE for column in range(width)]
        for row in range(height)
    ]


def raw(cells: list[list[int]], most: int = 255) -> bytes:
    head = f"P5\n# drawn by a test\n{len(cells[0])} {len(cells)}\n{most}\n".encode()
    return head + b"".join(bytes(row) for row in cells)


def plain(cells: list[list[int]], most: int = 255) -> bytes:
    rows = "\n".join(" ".join(map(str, row)) for row in cells)
    return f"P2 {len(cells[0])} {len(cells)} {most}\n{rows}\n".encode()


def written(folder: Path, image: bytes | None, yaml: str = YAML) -> Path:
    if image is not None:
        (folder / "hall.pgm").write_bytes(image)
    path = folder / "hall.yaml"
    path.write_text(yaml, encoding="utf-8")
    return path


def imported(path: Path, least: int = 1_000) -> SiteProposal:
    return import_map(path, site="hall", floor=2, min_area_mm2=least)


def site_of(folder: Path, cells: list[list[int]], **changes: Any) -> Site:
    return imported(written(folder, raw(cells)), **changes).site


@pytest.mark.parametrize("picture", [raw, plain])
def test_a_hall_is_one_region_in_exact_millimeters(tmp_path: Path, picture: Any) -> None:
    proposal = imported(written(tmp_path, picture(hall())))
    (area,) = proposal.site.regions.values()
    assert area.points == ((-950, 2550), (-50, 2550), (-50, 2950), (-950, 2950))
    assert (area.map, area.floor, area.tags, area.names) == ("map", 2, ("unreviewed",), ())
    assert side_of(area.approach, area.points) is Side.INSIDE
    assert proposal.site.doors == ()
    assert unreviewed(proposal.site) == ("regions.area-1.tags",)
    assert parse_site(to_yaml(proposal, where="x"), where="x") == proposal.site


def test_the_first_row_of_the_picture_is_the_north_of_the_map(tmp_path: Path) -> None:
    cells = hall()
    for row in range(1, 5):
        cells[row][1:10] = [WALL] * 9
    (area,) = site_of(tmp_path, cells).regions.values()
    assert (-950, 2550) in area.points
    assert (-950, 2950) not in area.points


def test_unknown_and_occupied_cells_are_in_no_region_and_free_ones_in_one(tmp_path: Path) -> None:
    """Every cell of random maps, by its middle: the region says free where the map does."""
    dice = random.Random(5)
    for _ in range(15):
        cells = [dice.choices([FREE, WALL, UNKNOWN], [8, 1, 1], k=12) for _ in range(12)]
        site = site_of(tmp_path, cells, least=0)
        assert faults(site) == ()
        for row, line in enumerate(reversed(cells)):
            for column, shade in enumerate(line):
                middle = (-1000 + 50 * column + 25, 2500 + 50 * row + 25)
                inside = [
                    region
                    for region, model in site.regions.items()
                    if side_of(middle, model.points) is Side.INSIDE
                ]
                assert len(inside) == (shade == FREE)


def test_a_pillar_cuts_the_hall_in_parts_with_a_door_between_them(tmp_path: Path) -> None:
    cells = hall()
    cells[4][8] = cells[4][9] = cells[5][8] = cells[5][9] = WALL
    site = site_of(tmp_path, cells)
    assert set(site.regions) == {"area-1", "area-2"}
    (door,) = site.doors
    assert door.between == ("area-1", "area-2")
    assert all(side_of(door.at, model.points) is Side.EDGE for model in site.regions.values())
    assert faults(site) == ()


def test_pieces_that_are_too_small_are_left_out_and_said_so(tmp_path: Path) -> None:
    cells = hall()
    for line in cells:
        line[4] = WALL
    path = written(tmp_path, raw(cells))
    small = 3 * 8 * 50 * 50
    assert len(imported(path, small).site.regions) == 2
    proposal = imported(path, small + 1)
    assert len(proposal.site.regions) == 1
    assert any("1 smaller" in line for line in proposal.missing)
    with pytest.raises(MalformedError, match="free space"):
        imported(path, 10**9)


def test_a_resolution_that_is_no_whole_millimeter_leaves_no_gap_and_no_overlap(
    tmp_path: Path,
) -> None:
    cells = hall()
    cells[4][8] = WALL
    path = written(tmp_path, raw(cells), YAML.replace("0.05", "0.0333"))
    site = imported(path).site
    assert faults(site) == ()
    assert len(site.doors) == 1


@pytest.mark.parametrize(
    ("shade", "free"), [(254, True), (206, True), (205, False), (128, False), (0, False)]
)
def test_the_thresholds_are_the_map_server_s(tmp_path: Path, shade: int, free: bool) -> None:
    """205 of 255 is an occupancy of 0.19608: just not below 0.196, so it is unknown."""
    cells = [[shade] * 4, [FREE] * 4]
    (area,) = site_of(tmp_path, cells).regions.values()
    assert (area.points[2][1] == 2600) is free


def test_a_negated_map_has_its_free_space_dark(tmp_path: Path) -> None:
    cells = [[255 - shade for shade in row] for row in hall()]
    path = written(tmp_path, raw(cells), YAML.replace("negate: 0", "negate: 1"))
    assert len(imported(path).site.regions) == 1


def test_a_picture_with_fewer_shades_is_read_on_its_own_scale(tmp_path: Path) -> None:
    cells = [[min(shade, 1) for shade in row] for row in hall()]
    assert len(imported(written(tmp_path, raw(cells, 1))).site.regions) == 1


#: The map's file changed in one way, and where it is refused.
BROKEN = {
    "turned": ("0.0]", "0.1]", ":origin[2]"),
    "an origin of two": (", 0.0]", "]", ":origin"),
    "an origin that is a word": ("-1.0", "west", ":origin[0]"),
    "an origin that is no number": ("-1.0", ".nan", ":origin[0]"),
    "no resolution": ("resolution: 0.05\n", "", ""),
    "a resolution of zero": ("0.05", "0", ":resolution"),
    "a negative resolution": ("0.05", "-0.05", ":resolution"),
    "a resolution beyond a map's": ("0.05", "10.001", ":resolution"),
    "another mode": ("negate: 0", "negate: 0\nmode: scale", ":mode"),
    "negated twice": ("negate: 0", "negate: 2", ":negate"),
    "an unknown field": ("negate: 0", "negate: 0\nlayers: 2", ""),
    "thresholds the wrong way round": ("0.196", "0.7", ":free_thresh"),
    "a threshold below zero": ("0.196", "-0.1", ":free_thresh"),
    "a threshold above one": ("0.65", "1.5", ":free_thresh"),
    "a threshold that is a word": ("0.65", "high", ":occupied_thresh"),
    "an image elsewhere": ("hall.pgm", "../hall.pgm", ":image"),
    "an absolute image": ("hall.pgm", "/etc/passwd", ":image"),
    "an image with a zero": ("image: hall.pgm", 'image: "hall\\0.pgm"', ":image"),
    "the folder itself": ("hall.pgm", ".", ":image"),
    "no image": ("image: hall.pgm\n", "", ""),
}


@pytest.mark.parametrize(("old", "new", "where"), BROKEN.values(), ids=BROKEN)
def test_a_map_file_with_one_fault_is_refused_in_its_place(
    tmp_path: Path, old: str, new: str, where: str
) -> None:
    assert YAML.count(old) == 1
    path = written(tmp_path, raw(hall()), YAML.replace(old, new))
    with pytest.raises(MalformedError) as caught:
        imported(path)
    assert caught.value.where == f"{path}{where}"


#: Pictures that are none, or too much.
PICTURES = {
    "another format": b"\x89PNG\r\n\x1a\n",
    "colors": b"P6 2 2 255\n" + bytes(12),
    "nothing": b"",
    "a header without an end": b"P5 2 2 255",
    "a comment without an end": b"P5 # 2 2 255",
    "a side of zero": b"P5 0 2 255\n",
    "too many cells": f"P5 {MOST_CELLS} 2 255\n".encode(),
    "a side of many digits": b"P5 99999999 1 255\n",
    "no shades": b"P5 2 2 0\n" + bytes(4),
    "two bytes a cell": b"P5 2 2 65535\n" + bytes(8),
    "a cell short": b"P5 2 2 255\n" + bytes(3),
    "a cell more": b"P5 2 2 255\n" + bytes(5),
    "a shade too bright": b"P5 2 2 100\n" + bytes([0, 0, 0, 101]),
    "a plain cell short": b"P2 2 2 255\n1 2 3",
    "a plain cell too bright": b"P2 2 2 255\n1 2 3 256",
    "a plain cell of many digits": b"P2 2 2 255\n1 2 3 0004",
    "a plain cell below zero": b"P2 2 2 255\n1 2 3 -4",
    "a plain cell that is a word": b"P2 2 2 255\n1 2 3 x",
    "no free cell": b"P2 2 2 255\n0 0 0 0",
}


@pytest.mark.parametrize("picture", PICTURES.values(), ids=PICTURES)
def test_a_picture_that_is_none_is_refused(tmp_path: Path, picture: bytes) -> None:
    path = written(tmp_path, picture)
    with pytest.raises(MalformedError) as caught:
        imported(path, least=0 if not picture.startswith(b"P2 2 2 255\n0") else 1)
    assert caught.value.where.startswith(str(path))
    assert caught.value.message.isascii()


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    """The attack: a map from elsewhere whose picture is a link to a file of the importer's."""
    outside = tmp_path / "outside.pgm"
    outside.write_bytes(raw(hall()))
    folder = tmp_path / "map"
    folder.mkdir()
    (folder / "hall.pgm").symlink_to(outside)
    with pytest.raises(MalformedError) as caught:
        imported(written(folder, None))
    assert caught.value.where.endswith(":image")


def test_a_missing_picture_is_a_fault_of_the_world(tmp_path: Path) -> None:
    path = written(tmp_path, None)
    with pytest.raises(EnvironmentFault):
        imported(path)


def test_a_picture_in_a_folder_below_is_read(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "hall.pgm").write_bytes(raw(hall()))
    path = written(tmp_path, None, YAML.replace("hall.pgm", "pictures/hall.pgm"))
    assert len(imported(path).site.regions) == 1


# -- what a hostile picture may cost ---------------------------------------------------------------

SIDE = 2_000


def checkered(side: int) -> bytes:
    rows = bytes([FREE, WALL]) * (side // 2), bytes([WALL, FREE]) * (side // 2)
    return head(side) + (rows[0] + rows[1]) * (side // 2)


def combed(side: int) -> bytes:
    return head(side) + bytes([FREE, WALL]) * (side // 2 * (side - 1)) + b"\xfe" * side


def noisy(side: int) -> bytes:
    half = bytes(FREE if shade < 128 else WALL for shade in range(256))
    return head(side) + random.Random(1).randbytes(side * side).translate(half)


def just_enough(side: int) -> bytes:
    """Noise of nearly as many stretches as there may be."""
    return noisy(side * 620 // SIDE)


def teeth(side: int) -> bytes:
    """A comb of nearly as many stretches as there may be, all of one piece."""
    row = (b"\xfe" * 39 + b"\x00") * (side // 40)
    return head(side) + row * (side - 1) + b"\xfe" * side


def head(side: int, form: str = "P5") -> bytes:
    return f"{form} {side} {side} 255\n".encode()


#: Pictures within the limits of size that cost seconds or gigabytes, and what is said of each.
COSTLY: dict[str, tuple[Callable[[int], bytes], str]] = {
    "checkered": (checkered, "stretches of free cells"),
    "a comb": (combed, "stretches of free cells"),
    "noise": (noisy, "stretches of free cells"),
    "noise just below the limit": (just_enough, "regions"),
    "a comb just below the limit": (teeth, ""),
    "plain": (lambda side: head(side, "P2") + b"10 " * side**2, "free space"),
    "plain and free": (lambda side: head(side, "P2") + b"254 " * side**2, ""),
    "plain, far too many": (lambda side: head(2, "P2") + b"1 " * (2 * side**2), "4 cells"),
    "plain without a gap": (lambda side: head(side, "P2") + b"1" * (4 * side**2), "plain digits"),
    "a header of spaces": (lambda side: b"P5" + b" " * (4 * side**2), "PGM"),
    "a header of comments": (lambda side: b"P5" + b"#\n" * (2 * side**2), "PGM"),
}


@pytest.mark.complete
@pytest.mark.parametrize("name", COSTLY)
def test_a_hostile_picture_costs_little_time(tmp_path: Path, name: str) -> None:
    picture, refusal = COSTLY[name]
    path = written(tmp_path, picture(SIDE))
    with at_most(2):
        _import_or_refuse(path, refusal)


@pytest.mark.parametrize("name", COSTLY)
def test_a_hostile_picture_costs_little_memory(tmp_path: Path, name: str) -> None:
    """Measuring is slow: by default a quarter of each picture, in a quarter of the memory."""
    picture, refusal = COSTLY[name]
    side = amount(SIDE // 2, SIDE)
    path = written(tmp_path, picture(side))
    tracemalloc.start()
    try:
        _import_or_refuse(path, refusal)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= 200_000_000 * side**2 // SIDE**2


def _import_or_refuse(path: Path, refusal: str) -> None:
    if not refusal:
        assert faults(imported(path).site) == ()
        return
    with pytest.raises(MalformedError) as caught:
        imported(path)
    assert refusal in caught.value.message


def test_numbers_of_a_plain_picture_are_not_cut_where_a_chunk_ends(tmp_path: Path) -> None:
    """Every offset of a number against the chunk: what is read is what was written."""
    for gap in range(1, 6):
        cells = [[FREE] * 300 for _ in range(300)]
        rows = (b" " * gap).join(b"%d" % shade for row in cells for shade in row)
        (area,) = imported(written(tmp_path, b"P2 300 300 255\n" + rows)).site.regions.values()
        assert len(area.points) == 4


@pytest.mark.parametrize("name", ["hall.pgm", "below/hall.pgm"])
def test_a_picture_that_is_a_link_to_itself_is_refused_in_its_place(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / name.partition("/")[0]).symlink_to(name.partition("/")[0])
    with pytest.raises(MalformedError) as caught:
        imported(written(tmp_path, None, YAML.replace("hall.pgm", name)))
    assert caught.value.where.endswith(":image")


def test_a_picture_with_a_name_longer_than_any_file_s_is_refused(tmp_path: Path) -> None:
    long = "x" * (os.pathconf(tmp_path, "PC_NAME_MAX") + 1)
    with pytest.raises((MalformedError, EnvironmentFault)) as caught:
        imported(written(tmp_path, None, YAML.replace("hall.pgm", long)))
    assert caught.value.where.endswith(":image")
