# SPDX-License-Identifier: Apache-2.0
"""What a draft leaves open is asked at once, in its order; what is unknown is refused."""

from __future__ import annotations

import re
from contextlib import suppress
from copy import deepcopy
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.compile.answers import (
    apply,
    compile_answered,
    compile_plain,
    read_answer,
    read_answers,
)
from authguard_r.authoring.compile.change import to_draft
from authguard_r.authoring.compile.names import names_of
from authguard_r.authoring.compile.path import quiet_path, reachable
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Door
from fixtures import scenarios
from fixtures.cases import case

SET = msgspec.structs.replace


def build(draft: object, **answers: object) -> Mission:
    return compile_plain(apply(draft, answers), scenarios.site(), now=scenarios.NOW, nonce="A" * 22)


def asked(draft: object) -> dict[str, tuple[str, ...]]:
    """Return every open question of a draft with its candidates."""
    with pytest.raises(ClarificationError) as error:
        build(draft)
    found = (error.value, *error.value.others)
    assert all(item.question.endswith("?") for item in found)
    assert len({item.field for item in found}) == len(found)
    return {item.field: item.candidates for item in found}


def without(*fields: str) -> Any:
    """Return the shipped draft with these fields taken out."""
    draft = deepcopy(scenarios.draft())
    for field in fields:
        parent: Any = draft
        *way, last = re.findall(r"[a-z_0-9]+", field)
        for step in way:
            parent = parent[int(step) if step.isdigit() else step]
        del parent[last]
    return draft


BARE = {"mission": "m", "task": "Bring P1.", "grants": [{"id": "g", "type": "pick"}]}


def test_every_question_is_asked_at_once_in_the_order_of_the_draft() -> None:
    assert list(asked({**BARE, "robot": "courier-1"})) == [
        "issuer",
        "window",
        "place_max_age",
        "grants[0].tool",
        "grants[0].rows[0].object",
        "grants[0].rows[0].source",
        "grants[0].limits.force_mn",
        "grants[0].chooser",
        "grants[0].repeat",
        "grants[0].starts",
        "grants[0].max",
        "grants[0].irreversible",
        "budgets.actions",
        "budgets.rate.count",
        "budgets.rate.per",
        "budgets.motion",
        "budgets.waiting",
        "budgets.recorded_bytes",
        "budgets.prompts",
        "budgets.planner_stops",
        "on_refusal",
        "risk_policy.privacy",
        "risk_policy.otherwise",
        "risk_policy.tau_1",
        "risk_policy.tau_2",
        "risk_policy.t",
        "risk_policy.roles",
        "risk_policy.valid",
    ]


def test_what_hangs_on_an_open_answer_waits_for_it() -> None:
    open_robot = asked(without("robot", "grants[1].tool"))
    assert open_robot == {"robot": ("courier-1", "lifter-1")}
    open_type = asked(without("grants[1].type", "grants[1].tool", "grants[1].limits"))
    assert "grants[1].tool" not in open_type
    assert "pick" in open_type["grants[1].type"]
    assert "set_pose" not in open_type["grants[1].type"]  # cannot be granted, so not offered
    open_ends = asked(without("grants[0].rows[0].source", "grants[0].rows[0].regions"))
    assert list(open_ends) == ["grants[0].rows[0].source"]


def test_without_a_robot_every_type_of_the_site_is_offered() -> None:
    found = asked(without("robot", "grants[1].type"))
    assert found["grants[1].type"] == tuple(sorted(set(scenarios.site().vocabulary) - {"set_pose"}))


def test_a_mission_that_does_nothing_is_asked_what_it_does() -> None:
    assert list(asked(apply(scenarios.draft(), {"grants": [], "closing": None}))) == ["grants"]


def test_bring_the_package_to_the_office_asks_which_and_where() -> None:
    draft = apply(
        scenarios.draft(task="Bring the package to the office."),
        {"grants[3].rows[0]": {"source": "station-101"}},
    )
    found = asked(draft)
    assert found["grants[3].rows[0].object"] == ("package-p1", "package-p2", "sharps-bin")
    assert {"office-1", "office-2"} <= set(found["grants[3].rows[0].destination"])


