# SPDX-License-Identifier: Apache-2.0
"""From a call to an action: every refusal alone with its place, every near miss, every rounding."""

from __future__ import annotations

import json
from decimal import Decimal
from fractions import Fraction
from typing import Any

import msgspec
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.core.action import Action, scope_of
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Dialect
from authguard_r.normalize.bind import scale
from authguard_r.normalize.binding import ArgumentUse
from authguard_r.site.model import Parameter, Rounding
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from unit.normalize.dialogue import WRITERS, Call, as_json, binder, name_place, place, read, refused

GO = ("navigate_to", {"destination": "Dock"})
SCAN: Call = ("scan", {})


def action(tool: str, **arguments: Any) -> Action:
    return read(as_json((tool, arguments))).steps[0].action


# -- what a call means -----------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", WRITERS)
def test_every_dialect_means_the_same_actions(dialect: Dialect) -> None:
    plan = read(
        WRITERS[dialect](
            ("navigate_to", {"destination": "Station 101", "speed": 0.8, "reason": "urgent"}),
            ("put_down", {"object": "P1", "at": "Nurse Station 101", "force": 12}),
            SCAN,
        ),
        dialect,
    )
    assert [step.action for step in plan.steps] == [
        Action(
            type="navigate",
            tool="base",
            destination="station-101",
            params={"speed_mm_s": 800},
        ),
        Action(
            type="place",
            tool="gripper",
            object="package-p1",
            destination="station-101",
            params={"force_mn": 12_000},
        ),
        Action(type="scan_obstacles", tool="lidar"),
    ]
    assert [step.attested for step in plan.steps] == [("source",), ("source",), ()]


def test_what_the_planner_leaves_out_is_what_the_binding_says() -> None:
    assert action("navigate_to", destination="Dock").params == {"speed_mm_s": 500}
    assert action("pick_up", object="P1").params == {"force_mn": 10_000}
    assert action("take_photo").params == {"max_bytes": 4_000_000}
    assert action("navigate_to", destination="Dock").route == ()


def test_a_route_is_resolved_name_by_name_in_order() -> None:
    found = action("navigate_to", destination="Dock", via=["Corridor", "Station 101", "Corridor"])
    assert found.route == ("public-corridor", "station-101", "public-corridor")
    assert action("navigate_to", destination="Dock", via=[]).route == ()


def test_a_source_is_never_the_planner_s_to_say() -> None:
    """It comes from attested state; a planner that names one is refused (L4)."""
    call = ("navigate_to", {"destination": "Dock", "source": "Pharmacy"})
    refused(as_json(call), Reason.FIELD_UNKNOWN, "plan[0].source")


def test_nothing_of_an_action_is_provenance_or_meta() -> None:
    found = action("navigate_to", destination="Dock", reason="operator said so")
    assert (found.provenance, found.meta) == ({}, None)


@pytest.mark.parametrize(
    "name", ["provenance", "meta", "type", "tool", "params", "approved", "mid"]
)
def test_a_planner_cannot_name_its_own_authority(name: str) -> None:
    call = ("navigate_to", {"destination": "Dock", name: "operator"})
    refused(as_json(call), Reason.FIELD_UNKNOWN, f"plan[0].{name}")


# -- each refusal alone ----------------------------------------------------------------------------

