# SPDX-License-Identifier: Apache-2.0
"""A mission that is handed in waits as `issued`: it authorizes nothing, and it ends for good.

Source: section "Stateful Action Verification" (the registry R), docs/spec/standing.md#handing-in
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.approvals import Selection
from authguard_r.audit.record import Record, read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.auditor.replay.standing import Standings
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.token import sign_object
from authguard_r.enforcement.management.orders import carry_out
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.issued_missions import damaged, issued, registered
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios, sealed_logs, templates
from fixtures.restarting_gate import Station, go, signer

MINUTE_MS = 60_000


def mission(name: str = "one", version: int = 1, **changes: Any) -> Mission:
    """Return a version of a mission; each supersedes the one before it."""
    if version > 1:
        changes["supersedes"] = digest_of(Tag.MISSION, mission(name, version - 1))
    return scenarios.mission(mission=name, version=version, **changes)


def hand_in(here: Station, value: Mission, by: str = "operator-1") -> Standing:
    return here.gate.management.issue(here.token(value, by))


def activate(here: Station, value: Mission) -> Standing:
    return here.gate.management.activate(here.token(value))


def refused(act: Any, *arguments: Any) -> tuple[str, str]:
    """Return the reason of a refusal, and what it says."""
    with pytest.raises(AuthGuardError) as error:
        act(*arguments)
    return str(error.value.reason), error.value.message


def waiting(here: Station) -> list[tuple[str, int]]:
    return [(one.mid, one.version) for one in here.gate.ledger.run(issued)]


def status(here: Station, value: Mission) -> str | None:
    """Return the registry's status of exactly this version."""
    named = value.mid, digest_of(Tag.MISSION, value)
    found = here.gate.ledger.run(lambda act: registered(act, *named))  # type: ignore[arg-type]
    return None if found is None else str(found.status)


def records(here: Station) -> list[Record]:
    return [read_record(row.record, where="") for row in here.store.rows()]


def verbs(here: Station) -> list[tuple[str, str, Any]]:
    return [
        (record.link.decision, record.link.mid, record.open.get("status"))
        for record in records(here)
        if record.kind == "management"
    ]


def test_an_issued_mission_authorizes_nothing_until_it_is_activated() -> None:
    here = Station()
    made = hand_in(here, mission())
    assert (made.status, waiting(here)) == ("issued", [("one", 1)])
    before = len(records(here))
    report = here.submit(go("pharmacy"))
    assert isinstance(report, Report)
    assert report.refusal is not None
    assert report.refusal.reason is Reason.MISSION_NOT_ACTIVE
    assert "authguard mission activate" in report.refusal.message
    assert [r.open["reasons"] for r in records(here)[before:]] == [["MISSION_NOT_ACTIVE"]]
    here.restart()
    assert status(here, mission()) == "issued"
    assert activate(here, mission()).status == "active"
    running = here.submit(go("pharmacy"))
    assert not isinstance(running, Report)
    assert here.finish(running).outcome == "succeeded"
    assert verbs(here) == [("issue", "one", "issued"), ("activate", "one", "active")]
    assert waiting(here) == []


def test_an_activation_without_handing_in_writes_both_statuses() -> None:
    here = Station()
    activate(here, mission())
    activate(here, mission(version=2))
    taken, first, offered, second = (r for r in records(here) if r.kind == "management")
    for issue, active in ((taken, first), (offered, second)):
        assert issue.open == {**active.open, "verb": "issue", "status": "issued"}
        assert (sorted(issue.committed), sorted(active.committed)) == (
            [],
            ["confirmation", "token"],
        )
    assert verify_rows(here.store.rows(), terminal=None).whole


def test_a_refused_activation_leaves_nothing_of_the_mission() -> None:
    here = Station()
    activate(here, mission("other"))
    held = here.store._held
    assert refused(activate, here, mission())[0] == "TRANSITION_REFUSED"
    assert (status(here, mission()), waiting(here)) == (None, [])
    assert here.store._held == held
    assert records(here)[-1].kind == "refusal"


@pytest.mark.parametrize(
    ("token", "reason"),
    [
        (lambda here: here.token(mission(), "supervisor-1"), "ROLE_DENIED"),
        (
            lambda here: here.token(mission()).replace(b'ture":"', b'ture":"A', 1),
            "SIGNATURE_INVALID",
        ),
        (lambda here: here.token(replace(mission(), profile="A" * 43)), "PROFILE_MISMATCH"),
        (lambda here: here.token(mission(version=2)), "MISSION_UNKNOWN"),
        (lambda _: b"{}", "MALFORMED"),
    ],
)
def test_what_could_not_be_activated_is_not_taken_in(token: Any, reason: str) -> None:
    here = Station()
    said = refused(lambda: here.gate.management.issue(token(here)))[0]
    assert said == reason
    assert said == refused(lambda: here.gate.management.activate(token(here)))[0]
    assert waiting(here) == []


