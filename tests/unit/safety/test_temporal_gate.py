# SPDX-License-Identifier: Apache-2.0
"""Temporal rules as a safety gate: what they refuse, what they remember, each way past them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.encoding import Tag, decode, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.quantities import Now
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.state import AttestedState
from authguard_r.core.token import sign_object
from authguard_r.keys.trust import read_trust
from authguard_r.safety import Rule, SafetyConfig, TemporalGate, default_config, open_config
from authguard_r.safety.temporal import memory as memories
from authguard_r.safety.temporal.memory import MAX_MEMORY, Memory
from authguard_r.safety.temporal.rules import MAX_RULES, compile_rules
from fixtures import scenarios
from fixtures.cases import case

SCAN = Action(type="scan_obstacles", tool="lidar")
TELL = Action(type="announce", tool="speaker")
GO = scenarios.navigate("dock", "pharmacy")
PICK = Action(
    type="pick", tool="gripper", object="package-p1", source="dock", params={"force_mn": 9_000}
)


def config(*formulas: str, **changes: Any) -> SafetyConfig:
    rules = tuple(Rule(id=f"rule-{n}", formula=text) for n, text in enumerate(formulas))
    made = msgspec.structs.replace(default_config(scenarios.site(), scenarios.RID), rules=rules)
    return msgspec.structs.replace(made, **changes)


def gate(*formulas: str, memory: bytes = b"", **changes: Any) -> TemporalGate:
    return TemporalGate(config(*formulas, **changes), memory)


def ask(here: TemporalGate, action: Action, state: AttestedState | None = None) -> SafetyDecision:
    told = here.assess(action, state or scenarios.state(), scenarios.facts(), scenarios.NOW)
    assert told.safe == (not told.findings)
    return told


def hazards(told: SafetyDecision) -> list[tuple[str, str]]:
    return [(str(finding.hazard), finding.field) for finding in told.findings]


def walk(here: TemporalGate, *actions: Action) -> list[bool]:
    """Release what is safe, each of which succeeds; return what was safe."""
    safe = []
    for action in actions:
        told = ask(here, action)
        safe.append(told.safe)
        if told.safe:
            here = here.recall(told.memory[1])
    return safe


def reading(variable: str, **changes: Any) -> AttestedState:
    """Return the hospital's state with one reading changed."""
    snapshot = scenarios.state().snapshot
    seen = msgspec.structs.replace(snapshot.readings["human_distance_mm"], **changes)
    return scenarios.attested(
        msgspec.structs.replace(snapshot, readings={**snapshot.readings, variable: seen})
    )


# atoms


def test_each_atom_both_ways() -> None:
    for formula, action, safe in [
        ("type = navigate", GO, True),
        ("type = pick", GO, False),
        ("destination = pharmacy", GO, True),
        ("destination != pharmacy", GO, False),
        ("source = dock", GO, True),
        ("object = package-p1", PICK, True),
        ("object = package-p2", PICK, False),
        ("object != package-p1", GO, True),  # a way has no object
        ("destination = pharmacy", SCAN, False),
        ("destination != pharmacy", SCAN, True),
        ("params.speed_mm_s <= 500", GO, True),
        ("params.speed_mm_s < 500", GO, False),
        ("params.speed_mm_s = 500", GO, True),
        (
            "route contains public-corridor",
            scenarios.navigate("dock", "pharmacy", route=("public-corridor",)),
            True,
        ),
        (
            "!route contains public-corridor",
            scenarios.navigate("dock", "pharmacy", route=("office-1",)),
            True,
        ),
        ("!route contains public-corridor", SCAN, True),
        ("state.holding = nothing", GO, True),
        ("state.holding = package-p1", GO, False),
        ("state.human_distance_mm >= 5000", GO, True),
        ("state.human_distance_mm > 5000", GO, False),
        ("state.human_distance_mm = 5000", GO, True),
    ]:
        with case(formula, action, safe):
            told = ask(gate(formula), action)
            assert told.safe is safe
            assert hazards(told) == ([] if safe else [("RULE", "rules.rule-0")])


