# SPDX-License-Identifier: Apache-2.0
"""Household sentences: bench manipulation in the words of this project, and the public tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.mission import Grant, Mission
from fixtures import household_sites
from fixtures.cases import case
from unit.drafting.drafts import asked_about, compiled, fields, propose

ROOT = Path(__file__).resolve().parents[3]
EXTERNAL = ROOT.parent / "shared" / "external"


def draft(sentence: str, **settled: str) -> Mission:
    site = household_sites.site(sentence)
    return compiled(propose(sentence, site=site, robot=household_sites.ROBOT, **settled), site)


def done(made: Mission) -> list[tuple[str, str | None]]:
    """Return what a mission grants, beside looking several times for the things it deals with."""
    return [
        (grant.type, grant.alternatives[0].object)
        for grant in made.actions
        if grant.type != "find" or grant.repeat == 1
    ]


def test_two_wordings_grant_the_same() -> None:
    for sentences, expected in [
        (["Open the cabinet.", "please open a Cabinet"], [("open", "cabinet")]),
        (["Close the drawer", "Shut the drawer."], [("close", "drawer")]),
        (
            ["Turn on the desk lamp", "switch the DeskLamp on", "Power on the desk lamp"],
            [("turn_on", "desklamp")],
        ),
        (["Turn off the faucet", "toggle the faucet off"], [("turn_off", "faucet")]),
        (["Slice the tomato", "cut a Tomato"], [("slice", "tomato")]),
        (["Break the window", "smash the window"], [("break", "window")]),
        (["Find the watch", "look for a watch", "locate the Watch."], [("find", "watch")]),
        (["Clean the mirror", "wipe the Mirror"], [("clean", "mirror")]),
        (["Dirty the pan", "soil the pan"], [("dirty", "pan")]),
        (["Cook the egg", "cook an Egg"], [("cook", "egg")]),
        (["Empty the kettle", "empty a kettle"], [("empty", "kettle")]),
        (["Use up the soap bottle", "use up the SoapBottle"], [("use_up", "soapbottle")]),
        (["Throw the pillow", "toss a pillow"], [("pick", "pillow"), ("throw", None)]),
        (["Drop the spoon", "pick up the spoon and drop it"], [("pick", "spoon"), ("drop", None)]),
        (
            ["Put the spoon on the sofa", "Pick up the spoon, then place it on the sofa"],
            [("pick", "spoon"), ("put_in", "sofa")],
        ),
        (["Fill the cup with milk", "fill up a cup with milk"], [("fill", "cup")]),
        (
            ["Pour tea from the pot into the sink", "pour tea over the sink using the pot"],
            [("fill", "pot"), ("pick", "pot"), ("pour", None)],
        ),
        (
            ["Put the egg in the fridge", "Place an egg inside the fridge."],
            [("pick", "egg"), ("open", "fridge"), ("put_in", "fridge"), ("close", "fridge")],
        ),
        (
            [
                "Open the box, put the pen inside, and close it",
                "Open the box, put the pen in it, and close the lid",
            ],
            [("open", "box"), ("pick", "pen"), ("put_in", "box"), ("close", "box")],
        ),
        (
            ["Heat the bread in the microwave", "warm up the bread in the microwave"],
            [
                ("pick", "bread"),
                ("open", "microwave"),
                ("put_in", "microwave"),
                ("close", "microwave"),
                ("turn_on", "microwave"),
            ],
        ),
    ]:
        with case(sentences, expected):
            for sentence in sentences:
                assert done(draft(sentence)) == expected, sentence


def test_what_is_put_dropped_thrown_or_poured_is_what_the_hand_holds() -> None:
    for sentence, kind, held in (
        ("Throw the knife", "throw", "knife"),
        ("Put the knife on the desk", "put_in", "knife"),
        ("Pour wine from the bowl onto the floor", "pour", "bowl"),
    ):
        (grant,) = [g for g in draft(sentence).actions if g.type == kind]
        assert ("holding", held) in {(guard.variable, guard.value) for guard in grant.guards}


def test_a_liquid_is_bound_by_its_number_and_an_unknown_one_is_asked_about() -> None:
    (grant,) = [g for g in draft("Fill the mug with wine").actions if g.type == "fill"]
    assert [(b.parameter, b.low, b.high) for b in grant.limits] == [("liquid_no", 3, 3)]
    site = household_sites.site("mug")
    made = propose("Fill the mug with lava", site=site, robot=household_sites.ROBOT)
    assert asked_about(made, "lava") == ["object"]
    assert "wine" in fields(made)["liquid"]


def test_what_was_opened_on_the_way_may_be_closed_after_the_mission() -> None:
    made = draft("Put the egg in the fridge")
    assert made.closing is not None
    assert made.closing.grants == ("close-fridge",)
    assert [g.id for g in made.actions if g.completes] == ["put-in-fridge"]


def test_what_is_to_stay_open_is_not_closed_again() -> None:
    made = draft("Put the egg in the fridge with the door left open")
    assert done(made) == [("pick", "egg"), ("open", "fridge"), ("put_in", "fridge")]
    assert made.closing is None
    site = household_sites.site("egg sofa")
    asked = propose(
        "Put the egg on the sofa with the door open", site=site, robot=household_sites.ROBOT
    )
    assert asked_about(asked, "left open") == ["destination"]


def test_leaving_a_thing_open_says_how_and_not_in_which_order() -> None:
    made = draft("Turn on the faucet and leave the box open")
    by_id = {grant.id: grant for grant in made.actions}
    assert by_id["open-box"].after == ()
    assert by_id["turn-on-faucet"].completes
    assert made.closing is not None
    assert made.closing.grants == ("open-box",)
    closed = draft("Turn on the faucet, leave the box open and close the box")
    assert [grant.type for grant in closed.actions if grant.completes] == ["close"]
    alone = draft("Leave the box open")
    assert [grant.completes for grant in alone.actions if grant.type == "open"] == [True]


def test_it_means_the_one_thing_that_the_verb_can_apply_to() -> None:
    made = draft("Put the fork in the microwave and turn it on")
    assert done(made)[-1] == ("turn_on", "microwave")
    site = household_sites.site("candle laptop sofa")
    asked = propose(
        "Turn on the candle and the laptop and turn it off", site=site, robot=household_sites.ROBOT
    )
    assert fields(asked) == {"step2.object": ("candle", "laptop")}


def test_the_order_that_was_said_is_kept_for_what_has_effects() -> None:
    made = draft("Turn off the laptop, then pour water from the cup onto the laptop")
    by_id = {grant.id: grant for grant in made.actions}
    assert "turn-off-laptop" in by_id["pour"].after


def test_the_state_of_a_switch_is_asked_for() -> None:
    site = household_sites.site("light switch")
    asked = propose("toggle the light switch", site=site, robot=household_sites.ROBOT)
    assert fields(asked) == {"state": ("on", "off")}
    assert done(draft("toggle the light switch", state="off")) == [("turn_off", "lightswitch")]


def test_turning_on_and_off_three_times_is_three_successes_each() -> None:
    made = draft("Turn on and off the desk lamp three times")
    assert [(g.type, g.repeat) for g in made.actions[:2]] == [("turn_on", 3), ("turn_off", 3)]


def test_after_and_before_put_clauses_into_their_order() -> None:
    first = draft("Drop the candle after turning off the candle")
    assert done(first)[0] == ("turn_off", "candle")
    second = draft("Put the pen in the box before closing it")
    assert done(second)[-1] == ("close", "box")


# The public tasks: which become drafts, and whether their own plans fit the drafts.


#: Tasks (file, line) with a word that the grammar asks about: `near`, `while`, `a few seconds`,
#: adjectives, and every task with a `Requirement`.
ASKED = {
    "abstract_1009": [9, 12, 17, 20, 22],
    "long_horizon_1009": [0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
    "safe_detailed_1009": [11, 12, 14, 22, 23, 32, 33, 41, 54, 71, 86, 91, 95, 99],
    "unsafe_detailed_1009": [3, 4, 7, 18, 19, 24, 27, 55],
}
#: Tasks whose plan does something that their sentence does not say, or in another order.
APART = {
    "abstract_1009": [1, 21, 24],
    "safe_detailed_1009": [53, 73],
    "unsafe_detailed_1009": [6, 9, 11, 40],
}


def verb_and_name(step: str) -> tuple[str, str]:
    """Return a plan step's action type and the name in it."""
    words = step.replace("_", " ").split()
    if words[0] == "turn":
        return f"turn_{words[1]}", " ".join(words[2:])
    kind = {"put": "put_in", "fillliquid": "fill"}.get(words[0].lower(), words[0].lower())
    return kind, " ".join(words[1:-1] if kind == "fill" else words[1:])


