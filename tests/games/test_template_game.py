# SPDX-License-Identifier: Apache-2.0
"""The game of a scheduler: it holds a key and a signed template, and wants one mission more.

Each attack changes one thing in a valid world; afterwards no mission is active, nothing was counted
and one record says why.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record
from authguard_r.authoring.keys.setup import Member, add_member
from authguard_r.core.encoding import Tag, b64, digest_of, encode_fast
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Endorsement, Token, read_token, sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.enforcement.templates import KeptTemplate
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from fixtures import scenarios, templates
from fixtures.templates import SET, edited, instance, signed, token, withdrawal

LATER = scenarios.START_MS + 25 * templates.MINUTE_MS


def opened(sim: Simulation) -> list[dict[str, Any]]:
    return [read_record(row.record, where="").open for row in sim.gate.ledger.store.rows()]  # type: ignore[attr-defined]


def kept(sim: Simulation, digest: str | None = None) -> KeptTemplate | None:
    found = sim.gate.ledger.run(lambda act: act.get("template", digest or templates.digest()))
    return None if found is None else msgspec.json.decode(found, type=KeptTemplate)


def refused(sim: Simulation, act: Callable[[], object], reason: str) -> None:
    """Assert that an act is refused, leaves one record, and that nothing can be done."""
    before, counted = len(opened(sim)), kept(sim)
    with pytest.raises(AuthGuardError) as error:
        act()
    assert str(error.value.reason) == reason, str(error.value)
    assert [record["reasons"] for record in opened(sim)[before:]] == [[reason]]
    assert kept(sim) == counted
    assert sim.gate.ledger.run(lambda act: act.active()) is None
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.refusal.reason is Reason.NO_ACTIVE_MISSION
    assert sim.robot.trace == []


FILL = {"package": "package-p1", "station": "station-101"}
OUTSIDE: dict[str, tuple[dict[str, Any], str]] = {
    "a value outside its set": ({"fill": {**FILL, "station": "plant-room"}}, "VALUE_OUT_OF_RANGE"),
    "a value of the other hole": (
        {"fill": {"package": "station-101", "station": "package-p1"}},
        "VALUE_OUT_OF_RANGE",
    ),
    "a number for a name": ({"fill": {**FILL, "station": 101}}, "VALUE_OUT_OF_RANGE"),
    "a value in another spelling": (
        {"fill": {**FILL, "station": "station_101"}},
        "VALUE_OUT_OF_RANGE",
    ),
    "a hole too few": ({"fill": {"package": "package-p1"}}, "SCHEMA_INVALID"),
    "no hole": ({"fill": {}}, "SCHEMA_INVALID"),
    "a hole too many": ({"fill": {**FILL, "tool": "gripper"}}, "SCHEMA_INVALID"),
    "a field of the mission as a hole": (
        {"fill": {**FILL, "issuer": "operator-2"}},
        "SCHEMA_INVALID",
    ),
    "a name under another template": ({"mid": "deliver-p1"}, "META_MISMATCH"),
    "a name that only begins alike": ({"mid": "deliver-all.1"}, "META_MISMATCH"),
    "a name with nothing of its own": ({"mid": "deliver."}, "META_MISMATCH"),
    "a longer validity": ({"expiry": to_timestamp(LATER + 1_000)}, "VALUE_OUT_OF_RANGE"),
    "an end before its beginning": (
        {"not_before": to_timestamp(LATER), "expiry": to_timestamp(scenarios.START_MS)},
        "SCHEMA_INVALID",
    ),
    "no instant": ({"expiry": "2026-02-30T00:00:00Z"}, "SCHEMA_INVALID"),
    "a mission of the past": (
        {"not_before": "2020-01-01T00:00:00Z", "expiry": "2020-01-01T00:10:00Z"},
        "EXPIRED",
    ),
    "a mission after the template's end": (
        {"not_before": "2099-01-01T00:00:00Z", "expiry": "2099-01-01T00:10:00Z"},
        "EXPIRED",
    ),
}


@pytest.mark.parametrize("attack", OUTSIDE)
def test_an_instance_that_says_more_than_was_signed_is_refused(attack: str) -> None:
    changes, reason = OUTSIDE[attack]
    sim = templates.admitted()
    data = token(instance(**changes))
    refused(sim, lambda: sim.gate.management.activate(data), reason)


def test_every_combination_of_two_holes_is_in_the_card_and_no_other() -> None:
    """Holes are independent: the signer was shown every cross, so every cross is taken."""
    for package in ("package-p1", "package-p2"):
        for station in ("station-101", "station-102", "station-103"):
            sim = templates.admitted()
            fill = {"package": package, "station": station}
            assert sim.gate.management.activate(token(instance(fill=fill))).status == "active"


def narrow() -> Any:
    """A second template of the same operator: its holes and name are its own."""
    holes = {**templates.template().holes}
    holes["station"] = SET(holes["station"], values=("station-102",))
    return edited(holes=holes, template="narrow")


@pytest.fixture(scope="module")
def two() -> Any:
    return templates.folder(templates.template(), narrow())


def test_the_certificate_for_another_template_fills_nothing(two: Any) -> None:
    sim = templates.admitted(two)
    sim.gate.management.template(signed(narrow()))
    data = token(by="scheduler-1", at=two)
    refused(sim, lambda: sim.gate.management.activate(data), "ROLE_DENIED")


def test_an_instance_of_another_template_than_its_certificate_s_is_refused(two: Any) -> None:
    sim = templates.admitted(two)
    sim.gate.management.template(signed(narrow()))
    other = instance(template=templates.digest(narrow()), mid="narrow.1")
    data = token(other, by="scheduler-0", at=two)
    refused(sim, lambda: sim.gate.management.activate(data), "ROLE_DENIED")


def test_a_template_that_is_not_here_fills_nothing(two: Any) -> None:
    sim = templates.admitted(two)
    other = instance(template=templates.digest(narrow()), mid="narrow.1")
    data = token(other, by="scheduler-1", at=two)
    refused(sim, lambda: sim.gate.management.activate(data), "MISSION_UNKNOWN")


def test_a_second_endorsement_bound_to_another_template_spoils_the_token(two: Any) -> None:
    """One principal with two certificates: each must be bound to this very template."""
    at = templates.folder(templates.template())
    member = Member(
        id="scheduler-9",
        role=Role.SCHEDULER,
        robots=None,
        regions=None,
        template=templates.digest(narrow()),
    )
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    add_member(at, member, now=begin, days=30)
    keys = at / "keys"
    for kind in ("key", "cert"):
        (keys / f"spare.{kind}.pem").write_bytes((keys / f"scheduler-9.{kind}.pem").read_bytes())
        (keys / f"scheduler-9.{kind}.pem").unlink()
    add_member(at, SET(member, template=templates.digest()), now=begin, days=30)
    first, second = (read_token(token(by=name, at=at)) for name in ("scheduler-9", "spare"))
    both = encode_fast(SET(first, endorsements=(*first.endorsements, *second.endorsements)))
    sim = templates.admitted(at)
    refused(sim, lambda: sim.gate.management.activate(both), "ISSUER_MISMATCH")
    whole = encode_fast(SET(first, endorsements=first.endorsements * 2))
    assert sim.gate.management.activate(whole).status == "active"


@pytest.mark.parametrize(
    "by", ["operator-1", "supervisor-1", "safety-officer-1", "site-authority-1"]
)
def test_nobody_but_a_scheduler_signs_an_instance(by: str) -> None:
    sim = templates.admitted()
    refused(sim, lambda: sim.gate.management.activate(token(by=by)), "ROLE_DENIED")


def test_a_scheduler_signs_no_mission_of_its_own() -> None:
    sim, scheduler = templates.admitted(), folder_signer(templates.one_folder(), "scheduler-0")
    for issuer in ("operator-1", "scheduler-0"):
        mission = SET(scenarios.mission(), issuer=issuer)
        data = sign_object(mission, Tag.MISSION, scheduler)
        refused(sim, lambda data=data: sim.gate.management.activate(data), "ROLE_DENIED")


def test_a_scheduler_gives_no_order_and_signs_no_template() -> None:
    sim, scheduler = templates.admitted(), folder_signer(templates.one_folder(), "scheduler-0")
    own = sign_object(narrow(), Tag.TEMPLATE, scheduler)
    refused(sim, lambda: sim.gate.management.template(own), "ROLE_DENIED")
    order = withdrawal(by="scheduler-0", at=templates.one_folder())
    refused(sim, lambda: sim.gate.management.template(order), "ROLE_DENIED")
    refused(sim, lambda: sim.gate.management.command(order), "ROLE_DENIED")


def test_a_scheduler_s_certificate_without_a_template_fills_nothing() -> None:
    at = templates.folder()
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    add_member(
        at,
        Member(id="anything", role=Role.SCHEDULER, robots=None, regions=None),
        now=begin,
        days=30,
    )
    sim = templates.admitted(at)
    data = token(by="anything", at=at)
    refused(sim, lambda: sim.gate.management.activate(data), "ROLE_DENIED")


@pytest.mark.parametrize("by", ["supervisor-1", "site-authority-1", "witness-1"])
def test_a_template_signed_by_somebody_who_issues_no_missions_is_refused(by: str) -> None:
    sim = templates.simulation()
    mine = edited((("issuer",), by))
    refused(sim, lambda: sim.gate.management.template(signed(mine, by=by)), "ROLE_DENIED")


def test_a_template_in_another_operator_s_name_is_refused() -> None:
    sim = templates.simulation()
    refused(sim, lambda: sim.gate.management.template(signed(by="operator-2")), "ISSUER_MISMATCH")


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("rid", "lifter-1", "ROBOT_MISMATCH"),
        ("profile", "A" * 43, "PROFILE_MISMATCH"),
        ("site", "A" * 43, "SITE_MISMATCH"),
    ],
)
def test_a_template_for_another_robot_profile_or_site_is_refused(
    field: str, value: str, reason: str
) -> None:
    sim = templates.simulation()
    other = edited(((field,), value))
    refused(sim, lambda: sim.gate.management.template(signed(other)), reason)


def test_a_template_that_ended_is_refused() -> None:
    sim = templates.simulation()
    old = edited(not_after="2020-01-01T00:00:00Z")
    refused(sim, lambda: sim.gate.management.template(signed(old)), "EXPIRED")


def test_a_template_is_taken_in_once() -> None:
    sim = templates.admitted()
    refused(sim, lambda: sim.gate.management.template(signed()), "TRANSITION_REFUSED")


def test_an_instance_is_no_mission_and_a_mission_no_instance() -> None:
    sim = templates.admitted()
    made = read_token(token())
    relabeled = encode_fast(SET(made, kind=Tag.MISSION))
    refused(sim, lambda: sim.gate.management.activate(relabeled), "SIGNATURE_INVALID")
    mission = encode_fast(SET(read_token(scenarios.token()), kind=Tag.INSTANCE))
    refused(sim, lambda: sim.gate.management.activate(mission), "MALFORMED")
    refused(sim, lambda: sim.gate.management.template(token()), "WRONG_KIND")
    refused(sim, lambda: sim.gate.management.activate(signed()), "WRONG_KIND")


def test_a_changed_instance_is_not_its_scheduler_s() -> None:
    sim = templates.admitted()
    good, other = read_token(token()), read_token(token(instance(2)))
    forged = encode_fast(SET(good, payload=other.payload))
    refused(sim, lambda: sim.gate.management.activate(forged), "SIGNATURE_INVALID")


def test_a_replayed_instance_is_refused_and_not_counted_twice() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    templates.delivered(sim, FILL)
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(token())
    assert error.value.reason is Reason.MISSION_COMPLETED
    assert kept(sim).used == 1  # type: ignore[union-attr]
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(token(instance(1, nonce="B" * 22)))
    assert error.value.reason is Reason.MISSION_COMPLETED


def test_a_second_instance_waits_for_the_first_to_end() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(token(instance(2)))
    assert error.value.reason is Reason.TRANSITION_REFUSED
    assert kept(sim).used == 1  # type: ignore[union-attr]


def test_no_more_instances_are_made_than_were_signed_for() -> None:
    few = edited(instances=2)
    at = templates.folder(few)
    sim = templates.simulation(at)
    sim.gate.management.template(signed(few))
    for number in (1, 2):
        made = instance(number, template=templates.digest(few))
        sim.gate.management.activate(token(made, at=at))
        templates.delivered(sim, FILL)
        bring_back(sim)
    third = token(instance(3, template=templates.digest(few)), at=at)
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(third)
    assert error.value.reason is Reason.STARTS_EXHAUSTED
    assert kept(sim, templates.digest(few)).used == 2  # type: ignore[union-attr]


def bring_back(sim: Simulation) -> None:
    """Somebody carries the packages back to the pharmacy."""
    sim.robot.state = scenarios.world()


def test_a_window_s_rate_is_held_across_a_restart(tmp_path: Any) -> None:
    slow = edited(rate=SET(templates.template().rate, count=1))
    at = templates.folder(slow)
    sim = templates.simulation(at, store=tmp_path / "robot.db")
    sim.gate.management.template(signed(slow))
    first = instance(1, template=templates.digest(slow))
    sim.gate.management.activate(token(first, at=at))
    templates.delivered(sim, FILL)
    end = sim.robot.wall_ms()
    sim.gate.close()
    again = templates.simulation(at, store=tmp_path / "robot.db", start_ms=end)
    second = token(instance(2, template=templates.digest(slow)), at=at)
    with pytest.raises(AuthGuardError) as error:
        again.gate.management.activate(second)
    assert error.value.reason is Reason.RATE_EXCEEDED
    again.robot.pause(60 * templates.MINUTE_MS)
    late = again.robot.wall_ms()
    window = {"not_before": to_timestamp(late), "expiry": to_timestamp(late + 600_000)}
    third = token(instance(3, template=templates.digest(slow), **window), at=at)
    assert again.gate.management.activate(third).status == "active"
    again.gate.close()


def test_a_withdrawn_template_ends_its_active_mission_and_makes_none_again() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    go = scenarios.navigate("dock", "pharmacy")
    assert scenarios.propose(sim, go).outcome == "succeeded"
    held = sim.gate.management.template(withdrawal())
    assert (held.withdrawn, held.used, held.instances) == (True, 1, 50)
    assert sim.gate.management.standing("deliver.1").status == "revoked"  # type: ignore[union-attr]
    assert scenarios.propose(sim, go).refusal.reason is Reason.NO_ACTIVE_MISSION
    for act in (
        lambda: sim.gate.management.activate(token(instance(2))),
        lambda: sim.gate.management.template(signed()),
        lambda: sim.gate.management.template(withdrawal()),
    ):
        with pytest.raises(AuthGuardError) as error:
            act()
        assert error.value.reason is Reason.REVOKED
    verbs = [record["verb"] for record in opened(sim) if "verb" in record]
    assert verbs == ["template", "issue", "activate", "withdraw", "revoke"]


def test_a_withdrawn_template_ends_no_mission_that_was_not_made_of_it() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(scenarios.token())
    sim.gate.management.template(withdrawal(by="safety-officer-1"))
    assert sim.gate.management.standing("deliver-p1").status == "active"  # type: ignore[union-attr]
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome == "succeeded"


def test_withdrawing_one_template_leaves_the_mission_of_another(two: Any) -> None:
    sim = templates.admitted(two)
    sim.gate.management.template(signed(narrow()))
    sim.gate.management.activate(token(at=two))
    sim.gate.management.template(withdrawal(narrow()))
    assert sim.gate.management.standing("deliver.1").status == "active"  # type: ignore[union-attr]
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome == "succeeded"


def test_withdrawing_after_the_last_mission_ended_revokes_nothing() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    templates.delivered(sim, FILL)
    sim.gate.management.template(withdrawal())
    assert sim.gate.management.standing("deliver.1").status == "completed"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("changes", "by", "reason"),
    [
        ({}, "operator-2", "ROLE_DENIED"),
        ({}, "supervisor-1", "ROLE_DENIED"),
        ({"expires_ms": scenarios.START_MS - 1}, "operator-1", "EXPIRED"),
        ({"mission": "A" * 43}, "operator-1", "MISSION_UNKNOWN"),
        ({"verb": Verb.REVOKE}, "operator-1", "TRANSITION_REFUSED"),
    ],
)
def test_a_withdrawal_that_is_nobody_s_to_give_changes_nothing(
    changes: dict[str, Any], by: str, reason: str
) -> None:
    sim = templates.admitted()
    order = withdrawal(by=by, **changes)
    refused(sim, lambda: sim.gate.management.template(order), reason)
    assert sim.gate.management.activate(token()).status == "active"


def test_a_withdrawal_is_no_order_about_a_mission() -> None:
    """Even one that names a real mission and its digest: the verb is of templates."""
    sim = templates.admitted()
    standing = sim.gate.management.activate(scenarios.token())
    order = withdrawal(mid="deliver-p1", mission=standing.digest)
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.command(order)
    assert error.value.reason is Reason.TRANSITION_REFUSED
    assert sim.gate.management.standing("deliver-p1") == standing


def test_the_confirmation_of_something_else_beside_an_instance_activates_nothing() -> None:
    sim = templates.admitted()
    refused(sim, lambda: sim.gate.management.activate(token(), confirmation=b"{}"), "META_MISMATCH")


@pytest.mark.parametrize("who", ["operator-1", "scheduler-0"])
def test_after_a_certificate_is_revoked_neither_new_nor_cached_missions_go_on(
    tmp_path: Any, who: str
) -> None:
    """Lists are read when a gate starts; both people's certificates carry the mission."""
    at = templates.folder()
    sim = templates.admitted(at, store=tmp_path / "robot.db")
    sim.gate.management.activate(token(at=at))
    end = sim.robot.wall_ms()
    sim.gate.close()
    revoke(at, who)
    again = templates.simulation(at, store=tmp_path / "robot.db", start_ms=end)
    go = scenarios.navigate("dock", "pharmacy")
    assert scenarios.propose(again, go).refusal.reason is Reason.CERTIFICATE_REVOKED
    with pytest.raises(AuthGuardError) as error:
        again.gate.management.activate(token(instance(2), at=at))
    assert error.value.reason is Reason.CERTIFICATE_REVOKED
    officer = withdrawal(by="safety-officer-1")
    assert again.gate.management.template(officer).withdrawn  # narrowing needs no issuer
    assert again.gate.management.standing("deliver.1").status == "revoked"  # type: ignore[union-attr]
    again.gate.close()