#: A call with one fault, the code, the field it is at, and the same call without the fault.
FAULTS: dict[str, tuple[Call, Reason, str, Call]] = {
    "unknown tool": (("fly_to", {"destination": "Dock"}), Reason.TOOL_UNKNOWN, "", GO),
    "tool in another case": (("Navigate_to", {}), Reason.TOOL_UNKNOWN, "", GO),
    "tool cut short": (("navigate", {"destination": "Dock"}), Reason.TOOL_UNKNOWN, "", GO),
    "tool with something behind": (
        ("navigate_to_", {"destination": "Dock"}),
        Reason.TOOL_UNKNOWN,
        "",
        GO,
    ),
    "the canonical type as tool": (("pick", {"object": "P1"}), Reason.TOOL_UNKNOWN, "", SCAN),
    "unknown field": (
        ("navigate_to", {"destination": "Dock", "frame_id": "map"}),
        Reason.FIELD_UNKNOWN,
        ".frame_id",
        ("navigate_to", {"destination": "Dock", "reason": "map"}),
    ),
    "field in another case": (
        ("navigate_to", {"Destination": "Dock"}),
        Reason.FIELD_UNKNOWN,
        ".Destination",
        GO,
    ),
    "field of another tool": (
        ("navigate_to", {"destination": "Dock", "force": 1}),
        Reason.FIELD_UNKNOWN,
        ".force",
        ("pick_up", {"object": "P1", "force": 1}),
    ),
    "missing field": (("navigate_to", {"speed": 0.5}), Reason.FIELD_MISSING, ".destination", GO),
    "missing count": (("wait", {}), Reason.FIELD_MISSING, ".seconds", ("wait", {"seconds": 1})),
    "refused field": (
        ("navigate_to", {"destination": "Dock", "behavior_tree": "x.xml"}),
        Reason.FIELD_REFUSED,
        ".behavior_tree",
        GO,
    ),
    "refused field, empty": (
        ("navigate_to", {"destination": "Dock", "behavior_tree": ""}),
        Reason.FIELD_REFUSED,
        ".behavior_tree",
        GO,
    ),
    "text for a number": (
        ("navigate_to", {"destination": "Dock", "speed": "0.5"}),
        Reason.VALUE_INVALID,
        ".speed",
        ("navigate_to", {"destination": "Dock", "speed": 0.5}),
    ),
    "truth for a number": (
        ("navigate_to", {"destination": "Dock", "speed": True}),
        Reason.VALUE_INVALID,
        ".speed",
        ("navigate_to", {"destination": "Dock", "speed": 1}),
    ),
    "number for a name": (
        ("navigate_to", {"destination": 101}),
        Reason.VALUE_INVALID,
        ".destination",
        ("navigate_to", {"destination": "Station 101"}),
    ),
    "truth for a name": (
        ("pick_up", {"object": True}),
        Reason.VALUE_INVALID,
        ".object",
        ("pick_up", {"object": "P1"}),
    ),
    "too fast": (
        ("navigate_to", {"destination": "Dock", "speed": 3.0001}),
        Reason.VALUE_OUT_OF_RANGE,
        ".speed",
        ("navigate_to", {"destination": "Dock", "speed": 3}),
    ),
    "not at all fast": (
        ("navigate_to", {"destination": "Dock", "speed": 0}),
        Reason.VALUE_OUT_OF_RANGE,
        ".speed",
        ("navigate_to", {"destination": "Dock", "speed": 0.0001}),
    ),
    "backwards": (
        ("navigate_to", {"destination": "Dock", "speed": -0.5}),
        Reason.VALUE_OUT_OF_RANGE,
        ".speed",
        ("navigate_to", {"destination": "Dock", "speed": 0.5}),
    ),
    "absurdly fast": (
        ("navigate_to", {"destination": "Dock", "speed": 10**30}),
        Reason.VALUE_OUT_OF_RANGE,
        ".speed",
        GO,
    ),
    "unknown place": (
        ("navigate_to", {"destination": "Station 104"}),
        Reason.NAME_UNKNOWN,
        ".destination",
        ("navigate_to", {"destination": "Station 103"}),
    ),
    "a place with a space behind": (
        ("navigate_to", {"destination": "Station 101 "}),
        Reason.NAME_UNKNOWN,
        ".destination",
        ("navigate_to", {"destination": "Station 101"}),
    ),
    "a place in another case": (
        ("navigate_to", {"destination": "station 101"}),
        Reason.NAME_UNKNOWN,
        ".destination",
        ("navigate_to", {"destination": "station-101"}),
    ),
    "an object for a place": (
        ("navigate_to", {"destination": "P1"}),
        Reason.NAME_UNKNOWN,
        ".destination",
        ("pick_up", {"object": "P1"}),
    ),
    "a place for an object": (
        ("pick_up", {"object": "Dock"}),
        Reason.NAME_UNKNOWN,
        ".object",
        ("put_down", {"object": "P1", "at": "Dock"}),
    ),
    "no name": (("pick_up", {"object": ""}), Reason.NAME_UNKNOWN, ".object", SCAN),
    "state writing": (
        ("relocalize", {"place": "Dock"}),
        Reason.STATE_WRITING_REFUSED,
        "",
        GO,
    ),
}


