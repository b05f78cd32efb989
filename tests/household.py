# SPDX-License-Identifier: Apache-2.0
"""One kitchen for one household task: a site whose things are the ones that the task names.

Independent of the grammar under test: things are found by a table of household nouns, not by the
lexicon. One region, one robot with hands, the standard words.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from authguard_r.site.check import faults
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words

#: The page that lists what does not run.
REFERENCE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "household.md"
KITCHEN = "kitchen"
ROBOT = "helper-1"
#: What a thing of the household lends itself to; the shipped profile knows these classes.
CLASSES: dict[str, str] = {
    "appliance": "AlarmClock Candle CellPhone CoffeeMachine DeskLamp Faucet FloorLamp Laptop "
    "LightSwitch ShowerHead StoveBurner StoveKnob Television Toaster",
    "container": "Box Cabinet Drawer Fridge Safe ShowerCurtain ShowerDoor Toilet",
    "item": "Apple BaseballBat BasketBall Book Bread ButterKnife CD Cloth CreditCard DishSponge "
    "Dumbbell Egg Fork HandTowel HousePlant KeyChain Knife Ladle Lettuce Newspaper Pan Pen Pencil "
    "PepperShaker Pillow Plate Plunger Potato RemoteControl SaltShaker ScrubBrush SoapBar "
    "SoapBottle Spatula Spoon SprayBottle Statue TeddyBear TennisRacket TissueBox ToiletPaper "
    "Tomato Towel Vase Watch",
    "powered-container": "Microwave",
    "surface": "ArmChair Bathtub BathtubBasin Bed Blinds CoffeeTable CounterTop Desk DiningTable "
    "Dresser Floor GarbageCan Mirror Ottoman Painting Shelf ShowerGlass SideTable Sink SinkBasin "
    "Sofa TowelHolder Window",
    "vessel": "Bottle Bowl Cup Kettle Mug Pot WateringCan WineBottle",
}
#: Other words for the same thing; what is sliced off a thing is that thing.
ALIASES: dict[str, tuple[str, ...]] = {
    "Apple": ("AppleSliced",),
    "Bread": ("BreadSliced", "Bread Slice"),
    "Fridge": ("Refrigerator",),
    "WateringCan": ("WaterContainer",),
}
_TYPES_OF_HANDS = (
    "break clean close cook dirty drop empty fill find navigate open pick place pour put_in slice "
    "throw turn_off turn_on use_up wait"
)


def things(*texts: str) -> dict[str, str]:
    """Return the household nouns that the texts name, each with its class."""
    said = " \n ".join(texts)
    return {
        noun: kind
        for kind, nouns in sorted(CLASSES.items())
        for noun in nouns.split()
        if any(_pattern(word).search(said) for word in (noun, *ALIASES.get(noun, ())))
    }


def site(*texts: str) -> Site:
    """Return a sound site with one kitchen and the things that the texts name in it."""
    found = things(*texts)
    model = convert(
        {
            "schema": "authguard-r/site/1",
            "id": "household",
            "version": 1,
            "regions": {
                KITCHEN: {
                    "map": "main",
                    "floor": 0,
                    "points": [[0, 0], [6000, 0], [6000, 5000], [0, 5000]],
                    "approach": [3000, 2500],
                    "tags": ["public"],
                    "names": ["Kitchen"],
                }
            },
            "objects": {
                identifier(noun): {
                    "kind": kind,
                    "home": KITCHEN,
                    "mass_g": 500,
                    "names": list(dict.fromkeys((noun, spaced(noun), *ALIASES.get(noun, ())))),
                }
                for noun, kind in sorted(found.items())
            },
            "robots": {
                ROBOT: {
                    "home": KITCHEN,
                    "profile": {
                        "tools": {
                            kind: ["eyes" if kind == "find" else "hand"]
                            for kind in _TYPES_OF_HANDS.split()
                        },
                        "max_speed_mm_s": 1000,
                        "max_force_mn": 40000,
                        "max_payload_g": 5000,
                    },
                }
            },
            "vocabulary": _vocabulary(),
        },
        Site,
        where="household",
    )
    assert faults(model) == ()
    return model


def identifier(noun: str) -> str:
    """Return the site's id of a household noun."""
    return noun.lower()


def spaced(noun: str) -> str:
    """Return a noun as people write it: `Desk Lamp`."""
    return " ".join(re.findall(r"[A-Z]+(?![a-z])|[A-Z][a-z]+", noun))


def sentence(task: dict[str, Any]) -> str:
    """Return what the operator says: the instruction, the plainest of several wordings."""
    told = task["instruction"]
    return (told if isinstance(told, str) else told[0]).strip()


def steps(task: dict[str, Any]) -> tuple[str, ...]:
    """Return the planner's steps, as the task has them; none for tasks without."""
    return tuple(task.get("step") or ())


def site_of(task: dict[str, Any]) -> Site:
    """Return the site for one task."""
    return site(sentence(task), *steps(task))


def tasks(folder: Path) -> list[dict[str, Any]]:
    """Return the 200 tasks in their order, each with the `file` and `line` that it stands in."""
    found = []
    for path in sorted(folder.glob("*.jsonl")):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines()):
            if line.strip():
                found.append({**json.loads(line), "file": path.stem, "line": number})
    return found


def counts(counted: Mapping[str, int]) -> str:
    """Return the line of the reference that says how many tasks ended how."""
    return (
        f"{sum(counted.values())} tasks: executed {counted['executed']}, asked {counted['asked']}, "
        f"refused {counted['refused']}."
    )


def table(rows: Iterable[tuple[str, str, list[tuple[str, tuple[str, ...]]]]]) -> str:
    """Return the reference's table.

    Args:
        rows: each task with its refused step (or nothing), and its questions as fields with
            candidates.
    """
    lines = ["| task | ending |", "|---|---|"]
    for task, refused, questions in rows:
        asked = "; ".join(f"`{field}` ({_answers(field, known)})" for field, known in questions)
        lines.append(f"| {task} | {f'refused: {refused}' if refused else f'asked: {asked}'} |")
    return "\n".join(lines) + "\n"


def _answers(field: str, known: tuple[str, ...]) -> str:
    open_ended = "a duration" if field.endswith("duration") else "say it otherwise"
    return ", ".join(known) or open_ended


@cache
def _pattern(noun: str) -> re.Pattern[str]:
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z][a-z]+", noun) or [noun]
    text = r"(?<![A-Za-z])" + r"[\s-]*".join(words) + r"(?:s|es)?(?![A-Za-z])"
    return re.compile(text, re.IGNORECASE)


@cache
def _vocabulary() -> Any:
    import msgspec

    return msgspec.to_builtins(standard_words())
