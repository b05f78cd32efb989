# SPDX-License-Identifier: Apache-2.0
"""A store and its outside counter: what was put back refuses everything until somebody signs."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.anchoring.anchor import CounterReading, Discrepancy, StoreAnchor, read_counter
from authguard_r.anchoring.counter import CounterNote, FileCounter, open_note, seal
from authguard_r.audit.record import read_record
from authguard_r.authoring.keys.setup import Member, demo_members, init_folder
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import (
    AuthGuardError,
    ClockError,
    EnvironmentFault,
    RefusedError,
    StoreError,
)
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, StoreClaim, Verb
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.operations.offline import offline_gate
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.server.wiring import LogSettings, assemble
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store, read_held
from fixtures import scenarios

GO = scenarios.navigate("dock", "pharmacy")
HOUR_MS = 3_600_000


class Robot:
    """A robot's store and counter in two folders, and copies of the store."""

    def __init__(self, folder: Path) -> None:
        self.store, self.counter = folder / "store" / "robot.db", folder / "other" / "counter"
        for path in (self.store, self.counter):
            path.parent.mkdir()
        self.kept = folder / "kept.db"
        self.start_ms = scenarios.START_MS
        self.trust = scenarios.trust_folder()

    def start(self, *, counter: bool = True) -> Simulation:
        self.start_ms += HOUR_MS
        return simulate(
            self.trust,
            scenarios.site(),
            scenarios.binding(),
            rid=scenarios.RID,
            start_ms=self.start_ms,
            store=self.store,
            counter=FileCounter(self.counter) if counter else None,
        )

    def keep(self) -> None:
        shutil.copy(self.store, self.kept)

    def put_back(self) -> None:
        shutil.copy(self.kept, self.store)

    def note(self) -> CounterNote:
        data = self.counter.read_bytes()
        return open_note(data, verifier=read_trust(scenarios.trust_folder()))


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def mission(*, irreversible: bool = False, **changes: Any) -> Mission:
    made = scenarios.mission(**changes)
    grants = tuple(
        msgspec.structs.replace(grant, irreversible=irreversible) for grant in made.actions
    )
    return msgspec.structs.replace(made, actions=grants, expiry="2199-01-01T00:00:00Z")


def records(sim: Simulation) -> list[Any]:
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    return [read_record(record, where="") for _, record, _, _ in rows]


def alerts(sim: Simulation) -> list[dict[str, Any]]:
    return [record.open for record in records(sim) if record.kind == "alert"]


def command(
    verb: Verb, made: Mission, *, by: str = "operator-1", at: int = 0, issued_ms: int = 0
) -> bytes:
    value = Command(
        verb=verb,
        mid=made.mid,
        version=1,
        mission=digest_of(Tag.MISSION, made),
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=(at or scenarios.START_MS) + 10**7,
        issued_ms=issued_ms,
    )
    return sign_object(value, Tag.COMMAND, folder_signer(scenarios.trust_folder(), by))


def order(
    sim: Simulation,
    *,
    by: str = "operator-1",
    mid: str = scenarios.RID,
    trust: Path | None = None,
    **claim: Any,
) -> bytes:
    """Return a signed order to accept the store as it is shown now."""
    shown = sim.gate.anchor.shown()
    size, head = sim.gate.ledger.peek(lambda turn: turn.head())
    said = {"store": shown["store"], "size": size, "head": b64(head), "number": shown["number"]}
    value = Command(
        verb=Verb.ACCEPT_STORE,
        mid=mid,
        version=1,
        mission=shown["store"],
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=sim.gate.ledger.last_ms() + 60_000,
        accepts=StoreClaim(**said | claim),
    )
    return sign_object(value, Tag.COMMAND, folder_signer(trust or scenarios.trust_folder(), by))


def refused(act: Any) -> Reason:
    with pytest.raises(AuthGuardError) as found:
        act()
    return found.value.reason


def worked(robot: Robot, made: Mission | None = None) -> Mission:
    """Run once: a mission is active in the store, kept, and something is done after."""
    made = made or mission()
    sim = robot.start()
    sim.gate.management.activate(scenarios.token(made))
    sim.gate.close()
    robot.keep()
    sim = robot.start()
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    sim.gate.close()
    return made