def test_a_call_with_one_fault_is_refused_in_its_place_and_without_it_is_not() -> None:
    for name, (bad, reason, field, good) in FAULTS.items():
        for dialect in WRITERS:
            with case(name, dialect):
                write = WRITERS[dialect]
                at = name_place if reason is Reason.TOOL_UNKNOWN else place
                refused(write(bad), reason, at(dialect, 0, bad) + field, dialect)
                assert len(read(write(good), dialect).steps) == 1


def test_one_bad_call_refuses_the_whole_plan() -> None:
    """What is not understood is never dropped so that the rest can be judged (L11)."""
    for name, (bad, reason, field, good) in FAULTS.items():
        for dialect in WRITERS:
            with case(name, dialect):
                calls = (good, bad, good)
                at = name_place if reason is Reason.TOOL_UNKNOWN else place
                refused(WRITERS[dialect](*calls), reason, at(dialect, 1, *calls) + field, dialect)


def test_every_reason_of_the_binder_has_a_vector_here() -> None:
    assert {reason for _, reason, _, _ in FAULTS.values()} == {
        Reason.TOOL_UNKNOWN,
        Reason.FIELD_UNKNOWN,
        Reason.FIELD_MISSING,
        Reason.FIELD_REFUSED,
        Reason.VALUE_INVALID,
        Reason.VALUE_OUT_OF_RANGE,
        Reason.NAME_UNKNOWN,
        Reason.STATE_WRITING_REFUSED,
    }


def test_a_value_that_only_json_can_say_is_no_value() -> None:
    """A list of one is not its item."""
    for field in ["destination", "speed", "behavior_tree"]:
        for value in [[], {}, ["Dock"], {"name": "Dock"}]:
            with case(field, value):
                reason = Reason.FIELD_REFUSED if field == "behavior_tree" else Reason.VALUE_INVALID
                for dialect in (Dialect.JSON, Dialect.OPENAI):
                    call = ("navigate_to", {"destination": "Dock", field: value})
                    refused(WRITERS[dialect](call), reason, f"{place(dialect, 0)}.{field}", dialect)


def test_null_leaves_an_optional_argument_out_and_is_no_value_of_a_needed_one() -> None:
    """Many models write every argument of a schema, and null where they mean none (L31)."""
    for dialect in WRITERS:
        with case(dialect):
            given = {"destination": "Dock", "speed": None, "via": None, "behavior_tree": None}
            plan = read(WRITERS[dialect](("navigate_to", given)), dialect)
            without = read(WRITERS[dialect](("navigate_to", {"destination": "Dock"})), dialect)
            assert plan.steps == without.steps
            call = ("navigate_to", {"destination": None})
            where = f"{place(dialect, 0)}.destination"
            refused(WRITERS[dialect](call), Reason.VALUE_INVALID, where, dialect)


