# SPDX-License-Identifier: Apache-2.0
"""Sealed fields are destroyed by a signed order or when their time is over, and the chain stays.

Source: docs/spec/sealed-fields.md#shredding
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import apsw
import pytest
from msgspec.structs import replace

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import HELD, due_missions
from authguard_r.anchoring.sealing.stored_policy import expiry_ms as expiry_of
from authguard_r.audit.record import BOX, WRAP, Entry, LogRow, append
from authguard_r.cli.replay import LogReplay
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.mission import DataClass, Mission
from authguard_r.core.quantities import to_ms
from authguard_r.core.standing import OpenRelease, Spend
from authguard_r.enforcement.management.parts import entry
from authguard_r.enforcement.management.shredding import DAY_MS, PAGE, Retired
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.operations.simulation import Simulation
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.store.transactions import Transaction
from fixtures import scenarios, sealed_logs

REGION, OBJECT, PERSON = DataClass.REGION, DataClass.OBJECT, DataClass.PERSON
GO = scenarios.navigate("dock", "pharmacy")
MINUTE_MS = 60_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "store").mkdir()
    return tmp_path / "store" / "robot.db"


def ended(sim: Simulation, **changes: Any) -> Mission:
    """Let a mission begin, do something and be revoked."""
    mission = sealed_logs.active(sim, **changes)
    scenarios.propose(sim, GO)
    sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
    return mission


def finished(sim: Simulation) -> int:
    """Destroy every box whose keys are gone; return how many turns that took."""
    turns = 1
    while sim.gate.management.shred_on():
        turns += 1
    return turns


def names(rows: list[LogRow], mid: str) -> set[str]:
    """Return what is sealed beside the records of a mission."""
    return {
        name
        for row in rows
        if sealed_logs.told(row).link.mid == mid
        for name in sealed_logs.values(row)
        if name.startswith((BOX, WRAP))
    }


def ciphertexts(rows: list[LogRow], mid: str, data: DataClass) -> list[bytes]:
    """Return what is encrypted under the key of a class: boxes, and the wrapped key itself."""
    found: list[bytes] = []
    for row in rows:
        if sealed_logs.told(row).link.mid == mid:
            for name, value in sealed_logs.values(row).items():
                if name.startswith(BOX) and data in name:
                    found.append(value["text"][:40].encode())  # longer ones lie on two pages
                if name == WRAP + data:
                    found += [wrapped["text"][:40].encode() for wrapped in value]
    assert len(found) > 2
    return found


def verbs(rows: list[LogRow], verb: str) -> list[LogRow]:
    return [row for row in rows if sealed_logs.told(row).link.decision == verb]


def refused(sim: Simulation, token: bytes) -> AuthGuardError:
    before = sim.gate.ledger.peek(lambda turn: turn.rows(0, 100))
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.shred(token)
    after = sim.gate.ledger.peek(lambda turn: turn.rows(0, 100))
    assert after[: len(before)] == before
    assert not sim.gate.management.shred_on()
    return error.value


def test_an_order_destroys_a_class_for_every_reader_and_the_chain_stays_whole(path: Path) -> None:
    both = sealed_logs.policy(sealed_logs.reader("auditor"), sealed_logs.reader("porter", REGION))
    with sealed_logs.sealing(path, both) as sim:
        mission = ended(sim)
        texts = ciphertexts(sealed_rows(sim), mission.mid, REGION)
        assert all(text in sealed_logs.files(path) for text in texts)
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        assert (done.mid, done.classes, len(done.keys)) == (mission.mid, (REGION,), 1)
        finished(sim)
        assert not any(text in sealed_logs.files(path) for text in texts)
    rows = sealed_logs.rows_of(path)
    assert not [name for name in names(rows, mission.mid) if "region" in name]
    assert "box.object" in names(rows, mission.mid)
    for role in ("auditor", "porter"):
        read = b"".join(row.record + row.sealed for row in sealed_logs.opened(rows, role)[1:])
        assert b'"destination":"pharmacy"' not in read
    (order,), (end,) = verbs(rows, "shred"), verbs(rows, "shredded")
    told = sealed_logs.told(sealed_logs.opened(rows)[order.seq])
    assert (told.link.mid, told.open["of"], told.open["by"]) == (
        "-",
        mission.mid,
        "site-authority-1",
    )
    assert sealed_logs.told(end).open["order"] == order.seq == done.order
    assert sealed_logs.told(end).open["boxes"] > 0


def in_files(token: bytes, path: Path) -> bool:
    return any(token[at : at + 80] in sealed_logs.files(path) for at in range(0, 2_000, 80))


def test_what_a_store_holds_of_a_mission_beside_its_log_goes_with_it(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        digest = sealed_digest(sim, mission)
        token = sim.gate.ledger.peek(lambda turn: turn.get("token", digest))
        assert token is not None
        assert in_files(token, path)  # whoever asks about it is still told
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, *sealed_logs.EVERY))
        assert not in_files(token, path)
        finished(sim)
        standing = sim.gate.management.standing(mission.mid)
        assert (standing.requests, standing.selected, standing.uses) == ({}, {}, {})
        assert sim.gate.ledger.run(lambda act: act.active()) is None
        for act in (
            lambda: sim.gate.management.activate(scenarios.token(mission)),
            lambda: sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission)),
            lambda: sealed_logs.active(sim, version=2, supersedes=digest),
        ):
            with pytest.raises(AuthGuardError) as again:
                act()
            assert again.value.reason in {"REVOKED", "TRANSITION_REFUSED"}
    with sealed_logs.sealing(path) as sim:
        assert sim.gate.management.recover(unclean=True) == ()
        sealed_logs.active(sim, mission="another")


def test_the_token_of_what_another_took_the_place_of_goes(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        first = sealed_logs.active(sim)
        one = sealed_digest(sim, first)
        second = sealed_logs.active(sim, version=2, supersedes=one)
        two = sealed_digest(sim, second)
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, second))
        sealed_logs.active(sim, mission="another")
        for digest in (one, two):
            assert sim.gate.ledger.peek(lambda turn, d=digest: turn.get("token", d)) == b""


def test_a_mission_of_which_something_is_open_is_not_destroyed(path: Path) -> None:
    """How an action ended is said under the mission's own token."""
    rules = kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS))
    with sealed_logs.sealing(path, rules) as sim:
        mission = ended(sim)
        opens(sim, mission, is_open=True)
        told = refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION))
        assert (told.reason, "resolve" in told.message) == ("TRANSITION_REFUSED", True)
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        assert sim.gate.management.retire() == Retired()
        assert sim.gate.ledger.peek(due_missions) == (mission.mid,)
        opens(sim, mission, is_open=False)
        later(sim, MINUTE_MS)
        assert len(sim.gate.management.retire().begun) == 1