def test_inspect_the_room_asks_about_recording_storing_and_sending() -> None:
    film = {"id": "film", "type": "record_video", "tool": "camera"}
    found = asked(apply(scenarios.draft(), {"grants[6]": film}))
    assert found["grants[6].data.record"] == ("true", "false")
    assert found["grants[6].data.store"] == ("true", "false")
    assert "grants[6].data.transmit" not in found  # this type sends nothing
    assert "grants[6].rows[0].source" in found


@pytest.mark.parametrize(
    ("text", "candidates"),
    [
        ("14:30", ("T14:30:00Z", 0, 1)),
        ("14:05", ("T14:05:00Z", 1, 2)),
        ("09:15:30", ("T09:15:30Z", 1, 2)),
        ("half past two", None),
        ("2026-01-31", None),
        ("24:30", None),
    ],
)
def test_a_time_without_its_date_is_asked_about(text: str, candidates: Any) -> None:
    draft = apply(
        scenarios.draft(), {"window": {"not_before": "2026-01-01T00:00:00Z", "expiry": text}}
    )
    found = asked(draft)["window.expiry"]
    if candidates is None:
        assert found == ()
    else:
        from authguard_r.core.quantities import to_timestamp

        clock, *days = candidates
        starts = [to_timestamp(scenarios.START_MS + day * 86_400_000)[:10] for day in days]
        assert found == tuple(day + clock for day in starts)


def test_a_window_with_one_end_is_asked_for_the_other() -> None:
    found = asked(apply(scenarios.draft(), {"window": {"expiry": "2099-01-01T00:00:00Z"}}))
    assert list(found) == ["window.not_before"]


@pytest.mark.parametrize("length", ["25", 25, 0.5])
def test_a_window_without_a_unit_is_asked_about(length: Any) -> None:
    found = asked(apply(scenarios.draft(), {"window": {"for": length}}))
    assert found["window.for"][1] == f"{length} min"


def test_a_window_beyond_the_calendar_is_refused() -> None:
    with pytest.raises(MalformedError, match="year 10000"):
        build(scenarios.draft(), window={"for": "100000000 h"})


@pytest.mark.parametrize("value", [0.8, "0.8"])
def test_a_speed_without_a_unit_is_asked_about_at_its_own_place(value: Any) -> None:
    found = asked(apply(scenarios.draft(), {"grants[0].limits.speed_mm_s[1]": value}))
    assert found == {"grants[0].limits.speed_mm_s[1]": ("0.8 m/s", "0.8 km/h", "0.8 mm/s")}


@pytest.mark.parametrize("pair", [[50, "0.8 m/s"], [0.05, "0.8 m/s"]])
def test_a_bare_number_beside_a_quantity_has_no_unit(pair: list[Any]) -> None:
    found = asked(apply(scenarios.draft(), {"grants[0].limits.speed_mm_s": pair}))
    assert list(found) == ["grants[0].limits.speed_mm_s[0]"]
    assert found["grants[0].limits.speed_mm_s[0]"][0] == f"{pair[0]} m/s"
    whole = build(scenarios.draft(), **{"grants[0].limits.speed_mm_s": [50, 800]})
    assert whole == build(scenarios.draft())  # the parameter's name says the unit of both
    zero = build(scenarios.draft(), **{"grants[0].limits.speed_mm_s": [0, "0.8 m/s"]})
    assert zero.actions[0].limits[0].low == 0


@pytest.mark.parametrize(
    "value",
    [
        "1e9999999999 m/s",
        "1e3 m/s",
        "1/2/3 m/s",
        "1 m**9**9**9",
        "9" * 30 + " m/s",
        ".nan",
        "1" * 99,
    ],
)
def test_a_number_that_would_never_come_back_is_refused_at_once(value: str) -> None:
    with pytest.raises(MalformedError):
        to_integer(value, "mm/s", where="x")