def test_a_route_with_one_fault_is_refused_at_its_entry() -> None:
    for via, reason, where in [
        ("Corridor", Reason.VALUE_INVALID, "via"),
        ({"0": "Corridor"}, Reason.VALUE_INVALID, "via"),
        (["Corridor", "Nowhere"], Reason.NAME_UNKNOWN, "via[1]"),
        (["Corridor", 7], Reason.VALUE_INVALID, "via[1]"),
        ([["Corridor"]], Reason.VALUE_INVALID, "via[0]"),
        ([None], Reason.VALUE_INVALID, "via[0]"),
        (["P1"], Reason.NAME_UNKNOWN, "via[0]"),
    ]:
        with case(via, reason, where):
            call = ("navigate_to", {"destination": "Dock", "via": via})
            refused(as_json(call), reason, f"plan[0].{where}")


def test_a_number_that_is_none_never_reaches_a_comparison() -> None:
    """Written into the raw text of each dialect (L3)."""
    for speed in [
        "NaN",
        "Infinity",
        "-Infinity",
        "1e400",
        "1" * 60,
        "0x1",
        "1_0",
        "+1",
        "01",
        ".5",
        "nan",
    ]:
        with case(speed):
            for text in (
                f'{{"tool":"navigate_to","arguments":{{"destination":"Dock","speed":{speed}}}}}',
                f'navigate_to(destination="Dock", speed={speed})',
            ):
                with pytest.raises(MalformedError) as caught:
                    read(text)
                assert caught.value.reason is Reason.MALFORMED


@pytest.mark.parametrize("name", ["reason", "text"])
def test_a_noted_field_may_hold_anything_and_changes_nothing(name: str) -> None:
    tool, rest = ("say", {}) if name == "text" else ("navigate_to", {"destination": "Dock"})
    plain = action(tool, **rest)
    for value in ("go(destination='Office 1')", None, 7, ["Office 1"], {"destination": "Office 1"}):
        assert action(tool, **rest, **{name: value}) == plain


def test_an_unknown_name_is_shown_in_ascii_and_not_in_full_length() -> None:
    call = ("navigate_to", {"destination": "St\u0430tion 101" + "!" * 500})
    error = refused(as_json(call), Reason.NAME_UNKNOWN, "plan[0].destination")
    assert error.message.isascii()
    assert "\\u0430" in error.message
    assert len(error.message) < 150


# -- names -----------------------------------------------------------------------------------------


def test_every_spelling_of_the_site_means_its_thing_and_no_other_does() -> None:
    site = scenarios.site()
    for region, model in site.regions.items():
        for name in (region, *model.names):
            assert action("navigate_to", destination=name).destination == region
    for item, thing in site.objects.items():
        for name in (item, *thing.names):
            assert action("pick_up", object=name).object == item


@settings(max_examples=amount(30, 150))
@given(st.text(max_size=20))
def test_a_name_that_nobody_gave_is_unknown(name: str) -> None:
    assume(name not in binder().spellings())
    for call in (("navigate_to", {"destination": name}), ("pick_up", {"object": name})):
        text = json.dumps({"tool": call[0], "arguments": call[1]}, ensure_ascii=False)
        refused(text, Reason.NAME_UNKNOWN, f"input.{next(iter(call[1]))}")


def test_the_spellings_hold_every_name_once() -> None:
    site = scenarios.site()
    names = [n for r, m in site.regions.items() for n in (r, *m.names)]
    names += [n for o, m in site.objects.items() for n in (o, *m.names)]
    assert sorted(binder().spellings()) == sorted(names)


# -- equal calls, equal actions --------------------------------------------------------------------


def digest(found: Action) -> str:
    return digest_of(Tag.ACTION, found)


@settings(max_examples=amount(25, 60))
@given(st.permutations(["destination", "speed", "via", "reason"]), st.text(max_size=10))
def test_the_order_of_arguments_and_what_is_noted_make_no_difference(
    order: list[str], reason: str
) -> None:
    values = {"destination": "Dock", "speed": 0.7, "via": ["Corridor"], "reason": reason}
    found = action("navigate_to", **{name: values[name] for name in order})
    plain = action("navigate_to", destination="Dock", speed=0.7, via=["Corridor"])
    assert digest(found) == digest(plain)


