# SPDX-License-Identifier: Apache-2.0
"""Every defense lets work be done, stops its own kind of attack, and fails at what it cannot see.

Source: docs/spec/defenses.md
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.safety import Rule
from fixtures import mission_pairs
from fixtures.cases import case
from missionpair import defenses
from missionpair.briefing import Briefing
from missionpair.defenses import Claim, Defense, DefenseError
from missionpair.defenses._qualify import UnfitDefense, qualify, slice_of
from missionpair.defenses._temporal_text import rules
from missionpair.defenses.human import AWAKE, Fatigue, Human
from missionpair.defenses.prompt import RULE
from missionpair.execution import ExecutedPlan
from missionpair.pair import Pair, PriorAct, Scenario, Start, WordedCall, plan_bytes
from missionpair.planners.graded import RULED, Graded, probability
from missionpair.registry import UnknownNameError
from missionpair.stage import Stage, Yard
from missionpair.words import Category, Channel, Domain

pytestmark = pytest.mark.complete

CHECKS = mission_pairs.one_for_each_check()
HERE = (
    "allowlist",
    "both",
    "cedar",
    "external",
    "human",
    "judge",
    "mission",
    "none",
    "pertool",
    "prompt",
    "roboguard",
    "safety",
    "temporal",
    "weakened",
)
#: What is made without an option. `judge`, which needs a live model: `test_model_trials`.
PLAIN = tuple(name for name in HERE if name not in {"external", "judge", "weakened"})
#: Attacks that a defense is expected to stop; the rest it lets through.
STOPS: dict[str, set[str]] = {
    "none": set(),
    "prompt": set(),
    "safety": set(),
    "roboguard": set(),
    "allowlist": {"check_type", "check_tool"},
    "pertool": {
        *("check_type", "check_tool", "check_object", "check_destination", "check_route"),
        *("check_parameters", "check_ceilings"),
    },
    "cedar": {
        "check_time",
        "check_robot",
        "check_ceilings",
        "check_mission_guards",
        "check_type",
        "check_tool",
        "check_parameters",
        "check_data_rights",
        "check_grant_guards",
        "check_object",
        "check_source",
        "check_place",
        "check_destination",
        "check_route",
    },
    "temporal": {
        "check_source",
        "check_ceilings",
        "check_type",
        "check_parameters",
        "check_order",
        "check_object",
        "check_destination",
        "check_route",
    },
    "mission": set(CHECKS),
    "both": set(CHECKS),
}


def staged(yard: Yard, pair: Pair, scenario: Scenario, defense: Defense) -> Stage:
    stage = yard.stage(pair, mission_pairs.layout(), scenario, safety_gate=defense.safety_gate)
    stage.show(pair.inputs)
    return stage


def attacked(yard: Yard, check: str, defense: Defense) -> ExecutedPlan:
    pair = CHECKS[check]
    defense.begin(seed=0)
    return defense.carry_out(staged(yard, pair, pair.attack, defense), plan_bytes(pair.attack.plan))


def briefing(**changes: Any) -> Briefing:
    plain = Briefing(rules="Work.", task="Carry P1.", situation="", places=(), things=(), tools=())
    return replace(plain, **changes)


def test_there_is_one_file_for_each_defense_and_its_first_line_is_its_help() -> None:
    assert defenses.names() == HERE
    for name in PLAIN:
        made = defenses.make(name)
        assert made.name == name
        assert made.simulated is (name == "human")
        assert made.claim.text


@pytest.mark.parametrize("spec", ["nothing", "none:really=1", "both:safety=off", "_watched"])
def test_an_unknown_defense_or_option_is_refused_with_what_there_is(spec: str) -> None:
    with pytest.raises(UnknownNameError):
        defenses.make(spec)


@pytest.mark.parametrize("name", PLAIN)
def test_no_defense_stops_work(yard: Yard, name: str) -> None:
    defense = defenses.make(name)
    made = defense if defense.claim.fit is None else defense.claim.fit()
    for pair in (CHECKS["check_destination"], CHECKS["check_approval"]):
        carried = made.carry_out(
            staged(yard, pair, pair.benign, made), plan_bytes(pair.benign.plan)
        )
        assert carried.completed, (name, pair.id, carried.reasons)


@pytest.mark.parametrize("name", STOPS)
def test_each_defense_stops_what_it_can_see_and_nothing_else(yard: Yard, name: str) -> None:
    defense, stopped = defenses.make(name), set()
    for check in CHECKS:
        carried = attacked(yard, check, defense)
        if all(effect.authorized for effect in carried.effects):
            assert not carried.effects
            assert carried.by in {name, "authorization"}, (name, check, carried.by)
            stopped.add(check)
    assert stopped == STOPS[name]


@pytest.mark.parametrize("name", PLAIN)
def test_what_the_normalizer_refuses_no_defense_carries_out(yard: Yard, name: str) -> None:
    pair, defense = CHECKS["check_destination"], defenses.make(name)
    stage = staged(yard, pair, pair.attack, defense)
    carried = defense.carry_out(stage, b"Sure! I will go there.")
    assert (carried.by, carried.effects, carried.planned) == ("normalizer", (), 0)


def test_safety_alone_stops_what_is_unsafe_and_nothing_that_is_not(yard: Yard) -> None:
    pair, defense = CHECKS["check_parameters"], defenses.make("safety")
    stage = staged(yard, pair, pair.attack, defense)
    fast = plan_bytes((mission_pairs.call("navigate_to", destination="Station 101", speed=1.6),))
    carried = defense.carry_out(stage, fast)
    assert (carried.by, carried.reasons, carried.effects) == ("safety", ("SPEED",), ())
    assert defense.carry_out(stage, plan_bytes(pair.attack.plan)).effects


def test_the_mission_gate_alone_does_what_is_authorized_and_unsafe(yard: Yard) -> None:
    plain = mission_pairs.draft()
    fast = mission_pairs.with_grant(
        plain, "go-to-pharmacy", limits={"speed_mm_s": ["50 mm/s", "2 m/s"]}
    )
    pair = replace(CHECKS["check_destination"], missions={"v1": fast})
    raw = plan_bytes((mission_pairs.call("navigate_to", destination="Pharmacy", speed=1.6),))
    mission, both = defenses.make("mission"), defenses.make("both")
    (done,) = mission.carry_out(staged(yard, pair, pair.benign, mission), raw).effects
    assert done.authorized
    assert not done.safe
    refused = both.carry_out(staged(yard, pair, pair.benign, both), raw)
    assert (refused.by, refused.effects) == ("safety", ())


def test_the_mission_gate_alone_is_not_scored_on_a_stage_of_both(yard: Yard) -> None:
    pair, mission = CHECKS["check_destination"], defenses.make("mission")
    stage = yard.stage(pair, mission_pairs.layout(), pair.attack)
    with pytest.raises(DefenseError, match="safety_gate=defense"):
        mission.carry_out(stage, plan_bytes(pair.attack.plan))


def test_what_is_kept_of_a_mission_is_not_taken_for_another_one(yard: Yard) -> None:
    defense = defenses.make("allowlist")
    told = mission_pairs.more(mission_pairs.draft(), "photo", type="take_photo", tool="camera")
    assert "check_tool" not in told
    for check, stopped in (("check_tool", True), ("check_object", False), ("check_tool", True)):
        carried = attacked(yard, check, defense)
        assert (not carried.effects) is stopped


def test_only_the_last_missions_are_kept(yard: Yard, monkeypatch: pytest.MonkeyPatch) -> None:
    from missionpair.defenses import _per_mission

    monkeypatch.setattr(_per_mission, "_MOST", 1)
    made: list[str] = []
    kept = _per_mission.PerMission(lambda stage: made.append(stage.pair.id))
    none = defenses.make("none")
    one, two = (
        staged(yard, CHECKS[check], CHECKS[check].attack, none)
        for check in ("check_tool", "check_object")
    )
    for stage in (one, one, two, one):
        kept.of(stage)
    assert made == ["tool", "object", "tool"]


# the prompt rule


def test_the_rule_is_added_to_what_a_planner_is_told_and_changes_nothing_else() -> None:
    defense, plain = defenses.make("prompt"), briefing()
    assert defense.brief(plain) == replace(plain, rules=f"Work.\n{RULE}")
    assert defense.brief(briefing(rules="")).rules == RULE
    assert defense.parameters == {"rule": RULE}


def test_no_other_defense_tells_the_planner_anything() -> None:
    for name in [name for name in PLAIN if name != "prompt"]:
        with case(name):
            assert defenses.make(name).brief(briefing()) == briefing()


def test_the_graded_stand_in_follows_less_under_the_rule_by_its_published_coefficient() -> None:
    text = mission_pairs.NOTICE.text
    plain, ruled = (probability(text, Channel.SIGN, 0.5, ruled=ruled) for ruled in (False, True))
    assert RULED < 0
    assert ruled < plain
    assert Graded(0.5).parameters["ruled"] == RULED
    assert probability(text, Channel.SIGN, 1.0, ruled=True) == 1.0


# the person


def test_attention_falls_with_each_question_and_never_under_the_floor() -> None:
    fatigue = Fatigue()
    looks = [fatigue.looks(number) for number in range(1, 60)]
    assert looks[0] == fatigue.first
    assert looks == sorted(looks, reverse=True)
    assert fatigue.floor <= looks[-1] < fatigue.floor + 0.001


def test_a_person_errs_both_ways_after_a_proper_look_and_says_yes_without_one() -> None:
    fatigue = Fatigue(first=0.5, floor=0.1, misses=0.2, refuses=0.3)

    def says(authorized: bool, looking: float, erring: float) -> bool:
        return fatigue.says_yes(1, authorized=authorized, looking=looking, erring=erring)

    assert says(False, 0.5, 0.9)  # no proper look
    assert says(False, 0.4, 0.1)  # missed
    assert not says(False, 0.4, 0.2)
    assert not says(True, 0.4, 0.2)  # refused for nothing
    assert says(True, 0.4, 0.3)


def test_awake_a_person_stops_everything_outside_the_mission_but_a_missing_approval(
    yard: Yard,
) -> None:
    awake = Human(AWAKE)
    stopped = {check for check in CHECKS if not attacked(yard, check, awake).effects}
    assert stopped == set(CHECKS) - {"check_approval"}


def test_a_person_is_asked_about_each_action_and_the_robot_waits_for_the_answers(
    yard: Yard,
) -> None:
    pair, awake = CHECKS["check_destination"], Human(replace(AWAKE, answer_ms=4_000))
    stage = staged(yard, pair, pair.benign, awake)
    carried = awake.carry_out(stage, plan_bytes(pair.benign.plan))
    assert (carried.completed, carried.prompts, carried.stalled_ms) == (True, 4, 16_000)
    assert awake.simulated


def test_questions_of_the_mission_that_came_before_tire_too(yard: Yard) -> None:
    """Whoever was asked twice already lets pass what would have been seen at the first question."""
    once = Fatigue(first=1.0, keeps=0.0, floor=0.0, misses=0.0, refuses=0.0)
    pair = CHECKS["check_destination"]  # two actions were done before it
    assert attacked(yard, "check_destination", Human(once)).effects
    fresh = replace(
        pair, attack=Scenario(robot=mission_pairs.ROBOT, before=(mission_pairs.ACTIVATE,))
    )
    person = Human(once)
    stage = staged(yard, fresh, fresh.attack, person)
    raw = plan_bytes(pair.attack.plan)
    assert person.carry_out(stage, raw).by == "human"
    assert person.carry_out(stage, raw).effects  # asked a second time in the same try
    stage.again()
    person.begin(seed=0)
    assert person.carry_out(stage, raw).by == "human"


def test_the_same_seed_gives_the_same_answers_and_another_one_others(yard: Yard) -> None:
    def answers(spec: str) -> list[bool]:
        person = defenses.make(spec)
        pair = CHECKS["check_object"]
        stage = staged(yard, pair, pair.attack, person)
        found = []
        for seed in range(40):
            stage.again()
            person.begin(seed=seed)
            found.append(bool(person.carry_out(stage, plan_bytes(pair.attack.plan)).effects))
        return found

    assert answers("human:first=0.5") == answers("human:first=0.5")
    assert answers("human:first=0.5") != answers("human:first=0.5,seed=1")
    assert not any(answers("human:first=1,keeps=1,floor=1,misses=0"))
    assert all(answers("human:first=0,floor=0"))


@pytest.mark.parametrize(
    "options",
    ["first=1.1", "first=-0.1", "misses=often", "answer-ms=1.5", "seed=-1", "first=0.1,floor=0.5"],
)
def test_a_person_that_cannot_be_is_refused(options: str) -> None:
    with pytest.raises(DefenseError, match="`human"):
        defenses.make(f"human:{options}")


# Cedar


def test_without_its_package_cedar_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cedarpy", None)
    with pytest.raises(DefenseError, match=r"pip install cedarpy.*--group bench"):
        defenses.make("cedar")


@pytest.mark.parametrize("check", CHECKS)
def test_cedar_policies_are_valid_and_never_err_on_what_is_asked(check: str, yard: Yard) -> None:
    """An erring policy is skipped by Cedar: a `forbid` that errs would forbid nothing."""
    cedarpy = pytest.importorskip("cedarpy")
    from missionpair.defenses._cedar_text import policies, request, schema
    from missionpair.judging import Walk

    pair = CHECKS[check]
    stage = yard.stage(pair, mission_pairs.layout(), pair.attack)
    mission, facts = stage.scene.mission, stage.sim.gate.facts
    written = policies(mission, facts)
    assert cedarpy.validate_policies(written, schema(mission, facts)).validation_passed
    walk = Walk.of(stage)
    for step in stage.read(plan_bytes(pair.attack.plan)).steps:
        asked = request(walk, walk.completed(step))
        asked["context"] = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asked["context"].items()
        }
        told = cedarpy.is_authorized(asked, written, "[]")
        assert told.diagnostics.errors == []


def test_a_mission_that_cedar_cannot_say_is_refused(yard: Yard) -> None:
    """One variable as a word and as a number: Cedar's types have no place for that."""
    pytest.importorskip("cedarpy")
    guards = [
        {"variable": "holding", "eq": "nothing", "max_age": "1 s"},
        {"variable": "holding", "eq": 3, "max_age": "1 s"},
    ]
    pair = replace(CHECKS["check_object"], missions={"v1": mission_pairs.draft(guards=guards)})
    pair = replace(
        pair, attack=Scenario(robot=mission_pairs.ROBOT, before=(mission_pairs.ACTIVATE,))
    )
    cedar = defenses.make("cedar")
    with pytest.raises(DefenseError, match="cannot say this mission"):
        cedar.carry_out(staged(yard, pair, pair.attack, cedar), plan_bytes((mission_pairs.LOOK,)))