def test_a_truth_value_is_neither_a_number_nor_a_word() -> None:
    for value, formula, told in (
        (True, "state.lamp = true", []),
        (False, "state.lamp = true", [("RULE", "rules.rule-0")]),
        (False, "state.lamp = false", []),
        (1, "state.lamp = true", [("STATE_UNKNOWN", "state.lamp")]),
        (True, "state.lamp = 1", [("STATE_UNKNOWN", "state.lamp")]),
        (True, "state.lamp >= 1", [("STATE_UNKNOWN", "state.lamp")]),
        ("true", "state.lamp = true", [("STATE_UNKNOWN", "state.lamp")]),
        ("on", "state.lamp <= 5", [("STATE_UNKNOWN", "state.lamp")]),
    ):
        state = reading("lamp", value=value)
        assert hazards(ask(gate(formula), GO, state)) == told, (value, formula)


# what is not known


@pytest.mark.parametrize("text", ["G !(state.door = shut)", "G (state.door = open)"])
def test_a_variable_that_nobody_reads_is_a_refusal_either_way(text: str) -> None:
    assert hazards(ask(gate(text), GO)) == [("STATE_UNKNOWN", "state.door")]


@pytest.mark.parametrize("change", [{"age_ms": 1_001}, {"label": "camera"}])
def test_an_atom_whose_reading_is_stale_or_seen_by_a_camera_is_not_known(change: Any) -> None:
    near = gate("G state.human_distance_mm > 1000")
    assert ask(near, GO, reading("human_distance_mm")).safe
    told = ask(near, GO, reading("human_distance_mm", **change))
    assert hazards(told) == [("STATE_UNKNOWN", "state.human_distance_mm")]


def test_a_reading_grows_stale_while_nothing_comes() -> None:
    near = gate("G state.human_distance_mm > 1000")
    late = Now(scenarios.NOW.utc_ms, scenarios.NOW.mono_ms + 1_001)
    told = near.assess(GO, scenarios.state(), scenarios.facts(), late)
    assert hazards(told) == [("STATE_UNKNOWN", "state.human_distance_mm")]


def test_without_state_and_with_another_robots_nothing_is_known() -> None:
    held = gate("G state.holding = nothing")
    assert hazards(held.assess(GO, None, scenarios.facts(), scenarios.NOW)) == [
        ("STATE_UNKNOWN", "state.holding")
    ]
    foreign = scenarios.state(rid=scenarios.OTHER)
    assert hazards(ask(held, GO, foreign)) == [("STATE_UNKNOWN", "state.holding")]


def test_an_absent_parameter_is_not_a_small_one() -> None:
    bare = scenarios.navigate("dock", "pharmacy", params={})
    for formula in ("G params.speed_mm_s <= 500", "G !(params.speed_mm_s > 500)"):
        assert hazards(ask(gate(formula), bare)) == [("STATE_UNKNOWN", "params.speed_mm_s")]
        assert hazards(ask(gate(formula), SCAN)) == [("STATE_UNKNOWN", "params.speed_mm_s")]
    assert ask(gate("G (type = navigate -> params.speed_mm_s <= 500)"), SCAN).safe


def test_a_way_that_is_left_open_may_pass_anywhere() -> None:
    assert hazards(ask(gate("G !route contains plant-room"), GO)) == [("STATE_UNKNOWN", "route")]
    nowhere = Action(type="navigate", tool="base", params={"speed_mm_s": 500})
    assert hazards(ask(gate("G destination != plant-room"), nowhere)) == [
        ("STATE_UNKNOWN", "destination")
    ]


def test_what_is_not_known_and_does_not_matter_is_no_finding() -> None:
    assert ask(gate("G (type = pick -> state.door = open)"), GO).safe


@pytest.mark.parametrize(
    "formula",
    [
        "G type != dance",
        "G object != package-p9",
        "G destination != plantroom",
        "G source != plantroom",
        "G !route contains plantroom",
        "G (type = navigate -> params.speed <= 500)",
    ],
)
def test_a_name_that_the_site_does_not_have_protects_nothing_so_nothing_is_safe(
    formula: str,
) -> None:
    assert hazards(ask(gate(formula), TELL)) == [("STATE_UNKNOWN", "rules.rule-0")]


def test_an_unknown_type_and_another_robots_gate_are_unsafe() -> None:
    here = gate("G type != pick")
    assert hazards(ask(here, Action(type="dance", tool="base"))) == [("STATE_UNKNOWN", "type")]
    told = here.assess(GO, scenarios.state(), scenarios.facts(scenarios.OTHER), scenarios.NOW)
    assert hazards(told) == [("STATE_UNKNOWN", "type")]


