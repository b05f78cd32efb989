# SPDX-License-Identifier: Apache-2.0
"""A gate that never said that it stopped: nobody knows what the robot did since, so it waits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.operations.simulation import Simulation
from authguard_r.store.transactions import Transaction
from fixtures import scenarios

GO = scenarios.navigate("dock", "pharmacy")


def order(verb: Verb, **changes: Any) -> bytes:
    mission = scenarios.mission()
    value = Command(
        verb=verb,
        mid=mission.mid,
        version=1,
        mission=digest_of(Tag.MISSION, mission),
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=scenarios.START_MS + 10**7,
        **changes,
    )
    return sign_object(
        value, Tag.COMMAND, scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
    )


def recoveries(sim: Simulation) -> list[dict[str, Any]]:
    records = [read_record(row.record, where="") for row in sim.gate.ledger.store.rows()]  # type: ignore[attr-defined]
    return [record.open for record in records if record.link.decision == "recover"]


def active() -> Simulation:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    return sim


def test_the_mark_says_whether_the_last_stop_was_a_clean_one(tmp_path: Path) -> None:
    store = tmp_path / "robot.db"
    for unclean in (False, False, True, True, False):
        sim = scenarios.simulation(store=store)
        records = len(sim.gate.ledger.store.rows()) if hasattr(sim.gate.ledger.store, "rows") else 0
        if unclean:  # the one before died without a word
            sim.gate.management.started()
            sim.gate.close()
            sim = scenarios.simulation(store=store)
        assert sim.gate.management.started() is unclean
        sim.gate.management.stopped()
        assert records == 0 or records == len(sim.gate.ledger.store.rows())  # type: ignore[attr-defined]
        sim.gate.close()


def test_a_mark_that_is_neither_is_no_clean_stop() -> None:
    sim = scenarios.simulation()
    sim.gate.ledger.run(lambda act: act.put("gate", "running", b"?"))
    assert sim.gate.management.started()
    assert sim.gate.management.started()
    sim.gate.management.stopped()
    assert not sim.gate.management.started()


def test_a_mark_that_cannot_be_written_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = scenarios.simulation()

    def fails(_: Transaction, *__: Any) -> None:
        raise StoreError("the disk is gone")

    with monkeypatch.context() as patch:
        patch.setattr(Transaction, "put", fails)
        for act in (sim.gate.management.started, sim.gate.management.stopped):
            with pytest.raises(StoreError):
                act()
    assert not sim.gate.management.started()


def test_after_an_unclean_stop_the_mission_waits_for_a_signed_resume() -> None:
    sim = active()
    assert sim.gate.management.recover(unclean=True) == ()
    assert recoveries(sim) == [
        {"verb": "recover", "status": "suspended", "unknown": 0, "unclean": True}
    ]
    report = scenarios.propose(sim, GO)
    assert report.judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
    assert sim.robot.trace == []
    assert (
        sim.gate.management.command(order(Verb.RESUME, issued_ms=sim.robot.wall_ms() + 1)).status
        == "active"
    )
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED


def test_after_a_clean_stop_the_mission_goes_on() -> None:
    sim = active()
    assert sim.gate.management.recover() == ()
    assert recoveries(sim) == []
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED


def test_an_unclean_stop_of_a_mission_that_waits_already_says_so_and_leaves_it() -> None:
    sim = active()
    sim.gate.management.command(order(Verb.SUSPEND))
    sim.gate.management.recover(unclean=True)
    assert [record["status"] for record in recoveries(sim)] == ["suspended"]


@pytest.mark.parametrize("ended", [True, False])
def test_where_no_mission_is_active_there_is_nothing_to_suspend(ended: bool) -> None:
    sim = active() if ended else scenarios.simulation()
    if ended:
        sim.gate.management.command(order(Verb.COMPLETE))
    assert sim.gate.management.recover(unclean=True) == ()
    assert recoveries(sim) == []


def test_a_mission_that_is_over_but_still_named_stays_over() -> None:
    sim = active()
    standing = sim.gate.management.standing(scenarios.mission().mid)
    assert standing is not None
    from msgspec.structs import replace

    sim.gate.ledger.run(lambda act: act.hold(replace(standing, status="completed")))
    assert sim.gate.management.recover(unclean=True) == ()
    assert recoveries(sim) == []


def test_a_closing_mission_goes_on_closing() -> None:
    sim = active()
    standing = sim.gate.management.standing(scenarios.mission().mid)
    assert standing is not None
    from msgspec.structs import replace

    from authguard_r.core.lifecycle import Status

    closing = replace(standing, status=Status.CLOSING, closes_ms=scenarios.START_MS + 600_000)
    sim.gate.ledger.run(lambda act: act.hold(closing))
    sim.gate.management.recover(unclean=True)
    assert [record["status"] for record in recoveries(sim)] == ["closing"]
    assert sim.gate.management.standing(scenarios.mission().mid) == closing


def test_what_attested_state_settles_is_settled_and_the_mission_waits_all_the_same() -> None:
    """Cleanly stopped, `done_when` would let it go on at once; uncleanly a person has a look."""
    sim = scenarios.simulation(start=scenarios.world("pharmacy", holding="package-p1"))
    standing = sim.gate.management.activate(scenarios.token())
    from msgspec.structs import replace

    from authguard_r.core.identifiers import Digest, GrantId
    from authguard_r.core.standing import OpenRelease, Spend

    open_now = OpenRelease(ticket=Digest("A" * 43), grant=GrantId("pick-p1"), reserved=Spend())
    sim.gate.ledger.run(lambda act: act.hold(replace(standing, open=(open_now,))))
    assert sim.gate.management.recover(unclean=True) == ()
    (record,) = recoveries(sim)
    assert (record["status"], record["unknown"]) == ("suspended", 0)
    after = sim.gate.management.standing(standing.mid)
    assert after is not None
    assert after.uses[GrantId("pick-p1")].successes == 1