def test_two_spellings_of_one_quantity_are_one_action() -> None:
    texts = ["0.8", "0.80", "8e-1", "80E-2", "0.800000000000000000000000000000000000"]
    found = {
        digest(read(f'navigate_to(destination="Dock", speed={text})').steps[0].action)
        for text in texts
    }
    assert len(found) == 1


#: For every argument of every tool, a value that means something else than the one before it.
VALUES: dict[str, tuple[Any, Any]] = {
    "destination": ("Dock", "Pharmacy"),
    "at": ("Dock", "Pharmacy"),
    "object": ("P1", "P2"),
    "via": (["Corridor"], ["Corridor", "Corridor"]),
    "speed": (0.5, 0.501),
    "force": (10, 10.001),
    "seconds": (5, 5.001),
}


def test_every_changed_argument_changes_the_action_or_is_refused_or_is_noted() -> None:
    """No argument falls through: whatever a planner can change is seen (L5, L16)."""
    for tool in [t for t in scenarios.binding().tools if t != "relocalize"]:
        with case(tool):
            arguments = scenarios.binding().tools[tool].arguments
            mapped = {
                name: VALUES[name][0]
                for name, one in arguments.items()
                if one.use is ArgumentUse.MAPPED
            }
            plain = action(tool, **mapped)
            for name, one in arguments.items():
                if one.use is ArgumentUse.MAPPED:
                    changed = action(tool, **{**mapped, name: VALUES[name][1]})
                    assert digest(changed) != digest(plain)
                    assert digest_of(Tag.SCOPE, scope_of(changed)) != digest_of(
                        Tag.SCOPE, scope_of(plain)
                    )
                elif one.use is ArgumentUse.REFUSED:
                    call = (tool, {**mapped, name: "x"})
                    refused(as_json(call), Reason.FIELD_REFUSED, f"plan[0].{name}")
                else:
                    assert digest(action(tool, **mapped, **{name: "x"})) == digest(plain)


def test_the_smallest_change_of_a_speed_is_seen() -> None:
    found = {
        digest(action("navigate_to", destination="Dock", speed=speed))
        for speed in (0.5, 0.5001, 0.501, 0.499)
    }
    assert len(found) == 3  # 0.5001 and 0.501 both ask for 501


# -- rounding --------------------------------------------------------------------------------------

decimals = st.decimals(-(10**6), 10**6, places=6) | st.integers(-(10**6), 10**6).map(Decimal)
factors = st.fractions(Fraction(1, 1000), 1000, max_denominator=1000)


def parameter(rounding: Rounding, low: int = -MAX_INTEGER, high: int = MAX_INTEGER) -> Parameter:
    return Parameter(unit="mm", low=low, high=high, rounding=rounding, required=True)


def scaled(value: Any, rounding: Rounding, per_unit: Fraction = Fraction(1)) -> int:
    return scale(value, parameter(rounding), per_unit=per_unit, where="x")


@settings(max_examples=amount(60, 300))
@given(decimals, factors)
def test_a_limit_is_rounded_away_from_zero_and_by_less_than_one(
    value: Decimal, factor: Fraction
) -> None:
    """What is asked for is never understated, in either direction."""
    exact = Fraction(value) * factor
    found = scaled(value, Rounding.LIMIT, factor)
    assert abs(exact) <= abs(found) < abs(exact) + 1
    assert found * exact >= 0
    assert (found == exact) == (exact.denominator == 1)


def test_a_number_of_32_bits_is_read_at_its_own_width_and_no_other_number_is() -> None:
    for text, wanted in [
        ("0.800000011920929", 800),
        ("0.10000000149011612", 100),
        ("-0.30000001192092896", -300),
        ("0.800000011920928", 801),  # no double spells these 32 bits so
        ("0.80000001", 801),
        ("0.8000005", 801),
    ]:
        with case(text):
            assert scaled(Decimal(text), Rounding.LIMIT, Fraction(1000)) == wanted
    assert scaled(Decimal("0.800000011920929"), Rounding.COUNT, Fraction(1000)) == 800
    with pytest.raises(MalformedError):
        scaled(Decimal("0.80000001"), Rounding.COUNT, Fraction(1000))


