# SPDX-License-Identifier: Apache-2.0
"""AllowedSrc(f) at the gate: what site and mission allow, what reached the planner, what runs.

Source: section "Provenance Labels". Every test asserts the state afterwards: what the registry
holds, and whether the robot moved.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.provenance import Label, SourceField
from authguard_r.core.reasons import Reason
from authguard_r.site.channels import CHANNELS
from fixtures import approvals
from missionpair.bench import Bench, BenchScene, make_bench, propose
from missionpair.suite import at_dock

#: Every label but a camera's.
NO_CAMERA = [str(label) for label in Label if label is not Label.CAMERA]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def scene(bench: Bench, *to: str, **changes: Any) -> BenchScene:
    """Return a scene at the dock whose planner goes to the first of the places, as it may."""
    draft = {**approvals.draft(bench, *(to or ("pharmacy",))), **changes}
    return at_dock(bench, draft, approvals.plan("pharmacy"))


def denied(at: BenchScene, channel: str = "") -> list[str]:
    """Propose once a text came on a channel, none if it is empty; return the fields denied."""
    at.context = [(channel, "The lift is out of order.")] if channel else []
    judged = propose(at)[-1].judged
    assert judged is not None
    found = judged.decision.findings
    assert {finding.reason for finding in found} <= {Reason.PROVENANCE_DENIED}
    assert (at.sim.robot.state.region != "dock") is (not found)
    return [finding.field for finding in found]


@pytest.mark.parametrize("field", ["type", "tool", "destination", "parameters"])
def test_a_planner_that_saw_a_label_that_is_left_out_sets_that_field_no_more(
    bench: Bench, field: str
) -> None:
    at = scene(bench, "pharmacy", "office-1", sources={field: NO_CAMERA})
    assert denied(at, "camera") == [field]
    assert denied(at, "audio") == []


@pytest.mark.parametrize("channel", sorted(CHANNELS))
def test_a_set_of_the_models_label_alone_lets_no_other_channel_in(
    bench: Bench, channel: str
) -> None:
    at = scene(bench, "pharmacy", "office-1", sources={"destination": ["model"]})
    is_less = CHANNELS[channel] is not Label.MODEL
    assert denied(at, channel) == (["destination"] if is_less else [])


def test_one_signed_value_is_the_signers_whatever_the_planner_saw(bench: Bench) -> None:
    at = scene(bench, sources={"destination": ["operator", "supervisor"]})
    assert denied(at, "camera") == []


def test_a_wide_set_gives_no_choice_that_the_grant_does_not_give(bench: Bench) -> None:
    draft = approvals.draft(bench, "pharmacy", "office-1")
    grants = [{**grant, "chooser": "operator"} for grant in draft["grants"]]
    sources = {"destination": [str(label) for label in Label]}
    at = scene(bench, "pharmacy", "office-1", grants=grants, sources=sources)
    assert denied(at) == ["destination"]


def test_the_sites_sets_count_for_a_mission_that_has_none(bench: Bench) -> None:
    site = replace(bench.site, sources={SourceField.TYPE: (Label.MODEL,)})
    narrow = Bench(bench.folder, site, bench.binding, bench.start_ms)
    at = scene(narrow)
    assert at.mission.sources == {}
    assert denied(at, "document") == ["type"]
    assert denied(at) == []


def test_a_mission_wider_than_its_site_is_not_activated(bench: Bench) -> None:
    """The attack: an operator signs what the site authority does not allow."""
    site = replace(bench.site, sources={SourceField.ROUTE: (Label.MODEL, Label.OPERATOR)})
    narrow = Bench(bench.folder, site, bench.binding, bench.start_ms)
    sim = narrow.simulation()
    mission = narrow.mission(approvals.draft(narrow, "pharmacy"))
    wide = replace(mission, sources={SourceField.ROUTE: (Label.CAMERA, Label.MODEL)})
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(narrow.sign(wide))
    assert error.value.reason is Reason.PROVENANCE_DENIED
    assert error.value.where == "mission.sources.route"
    assert "model, operator" in error.value.message
    assert sim.gate.ledger.standing(mission.mid) is None


def test_a_token_of_the_first_language_is_accepted_as_before(bench: Bench) -> None:
    at = scene(bench, "pharmacy", "office-1")
    first = replace(at.mission, schema="authguard-r/mission/1")
    sim = bench.simulation()
    sim.gate.management.activate(bench.sign(first))
    assert denied(BenchScene(sim=sim, mission=first, plan=at.plan), "camera") == []


def test_a_token_of_the_first_language_with_a_newer_field_is_refused_by_its_place(
    bench: Bench,
) -> None:
    mission = bench.mission({**approvals.draft(bench, "pharmacy"), "retention": {"person": "1 h"}})
    sim = bench.simulation()
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(bench.sign(replace(mission, schema="authguard-r/mission/1")))
    assert (error.value.reason, error.value.where) == (Reason.SCHEMA_INVALID, "retention")
    assert "authguard mission compile" in error.value.message
    assert sim.gate.ledger.standing(mission.mid) is None


def test_the_log_has_every_fields_label_the_deviation_and_its_weights(bench: Bench) -> None:
    policy = approvals.draft(bench, "pharmacy")["risk_policy"]
    weighed = {**policy, "field_weights": {"provenance": 6, "time": 4}}
    at = scene(bench, sources={"type": ["model"]}, risk_policy=weighed)
    assert denied(at, "camera") == ["type"]
    told = approvals.records(at, "decision")[-1]["open"]
    assert told["weights"] == {"provenance": 6, "time": 4}
    assert Fraction(*told["deviation"]) == Fraction(6, 23)
    assert told["labels"] == {
        "type": "camera",
        "tool": "camera",
        "source": "trusted_sensor",
        "destination": "operator",
        "params": "camera",
    }
