# SPDX-License-Identifier: Apache-2.0
"""A site model as an SVG map, so that the person who signs it sees the rooms and not numbers.

One panel for each floor of each map, north up, with a scale and a legend. The same site gives the
same bytes; every text is escaped; the file refers to nothing outside itself.
How-to: docs/howto/site.md
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import escape

from msgspec import Struct

from authguard_r.core.geometry import Point
from authguard_r.site.model import Region, Site

#: Fill by tag; of several tags the first here that fits, so that the most sensitive one shows.
_FILLS = {
    "hazardous": "#f4b6a8",
    "private": "#d3c1e8",
    "restricted": "#f7d9a0",
    "unreviewed": "#ffffff",
    "public": "#cfe8cf",
}
_OTHER = "#d5dde5"
_WIDTH = 960
_MARGIN = 40
_GAP = 80
#: Sizes of type; a region's name shrinks with the region, but not below what can be read.
_TITLE, _SMALL, _LEAST = 18, 11, 7
#: Lengths that a scale may show, millimeters.
_SCALES = (100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 500_000)


class _Panel(Struct, frozen=True, kw_only=True):
    """One floor of one map and where it is drawn.

    Args:
        map: the map.
        floor: the floor.
        low: the corner with the smallest coordinates, millimeters.
        high: the one with the largest.
        top: where the drawing begins, in the picture's units.
        span: millimeters that `_WIDTH` stands for, the same on every panel.
    """

    map: str
    floor: int
    low: Point
    high: Point
    top: int
    span: int

    def at(self, point: Point) -> Point:
        """Return a point of the floor in the picture's units; up is north."""
        x, y = point
        return (
            _MARGIN + (x - self.low[0]) * _WIDTH // self.span,
            self.top + (self.high[1] - y) * _WIDTH // self.span,
        )

    @property
    def height(self) -> int:
        """How high the drawing is, in the picture's units."""
        return (self.high[1] - self.low[1]) * _WIDTH // self.span


def picture(site: Site) -> str:
    """Return the map of a sound site as one SVG file's text, with a final newline."""
    panels = _panels(site)
    lines = [line for panel in panels for line in _floor(site, panel)]
    bottom = panels[-1].top + panels[-1].height + _GAP if panels else _GAP
    legend = list(_legend(bottom))
    width, height = _WIDTH + 2 * _MARGIN, bottom + _MARGIN
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif">',
        f"<title>{_safe(f'{site.id} version {site.version}')}</title>",
        f'<rect width="{width}" height="{height}" fill="#fbfbfb"/>',
    ]
    return "\n".join([*head, *lines, *legend, "</svg>"]) + "\n"


def _panels(site: Site) -> tuple[_Panel, ...]:
    """Return the floors, stacked, all on one scale."""
    boxes = []
    for map_id, floor in sorted({(m.map, m.floor) for m in site.regions.values()}):
        points = [p for m in _regions(site, map_id, floor).values() for p in m.points]
        xs, ys = [x for x, _ in points], [y for _, y in points]
        boxes.append((map_id, floor, (min(xs), min(ys)), (max(xs), max(ys))))
    span = max((high[0] - low[0] for _, _, low, high in boxes), default=1)
    panels: list[_Panel] = []
    top = _MARGIN * 2
    for map_id, floor, low, high in boxes:
        panels.append(_Panel(map=map_id, floor=floor, low=low, high=high, top=top, span=span))
        top += panels[-1].height + _GAP
    return tuple(panels)


def _regions(site: Site, map_id: str, floor: int) -> dict[str, Region]:
    """Return a floor's regions, the large before the small that may lie within them."""
    here = {r: m for r, m in site.regions.items() if (m.map, m.floor) == (map_id, floor)}
    return dict(sorted(here.items(), key=lambda item: (-_box(item[1].points), item[0])))


def _box(points: tuple[Point, ...]) -> int:
    xs, ys = [x for x, _ in points], [y for _, y in points]
    return (max(xs) - min(xs)) * (max(ys) - min(ys))


