# SPDX-License-Identifier: Apache-2.0
"""The template grammar: what a sentence grants, and what it must be asked before it grants."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.authoring.drafting.proposal import clarification
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Comparison, DataRights
from authguard_r.site.model import ObjectModel, Site
from authguard_r.site.words import standard_words
from fixtures import scenarios
from fixtures.cases import case
from unit.drafting.drafts import GIVEN, asked_about, compiled, fields, mission, propose, shape

DELIVERY = [
    ("navigate", None, "pharmacy"),
    ("pick", "package-p1", None),
    ("navigate", None, "station-101"),
    ("place", "package-p1", "station-101"),
]
VISIT = [("navigate", None, "station-102")]


def test_a_delivery_is_going_there_picking_carrying_placing() -> None:
    for sentence in [
        "Deliver package P1 to station 101.",
        "Bring P1 from the pharmacy to Nurse Station 101, please",
        "courier-1, carry the Medicine Package P1 to room 101",
        "Take package-p1 to station-101",
        "Could you transport P1 into Station 101?",
        "Fetch P1 from the pharmacy to Station 101",
        "get P1 to room 101",
        "Pick up P1 and put it in station 101",
        "Pick up P1, then place it in Room 101.",
        "Return P1 to station 101",
        "Move P1 to station 101",
    ]:
        with case(sentence):
            made = mission(sentence)
            assert shape(made.actions) == DELIVERY
            assert [grant.completes for grant in made.actions] == [False, False, False, True]
            assert made.task == sentence
            assert made.objects == ("package-p1",)
            assert made.regions == ("dock", "pharmacy", "public-corridor", "station-101")


def test_a_visit_is_one_motion_that_records_nothing() -> None:
    for sentence in [
        "Go to station 102",
        "drive to Nurse Station 102.",
        "move to Room 102",
        "Guide the visitor to station 102",
        "Escort the patient to Station 102",
        "Patrol station 102",
        "Inspect Room 102 without recording",
        "check station 102, do not record",
    ]:
        with case(sentence):
            made = mission(sentence)
            assert shape(made.actions) == VISIT
            assert made.actions[0].data == DataRights()
            assert made.budgets.recorded_bytes == 0


@pytest.mark.parametrize(
    "sentence", ["Patrol stations 101, 102 and 103", "patrol Station 101, Room 102 and Station 103"]
)
def test_a_patrol_goes_in_the_order_of_the_sentence(sentence: str) -> None:
    made = mission(sentence)
    assert [end for _, _, end in shape(made.actions)] == [
        "station-101",
        "station-102",
        "station-103",
    ]
    assert [len(grant.after) for grant in made.actions] == [0, 1, 1]


def test_a_patrol_twice_comes_back_for_the_second_round() -> None:
    ends = [end for _, _, end in shape(mission("patrol stations 101 and 102 twice").actions)]
    assert ends == ["station-101", "station-102"] * 2


@pytest.mark.parametrize(
    ("sentence", "kind"),
    [
        ("Record the pharmacy for 30 s", "record_video"),
        ("Film the pharmacy for up to 30 seconds", "record_video"),
        ("Take a photo of the pharmacy", "take_photo"),
        ("photograph the pharmacy", "take_photo"),
        ("Inspect the pharmacy with recording", "take_photo"),
    ],
)
def test_a_recording_has_the_rights_that_were_said_and_a_bound(sentence: str, kind: str) -> None:
    made = mission(sentence, data__store="no", data__transmit="no")
    grant = made.actions[-1]
    assert grant.type == kind
    assert grant.data == DataRights(record=True)
    assert {limit.parameter for limit in grant.limits} >= {"max_bytes"}
    assert made.budgets.recorded_bytes == 10_000_000 * grant.starts


@pytest.mark.parametrize(
    "sentence", ["Wait 30 s at the pharmacy", "pause for 30 seconds in Pharmacy"]
)
def test_a_wait_is_as_long_as_it_was_said(sentence: str) -> None:
    made = mission(sentence)
    wait = made.actions[-1]
    assert (wait.type, wait.limits[0].high, wait.max_ms) == ("wait", 30_000, 35_000)
    assert made.budgets.wait_ms == 35_000 * wait.starts


@pytest.mark.parametrize(
    ("sentence", "comparison", "value"),
    [
        ("return to base when the battery is low", Comparison.LT, 200),
        ("Go home if the battery falls below 15 %", Comparison.LT, 150),
        ("When the battery is low, return to the dock", Comparison.LT, 200),
        ("return home once the battery level is under 20 percent", Comparison.LT, 200),
    ],
)
def test_the_papers_return_mission_has_its_battery_guard(
    sentence: str, comparison: Comparison, value: int
) -> None:
    (grant,) = mission(sentence).actions
    assert [(g.variable, g.comparison, g.value) for g in grant.guards] == [
        ("battery_permille", comparison, value)
    ]
    assert {row.destination for row in grant.alternatives} == {"dock"}
    assert grant.chooser == "trusted_sensor"
    entered = {region for row in grant.alternatives for region in row.regions}
    assert not entered & {"office-1", "office-2", "isolation-room", "plant-room"}


@pytest.mark.parametrize("sentence", ["return to base", "Go home."])
def test_a_return_without_a_condition_is_asked_about(sentence: str) -> None:
    asked = propose(sentence)
    assert asked.draft == {}
    assert fields(asked) == {"condition": ("when the battery is low", "always")}
    guarded = mission(sentence, condition="when the battery is low").actions[0]
    assert [guard.variable for guard in guarded.guards] == ["battery_permille"]
    assert mission(sentence, condition="always").actions[0].guards == ()


def test_a_condition_between_two_clauses_belongs_to_the_second() -> None:
    made = mission("Go to station 101, when the battery is low, return to base")
    assert [bool(grant.guards) for grant in made.actions] == [False, True]
    asked = propose("Go to station 101, when the battery is low")
    assert fields(asked) == {"condition": ()}
    assert asked_about(asked, "when the battery is low") == ["condition"]


def test_rights_that_the_sentence_settles_are_not_asked_for() -> None:
    made = mission("Record the pharmacy for 30 s and store it, do not transmit it")
    assert made.actions[-1].data == DataRights(record=True, store=True)
    asked = propose("Record the pharmacy for 30 s and send it to office 1")
    assert asked_about(asked, "send") == ["condition"]


@pytest.mark.parametrize("more", ["", " within 1 h"])
def test_in_ten_minutes_may_be_the_begin_or_the_end_and_is_asked_about(more: str) -> None:
    asked = propose(f"go to station 101 in 10 minutes{more}", given={})
    (question,) = [one for one in asked.questions if one.field == "window"]
    assert question.question.startswith("`in 10 minutes` may be the begin or the end. How long")


@pytest.mark.parametrize(
    "sentence",
    [
        "go to station 101 within 5 min within 1 h",
        "go to station 101 before 14:30 until 15:00",
        "inspect the pharmacy without recording and with recording",
        "go to station 101 at 0.2 m/s at 0.9 m/s",
        "go to station 101 when the battery is low if the battery is above 90 %",
        "patrol station 101 twice once",
    ],
)
def test_terms_that_contradict_each_other_are_asked_about(sentence: str) -> None:
    asked = propose(sentence)
    assert asked.draft == {}
    assert any(" not understood" in q.question for q in asked.questions)


def test_a_return_after_something_waits_for_it() -> None:
    made = mission("Deliver P1 to station 101, then return to base")
    assert made.actions[-1].after == ("place-package-p1",)
    assert made.actions[-1].completes


def test_a_return_on_low_battery_does_not_wait_for_the_delivery() -> None:
    made = mission("Deliver P1 to station 101 and return to base when the battery is low")
    assert made.actions[-1].after == ()
    assert not made.actions[-1].completes
    assert made.actions[-2].completes
    assert made.actions[-2].guards[0].variable == "holding"


def test_the_package_and_the_office_are_two_questions() -> None:
    asked = propose("bring the package to the office")
    assert fields(asked) == {
        "object": ("package-p1", "package-p2"),
        "destination": ("office-1", "office-2"),
    }
    assert asked.draft == {}
    answered = mission(
        "bring the package to the office", object="package-p2", destination="office-1"
    )
    assert shape(answered.actions)[-1] == ("place", "package-p2", "office-1")


def test_answers_may_come_one_at_a_time() -> None:
    asked = propose("bring the package to the office", object="package-p2")
    assert fields(asked) == {"destination": ("office-1", "office-2")}


def test_everything_that_is_open_is_asked_at_once_the_sentence_first() -> None:
    asked = propose("bring the package to the office", robot=None, given={})
    assert list(fields(asked)) == ["object", "destination", "robot", "window", "issuer"]
    error = clarification(asked.questions)
    assert [error.field, *(other.field for other in error.others)] == [
        question.field for question in asked.questions
    ]


def test_inspecting_the_room_asks_which_and_for_each_data_right() -> None:
    asked = fields(propose("inspect the room"))
    assert list(asked) == ["destination", "data.record", "data.store", "data.transmit"]
    assert "isolation-room" in asked["destination"]
    assert asked["data.record"] == ("yes", "no")


@pytest.mark.parametrize(
    ("sentence", "first"),
    [
        ("Deliver P1 to station 101 by half past two", "2026-01-01T14:30:00Z"),
        ("Deliver P1 to station 101 before 14:30", "2026-01-01T14:30:00Z"),
        ("Deliver P1 to station 101 until 2:30 pm tomorrow", "2026-01-02T14:30:00Z"),
        ("Deliver P1 to station 101 no later than noon", "2026-01-01T12:00:00Z"),
    ],
)
def test_a_time_without_its_date_or_zone_is_asked_about(sentence: str, first: str) -> None:
    asked = propose(sentence, given={"issuer": "operator-1"})
    assert list(fields(asked)) == ["window.expiry"]
    assert fields(asked)["window.expiry"][0] == first
    made = mission(sentence, given={"issuer": "operator-1"}, window__expiry=first)
    assert made.expiry == first


@pytest.mark.parametrize(
    ("sentence", "begin", "end"),
    [
        ("Go to station 101 within 25 minutes", "2026-01-01T10:00:00Z", "2026-01-01T10:25:00Z"),
        ("Go to station 101 in the next hour", None, None),
        (
            "Go to station 101 before 2026-01-01T14:30:00Z",
            "2026-01-01T10:00:00Z",
            "2026-01-01T14:30:00Z",
        ),
        ("Go to station 101 by 14:30 UTC today", "2026-01-01T10:00:00Z", "2026-01-01T14:30:00Z"),
    ],
)
def test_a_window_that_was_said_in_full_is_taken(
    sentence: str, begin: str | None, end: str | None
) -> None:
    asked = propose(sentence, given={"issuer": "operator-1"})
    if begin is None:
        assert asked_about(asked, "hour") == ["duration"]  # it has no number: how many?
        return
    made = compiled(asked)
    assert (made.not_before, made.expiry) == (begin, end)


def test_a_window_is_asked_for_and_takes_a_duration_or_an_instant() -> None:
    given = {"issuer": "operator-1"}
    assert fields(propose("go to station 101", given=given)) == {"window": ()}
    assert mission("go to station 101", given=given, window="10 min").expiry == (
        "2026-01-01T10:10:00Z"
    )
    made = mission("go to station 101", given=given, window="2026-01-01T11:00:00Z")
    assert made.expiry == "2026-01-01T11:00:00Z"
    with pytest.raises(MalformedError, match="duration"):
        propose("go to station 101", given=given, window="soon")
    over = propose("go to station 101 until 2025-01-01T00:00:00Z", given=given)
    assert "window.end" in fields(over)


def test_at_two_is_a_time_or_a_speed_and_is_asked_about() -> None:
    asked = fields(propose("go to station 101 at 2"))
    assert asked["at"] == (
        "2 m/s",
        "2 km/h",
        "2026-01-01T14:00:00Z",
        "2026-01-02T02:00:00Z",
        "2026-01-02T14:00:00Z",
    )
    made = mission("go to station 101 at 2", at="2026-01-01T14:00:00Z")
    assert (made.not_before, made.expiry) == ("2026-01-01T14:00:00Z", "2026-01-01T14:25:00Z")
    begin = propose("go to station 101 at 14:00")
    assert fields(begin)["window.not_before"][0] == "2026-01-01T14:00:00Z"


@pytest.mark.parametrize(
    ("sentence", "field", "candidates"),
    [
        ("go to station 101 speed 0.8", "limits.speed_mm_s", ("0.8 m/s", "0.8 km/h", "0.8 mm/s")),
        ("go to station 101 at a speed of 0.8", "limits.speed_mm_s", None),
        ("deliver P1 to station 101 with a force of 5", "limits.force_mn", ("5 N", "5 mN")),
        ("wait at the pharmacy for 5", "duration", ("5 s", "5 min", "5 h")),
        ("wait at the pharmacy", "duration", ()),
    ],
)
def test_a_number_without_its_unit_is_asked_about(
    sentence: str, field: str, candidates: tuple[str, ...] | None
) -> None:
    asked = fields(propose(sentence))
    assert field in asked
    assert candidates is None or asked[field] == candidates


def test_a_speed_that_was_said_is_the_upper_bound() -> None:
    (grant,) = mission("go to station 101 at 0.8 m/s").actions
    assert (grant.limits[0].low, grant.limits[0].high) == (50, 800)
    (slow,) = mission("go to station 101 at most 20 mm/s").actions
    assert (slow.limits[0].low, slow.limits[0].high) == (20, 20)
    settled = mission("go to station 101 speed 0.8", limits__speed_mm_s="0.8 m/s")
    assert settled.actions[0].limits[0].high == 800


@pytest.mark.parametrize("said", ["3 m/s", "0 m/s", "1 km/h"])
def test_a_speed_that_the_robot_cannot_do_exactly_is_asked_about(said: str) -> None:
    asked = fields(propose(f"go to station 101 at {said}"))
    assert list(asked) == ["limits.speed_mm_s"]
    made = mission(f"go to station 101 at {said}", limits__speed_mm_s="1.5 m/s")
    assert made.actions[0].limits[0].high == 1500
    with pytest.raises(MalformedError):
        propose(f"go to station 101 at {said}", limits__speed_mm_s="2 m/s")


def test_an_unsaid_speed_is_the_profiles_upper_bound_and_is_marked() -> None:
    made = propose("go to station 101")
    (grant,) = compiled(made).actions
    assert grant.limits[0].high == 500
    assert "limits.speed_mm_s" in {item.field for item in made.assumed}
    (gentle,) = mission("go slowly to station 101").actions
    assert gentle.limits[0].high == 250
    (guide,) = mission("guide the visitor to station 101").actions
    assert guide.limits[0].high == 400


def test_words_that_nothing_explains_are_asked_about_at_the_slot_they_could_change() -> None:
    for sentence, word, field, candidates in [
        ("quietly go to station 101", "quietly", "speed", ("leave it out",)),
        ("go to station 101 hurriedly", "hurriedly", "speed", ("leave it out",)),
        ("firmly pick up P1", "firmly", "force", ("leave it out",)),
        ("pick up P1 with force", "with force", "force", ()),
        ("bring P1 to the private station 101", "private", "destination", ("station-101",)),
        ("bring the heavy P1 to station 101", "heavy", "object", ("package-p1",)),
        ("bring the heavy package to station 101", "heavy", "object", ("package-p1", "package-p2")),
        ("bring P1 to station 101 with the patient", "patient", "object", ()),
        ("bring P1 from the dusty pharmacy to dock", "dusty", "source", ("pharmacy",)),
        ("go to station 101 & office 1", "&", "destination", ("station-101",)),
        ("inspect P1 via office 1 without recording", "office 1", "route", ()),
        (
            "bring the package with the red label to dock",
            "with the red label",
            "object",
            ("package-p1", "package-p2"),
        ),
        ("deliver P1 around noon to station 101", "around noon", "destination", ()),
        ("hello", "hello", "condition", ()),
        ("go home and glow", "glow", "condition2", ()),
        ("deliver P1 to station 101, glow", "glow", "condition", ()),
        ("pick up P1 and zorb P2", "zorb", "condition", ()),
        ("wait at the pharmacy for a few seconds", "seconds", "duration", ()),
        ("go to station 101, then bring P1 to the wet dock", "wet", "step2.destination", ("dock",)),
    ]:
        with case(sentence, word, field, candidates):
            asked = propose(sentence)
            assert asked_about(asked, word) == [field]
            assert fields(asked)[field] == candidates
            assert asked.draft == {}


@pytest.mark.parametrize(
    ("sentence", "places"),
    [
        ("bring P1 near station 101", ("station-101", "public-corridor", "staff-corridor")),
        ("bring P1 next to the sharps bin", ("sharps-bin", "station-102")),
        ("wait outside office 1 for 5 s", ("office-1", "public-corridor")),
    ],
)
def test_near_a_place_is_asked_about_with_what_lies_there(
    sentence: str, places: tuple[str, ...]
) -> None:
    asked = fields(propose(sentence))
    assert set(asked["destination"]) == set(places)
    answered = propose(sentence, destination=places[1])
    assert "destination" not in fields(answered)


def test_an_answer_that_names_the_thing_settles_the_words_at_it() -> None:
    answered = mission("bring the heavy P1 to station 101", object="package-p1")
    assert shape(answered.actions) == DELIVERY
    for wrong in ("package-p2", "leave it out"):
        with pytest.raises(MalformedError, match="expected one of"):
            propose("bring the heavy P1 to station 101", object=wrong)
    unnamed = propose("deliver zorb to station 101")
    assert asked_about(unnamed, "zorb") == ["object"]
    settled = propose("deliver zorb to station 101", object="package-p1")
    assert shape(compiled(settled).actions) == DELIVERY
    assert any("zorb" in item.why for item in settled.assumed if item.field == "object")
    waited = propose("wait at the pharmacy for a few seconds", duration="5 s")
    assert compiled(waited).actions[-1].limits[0].high == 5_000


def test_an_answer_to_another_question_of_the_slot_does_not_settle_a_phrase_without_use() -> None:
    """The object is answered; the thing that goes with it is still a question of its own."""
    sentence = "bring the package to station 101 using P2"
    assert fields(propose(sentence, object="package-p1")) == {"object2": ()}
    again = propose(sentence, object="package-p1", object2="leave it out")
    assert fields(again) == {"object2": ()}


#: Words that limit; some lost their apostrophe, or have another one.
LIMITS = (
    "dont mustn't mustn\u2019t mustn\u02bct shouldn't won't wont cant neither nobody "
    "refuse refrain exclusively solely just merely excluding skip prohibited whenever "
    "during provided slower fewer maximum rarely never avoid except later tomorrow"
)


def test_a_word_that_limits_cannot_be_left_out() -> None:
    """Leaving it out would grant what the sentence holds back."""
    for sentence in [
        "do not enter office 1 and go to station 101",
        "deliver P1 to station 101, don't go to office 1",
        "Never go to office 1",
        "go to station 101 unless it is dark",
        "go to station 101 after the patient left",
        "go to station 101 if the door is open",
        "bring P1 to station 101 or station 102",
        "go to station 101 at least 0.5 m/s",
        "go to station 101 without leaving the corridor",
        "go to station 101. Requirement: stay on the left",
        "go to station 101, ensuring quiet",
        "go to station 101 within three steps",
        *(
            f"bring P1 to Station 101{mark} {word} go to Station 102"
            for mark in (";", "")
            for word in LIMITS.split()
        ),
    ]:
        with case(sentence):
            (field,) = [name for name in fields(propose(sentence)) if name.endswith("condition")]
            assert fields(propose(sentence))[field] == ()
            for answer in ("leave it out", "always", "when the battery is low"):
                answered = propose(sentence, given={**GIVEN, field: answer})
                assert answered.draft == {}
                assert fields(answered)[field] == ()


@pytest.mark.parametrize("word", ["kept", "zorb", "gently-ish", "dry", "notwithstanding"])
def test_only_words_known_to_be_harmless_can_be_left_out(word: str) -> None:
    """No list of limiting words is complete: a word on no list can be said otherwise only."""
    sentence = f"bring P1 to Station 101, {word}, and go to Station 102"
    asked = propose(sentence)
    assert asked.questions
    assert all("leave it out" not in candidates for candidates in fields(asked).values())
    answers = dict.fromkeys(fields(asked), "leave it out")
    assert propose(sentence, given={**GIVEN, **answers}).draft == {}


def test_more_than_one_word_behind_a_noun_is_no_label_of_it() -> None:
    """`A` may name the package; `as yet unopened boxes` says something that nobody understood."""
    assert fields(propose("go to station 101 A"))["destination"] == ("station-101",)
    asked = propose("go to station 101 zorb glow")
    assert fields(asked) == {"destination": ()}
    assert propose("go to station 101 zorb glow", destination="station-101").draft == {}


@pytest.mark.parametrize(
    ("sentence", "slow"),
    [
        ("go to Station 101 and then slowly drive home", [False, True]),
        ("go to Station 101, slowly go to Station 102", [False, True]),
        ("go to Station 101, slowly and go to Station 102", None),
        ("go to Station 101, slowly, go to Station 102", None),
        ("go to Station 101, carefully slowly please go home", [False, True]),
        ("slowly go to Station 101, then go home", [True, False]),
        ("go to Station 101 slowly, then go home", [True, False]),
        ("go to Station 101, then go home, slowly.", [False, True]),
        ("go to Station 101 and courier-1 slowly go home", [False, True]),
    ],
)
def test_a_manner_never_slows_another_clause_than_its_own(
    sentence: str, slow: list[bool] | None
) -> None:
    """Slowing the wrong one would let the robot hurry where it was told not to."""
    made = propose(sentence)
    if slow is None:
        assert asked_about(made, "slowly")
        assert not any(fields(made).values())
        return
    highs = [grant.limits[0].high for grant in compiled(made).actions]
    assert highs == [250 if careful else 500 for careful in slow]


def test_a_robot_in_the_place_of_a_thing_or_a_region_never_vanishes() -> None:
    for sentence, field in [
        ("put P1 into courier-1 at Station 101", "destination"),
        ("take P1 from courier-1 to Station 101", "source"),
        ("go to Station 101 to courier-1", "destination2"),
        ("go to Station 101 near courier-1", "destination2"),
        ("go to Station 101 with courier-1", "object"),
        ("with courier-1 go to Station 101", "condition"),
        ("go to Station 101 and courier-1", "destination2"),
        ("go to Station 101, then courier-1", "destination2"),
        ("pick up P1 and courier-1", "object2"),
    ]:
        with case(sentence, field):
            asked = propose(sentence)
            assert field in fields(asked)
            assert asked.draft == {}


def test_a_robot_that_is_spoken_to_is_no_place() -> None:
    for sentence in (
        "courier-1, go to Station 101",
        "go to Station 101, courier-1",
        "courier-1 please go to Station 101",
    ):
        assert shape(mission(sentence).actions) == [("navigate", None, "station-101")]
    both = mission("go to Station 101 and courier-1 please go home")
    assert [place for _, _, place in shape(both.actions)] == ["station-101", "dock"]


def test_a_second_value_of_one_quantity_is_a_question_that_no_answer_settles() -> None:
    """Whichever was taken, the other one would have been said for nothing."""
    for sentence, settled in [
        ("go to Station 101 at 0.3 at 0.5 m/s", {"at": "0.3 m/s"}),
        ("go to Station 101 at 0.5 m/s at 0.3", {"at": "0.3 m/s"}),
        ("go to Station 101 at 0.5 m/s at 0.5", {"at": "0.5 m/s"}),
        ("go to Station 101 at 0.3 at 0.5", {"at": "0.3 m/s"}),
        ("go to Station 101 at 0.3 speed 0.5", {"at": "0.3 m/s", "limits.speed_mm_s": "0.5 m/s"}),
        ("wait at the pharmacy for 30 for 40 s", {"duration": "30 s"}),
        ("go to Station 101 at 14:30 at 2", {"at": "2026-01-01T14:00:00Z"}),
        (
            "go to Station 101 at 2 and go to Station 102 at 3",
            {"at": "2026-01-01T14:00:00Z", "step2.at": "2026-01-01T15:00:00Z"},
        ),
    ]:
        with case(sentence, settled):
            asked = propose(
                sentence, given={**GIVEN, "window.not_before": "2026-01-01T14:30:00Z", **settled}
            )
            assert asked.draft == {}
            assert any("say one of them only" in question.question for question in asked.questions)


def test_a_phrase_that_no_step_uses_is_asked_about() -> None:
    """What was said and then not used would be a condition that vanished."""
    for sentence, word, field in [
        ("go to the pharmacy with P1", "P1", "object"),
        ("go with P1 to the pharmacy", "P1", "object"),
        ("return from station 101 to base when the battery is low", "station 101", "source"),
        ("escort P1 to station 101", "P1", "object"),
        ("inspect the pharmacy in station 101 without recording", "station 101", "destination"),
        ("pick up P1 from station 101 in office 1", "office 1", "destination"),
        ("deliver P1 to station 101 twice", "2 times", "count"),
        ("go to station 101 three times", "3 times", "count"),
        ("go to station 101 with 20 N", "20 N", "force"),
        ("go to station 101 for 30 s", "30 s", "duration"),
        ("go to station 101 without recording", "record", "data.record"),
    ]:
        with case(sentence, word, field):
            assert asked_about(propose(sentence), word) == [field]


def test_a_thing_is_inspected_where_the_sentence_says_it_is() -> None:
    given = {**GIVEN, "data.record": "yes", "data.store": "no", "data.transmit": "no"}
    made = mission("inspect P1 in station 102", given=given)
    assert shape(made.actions)[0] == ("navigate", None, "station-102")


def test_a_word_is_left_out_only_when_a_person_says_so() -> None:
    answered = propose("quietly go to station 101", speed="leave it out")
    assert shape(compiled(answered).actions) == [("navigate", None, "station-101")]
    assert ("speed", '"quietly" left out') in {(i.field, i.value) for i in answered.assumed}


@pytest.mark.parametrize(
    ("sentence", "settled"),
    [
        ("bring the package to office 1", {"object": "sharps-bin"}),
        ("go to station 101", {"colour": "red"}),
        ("go to station 101", {"robot": "rover"}),
        ("go to station 101", {"mission": "Not An Id"}),
        ("wait at the pharmacy", {"duration": "soon"}),
    ],
)
def test_an_answer_that_is_no_candidate_or_that_nobody_asked_for_is_refused(
    sentence: str, settled: dict[str, str]
) -> None:
    with pytest.raises(MalformedError):
        propose(sentence, **settled)


@pytest.mark.parametrize(
    "text", ["", "  \n", "x" * 2001, "go to\u202e station", "Cafe\u0301", "a\x00b"]
)
def test_text_that_cannot_be_shown_and_signed_is_refused(text: str) -> None:
    with pytest.raises(MalformedError) as refused:
        propose(text)
    assert refused.value.where.startswith("sentence")


def test_a_look_alike_letter_makes_another_word() -> None:
    asked = propose("bring P1 to st\u0430tion 101")  # a Cyrillic letter
    assert asked_about(asked, "st\u0430tion") == ["destination"]


def test_a_sentence_that_asks_for_nothing_grants_nothing() -> None:
    for sentence in ("hello", "please", "find nothing", "leave P1 there"):
        assert propose(sentence).draft == {}
        assert propose(sentence).questions


def test_a_pronoun_needs_exactly_one_antecedent() -> None:
    asked = fields(propose("pick up P1 and P2 and put it in station 101"))
    assert asked["step2.object"] == ("package-p1", "package-p2")
    assert "object" in fields(propose("put it in station 101"))


def test_two_robots_are_asked_about_and_one_named_is_taken() -> None:
    assert fields(propose("go to station 101", robot=None)) == {"robot": ("courier-1", "lifter-1")}
    assert mission("lifter-1, go to station 101", robot=None).rid == "lifter-1"
    assert fields(propose("lifter-1, go to station 101"))["robot"] == ("courier-1", "lifter-1")
    assert mission("lifter-1, go to station 101", robot="lifter-1").rid == "lifter-1"


def test_what_no_robot_or_another_robot_can_do_is_asked_about() -> None:
    assert "type" in fields(propose("throw P1"))
    asked = fields(
        propose("photograph the pharmacy", robot="lifter-1", data__store="no", data__transmit="no")
    )
    assert asked == {"robot": ("courier-1",)}


@pytest.mark.parametrize(
    "sentence",
    [
        "open the door",
        "open the door of the pharmacy",
        "open the isolation room door",
        "close the door to Isolation Room",
        "open the door between the isolation room and the public corridor",
    ],
)
def test_a_door_that_the_site_has_no_thing_for_is_asked_about_among_doors(sentence: str) -> None:
    """A package is no answer to the question which door."""
    assert fields(propose(sentence))["object"] == ("isolation_door_open",)
    answered = propose(sentence, object="isolation_door_open")
    assert answered.draft == {}
    assert fields(answered)["object"] == ()


def site_with_doors(**things: dict[str, Any]) -> Site:
    """Return the hospital with things of class `door`, and a courier that opens them."""
    site = scenarios.site()
    objects = dict(site.objects)
    for item, model in things.items():
        objects[item.replace("_", "-")] = ObjectModel(kind="door", mass_g=0, **model)  # type: ignore[index]
    words = standard_words()
    robots = dict(site.robots)
    held = robots["courier-1"]  # type: ignore[index]
    tools = {**held.profile.tools, "open": ("gripper",), "close": ("gripper",)}
    profile = msgspec.structs.replace(held.profile, tools=tools)
    robots["courier-1"] = msgspec.structs.replace(held, profile=profile)  # type: ignore[index]
    vocabulary = {**site.vocabulary, "open": words["open"], "close": words["close"]}  # type: ignore[index]
    return changed_site(objects=objects, robots=robots, vocabulary=vocabulary)


TWO_DOORS = {
    "isolation_door": {"home": "public-corridor", "names": ("Isolation Room Door",)},
    "drug_door": {"home": "pharmacy", "names": ("Drug Door", "Door to the Staff Corridor")},
}


def test_a_door_is_what_stands_at_the_place_or_has_its_name() -> None:
    for sentence, door in [
        ("open the isolation room door", "isolation-door"),
        ("open the door of the isolation room", "isolation-door"),
        ("open the door to Isolation Room", "isolation-door"),
        ("open the door into the isolation room", "isolation-door"),
        (
            "open the door between the isolation room and the public corridor",
            "isolation-door",
        ),
        ("open the door between pharmacy and staff corridor", "drug-door"),
        ("open the pharmacy door", "drug-door"),
        ("open the drug door", "drug-door"),
    ]:
        with case(sentence, door):
            site = site_with_doors(**TWO_DOORS)
            made = compiled(propose(sentence, site=site), site)
            assert shape(made.actions)[-1] == ("open", door, None)


@pytest.mark.parametrize(
    "sentence",
    ["open the plant room door", "open the door between office 1 and office 2", "open the door"],
)
def test_a_door_that_no_thing_fits_is_asked_about_among_doors(sentence: str) -> None:
    site = site_with_doors(**TWO_DOORS)
    assert fields(propose(sentence, site=site)) == {"object": ("drug-door", "isolation-door")}
    made = compiled(propose(sentence, site=site, object="drug-door"), site)
    assert shape(made.actions)[-1] == ("open", "drug-door", None)


@pytest.mark.parametrize(
    "sentence", ["open the door between office 1", "open the door of", "open the door between P1"]
)
def test_half_a_door_is_a_question(sentence: str) -> None:
    assert propose(sentence, site=site_with_doors(**TWO_DOORS)).questions


def changed_site(**changes: Any) -> Site:
    return msgspec.structs.replace(scenarios.site(), **changes)


def test_two_packages_and_three_offices_are_two_questions() -> None:
    regions = dict(scenarios.site().regions)
    third = msgspec.structs.replace(
        regions["plant-room"],  # type: ignore[index]
        names=("Office 3",),
    )
    regions["office-3"] = third  # type: ignore[index]
    del regions["plant-room"]  # type: ignore[arg-type]
    doors = tuple(door for door in scenarios.site().doors if "plant-room" not in door.between)
    site = changed_site(regions=regions, doors=doors)
    assert fields(propose("bring the package to the office", site=site)) == {
        "object": ("package-p1", "package-p2"),
        "destination": ("office-1", "office-2", "office-3"),
    }


def test_a_way_through_a_private_room_is_asked_about() -> None:
    doors = tuple(door for door in scenarios.site().doors if "dock" not in door.between) + tuple(
        msgspec.structs.replace(door, between=("dock", "office-1"))  # type: ignore[arg-type]
        for door in scenarios.site().doors
        if "dock" in door.between
    )
    site = changed_site(doors=doors)
    asked = propose("go to station 101", site=site)
    assert fields(asked) == {"route.station-101": ("dock, office-1, public-corridor, station-101",)}
    assert fields(propose("go to station 101", site=changed_site(doors=()))) == {
        "route.station-101": ()
    }
    way = {"route.station-101": "dock, office-1, public-corridor, station-101"}
    made = compiled(propose("go to station 101", site=site, given={**GIVEN, **way}), site)
    assert "office-1" in made.regions


def test_one_tool_of_several_is_asked_for() -> None:
    robots = dict(scenarios.site().robots)
    held = robots["courier-1"]  # type: ignore[index]
    tools = {**held.profile.tools, "navigate": ("base", "tracks")}
    profile = msgspec.structs.replace(held.profile, tools=tools)
    robots["courier-1"] = msgspec.structs.replace(held, profile=profile)  # type: ignore[index]
    site = changed_site(robots=robots)
    assert fields(propose("go to station 101", site=site)) == {"tool.navigate": ("base", "tracks")}
    made = propose("go to station 101", site=site, given={**GIVEN, "tool.navigate": "tracks"})
    assert made.draft["grants"][0]["tool"] == "tracks"


def test_the_same_words_make_the_same_draft() -> None:
    first, second = (propose("Deliver P1 to station 101, then go home") for _ in range(2))
    assert msgspec.json.encode(first) == msgspec.json.encode(second)


def test_everything_from_the_profile_is_listed_as_assumed() -> None:
    made = propose("Deliver P1 to station 101")
    told = {item.field for item in made.assumed}
    assert told >= {
        "place_max_age",
        "on_refusal",
        "risk_policy",
        "retries",
        "max.navigate",
        "limits.force_mn",
        "budgets.prompts",
        "window.not_before",
    }
    assert made.draft["budgets"]["actions"] == sum(g["starts"] for g in made.draft["grants"])


#: The hospital with one package only, so that `package` alone is no question.
ONE_PACKAGE = {"package-p1", "sharps-bin"}


def one_package() -> Site:
    objects = {k: v for k, v in scenarios.site().objects.items() if k in ONE_PACKAGE}
    return changed_site(objects=objects)


def test_a_label_behind_a_noun_is_no_article() -> None:
    """`package A` on a site with one package P1 is not that package: it is a question."""
    for sentence, word, field in [
        ("deliver package A to station 101", "A", "object"),
        ("deliver package a to station 101", "a", "object"),
        ("deliver the package the to station 101", "the", "object"),
        ("deliver package B to station 101", "B", "object"),
        ("deliver package S to station 101", "S", "object"),
        ("deliver package 2 to station 101", "2", "object"),
        ("deliver package two to station 101", "two", "object"),
        ("deliver A package to station 101", "A", "object"),
        ("deliver package robot to station 101", "robot", "object"),
        ("deliver package to station 101 A", "A", "destination"),
        ("deliver package to station 101 the", "the", "destination"),
        ("deliver package to station 101 your", "your", "destination"),
        ("deliver package Please to station 101", "Please", "object"),
        ("guide the visitor A to station 101", "A", "destination"),
    ]:
        with case(sentence, word, field):
            asked = propose(sentence, site=one_package())
            assert asked_about(asked, word) == [field]


@pytest.mark.parametrize(
    "sentence",
    [
        "deliver a package to the station 101",
        "robot, deliver the package to station 101 please",
        "Please deliver your package to station 101",
        "deliver the package to station 101, please.",
    ],
)
def test_an_article_before_its_noun_is_no_label(sentence: str) -> None:
    assert shape(mission(sentence, site=one_package()).actions) == DELIVERY