# traces


def test_what_comes_after_is_held_against_what_came_before() -> None:
    twice = gate("G (type = announce -> WX G type != announce)")
    assert walk(twice, SCAN, TELL, SCAN, TELL, SCAN) == [True, True, True, False, True]
    first = gate("type != navigate W type = announce")
    assert walk(first, SCAN, GO, TELL, GO) == [True, False, True, True]


def test_an_action_that_leaves_no_way_to_satisfy_a_rule_is_refused_early() -> None:
    """The announcement has to come; after the way it may not come any more."""
    here = gate("F type = announce & G (type = navigate -> G type != announce)")
    assert walk(here, SCAN, GO, TELL, GO) == [True, False, True, True]


def test_the_end_of_a_mission_is_told_and_refuses_nothing() -> None:
    here = gate("F type = announce", "G type != pick")
    assert here.unfulfilled() == ("rule-0",)
    told = ask(here, SCAN)
    assert here.recall(told.memory[1]).unfulfilled() == ("rule-0",)
    told = ask(here.recall(told.memory[1]), TELL)
    assert here.recall(told.memory[1]).unfulfilled() == ()
    assert here.recall(told.memory[0]).unfulfilled() == ("rule-0",)  # it may not have happened
    assert here.recall(b"lost").unfulfilled() == ("rule-0", "rule-1")


def test_until_it_is_known_whether_it_happened_both_have_to_be_safe() -> None:
    first = gate("type != navigate W type = announce")
    told = ask(first, TELL)
    assert not ask(first.recall(told.memory[0]), GO).safe
    assert ask(first.recall(told.memory[1]), GO).safe
    twice = gate("G (type = announce -> WX G type != announce)")
    told = ask(twice, TELL)
    assert not ask(twice.recall(told.memory[0]), TELL).safe


def test_every_rule_that_is_broken_is_told_in_its_own_words() -> None:
    rules = (
        Rule(id="quiet", formula="G type != announce", message="nothing is announced here"),
        Rule(id="still", formula="G type != navigate"),
        Rule(id="dumb", formula="G type != announce"),
    )
    told = ask(TemporalGate(config(rules=rules)), TELL)
    assert [(f.field, f.expected, f.got) for f in told.findings] == [
        ("rules.quiet", "nothing is announced here", "announce"),
        ("rules.dumb", "G type != announce", "announce"),
    ]
    assert told.memory == (b"", b"")


def test_asking_changes_nothing() -> None:
    here = gate("G (type = announce -> WX G type != announce)")
    assert len({ask(here, TELL) for _ in range(3)}) == 1
    assert ask(here, SCAN).safe


def test_without_rules_there_is_nothing_to_remember() -> None:
    assert ask(gate(), GO) == SafetyDecision(safe=True)


# the memory


def done(mission: str | None, *, formula: str = "G type != pick", **changes: Any) -> bytes:
    """Return what a gate remembers of one action of a mission."""
    return ask(gate(formula, **changes), of(TELL, mission)).memory[1]


def of(action: Action, mission: str | None) -> Action:
    meta = ActionMeta(
        planner="planner",
        timestamp="2026-01-01T00:00:00Z",
        evidence="A" * 43,
        mission=mission,
    )
    return msgspec.structs.replace(action, meta=meta)


def test_the_memory_of_another_robot_mission_or_rule_is_none() -> None:
    mine = gate("G type != pick")
    assert ask(mine.recall(done("m-1")), of(TELL, "m-1")).safe
    others = {
        "mission": done("m-2"),
        "robot": encode_fast(_owned(done("m-1"), rid=scenarios.OTHER)),
        "rule": done("m-1", formula="G type != place"),
    }
    for memory in others.values():
        told = ask(mine.recall(memory), of(TELL, "m-1"))
        assert hazards(told) == [("STATE_UNKNOWN", "memory")]


def test_a_what_if_that_names_no_mission_is_answered_with_the_memory_of_any() -> None:
    assert ask(gate("G type != pick", memory=done("m-1")), TELL).safe