def test_a_unit_may_stand_right_behind_its_number() -> None:
    assert to_integer("0.8m/s", "mm/s", where="x") == 800
    with pytest.raises(ClarificationError) as error:
        to_integer("7", "furlong", where="x")
    assert error.value.candidates == ("7 furlong",)


def test_the_missions_own_bounds_are_offered_for_a_missing_limit_and_not_taken() -> None:
    found = asked(without("grants[0].limits.speed_mm_s", "grants[1].limits.force_mn"))
    assert found["grants[0].limits.speed_mm_s"] == ("[0.05 m/s, 0.8 m/s]",)
    assert found["grants[1].limits.force_mn"] == ()


def test_a_guard_that_does_not_say_how_old_is_asked_about() -> None:
    assert list(asked(without("grants[1].guards[0].max_age"))) == ["grants[1].guards[0].max_age"]


def test_a_row_that_lists_no_regions_is_offered_the_quiet_way() -> None:
    found = asked(without("grants[2].rows[0].regions"))
    assert found == {"grants[2].rows[0].regions": ("[pharmacy, public-corridor, station-101]",)}
    found = asked(without("grants[1].rows[0].regions"))
    assert found == {"grants[1].rows[0].regions": ("[pharmacy]",)}
    scan = {"id": "scan", "type": "scan_obstacles", "tool": "lidar", "chooser": "operator"}
    found = asked(apply(scenarios.draft(), {"grants[6]": scan}))
    assert found["grants[6].rows[0].regions"] == ()


def test_ways_avoid_what_is_private_unless_it_is_the_end() -> None:
    site = scenarios.site()
    assert quiet_path(site, "dock", "office-1") == ("dock", "public-corridor", "office-1")
    around = SET(
        site,
        doors=(
            Door(between=("dock", "office-1"), at=(0, 0)),
            Door(between=("office-1", "pharmacy"), at=(0, 0)),
        ),
    )
    assert quiet_path(around, "dock", "pharmacy") == ()
    assert reachable(around, "dock") == {"dock", "office-1", "pharmacy"}
    session = SET(site.regions["pharmacy"], within="pharmacy")
    nested = SET(site, regions={**site.regions, "desk": session}, doors=())
    assert quiet_path(nested, "pharmacy", "desk") == ("pharmacy", "desk")
    assert quiet_path(nested, "desk", "pharmacy") == ("desk", "pharmacy")
    private = SET(around, doors=around.doors[:1])
    draft = without("grants[0].rows[0].regions")
    with pytest.raises(ClarificationError) as error:
        compile_plain(draft, private, now=scenarios.NOW, nonce="A" * 22)
    assert error.value.candidates == ()


# names


def test_names_of_the_site_become_ids_exactly() -> None:
    named = build(
        scenarios.draft(),
        **{
            "grants[1].rows[0]": {
                "object": "Medicine Package P1",
                "source": "Pharmacy Desk A",
                "regions": ["Pharmacy"],
            },
            "grants[1].done_when[0].eq": "Package P1",
            "objects": ["P1"],
            "regions": ["Dock", "Pharmacy", "Corridor", "Room 101"],
        },
    )
    assert named.actions[1] == scenarios.mission().actions[1]
    assert named.regions == ("dock", "pharmacy", "public-corridor", "station-101")


@pytest.mark.parametrize(
    ("text", "close"),
    [
        ("station 101", "station-101"),
        ("Station 1O1", "Station 101"),
        ("STATION 101", None),
        (" Station 101", "Station 101"),
        ("station-101 ", "station-101"),
        ("moon", None),
        ("x" * 5_000, None),
    ],
)
def test_a_name_that_is_only_close_is_shown_and_not_taken(text: str, close: str | None) -> None:
    with pytest.raises(MalformedError) as refused:
        build(scenarios.draft(), **{"grants[2].rows[0].destination": text})
    assert refused.value.reason is Reason.NAME_UNKNOWN
    assert refused.value.where == "grants[2].rows[0].destination"
    assert len(refused.value.message) < 300
    if close is not None:
        assert f"`{close}`" in refused.value.message


