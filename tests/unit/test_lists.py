# SPDX-License-Identifier: Apache-2.0
"""Revocation lists that come while a gate runs: newer only, at once, for everything kept."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.approvals import answer
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import (
    AuthenticityError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
    StoreError,
)
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import Trust, read_certificates, read_trust
from authguard_r.operations.simulation import simulate
from authguard_r.store.sqlite import open_store, read_held
from authguard_r.store.transactions import Ledger
from authguard_r.wire.messages import ClientRole, Kind, Order, OrderKind
from fixtures import scenarios
from fixtures.revocation_lists import next_lists
from missionpair.bench import make_bench
from unit.server.demo_site import GO, SCAN, DemoGate, Refused, reasons

DAY_MS = 86_400_000
BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a set-up that a gate reads; `auth` beside it is the authority's own copy."""
    init_folder(tmp_path / "trust", demo_members(scenarios.site(), (scenarios.RID,)), now=BEGIN)
    shutil.copytree(tmp_path / "trust", tmp_path / "auth")
    return tmp_path


@pytest.fixture
def house(folder: Path) -> Iterator[DemoGate]:
    with DemoGate(trust=folder / "trust") as made:
        made.activate()
        yield made


def dead(folder: Path, name: str) -> bytes:
    """Return the authority's next list, with a principal on it."""
    lists = revoke(folder / "auth", principal=name, serial=None, now=BEGIN, days=30).lists
    ((_, found),) = lists.items()
    return found.signed


def fresh(folder: Path, name: str = "people", *, days: int = 30) -> bytes:
    """Return the authority's next list, with nobody new on it."""
    return next_lists(folder / "auth", {name: set()}, now=BEGIN, days=days)[name].signed


def bring(house: DemoGate, data: bytes) -> dict[str, Any]:
    operator = house.enter(ClientRole.OPERATOR)
    try:
        told: dict[str, Any] = operator.ask(
            Kind.ORDER, Order(act=OrderKind.REVOCATIONS, token=data)
        )
    finally:
        operator.leave()
        house.pump()
    return told["revocations"]


def codes(answered: dict[str, Any]) -> list[str]:
    (step,) = answered["steps"]
    return list(step.get("reasons") or [step["refusal"]["reason"]] if "refusal" in step else [])


def refusals(house: DemoGate) -> list[Any]:
    house.advance(1_000)
    return [code for record in house.log("refusal") for code in record.open["reasons"]]


# at once


def test_the_first_decision_after_a_list_is_refused_and_the_one_before_was_not(
    house: DemoGate, folder: Path
) -> None:
    planner = house.enter(ClientRole.PLANNER)
    (step,) = house.propose(planner, SCAN)["steps"]
    assert step["released"] is True
    told = bring(house, dead(folder, "operator-1"))
    assert (told["authority"], told["number"], told["serials"]) == ("people", 2, 1)
    (step,) = house.propose(planner, SCAN)["steps"]
    assert step["released"] is False
    kinds = [r.kind for r in house.log() if r.kind in {"decision", "revocation", "refusal"}]
    assert kinds == ["decision", "revocation", "refusal"]
    assert refusals(house) == ["CERTIFICATE_REVOKED"]


def test_a_motion_whose_issuer_is_revoked_is_stopped(house: DemoGate, folder: Path) -> None:
    planner = house.enter(ClientRole.PLANNER)
    number = house.begin(planner, GO)
    house.advance(500)
    bring(house, dead(folder, "operator-1"))
    (step,) = house.rest(planner, number)["steps"]
    assert (step["execution"]["outcome"], reasons(step)) == ("aborted", ["CERTIFICATE_REVOKED"])
    rested = house.place
    house.advance(2_000)
    assert house.place == rested


def test_a_motion_goes_on_under_a_list_that_names_others(house: DemoGate, folder: Path) -> None:
    planner = house.enter(ClientRole.PLANNER)
    number = house.begin(planner, GO)
    house.advance(500)
    bring(house, dead(folder, "supervisor-1"))
    (step,) = house.rest(planner, number)["steps"]
    assert step["execution"]["outcome"] == "succeeded"


