# SPDX-License-Identifier: Apache-2.0
"""What conditions leave open: the laws behind `a guard that always holds is none`."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from authguard_r.authoring.compile.conditions import can_hold, real_guards
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.mission import Comparison, Guard
from authguard_r.core.provenance import Label
from authguard_r.core.state import Reading, Snapshot
from fixtures import scenarios
from fixtures.cases import case

TOP = MAX_INTEGER


def guard(variable: str, comparison: str, value: Any) -> Guard:
    return Guard(variable=variable, comparison=Comparison(comparison), value=value, max_age_ms=9)


def test_a_guard_is_one_when_some_value_fails_it() -> None:
    for variable, comparison, value, is_real in [
        ("battery_permille", "ge", 0, False),
        ("battery_permille", "ge", 1, True),
        ("battery_permille", "gt", -1, False),
        ("battery_permille", "gt", 0, True),
        ("battery_permille", "le", 1000, False),
        ("battery_permille", "le", 999, True),
        ("battery_permille", "lt", 1001, False),
        ("battery_permille", "lt", 1000, True),
        ("battery_permille", "ne", 1001, False),
        ("battery_permille", "ne", -1, False),
        ("battery_permille", "ne", 1000, True),
        ("battery_permille", "eq", 1000, True),
        ("charge_percent", "le", 100, False),
        ("charge_percent", "le", 99, True),
        *((f"x{end}", "ge", 0, False) for end in ("_ms", "_mm", "_mm_s", "_g", "_bytes")),
        *((f"x{end}", "ge", 1, True) for end in ("_ms", "_mm", "_mm_s", "_g", "_bytes")),
        ("x_g", "le", 10**9, True),
        ("people", "ge", 0, True),
        ("people", "ge", -TOP, False),
        ("people", "le", TOP, False),
        ("people", "le", TOP - 1, True),
        ("door_open", "eq", False, True),
        ("door_open", "ne", False, True),
        ("holding", "ne", "nothing", True),
        ("battery_permille", "ne", "low", True),
        ("battery_permille", "ne", True, True),
    ]:
        with case(variable, comparison, value, is_real):
            asked = guard(variable, comparison, value)
            assert real_guards((asked,)) == ((asked,) if is_real else ())


def test_what_holds_anyway_is_no_further_condition() -> None:
    for given_guards, asked, is_real in [
        ([("battery_permille", "ge", 200)], ("battery_permille", "gt", 199), False),
        ([("battery_permille", "ge", 200)], ("battery_permille", "gt", 200), True),
        ([("battery_permille", "le", 200)], ("battery_permille", "lt", 201), False),
        ([("battery_permille", "eq", 5)], ("battery_permille", "eq", 5), False),
        ([("battery_permille", "eq", 5)], ("battery_permille", "ge", 5), False),
        (
            [("battery_permille", "ge", 5), ("battery_permille", "lt", 6)],
            ("battery_permille", "eq", 5),
            False,
        ),
        ([("battery_permille", "ge", 200)], ("speed_mm_s", "gt", 100), True),
        ([("holding", "eq", "nothing")], ("holding", "eq", "nothing"), False),
        ([("holding", "eq", "nothing")], ("holding", "ne", "package-p1"), True),
        ([("door_open", "eq", True)], ("door_open", "eq", True), False),
        ([("x", "eq", True)], ("x", "eq", 1), True),
        ([("x", "ge", "a")], ("x", "ge", 1), True),
        ([("x", "ne", 3)], ("x", "ge", 1), True),
    ]:
        with case(given_guards, asked, is_real):
            found = real_guards((guard(*asked),), [guard(*item) for item in given_guards])
            assert bool(found) is is_real


CONDITIONS = st.builds(
    guard,
    st.just("battery_permille"),
    st.sampled_from([str(c) for c in Comparison]),
    st.integers(min_value=-3, max_value=1_003),
)


def holds(asked: Guard, value: int) -> bool:
    """Ask the gate itself."""
    reading = Reading(value=value, label=Label.TRUSTED_SENSOR, age_ms=0)
    readings = {"battery_permille": reading}
    snapshot = Snapshot(**{**fields(), "readings": readings})
    return guard_finding(asked, scenarios.attested(snapshot), scenarios.RID, scenarios.NOW) is None


def fields() -> dict[str, Any]:
    snapshot = scenarios.state().snapshot
    return {name: getattr(snapshot, name) for name in snapshot.__struct_fields__}


@given(st.lists(CONDITIONS, min_size=1, max_size=3))
def test_no_guard_is_dropped_that_the_gate_would_ever_fail(guards: list[Guard]) -> None:
    kept = real_guards(guards)
    for asked in guards:
        if asked not in kept:
            around = {0, 1, 999, 1_000, asked.value - 1, asked.value, asked.value + 1}
            assert all(holds(asked, value) for value in around if 0 <= value <= 1_000)


@given(st.lists(CONDITIONS, min_size=1, max_size=3), st.integers(0, 1_000))
def test_guards_that_the_gate_fulfils_together_are_never_called_apart(
    guards: list[Guard], value: int
) -> None:
    if all(holds(asked, value) for asked in guards):
        assert can_hold(guards)


def test_conditions_on_several_variables_must_each_leave_a_value() -> None:
    apart = [guard("a", "lt", 1), guard("a", "gt", 0)]
    assert not can_hold([guard("b", "eq", 1), *apart])
    assert can_hold([guard("b", "eq", 1), apart[0]])
    assert can_hold([])
    assert not can_hold([guard("people", "gt", TOP)])
