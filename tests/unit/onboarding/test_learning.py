# SPDX-License-Identifier: Apache-2.0
"""A proposed mission holds what occurred and nothing else; gate and oracle are asked both ways."""

from __future__ import annotations

import re
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.compile.answers import apply, compile_plain
from authguard_r.authoring.onboarding.evidence import Proposed, ShadowEvidence, gather
from authguard_r.authoring.onboarding.grants import draft_of, learn
from authguard_r.authoring.onboarding.pages import MISSION, propose, ranked, row_line
from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.decision import Verdict
from authguard_r.core.errors import ClarificationError
from authguard_r.core.mission import MAX_GRANTS, MAX_ROWS, Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.provenance.context import Influence
from authguard_r.site.source import read_yaml
from fixtures import scenarios
from fixtures import shadow_logs as logs
from fixtures.amount import amount
from fixtures.decision_cases import Case, decide_case, oracle_case

SITE = scenarios.site()
#: What a person answers so that nothing but the proposal's own bounds is left to refuse.
ANSWERS: tuple[tuple[str, Any], ...] = (
    (r"task", "What was seen."),
    (r"issuer", "operator-1"),
    (r"window", {"for": "25 min"}),
    (r"place_max_age", "10 s"),
    (r".*\.chooser", "planner"),
    (r".*\.max", "1 min"),
    (r".*\.irreversible", False),
    (r".*\.data\..*", True),
    (r"budgets\.rate\.count", 1_000),
    (r"budgets\.rate\.per", "1 s"),
    (r"budgets\.(motion|waiting)", "10 h"),
    (r"budgets\.recorded_bytes", 9_000_000_000),
    (r"budgets\.(prompts|planner_stops)", 3),
    (r"on_refusal", "hold"),
    (r"risk_policy\.(privacy|otherwise)", 0),
    (r"risk_policy\.tau_[12]", 1_000),
    (r"risk_policy\.t", 2),
    (r"risk_policy\.roles", ["supervisor"]),
    (r"risk_policy\.valid", "1 min"),
)
RELAXED = settings(max_examples=amount(20, 60), suppress_health_check=list(HealthCheck))
SEEDS = st.integers(min_value=0, max_value=2**63)
PLACES = ("dock", "pharmacy", "station-101", "public-corridor")


def answered(plain: object) -> Mission:
    """Return the proposed mission with every question answered as widely as may be."""
    for _ in range(5):
        try:
            return compile_plain(plain, SITE, now=scenarios.NOW, nonce="A" * 22)
        except ClarificationError as error:
            fields = [asked.field for asked in (error, *error.others)]
            plain = apply(plain, {field: answer(field) for field in fields})
    raise AssertionError("the compiler goes on asking")


def answer(field: str) -> Any:
    return next(value for pattern, value in ANSWERS if re.fullmatch(pattern, field))


def random_action(rnd: Random) -> tuple[Action, str]:
    """Return an action that the courier could propose, and where it stands then."""
    at = rnd.choice(PLACES)
    kind = rnd.choice(["navigate", "navigate", "pick", "place", "wait", "scan", "film", "say"])
    if kind == "navigate":
        route = tuple(rnd.sample(PLACES, rnd.randint(0, 2)))
        speed = rnd.randint(50, 1_500)
        return scenarios.navigate(at, rnd.choice(PLACES), speed=speed, route=route), at
    thing = rnd.choice(["package-p1", "package-p2"])
    force = {"force_mn": rnd.randint(1, 40_000)}
    made = {
        "pick": Action(type="pick", tool="gripper", object=thing, source=at, params=force),
        "place": Action(
            type="place", tool="gripper", object=thing, source=at, destination=at, params=force
        ),
        "wait": Action(type="wait", tool="base", params={"duration_ms": rnd.randint(1, 60_000)}),
        "scan": Action(type="scan_obstacles", tool="lidar"),
        "say": Action(type="announce", tool="speaker"),
        "film": Action(
            type="record_video",
            tool="camera",
            source=at,
            params={"duration_ms": rnd.randint(1, 9_000), "max_bytes": rnd.randint(1, 9_000)},
        ),
    }
    return made[kind], at


def run(rnd: Random) -> tuple[list[tuple[Action, str]], ShadowEvidence]:
    seen = [random_action(rnd) for _ in range(rnd.randint(1, 8))]
    entries = [logs.decided(action, at=at) for action, at in seen]
    return seen, gather(logs.in_memory(*entries), SITE)


