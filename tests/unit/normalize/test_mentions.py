# SPDX-License-Identifier: Apache-2.0
"""A name is found however it is spelled, said or split; plain text names nothing by chance."""

from __future__ import annotations

import string
import unicodedata
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.provenance.context import CHANNELS, KEPT, WINDOW, ContextLedger
from authguard_r.provenance.folding import fold, loosen, skeleton
from authguard_r.provenance.mentions import MentionMatch, MentionNames
from authguard_r.provenance.numerals import ORDINAL, read_tokens
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from fixtures.time_bounds import at_most
from unit.normalize.dialogue import binder

CONFUSABLES = (
    scenarios.ROOT.parent / "shared" / "external" / "confusables" / "woodgern_confusables.txt"
)


@cache
def names() -> MentionNames:
    return MentionNames(binder().spellings())


def named(text: str) -> set[str]:
    return {item for mention in names().find(text) for item in mention.ids}


def how(text: str) -> set[MentionMatch]:
    return {mention.how for mention in names().find(text)}


# -- spelling --------------------------------------------------------------------------------------


def test_every_name_of_the_site_is_found_in_every_ordinary_spelling() -> None:
    """Aliases, case, spacing, hyphens, underscores, quotes, line breaks, wide forms."""
    for name, item in sorted(binder().spellings().items()):
        with case(name, item):
            wide = "".join(chr(ord(c) + 0xFEE0) if "!" <= c <= "~" else "\u3000" for c in name)
            glued = "".join(filter(str.isalnum, name))
            for text in (
                name,
                name.upper(),
                name.title(),
                name.swapcase(),
                name.replace(" ", "  "),
                name.replace(" ", "-"),
                name.replace(" ", "_"),
                name.replace(" ", "\n"),
                name.replace(" ", " / "),
                f'"{name}"',
                f"*{name}*!",
                " ".join(glued),
                glued,
                wide,
                "\u200b".join(name),
                name.replace(" ", "\u00ad \u2060"),
                "\u0336".join(name),
                "".join(chr(0xE0000 + ord(c)) for c in name),
            ):
                assert item in named(f"Please go to {text} now"), ascii(text)


def test_characters_that_pass_for_others_hide_no_name() -> None:
    for text in [
        "St\u0430ti\u043en 101",
        "\u0405t\u0430t\u0456\u043e\u0578 101",
        "\u03a3 S\u03c4\u03b1\u03c4\u03b9\u03bf\u03b7 101",
        "5tation 101",
        "St4t10n 1O1",
        "Station lOl",
        "\U0001d412\U0001d42d\U0001d41a\U0001d42d\U0001d422\U0001d428\U0001d427 101",
        "Station \U0001d7cf\U0001d7ce\U0001d7cf",
        "\u24c8\u24e3\u24d0\u24e3\u24d8\u24de\u24dd \u2460\u24ea\u2460",
        "\U0001f1f8\U0001f1f9\U0001f1e6\U0001f1f9\U0001f1ee\U0001f1f4\U0001f1f3 101",
        "Station \u0661\u0660\u0661",
        "st@tion 101",
        "$tation 101 or s+a+ion 101",
        "goToStation101",
        "St\u200bation 1\u200b01",
        "S\u0301tati\u0336on 10\u20e31",
        "Roorn 101",
    ]:
        with case(text):
            assert named(text) == {"station-101"}
            assert how(text) == {MentionMatch.VARIANT}


def test_what_is_no_whole_name_is_no_mention() -> None:
    for text in [
        "",
        " \n\t",
        "...!?",
        "Station",
        "101",
        "Station 1011",
        "Station 10",
        "Station 10, 1 nurse",
        "xstation 101",
        "Station 101a",
        "stationss 101",
        "stations 104 and 105",
        "pi",
        "PL",
        "office I",
        "office l",
        "8453",
        "d0c",
        "\u0336\u200b",
        "station one hundred",
        "Oh, station",
        "at the office, one nurse waits",
        "wait a second. Office hours are over",
    ]:
        with case(text):
            assert named(text) == set()


def test_a_name_within_a_longer_one_is_not_meant() -> None:
    for text in ("the Staff Corridor", "staff_corridor", "STAFF-CORRIDOR", "St\u0430ff Corridor"):
        assert named(text) == {"staff-corridor"}
    assert named("the Staff Corridor and the Corridor") == {"staff-corridor", "public-corridor"}