def test_what_a_revoked_estimator_said_is_believed_no_more(house: DemoGate, folder: Path) -> None:
    inputs = house.gate.enforcer.inputs
    assert inputs.state is not None
    bring(house, dead(folder, f"estimator-{scenarios.RID}"))
    assert inputs.state is None
    house.advance(200)
    assert inputs.state is None
    assert isinstance(inputs.fault, AuthenticityError)
    assert inputs.fault.reason is Reason.CERTIFICATE_REVOKED
    planner = house.enter(ClientRole.PLANNER)
    (step,) = house.propose(planner, GO)["steps"]
    assert step["released"] is False


def test_what_another_estimator_said_stays(house: DemoGate, folder: Path) -> None:
    before = house.gate.enforcer.inputs.newest
    assert before is not None
    bring(house, fresh(folder, "machines"))
    assert house.gate.enforcer.inputs.newest is before


def test_a_list_may_come_before_any_state(folder: Path) -> None:
    with DemoGate(trust=folder / "trust", robot=False, estimator=False) as house:
        assert bring(house, fresh(folder))["number"] == 2
        assert house.gate.enforcer.inputs.state is None


def test_a_gate_that_is_revoked_releases_nothing_more(house: DemoGate, folder: Path) -> None:
    planner = house.enter(ClientRole.PLANNER)
    number = house.begin(planner, GO)
    house.advance(500)
    bring(house, dead(folder, f"gate-{scenarios.RID}"))
    (step,) = house.rest(planner, number)["steps"]
    assert step["execution"]["outcome"] == "aborted"
    for _ in range(2):
        (step,) = house.propose(planner, SCAN)["steps"]
        assert step["released"] is False
    assert "CERTIFICATE_REVOKED" in refusals(house)


def test_an_approver_who_is_revoked_after_answering_does_not_count(tmp_path: Path) -> None:
    from missionpair.bench import calls, propose
    from missionpair.suite import at_dock, wide, with_grant

    bench = make_bench(tmp_path / "trust", begin=BEGIN)
    shutil.copytree(bench.folder, tmp_path / "auth")
    room = "isolation-room"
    row = {"source": "dock", "destination": room, "regions": ["dock", room, "public-corridor"]}
    draft = wide(bench)
    policy = {**draft["risk_policy"], "tau_2": 31, "t": 2}
    draft = with_grant(
        {**draft, "risk_policy": policy}, "go-to-pharmacy", rows=[row], chooser="planner"
    )
    scene = at_dock(
        bench, draft, calls(("navigate_to", {"destination": "Isolation Room", "speed": 0.5}))
    )

    def proposed() -> list[str]:
        report = propose(scene)[-1]
        assert report.judged is not None
        return [str(reason) for reason in report.judged.decision.reasons]

    assert proposed() == ["APPROVAL_REQUIRED"]
    gate, standing = scene.sim.gate, scene.standing()
    assert standing is not None
    ((grant, request),) = standing.requests.items()
    verified = gate.ledger.run(gate.enforcer.inputs.active_mission)
    said = answer(verified, grant, request, rid=scenarios.RID, verdict=ApprovalVerdict.APPROVE)
    for name in ("supervisor-1", "supervisor-2"):
        token = sign_object(said, Tag.APPROVAL, folder_signer(bench.folder, name))
        if name == "supervisor-1":
            gate.management.approve(token)
            gate.lists.install(dead(tmp_path, name))
            assert proposed() == ["APPROVAL_REQUIRED"]
            with pytest.raises(AuthenticityError) as error:
                gate.management.approve(token)
            assert error.value.reason is Reason.CERTIFICATE_REVOKED
        else:
            gate.management.approve(token)
            assert proposed() == []


# newer only