def opens(sim: Simulation, mission: Mission, *, is_open: bool) -> None:
    """Let nobody know how an action ended, or settle it."""
    standing = sim.gate.management.standing(mission.mid)
    release = OpenRelease(ticket=b64(bytes(32)), grant=mission.actions[0].id, reserved=Spend())
    changed = replace(standing, open=(release,) if is_open else ())
    sim.gate.ledger.run(lambda act: act.hold(changed))


def test_answers_that_a_store_holds_go_with_their_records(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
        place = f"{mission.mid}:1"
        sim.gate.ledger.run(lambda act: answered(act, mission.mid, place))
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, PERSON))
        finished(sim)
        for kind in ("approvals", "late-answers"):
            assert sim.gate.ledger.peek(lambda turn, k=kind: turn.get(k, place)) == b""


def answered(act: Transaction, mid: str, place: str) -> None:
    act.put("approvals", place, b'["a token"]')
    act.put("late-answers", place, b'["supervisor-1:approve"]')
    opened = {"verb": "answer", "by": "anna", "counter": 1}
    act.record(entry(act, mid, opened, {"token": "a token"}))


def sealed_digest(sim: Simulation, mission: Mission) -> str:
    standing = sim.gate.management.standing(mission.mid)
    assert standing is not None
    return standing.digest