def test_a_mission_is_handed_in_while_another_one_is_active() -> None:
    here = Station()
    activate(here, mission("other"))
    hand_in(here, mission())
    assert here.gate.ledger.run(lambda act: act.active()) == "other"
    assert not isinstance(here.submit(go("pharmacy")), Report)


def test_a_token_is_handed_in_once() -> None:
    here = Station()
    hand_in(here, mission())
    assert refused(hand_in, here, mission())[0] == "MISSION_NOT_ACTIVE"
    activate(here, mission())
    assert refused(hand_in, here, mission())[0] == "TRANSITION_REFUSED"
    assert refused(activate, here, mission())[0] == "TRANSITION_REFUSED"


@pytest.mark.parametrize("by", ["operator-1", "safety-officer-1"])
def test_an_issued_mission_that_is_revoked_is_never_activated(by: str) -> None:
    here = Station()
    activate(here, mission("other"))
    hand_in(here, mission())
    done = here.gate.management.command(here.order(mission(), Verb.REVOKE, by))
    assert (done.status, waiting(here)) == ("revoked", [])
    assert here.gate.ledger.run(lambda act: act.active()) == "other"  # it goes on
    here.gate.management.command(here.order(mission("other"), Verb.REVOKE))
    here.restart()
    for act in (hand_in, activate):
        assert refused(act, here, mission())[0] == "REVOKED"


@pytest.mark.parametrize("verb", [Verb.SUSPEND, Verb.RESUME, Verb.COMPLETE])
def test_no_other_order_changes_an_issued_mission(verb: Verb) -> None:
    here = Station()
    hand_in(here, mission())
    reason = refused(here.gate.management.command, here.order(mission(), verb))[0]
    assert reason == "TRANSITION_REFUSED"
    assert status(here, mission()) == "issued"


def test_a_row_of_an_issued_mission_is_not_chosen() -> None:
    here = Station()
    hand_in(here, mission())
    value = mission()
    choice = Selection(
        mid=value.mid,
        version=value.version,
        mission=digest_of(Tag.MISSION, value),
        grant=value.actions[0].id,
        row=0,
        nonce=b64(b"choice"),
        expires_ms=here.robot.wall_ms() + MINUTE_MS,
        issued_ms=here.robot.wall_ms(),
    )
    before = here.standing("one")
    token = sign_object(choice, Tag.SELECTION, signer("operator-1"))
    assert refused(here.gate.management.select, token)[0] == "MISSION_NOT_ACTIVE"
    assert here.standing("one") == before


@pytest.mark.parametrize("verb", [Verb.SUSPEND, Verb.REVOKE])
def test_an_order_that_misnames_its_version_is_refused(verb: Verb) -> None:
    here = Station()
    activate(here, mission())
    hand_in(here, mission(version=2))
    for value, wrong in ((mission(), 2), (mission(version=2), 1)):
        order = here.order(value, verb, version=wrong)
        with pytest.raises(AuthGuardError) as error:
            here.gate.management.command(order)
        assert (str(error.value.reason), error.value.where) == (
            "MISSION_UNKNOWN",
            "command.version",
        )
        assert f"expected {value.version}" in error.value.message
    assert (status(here, mission()), status(here, mission(version=2))) == ("active", "issued")


def test_nobody_else_revokes_an_issued_mission() -> None:
    here = Station()
    hand_in(here, mission())
    order = here.order(mission(), Verb.REVOKE, "operator-2")
    assert refused(here.gate.management.command, order)[0] == "ROLE_DENIED"
    assert status(here, mission()) == "issued"


def test_an_issued_mission_whose_time_ends_is_expired_by_the_next_order() -> None:
    here = Station()
    hand_in(here, mission(window={"for": "10 min"}))
    here.jump(11 * MINUTE_MS)
    value = mission(window={"for": "10 min"})
    assert refused(activate, here, value)[0] == "EXPIRED"
    assert (status(here, value), waiting(here)) == ("expired", [])
    assert verbs(here)[-1] == ("lapse", "one", "expired")
    assert records(here)[-2].open["reasons"] == ["EXPIRED"]
    for act in (hand_in, activate):
        assert refused(act, here, value)[0] == "EXPIRED"
    assert [verb for verb, *_ in verbs(here)] == ["issue", "lapse"]  # once


