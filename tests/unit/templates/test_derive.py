# SPDX-License-Identifier: Apache-2.0
"""From a draft with holes to a template: derived, and then held to what the compiler said."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from authguard_r.authoring.templates.derive import compile_template, template_bytes
from authguard_r.core.encoding import decode
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates import Template, combinations, filled
from fixtures import scenarios, templates
from fixtures.cases import case


def compiled(plain: Any) -> Template:
    return compile_template(plain, scenarios.site(), now=scenarios.NOW)


def changed(*path: Any, to: Any) -> dict[str, Any]:
    """Return the shipped draft with one thing of it replaced, or taken out."""
    plain = deepcopy(templates.draft())
    node = plain
    for step in path[:-1]:
        node = node[step]
    if to is None:
        del node[path[-1]]
    else:
        node[path[-1]] = to
    return plain


def refused(plain: Any, where: str, reason: Reason = Reason.MALFORMED) -> None:
    with pytest.raises(MalformedError) as error:
        compiled(plain)
    assert (error.value.where, error.value.reason) == (where, reason), str(error.value)


def test_the_shipped_draft_becomes_a_template_with_its_holes() -> None:
    template = compiled(templates.draft())
    assert template.mission["task"] == [
        "Carry ",
        {"hole": "package"},
        " from pharmacy to ",
        {"hole": "station"},
        ".",
    ]
    assert template.mission["objects"] == [{"hole": "package"}]
    assert template.mission["regions"][-1] == {"hole": "station"}
    assert (template.instances, template.for_ms) == (50, 1_500_000)
    assert decode(template_bytes(template)[:-1], Template) == template


def test_a_task_without_holes_is_text() -> None:
    template = compiled(changed("mission", "task", to="Carry medicine from pharmacy {As you can}."))
    assert template.mission["task"] == "Carry medicine from pharmacy {As you can}."


def test_a_guard_s_number_is_in_the_variable_s_own_unit() -> None:
    guard = {"variable": "battery_permille", "ge": {"hole": "least"}, "max_age": "2 s"}
    plain = changed("mission", "guards", to=[guard])
    plain["holes"]["least"] = {"kind": "integer", "values": [200, 300]}
    values = {
        filled(compiled(plain), fill).guards[0].value for fill in combinations(compiled(plain))
    }
    assert values == {200, 300}


def test_numbers_are_written_with_their_unit() -> None:
    plain = changed("mission", "limits", to={"speed_mm_s": ["0.05 m/s", {"hole": "speed"}]})
    plain["holes"]["speed"] = {"kind": "integer", "unit": "mm/s", "values": ["0.8 m/s", "0.5 m/s"]}
    plain["mission"]["task"] = "Carry medicine from pharmacy {as you can}."
    plain["mission"]["task"] += " Not above {speed} mm/s."
    template = compiled(plain)
    assert template.holes["speed"].values == (500, 800)  # type: ignore[index]
    text = "Carry medicine from pharmacy {as you can}. Not above "
    assert template.mission["task"] == [text, {"hole": "speed"}, " mm/s."]
    speeds = {filled(template, fill).limits[0].high for fill in combinations(template)}
    assert speeds == {500, 800}


def test_a_draft_without_holes_is_a_template_too() -> None:
    mission = {k: v for k, v in scenarios.draft().items() if k not in {"mission", "window"}}
    plain = {**templates.draft(), "holes": {}, "mission": mission}
    assert list(combinations(compiled(plain))) == [{}]


def test_an_end_may_be_said_as_an_instant() -> None:
    plain = {**changed("lasts", to=None), "not_after": "2099-01-01T00:00:00Z"}
    assert compiled(plain).not_after == "2099-01-01T00:00:00Z"
    refused({**templates.draft(), "not_after": "2099-01-01T00:00:00Z"}, "not_after")


def test_what_is_open_is_asked_about_all_at_once() -> None:
    plain = templates.draft()
    for name in ("instances", "rate", "for", "lasts"):
        del plain[name]
    with pytest.raises(ClarificationError) as asked:
        compiled(plain)
    fields = [e.field for e in (asked.value, *asked.value.others)]
    assert fields == ["instances", "rate.count", "rate.per", "for", "lasts"]


def test_what_the_mission_leaves_open_is_asked_about_as_ever() -> None:
    with pytest.raises(ClarificationError) as asked:
        compiled(changed("mission", "on_refusal", to=None))
    assert asked.value.field == "on_refusal"


REFUSED: dict[str, tuple[dict[str, Any], str, Reason]] = {
    "no template": ({}, "draft", Reason.MALFORMED),
    "an unknown field": (changed("zone", to=1), "draft", Reason.MALFORMED),
    "a hole nobody declared": (
        changed("mission", "grants", 1, "rows", 0, "object", to={"hole": "nothing"}),
        "mission.grants[1].rows[0].object",
        Reason.NAME_UNKNOWN,
    ),
    "a hole in the task that nobody declared": (
        changed("mission", "task", to="Carry {nothing}."),
        "mission.task",
        Reason.NAME_UNKNOWN,
    ),
    "a hole that stands nowhere": (
        changed("holes", "other", to={"kind": "region", "values": ["dock", "pharmacy"]}),
        "holes.other",
        Reason.SCHEMA_INVALID,
    ),
    "a hole for a tool": (
        changed("mission", "grants", 0, "tool", to={"hole": "station"}),
        "mission.actions[0].tool",
        Reason.SCHEMA_INVALID,
    ),
    "no values": (changed("holes", "station", "values", to=[]), "holes", Reason.MALFORMED),
    "too many combinations": (
        changed("holes", "station", "values", to=[f"v{n}" for n in range(4_000)]),
        "holes",
        Reason.MALFORMED,
    ),
    "a kind that there is not": (
        changed("holes", "station", "kind", to="place"),
        "",
        Reason.MALFORMED,
    ),
    "a name": (changed("mission", "mission", to="deliver"), "mission.mission", Reason.MALFORMED),
    "a window": (
        changed("mission", "window", to={"for": "1 h"}),
        "mission.window",
        Reason.MALFORMED,
    ),
    "names and numbers in one": (
        changed("holes", "station", "values", to=["station-101", 5]),
        "",
        Reason.MALFORMED,
    ),
    "a value as the site spells it": (
        changed("holes", "station", "values", to=["Station 101", "station-102"]),
        "",
        Reason.MALFORMED,
    ),
    "an end after the last year": (changed("lasts", to="90000000 h"), "lasts", Reason.MALFORMED),
    "an object as the site spells it": (
        changed("holes", "package", "values", to=["P1", "package-p2"]),
        "",
        Reason.MALFORMED,
    ),
}


def test_a_draft_that_is_no_template_is_refused() -> None:
    for what, (plain, where, reason) in REFUSED.items():
        with case(what):
            with pytest.raises(MalformedError) as error:
                compiled(plain)
            if where:
                assert where in error.value.where, str(error.value)
            assert error.value.reason is reason or not where, str(error.value)


def test_the_task_is_needed() -> None:
    with pytest.raises(ClarificationError) as asked:
        compiled(changed("mission", "task", to=None))
    assert asked.value.field == "task"
    with pytest.raises(MalformedError):
        compiled(changed("mission", to=[]))


def test_lists_that_differ_in_length_are_no_template() -> None:
    """A value that the compiler folds away would change the mission's shape."""
    plain = changed("holes", "station", "values", to=["pharmacy", "station-101"])
    with pytest.raises(MalformedError):
        compiled(plain)


def test_a_unit_that_the_mission_does_not_count_in_is_refused_where_it_shows() -> None:
    plain = changed("mission", "limits", to={"speed_mm_s": ["0.05 m/s", {"hole": "speed"}]})
    speeds = ["0.5 m/s", "0.8 m/s"]
    plain["holes"]["speed"] = {"kind": "integer", "unit": "cm/s", "values": speeds}
    refused(plain, "mission.limits[0].high")