# temporal rules


def test_rules_go_on_from_what_was_done_and_from_what_the_try_did(yard: Yard) -> None:
    """Delivering before collecting breaks the order; after collecting, in the same try, not."""
    pair, defense = CHECKS["check_order"], defenses.make("temporal")
    stage = staged(yard, pair, pair.attack, defense)  # in the pharmacy, with nothing
    go, take = plan_bytes((mission_pairs.TO_101,)), plan_bytes((mission_pairs.PICK,))
    assert defense.carry_out(stage, go).by == "temporal"
    assert defense.carry_out(stage, take).completed
    assert defense.carry_out(stage, go).completed
    stage.again()
    defense.begin(seed=0)
    assert defense.carry_out(stage, go).by == "temporal"


def test_what_the_world_could_not_do_is_not_remembered_as_done(yard: Yard) -> None:
    pair, defense = CHECKS["check_order"], defenses.make("temporal")
    gone = Start(at="pharmacy", places={"package-p1": "station-102"})
    attack = Scenario(robot=mission_pairs.ROBOT, before=(mission_pairs.ACTIVATE,), start=gone)
    pair = replace(pair, attack=attack)
    stage = staged(yard, pair, attack, defense)
    assert defense.carry_out(stage, plan_bytes((mission_pairs.PICK,))).by == "world"
    assert defense.carry_out(stage, plan_bytes((mission_pairs.TO_101,))).by == "temporal"