def revoke(at: Any, who: str) -> None:
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    from authguard_r.authoring.keys.setup import write_revocations

    leaf = x509.load_pem_x509_certificates((at / "keys" / f"{who}.cert.pem").read_bytes())[0]
    key = load_pem_private_key((at / "keys" / "people.key.pem").read_bytes(), None)
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    serials = (leaf.serial_number,)
    write_revocations(at, "people", key, serials=serials, now=begin, number=2, days=30)  # type: ignore[arg-type]


def test_a_mission_ends_with_the_scheduler_s_certificate_too() -> None:
    at = templates.folder()
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    short = Member(
        id="brief", role=Role.SCHEDULER, robots=None, regions=None, template=templates.digest()
    )
    add_member(at, short, now=begin, days=1)
    sim = templates.admitted(at)
    standing = sim.gate.management.activate(token(by="brief", at=at))
    mission = sim.gate.ledger.run(
        lambda act: sim.gate.enforcer.inputs.mission(act, standing.digest)
    )
    assert mission.issuer.id == "operator-1"
    assert mission.issuer.usable_until_ms == scenarios.START_MS + 86_400_000


def restarted(sim: Simulation) -> Simulation:
    sim.gate.enforcer.inputs.forget()  # what a new process would have: nothing verified
    return sim