def fits(task: dict[str, Any], made: Mission) -> bool:
    """True when every step of the task's plan has an open grant, in the plan's order."""
    site = household_sites.site_of(task)
    named = {
        spelling.lower().replace(" ", ""): str(item)
        for item, thing in site.objects.items()
        for spelling in (item, *thing.names)
    }
    holding, record = "nothing", []
    for step in household_sites.steps(task):
        kind, name = verb_and_name(step)
        item = named.get(name.lower().replace(" ", "")) if name else None
        grant = next((g for g in made.actions if _open(g, kind, item, holding, record)), None)
        if grant is None:
            return False
        record.append(str(grant.id))
        if kind == "pick":
            holding = str(item)
        elif kind in {"put_in", "drop", "throw"}:
            holding = "nothing"
    return True


def _open(grant: Grant, kind: str, item: str | None, holding: str, record: list[str]) -> bool:
    since = max((n for n, done_id in enumerate(record) if done_id == grant.id), default=-1)
    return (
        grant.type == kind
        and any(row.object == item for row in grant.alternatives)
        and set(grant.after) <= set(record[since + 1 :])
        and record.count(str(grant.id)) < grant.repeat
        and all(guard.value == holding for guard in grant.guards if guard.variable == "holding")
    )


@pytest.mark.external
@pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}")
def test_150_of_the_200_household_tasks_become_drafts_and_the_rest_are_questions() -> None:
    tasks = household_sites.tasks(EXTERNAL / "safeagentbench")
    assert len(tasks) == 200
    asked: dict[str, list[int]] = {}
    apart: dict[str, list[int]] = {}
    for task in tasks:
        site, sentence = household_sites.site_of(task), household_sites.sentence(task)
        made = propose(sentence, site=site, robot=household_sites.ROBOT)
        if made.questions:
            assert made.draft == {}
            assert all(question.field for question in made.questions)
            asked.setdefault(task["file"], []).append(task["line"])
        elif not fits(task, compiled(made, site)):
            apart.setdefault(task["file"], []).append(task["line"])
    assert asked == ASKED
    assert apart == APART
    assert 200 - sum(map(len, asked.values())) - sum(map(len, apart.values())) >= 150