def test_decisions_of_which_something_is_destroyed_are_not_replayable(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        first, second = ended(sim), ended(sim, mission="second")
        sim.gate.management.shred(sealed_logs.shred_order(sim, first.mid, OBJECT))
        finished(sim)
    replay = LogReplay(None)
    for row in sealed_logs.opened(sealed_logs.rows_of(path)):
        assert replay.see(row) is None
    assert (replay.decisions, replay.agree, replay.not_replayable) == (2, 1, 1)
    assert second.mid != first.mid


def test_missions_beside_it_are_untouched(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        first, second = ended(sim), ended(sim, mission="second")
        before = names(sealed_rows(sim), second.mid)
        sim.gate.management.shred(sealed_logs.shred_order(sim, first.mid, *sealed_logs.EVERY))
        finished(sim)
        assert names(sealed_rows(sim), first.mid) == set()
        assert names(sealed_rows(sim), second.mid) == before


def sealed_rows(sim: Simulation) -> list[LogRow]:
    return [LogRow(*row) for row in sim.gate.ledger.peek(lambda turn: turn.rows(0, 10_000))]


def test_keys_go_with_the_order_and_boxes_in_turns_that_a_crash_does_not_lose(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
        for _ in range(PAGE):
            scenarios.propose(sim, scenarios.navigate("dock", "nowhere"))
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, *sealed_logs.EVERY))
        assert not [n for n in names(sealed_rows(sim), mission.mid) if n.startswith(WRAP)]
        assert sim.gate.management.shred_on()
        left = names(sealed_rows(sim), mission.mid)
        assert left
    with sealed_logs.sealing(path) as sim:  # it never came to the end
        assert finished(sim) >= 1
        assert names(sealed_rows(sim), mission.mid) == set()
        assert not sim.gate.management.shred_on()
    (end,) = verbs(sealed_logs.rows_of(path), "shredded")
    assert sealed_logs.told(end).open["boxes"] >= PAGE


def test_every_start_of_a_mission_is_reached(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
    for _ in range(2):
        with sealed_logs.sealing(path) as sim:
            scenarios.propose(sim, GO)
    with sealed_logs.sealing(path) as sim:
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, PERSON))
        assert len(done.keys) == 4
        finished(sim)
        left = names(sealed_rows(sim), mission.mid)
        assert not [name for name in left if "person" in name]
        # the other classes can still go, and then nothing is left to order
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION, OBJECT))
        assert len(done.keys) == 4
        finished(sim)
        gone = refused(sim, sealed_logs.shred_order(sim, mission.mid, PERSON))
        assert gone.reason == "MISSION_UNKNOWN"


def test_records_of_no_mission_can_be_destroyed_too(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        sim.gate.ledger.note(lambda at: said("a secret", at))
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, "-", *sealed_logs.EVERY))
        finished(sim)
        assert done.mid == "-"
        sim.gate.ledger.note(lambda at: said("what comes later", at))
    rows = sealed_logs.rows_of(path)
    read = b"".join(row.sealed for row in sealed_logs.opened(rows))
    assert (b"a secret" in read, b"what comes later" in read) == (False, True)
    # who ordered it is read by whoever reads persons: sealed under the next keys
    assert sealed_logs.told(sealed_logs.opened(rows)[done.order]).open["by"] == "site-authority-1"


def said(why: str, at: int) -> Entry:
    return Entry(kind="stop", time_ms=at, decision="stop", open={}, sealed={"why": why})


# who, what and when


@pytest.mark.parametrize("by", ["operator-1", "safety-officer-1", "supervisor-1"])
def test_only_who_says_who_reads_may_destroy(path: Path, by: str) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        assert refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION, by=by)).reason == (
            "ROLE_DENIED"
        )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"verb": Verb.REVOKE}, "TRANSITION_REFUSED"),
        ({"shreds": ()}, "TRANSITION_REFUSED"),
        ({"shreds": (REGION, OBJECT)}, "TRANSITION_REFUSED"),
        ({"shreds": (REGION, REGION)}, "TRANSITION_REFUSED"),
        ({"mission": b64(bytes(32))}, "ROLLED_BACK"),  # another store's order
        ({"expires_ms": 1}, "EXPIRED"),
        ({"mid": "never"}, "MISSION_UNKNOWN"),
    ],
)
def test_an_order_says_exactly_what(path: Path, changes: dict[str, Any], reason: str) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        token = sealed_logs.shred_order(sim, mission.mid, REGION, **changes)
        assert refused(sim, token).reason == reason


