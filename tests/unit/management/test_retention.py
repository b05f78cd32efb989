# SPDX-License-Identifier: Apache-2.0
"""A mission has retention times of its own, within the bounds of the gate's configuration.

Source: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import due_missions, retention_of
from authguard_r.audit.record import LogRow
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import FIRST_SCHEMA, DataClass, Mission
from authguard_r.core.quantities import to_ms
from authguard_r.enforcement.management.parts import entry
from authguard_r.enforcement.management.shredding import DAY_MS, Retired
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.operations.simulation import Simulation
from fixtures import scenarios, sealed_logs

OBJECT, REGION = DataClass.OBJECT, DataClass.REGION
GO = scenarios.navigate("dock", "pharmacy")
MINUTE_MS, HOUR_MS = 60_000, 3_600_000
#: A gate with rules for two classes; the longest `least_ms` is 1 h, also for other classes.
RULES = (
    sealed_logs.rule(OBJECT, least_ms=HOUR_MS),
    sealed_logs.rule(REGION, most_ms=2 * HOUR_MS),
)
BOUNDED = sealed_logs.policy(sealed_logs.reader("porter", OBJECT, REGION), retention=RULES)
#: A gate that seals every class and has no rule.
FREE = sealed_logs.policy()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "robot.db"


def begun(sim: Simulation, retention: dict[str, int], **changes: Any) -> Mission:
    """Activate a mission with these times, and let it do something."""
    mission: Mission = sealed_logs.active(sim, retention=retention, **changes)
    scenarios.propose(sim, GO)
    return mission


def ended(sim: Simulation, retention: dict[str, int], **changes: Any) -> Mission:
    mission = begun(sim, retention, **changes)
    sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
    return mission


def digest(sim: Simulation, mission: Mission) -> Digest:
    standing = sim.gate.management.standing(mission.mid)
    assert standing is not None
    return standing.digest


def after_expiry(sim: Simulation, mission: Mission, ms: int) -> None:
    """Let it be this long after a mission's expiry."""
    over_ms = to_ms(mission.expiry, where="expiry") + ms
    sim.robot.elapsed_ms += over_ms - sim.gate.ledger.now().utc_ms


def destroyed(sim: Simulation) -> list[tuple[str, tuple[DataClass, ...]]]:
    """Return what the gate begins to destroy now, and destroy it."""
    done = sim.gate.management.retire()
    assert done.stuck == ()
    while sim.gate.management.shred_on():
        pass
    return [(one.mid, one.classes) for one in done.begun if one.mid != "-"]


def due(sim: Simulation) -> tuple[str, ...]:
    return sim.gate.ledger.peek(due_missions)


def rows(sim: Simulation) -> list[LogRow]:
    return [LogRow(*row) for row in sim.gate.ledger.peek(lambda turn: turn.rows(0, 10_000))]


# activation


@pytest.mark.parametrize(
    ("policy", "retention", "place", "text"),
    [
        (BOUNDED, {"person": DAY_MS}, "person", "a class that this gate seals (object, region)"),
        (SealingPolicy(), {"region": DAY_MS}, "region", "seals (it seals none)"),
        (BOUNDED, {"object": HOUR_MS - 1}, "object", "expected at least 1 h, got 59 min 59.999 s"),
        (
            BOUNDED,  # the longest `least_ms` is of another class: fields lie together
            {"region": 1},
            "region",
            "expected at least 1 h and at most 2 h, got 0.001 s",
        ),
        (
            BOUNDED,
            {"object": DAY_MS, "region": 2 * HOUR_MS + 1},
            "region",
            "expected at least 1 h and at most 2 h, got 2 h 0.001 s",
        ),
    ],
)
def test_a_time_outside_the_bounds_of_the_gate_is_refused_and_nothing_is_activated(
    path: Path, policy: SealingPolicy, retention: dict[str, int], place: str, text: str
) -> None:
    with sealed_logs.sealing(path, policy) as sim:
        mission = scenarios.mission(retention=retention)
        before = sim.gate.ledger.peek(lambda turn: turn.head())[0]
        with pytest.raises(AuthGuardError) as error:
            sim.gate.management.activate(scenarios.token(mission))
        assert (error.value.reason, error.value.where) == (
            "VALUE_OUT_OF_RANGE",
            f"mission.retention.{place}",
        )
        assert text in error.value.message
        assert error.value.message.endswith("change `retention` in the draft and compile it again")
        assert sim.gate.management.standing(mission.mid) is None
        assert sim.gate.ledger.run(lambda act: act.active()) is None
        assert due(sim) == ()
        held = sim.gate.ledger.peek(lambda turn: retention_of(turn, mission.mid, FREE))
        assert held == {}
        told = [sealed_logs.told(row) for row in rows(sim)[before:]]
        (refusal,) = [one for one in told if one.kind != "sealing"]
        assert (refusal.kind, refusal.open["reasons"]) == ("refusal", ["VALUE_OUT_OF_RANGE"])


