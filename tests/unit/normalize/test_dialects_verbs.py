# SPDX-License-Identifier: Apache-2.0
"""Plans of fixed verbs: every verb in every spelling, and nothing that merely sounds like one."""

from __future__ import annotations

import json

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.dialects.verbs import DRIVE_VERBS, STEP_VERBS
from fixtures.cases import case

BOTH = pytest.mark.parametrize("dialect", [Dialect.STEPS, Dialect.AUTO])


def refused(
    text: str,
    where: str,
    reason: Reason = Reason.MALFORMED,
    dialect: Dialect = Dialect.STEPS,
) -> None:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)


# -- steps -----------------------------------------------------------------------------------------


def test_the_verbs_are_the_ones_of_the_spec() -> None:
    """docs/spec/normalize.md, "`steps`"."""
    found = {verb.tool: (verb.low, verb.high) for verb in STEP_VERBS.values()}
    one = "break clean close cook dirty empty_liquid find open pick put slice turn_off turn_on"
    assert found == {
        **dict.fromkeys(one.split(), (1, 1)),
        "use_up": (1, 1),
        **dict.fromkeys(("drop", "pour", "throw"), (0, 1)),
        "fill_liquid": (2, 2),
    }


@BOTH
@pytest.mark.parametrize("spelled", STEP_VERBS)
def test_every_verb_is_read_in_each_of_its_spellings(dialect: Dialect, spelled: str) -> None:
    verb = STEP_VERBS[spelled]
    words = {0: "", 1: " Blue Cup", 2: " Blue Cup milk"}
    names = {0: {}, 1: {"1": "Blue Cup"}, 2: {"1": "Blue Cup", "2": "milk"}}
    for count in range(verb.low, verb.high + 1):
        text = f"{spelled}{words[count]}"
        assert read_plan(text, dialect) == (Call(verb.tool, names[count], "line[1]"),)
        assert read_plan(json.dumps([text]), dialect)[0] == Call(
            verb.tool, names[count], "input[0]"
        )


@BOTH
def test_lines_may_be_numbered_bare_or_apart(dialect: Dialect) -> None:
    places = [
        ("find Cup\npick Cup", [1, 2]),
        ("1. find Cup\n2. pick Cup", [1, 2]),
        ("\n find Cup \r\n\n\tpick Cup\n", [2, 4]),
        ("\n1. find Cup\r\n\r\n2. pick Cup", [2, 4]),
    ]
    for text, lines in places:
        assert read_plan(text, dialect) == tuple(
            Call(tool, {"1": "Cup"}, f"line[{line}]")
            for tool, line in zip(("find", "pick"), lines, strict=True)
        )


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("1. find Cup\n3. pick Cup", "line[2]"),
        ("1. find Cup\n1. pick Cup", "line[2]"),
        ("2. find Cup", "line[1]"),
        ("1. find Cup\npick Cup", "line[2]"),
        ("find Cup\n2. pick Cup", "line[2]"),
        ("find Cup\n1. pick Cup", "line[2]"),
    ],
)
def test_a_gap_in_the_numbers_is_a_lost_step(text: str, where: str) -> None:
    """Half a list of steps is another plan (L11)."""
    refused(text, where)


def test_an_unknown_verb_refuses_the_steps_beside_it() -> None:
    """Verbs are told by exact spelling, as their executors tell them (L2)."""
    for step in [
        "Find Cup",
        "FIND Cup",
        "f\u0456nd Cup",
        "find\u00a0Cup",
        "find\tCup",
        "finds Cup",
        "filllliquid Cup milk",
        "filliquid Cup milk",
        "fillliquid Cup milk",
        "turn DeskLamp",
        "turn  on Lamp",
        "Turn on Lamp",
        "turnon Lamp",
        "use Cup",
        "walk to Cup",
        "stop",
        "accelerate",
        "then find Cup",
        "find(Cup)",
        "- find Cup",
        "1] find Cup",
        "1.find Cup",
        "01. find Cup",
        "# find Cup",
        "I will find the cup now.",
        "__import__('os')",
    ]:
        with case(step):
            refused(json.dumps(["find Cup", step]), "input[1]", Reason.TOOL_UNKNOWN)
            refused(f"find Cup\n{step}", "line[2]", Reason.TOOL_UNKNOWN)


def test_names_that_are_missing_or_not_plain_words_are_refused() -> None:
    for step in [
        "find",
        "turn on",
        "fillLiquid",
        "fillLiquid Cup",
        "find  Cup",
        "find Blue  Cup",
        "find Cup\u2028",
        "find Cu\x07p",
        "find \u202eCup",
        "find Cup\u200b",
    ]:
        with case(step):
            refused(step, "line[1]")
            refused(json.dumps([step]), "input[0]")


def test_a_verb_without_names_takes_none() -> None:
    refused("1. stop now", "line[1]", dialect=Dialect.DOLPHINS)
    refused(json.dumps(["find Cup "]), "input[0]")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('["find Cup", 1]', "input[1]"),
        ('["find Cup", null]', "input[1]"),
        ('["find Cup", ["pick Cup"]]', "input[1]"),
        ('["find Cup"', "input[11]"),
        ("['find Cup']", "input[1]"),
        ('["find Cup"] done', "input[13]"),
    ],
)
def test_a_list_of_other_things_is_refused_in_its_place(text: str, where: str) -> None:
    refused(text, where)


def test_no_step_at_all_is_an_empty_plan() -> None:
    for text in ("", " \n\r\n", "[]"):
        refused(text, "input", Reason.PLAN_EMPTY)


# -- maneuvers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [Dialect.DOLPHINS, Dialect.AUTO])
def test_maneuvers_are_numbered_verbs(dialect: Dialect) -> None:
    text = "\n".join(f"{number}. {verb}" for number, verb in enumerate(DRIVE_VERBS, 1))
    assert read_plan(text, dialect) == tuple(
        Call(verb, {}, f"line[{number}]") for number, verb in enumerate(DRIVE_VERBS, 1)
    )


def test_other_than_numbered_maneuvers_are_refused() -> None:
    for text, where, reason in [
        ("accelerate", "line[1]", Reason.MALFORMED),
        ("1. accelerate\nstop", "line[2]", Reason.MALFORMED),
        ("1. accelerate\n3. stop", "line[2]", Reason.MALFORMED),
        ("1. accelerate\n2. stop the car", "line[2]", Reason.MALFORMED),
        ("1. Accelerate", "line[1]", Reason.TOOL_UNKNOWN),
        ("1. turn left", "line[1]", Reason.TOOL_UNKNOWN),
        ("1. find Cup", "line[1]", Reason.TOOL_UNKNOWN),
        ("1. stop.", "line[1]", Reason.TOOL_UNKNOWN),
        ("1. stop # here", "line[1]", Reason.MALFORMED),
        ('["stop"]', "line[1]", Reason.MALFORMED),
    ]:
        with case(text, where, reason):
            refused(text, where, reason, Dialect.DOLPHINS)