def verdict(mission: Mission, action: Action, at: str) -> Verdict:
    """Return what the gate says of an action under the mission, and that the oracle agrees."""
    meta = ActionMeta(
        planner="planner",
        timestamp=to_timestamp(scenarios.NOW.utc_ms),
        evidence=logs.EVIDENCE,
        mission=mission.mid,
        mission_version=mission.version,
    )
    case = Case(
        mission=mission,
        action=msgspec.structs.replace(action, meta=meta, provenance={}),
        state=scenarios.state(at),
        now=scenarios.NOW,
        standing=scenarios.active(scenarios.verified(mission)),
    )
    ours, theirs = decide_case(case), oracle_case(case)
    told = (str(ours.verdict), [str(reason) for reason in ours.reasons])
    assert told == (theirs["verdict"], theirs["reasons"])
    return ours.verdict


def row_of(action: Action) -> tuple[Any, ...]:
    return (action.type, action.tool, action.object, action.source, action.destination)


@pytest.mark.complete
@RELAXED
@given(SEEDS)
def test_every_grant_row_and_limit_is_justified_by_a_record(seed: int) -> None:
    seen, evidence = run(Random(seed))
    learned = learn(evidence.proposed)
    actions = [action for action, _ in seen]
    of_grant = {(grant.type, grant.tool): grant for grant in learned.grants}
    assert of_grant.keys() == {(action.type, action.tool) for action in actions}
    for grant in learned.grants:
        mine = [
            action for action in actions if (action.type, action.tool) == (grant.type, grant.tool)
        ]
        assert grant.starts == len(mine)
        assert {
            (grant.type, grant.tool, r.object, r.source, r.destination) for r in grant.rows
        } == {row_of(action) for action in mine}
        for name, (low, high) in grant.limits.items():
            values = [action.params[name] for action in mine if name in action.params]
            assert (low, high) == (min(values), max(values))
        for row in grant.rows:
            assert row.seqs
            for seq in row.seqs:
                action, at = seen[seq - 1]
                ends = {action.source, action.destination, *action.route, at} - {None}
                assert set(row.regions) == ends


@pytest.mark.complete
@RELAXED
@given(SEEDS)
def test_every_action_that_was_seen_is_accepted_and_a_changed_one_is_not(seed: int) -> None:
    rnd = Random(seed)
    seen, evidence = run(rnd)
    proposals = propose(evidence, SITE, None)
    mission = answered(read_yaml(proposals.files[MISSION], where="m"))
    assert mission.budgets.actions == len(seen)
    for action, at in seen:
        assert verdict(mission, action, at) is Verdict.ACCEPT
    known = {row_of(action) for action, _ in seen}
    for _ in range(12):
        action, at = random_action(rnd)
        if row_of(action) not in known:
            assert verdict(mission, action, at) is not Verdict.ACCEPT
    for action, at in seen:
        for name in action.params:
            same = [
                a.params[name] for a, _ in seen if (a.type, a.tool) == (action.type, action.tool)
            ]
            for beyond in (min(same) - 1, max(same) + 1):
                params = {**action.params, name: beyond}
                changed = msgspec.structs.replace(action, params=params)
                assert verdict(mission, changed, at) is not Verdict.ACCEPT
        for field, value in (("tool", "arm"), ("type", "take_photo"), ("destination", "office-1")):
            if getattr(action, field) != value:
                changed = msgspec.structs.replace(action, **{field: value})
                assert verdict(mission, changed, at) is not Verdict.ACCEPT


def test_rows_are_never_a_cross_product() -> None:
    pairs = [("dock", "pharmacy"), ("pharmacy", "station-101")]
    entries = [logs.decided(scenarios.navigate(a, b), at=a) for a, b in pairs]
    evidence = gather(logs.in_memory(*entries), SITE)
    mission = answered(draft_of(learn(evidence.proposed), SITE, robot=scenarios.RID))
    assert verdict(mission, scenarios.navigate("dock", "pharmacy"), "dock") is Verdict.ACCEPT
    crossed = scenarios.navigate("dock", "station-101")
    assert verdict(mission, crossed, "dock") is Verdict.REJECT