def test_an_update_outside_the_bounds_leaves_the_version_before_and_its_times(path: Path) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        first = begun(sim, {"region": HOUR_MS})
        one = digest(sim, first)
        with pytest.raises(AuthGuardError) as error:
            begun(sim, {"region": 1}, version=2, supersedes=one)
        assert error.value.where == "mission.retention.region"
        assert digest(sim, first) == one
        held = sim.gate.ledger.peek(lambda turn: retention_of(turn, first.mid, FREE))
        assert held == {REGION: HOUR_MS}


@pytest.mark.parametrize(
    ("policy", "retention"),
    [
        (BOUNDED, {"object": HOUR_MS, "region": HOUR_MS}),
        (BOUNDED, {"object": 10_000 * DAY_MS, "region": 2 * HOUR_MS}),  # `most_ms` 0: no bound
        (FREE, {"person": 1}),
    ],
)
def test_a_time_at_a_bound_is_taken(
    path: Path, policy: SealingPolicy, retention: dict[str, int]
) -> None:
    with sealed_logs.sealing(path, policy) as sim:
        mission = begun(sim, retention)
        held = sim.gate.ledger.peek(lambda turn: retention_of(turn, mission.mid, policy))
        assert held == {REGION: 2 * HOUR_MS, **retention} if policy is BOUNDED else retention


# retirement


@pytest.mark.parametrize("own_ms", [HOUR_MS, HOUR_MS + 1, 2 * HOUR_MS])
def test_a_missions_own_time_counts_in_place_of_the_gates(path: Path, own_ms: int) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        mission = ended(sim, {"region": own_ms})
        after_expiry(sim, mission, own_ms - 1)
        assert destroyed(sim) == []
        after_expiry(sim, mission, own_ms)
        assert destroyed(sim) == [(mission.mid, (REGION,))]
        assert due(sim) == ()
        read = b"".join(row.sealed for row in sealed_logs.opened(rows(sim), "porter")[1:])
        assert (b'"destination":"pharmacy"' in read, b'"action.object"' in read) == (False, True)


def test_a_gate_without_a_rule_destroys_what_a_mission_says_and_nothing_else(path: Path) -> None:
    with sealed_logs.sealing(path, FREE) as sim:
        first = ended(sim, {"region": HOUR_MS})
        other = ended(sim, {}, mission="other")
        assert due(sim) == (first.mid,)
        after_expiry(sim, other, DAY_MS)
        assert destroyed(sim) == [(first.mid, (REGION,))]
        assert (due(sim), sim.gate.management.retire()) == ((), Retired())


def test_a_class_of_which_the_mission_says_nothing_is_kept_as_the_gate_says(path: Path) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        mission = ended(sim, {"object": HOUR_MS})
        after_expiry(sim, mission, HOUR_MS)
        assert destroyed(sim) == [(mission.mid, (OBJECT,))]
        assert due(sim) == (mission.mid,)
        after_expiry(sim, mission, 2 * HOUR_MS)
        assert destroyed(sim) == [(mission.mid, (REGION,))]
        assert due(sim) == ()


def test_two_missions_have_different_times(path: Path) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        first = ended(sim, {"region": HOUR_MS + 2 * MINUTE_MS})
        second = ended(sim, {"region": HOUR_MS}, mission="second")
        assert first.expiry == second.expiry
        after_expiry(sim, first, HOUR_MS)
        assert destroyed(sim) == [(second.mid, (REGION,))]
        after_expiry(sim, first, HOUR_MS + 2 * MINUTE_MS)
        assert destroyed(sim) == [(first.mid, (REGION,))]


@pytest.mark.parametrize(
    ("before", "after", "then_ms"),
    [
        ({}, {"region": HOUR_MS}, HOUR_MS),
        ({"region": HOUR_MS}, {"region": 3 * HOUR_MS}, 3 * HOUR_MS),
        ({"region": 3 * HOUR_MS}, {"region": HOUR_MS}, HOUR_MS),
        ({"region": HOUR_MS}, {"object": DAY_MS}, None),
        ({"region": HOUR_MS}, {}, None),
    ],
)
def test_an_update_replaces_the_times(
    path: Path, before: dict[str, int], after: dict[str, int], then_ms: int | None
) -> None:
    with sealed_logs.sealing(path, FREE) as sim:
        first = begun(sim, before)
        second = ended(sim, after, version=2, supersedes=digest(sim, first))
        after_expiry(sim, second, 3 * HOUR_MS - 1 if then_ms is None else then_ms - 1)
        assert destroyed(sim) == []
        after_expiry(sim, second, 3 * HOUR_MS if then_ms is None else then_ms)
        assert destroyed(sim) == ([] if then_ms is None else [(second.mid, (REGION,))])