def rolled_back(robot: Robot) -> tuple[Mission, Simulation]:
    made = worked(robot)
    robot.put_back()
    return made, robot.start()


# what is written, and when


def test_a_store_is_counted_at_the_start_and_at_a_clean_end(robot: Robot) -> None:
    sim = robot.start()
    begun = robot.note()
    size, head = sim.gate.ledger.peek(lambda turn: turn.head())
    assert (begun.robot, begun.number, begun.size, begun.head) == (
        scenarios.RID,
        1,
        size,
        b64(head),
    )
    sim.gate.management.activate(scenarios.token(mission()))
    assert robot.note() == begun
    sim.gate.close()
    ended = robot.note()
    assert (ended.number, ended.store) == (2, begun.store)
    assert ended.size > begun.size
    assert ended.time_ms >= begun.time_ms
    assert read_held(robot.store, "counter", "known") == b"1"


def test_two_stores_never_have_the_same_name(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    other = Robot(tmp_path / "b")
    names = set()
    for one in (robot, other):
        one.start().gate.close()
        names.add(one.note().store)
    assert len(names) == 2


def test_what_cannot_be_undone_is_counted_before_it_is_dispatched(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = robot.start()
    sim.gate.management.activate(scenarios.token(mission(irreversible=True)))
    seen: list[tuple[int, int]] = []
    dispatch = sim.robot.dispatch

    def looked(action: Any, lease: Any) -> Any:
        seen.append((robot.note().size, sim.gate.ledger.peek(lambda turn: turn.head())[0]))
        return dispatch(action, lease)

    monkeypatch.setattr(sim.robot, "dispatch", looked)
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    assert seen == [(seen[0][1], seen[0][1])]  # the decision's own record is counted
    sim.gate.close()


def test_what_can_be_undone_costs_no_counter(robot: Robot) -> None:
    sim = robot.start()
    sim.gate.management.activate(scenarios.token(mission()))
    before = robot.note()
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    assert robot.note() == before


def test_a_counter_that_cannot_be_written_refuses_what_cannot_be_undone_and_nothing_else(
    robot: Robot,
) -> None:
    """Nothing is consumed by it, and once it can be written again the same proposal is released."""
    sim = robot.start()
    irreversible = mission(irreversible=True)
    sim.gate.management.activate(scenarios.token(irreversible))
    away = robot.counter.parent.with_name("away")
    robot.counter.parent.rename(away)
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.STORE_UNAVAILABLE
    assert report.refusal.where == str(robot.counter)
    assert records(sim)[-1].open["reasons"] == ["STORE_UNAVAILABLE"]
    assert sim.gate.ledger.standing(irreversible.mid).uses == {}
    assert sim.robot.trace == []
    away.rename(robot.counter.parent)
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED


def test_a_counter_that_breaks_between_commit_and_dispatch_starts_nothing(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = robot.start()
    made = mission(irreversible=True)
    sim.gate.management.activate(scenarios.token(made))
    write, left = FileCounter.write, [1]  # the first, before the commit, still works

    def breaks(counter: FileCounter, note: bytes) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise EnvironmentFault("gone", reason=Reason.STORE_UNAVAILABLE, where="counter")
        write(counter, note)

    monkeypatch.setattr(FileCounter, "write", breaks)
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.NOT_STARTED
    assert [finding.reason for finding in report.reasons] == [Reason.STORE_UNAVAILABLE]
    assert sim.robot.trace == []
    standing = sim.gate.ledger.standing(made.mid)
    assert [use.starts for use in standing.uses.values()] == [1]  # never given back
    assert standing.open == ()


def test_a_counter_that_cannot_be_written_at_the_start_or_the_end_hinders_nobody(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        raise EnvironmentFault("read-only", reason=Reason.STORE_UNAVAILABLE)

    with monkeypatch.context() as patch:
        patch.setattr(FileCounter, "write", breaks)
        sim = robot.start()
        sim.gate.management.activate(scenarios.token(mission()))
        assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
        sim.gate.close()
    assert not robot.counter.exists()
    sim = robot.start()  # it never was there, so nothing is missing
    assert sim.gate.anchor.why is None


# what is put back


def test_a_store_that_was_put_back_is_caught_and_refuses(robot: Robot) -> None:
    made, sim = rolled_back(robot)
    assert sim.gate.anchor.why is Discrepancy.BEHIND
    (alert,) = alerts(sim)
    assert (alert["what"], alert["why"]) == ("the store was rolled back", "behind")
    assert alert["counted"] > alert["size"]
    assert sim.gate.ledger.standing(made.mid).status == "suspended"
    assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK
    assert sim.robot.trace == []
    manage = sim.gate.management
    for act in (
        lambda: manage.activate(scenarios.token(made)),
        lambda: manage.command(command(Verb.RESUME, made)),
        lambda: manage.command(command(Verb.SUSPEND, made, by="safety-officer-1")),
        lambda: manage.select(b"{}"),
        lambda: manage.approve(b"{}"),
        lambda: manage.template(b"{}"),
    ):
        assert refused(act) is Reason.ROLLED_BACK
    sim.gate.enforcer.stop(by="person", is_planner=False, suspends=True)
    assert records(sim)[-1].kind in {"stop", "management"}


def test_what_was_compared_is_shown_and_not_what_was_written_since(robot: Robot) -> None:
    _, sim = rolled_back(robot)
    shown, (alert,) = sim.gate.anchor.shown(), alerts(sim)
    size = sim.gate.ledger.peek(lambda turn: turn.head())[0]
    assert (shown["opened"], shown["counted"]) == (alert["size"], alert["counted"])
    assert shown["opened"] < size  # the alert itself came after


def test_a_refusing_gate_overwrites_nothing_of_what_it_was_caught_by(robot: Robot) -> None:
    worked(robot)
    before = robot.counter.read_bytes()
    robot.put_back()
    for _ in range(2):  # a restart is no way out
        sim = robot.start()
        assert sim.gate.anchor.why is Discrepancy.BEHIND
        sim.gate.close()
        assert robot.counter.read_bytes() == before


def test_a_store_that_was_deleted_is_caught(robot: Robot) -> None:
    worked(robot)
    robot.store.unlink()
    sim = robot.start()
    assert sim.gate.anchor.why is Discrepancy.REPLACED
    assert refused(lambda: sim.gate.management.activate(scenarios.token(mission()))) is (
        Reason.ROLLED_BACK
    )


def test_a_copy_that_went_on_elsewhere_is_caught_however_long_it_is(robot: Robot) -> None:
    made = worked(robot)
    counter = robot.counter.read_bytes()
    robot.put_back()
    robot.counter.unlink()
    held = robot.start(counter=False)  # elsewhere, without the counter, somebody accepts it
    assert held.gate.anchor.why is Discrepancy.COUNTER_NOT_NAMED
    held.gate.management.accept_store(order(held))
    anew = held.gate.ledger.last_ms() + 1
    held.gate.management.command(command(Verb.RESUME, made, at=robot.start_ms, issued_ms=anew))
    for place in ("pharmacy", "dock", "pharmacy"):
        scenarios.propose(held, scenarios.navigate("dock", place))
    held.gate.close()
    robot.counter.write_bytes(counter)
    sim = robot.start()
    assert sim.gate.anchor.why is Discrepancy.FORKED


def test_a_counter_that_is_gone_torn_foreign_or_another_robots_is_caught(robot: Robot) -> None:
    worked(robot)
    good, note = robot.counter.read_bytes(), robot.note()
    lifter = folder_signer(scenarios.trust_folder(), "gate-lifter-1")
    foreign = seal(msgspec.structs.replace(note, robot=scenarios.OTHER), lifter)
    forged = seal(note, folder_signer(scenarios.trust_folder(), "operator-1"))
    for bad, why in (
        (None, Discrepancy.COUNTER_MISSING),
        (b"", Discrepancy.COUNTER_FOREIGN),
        (good[:100], Discrepancy.COUNTER_FOREIGN),
        (foreign, Discrepancy.COUNTER_FOREIGN),
        (forged, Discrepancy.COUNTER_FOREIGN),
    ):
        robot.counter.unlink()
        if bad is not None:
            robot.counter.write_bytes(bad)
        sim = robot.start()
        assert sim.gate.anchor.why is why
        assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK
        sim.gate.close()
        robot.counter.write_bytes(good)
    robot.start().gate.close()


def test_an_older_note_of_the_same_store_is_caught_by_the_store(robot: Robot) -> None:
    robot.start().gate.close()
    older = robot.counter.read_bytes()
    for _ in range(2):
        robot.start().gate.close()
    robot.counter.write_bytes(older)
    assert robot.start().gate.anchor.why is Discrepancy.COUNTER_BEHIND


def test_a_counter_that_is_not_mounted_is_no_counter_that_is_new(robot: Robot) -> None:
    worked(robot)
    away = robot.counter.parent.with_name("away")
    robot.counter.parent.rename(away)
    sim = robot.start()
    assert sim.gate.anchor.why is Discrepancy.COUNTER_UNREADABLE
    away.rename(robot.counter.parent)
    # nobody signs away what he could still read
    with pytest.raises(RefusedError, match="has to be readable first") as found:
        sim.gate.management.accept_store(order(sim))
    assert found.value.reason is Reason.TRANSITION_REFUSED
    sim.gate.close()
    assert robot.start().gate.anchor.why is None


def test_leaving_the_counter_out_is_no_way_round(robot: Robot) -> None:
    worked(robot)
    sim = robot.start(counter=False)
    assert sim.gate.anchor.why is Discrepancy.COUNTER_NOT_NAMED
    sim.gate.close()
    gate = offline_gate(
        scenarios.trust_folder(), scenarios.site(), rid=scenarios.RID, store=robot.store
    )
    assert refused(lambda: gate.management.activate(scenarios.token(mission()))) is (
        Reason.ROLLED_BACK
    )
    gate.close()


def test_a_store_that_is_ahead_of_its_counter_is_one_whose_gate_died(robot: Robot) -> None:
    made = mission()
    sim = robot.start()
    sim.gate.management.activate(scenarios.token(made))
    sim.gate.ledger.close()  # no clean end: the counter knows of the start alone
    sim = robot.start()
    assert sim.gate.anchor.why is None
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED


def test_a_store_from_before_there_was_a_counter_takes_one(robot: Robot) -> None:
    sim = robot.start(counter=False)
    assert sim.gate.anchor.shown()["state"] == "uncounted"
    sim.gate.close()
    assert not robot.counter.exists()
    sim = robot.start()
    assert sim.gate.anchor.shown()["state"] == "counted"
    assert robot.note().number == 1


def test_a_number_that_is_none_is_a_damaged_store(robot: Robot) -> None:
    sim = robot.start()
    sim.gate.ledger.store.run(lambda turn: turn.put("counter", "known", b"many"))
    sim.gate.ledger.close()
    with pytest.raises(StoreError) as fault:
        robot.start()
    assert fault.value.reason is Reason.STORE_CORRUPT
    open_store(robot.store).close()  # and a gate that was not made holds nothing


def test_a_counter_and_a_signer_go_together(robot: Robot) -> None:
    sim = robot.start()
    for wrong in ({"counter": FileCounter(robot.counter)}, {"signer": sim.signer}):
        with pytest.raises(TypeError):
            StoreAnchor(sim.gate.ledger, robot=scenarios.RID, **wrong)


def test_without_a_counter_nothing_is_read() -> None:
    assert read_counter(None, verifier=read_trust(scenarios.trust_folder())) == CounterReading()


# recovery


@pytest.mark.parametrize("by", ["operator-1", "safety-officer-1"])
def test_work_goes_on_after_a_signed_order_and_a_resume(robot: Robot, by: str) -> None:
    made, sim = rolled_back(robot)
    behind = robot.note()
    done = sim.gate.management.accept_store(order(sim, by=by))
    assert (done.mission, done.status) == (made.mid, "suspended")
    record = next(r for r in records(sim) if r.link.decision == "accept_store")
    assert (record.open["by"], record.open["why"]) == (by, "behind")
    after = robot.note()
    assert after.number > behind.number
    assert after.size == done.size
    assert scenarios.propose(sim, GO).judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
    accepted = sim.gate.ledger.last_ms()
    for issued_ms in (0, accepted):  # it may be one of the lost part
        early = command(Verb.RESUME, made, at=accepted, issued_ms=issued_ms)
        with pytest.raises(AuthGuardError, match="sign it again") as old:
            sim.gate.management.command(early)
        assert (old.value.reason, old.value.where) == (Reason.ROLLED_BACK, "command.issued_ms")
    late = command(Verb.RESUME, made, at=accepted, issued_ms=accepted + 1)
    sim.gate.management.command(late)
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    sim.gate.close()
    assert robot.start().gate.anchor.why is None


@pytest.mark.parametrize("by", ["supervisor-1", "gate-courier-1", "site-authority-1"])
def test_nobody_else_accepts_a_store(robot: Robot, by: str) -> None:
    _, sim = rolled_back(robot)
    assert refused(lambda: sim.gate.management.accept_store(order(sim, by=by))) is (
        Reason.ROLE_DENIED
    )
    assert sim.gate.anchor.why is Discrepancy.BEHIND


def test_an_operator_of_other_robots_accepts_no_store_of_this_one(
    robot: Robot, tmp_path: Path
) -> None:
    robot.trust = tmp_path / "trust"
    confined = Member(id="operator-9", role=Role.OPERATOR, robots=(scenarios.OTHER,), regions=None)
    init_folder(
        robot.trust,
        (*demo_members(scenarios.site(), (scenarios.RID,)), confined),
        now=datetime.fromtimestamp(scenarios.START_MS / 1_000, UTC),
    )
    robot.start().gate.close()
    robot.counter.unlink()
    sim = robot.start()
    signed = order(sim, by="operator-9", trust=robot.trust)
    assert refused(lambda: sim.gate.management.accept_store(signed)) is Reason.SIGNER_OUT_OF_SCOPE
    assert sim.gate.anchor.why is Discrepancy.COUNTER_MISSING


def test_two_releases_at_once_never_count_less_than_before(robot: Robot) -> None:
    """A thread that comes back late has read an older end of the log."""
    sim = robot.start()
    anchor, ledger = sim.gate.anchor, sim.gate.ledger
    older = ledger.peek(lambda turn: turn.head())
    sim.gate.management.activate(scenarios.token(mission()))
    anchor.count()
    newer = robot.note()
    assert newer.size > older[0]
    peek = ledger.peek
    ledger.peek = lambda job: peek(lambda turn: job(_Late(older)))  # type: ignore[method-assign,arg-type]
    anchor.count()
    assert (robot.note().size, robot.note().head) == (newer.size, newer.head)
    assert robot.note().number == newer.number + 1


class _Late:
    """What a turn saw before somebody else's."""

    def __init__(self, head: tuple[int, bytes]) -> None:
        self._head = head

    def head(self) -> tuple[int, bytes]:
        return self._head


@pytest.mark.parametrize(
    ("claim", "reason"),
    [
        ({"store": b64(bytes(32))}, Reason.ROLLED_BACK),
        ({"size": 1}, Reason.ROLLED_BACK),
        ({"size": 10**6}, Reason.ROLLED_BACK),
        ({"head": b64(bytes(32))}, Reason.ROLLED_BACK),
        ({"number": 0}, Reason.ROLLED_BACK),
        ({"mid": "lifter-1"}, Reason.ROBOT_MISMATCH),
    ],
)
def test_an_order_about_anything_else_is_refused(
    robot: Robot, claim: dict[str, Any], reason: Reason
) -> None:
    _, sim = rolled_back(robot)
    before = robot.counter.read_bytes()
    assert refused(lambda: sim.gate.management.accept_store(order(sim, **claim))) is reason
    assert sim.gate.anchor.why is Discrepancy.BEHIND
    assert robot.counter.read_bytes() == before
    assert records(sim)[-1].open["reasons"] == [reason]


def test_an_order_counts_once_whatever_is_put_back(robot: Robot) -> None:
    made, sim = rolled_back(robot)
    signed = order(sim)
    copy = robot.kept.with_name("refusing.db")
    sim.gate.close()
    shutil.copy(robot.store, copy)
    sim = robot.start()
    signed = order(sim)
    sim.gate.management.accept_store(signed)
    assert refused(lambda: sim.gate.management.accept_store(signed)) is Reason.EXPIRED
    sim.gate.close()
    shutil.copy(copy, robot.store)  # a store in which it was never carried out
    robot.start_ms -= HOUR_MS  # at the same time
    sim = robot.start()
    assert sim.gate.anchor.why is Discrepancy.BEHIND
    assert refused(lambda: sim.gate.management.accept_store(signed)) is Reason.ROLLED_BACK
    assert sim.gate.ledger.standing(made.mid).status == "suspended"


def test_an_order_that_ran_out_or_is_another_is_refused(robot: Robot) -> None:
    made, sim = rolled_back(robot)
    late = order(sim)
    sim.robot.pause(120_000)
    manage = sim.gate.management
    assert refused(lambda: manage.accept_store(late)) is Reason.EXPIRED
    assert refused(lambda: manage.accept_store(command(Verb.RESUME, made))) is (
        Reason.TRANSITION_REFUSED
    )
    assert refused(lambda: manage.accept_store(b"{}")) is Reason.MALFORMED


def test_there_is_nothing_to_accept_of_a_store_that_agrees(robot: Robot) -> None:
    sim = robot.start()
    assert refused(lambda: sim.gate.management.accept_store(order(sim))) is (
        Reason.TRANSITION_REFUSED
    )
    assert refused(lambda: sim.gate.management.command(order(sim))) is Reason.MISSION_UNKNOWN


def test_an_order_whose_counter_cannot_be_written_lets_nothing_go_on(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, sim = rolled_back(robot)

    def breaks(*_: object) -> None:
        raise EnvironmentFault("read-only", reason=Reason.STORE_UNAVAILABLE)

    with monkeypatch.context() as patch:
        patch.setattr(FileCounter, "write", breaks)
        assert refused(lambda: sim.gate.management.accept_store(order(sim))) is (
            Reason.STORE_UNAVAILABLE
        )
    assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK
    sim.gate.ledger.close()  # it dies there
    sim = robot.start()
    # its refusals and alerts have made it longer than what was counted, and it is not that log
    assert sim.gate.anchor.why is Discrepancy.FORKED
    sim.gate.management.accept_store(order(sim))  # a person is asked again
    assert sim.gate.anchor.why is None


def test_a_mission_that_the_lost_part_may_have_used_up_is_not_taken_in_again(robot: Robot) -> None:
    robot.start().gate.close()
    robot.keep()
    made = mission()
    sim = robot.start()
    sim.gate.management.activate(scenarios.token(made))
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    sim.gate.close()
    robot.put_back()
    sim = robot.start()
    sim.gate.management.accept_store(order(sim))
    manage = sim.gate.management
    assert refused(lambda: manage.activate(scenarios.token(made))) is Reason.ROLLED_BACK
    later = scenarios.mission(
        window={
            "not_before": to_timestamp(robot.start_ms),
            "expiry": to_timestamp(robot.start_ms + HOUR_MS),
        }
    )
    assert manage.activate(scenarios.token(later)).status == "active"


def test_a_mission_of_the_acceptances_own_second_may_have_run_before_it(robot: Robot) -> None:
    worked(robot)
    robot.store.unlink()
    sim = robot.start()
    sim.robot.pause(300)
    sim.gate.management.accept_store(order(sim))
    manage, second = sim.gate.management, sim.robot.wall_ms() // 1_000 * 1_000

    def beginning(at_ms: int) -> bytes:
        window = {"not_before": to_timestamp(at_ms), "expiry": to_timestamp(at_ms + HOUR_MS)}
        return scenarios.token(scenarios.mission(window=window))

    assert refused(lambda: manage.activate(beginning(second))) is Reason.ROLLED_BACK
    sim.robot.pause(1_000)
    assert manage.activate(beginning(second + 1_000)).status == "active"


def test_requests_and_choices_of_before_die_and_numbers_leap(robot: Robot) -> None:
    made, sim = rolled_back(robot)

    def asked(act: Any) -> None:
        standing = act.standing(made.mid)
        act.hold(msgspec.structs.replace(standing, selected={"go": 0}, counter=3))

    sim.gate.ledger.run(asked)
    sim.gate.management.accept_store(order(sim))
    standing = sim.gate.ledger.standing(made.mid)
    assert (standing.selected, standing.requests) == ({}, {})
    assert standing.counter == 3 + 2**32


def test_what_was_closing_is_over(robot: Robot) -> None:
    made, sim = rolled_back(robot)

    def closing(act: Any) -> None:
        standing = act.standing(made.mid)
        act.hold(msgspec.structs.replace(standing, status=Status.CLOSING))

    sim.gate.ledger.run(closing)
    done = sim.gate.management.accept_store(order(sim))
    assert done.status == "revoked"
    assert scenarios.propose(sim, GO).refusal.reason is Reason.NO_ACTIVE_MISSION


def test_a_store_without_a_mission_is_accepted_too(robot: Robot) -> None:
    worked(robot)
    robot.store.unlink()
    sim = robot.start()
    done = sim.gate.management.accept_store(order(sim))
    assert (done.mission, done.status) == (None, None)
    assert robot.note().store == sim.gate.anchor.shown()["store"]


# the clock


def test_the_counter_knows_how_late_it_is_when_the_store_does_not(robot: Robot) -> None:
    worked(robot)
    late_ms = robot.note().time_ms
    robot.store.unlink()
    robot.start_ms = late_ms - 2 * HOUR_MS  # the clock was set back, and the store deleted
    sim = robot.start()
    with pytest.raises(ClockError):
        sim.gate.ledger.now()
    assert refused(lambda: sim.gate.management.accept_store(order(sim))) is Reason.CLOCK_BEHIND
    assert [alert["why"] for alert in alerts(sim)] == ["replaced"]  # recorded without a clock
    assert all(record.link.time_ms >= late_ms for record in records(sim))


def test_a_machine_without_a_clock_serves_stops_and_waits(robot: Robot) -> None:
    made = worked(robot)
    trust = read_trust(scenarios.trust_folder())
    for at_ms in (0, 86_400_000):
        clock = scenarios.simulation(start_ms=scenarios.START_MS).robot
        gate = assemble(
            trust=trust,
            chain=folder_signer(scenarios.trust_folder(), "gate-courier-1").chain,
            site=scenarios.site(),
            safety=EnvelopeGate(default_config(scenarios.site(), scenarios.RID)),
            controller=clock,
            source=clock,
            clock=Stopped(at_ms),
            store=open_store(robot.store),
            log=LogSettings(
                counter=FileCounter(robot.counter),
                signer=folder_signer(scenarios.trust_folder(), "gate-courier-1"),
            ),
            demo=True,
        )
        assert gate.anchor.why is None
        assert refused(lambda made=gate: made.ledger.now()) is Reason.CLOCK_BEHIND
        assert refused(lambda gate=gate: gate.management.activate(scenarios.token(made))) is (
            Reason.CLOCK_BEHIND
        )
        gate.enforcer.stop(by="person", is_planner=False)
        gate.close()


def test_a_new_store_on_a_machine_without_a_clock_does_not_begin_in_1970() -> None:
    robot = scenarios.simulation().robot
    gate = assemble(
        trust=read_trust(scenarios.trust_folder()),
        chain=folder_signer(scenarios.trust_folder(), "gate-courier-1").chain,
        site=scenarios.site(),
        safety=EnvelopeGate(default_config(scenarios.site(), scenarios.RID)),
        controller=robot,
        source=robot,
        clock=Stopped(0),
        store=MemoryStore(),
        demo=True,
    )
    assert refused(gate.ledger.now) is Reason.CLOCK_BEHIND
    (first,) = (row for row in gate.ledger.peek(lambda turn: turn.rows(0, 1)))
    assert read_record(first[1], where="").link.time_ms > scenarios.START_MS - 30 * 86_400_000


class Stopped:
    """A machine whose clock nobody has set."""

    def __init__(self, wall_ms: int) -> None:
        self._wall_ms = wall_ms

    def wall_ms(self) -> int:
        return self._wall_ms

    def mono_ms(self) -> int:
        return 1_000

    def pause(self, duration_ms: int) -> None:
        """Time stands still."""
