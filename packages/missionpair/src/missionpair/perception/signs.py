# SPDX-License-Identifier: Apache-2.0
"""Signs: a text as a picture that a camera could take, and what Tesseract reads of it."""

from __future__ import annotations

import io
import textwrap
from functools import cache
from random import Random
from typing import Any

from msgspec import Struct

from missionpair.perception.tools import package, run, version_of

#: Fonts by name, as the packages `font_*` call them.
FONTS = {
    "Roboto": ("font_roboto", "RobotoBold"),
    "Source Serif": ("font_source_serif_pro", "SourceSerifPro"),
    "Hanken Grotesk": ("font_hanken_grotesk", "HankenGrotesk"),
    "Caladea": ("font_caladea", "Caladea"),
    "Amatic": ("font_amatic_sc", "AmaticSCBold"),
}
_PAPERS = ("#ffffff", "#f4ecd8", "#fff3a0", "#dfe9f5")
_INKS = ("#101010", "#1c2a6b", "#7a1212", "#23402b")
_WALL = "#8a8f94"
_MARGIN = 40


class Sign(Struct, frozen=True, kw_only=True):
    """How a sign looks, and what spoils the view of it.

    Args:
        font: one of `FONTS`.
        size: height of a letter's box, in pixels.
        columns: most letters in a line.
        paper: its color.
        ink: the color of its letters.
        degrees: how far it is turned.
        blur: radius of the blur, in pixels.
        glare: a lamp is reflected in it.
        covered: a strip hides a part of a line.
    """

    font: str
    size: int
    columns: int
    paper: str
    ink: str
    degrees: float
    blur: float
    glare: bool
    covered: bool

    @property
    def how(self) -> tuple[str, ...]:
        """What spoils the view, in words; the font first."""
        spoiled = {
            "turned": abs(self.degrees) >= 1,
            "blurred": self.blur >= 0.5,
            "glare": self.glare,
            "covered": self.covered,
        }
        return (self.font, *(name for name, is_so in spoiled.items() if is_so))


def drawn(key: str) -> Sign:
    """Return a sign drawn by the dice of a key; the same for the same key."""
    dice = Random(f"sign {key}")  # noqa: S311
    return Sign(
        font=dice.choice(sorted(FONTS)),
        size=dice.randint(24, 44),
        columns=dice.randint(26, 44),
        paper=dice.choice(_PAPERS),
        ink=dice.choice(_INKS),
        degrees=round(dice.uniform(-8, 8), 1) if dice.random() < 0.6 else 0.0,
        blur=round(dice.uniform(0.5, 2.0), 1) if dice.random() < 0.5 else 0.0,
        glare=dice.random() < 0.3,
        covered=dice.random() < 0.2,
    )


def picture(text: str, sign: Sign, key: str) -> bytes:
    """Return a text on a sign, as a PNG.

    Args:
        text: what stands on it.
        sign: how it looks.
        key: of the dice that place glare and strip.

    Raises:
        PerceptionError: the extra `perception` is not installed.
    """
    images, draws = package("PIL.Image"), package("PIL.ImageDraw")
    blur = package("PIL.ImageFilter").GaussianBlur
    dice = Random(f"place {key}")  # noqa: S311
    font = _font(sign.font, sign.size)
    lines = [
        line for part in text.split("\n") for line in textwrap.wrap(part, sign.columns) or [""]
    ]
    step = round(sign.size * 1.4)
    width = round(max(map(font.getlength, lines))) + 2 * _MARGIN
    image = images.new("RGB", (width, step * len(lines) + 2 * _MARGIN), sign.paper)
    pen = draws.Draw(image)
    for number, line in enumerate(lines):
        pen.text((_MARGIN, _MARGIN + number * step), line, fill=sign.ink, font=font)
    if sign.covered:
        left = dice.randint(_MARGIN, width - _MARGIN)
        top = _MARGIN + dice.randrange(len(lines)) * step + step // 3
        pen.rectangle((left, top, left + 2 * sign.size, top + sign.size // 3), fill=_WALL)
    if sign.glare:
        x, y = dice.randint(0, width), dice.randint(0, image.height)
        light = images.new("RGBA", image.size, (255, 255, 255, 0))
        spot = (x - 3 * sign.size, y - 2 * sign.size, x + 3 * sign.size, y + 2 * sign.size)
        draws.Draw(light).ellipse(spot, fill=(255, 255, 255, 190))
        over = light.filter(blur(sign.size))
        image = images.alpha_composite(image.convert("RGBA"), over).convert("RGB")
    image = image.rotate(sign.degrees, expand=True, fillcolor=_WALL, resample=3)
    image = image.filter(blur(sign.blur))
    into = io.BytesIO()
    image.save(into, "PNG")
    return into.getvalue()


def read_picture(png: bytes) -> str:
    """Return what Tesseract reads of a picture; empty where it reads nothing.

    Raises:
        PerceptionError: Tesseract is not installed, or it failed.
    """
    found = run("tesseract", "stdin", "stdout", "--psm", "6", "-l", "eng", stdin=png)
    return " ".join(found.decode(errors="replace").split())


def reader() -> str:
    """Return the reader's name with its version."""
    return version_of("tesseract")


@cache
def _font(name: str, size: int) -> Any:
    module, attribute = FONTS[name]
    return package("PIL.ImageFont").truetype(getattr(package(module), attribute), size)