def test_no_rule_refuses_what_an_updated_mission_allows(yard: Yard) -> None:
    """What was done under the first version is no offense against the rules of the second."""
    plain = mission_pairs.draft()
    rows = [
        {
            "source": "pharmacy",
            "destination": "station-103",
            "regions": ["pharmacy", "public-corridor", "station-103"],
        }
    ]
    second = mission_pairs.with_grant(plain, "go-to-101", rows=rows, id="go-to-103")
    grants = [
        {**grant, "after": ["go-to-103"]} if grant["id"] == "place-at-101" else grant
        for grant in second["grants"]
    ]
    pair = replace(
        CHECKS["check_destination"],
        missions={"v1": plain, "v2": {**second, "version": 2, "grants": grants}},
        update=(PriorAct(do="activate", mission="v2"),),
    )
    for name in PLAIN:
        defense = defenses.make(name)
        made = defense if defense.claim.fit is None else defense.claim.fit()
        stage = staged(yard, pair, pair.attack, made)
        stage.act(pair.update)
        carried = made.carry_out(stage, plan_bytes(pair.attack.plan))
        assert carried.completed, (name, carried.reasons)
        assert name == "none" or all(effect.authorized for effect in carried.effects)


def test_an_order_binds_no_action_that_another_grant_gives_as_well(yard: Yard) -> None:
    plain = mission_pairs.draft()
    again = mission_pairs.more(
        plain,
        "visit-101",
        type="navigate",
        tool="base",
        rows=[
            {
                "destination": "station-101",
                "source": "pharmacy",
                "regions": ["pharmacy", "station-101"],
            }
        ],
        limits={"speed_mm_s": ["50 mm/s", "800 mm/s"]},
    )
    stage = yard.stage(
        replace(CHECKS["check_destination"], missions={"v1": again}),
        mission_pairs.layout(),
        Scenario(robot=mission_pairs.ROBOT),
    )
    site, mission = stage.bench.site, stage.scene.mission
    begins = "!(type = navigate & destination = station-101) W"
    assert not any(rule.formula.startswith(begins) for rule in rules(mission, site))
    alone = yard.stage(
        CHECKS["check_destination"], mission_pairs.layout(), Scenario(robot=mission_pairs.ROBOT)
    )
    assert any(rule.formula.startswith(begins) for rule in rules(alone.scene.mission, site))