@pytest.mark.parametrize(
    ("data", "code"),
    [
        ("older", "REVOCATION_STALE"),
        ("ended", "REVOCATION_STALE"),
        ("foreign", "SIGNATURE_INVALID"),
        ("nobody's", "MALFORMED"),
        ("junk", "MALFORMED"),
        ("empty", "MALFORMED"),
    ],
)
def test_no_other_list_takes_the_place_of_the_one_in_force(
    house: DemoGate, folder: Path, data: str, code: str
) -> None:
    first = (folder / "trust/revocations/people.json").read_bytes()
    second = dead(folder, "supervisor-1")
    bring(house, second)
    init_folder(folder / "foreign", (), now=BEGIN)
    shutil.rmtree(folder / "auth" / "revocations")
    shutil.copytree(folder / "trust/revocations", folder / "auth" / "revocations")
    fresh(folder)
    brought = {
        "older": first,
        "ended": fresh(folder, days=-1),
        "foreign": [
            next_lists(folder / "foreign", {"people": set()}, now=BEGIN, days=9)["people"].signed
            for _ in range(3)
        ][-1],
        "nobody's": b"",
        "junk": b"{}",
        "empty": b"",
    }[data]
    if data == "nobody's":
        init_folder(
            folder / "other",
            (),
            now=BEGIN,
            algorithms=("ed25519", "ml-dsa-65"),  # type: ignore[arg-type]
        )
        brought = (folder / "other/revocations/people-2.json").read_bytes()
    with pytest.raises(Refused) as refused:
        bring(house, brought)
    assert refused.value.code == code
    held = [known for known in house.gate.trust.lists.values() if known.authority == "people"]
    assert [known.number for known in held] == [2]
    assert code in refusals(house)
    assert len(house.log("revocation")) == 1


def test_the_very_list_that_is_in_force_is_there_already_and_recorded_once(
    house: DemoGate, folder: Path
) -> None:
    data = dead(folder, "supervisor-1")
    first = bring(house, data)
    before = len(house.log("management"))
    assert bring(house, data) == first
    assert refusals(house) == []
    assert (len(house.log("revocation")), len(house.log("management"))) == (1, before)