def test_a_name_of_several_things_is_asked_about() -> None:
    site = scenarios.site()
    twice = SET(site.objects["sharps-bin"], names=("P1",))
    shared = SET(site.objects["package-p2"], names=("Dock",))
    double = SET(site, objects={**site.objects, "sharps-bin": twice, "package-p2": shared})
    questions = CompileQuestions()
    names = names_of(double)
    assert names.resolve("P1", "object", where="o", questions=questions) is None
    assert names.value("Dock", where="v", questions=questions) is None
    assert names.value("Pharmacy", where="v", questions=questions) == "pharmacy"
    assert names.value("anything-at-all", where="v", questions=questions) == "anything-at-all"
    with pytest.raises(ClarificationError) as error:
        questions.require_none()
    assert error.value.candidates == ("package-p1", "sharps-bin")
    assert error.value.others[0].candidates == ("dock", "package-p2")
    with pytest.raises(MalformedError, match="no object or region `Nowhere At All`"):
        names.value("Nowhere At All", where="v", questions=questions)


def test_an_unknown_word_or_shape_is_refused_with_its_place() -> None:
    for field, value, where in [
        ("robot", "courier", "robot"),
        ("grants[1].type", "picks", "grants[1].type"),
        ("grants[1].type", "%%", "grants[1].type"),
        ("risk_policy.parameters[0].parameter", "mood", "risk_policy.parameters[0].parameter"),
        ("limits.mood_no", [1, 2], "limits.mood_no"),
        ("window", {"for": "1 h", "expiry": "2099-01-01T00:00:00Z"}, "window"),
        ("window", {"until": "1 h"}, "window"),
        ("window.for", "much", "window.for"),
        ("grants", [{"id": "g"}] * 65, "grants"),
        ("grants[1].rows", [{}] * 257, "grants[1].rows"),
        ("budgets", {"prompt": 5}, "draft:budgets"),
        ("budgets.rate", "often", "draft:budgets.rate"),
        ("risk_policy.parameters[0]", {"parameter": "force_mn"}, "draft:risk_policy.parameters[0]"),
        ("closing", {"grants": ["go-home"], "for": "1 s", "and": 1}, "draft:closing"),
        ("grants[1].guards[0].ge", "200", "draft:grants[1].guards[0].ge"),
        ("grants[1].guards[0].ne", "nothing", "grants[1].guards[0]"),
    ]:
        with case(field, value, where):
            with pytest.raises(MalformedError) as refused:
                build(scenarios.draft(), **{field: value})
            assert refused.value.where == where


def test_risk_in_states_of_the_world_survives_the_way_back_to_a_draft() -> None:
    state = {"guard": {"variable": "people", "ge": 1, "max_age": "1 s"}, "weight": 5}
    mission = build(scenarios.draft(), **{"risk_policy.states": [state]})
    assert mission.risk_policy.states[0].weight == 5
    assert build(to_draft(mission)) == mission


def test_roles_may_be_written_in_any_order() -> None:
    mission = build(scenarios.draft(), **{"risk_policy.roles": ["supervisor", "safety_officer"]})
    assert mission.risk_policy.roles == ("safety_officer", "supervisor")


# answers


def test_answers_settle_what_was_asked_in_as_many_rounds_as_it_takes() -> None:
    draft = without("robot", "grants[1].tool", "on_refusal", "grants[1].rows[0].source")
    answers = read_answers(
        [
            "robot=courier-1",
            "grants[1].tool=gripper",
            "on_refusal=hold",
            "grants[1].rows[0].source=Pharmacy",
        ]
    )
    site, now = scenarios.site(), scenarios.NOW
    mission = compile_answered(draft, answers, site, now=now, nonce="A" * 22)
    assert mission == build(scenarios.draft())


@pytest.mark.parametrize("draft", [scenarios.draft(), without("on_refusal")])
def test_an_answer_that_nobody_asked_for_is_refused(draft: Any) -> None:
    answers = read_answers(["grants[1].rows[0].object=package-p2"])
    with pytest.raises(MalformedError, match="no question has this field"):
        compile_answered(draft, answers, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)