def test_what_is_sealed_after_a_missions_time_is_destroyed_too(path: Path) -> None:
    """Another start seals it under other keys, which the order of before did not reach."""
    with sealed_logs.sealing(path, FREE) as sim:
        mission = ended(sim, {"region": HOUR_MS})
        after_expiry(sim, mission, HOUR_MS)
        assert (destroyed(sim), due(sim)) == ([(mission.mid, (REGION,))], ())
    with sealed_logs.sealing(path) as sim:
        late: dict[str, object] = {"verb": "answer", "by": "anna"}
        sim.gate.ledger.run(
            lambda act: act.record(entry(act, mission.mid, late, {"where": "pharmacy"}))
        )
        assert due(sim) == (mission.mid,)
        assert (destroyed(sim), due(sim)) == ([(mission.mid, (REGION,))], ())
        mine = [row for row in rows(sim) if sealed_logs.told(row).link.mid == mission.mid]
        assert not [name for row in mine for name in sealed_logs.values(row) if "region" in name]


def test_an_order_is_refused_before_the_gates_least_time_whatever_the_mission_says(
    path: Path,
) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        mission = ended(sim, {"object": HOUR_MS, "region": HOUR_MS})
        after_expiry(sim, mission, HOUR_MS - 1)
        with pytest.raises(AuthGuardError) as error:
            sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        assert error.value.reason == "NOT_YET_VALID"
        after_expiry(sim, mission, HOUR_MS)
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))


@pytest.mark.parametrize(
    ("rules", "end_ms"),
    [
        ((sealed_logs.rule(OBJECT, least_ms=5 * HOUR_MS),), 5 * HOUR_MS),  # the stricter least
        ((sealed_logs.rule(REGION, most_ms=HOUR_MS),), HOUR_MS),  # the lower most
        ((sealed_logs.rule(REGION, least_ms=1, most_ms=DAY_MS),), 3 * HOUR_MS),  # between them
        ((), 3 * HOUR_MS),
        (None, 3 * HOUR_MS),  # and the gate seals nothing any more
    ],
)
def test_a_changed_configuration_bounds_the_times_of_missions_that_are_here(
    path: Path, rules: tuple[Any, ...] | None, end_ms: int
) -> None:
    with sealed_logs.sealing(path, FREE) as sim:
        mission = ended(sim, {"region": 3 * HOUR_MS})
    policy = SealingPolicy() if rules is None else sealed_logs.policy(retention=rules)
    with sealed_logs.sealing(path, policy) as sim:
        after_expiry(sim, mission, end_ms - 1)
        assert destroyed(sim) == []
        after_expiry(sim, mission, end_ms)
        assert destroyed(sim) == [(mission.mid, (REGION,))]


# what was before


def test_a_mission_of_the_first_language_is_kept_as_the_gate_says(path: Path) -> None:
    with sealed_logs.sealing(path, BOUNDED) as sim:
        mission = replace(scenarios.mission(), schema=FIRST_SCHEMA)
        sim.gate.management.activate(scenarios.token(mission))
        scenarios.propose(sim, GO)
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        held = sim.gate.ledger.peek(lambda turn: turn.get("sealing-retention", mission.mid))
        assert held is None
        after_expiry(sim, mission, 2 * HOUR_MS - 1)
        assert destroyed(sim) == []
        after_expiry(sim, mission, 2 * HOUR_MS)
        assert destroyed(sim) == [(mission.mid, (REGION,))]


def test_missions_of_a_gate_that_had_rules_wait_while_there_are_none(path: Path) -> None:
    """A store of before: what its last gate tracked is neither destroyed nor forgotten."""
    with sealed_logs.sealing(path, BOUNDED) as sim:
        mission = ended(sim, {})
    with sealed_logs.sealing(path, FREE) as sim:
        after_expiry(sim, mission, DAY_MS)
        assert (sim.gate.management.retire(), due(sim)) == (Retired(), (mission.mid,))
    with sealed_logs.sealing(path, BOUNDED) as sim:
        after_expiry(sim, mission, DAY_MS)
        assert destroyed(sim) == [(mission.mid, (REGION,))]


@pytest.mark.parametrize("held", [b"soon", b'{"region":0}', b'{"weather":1}'])
def test_times_that_the_store_cannot_say_keep_no_other_mission_from_its_end(
    path: Path, held: bytes
) -> None:
    with sealed_logs.sealing(path, FREE) as sim:
        first = ended(sim, {"region": 1})
        second = ended(sim, {"region": 1}, mission="second")
        sim.gate.ledger.run(lambda act: act.put("sealing-retention", first.mid, held))
        after_expiry(sim, second, 1)
        done = sim.gate.management.retire()
        assert ([one.mid for one in done.begun], done.stuck) == ([second.mid], (first.mid,))
