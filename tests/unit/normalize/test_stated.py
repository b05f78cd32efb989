# SPDX-License-Identifier: Apache-2.0
"""What a free text states: whole names as the site spells them, values with their units."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from msgspec.structs import replace

from authguard_r.authoring.binding.samples import probe_site
from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.free_text import model_prompt_schema
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Plan
from authguard_r.normalize.binding import POSE, Argument, ArgumentUse, Binding, load_binding, ways
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
        ("at (500 mm/s)", "0.5"),
        ("at 50 cm/s, please", "0.5"),
        ("with 1.8 km/h", "0.5"),
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
    for text in ("1 min 30 s", "1 min and 30 s", "1 min, and a further 30 s", "1min & 30s"):
        for seconds in (60, 30):
            with pytest.raises(MalformedError, match="does not state"):
                read(f"wait {text}", ("wait", {"seconds": seconds}))
    read("wait 30 s, not 1 min", ("wait", {"seconds": 60}))


def waits(text: str) -> bool:
    """True when a text states a wait of 30 s."""
    try:
        read(f"wait, scan {text}", ("wait", {"seconds": 30}))
    except MalformedError as refused:
        assert refused.where == "actions[0].params.duration_ms"  # noqa: PT017
        return False
    return True


@pytest.mark.parametrize(
    "before",
    [
        *("10", "2,", "1.", "1:", "2e3", "x10", "\u0663", "\u00bd", "\u2161", "10\u200b", "Room 7"),
        *(
            "-",
            "+",
            "*",
            "/",
            "x",
            ":",
            ".",
            ",",
            "%",
            "~",
            "<",
            ">",
            "=",
            "\u2212",
            "\u2013",
            "\u00d7",
        ),
        *(
            "\u2264",
            "\u0445",
            "\u2063",
            "\u3164",
            "t=",
            "5 x",
            "10 -",
            "1 /",
            "minus",
            "times",
            "5 times",
        ),
        *("two hundred", "Two", "twenty-five", "thousands", "a million", "half", "half a", "twice"),
        *(
            "1 h and",
            "1 h, and",
            "1 h plus",
            "1 h &",
            "1 h -and",
            "1 h as well as",
            "10 through",
            "1 h and/or",
            "an hour and",
            "an hour",
            "two hours and a",
        ),
        *("5 N and", "10 to", "10 or", "2 lots of", "third of"),
    ],
)
def test_a_quantity_beside_a_number_or_a_sign_before_it_states_nothing(before: str) -> None:
    assert waits("then 30 s") == waits("then 30s") == (before != "")
    assert not waits(f"{before} 30 s") or before == "times"
    assert not waits(f"{before} 30s") or before == "times"


@pytest.mark.parametrize(
    "after",
    [
        *(
            "500 ms",
            "500ms",
            ", 5",
            ".5",
            "5",
            "\u0663",
            "two",
            "hundred",
            "half",
            "x 5",
            "times 5",
        ),
        *("and 2 min", "and two minutes", "and a half", "and a minute", "plus 2 min", "& 2 min"),
        *(
            "- 10 s",
            "-10",
            "\u2013 40 s",
            "+ x",
            "* 2",
            "/ 2",
            "% ",
            "^2",
            "per m",
            "squared",
            "to 40 s",
        ),
        *("or 40 s", "m", "minus", "~", "=", "\u00d7"),
    ],
)
def test_a_quantity_beside_a_number_or_a_sign_behind_it_states_nothing(after: str) -> None:
    assert not waits(f"then 30 s {after}")
    assert not waits(f"then 30s {after}")


@pytest.mark.parametrize(
    "text",
    [
        "for 30 s. Then drive to Station 101",
        "and 30 s later drive on",
        "(30 s)",
        "at Station 101 and 30 s later scan",
        "with 5 N, wait 30 s, and scan",
        "a whole 30 s, to the end",
    ],
)
def test_ordinary_words_beside_a_quantity_change_nothing(text: str) -> None:
    assert waits(text)


@pytest.mark.parametrize(
    "text",
    [
        "go through the 5taff Corridor",
        "go through the St\u0430ff Corridor",
        "go through the St@ff Corridor",
        "go through the Staff-Corridor",
        "go through the \ufb06aff, turn, 5taff  \n Corridor",
        "go through the S t a f f Corridor",
    ],
)
def test_a_name_within_what_looks_like_another_one_names_nothing(text: str) -> None:
    with pytest.raises(MalformedError, match="does not name `public-corridor`"):
        drive(text, "Corridor")
    drive(f"{text}, out of it and by the Corridor", "Corridor")


def test_a_name_before_what_looks_like_the_rest_of_another_one_names_nothing() -> None:
    site = renamed(station_101=("Bay",), station_102=("Bay East",))
    go = ("navigate_to", {"destination": "Bay"})
    read("go to Bay Eastern", go, site=site)
    with pytest.raises(MalformedError, match="does not name `station-101`"):
        read("go to Bay Ea5t", go, site=site)


@pytest.mark.parametrize(
    "text",
    [
        *(
            "Station 101 02",
            "Station 101 .5",
            "Station 101 ,5",
            "Station 101, 02",
            "Station 101 - 2",
        ),
        *("Station 101 (02)", "Station 101 \u0662", "Station 101 \u00bd", "Station 101 \u3164 2"),
        "Station 101\n2",
    ],
)
def test_a_name_before_a_number_names_nothing(text: str) -> None:
    with pytest.raises(MalformedError, match="does not name `station-101`"):
        drive(f"go to {text}")
    drive(f"go to {text} or to Station 101 itself")


def test_a_number_before_a_name_that_begins_with_one_names_nothing() -> None:
    site = renamed(station_101=("3 West",))
    go = ("navigate_to", {"destination": "3 West"})
    read("go to ward 3 West", go, site=site)
    for text in ("1 3 West", "1, 3 West", "\u0661. 3 West", "1 - 3 West"):
        with pytest.raises(MalformedError, match="does not name `station-101`"):
            read(f"go to {text}", go, site=site)
    drive("go to gate 2 Station 101")


def test_the_digits_of_a_name_are_no_value() -> None:
    site = renamed(office_1=("Office 30 s",))
    with pytest.raises(MalformedError, match="does not state 30000 ms"):
        read("wait in Office 30 s", ("wait", {"seconds": 30}), site=site)


def test_a_word_of_the_binding_states_its_value() -> None:
    seconds = Argument(
        use=ArgumentUse.MAPPED, to="params.duration_ms", values={"short": 5000, "long": 60_000}
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
    shown = model_prompt_schema(binding, site)["tools"]
    for way in ways(binding):
        if site.vocabulary[way.tool.type].state_writing:
            continue
        mapped = {n for n, a in way.tool.arguments.items() if a.use is ArgumentUse.MAPPED}
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


NAMES = (
    *("Room 10", "Room 101", "Room", "Room 1", "Bay", "bay", "Bay A", "A", "P 1", "P", "Bay-A"),
    *("7 A", "A Bay"),
)
MARKS = (*[""] * 20, ",", ".", "-", "'s", "(", ")", "_", "\u200b")
SPACES = (*[" "] * 9, "  ", "\n", "", "-")
IDS = ("station-101", "station-102", "dock")
PIECES = st.sampled_from(
    (*NAMES, *IDS, *["package-p1"] * 3, "not", "10", "101", "1", "room", "8ay", ".5")
)


def spell(parts: list[tuple[str, str, str, str]]) -> str:
    return "".join(f"{before}{word}{after}{space}" for before, word, after, space in parts)


TEXTS = st.lists(
    st.tuples(st.sampled_from(MARKS), PIECES, st.sampled_from(MARKS), st.sampled_from(SPACES)),
    min_size=2,
    max_size=10,
).map(spell)
SPELLINGS = st.lists(st.sampled_from(NAMES), max_size=3, unique=True).map(tuple)


def first_shown(text: str) -> str:
    return next(filter(str.isalnum, text), "")


def windows(words: list[str], name: str) -> set[tuple[int, int]]:
    """Return where some words of a text, without the marks around them, are a name."""
    size = len(name.split())
    return {
        (at, at + size)
        for at in range(len(words))
        if " ".join(words[at : at + size]).lstrip("(\"'[").rstrip(")\"'].,;:!?")
        == " ".join(name.casefold().split())
    }


def stands(text: str, name: str, others: set[str]) -> bool:
    """True when a name stands in a text without a number beside it, nor as a part of another.

    Args:
        text: it, with `8ay` for `Bay` here and there.
        name: the name.
        others: the names of everything else.
    """
    words = text.casefold().split()
    read = [word.replace("8ay", "bay") for word in words]
    looks = {
        (start, end)
        for other in others
        for start, end in windows(read, other)
        if read[start:end] != words[start:end]
    }
    return any(
        not first_shown(" ".join(words[end:])).isdigit()
        and not (name[0].isdigit() and first_shown("".join(words[:start])[::-1]).isdigit())
        and all(last <= start or end <= first for first, last in looks)
        for start, end in windows(words, name)
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

    def others(item: str) -> set[str]:
        return {name for other, has in spelled.items() if other != item for name in has}

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
                stands(text, name, others(item)) and owners(name) == {item}
                for name in spelled[item]
            )


@given(name=st.sampled_from(("Station 101", "Pharmacy Desk A", "dock", "Director's Office")))
def test_a_text_that_is_a_name_is_accepted(name: str) -> None:
    assert drive(name, name).steps


HALF_A_MINUTE = ("30 s", "30s", "(30 s)", "30 s,")
ORDINARY = ("then", "wait", "with", "scan.", "for", "slowly", "Dock")
JOINING = ("and", "plus", "to", "or", "of", "a")
FOREIGN = (
    *(
        "10",
        "2,",
        "1.",
        "1:",
        "2e3",
        "x7",
        "\u0663",
        "\u00bd",
        "500 ms",
        "1 h",
        "5 N",
        "two",
        "hundred",
    ),
    *(
        "hour",
        "half",
        "-",
        "+",
        "*",
        "x",
        "/",
        ":",
        "~",
        "<",
        "=",
        "%",
        "&",
        "\u2212",
        "\u00d7",
        "\u2063",
    ),
)


@given(
    st.lists(
        st.one_of(*map(st.sampled_from, (HALF_A_MINUTE, ORDINARY, JOINING, FOREIGN))), max_size=7
    )
)
def test_a_quantity_counts_only_among_ordinary_words(pieces: list[str]) -> None:
    """A word that joins is passed over: what it joins decides."""

    def ends_well(beside: list[str]) -> bool:
        return next((piece in ORDINARY for piece in beside if piece not in JOINING), True)

    places = [at for at, piece in enumerate(pieces) if piece in HALF_A_MINUTE]
    counts = [at for at in places if ends_well(pieces[:at][::-1]) and ends_well(pieces[at + 1 :])]
    joined = [at for at in counts if {*pieces[max(0, at - 1) : at]} & {*JOINING}]
    if waits(" ".join(pieces)):
        event("accepted")
        assert counts
    else:  # one that a word joins to what is before may be refused in doubt
        assert counts == joined