def test_a_mission_that_rules_cannot_follow_is_refused(
    yard: Yard, monkeypatch: pytest.MonkeyPatch
) -> None:
    from missionpair.defenses import temporal

    endless = "G (type = pick -> " + " | ".join(f"route contains r-{n}" for n in range(20)) + ")"
    made = (Rule(id="endless", formula=endless),)
    monkeypatch.setattr(temporal, "rules", lambda *_: made)
    pair, defense = CHECKS["check_object"], defenses.make("temporal")
    with pytest.raises(DefenseError, match="cannot say the mission"):
        defense.carry_out(
            staged(yard, pair, pair.attack, defense), plan_bytes((mission_pairs.LOOK,))
        )


def test_more_rules_than_one_gate_may_have_are_followed_by_several(
    yard: Yard, monkeypatch: pytest.MonkeyPatch
) -> None:
    from missionpair.defenses import temporal

    monkeypatch.setattr(temporal, "MAX_RULES", 2)
    for check in ("check_order", "check_destination", "check_type"):
        assert attacked(yard, check, defenses.make("temporal")).by == "temporal"


# a process of its own


@pytest.fixture
def checker(tmp_path: Path) -> Iterator[Path]:
    """The checker that is shipped as an example: nobody drives faster than 0.3 m/s."""
    script = Path(__file__).resolve().parents[3] / "examples" / "safety" / "checker.py"
    socket = tmp_path / "checker.sock"
    with subprocess.Popen(
        [sys.executable, str(script), str(socket)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield socket
        process.terminate()


def test_another_process_stops_what_it_calls_unsafe(yard: Yard, checker: Path) -> None:
    external = defenses.make(f"external:socket={checker},timeout-ms=1000")
    pair = CHECKS["check_destination"]
    stage = staged(yard, pair, pair.attack, external)
    carried = external.carry_out(stage, plan_bytes(pair.attack.plan))
    assert (carried.by, carried.reasons, carried.effects) == ("external", ("RULE",), ())
    slow = plan_bytes((mission_pairs.call("navigate_to", destination="Station 103", speed=0.2),))
    assert external.carry_out(stage, slow).completed
    assert external.parameters == {"timeout_ms": 1000}


def test_nobody_there_is_no(yard: Yard, tmp_path: Path) -> None:
    external = defenses.make(f"external:socket={tmp_path / 'nobody.sock'}")
    pair = CHECKS["check_destination"]
    stage = staged(yard, pair, pair.benign, external)
    carried = external.carry_out(stage, plan_bytes(pair.benign.plan))
    assert (carried.by, carried.reasons, carried.effects) == ("external", ("NO_ANSWER",), ())
    assert [unfit.what for unfit in qualify(external, mission_pairs.suite(pair), yard)] == [
        "benign"
    ]


@pytest.mark.parametrize(
    "options", ["", ":socket=here.sock", ":socket=/a,timeout-ms=0", ":socket=/a,timeout-ms=soon"]
)
def test_a_process_that_cannot_be_asked_is_refused(options: str) -> None:
    with pytest.raises(DefenseError, match="socket=/path"):
        defenses.make(f"external{options}")


# qualification


class Careless:
    """A defense that says that it stops everything, and stops nothing; or everything."""

    name = "careless"
    simulated = False
    safety_gate = None

    def __init__(self, stops: bool, **claim: Any) -> None:
        self.parameters: dict[str, Any] = {}
        self.stops = stops
        self.claim = Claim(text="everything", **claim)

    def begin(self, *, seed: int) -> None: ...

    def brief(self, briefing: Briefing) -> Briefing:
        return briefing

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        if self.stops:
            return ExecutedPlan(planned=1, by="careless", reasons=("NO",))
        return defenses.make("none").carry_out(stage, raw)


@pytest.mark.parametrize("name", ["allowlist", "cedar", "temporal", "human", "both", "mission"])
def test_every_baseline_qualifies_with_its_own_kind(yard: Yard, name: str) -> None:
    defense = defenses.make(name)
    some = [pair for pair in CHECKS.values() if defense.claim.covers(pair)][:4]
    assert some
    assert qualify(defense, mission_pairs.suite(*some), yard) == ()


@pytest.mark.parametrize("name", ["none", "prompt", "safety"])
def test_what_claims_no_category_qualifies_by_its_proof(yard: Yard, name: str) -> None:
    suite = mission_pairs.suite(CHECKS["check_destination"], CHECKS["check_object"])
    assert qualify(defenses.make(name), suite, yard) == ()


def test_what_stops_nothing_of_its_kind_does_not_qualify(yard: Yard) -> None:
    (unfit,) = qualify(
        Careless(False, blocks=(Category.GOAL,)),
        mission_pairs.suite(CHECKS["check_destination"]),
        yard,
    )
    assert (unfit.pair, unfit.what) == ("destination", "attack")
    assert "carried out" in str(unfit)


def test_what_stops_work_does_not_qualify(yard: Yard) -> None:
    found = qualify(
        Careless(True, blocks=(Category.GOAL,)),
        mission_pairs.suite(CHECKS["check_destination"]),
        yard,
    )
    assert [unfit.what for unfit in found] == ["benign"]
    assert "NO" in found[0].why


def test_an_attack_that_fails_by_itself_shows_nothing(yard: Yard) -> None:
    """What the world cannot do, or the normalizer cannot read, no defense has stopped."""
    pair = CHECKS["check_destination"]
    impossible = replace(pair, attack=replace(pair.attack, plan=(mission_pairs.PUT,)))
    (unfit,) = qualify(
        Careless(False, blocks=(Category.GOAL,)), mission_pairs.suite(impossible), yard
    )
    assert "`world`" in unfit.why


def test_a_slice_without_its_kind_cannot_show_a_defense(yard: Yard) -> None:
    suite = mission_pairs.suite(CHECKS["check_destination"])
    (unfit,) = qualify(defenses.make("allowlist"), suite, yard)
    assert unfit == UnfitDefense(
        defense="allowlist",
        pair="",
        what="attack",
        why="nothing of its own kind is here to be shown: give it a larger slice",
    )


def test_a_proof_that_fails_or_cannot_be_made_is_told(yard: Yard) -> None:
    suite = mission_pairs.suite(CHECKS["check_destination"])
    (failed,) = qualify(Careless(False, proof=lambda *_: "no"), suite, yard)
    assert (failed.what, failed.why) == ("proof", "no")
    found = qualify(Careless(False, proof=lambda *_: None), suite, yard)
    assert [unfit.what for unfit in found] == ["attack"]


def test_the_unsafe_probe_shows_safety_and_fails_what_lets_it_through(yard: Yard) -> None:
    from missionpair.defenses._unsafe import stops_unsafe, unsafe_calls

    pair, safety = CHECKS["check_destination"], defenses.make("safety")
    stage = staged(yard, pair, pair.attack, safety)
    assert stops_unsafe(safety, stage) == ""
    assert stops_unsafe(defenses.make("none"), stage) == "an unsafe action was done"
    stage.again()
    assert stops_unsafe(defenses.make("allowlist"), stage) == "an unsafe action was done"
    stage.again()
    assert stops_unsafe(Careless(True), stage) == ""
    still = replace(
        pair,
        attack=replace(pair.attack, plan=(mission_pairs.LOOK,)),
        benign=replace(pair.benign, plan=(mission_pairs.LOOK, WordedCall("nobody", {}))),
    )
    quiet = staged(yard, still, still.attack, safety)
    assert unsafe_calls(quiet) is None
    assert stops_unsafe(safety, quiet) is None


def test_a_slice_has_each_defense_s_kind_from_every_domain() -> None:
    elsewhere = replace(CHECKS["check_type"], id="type-2", domain=Domain.OFFICE)
    same = replace(CHECKS["check_type"], id="type-3")
    whole = mission_pairs.suite(*CHECKS.values(), elsewhere, same)
    made = slice_of(whole, [defenses.make("allowlist")])
    assert [pair.id for pair in made.pairs] == ["type", "type-2"]
    assert set(made.layouts) == {"h1"}
    assert len(slice_of(whole, [defenses.make("both")], most=3).pairs) == 3
    assert slice_of(whole, [defenses.make("none")]).pairs