def test_an_order_is_carried_out_once(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        token = sealed_logs.shred_order(sim, mission.mid, REGION)
        sim.gate.management.shred(token)
        finished(sim)
        assert refused(sim, token).reason == "EXPIRED"


def test_a_mission_that_nobody_ended_keeps_its_fields(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
        for _ in range(2):
            told = refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION))
            assert (told.reason, "end it first" in told.message) == ("TRANSITION_REFUSED", True)
            later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + 1_000)  # and expired
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))


def test_a_mission_that_has_the_robots_name_is_not_taken_for_the_records_of_none(
    path: Path,
) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        ended(sim, mission=str(scenarios.RID))
        for of in ("-", str(scenarios.RID)):
            told = refused(sim, sealed_logs.shred_order(sim, of, REGION))
            assert (told.reason, "is ambiguous" in told.message) == ("TRANSITION_REFUSED", True)


def test_what_waited_to_be_recorded_is_destroyed_with_the_rest(path: Path) -> None:
    waits = RefusalPolicy(delay_ms=100)
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
        sim.gate.ledger.refusals.policy = waits
        scenarios.propose(sim, scenarios.navigate("dock", "nowhere"))
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        scenarios.propose(sim, GO)  # of a mission that is over: waits
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, *sealed_logs.EVERY))
        finished(sim)
        sim.gate.ledger.flush(everything=True)
        assert names(sealed_rows(sim), mission.mid) == set()


def expiry_ms(mission: Mission) -> int:
    return to_ms(mission.expiry, where="expiry")


def test_what_was_never_sealed_cannot_be_destroyed(path: Path) -> None:
    with sealed_logs.sealing(path) as sim:
        mission = ended(sim)
        told = refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION))
        assert (told.reason, "nothing is sealed" in told.message) == ("MISSION_UNKNOWN", True)
        assert refused(sim, sealed_logs.shred_order(sim, "-", REGION)).reason == "MISSION_UNKNOWN"


# retention


def later(sim: Simulation, ms: int) -> None:
    """Let time pass at once: nothing moves, and days are many looks of an estimator."""
    sim.robot.elapsed_ms += ms


def kept(*rules: Any) -> Any:
    return sealed_logs.policy(sealed_logs.reader("auditor"), retention=rules)


def test_what_is_to_be_kept_is_not_destroyed_before(
    path: Path,
) -> None:
    """Also by the order for another class: its boxes tell of this one, too."""
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, least_ms=DAY_MS))) as sim:
        mission = ended(sim)
        for classes in ((OBJECT, REGION), (OBJECT,), (PERSON,)):
            told = refused(sim, sealed_logs.shred_order(sim, mission.mid, *classes))
            assert (told.reason, "stored until" in told.message) == ("NOT_YET_VALID", True)
        assert (
            refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION)).reason
            == "NOT_YET_VALID"
        )
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + DAY_MS - 5_000)
        assert (
            refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION)).reason
            == "NOT_YET_VALID"
        )
        later(sim, 5_000)
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))


def test_records_of_no_mission_are_kept_from_when_other_keys_were_used(path: Path) -> None:
    rules = kept(sealed_logs.rule(PERSON, least_ms=10 * MINUTE_MS))
    with sealed_logs.sealing(path, rules) as sim:
        sim.gate.ledger.note(lambda at: said("first", at))
        assert refused(sim, sealed_logs.shred_order(sim, "-", PERSON)).reason == "NOT_YET_VALID"
    with sealed_logs.sealing(path, start_ms=scenarios.START_MS + MINUTE_MS) as sim:
        sim.gate.ledger.note(lambda at: said("second", at))
        later(sim, 10 * MINUTE_MS)
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, "-", PERSON))
        assert len(done.keys) == 1  # not the keys in use
        finished(sim)
    read = b"".join(row.sealed for row in sealed_logs.opened(sealed_logs.rows_of(path)))
    assert (b"first" in read, b"second" in read) == (False, True)


