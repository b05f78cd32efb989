# SPDX-License-Identifier: Apache-2.0
"""What the programs print uses plain words, as their help does: every text in the source counts."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = (ROOT / "src" / "authguard_r", ROOT / "packages" / "missionpair" / "src" / "missionpair")
#: Metaphors, and pronouns in the place of the actor.
FORBIDDEN = re.compile(
    r"\b(road|house|lane|mends?|mended|desk|ring|nobody|anybody|whoever|whomever|everybody|somebody"
    r"|told|kept|seen|spoken|believed|anew|goes on|go on|put back|does not hold|any ?more"
    r"|worth nothing|becomes? of|became of|of what|of whom|speaks? of|is none|none of|whatever"
    r"|what is not|what is left|says? of (itself|themselves))\b",
    re.IGNORECASE,
)
#: Longest sentence of a message, in words.
LONGEST = 24
#: Texts of robots' worlds, of people who talk to them, and of attackers; and statements of SQL.
WORLDS = re.compile(
    r"missionpair/(attackers|campaign/showing|domains|planners|suites|variants|wording"
    r"|defenses/(judge|prompt))"
)
STATEMENT = re.compile(r"\b(SELECT|INSERT|DELETE|CREATE|UPDATE)\b")
#: Words that the drafting grammar reads.
GRAMMAR = ROOT / "src" / "authguard_r" / "authoring" / "drafting"


def texts(path: Path) -> Iterator[tuple[str, str]]:
    """Yield every text of more than one word in a module with its place, but no docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    lone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in lone:
            text = node.value
            if " " in text.strip() and not STATEMENT.search(text):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", text


def remedies() -> list[tuple[str, str]]:
    """Return what `explain` tells people to do."""
    path = ROOT / "src" / "authguard_r" / "server" / "remediation.toml"
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    return [(path.name, one["do"]) for part in ("answers", "emergency") for one in found[part]]


def every_text() -> list[tuple[str, str]]:
    """Return every text that a person can get to see."""
    modules = (path for root in SOURCES for path in sorted(root.rglob("*.py")))
    return [
        found
        for path in modules
        if not WORLDS.search(path.as_posix()) and GRAMMAR not in path.parents
        for found in texts(path)
    ]


def test_no_message_has_a_word_that_a_reader_cannot_look_up() -> None:
    found = every_text()
    assert len(found) > 4_500
    found += remedies()
    assert [(place, text) for place, text in found if FORBIDDEN.search(text)] == []


def test_the_sentences_of_messages_are_short() -> None:
    sentences = [
        (place, sentence)
        for place, text in every_text() + remedies()
        for sentence in re.split(r"[.:;?!]\s|\n", text)
        if ":Constraints[]" not in sentence  # the fields of a ROS message
    ]
    assert len(sentences) > 5_000
    assert [
        found for found in sentences if len(re.findall(r"[A-Za-z']+", found[1])) > LONGEST
    ] == []


def test_the_check_sees_a_word_in_the_middle_of_a_message(tmp_path: Path) -> None:
    """Otherwise an empty list would prove nothing."""
    module = ROOT / "src" / "authguard_r" / "cli" / "stop.py"
    seen = [text for _, text in texts(module)]
    assert any("no gate answered and no robot was reached" in text for text in seen)
    assert FORBIDDEN.search("refused, whoever asks")
    assert not FORBIDDEN.search("Record an operator's stop")
