# SPDX-License-Identifier: Apache-2.0
"""What a free text states: whole names as the site spells them, values with their units."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from msgspec.structs import replace

from authguard_r.cli.free_text import words_for_model
from authguard_r.compile.units import to_integer
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Plan
from authguard_r.normalize.binding import POSE, Argument, Binding, Use, load_binding, ways
from authguard_r.normalize.samples import probe_site
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.normalize.stated import normalize_stated
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures import scenarios


def quantity(said: str, unit: str) -> int:
    return to_integer(said, unit, where="text")


def read(
    text: str,
    *calls: tuple[str, dict[str, Any]],
    site: Site | None = None,
    binding: Binding | None = None,
) -> Plan:
    steps = [{"tool": tool, "arguments": arguments} for tool, arguments in calls]
    return normalize_stated(
        json.dumps({"plan": steps}).encode(),
        text,
        site=site or scenarios.site(),
        binding=binding or scenarios.binding(),
        quantity=quantity,
    )


def drive(text: str, destination: str = "Station 101", **more: Any) -> Plan:
    return read(text, ("navigate_to", {"destination": destination, **more}))


@pytest.mark.parametrize(
    "text",
    [
        "Station 101",
        "go to Nurse Station 101.",
        "go to ROOM  101, then wait",
        'go to "room\n101"!',
        "go to (station-101); wait",
        "not to Station 101",  # negation is not checked
    ],
)
def test_a_whole_name_in_any_case_and_spacing_names_its_place(text: str) -> None:
    assert drive(text).steps[0].action.destination == "station-101"


@pytest.mark.parametrize(
    "text",
    [
        "go to station 10",
        "go to room 1011",
        "go to room 10 1",
        "go to 101",
        "go to stations 102 and 101",
        "go to Station_101",
        "go to Station one hundred and one",
        "go to Station 101-B",
        "go to Station 101's closet",
        "go to Station 101/B",
        "go to Station 101\u200bB",
        "go to Station 101\u0301",
        "go to St\u0430tion 101",
        "go to pre-Station 101",
        "go to xStation 101",
        "go to Stati0n 101",
        "the Pharmacy",
    ],
)
def test_what_is_near_a_name_names_nothing(text: str) -> None:
    with pytest.raises(MalformedError) as refused:
        drive(text)
    assert (refused.value.reason, refused.value.where) == (
        Reason.NAME_UNKNOWN,
        "actions[0].destination",
    )
    assert "`Nurse Station 101`" in refused.value.message


def test_a_name_within_a_longer_one_names_nothing() -> None:
    """`Staff Corridor` is another place than `Corridor`."""
    with pytest.raises(MalformedError, match="does not name `public-corridor`"):
        drive("go through the Staff Corridor", "Corridor")
    drive("go through the Staff Corridor", "Service Corridor")


def renamed(**names: tuple[str, ...]) -> Site:
    """Return the hospital with other names for some of its places and things."""
    site = scenarios.site()
    named = {name.replace("_", "-"): given for name, given in names.items()}
    regions = {r: replace(m, names=named.get(r, m.names)) for r, m in site.regions.items()}
    objects = {o: replace(m, names=named.get(o, m.names)) for o, m in site.objects.items()}
    return replace(site, regions=regions, objects=objects)


@pytest.mark.parametrize(
    "site",
    [
        renamed(station_101=("Bay",), station_102=("BAY",)),
        renamed(station_101=("Bay",), package_p1=("bay",)),
        renamed(station_101=("Bay",), package_p1=("Bay",)),
    ],
)
def test_a_name_of_two_things_names_neither(site: Site) -> None:
    with pytest.raises(ClarificationError) as asked:
        read("go to Bay", ("navigate_to", {"destination": "station-101"}), site=site)
    assert asked.value.field == "actions[0].destination"
    assert "place station-101" in asked.value.candidates
    assert len(asked.value.candidates) == 2
    read("go to station-101, Bay", ("navigate_to", {"destination": "Bay"}), site=site)


def test_names_that_share_a_word_name_nothing() -> None:
    site = renamed(station_101=("Nurse Bay",), station_102=("Bay 7",))
    for place in ("Nurse Bay", "Bay 7"):
        with pytest.raises(MalformedError, match="does not name"):
            read("go to Nurse Bay 7", ("navigate_to", {"destination": place}), site=site)


@pytest.mark.parametrize(
    ("text", "speed"),
    [
        ("at 0.5 m/s", "0.5"),
        ("at 0.5m/s.", "0.5"),
        ("(500 mm/s)", "0.5"),
        ("at 50 cm/s, please", "0.5"),
        ("1.8 km/h", "0.5"),
        ("slowly", "0.5"),  # what the binding carries when the planner gives no speed
    ],
)
def test_a_value_is_converted_exactly_from_the_unit_of_the_text(text: str, speed: str) -> None:
    made = drive(f"Station 101 {text}", speed=float(speed))
    assert made.steps[0].action.params == {"speed_mm_s": 500}


@pytest.mark.parametrize(
    "text",
    [
        "at 0.6",
        "at 600",
        "at 0.61 m/s",
        "at 0.6 m",
        "at 0.6 N",
        "at 0.6 s",
        "at -0.6 m/s",
        "at 10.6 m/s",
        "at 1 0.6 m/s",
        "at 0.6 m/s^2",
        "at 0,6 m/s",
        "at 5-0.6 m/s",
        "at 0.6 m/s 0.1 m/s",
        "at 0.6, m/s",
        "at 0.6 Station 101 m/s",
        "at six hundred mm/s",
    ],
)
def test_a_value_without_its_number_and_unit_is_refused(text: str) -> None:
    with pytest.raises(MalformedError) as refused:
        drive(f"go to Station 101 {text}", speed=0.6)
    assert (refused.value.reason, refused.value.where) == (
        Reason.VALUE_INVALID,
        "actions[0].params.speed_mm_s",
    )


def test_a_compound_quantity_states_neither_of_its_parts() -> None:
    for seconds in (60, 30):
        with pytest.raises(MalformedError, match="does not state"):
            read("wait 1 min 30 s", ("wait", {"seconds": seconds}))
    read("wait 30 s, not 1 min", ("wait", {"seconds": 60}))


def test_the_digits_of_a_name_are_no_value() -> None:
    site = renamed(office_1=("Office 30 s",))
    with pytest.raises(MalformedError, match="does not state 30000 ms"):
        read("wait in Office 30 s", ("wait", {"seconds": 30}), site=site)


def test_a_word_of_the_binding_states_its_value() -> None:
    seconds = Argument(
        use=Use.MAPPED, to="params.duration_ms", values={"short": 5000, "long": 60_000}
    )
    wait = replace(scenarios.binding().tools["wait"], arguments={"seconds": seconds})
    binding = replace(scenarios.binding(), tools={"wait": wait})
    read("wait (Short)", ("wait", {"seconds": "short"}), binding=binding)
    for text in ("wait shortly", "wait long"):
        with pytest.raises(MalformedError, match="does not state 5000 ms"):
            read(text, ("wait", {"seconds": "short"}), binding=binding)


def test_a_count_is_a_number_of_its_own() -> None:
    site = scenarios.site()
    wait = site.vocabulary[ActionType("wait")]
    name = ParameterId("duration_ms")
    times = replace(wait, params={name: replace(wait.params[name], unit="count")})
    site = replace(site, vocabulary={**site.vocabulary, ActionType("wait"): times})
    read("wait 3000 times", ("wait", {"seconds": 3}), site=site)
    for text in ("wait 3 times", "wait 13000", "wait x3000", "wait 3,000", "wait 1 3000"):
        with pytest.raises(MalformedError, match="does not state 3000 count"):
            read(text, ("wait", {"seconds": 3}), site=site)


@pytest.mark.parametrize("name", shipped_names())
def test_a_model_is_shown_the_mapped_arguments_of_a_binding_and_nothing_else(name: str) -> None:
    site = probe_site(convert(binding_source(name), Binding, where=name), standard_words())
    binding = load_binding(binding_source(name), site=site, where=name)
    shown = words_for_model(binding, site)["tools"]
    for way in ways(binding):
        if site.vocabulary[way.tool.type].state_writing:
            continue
        mapped = {n for n, a in way.tool.arguments.items() if a.use is Use.MAPPED}
        (seen,) = [one for one in shown[way.name] if set(one) == mapped | set(way.tool.when)][:1]
        for path in mapped:
            argument = way.tool.arguments[path]
            assert ("number" in seen[path] or "one of" in seen[path]) == argument.to.startswith(
                "params."
            )
            assert (seen[path].get("is") == argument.to) == (argument.to in POSE)


def test_an_action_without_a_name_needs_its_tool_in_the_text() -> None:
    for text in ("Take photo", "take_photo now"):
        assert read(text, ("take_photo", {})).steps[0].action.params == {"max_bytes": 4_000_000}
    for text in ("look around", "retake photo", "take photos", "record video"):
        with pytest.raises(MalformedError, match="does not name `take_photo`") as refused:
            read(text, ("take_photo", {}))
        assert refused.value.where == "actions[0].tool"


def test_every_action_of_a_plan_is_checked() -> None:
    scan: tuple[str, dict[str, Any]] = ("scan", {})
    go = ("navigate_to", {"destination": "Dock", "via": ["Corridor", "Office 1"]})
    with pytest.raises(MalformedError) as refused:
        read("scan, then to the Dock by the Corridor", scan, go)
    assert refused.value.where == "actions[1].route[1]"


NAMES = ("Room 10", "Room 101", "Room", "Room 1", "Bay", "bay", "Bay A", "A", "P 1", "P", "Bay-A")
MARKS = (*[""] * 20, ",", ".", "-", "'s", "(", ")", "_", "\u200b")
SPACES = (*[" "] * 9, "  ", "\n", "", "-")
IDS = ("station-101", "station-102", "dock")
PIECES = st.sampled_from((*NAMES, *IDS, *["package-p1"] * 3, "not", "10", "101", "1", "room"))


def spell(parts: list[tuple[str, str, str, str]]) -> str:
    return "".join(f"{before}{word}{after}{space}" for before, word, after, space in parts)


TEXTS = st.lists(
    st.tuples(st.sampled_from(MARKS), PIECES, st.sampled_from(MARKS), st.sampled_from(SPACES)),
    min_size=2,
    max_size=10,
).map(spell)
SPELLINGS = st.lists(st.sampled_from(NAMES), max_size=3, unique=True).map(tuple)


def stands(text: str, name: str) -> bool:
    """True when some words of a text, without the marks around them, are the name."""
    words, size = text.casefold().split(), len(name.split())
    windows = (" ".join(words[at : at + size]) for at in range(len(words)))
    return any(
        window.lstrip("(\"'[").rstrip(")\"'].,;:!?") == " ".join(name.casefold().split())
        for window in windows
    )


@given(
    text=TEXTS,
    names=st.fixed_dictionaries(
        dict.fromkeys(("station_101", "station_102", "dock", "package_p1"), SPELLINGS)
    ),
    place=st.sampled_from(IDS),
    via=st.lists(st.sampled_from(IDS), max_size=2),
)
def test_accepted_places_and_objects_are_exact_names_of_the_text(
    text: str, names: dict[str, tuple[str, ...]], place: str, via: list[str]
) -> None:
    """And each by a name that nothing else of the site has."""
    site = renamed(**names)
    spelled: dict[str, tuple[str, ...]] = {r: (r, *m.names) for r, m in site.regions.items()}
    spelled |= {o: (o, *m.names) for o, m in site.objects.items()}

    def owners(name: str) -> set[str]:
        same = name.casefold()
        return {item for item, has in spelled.items() if same in {n.casefold() for n in has}}

    for call in (
        ("navigate_to", {"destination": place, "via": via}),
        ("put_down", {"object": "package-p1", "at": place}),
        ("pick_up", {"object": "package-p1"}),
    ):
        try:
            (step,) = read(text, call, site=site).steps
        except (MalformedError, ClarificationError):
            continue
        event(f"accepted {call[0]}")
        action = step.action
        for item in (action.object, action.destination, *action.route):
            assert item is None or any(
                stands(text, name) and owners(name) == {item} for name in spelled[item]
            )


@given(name=st.sampled_from(("Station 101", "Pharmacy Desk A", "dock", "Director's Office")))
def test_a_text_that_is_a_name_is_accepted(name: str) -> None:
    assert drive(name, name).steps
