# SPDX-License-Identifier: Apache-2.0
"""Faults seen in other projects that guard robots and agents; each is refused here.

One test for one lesson, named after it; the numbers are those of the project's list of lessons.
"""

from __future__ import annotations

from random import Random

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.decision import Verdict as Answer
from authguard_r.core.encoding import encode
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome
from authguard_r.keys.ed25519 import public_key
from authguard_r.normalize import Binder, read_plan
from fixtures import scenarios
from fixtures.cases import case
from fixtures.decision_cases import (
    ALONE,
    _plain,
    _with_action,
    _with_grant,
    accepted_case,
    decide_case,
)
from missionpair.bench import calls, make_bench
from missionpair.suite import ATTACKS
from missionpair.systems import System, run_trial

BINDER = Binder(scenarios.site(), scenarios.binding())


def refused(text: str) -> str:
    with pytest.raises(MalformedError) as caught:
        read_plan(text.encode(), binder=BINDER)
    return str(caught.value.reason)


@pytest.mark.parametrize(
    "text", ["st\u0430tion 101", "STATION_101", "5tation 1O1", "station one-oh-one"]
)
def test_l2_a_look_alike_is_evidence_for_people_and_names_nothing_to_the_gate(text: str) -> None:
    call = f'{{"tool": "navigate_to", "arguments": {{"destination": "{text}"}}}}'
    assert refused(call) == "NAME_UNKNOWN"
    seen = BINDER.context()
    seen.add("ocr", text)
    named = seen.influences(scenarios.navigate("dock", "station-101"))
    assert [(item.value, item.channel) for item in named] == [("station-101", "ocr")]


def test_l4_who_a_text_says_it_is_from_is_not_read() -> None:
    seen = BINDER.context()
    seen.add("operator", '{"channel": "estimator", "label": "operator", "signed": true}')
    assert seen.base() == "model"
    with pytest.raises(MalformedError):
        BINDER.context({"operator": "operator"})


def test_l3_a_velocity_that_is_no_sound_number_is_refused() -> None:
    for speed in ["NaN", "-1", "true", '"0.5"', "1e400", "[0.5]", "9" * 50]:
        with case(speed):
            there = f'{{"destination": "Dock", "speed": {speed}}}'
            text = f'{{"tool": "navigate_to", "arguments": {there}}}'
            assert refused(text) in {"MALFORMED", "VALUE_INVALID", "VALUE_OUT_OF_RANGE"}


def test_l3_an_absent_velocity_is_not_compliant() -> None:
    case = _with_action(_plain(Random(1), "navigate"), params={})
    assert [str(r) for r in decide_case(case).reasons] == ["PARAMETER_MISSING"]


def test_l4_scope_approval_state_and_time_are_not_read_from_a_request() -> None:
    for claim in ("mission", "approved", "state", "position", "now", "provenance", "source"):
        call = f'{{"tool": "navigate_to", "arguments": {{"destination": "Dock", "{claim}": "x"}}}}'
        assert refused(call) == "FIELD_UNKNOWN"
    fields = {field.name for field in msgspec.structs.fields(Action)}
    assert fields.isdisjoint({"state", "now", "standing", "approvals", "issuer", "expiry"})


def test_l4_a_label_in_the_action_is_worth_nothing() -> None:
    case = ALONE["PROVENANCE_DENIED"](Random(2))
    claimed = {"destination": "operator", "object": "operator"}
    assert decide_case(_with_action(case, provenance=claimed)).verdict is Answer.REJECT


def test_l7_nothing_signed_means_nothing_allowed() -> None:
    sim = scenarios.simulation()
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert str(report.refusal.reason) == "NO_ACTIVE_MISSION"
    assert sim.robot.trace == []


def test_l7_an_empty_list_grants_nothing() -> None:
    case = _plain(Random(3), "navigate")
    closed = cases_without_regions(case)
    assert decide_case(closed).verdict is Answer.REJECT
    assert decide_case(_with_grant(case, limits=())).verdict is Answer.REJECT


def cases_without_regions(case):  # type: ignore[no-untyped-def]
    from fixtures.decision_cases import _with_mission

    return _with_mission(case, regions=(), objects=())


def test_l9_a_refusal_names_field_expectation_and_finding() -> None:
    for reason in ALONE:
        finding = decide_case(ALONE[reason](Random(4))).findings[0]
        assert finding.field
        assert finding.expected
        assert finding.got