def _floor(site: Site, panel: _Panel) -> Iterator[str]:
    regions = _regions(site, panel.map, panel.floor)
    yield _text((_MARGIN, panel.top - 12), f"{panel.map}, floor {panel.floor}", _TITLE, "start")
    for region, model in regions.items():
        yield _shape(panel, region, model)
    for door in site.doors:
        if regions.keys() & {*door.between}:
            x, y = panel.at(door.at)
            fill = "#c0392b" if door.variable is not None else "#333333"
            label = " - ".join(door.between) + (f" ({door.variable})" if door.variable else "")
            yield (
                f'<rect x="{x - 4}" y="{y - 4}" width="8" height="8" fill="{fill}">'
                f"<title>{_safe(label)}</title></rect>"
            )
    for region, model in regions.items():
        yield from _label(site, panel, region, model)
    yield from _scale(panel)


def _shape(panel: _Panel, region: str, model: Region) -> str:
    corners = " ".join(f"{x},{y}" for x, y in map(panel.at, model.points))
    fill = next((color for tag, color in _FILLS.items() if tag in model.tags), _OTHER)
    told = f"{region}: {', '.join(model.tags)}; {', '.join(model.names)}"
    return (
        f'<polygon points="{corners}" fill="{fill}" stroke="#555555">'
        f"<title>{_safe(told)}</title></polygon>"
    )


def _label(site: Site, panel: _Panel, region: str, model: Region) -> Iterator[str]:
    """Yield a region's name, tags, and what is at home in it, below its approach point."""
    x, y = panel.at(model.approach)
    xs = [panel.at(point)[0] for point in model.points]
    name = model.names[0] if model.names else region
    size = max(_LEAST, min(_SMALL + 2, 2 * (max(xs) - min(xs)) // max(len(name), 1)))
    yield f'<circle cx="{x}" cy="{y}" r="2" fill="#555555"/>'
    yield _text((x, y - 6), name, size, "middle")
    yield _text((x, y + size + 2), ", ".join(model.tags), max(_LEAST, size - 3), "middle")
    robots = [f"robot {rid}" for rid, robot in site.robots.items() if robot.home == region]
    things = [item for item, thing in site.objects.items() if thing.home == region]
    for number, line in enumerate([*robots, *things]):
        below = y + (number + 2) * (size + 1) + 4
        yield _text((x, below), line, max(_LEAST, size - 3), "middle")


def _scale(panel: _Panel) -> Iterator[str]:
    """Yield a bar of a round length, about a tenth of the picture."""
    length = next((s for s in _SCALES if s * 10 >= panel.span), _SCALES[-1])
    x, y, wide = _MARGIN, panel.top + panel.height + 24, length * _WIDTH // panel.span
    yield (
        f'<path d="M{x},{y - 4}v8m0,-4h{wide}m0,-4v8" stroke="#333333" fill="none">'
        "<title>scale</title></path>"
    )
    told = f"{length // 1000} m" if length >= 1000 else f"{length} mm"
    yield _text((x + wide + 8, y + 4), told, _SMALL, "start")


def _legend(top: int) -> Iterator[str]:
    words = [*((tag, fill) for tag, fill in _FILLS.items()), ("other tags", _OTHER)]
    for number, (word, fill) in enumerate(words):
        x = _MARGIN + number * 120
        yield f'<rect x="{x}" y="{top}" width="14" height="14" fill="{fill}" stroke="#555555"/>'
        yield _text((x + 20, top + 11), word, _SMALL, "start")
    x = _MARGIN + len(words) * 120
    for number, (word, fill) in enumerate((("door", "#333333"), ("door with sensor", "#c0392b"))):
        left = x + number * 70
        yield f'<rect x="{left}" y="{top + 3}" width="8" height="8" fill="{fill}"/>'
        yield _text((left + 14, top + 11), word, _SMALL, "start")


def _text(at: Point, words: str, size: int, anchor: str) -> str:
    return (
        f'<text x="{at[0]}" y="{at[1]}" font-size="{size}" text-anchor="{anchor}" '
        f'fill="#222222">{_safe(words)}</text>'
    )


def _safe(words: str) -> str:
    """Return text that is valid XML: escaped, and without what XML cannot contain."""
    return escape("".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in words))