def _owned(data: bytes, **changes: Any) -> Memory:
    memory = decode(data, Memory)
    return msgspec.structs.replace(memory, owner=msgspec.structs.replace(memory.owner, **changes))


def test_a_memory_that_no_gate_wrote_is_none() -> None:
    for left in [
        {},
        {"rule-0": ((0,),), "rule-1": ((0,),)},
        {"rule-1": ((0,),)},
        {"rule-0": ((99,),)},
        {"rule-0": ((0, 0),)},
        {"rule-0": ((1, 0),)},
        {"rule-0": ((1,), (0,))},
        {"rule-0": ((0,), (0, 1))},
        {"rule-0": ((0,), (0,))},
    ]:
        with case(left):
            made = msgspec.structs.replace(decode(done("m-1"), Memory), left=left)
            told = ask(gate("G type != pick", memory=encode_fast(made)), of(TELL, "m-1"))
            assert hazards(told) == [("STATE_UNKNOWN", "memory")]


@pytest.mark.parametrize("data", [b"lost", b"{}", b"null", b"\xff", b" " * (MAX_MEMORY + 1)])
def test_no_bytes_are_read_as_a_fresh_start(data: bytes) -> None:
    told = ask(gate("G type != pick", memory=data), of(TELL, "m-1"))
    assert hazards(told) == [("STATE_UNKNOWN", "memory")]


def test_a_new_message_keeps_the_memory_and_a_new_formula_does_not() -> None:
    kept = Rule(id="rule-0", formula="G type != pick", message="no lifting")
    assert ask(TemporalGate(config(rules=(kept,)), done("m-1")), of(TELL, "m-1")).safe
    speed = config("G type != pick", max_speed_mm_s=1)
    assert ask(TemporalGate(speed, done("m-1")), of(TELL, "m-1")).safe


def test_a_memory_is_never_longer_than_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    here = gate("G type != pick")
    length = len(ask(here, TELL).memory[0])
    monkeypatch.setattr(memories, "MAX_MEMORY", length - 1)
    assert hazards(ask(here, TELL)) == [("STATE_UNKNOWN", "memory")]
    monkeypatch.setattr(memories, "MAX_MEMORY", length)
    assert ask(here, TELL).safe


def test_a_rule_that_grows_while_it_is_followed_makes_the_action_unsafe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = gate("X type = announce | X type = navigate", "G type != pick")
    monkeypatch.setattr("authguard_r.safety.temporal.track.MAX_WAYS", 1)
    assert hazards(ask(here, SCAN)) == [("STATE_UNKNOWN", "rules.rule-0")]


# the configuration


def test_a_rule_that_grows_makes_the_configuration_invalid_though_it_is_signed() -> None:
    wide = " & ".join(
        f"F object = {name}" for name in ("package-p1", "package-p2", "package-p3", "a", "b", "c")
    )
    for formula, where in (
        (f"({wide}) & F destination = icu & F source = a & F type = a", "safety.rules[1].formula"),
        ("G type = ", "safety.rules[1].formula:10"),
        ("G false", "safety.rules[1].formula"),
    ):
        folder = scenarios.trust_folder()
        officer = scenarios.folder_signer(folder, "safety-officer-1")
        token = sign_object(config("G type != pick", formula), Tag.SAFETY, officer)
        with pytest.raises(MalformedError) as refused:
            open_config(token, verifier=read_trust(folder), now=Now(scenarios.START_MS, 0))
        assert refused.value.where == where
        with pytest.raises(MalformedError):
            gate(formula)


def test_two_rules_of_one_name_and_too_many_rules_are_refused() -> None:
    twice = (Rule(id="a", formula="true"), Rule(id="a", formula="G type != pick"))
    with pytest.raises(MalformedError, match="same id"):
        compile_rules(twice)
    many = tuple(Rule(id=f"r{n}", formula="true") for n in range(MAX_RULES + 1))
    assert len(compile_rules(many[1:])) == MAX_RULES
    with pytest.raises(MalformedError, match=f"at most {MAX_RULES} rules"):
        compile_rules(many)


def test_the_configuration_of_before_is_spelled_as_it_was() -> None:
    """Neither rules nor checker: bytes, and so signatures, are those of earlier versions."""
    assert b"rules" not in encode_fast(config())
    assert b"checker" not in encode_fast(config())