# the next version


def test_an_update_waits_beside_the_active_version_and_takes_over_what_was_used() -> None:
    here = Station()
    activate(here, mission())
    first = here.submit(go("pharmacy"))
    assert not isinstance(first, Report)
    hand_in(here, mission(version=2))
    assert here.standing("one").version == 1  # type: ignore[union-attr]
    here.finish(first)  # it goes on to its end
    used = here.standing("one")
    assert used is not None
    here.restart()
    assert (status(here, mission(version=2)), waiting(here)) == ("issued", [("one", 2)])
    made = activate(here, mission(version=2))
    assert (made.version, made.status, made.uses) == (2, "active", used.uses)
    assert waiting(here) == []
    assert status(here, mission()) is None
    assert refused(activate, here, mission(version=2))[0] == "TRANSITION_REFUSED"


@pytest.mark.parametrize(
    ("verb", "ends"), [(Verb.REVOKE, "revoked"), (Verb.COMPLETE, "superseded")]
)
def test_an_update_that_waits_ends_with_its_mission(verb: Verb, ends: str) -> None:
    here = Station()
    activate(here, mission())
    hand_in(here, mission(version=2))
    here.gate.management.command(here.order(mission(), verb))
    assert (status(here, mission(version=2)), waiting(here)) == (ends, [])
    lapse = records(here)[-1]
    assert (lapse.link.decision, lapse.open["version"]) == ("lapse", 2)
    reason = {"revoked": "REVOKED", "superseded": "SUPERSEDED"}[ends]
    for act in (hand_in, activate):
        assert refused(act, here, mission(version=2))[0] == reason


def test_an_update_that_waits_expires_with_its_mission() -> None:
    here = Station()
    first, late = mission(window={"for": "10 min"}), {"window": {"for": "40 min"}}
    digest = digest_of(Tag.MISSION, first)
    second = scenarios.mission(mission="one", version=2, supersedes=digest, **late)
    activate(here, first)
    hand_in(here, second)
    here.jump(11 * MINUTE_MS)
    assert refused(activate, here, second)[0] == "EXPIRED"
    assert status(here, second) == "expired"


def test_a_revoked_update_leaves_the_active_version_and_another_one_takes_its_place() -> None:
    here = Station()
    activate(here, mission())
    hand_in(here, mission(version=2))
    here.gate.management.command(here.order(mission(version=2), Verb.REVOKE, issued_ms=0))
    assert here.standing("one").status == "active"  # type: ignore[union-attr]
    assert here.gate.ledger.run(lambda act: act.active()) == "one"
    assert refused(hand_in, here, mission(version=2))[0] == "REVOKED"
    other = mission(version=2, task="Something else.")
    hand_in(here, other)
    assert activate(here, other).version == 2


def test_an_order_about_an_issued_update_makes_none_about_the_active_version_too_old() -> None:
    here = Station()
    activate(here, mission())
    hand_in(here, mission(version=2))
    earlier = here.order(mission(), Verb.SUSPEND)
    here.gate.management.command(here.order(mission(version=2), Verb.REVOKE))
    assert here.gate.management.command(earlier).status == "suspended"


def test_of_two_updates_that_wait_the_first_activated_supersedes_the_other() -> None:
    here = Station()
    activate(here, mission())
    other = mission(version=2, task="Something else.")
    for value in (mission(version=2), other):
        hand_in(here, value)
    activate(here, other)
    assert status(here, mission(version=2)) == "superseded"
    assert refused(activate, here, mission(version=2))[0] == "SUPERSEDED"


def test_a_version_that_is_only_issued_is_superseded_by_the_next() -> None:
    here = Station()
    hand_in(here, mission())
    hand_in(here, mission(version=2))
    assert waiting(here) == [("one", 1), ("one", 2)]
    assert activate(here, mission(version=2)).status == "active"
    assert waiting(here) == []
    assert refused(activate, here, mission())[0] == "TRANSITION_REFUSED"


def test_an_update_by_somebody_else_is_not_taken_in() -> None:
    here = Station()
    activate(here, mission())
    value = mission(version=2, issuer="operator-2")
    said = refused(lambda: here.gate.management.issue(here.token(value, "operator-2")))
    assert said[0] == "ROLE_DENIED"
    assert waiting(here) == []


# bounds and damage