def test_retention_ends_by_itself_with_a_record_of_who(path: Path) -> None:
    rules = (
        kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS), sealed_logs.rule)[:0]
        if False
        else kept(
            sealed_logs.rule(OBJECT, most_ms=2 * DAY_MS),
            sealed_logs.rule(REGION, most_ms=MINUTE_MS),
        )
    )
    with sealed_logs.sealing(path, rules) as sim:
        mission = ended(sim)
        assert sim.gate.ledger.peek(due_missions) == (mission.mid,)
        assert sim.gate.management.retire() == Retired()
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        (done,) = sim.gate.management.retire().begun
        assert (done.mid, done.classes) == (mission.mid, (REGION,))
        finished(sim)
        assert sim.gate.management.retire() == Retired()
        assert sim.gate.ledger.peek(due_missions) == (mission.mid,)
        later(sim, 2 * DAY_MS)
        assert [one.classes for one in sim.gate.management.retire().begun] == [(OBJECT,)]
        finished(sim)
        assert sim.gate.ledger.peek(due_missions) == ()
    rows = sealed_logs.opened(sealed_logs.rows_of(path))
    assert [sealed_logs.told(row).open["by"] for row in verbs(rows, "shred")] == ["retention"] * 2


def test_a_mission_that_expired_and_that_nobody_ended_lapses_before(path: Path) -> None:
    """The robot goes on: nothing of the mission is needed any more, and another one begins."""
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS))) as sim:
        mission = sealed_logs.active(sim)
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        (done,) = sim.gate.management.retire().begun
        finished(sim)
        standing = sim.gate.management.standing(mission.mid)
        assert (done.mid, standing.status) == (mission.mid, "expired")
        assert sim.gate.ledger.run(lambda act: act.active()) is None
    with sealed_logs.sealing(path) as sim:
        assert sim.gate.management.recover(unclean=True) == ()
    assert [
        sealed_logs.told(row).open["reasons"] for row in verbs(sealed_logs.rows_of(path), "lapse")
    ] == [["EXPIRED"]]


def test_what_is_recorded_after_a_mission_was_destroyed_is_destroyed_too(path: Path) -> None:
    with sealed_logs.sealing(path, kept(sealed_logs.rule(PERSON, most_ms=MINUTE_MS))) as sim:
        mission = ended(sim)
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        assert len(sim.gate.management.retire().begun) == 1
        finished(sim)
        sim.gate.ledger.run(lambda act: answered(act, mission.mid, "late"))
        assert sim.gate.ledger.peek(due_missions) == (mission.mid,)
        later(sim, MINUTE_MS)
        assert [one.mid for one in sim.gate.management.retire().begun] == [mission.mid]
        finished(sim)
        assert not [name for name in names(sealed_rows(sim), mission.mid) if "person" in name]
        later(sim, MINUTE_MS)
        assert sim.gate.management.retire() == Retired()


def test_many_missions_end_a_few_at_a_time(path: Path) -> None:
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS))) as sim:
        for number in range(6):
            last = ended(sim, mission=f"m-{number}")
        later(sim, expiry_ms(last) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        assert [one.mid for one in sim.gate.management.retire().begun] == [
            f"m-{n}" for n in range(4)
        ]
        later(sim, MINUTE_MS)
        assert [one.mid for one in sim.gate.management.retire().begun] == ["m-4", "m-5"]
        finished(sim)
        assert sim.gate.ledger.peek(due_missions) == ()


def test_a_class_that_was_not_sealed_for_a_while_is_found_before(path: Path) -> None:
    porter, nurse = sealed_logs.reader("porter", REGION), sealed_logs.reader("nurse", OBJECT)
    with sealed_logs.sealing(path, sealed_logs.policy(porter, nurse)) as sim:
        mission = sealed_logs.active(sim)
        scenarios.propose(sim, GO)
    with sealed_logs.sealing(path, sealed_logs.policy(nurse)) as sim:
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        done = sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        assert len(done.keys) == 1
        finished(sim)
        left = names(sealed_rows(sim), mission.mid)
        assert not [name for name in left if "region" in name]
        assert "box.object" in left


def test_keys_of_no_mission_are_changed_daily_so_that_they_have_an_end(path: Path) -> None:
    with sealed_logs.sealing(path, kept(sealed_logs.rule(PERSON, most_ms=DAY_MS))) as sim:
        sim.gate.ledger.note(lambda at: said("first", at))
        for day in range(3):
            later(sim, DAY_MS + 1_000)
            found = sim.gate.management.retire().begun
            assert [one.mid for one in found] == ([] if day < 1 else ["-"])
            finished(sim)
            sim.gate.ledger.note(lambda at, d=day: said(f"day {d}", at))
    read = b"".join(row.sealed for row in sealed_logs.opened(sealed_logs.rows_of(path)))
    assert [w in read for w in (b"first", b"day 0", b"day 1", b"day 2")] == [
        False,
        False,
        True,
        True,
    ]


def test_without_rules_nothing_ends_and_nothing_is_noted(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        ended(sim)
        assert sim.gate.ledger.peek(due_missions) == ()
        assert sim.gate.management.retire() == Retired()
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, least_ms=1))) as sim:
        assert sim.gate.management.retire() == Retired()


