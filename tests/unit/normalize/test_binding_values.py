# SPDX-License-Identifier: Apache-2.0
"""Values that nobody proposes are held to what the site says they can be."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.binding import load_binding
from fixtures import scenarios
from fixtures.cases import case

TOOL = {
    "type": "navigate",
    "tool": "base",
    "attested": ["source"],
    "arguments": {"to": {"use": "mapped", "to": "destination"}},
    "fixed": {"params.speed_mm_s": 500},
}


def load(name: str = "go", **changes: Any) -> Any:
    plain = {**msgspec.to_builtins(scenarios.binding()), "tools": {name: {**TOOL, **changes}}}
    return load_binding(plain, site=scenarios.site(), where="binding")


def argument(**changes: Any) -> dict[str, Any]:
    speed = {"use": "mapped", "to": "params.speed_mm_s", "optional": True, **changes}
    return {"arguments": {**TOOL["arguments"], "speed": speed}, "fixed": {}}


def test_the_unchanged_binding_is_sound() -> None:
    assert load().tools["go"].fixed == {"params.speed_mm_s": 500}
    assert load(**argument(default=3_000)).tools["go"].arguments["speed"].default == 3_000


def test_a_value_that_cannot_be_is_refused_with_its_place() -> None:
    for changes, place in [
        ({"fixed": {"params.speed_mm_s": 3_001}}, "fixed.params.speed_mm_s"),
        ({"fixed": {"params.speed_mm_s": 0}}, "fixed.params.speed_mm_s"),
        ({"fixed": {"params.speed_mm_s": "lots"}}, "fixed.params.speed_mm_s"),
        ({"fixed": {"params.nothing": 1}}, "fixed.params.nothing"),
        ({"fixed": {"params.speed_mm_s": 1, "route": "moon"}}, "fixed.route"),
        (argument(default=-5), "arguments.speed.default"),
        (argument(default=3_001), "arguments.speed.default"),
        (argument(per_unit="0"), "arguments.speed.per_unit"),
        (argument(per_unit="1/0"), "arguments.speed.per_unit"),
        (argument(per_unit="many"), "arguments.speed.per_unit"),
        (argument(per_unit="1" * 21), "arguments.speed.per_unit"),
    ]:
        with case(changes, place):
            with pytest.raises(MalformedError) as refused:
                load(**changes)
            assert refused.value.where == f"tools.go.{place}"


def test_a_fixed_object_is_one_of_the_site() -> None:
    pick = {
        "type": "pick",
        "arguments": {},
        "fixed": {"params.force_mn": 1, "object": "package-p1"},
    }
    assert load(**pick).tools["go"].fixed["object"] == "package-p1"
    pick["fixed"] = {"params.force_mn": 1, "object": "dock"}
    with pytest.raises(MalformedError):
        load(**pick)


def test_names_are_ascii_because_canonical_bytes_sort_them() -> None:
    with pytest.raises(MalformedError, match="ASCII"):
        load("gö")


def test_a_type_that_the_site_does_not_have_is_refused() -> None:
    with pytest.raises(MalformedError) as refused:
        load(type="dance")
    assert refused.value.where == "tools.go.type"