def test_what_the_log_cannot_say_is_asked_and_what_never_was_is_zero() -> None:
    evidence = gather(logs.in_memory(logs.decided(scenarios.navigate("dock", "pharmacy"))), SITE)
    proposals = propose(evidence, SITE, None)
    asked = {field for field, _ in proposals.questions}
    assert {"task", "issuer", "window", "place_max_age", "on_refusal", "risk_policy.tau_1"} < asked
    assert {"grants[0].chooser", "grants[0].max", "grants[0].irreversible"} < asked
    assert "budgets.motion" in asked
    plain = read_yaml(proposals.files[MISSION], where="m")
    assert plain["budgets"] == {"actions": 1, "waiting": 0, "recorded_bytes": 0}
    text = proposals.files[MISSION]
    assert all(f"TODO {field}" in text for field in asked)
    assert text.startswith("# PROPOSED")


def test_an_action_without_an_attested_start_leaves_the_start_open() -> None:
    go = Action(type="navigate", tool="base", destination="pharmacy", params={"speed_mm_s": 5})
    item = Proposed(seq=1, action=go, place=frozenset(), influences=None)
    plain = draft_of(learn([item]), SITE, robot=None)
    assert plain["grants"][0]["rows"] == [{"destination": "pharmacy"}]
    assert "robot" not in plain


def test_rows_that_an_input_had_mentioned_come_first_and_say_so() -> None:
    notice = Influence(
        field="destination",
        value="station-103",
        channel="camera",
        label="camera",
        evidence=logs.EVIDENCE,
    )
    entries = (
        logs.decided(scenarios.navigate("dock", "pharmacy")),
        logs.decided(scenarios.navigate("dock", "station-103"), influences=(notice,)),
    )
    evidence = gather(logs.in_memory(*entries), SITE)
    unlooked = msgspec.structs.replace(
        evidence.proposed[0], influences=None, action=scenarios.navigate("dock", "office-1")
    )
    rows = ranked(learn((*evidence.proposed, unlooked)))
    assert [row.destination for _, row in rows] == ["station-103", "office-1", "pharmacy"]
    assert "INFLUENCED by camera" in row_line(rows[0][1])
    assert "is unknown" in row_line(rows[1][1])


def test_a_mission_has_room_for_so_many_grants_and_rows_and_the_rest_is_said() -> None:
    def item(seq: int, **changes: Any) -> Proposed:
        action = scenarios.navigate("dock", "pharmacy", **changes)
        return Proposed(seq=seq, action=action, place=frozenset(), influences=())

    tools = [item(n, tool=f"tool-{n}") for n in range(MAX_GRANTS + 3)]
    learned = learn(tools)
    assert len(learned.grants) == MAX_GRANTS
    assert [unused.seq for unused in learned.unused] == [64, 65, 66]
    assert len({grant.id for grant in learned.grants}) == MAX_GRANTS
    rows = [item(n, object=f"thing-{n}") for n in range(MAX_ROWS + 2)]
    assert len(learn(rows).grants[0].rows) == MAX_ROWS
    assert len(learn(rows).unused) == 2


def test_grants_whose_names_would_meet_or_be_too_long_get_numbers() -> None:
    def item(kind: str, tool: str) -> Proposed:
        action = Action(type=kind, tool=tool)
        return Proposed(seq=1, action=action, place=frozenset(), influences=())

    pairs = [("a-b", "c"), ("a", "b-c"), ("grant", "1"), ("x" * 40, "y" * 40), ("grant", "3")]
    ids = [grant.id for grant in learn([item(*pair) for pair in pairs]).grants]
    assert len(set(ids)) == len(pairs)
    assert ids[:2] == ["a-b-c", "grant-1"]


def test_the_way_home_is_a_grant_of_its_own_and_says_that_it_wants_a_guard() -> None:
    ends = [("dock", "pharmacy"), ("pharmacy", "dock"), ("pharmacy", "station-101")]
    entries = [logs.decided(scenarios.navigate(a, b), at=a) for a, b in ends]
    evidence = gather(logs.in_memory(*entries), SITE)
    for robot in (evidence.robot, None):
        proposals = propose(msgspec.structs.replace(evidence, robot=robot), SITE, None)
        out, home = proposals.learned.grants
        assert [row.destination for row in out.rows] == ["pharmacy", "station-101"]
        assert [row.destination for row in home.rows] == ["dock"]
        assert (home.id, home.leaves, out.leaves) == ("navigate-base-home", True, False)
        page = proposals.files[MISSION]
        assert page.index("after: [GRANT]") > page.index(home.id)