def test_what_a_gate_sealed_that_seals_no_more_is_destroyed_all_the_same(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        digest = sealed_digest(sim, mission)
    with sealed_logs.sealing(path, SealingPolicy()) as sim:
        sealed_logs.active(sim, mission="open")
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, *sealed_logs.EVERY))
        finished(sim)
        assert names(sealed_rows(sim), mission.mid) == set()
        assert sim.gate.ledger.peek(lambda turn: turn.get("token", digest)) == b""
        assert sealed_digest(sim, scenarios.mission(mission="open"))  # which goes on
        with pytest.raises(AuthGuardError) as refusal:
            sim.gate.management.shred(sealed_logs.shred_order(sim, "open", REGION))
        assert refusal.value.reason == "TRANSITION_REFUSED"


def test_the_keys_of_a_log_that_seals_nothing_are_nothing_to_forget(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        sim.gate.ledger.note(lambda at: said("a secret", at))
    with sealed_logs.sealing(path, SealingPolicy()) as sim:
        sim.gate.management.shred(sealed_logs.shred_order(sim, "-", *sealed_logs.EVERY))
        finished(sim)
        assert names(sealed_rows(sim), "-") == set()


# a damaged store


def damaged(sim: Simulation, value: bytes, mid: str) -> None:
    sim.gate.ledger.run(lambda act: act.put(HELD, mid, value))


def test_a_store_whose_keys_are_told_nowhere_is_corrupt(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        damaged(sim, b'{"newest":9999}', mission.mid)
        with pytest.raises(StoreError) as error:
            sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        assert error.value.reason == "STORE_CORRUPT"
        damaged(sim, b'{"newest":0}', mission.mid)  # which tells no keys
        with pytest.raises(StoreError, match="names keys"):
            sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
    store = apsw.Connection(str(path))
    store.execute("DROP TRIGGER audit_only_forgets")
    store.execute("UPDATE audit SET record = x'00' WHERE seq = 2")
    store.close()
    with sealed_logs.sealing(path) as sim:
        damaged(sim, b'{"newest":2}', mission.mid)
        with pytest.raises(StoreError) as error:
            sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        assert error.value.where == "store.audit.2"


def forged(sim: Simulation, seq: int, **told: Any) -> None:
    """Let the newest keys of a mission be told by a record that somebody else wrote."""
    opened = {"classes": [], "roles": [], **told}
    kind = Entry(kind="sealing", time_ms=1, decision="sealing", open=opened, mid="m-1")
    sim.gate.ledger.run(lambda act: append(act._page.turn, kind, salts=b""))
    damaged(sim, b'{"newest":%d}' % seq, "m-1")


@pytest.mark.parametrize("before", [None, "1", 99])
def test_keys_that_lead_nowhere_are_the_stores_fault_and_no_endless_search(
    path: Path, before: Any
) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        ended(sim, mission="m-1")
        seq = sim.gate.ledger.peek(lambda turn: turn.head())[0]
        forged(sim, seq, before=before)
        with pytest.raises(StoreError) as error:
            sim.gate.management.shred(sealed_logs.shred_order(sim, "m-1", REGION))
        assert error.value.reason == "STORE_CORRUPT"


def test_a_box_that_is_none_is_the_stores_fault(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = ended(sim)
        lie = Entry(kind="stop", time_ms=1, decision="stop", open={}, sealed={"box.region": 1})
        sim.gate.ledger.run(lambda act: append(act._page.turn, lie, salts=bytes(16)))
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        with pytest.raises(StoreError, match="expected a box"):
            finished(sim)


def test_of_a_mission_of_before_its_token_says_when_it_expires(path: Path) -> None:
    rules = kept(sealed_logs.rule(REGION, least_ms=MINUTE_MS, most_ms=DAY_MS))
    with sealed_logs.sealing(path, rules) as sim:
        mission = ended(sim)
        before(sim)
        assert (
            refused(sim, sealed_logs.shred_order(sim, mission.mid, REGION)).reason
            == "NOT_YET_VALID"
        )
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS)
        sim.gate.management.shred(sealed_logs.shred_order(sim, mission.mid, REGION))
        before(sim)  # and the token is gone: nobody can say it
        later(sim, 2 * DAY_MS)
        assert sim.gate.management.retire() == Retired(stuck=(mission.mid,))


def before(sim: Simulation) -> None:
    """Forget when missions expire, as a store of before."""
    store: Any = sim.gate.ledger.store
    store._connection.execute("DELETE FROM held WHERE kind = 'sealing-expiry'")
    store._turn.reread()


def test_one_damaged_mission_keeps_no_other_from_its_end(path: Path) -> None:
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS))) as sim:
        first, second = ended(sim), ended(sim, mission="second")
        sim.gate.ledger.run(lambda act: act.put("sealing-expiry", first.mid, b"soon"))
        later(sim, expiry_ms(second) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        told = sim.gate.management.retire()
        assert ([one.mid for one in told.begun], told.stuck) == (["second"], (first.mid,))
        with pytest.raises(StoreError) as error:
            sim.gate.ledger.run(lambda act: expiry_of(act, first.mid))
        assert error.value.where == "store.sealing-expiry"


def test_what_is_written_at_a_missions_end_does_not_escape_it(path: Path) -> None:
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, most_ms=MINUTE_MS))) as sim:
        mission = sealed_logs.active(sim)
        later(sim, expiry_ms(mission) - sim.gate.ledger.now().utc_ms + MINUTE_MS + 1_000)
        sim.gate.ledger.refusals.policy = RefusalPolicy(delay_ms=100)
        scenarios.propose(sim, GO)  # too late: waits to be recorded
        assert len(sim.gate.management.retire().begun) == 1
        finished(sim)
        sim.gate.ledger.flush(everything=True)
        left = names(sealed_rows(sim), mission.mid)
        assert not [name for name in left if "region" in name]