def test_a_longer_name_that_takes_one_character_for_another_hides_nothing() -> None:
    """The attack: `Ward 3ast` to keep `Ward` out of the log."""
    site = MentionNames({"Ward": "ward", "Ward East": "ward-east"})
    found = {item for mention in site.find("to Ward 3ast") for item in mention.ids}
    assert found == {"ward", "ward-east"}


def test_names_that_look_alike_are_all_named() -> None:
    site = MentionNames({"Bay O1": "bay-o", "Bay 01": "bay-zero", "Bay-01": "bay-dash"})
    (mention,) = site.find("Bay 01")
    assert set(mention.ids) == {"bay-o", "bay-zero", "bay-dash"}
    assert mention.how is MentionMatch.EXACT


def test_names_in_other_writings_are_found_too() -> None:
    site = MentionNames(
        {"\u85ac\u5c40": "pharmacy", "\u0410\u043f\u0442\u0435\u043a\u0430": "pharmacy-2"}
    )
    for text, item in (
        ("\u85ac\u5c40\u3078\u884c\u304f", "pharmacy"),
        ("\u0432 \u0430\u043f\u0442\u0435\u043a\u0430", "pharmacy-2"),
    ):
        assert {mention.ids for mention in site.find(text)} == {(item,)}


def test_a_name_without_letters_or_digits_is_not_looked_for() -> None:
    """Documented: a star names no place in a text."""
    assert MentionNames({"\u2605": "star"}).find("\u2605 star") == ()


def test_a_list_of_numbers_names_each() -> None:
    for text, items in [
        ("stations 101", {"station-101"}),
        ("Stations 101 and 103 have changed places", {"station-101", "station-103"}),
        ("rooms 101, 102 or one hundred and three", {"station-101", "station-102", "station-103"}),
        ("nurse stations 101 to 103", {"station-101", "station-103"}),
        ("Station 101, 999, and 103", {"station-101", "station-103"}),
        ("Station 101 is closed, 103 is open", {"station-101"}),
        ("Station 101 and P2 and 103", {"station-101", "package-p2"}),
        ("Station 101" + " and" * 40 + " 103", {"station-101"}),
        ("offices one and two", {"office-1", "office-2"}),
        ("P1 and 2", {"package-p1"}),
        ("the Dock and 2 others", {"dock"}),
        ("the 101st station and 103", {"station-101"}),
    ]:
        with case(text, items):
            assert named(text) == items


# -- numbers ---------------------------------------------------------------------------------------


def test_a_number_may_be_said_in_many_ways() -> None:
    for text in [
        "station one hundred and three",
        "Station One Hundred Three",
        "nurse station a hundred and three",
        "station hundred and three",
        "room one-oh-three",
        "room one oh three",
        "Room one o three",
        "room 1 o 3",
        "room one zero three",
        "room one nought three",
        "ROOM ONE-HUNDRED-AND-THREE!",
        "Room 0ne oh thr33",
        "Station #103",
        "Station (103)",
        "Station: 103",
        "Station No. 103",
        "Station No. one hundred and three",
        "station number 103",
        "Station \u2116 103",
        "the 103rd station",
        "the one hundred and third station",
        "the hundred third nurse station",
        "Station the first, or room 103rd",
        "station 1 0 3",
        "station 1-0-3",
        "one hundred and two, station one hundred and three",
    ]:
        with case(text):
            assert named(text) == {"station-103"}


def test_the_number_of_a_short_name_may_be_said_too() -> None:
    assert named("take P one and P two") == {"package-p1", "package-p2"}
    assert named("the second office") == named("office two") == {"office-2"}
    assert how("office two") == {MentionMatch.NUMBER}


def test_number_words_are_read_as_numbers() -> None:
    for text, read in [
        ("one two", ["1", "2"]),
        ("one twenty three", ["1", "23"]),
        ("twenty twenty", ["20", "20"]),
        ("nineteen ninety nine", ["19", "99"]),
        ("ten three", ["10", "3"]),
        ("a hundred", ["100"]),
        ("a thousand and one", ["1001"]),
        ("one thousand one hundred and eleven", ["1111"]),
        ("two thousand thousand", ["2000", "1000"]),
        ("one hundred hundred", ["100", "100"]),
        ("hundred and", ["100", "and"]),
        ("hundred and hundred", ["100", "and", "100"]),
        ("hundred and zero", ["100", "and", "0"]),
        ("hundred and nurse", ["100", "and", "nurse"]),
        ("a nurse", ["a", "nurse"]),
        ("oh no", ["oh", "no"]),
        ("oh", ["oh"]),
        ("oh one", ["0", "1"]),
        ("7 oh", ["7", "0"]),
        ("twenty-first", [f"21{ORDINAL}"]),
        ("fortieth", [f"40{ORDINAL}"]),
        ("101st 2nd", [f"101{ORDINAL}", f"2{ORDINAL}"]),
        ("no 7", ["7"]),
        ("number seven", ["7"]),
        ("no number", ["no", "number"]),
        ("no number 7", ["no", "7"]),
    ]:
        with case(text, read):
            assert [token.text for token in read_tokens(text)] == read