def held(sim: Simulation) -> dict[tuple[str, str], bytes]:
    found: dict[tuple[str, str], bytes] = sim.gate.ledger.store._held  # type: ignore[attr-defined]
    return found


TAMPERED: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "the instance of another mission": (
        lambda pair: pair.replace(
            token().strip().replace(b'"', b'\\"'), token(instance(2)).strip().replace(b'"', b'\\"')
        ),
        "STORE_CORRUPT",
    ),
    "the token of a plain mission": (lambda _: scenarios.token(), "STORE_CORRUPT"),
    "a pair that is none": (lambda pair: pair[:-1], "STORE_CORRUPT"),
    "another template": (
        lambda pair: pair.replace(
            signed().strip().replace(b'"', b'\\"'), signed(narrow()).strip().replace(b'"', b'\\"')
        ),
        "MISSION_UNKNOWN",
    ),
    "a template that nobody signed": (
        lambda pair: pair.replace(b'\\"signature\\":\\"', b'\\"signature\\":\\"AAAA'),
        "SIGNATURE_INVALID",
    ),
    "an instance that is no token": (
        lambda pair: encode_fast({**msgspec.json.decode(pair), "instance": "x"}),
        "MALFORMED",
    ),
}


@pytest.mark.parametrize("attack", TAMPERED)
def test_what_was_tampered_with_in_the_store_authorizes_nothing(attack: str) -> None:
    change, reason = TAMPERED[attack]
    sim = templates.admitted()
    standing = sim.gate.management.activate(token())
    key = ("token", standing.digest)
    before = held(sim)[key]
    held(sim)[key] = change(before)
    assert held(sim)[key] != before
    report = scenarios.propose(restarted(sim), scenarios.navigate("dock", "pharmacy"))
    assert str(report.refusal.reason) == reason
    assert sim.robot.trace == []