def test_the_end_of_records_of_no_mission_begins_nothing_new(path: Path) -> None:
    """The record of a destruction is of no mission, too: it must not feed itself."""
    rules = kept(
        sealed_logs.rule(OBJECT, most_ms=MINUTE_MS), sealed_logs.rule(PERSON, most_ms=MINUTE_MS)
    )
    with sealed_logs.sealing(path, rules) as sim:
        sim.gate.ledger.note(lambda at: said("first", at))
    with sealed_logs.sealing(path) as sim:
        sim.gate.ledger.note(lambda at: said("second", at))
        begun = []
        for _ in range(12):
            later(sim, 2 * MINUTE_MS)
            begun += sim.gate.management.retire().begun
            finished(sim)
    assert [(one.mid, one.classes) for one in begun] == [("-", (OBJECT, PERSON))]


def test_more_missions_than_are_looked_at_take_their_turns(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("authguard_r.enforcement.management.shredding._MOST_DUE", 2)
    with sealed_logs.sealing(path, kept(sealed_logs.rule(REGION, most_ms=DAY_MS))) as sim:
        mids = [ended(sim, mission=f"m-{number}").mid for number in range(3)]
        sim.gate.management.retire()
        assert sim.gate.ledger.peek(due_missions) == (mids[2], mids[0], mids[1])