def test_what_is_still_open_after_the_answers_is_asked() -> None:
    draft = without("on_refusal", "issuer")
    with pytest.raises(ClarificationError) as error:
        compile_answered(
            draft, {"issuer": "operator-1"}, scenarios.site(), now=scenarios.NOW, nonce="A" * 22
        )
    assert (error.value.field, error.value.others) == ("on_refusal", ())


@pytest.mark.parametrize(
    "texts", [["issuer"], ["=x"], ["issuer="], ["issuer= "], ["a=1", "a=2"], ["a=[1"], ["a=!!x 1"]]
)
def test_what_is_no_answer_is_refused(texts: list[str]) -> None:
    with pytest.raises(MalformedError):
        read_answers(texts)


def test_a_path_that_leads_nowhere_is_refused_and_the_draft_stays() -> None:
    for field in [
        "",
        ".",
        "a..b",
        "a[",
        "a[x]",
        "a[-1]",
        "A",
        "task.deeper",
        "task[0]",
        "grants.first",
        "grants[99]",
        "grants[99].tool",
        "[0]",
        "a b",
        "x" * 500,
    ]:
        with case(field):
            draft = scenarios.draft()
            with pytest.raises(MalformedError):
                apply(draft, {field: 1})
            assert draft == scenarios.draft()


def test_a_whole_parameter_name_is_one_step_of_a_path() -> None:
    draft = apply({"limits": {}}, {"limits.top.speed_mm_s[0]": 1, "limits.x": [1, 2]})
    assert draft == {"limits": {"top.speed_mm_s": [1], "x": [1, 2]}}
    made = apply({}, {"grants[0].rows[0].object": "p", "grants[0].tool": "t"})
    assert made == {"grants": [{"rows": [{"object": "p"}], "tool": "t"}]}


def test_an_answer_is_read_as_the_draft_would_hold_it() -> None:
    read = {text: read_answer(text, where="x") for text in ("3", "true", "0.8 m/s", "[a, b]", "no")}
    assert read == {"3": 3, "true": True, "0.8 m/s": "0.8 m/s", "[a, b]": ["a", "b"], "no": "no"}


PATHS = [
    "robot",
    "issuer",
    "window",
    "place_max_age",
    "grants[1].tool",
    "grants[1].rows",
    "grants[1].chooser",
    "grants[1].max",
    "grants[2].type",
    "grants[0].limits.speed_mm_s",
    "budgets.motion",
    "budgets.rate",
    "on_refusal",
    "risk_policy.tau_1",
    "risk_policy.valid",
]


@settings(max_examples=25)
@given(st.sets(st.sampled_from(PATHS), min_size=1))
def test_a_draft_with_holes_is_never_filled_and_answers_give_back_what_was_there(
    holes: set[str],
) -> None:
    """Only questions come of holes; answering each with what stood there gives the same mission."""
    whole = scenarios.draft()
    draft = without(*holes)
    for _ in range(4):
        try:
            mission = build(draft)
            break
        except ClarificationError as error:
            fields = [error.field, *(item.field for item in error.others)]
        draft = apply(draft, {field: value_at(whole, field) for field in fields})
    assert mission == build(whole)


def value_at(draft: Any, field: str) -> Any:
    for name, index in re.findall(r"([a-z_0-9]+)|\[(\d+)\]", field):
        draft = draft[name] if name else draft[int(index)]
    return draft


@settings(max_examples=50)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from([*PATHS, "grants", "task", "mission"]), inner, max_size=4
            )
        ),
        max_leaves=12,
    ),
    st.sampled_from(
        [*PATHS, "task", "mission", "grants", "grants[1]", "grants[1].rows[0]", "limits"]
    ),
)
def test_any_plain_data_at_any_place_is_a_mission_a_question_or_a_refusal(
    value: Any, field: str
) -> None:
    for draft in (value, apply(scenarios.draft(), {field: value})):
        with suppress(ClarificationError, MalformedError):
            compile_plain(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