@settings(max_examples=amount(60, 300))
@given(decimals, factors)
def test_a_position_is_rounded_to_the_nearest_and_halves_to_even(
    value: Decimal, factor: Fraction
) -> None:
    exact = Fraction(value) * factor
    found = scaled(value, Rounding.POSITION, factor)
    assert abs(found - exact) <= Fraction(1, 2)
    if abs(found - exact) == Fraction(1, 2):
        assert found % 2 == 0


@settings(max_examples=amount(60, 300))
@given(decimals, factors)
def test_a_count_is_exact_or_refused(value: Decimal, factor: Fraction) -> None:
    exact = Fraction(value) * factor
    if exact.denominator == 1:
        assert scaled(value, Rounding.COUNT, factor) == exact
        return
    with pytest.raises(MalformedError) as caught:
        scaled(value, Rounding.COUNT, factor)
    assert (caught.value.reason, caught.value.where) == (Reason.VALUE_INVALID, "x")


def test_roundings_by_example() -> None:
    for value, limit, position in [
        ("0.5", 1, 0),
        ("-0.5", -1, 0),
        ("1.5", 2, 2),
        ("2.5", 3, 2),
        ("-2.5", -3, -2),
        ("2.4999999999", 3, 2),
        ("0.0000000001", 1, 0),
        ("-0.0000000001", -1, 0),
        ("0", 0, 0),
        ("-0.0", 0, 0),
        ("7", 7, 7),
    ]:
        with case(value, limit, position):
            assert scaled(Decimal(value), Rounding.LIMIT) == limit
            assert scaled(Decimal(value), Rounding.POSITION) == position


@settings(max_examples=amount(40, 200))
@given(decimals, factors, st.integers(-1000, 1000), st.integers(-1000, 1000))
def test_a_number_passes_exactly_when_what_is_carried_lies_in_the_range(
    value: Decimal, factor: Fraction, one: int, two: int
) -> None:
    """The range is held against the rounded number: 3.0001 m/s is not waved through as 3."""
    low, high = min(one, two), max(one, two)
    whole = scaled(value, Rounding.LIMIT, factor)
    bounded = parameter(Rounding.LIMIT, low, high)
    if low <= whole <= high:
        assert scale(value, bounded, per_unit=factor, where="x") == whole
        return
    with pytest.raises(MalformedError) as caught:
        scale(value, bounded, per_unit=factor, where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.VALUE_OUT_OF_RANGE, "x")
    assert f"{low} to {high} mm" in caught.value.message


@pytest.mark.parametrize("value", [MAX_INTEGER + 1, -MAX_INTEGER - 1, 10**40])
def test_an_integer_that_signed_data_cannot_hold_is_out_of_range_whatever_the_type_says(
    value: int,
) -> None:
    wide = msgspec.structs.replace(parameter(Rounding.LIMIT), low=-(10**50), high=10**50)
    with pytest.raises(MalformedError) as caught:
        scale(value, wide, per_unit=Fraction(1), where="x")
    assert caught.value.reason is Reason.VALUE_OUT_OF_RANGE
    assert scale(MAX_INTEGER, wide, per_unit=Fraction(1), where="x") == MAX_INTEGER


def test_a_value_that_is_no_exact_number_is_refused() -> None:
    for rounding in Rounding:
        for value in [
            True,
            False,
            "1",
            1.0,
            float("nan"),
            float("inf"),
            None,
            [1],
            {},
            b"1",
            Fraction(1, 2),
        ]:
            with case(rounding, value):
                with pytest.raises(MalformedError) as caught:
                    scaled(value, rounding)
                assert (caught.value.reason, caught.value.where) == (Reason.VALUE_INVALID, "x")