def test_a_list_that_could_not_be_written_is_not_in_force(
    house: DemoGate, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = dead(folder, "operator-1")
    run, calls = Ledger.run, iter([False, True])

    def fails(self: Ledger, job: Any, **more: Any) -> Any:
        if not next(calls, False):
            return run(self, job, **more)

        def lost(act: Any) -> Any:
            job(act)
            raise StoreError("the disk is gone", where="store", reason=Reason.STORE_UNAVAILABLE)

        return run(self, lost, **more)

    with monkeypatch.context() as patch:
        patch.setattr(Ledger, "run", fails)
        with pytest.raises(StoreError):
            house.gate.lists.install(data)
    assert {known.number for known in house.gate.trust.lists.values()} == {1}
    assert house.log("revocation") == []
    house.gate.lists.install(data)
    assert len(house.log("revocation")) == 1


def test_of_two_lists_at_once_the_second_is_looked_at_anew(
    house: DemoGate, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread brings number 3 while number 2 waits for its turn."""
    second, third = fresh(folder), fresh(folder)
    read = Trust.read_newer
    waiting = [third]

    def slowly(self: Trust, data: bytes, now: Now) -> Any:
        found = read(self, data, now)
        if waiting:
            self.put_in_force(dict([read(self, waiting.pop(), now)]))
        return found

    monkeypatch.setattr(Trust, "read_newer", slowly)
    with pytest.raises(RefusedError) as error:
        house.gate.lists.install(second)
    assert error.value.reason is Reason.REVOCATION_STALE
    held = [known for known in house.gate.trust.lists.values() if known.authority == "people"]
    assert [known.number for known in held] == [3]


# over a restart


def started(folder: Path, *, store: Path) -> Any:
    return simulate(
        folder / "trust",
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=scenarios.START_MS,
        store=store,
    )


def numbers(sim: Any) -> dict[str, int]:
    return {known.authority: known.number for known in sim.gate.trust.lists.values()}


def records(sim: Any) -> list[dict[str, Any]]:
    from authguard_r.audit.record import read_record

    rows = sim.gate.ledger.run(lambda act: act.rows(0, 1_000))
    read = [read_record(row[1], where="log") for row in rows]
    return [dict(record.open) for record in read if record.kind == "revocation"]


def test_a_gate_that_starts_with_an_older_folder_has_the_list_that_it_had(folder: Path) -> None:
    store = folder / "robot.db"
    sim = started(folder, store=store)
    assert records(sim) == []  # a first list has nothing older
    sim.gate.lists.install(dead(folder, "operator-1"))
    sim.gate.close()
    sim = started(folder, store=store)
    assert numbers(sim)["people"] == 2
    with pytest.raises(AuthenticityError, match="revoked"):
        sim.gate.management.activate(
            sign_object(
                scenarios.mission(), Tag.MISSION, folder_signer(folder / "trust", "operator-1")
            )
        )
    (told,) = records(sim)
    assert (told["by"], told["number"], told["authority"]) == ("order", 2, "people")
    sim.gate.close()


def test_a_newer_list_in_the_folder_counts_and_is_held(folder: Path) -> None:
    store = folder / "robot.db"
    older = (folder / "trust/revocations/people.json").read_bytes()
    (folder / "trust/revocations/people.json").write_bytes(dead(folder, "supervisor-1"))
    sim = started(folder, store=store)
    (told,) = records(sim)
    assert (told["by"], told["number"], told["serials"]) == ("folder", 2, 1)
    sim.gate.close()
    (folder / "trust/revocations/people.json").write_bytes(older)
    sim = started(folder, store=store)
    assert numbers(sim)["people"] == 2
    assert len(records(sim)) == 1
    sim.gate.close()
    sim = started(folder, store=store)
    assert len(records(sim)) == 1
    sim.gate.close()


def key_of(folder: Path) -> str:
    from authguard_r.enforcement.management.lists import _key

    (authority,) = read_certificates(folder / "trust/authorities/people.pem")
    return _key(authority.public_bytes(Encoding.DER))


@pytest.mark.parametrize("held", [b"junk", b""])
def test_what_is_held_and_is_no_list_stops_the_start(folder: Path, held: bytes) -> None:
    path = folder / "robot.db"
    started(folder, store=path).gate.close()
    store = open_store(path)
    store.run(lambda turn: turn.put("revocations", key_of(folder), held))
    store.close()
    with pytest.raises(StoreError) as error:
        started(folder, store=path)
    assert error.value.reason is Reason.STORE_CORRUPT
    open_store(path).close()  # it was let go


def test_a_gate_that_was_revoked_does_not_start(folder: Path) -> None:
    path = folder / "robot.db"
    sim = started(folder, store=path)
    sim.gate.lists.install(dead(folder, f"gate-{scenarios.RID}"))
    sim.gate.close()
    assert read_held(path, "revocations", key_of(folder)) is None
    with pytest.raises(AuthenticityError, match="revoked"):
        started(folder, store=path)
    open_store(path).close()


def test_a_newer_list_of_others_does_not_keep_the_gate_from_starting(folder: Path) -> None:
    path = folder / "robot.db"
    sim = started(folder, store=path)
    sim.gate.lists.install(fresh(folder, "machines"))
    sim.gate.close()
    sim = started(folder, store=path)
    assert numbers(sim)["machines"] == 2
    sim.gate.close()


def test_a_clock_that_is_behind_takes_no_list_and_starts_all_the_same(folder: Path) -> None:
    path = folder / "robot.db"
    sim = started(folder, store=path)
    sim.robot.pause(3_600_000)
    sim.gate.management.started()
    sim.gate.close()
    (folder / "trust/revocations/people.json").write_bytes(dead(folder, "supervisor-1"))
    sim = started(folder, store=path)
    assert numbers(sim)["people"] == 2  # in force; it is held once the clock is right
    with pytest.raises(EnvironmentFault):
        sim.gate.lists.install(fresh(folder))
    sim.gate.close()
    store = open_store(path)
    assert store.run(lambda turn: turn.get("revocations", key_of(folder))) is None
    store.close()


def test_only_lists_of_authorities_that_are_here_are_read(folder: Path) -> None:
    trust = read_trust(folder / "trust")
    data = fresh(folder)
    lists = {der: known for der, known in trust.lists.items() if known.authority != "people"}
    with pytest.raises(MalformedError, match="trusted here"):
        Trust(trust.roots, lists).read_newer(data, scenarios.NOW)