def test_a_kept_template_that_is_another_makes_no_mission() -> None:
    sim = templates.admitted()
    other = KeptTemplate(token=signed(narrow()).decode().strip())
    held(sim)["template", templates.digest()] = encode_fast(other)
    refused(sim, lambda: sim.gate.management.activate(token()), "MISSION_UNKNOWN")


def test_a_kept_template_that_is_none_is_the_store_s_corruption() -> None:
    sim = templates.admitted()
    held(sim)["template", templates.digest()] = b"{}"
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(token())
    assert error.value.reason is Reason.STORE_CORRUPT


def test_after_a_restart_the_mission_is_verified_from_both_tokens() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    templates.delivered(restarted(sim), FILL)
    assert sim.gate.management.standing("deliver.1").status == "completed"  # type: ignore[union-attr]


def test_a_template_gone_from_the_store_takes_its_mission_along() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    del held(sim)["template", templates.digest()]
    report = scenarios.propose(restarted(sim), scenarios.navigate("dock", "pharmacy"))
    assert report.refusal.reason is Reason.MISSION_UNKNOWN


def test_the_operator_may_change_a_running_instance_by_its_own_signature() -> None:
    """An instance is a mission: version 2 of it is the issuer's to sign, not the scheduler's."""
    sim = templates.admitted()
    standing = sim.gate.management.activate(token())
    made = sim.gate.ledger.run(lambda act: sim.gate.enforcer.inputs.mission(act, standing.digest))
    second = SET(made.mission, version=2, supersedes=standing.digest, nonce=b64(bytes(16)))
    assert sim.gate.management.activate(scenarios.token(second)).version == 2
    third = token(instance(1, nonce="C" * 22))
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(third)
    assert error.value.reason is Reason.TRANSITION_REFUSED


def test_a_scheduler_cannot_fill_the_memory_with_missions_that_are_refused() -> None:
    sim = templates.admitted()
    sim.gate.management.activate(token())
    for number in range(2, 40):
        with pytest.raises(AuthGuardError):
            sim.gate.management.activate(token(instance(number)))
    assert len(sim.gate.enforcer.inputs._verified) <= 16


def test_the_endorsements_of_an_instance_are_at_least_one() -> None:
    bare = encode_fast(
        Token(kind=Tag.INSTANCE, payload=read_token(token()).payload, endorsements=())
    )
    sim = templates.admitted()
    refused(sim, lambda: sim.gate.management.activate(bare), "MALFORMED")
    assert isinstance(read_token(token()).endorsements[0], Endorsement)
    assert digest_of(Tag.TEMPLATE, templates.template()) == templates.digest()