def test_a_bounded_number_of_missions_waits() -> None:
    here = Station()
    for number in range(LIMITS.issued_missions):
        hand_in(here, mission(f"m-{number}"))
    reason, text = refused(hand_in, here, mission("more"))
    assert reason == "BUSY"
    assert "authguard mission revoke" in text
    assert activate(here, mission("more")).status == "active"  # it does not wait
    here.gate.management.command(here.order(mission("m-0"), Verb.REVOKE))
    hand_in(here, mission("next"))
    assert len(waiting(here)) == LIMITS.issued_missions


def test_a_damaged_issued_mission_keeps_nobody_from_an_order() -> None:
    here = Station()
    activate(here, mission("other"))
    hand_in(here, mission())
    digest = digest_of(Tag.MISSION, mission())
    here.gate.ledger.run(lambda act: act.put("token", digest, b"{}"))
    done = here.gate.management.command(here.order(mission("other"), Verb.REVOKE))
    assert done.status == "revoked"
    assert status(here, mission()) == "issued"


def spoil(here: Station, what: str) -> None:
    """Damage an entry about issued missions: the list of all, an update, or another mission."""
    update = digest_of(Tag.MISSION, mission("other", 2))
    kind, key = {
        "list": ("issued", "names"),
        "update": ("issued", update),
        "mission": ("standing", "one"),
    }[what]
    assert here.store._held[kind, key]
    here.store._held[kind, key] = b"{"
    here.kill()


@pytest.mark.parametrize("verb", [Verb.SUSPEND, Verb.REVOKE])
@pytest.mark.parametrize("what", ["list", "update", "mission"])
def test_damage_to_issued_missions_stops_no_order_that_narrows(what: str, verb: Verb) -> None:
    here = Station()
    activate(here, mission("other"))
    hand_in(here, mission("other", 2))
    hand_in(here, mission())
    spoil(here, what)
    here.gate.management.command(here.order(mission("other"), verb))
    after = {Verb.SUSPEND: "suspended", Verb.REVOKE: "revoked"}[verb]
    assert status(here, mission("other")) == after
    if verb is Verb.REVOKE and what == "mission":  # what can be read ends with its mission
        assert status(here, mission("other", 2)) == "revoked"
    (text,) = here.gate.ledger.run(damaged)
    assert {"list": "the list", "update": "`other`", "mission": "`one`"}[what] in text
    size = len(records(here))
    for act in (hand_in, activate):
        reason, said = refused(act, here, mission("more"))
        assert (reason, "rollback.md" in said) == ("STORE_CORRUPT", True)
    assert (status(here, mission("more")), len(records(here))) == (None, size)


def test_an_order_that_narrows_is_carried_out_before_issued_missions_are_looked_at() -> None:
    here = Station()
    activate(here, mission("other"))
    hand_in(here, mission(window={"for": "10 min"}))
    here.jump(11 * MINUTE_MS)
    here.gate.management.command(here.order(mission("other"), Verb.SUSPEND))
    assert verbs(here)[-2:] == [("suspend", "other", "suspended"), ("lapse", "one", "expired")]


@pytest.mark.parametrize("data", [b"{", b'[["one"]]'])
def test_a_damaged_list_of_issued_missions_is_said(data: bytes) -> None:
    here = Station()
    here.gate.ledger.run(lambda act: act.put("issued", "names", data))
    with pytest.raises(StoreError):
        hand_in(here, mission())


def test_damage_to_issued_missions_stops_no_withdrawal() -> None:
    sim = templates.admitted()
    management = sim.gate.management
    management.activate(templates.token())
    management.issue(templates.token(templates.instance(2)))
    sim.gate.ledger.run(lambda act: act.put("issued", "names", b"{"))
    assert management.template(templates.withdrawal()).withdrawn
    standing = management.standing("deliver.1")  # type: ignore[arg-type]
    assert standing is not None
    assert standing.status == "revoked"


# templates


def test_an_instance_is_counted_when_it_is_handed_in_and_ends_with_its_template() -> None:
    sim = templates.admitted()
    management = sim.gate.management
    management.issue(templates.token())
    assert management.activate(templates.token()).status == "active"
    management.issue(templates.token(templates.instance(2)))
    gone = management.template(templates.withdrawal())
    assert gone.used == 2  # the first one once
    for number in (1, 2):
        standing = management.standing(f"deliver.{number}")  # type: ignore[arg-type]
        assert standing is not None
        assert standing.status == "revoked"


# the log