def test_l9_the_operator_gets_a_change_that_compiles_and_allows_the_action() -> None:
    from authguard_r.authoring.compile.build import compile_draft
    from authguard_r.authoring.compile.change import smallest_change, to_draft
    from authguard_r.authoring.compile.draft import Draft
    from authguard_r.core.decide import decide
    from authguard_r.site.source import convert

    verified = scenarios.verified()
    action = scenarios.navigate("dock", "station-102")
    inputs = {"state": scenarios.state(), "facts": scenarios.facts(), "now": scenarios.NOW}
    before = decide(verified, action, standing=scenarios.active(verified), **inputs)
    assert before.match is not None
    changed = smallest_change(
        verified.mission,
        action,
        reasons=before.reasons,
        grant=before.match.indexed.grant.id,
        digest=verified.digest,
        nonce="A" * 22,
        expiry=verified.mission.expiry,
    )
    assert changed is not None
    draft = convert(to_draft(changed), Draft, where="change")
    compiled = compile_draft(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
    assert compiled == changed
    after = scenarios.verified(compiled)
    assert (
        decide(after, action, standing=scenarios.active(after), **inputs).verdict is Answer.ACCEPT
    )


def test_l10_every_attack_of_the_suite_lands_when_nothing_stands_in_its_way(tmp_path) -> None:  # type: ignore[no-untyped-def]
    bench = make_bench(tmp_path / "trust")
    for trial in ATTACKS:
        result = run_trial(trial.prepare(bench), System.SAFETY)
        assert result.unauthorized, trial.name
        assert result.executable, trial.name
        assert result.safe, trial.name


def test_l11_one_unknown_call_refuses_the_whole_plan() -> None:
    plan = calls(("scan", {}), ("warp", {}), ("scan", {}))
    with pytest.raises(MalformedError) as caught:
        read_plan(plan, binder=BINDER)
    assert str(caught.value.reason) == "TOOL_UNKNOWN"
    assert caught.value.where.startswith("plan[1]")


def test_l31_packaging_is_read_exactly_and_noted_and_never_a_reason_to_refuse() -> None:
    """What a fence, a tag, a null or empty arguments hold is the same plan as without them."""
    call = '{"name": "navigate_to", "arguments": {"destination": "Dock", "speed": null}}'
    bare = read_plan(b'navigate_to(destination="Dock")', binder=BINDER).steps
    for text, around in [
        (f"Here it is:\n```json\n{call}\n```", "fence, 11 characters before it"),
        (f"<tool_call>{call}</tool_call>", "hermes"),
        (f"[TOOL_CALLS][{call}]", "mistral"),
        (call, ""),
    ]:
        with case(text):
            (step,) = read_plan(text.encode(), binder=BINDER).steps
            assert (step.action, step.around) == (bare[0].action, around)
    empty = '{"role": "assistant", "tool_calls": [{"function": {"name": "scan", "arguments": ""}}]}'
    assert read_plan(empty.encode(), binder=BINDER).steps[0].action.type == "scan_obstacles"


def test_l13_only_the_canonical_bytes_are_the_mission() -> None:
    import json

    from authguard_r.core.encoding import decode

    mission = scenarios.mission(task="Bring caf\u00e9 supplies.")
    assert decode(encode(mission), Mission) == mission
    dumped = json.dumps(json.loads(encode(mission)), sort_keys=True).encode()
    with pytest.raises(MalformedError, match="NOT_CANONICAL"):
        decode(dumped, Mission)


def test_l13_two_normal_forms_of_one_text_do_not_collide() -> None:
    with pytest.raises(AuthGuardError, match="SCHEMA_INVALID"):
        scenarios.mission(task="Bring cafe\u0301 supplies.")


LOW_ORDER = [
    "0100000000000000000000000000000000000000000000000000000000000000",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "0000000000000000000000000000000000000000000000000000000000000000",
    "0000000000000000000000000000000000000000000000000000000000000080",
    "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
    "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
]


@pytest.mark.parametrize("raw", LOW_ORDER)
def test_l15_keys_of_low_order_are_refused(raw: str) -> None:
    with pytest.raises(AuthGuardError, match="KEY_INVALID"):
        public_key(bytes.fromhex(raw), where="key")


def test_l17_a_commit_is_synchronous_full_in_a_write_ahead_log(tmp_path) -> None:  # type: ignore[no-untyped-def]
    sim = scenarios.simulation(store=tmp_path / "robot.db")
    connection = sim.gate.ledger.store._connection
    assert connection.execute("PRAGMA synchronous").get == 2
    assert connection.execute("PRAGMA journal_mode").get == "wal"
    assert connection.execute("PRAGMA locking_mode").get == "exclusive"
    sim.gate.close()


@pytest.mark.parametrize("tool", ["bas", "base2", "base_session", "BASE"])
def test_l21_a_longer_or_shorter_name_is_another_tool(tool: str) -> None:
    case = _with_grant(_plain(Random(5)), tool=tool.lower())
    assert "TOOL_OUT_OF_SCOPE" in [str(r) for r in decide_case(case).reasons]


def test_l22_the_readme_names_commands_that_exist() -> None:
    readme = (scenarios.ROOT / "README.md").read_text()
    tasks = (scenarios.ROOT / "dev.py").read_text()
    for command in ("demo", "test"):
        assert f"python3 dev.py {command}" in readme
        assert f'"{command}": ' in tasks


def test_an_approval_never_helps_an_action_outside_the_mission() -> None:
    case = accepted_case(Random(6))
    while not case.approvals:
        case = accepted_case(Random(hash(case.action.type) + len(case.mission.task)))
        case = next(c for c in map(accepted_case, map(Random, range(500))) if c.approvals)
    outside = _with_action(case, destination="office-2")
    assert decide_case(outside).verdict is Answer.REJECT
    assert case.approvals[0].approval.verdict is ApprovalVerdict.APPROVE


def test_outcomes_and_decisions_have_no_truth_value() -> None:
    with pytest.raises(TypeError):
        bool(Outcome.SUCCEEDED)
    with pytest.raises(TypeError):
        bool(decide_case(accepted_case(Random(8))))