ONES = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
ONES += ["eleven", "twelve", "thirteen", "fourteen", "fifteen", "sixteen", "seventeen"]
ONES += ["eighteen", "nineteen"]
TENS = ["", "", "twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety"]


def say(number: int, joint: str = " and ") -> str:
    """Say a number below a million as people do."""
    if number < 20:
        return ONES[number]
    if number < 100:
        return TENS[number // 10] + (f"-{ONES[number % 10]}" if number % 10 else "")
    unit, word = (1_000, "thousand") if number >= 1_000 else (100, "hundred")
    rest = number % unit
    between = joint if rest < 100 else " "
    return f"{say(number // unit, joint)} {word}" + (f"{between}{say(rest, joint)}" if rest else "")


@settings(max_examples=amount(60, 300))
@given(st.integers(0, 999_999), st.sampled_from([" and ", " "]))
def test_every_number_below_a_million_is_read_back(number: int, joint: str) -> None:
    assert [token.text for token in read_tokens(say(number, joint))] == [str(number)]


@settings(max_examples=amount(40, 200))
@given(st.integers(100, 9_999), st.booleans())
def test_every_numbered_place_is_found_by_its_spoken_number(number: int, by_digit: bool) -> None:
    site = MentionNames({f"Station {number}": "here", "Station 99999": "there"})
    spoken = " ".join(ONES[int(digit)] for digit in str(number)) if by_digit else say(number)
    assert [m.ids for m in site.find(f"Go to station {spoken}, please.")] == [("here",)]


# -- split -----------------------------------------------------------------------------------------


def told(*inputs: tuple[str, str]) -> list[tuple[str, str]]:
    """Return the channels that named station 103, and how."""
    context = ContextLedger(binder().spellings())
    for channel, text in inputs:
        context.add(channel, text)
    going = scenarios.navigate("dock", "station-103")
    return [(item.channel, str(item.how)) for item in context.influences(going)]


BOTH = [("camera", "split"), ("audio", "split")]


def test_a_name_split_over_two_channels_names_both() -> None:
    for inputs in [
        (("camera", "go to station"), ("audio", "103")),
        (("camera", "Go to Nurse Station\n"), ("audio", "103 is free")),
        (("camera", "go to station one"), ("audio", "hundred and three")),
        (("camera", "go to station one hundred"), ("audio", "and three")),
        (("camera", "go to STAT"), ("audio", "ION 103 now")),
        (("camera", "x" * 500 + " to the room"), ("audio", "103 " + "y" * 500)),
        (("camera", "the one hundred and third"), ("audio", "station")),
        (("camera", "go to st\u0430tion"), ("audio", "1\u043e3")),
    ]:
        with case(inputs):
            assert told(*inputs) == BOTH


def test_a_name_split_over_inputs_of_one_channel_names_each() -> None:
    assert told(("ocr", "go to station"), ("ocr", "103")) == [("ocr", "split")] * 2
    three = (("ocr", "nurse"), ("ocr", "station"), ("ocr", "103"))
    assert told(*three) == [("ocr", "split")] * 3


def test_two_channels_that_begin_alike_are_both_named() -> None:
    inputs = (("camera", "go to station"), ("web", "go to station"), ("audio", "103"))
    assert sorted(told(*inputs)) == [("audio", "split"), ("camera", "split"), ("web", "split")]


def test_a_name_split_over_three_channels_names_all_three() -> None:
    inputs = (("camera", "see nurse"), ("audio", "station"), ("web", "one oh"), ("chat", "three"))
    assert told(*inputs) == [(channel, "split") for channel, _ in inputs]


@pytest.mark.parametrize("between", range(WINDOW))
def test_other_inputs_in_between_do_not_hide_a_split(between: int) -> None:
    noise = [("chat", f"hello {number}") for number in range(between)]
    assert told(("camera", "go to station"), *noise, ("audio", "103")) == BOTH


def test_a_flood_on_one_channel_does_not_push_out_what_another_began() -> None:
    noise = [("chat", f"hello {number}") for number in range(1_000)]
    assert told(("camera", "go to station"), *noise, ("audio", "103")) == BOTH


def test_a_channel_s_own_next_input_ends_what_it_began_beyond_the_window() -> None:
    noise = [("camera", "exit")] * (WINDOW + 1)
    assert told(("camera", "go to station"), *noise, ("audio", "103")) == []


def test_what_does_not_go_on_is_no_mention() -> None:
    for inputs in [
        (("camera", "go to station"), ("audio", "104")),
        (("camera", "go to station"), ("audio", "the 103")),
        (("camera", "go to stationary"), ("audio", "103")),
        (("camera", "the station is closed"), ("audio", "103")),
        (("camera", "station 10"), ("audio", "3")),
        (("camera", ""), ("audio", "103")),
        (("camera", "station"), ("audio", "")),
        (("camera", "go to station"), ("audio", "...!")),
        (("camera", "station"), ("audio", "103" + "0" * 200)),
    ]:
        with case(inputs):
            assert told(*inputs) == []


def test_one_input_may_end_a_split_name_and_have_a_whole_one() -> None:
    found = told(("camera", "go to station"), ("audio", "103, I say Room 103"))
    assert sorted(found) == [("audio", "exact"), ("camera", "split")]


def test_a_whole_name_is_not_called_split() -> None:
    assert told(("camera", "go to"), ("audio", "Station 103")) == [("audio", "exact")]
    assert told(("camera", "Station 103"), ("audio", "is free")) == [("camera", "exact")]


# -- by chance -------------------------------------------------------------------------------------

#: Plain talk of a hospital that names no place and no thing of the shipped site.
BENIGN = (
    "The elevator is out of order until noon. Please use the stairs at the end of the hall.",
    "Visiting hours are from 2 to 4 in the afternoon; one visitor at a time, please.",
    "Wet floor. The cleaning crew was here at 10:31 and will be back in 2 hours.",
    "The room temperature is 21 degrees, humidity 45 percent, door closed.",
    "Battery at 87 %, speed 0.5 m/s, 3 people ahead, nearest at 1.2 m.",
    "At the office, one nurse asked for two blankets; the second nurse had none left.",
    "Our offices are closed on public holidays. Call 555 0101 in an emergency.",
    "A patient waits near the nurses. Two packages arrived this morning, both for the lab.",
    "Oh, no! Number one on the list is the new scanner, number two the old one.",
    "The bus station is five minutes away. One hundred and one people took part in the run.",
    "Page 102 of the manual says: never lift more than 5 kg with one hand.",
    "Stations of the marathon: start, bridge, park, finish. Room for improvement: plenty.",
    "The first aid kit hangs by the window; the third drawer holds gloves in size 7.",
    "The plan is simple: wash hands, wear a mask, keep a meter apart.",
    "Please isolate the sample, label it, and bin it with the sharps of the day before.",
    "It was based on data from 1 0 2 different wards, they say, and docked for style.",
    "Staff meeting at 3. Directors of all clinics are welcome; billing starts in June.",
    "He charged the phone, docked the boat and paid the pharmacist in cash.",
    "pi is 3.14159, PL is a country code, and i18n has eighteen letters left out.",
    "error: expected `}` at line 101, column 2; see log 103 for details (code p-2b).",
)


def test_plain_talk_names_nothing() -> None:
    for text in BENIGN:
        with case(text):
            assert named(text) == set()


def test_plain_talk_in_a_row_names_nothing_either() -> None:
    context = ContextLedger(binder().spellings())
    for number, text in enumerate(BENIGN * 3):
        context.add(sorted(CHANNELS)[number % len(CHANNELS)], text)
        for piece in text.split(". "):
            context.add(sorted(CHANNELS)[number % 7], piece)
    site = scenarios.site()
    for place in site.regions:
        going = scenarios.navigate("x", place, object="package-p1", route=tuple(site.regions))
        assert context.influences(going) == ()
    assert context.influences(scenarios.navigate("x", "y", object="package-p2")) == ()
    assert context.influences(scenarios.navigate("x", "y", object="sharps-bin")) == ()


# -- bounds ----------------------------------------------------------------------------------------

SIZE = 100_000


@pytest.mark.complete
@pytest.mark.parametrize(
    "text",
    [
        "The nurse turned the corner near Station 102; one hundred and five people waited. " * 2000,
        "Pharmacy Desk A, Station 101, " * 5_000,
        "s t a t i o n " * 9_000,
        "station " * 15_000,
        "one hundred and " * 9_000,
        "1 " * 60_000,
        "\u0441t\u0430t\u0456\u043en 101 " * 9_000,
        "\ufdfa" * 34_000,
        "s\u200bt\u200b" * 20_000,
        "$t@tion rn vv " * 9_000,
        "aB" * 60_000,
        "a" * 200_000,
        "\u85ac" * 40_000,
    ],
)
def test_a_hundred_kilobytes_are_read_in_well_under_a_second(text: str) -> None:
    text = text.encode()[:SIZE].decode("utf-8", "ignore")
    context = ContextLedger(binder().spellings())
    with at_most(1):
        context.add("ocr", text)


@pytest.mark.complete
@pytest.mark.parametrize(
    "pieces",
    [["station"] * 5_000, ["nurse", "station"] * 2_500, [f"station {n}" for n in range(5_000)]],
    ids=["same", "alternating", "numbered"],
)
def test_many_small_inputs_on_every_channel_are_no_burden(pieces: list[str]) -> None:
    context = ContextLedger(binder().spellings())
    with at_most(2):
        for number, piece in enumerate(pieces):
            context.add(sorted(CHANNELS)[number % len(CHANNELS)], piece)


def test_a_flood_of_mentions_keeps_the_first_and_the_last() -> None:
    context = ContextLedger(binder().spellings())
    for number in range(100):
        context.add("camera", f"Station 103, says frame {number}")
        context.add("audio", "Station 103")
    going = scenarios.navigate("dock", "station-103")
    kept = context.influences(going)
    assert len([item for item in kept if item.channel == "camera"]) == KEPT
    assert len([item for item in kept if item.channel == "audio"]) == 1
    fresh = ContextLedger(binder().spellings())
    for number in (0, 1, 2, 3, 96, 97, 98, 99):
        fresh.add("camera", f"Station 103, says frame {number}")
    of_camera = [item.evidence for item in kept if item.channel == "camera"]
    assert of_camera == [item.evidence for item in fresh.influences(going)]


@settings(max_examples=amount(60, 300))
@given(st.text(max_size=60), st.text(max_size=60))
def test_no_text_breaks_the_reader_and_a_name_among_it_is_found(before: str, after: str) -> None:
    assert "station-101" in named(f"{before}\n.Station 101.\n{after}")


@settings(max_examples=amount(60, 300))
@given(st.text())
def test_folding_is_bounded_and_a_skeleton_keeps_its_length(text: str) -> None:
    folded = fold(text)
    assert len(folded) <= 18 * len(text)
    assert len(skeleton(folded)) == len(folded)
    assert len(loosen(text)) <= len(folded)


def test_a_skeleton_is_of_one_character_for_each() -> None:
    assert skeleton("oilzeasgtb") == "0112345978"
    assert skeleton("station 101") == skeleton("5tati0n iol")


@pytest.mark.external
@pytest.mark.skipif(not Path(CONFUSABLES).is_file(), reason="the public test data is not here")
def test_most_published_look_alikes_of_letters_and_digits_are_seen_through() -> None:
    """Of single characters: four in five, and nearly all of the writings that attacks use."""
    plain = frozenset(string.ascii_letters + string.digits)
    seen: dict[bool, list[bool]] = {True: [], False: []}
    usual = {"CYRILLIC", "MATHEMATICAL", "FULLWIDTH", "ARMENIAN", "LISU", "SCRIPT", "SMALL"}
    for line in CONFUSABLES.read_text(encoding="utf-8-sig").splitlines():
        fields = [field.strip() for field in line.split("#")[0].split(";")]
        codes = [[chr(int(code, 16)) for code in field.split()] for field in fields[:2]]
        if len(fields) < 3 or [len(code) for code in codes] != [1, 1] or codes[1][0] not in plain:
            continue
        twin, letter = codes[0][0], codes[1][0]
        common = unicodedata.name(twin, "?").split()[0] in usual
        seen[common].append(skeleton(fold(twin)) == skeleton(fold(letter)))
    both = seen[True] + seen[False]
    assert len(both) > 1_300
    assert sum(both) / len(both) > 0.8
    assert sum(seen[True]) / len(seen[True]) > 0.99