def test_the_log_of_issued_missions_is_replayed() -> None:
    here = Station()
    activate(here, mission())
    running = here.submit(go("pharmacy"))
    assert not isinstance(running, Report)
    here.finish(running)
    here.gate.management.command(here.order(mission(), Verb.SUSPEND))
    hand_in(here, mission(version=2))
    here.gate.management.command(here.order(mission(version=2), Verb.REVOKE))
    counted = Standings()
    assert "".join(counted.note(record, {}) for record in records(here)) == ""
    standing = here.standing("one")
    assert standing is not None
    assert counted.wrong(standing) == ""
    # what became of the issued version hides no change of the active one
    assert "suspended" in counted.wrong(replace(standing, status=Status.ACTIVE))


def test_the_replay_tells_two_tokens_of_one_version_apart() -> None:
    here = Station()
    activate(here, mission())
    other = mission(version=2, task="Something else.")
    for value in (mission(version=2), other):
        hand_in(here, value)
    activate(here, other)  # it ends its sibling, with a `lapse` of version 2
    lapse = records(here)[-1]
    assert (lapse.open["status"], lapse.open["version"]) == ("superseded", 2)
    counted = Standings()
    assert "".join(counted.note(record, {}) for record in records(here)) == ""
    standing = here.standing("one")
    assert standing is not None
    assert counted.wrong(standing) == ""
    changed = replace(standing, status=Status.SUSPENDED)  # by nobody's order
    assert "by the records before it active" in counted.wrong(changed)


def test_the_record_of_an_order_names_the_digest_of_its_version() -> None:
    here = Station()
    activate(here, mission())
    for value in (mission(version=2), mission(version=2, task="Something else.")):
        hand_in(here, value)
        here.gate.management.command(here.order(value, Verb.REVOKE))
        assert records(here)[-1].open["mission"] == digest_of(Tag.MISSION, value)


# sealed logs


@pytest.mark.parametrize("way", ["retention", "order", "crash"])
def test_an_update_that_waits_is_destroyed_with_its_mission(tmp_path: Path, way: str) -> None:
    (tmp_path / "store").mkdir()
    path = tmp_path / "store" / "robot.db"
    data = sealed_logs.DataClass.REGION
    kept = sealed_logs.policy(retention=(sealed_logs.rule(data, most_ms=MINUTE_MS),))
    with sealed_logs.sealing(path, kept) as sim:
        management = sim.gate.management
        first = sealed_logs.active(sim)
        digest = digest_of(Tag.MISSION, first)
        update = scenarios.mission(version=2, supersedes=digest, window={"for": "50 min"})
        waits = digest_of(Tag.MISSION, update)
        management.issue(scenarios.token(update))
        assert sim.gate.ledger.run(lambda act: act.token(waits)) is not None
        if way != "retention":
            revoke = sealed_logs.command(sim, Verb.REVOKE, first)
            if way == "order":
                management.command(revoke)
            else:  # the gate ends right behind the commit of the order
                sim.gate.ledger.run(lambda act: carry_out(act, revoke, parts=management._parts))
            management.shred(sealed_logs.shred_order(sim, first.mid, data))
        else:
            sim.robot.pause(35 * MINUTE_MS)
            (done,) = management.retire().begun
            assert done.mid == first.mid
        while management.shred_on():
            pass
        assert sim.gate.ledger.run(issued) == ()
        assert sim.gate.ledger.run(lambda act: act.token(waits)) is None
    rows = sealed_logs.opened(sealed_logs.rows_of(path))
    tokens = [row for row in rows if sealed_logs.told(row).link.decision == "issue"]
    assert [sealed_logs.values(row) for row in tokens] == [{}, {}]


def test_an_issued_mission_that_expired_is_retired_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    path = tmp_path / "store" / "robot.db"
    data = sealed_logs.DataClass.REGION
    kept = sealed_logs.policy(retention=(sealed_logs.rule(data, most_ms=MINUTE_MS),))
    value = scenarios.mission()
    digest = digest_of(Tag.MISSION, value)
    with sealed_logs.sealing(path, kept) as sim:
        sim.gate.management.issue(scenarios.token(value))
        sim.robot.pause(35 * MINUTE_MS)
        (done,) = sim.gate.management.retire().begun
        assert done.mid == value.mid
        while sim.gate.management.shred_on():
            pass
        assert sim.gate.management.standing(value.mid).status == "expired"  # type: ignore[union-attr]
        assert sim.gate.ledger.run(issued) == ()
        assert sim.gate.ledger.run(lambda act: act.token(digest)) is None
