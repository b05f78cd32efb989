# SPDX-License-Identifier: Apache-2.0
"""Who signed the active mission is revoked, or his certificate ends: it authorizes nothing more.

And it locks nobody out: it can be ended, settled, succeeded by another, shown and stopped. Nothing
that lets it go on goes by a signature that does not hold.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.authoring.keys.setup import Member, add_member, demo_members, init_folder
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.messages import ClientRole, Kind, Order, OrderKind
from fixtures import scenarios, templates
from unit.server.demo_site import GO, SCAN, DemoGate, HandClock, Refused
from unit.server.test_emergencies import Disk, _Kept

BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
MINUTE_MS = 60_000
#: When the first certificate of `operator-2` ends.
ENDS_MS = 10 * MINUTE_MS
SECOND = Member(id="operator-2", role=Role.OPERATOR, robots=None, regions=None)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a set-up that a gate reads, `auth` beside it, and `new` with a later certificate.

    `operator-2` has a certificate that ends soon in the first two, another one in the third.
    """
    init_folder(tmp_path / "trust", demo_members(scenarios.site(), (scenarios.RID,)), now=BEGIN)
    shutil.copytree(tmp_path / "trust", tmp_path / "new")
    add_member(tmp_path / "new", SECOND, now=BEGIN, days=30)
    soon = BEGIN - timedelta(days=1) + timedelta(milliseconds=ENDS_MS)
    add_member(tmp_path / "trust", SECOND, now=soon, days=1)
    shutil.copytree(tmp_path / "trust", tmp_path / "auth")
    return tmp_path


class EmergencyGate:
    """A gate and everybody who may sign for it.

    Args:
        folder: the set-up.
        issuer: who signs the first mission.
        more: of the house.
    """

    def __init__(self, folder: Path, *, issuer: str = "operator-1", **more: Any) -> None:
        self.folder = folder
        self.first = mission("first", issuer)
        self.house = DemoGate(trust=folder / "trust", mission=self.first, **more)

    def __enter__(self) -> Self:
        self.house.__enter__()
        return self

    def __exit__(self, *more: object) -> None:
        self.house.__exit__(*more)

    @property
    def management(self) -> Any:
        return self.house.gate.management

    def status(self, mid: str = "first") -> str:
        return str(self.management.standing(mid).status)

    def list(self, name: str = "operator-1") -> None:
        """Let the gate have a list that names everything that somebody was given."""
        self.house.gate.lists.install(dead(self.folder, name))

    def begin(self, which: str, by: str, *, of: str = "trust") -> Any:
        return self.management.activate(self.signed(mission(which, by), by, of=of))

    def signed(self, value: Mission, by: str, *, of: str = "trust") -> bytes:
        return sign_object(value, Tag.MISSION, folder_signer(self.folder / of, by))

    def order(self, verb: Verb, by: str, *, of: str = "trust", **more: Any) -> bytes:
        fields: dict[str, Any] = {
            "verb": verb,
            "mid": self.first.mid,
            "version": 1,
            "mission": digest_of(Tag.MISSION, self.first),
            "nonce": b64(scenarios.random_bytes(16)),
            "expires_ms": self.house.clock.wall_ms() + MINUTE_MS,
            "issued_ms": self.house.clock.wall_ms() + 1,
        }
        value = Command(**{**fields, **more})
        return sign_object(value, Tag.COMMAND, folder_signer(self.folder / of, by))

    def refused(self, act: Callable[[], object]) -> str:
        before = self.management.standing("first")
        with pytest.raises(AuthGuardError) as error:
            act()
        assert self.management.standing("first") == before
        return str(error.value.reason)

    def lapses(self) -> list[tuple[str, str, list[str]]]:
        """What ended by itself: whose record it is, how it stands, and why."""
        return [
            (record.link.mid, record.open["status"], record.open["reasons"])
            for record in self.house.log("management")
            if record.link.decision == "lapse"
        ]


def mission(name: str, issuer: str = "operator-1") -> Mission:
    return scenarios.mission(mission=name, issuer=issuer)


def dead(folder: Path, name: str) -> bytes:
    done = revoke(folder / "auth", principal=name, serial=None, now=BEGIN, days=30)
    ((_, found),) = done.lists.items()
    return found.signed


@pytest.mark.parametrize(("verb", "after"), [(Verb.SUSPEND, "suspended"), (Verb.REVOKE, "revoked")])
def test_an_officer_narrows_a_mission_whose_signer_is_on_a_list(
    folder: Path, verb: Verb, after: str
) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        ward.list()
        ward.management.command(ward.order(verb, "safety-officer-1"))
        assert ward.status() == after
        assert ward.lapses() == []


def test_the_next_mission_takes_the_place_of_one_whose_signer_is_on_a_list(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        ward.list()
        ward.begin("second", "operator-2")
        assert (ward.status(), ward.status("second")) == ("revoked", "active")
        assert ward.lapses() == [("first", "revoked", ["CERTIFICATE_REVOKED"])]
        planner = ward.house.enter(ClientRole.PLANNER)
        (step,) = ward.house.propose(planner, SCAN)["steps"]
        assert step["released"] is True


def test_a_mission_that_ended_in_time_lapses_whatever_became_of_its_signer(folder: Path) -> None:
    with EmergencyGate(folder, estimator=False, robot=False) as ward:
        ward.house.activate()
        ward.list()
        ward.house.clock.ms += 26 * MINUTE_MS
        later = scenarios.draft(mission="second", window={"for": "50 min"})
        value = scenarios.mission(**{**later, "issuer": "operator-2"})
        ward.management.activate(ward.signed(value, "operator-2", of="new"))
        assert ward.lapses() == [("first", "expired", ["EXPIRED"])]


def test_a_mission_whose_signers_certificate_ended_gives_way_too(folder: Path) -> None:
    with EmergencyGate(folder, issuer="operator-2", estimator=False, robot=False) as ward:
        ward.house.activate()
        ward.house.clock.ms += ENDS_MS + 1_000
        ward.begin("second", "operator-1")
        assert ward.lapses() == [("first", "expired", ["CERTIFICATE_EXPIRED"])]
        assert ward.status("second") == "active"


def test_an_issued_mission_whose_signers_certificate_ended_expires(folder: Path) -> None:
    with EmergencyGate(folder, estimator=False, robot=False) as ward:
        ward.house.activate()
        second = ward.signed(mission("second", "operator-2"), "operator-2")
        assert ward.management.issue(second).status == "issued"
        ward.house.clock.ms += ENDS_MS + 1_000
        ward.management.command(ward.order(Verb.SUSPEND, "operator-1"))
        assert ward.lapses() == [("second", "expired", ["CERTIFICATE_EXPIRED"])]
        assert (ward.status(), ward.status("second")) == ("suspended", "expired")


def test_a_mission_whose_signature_holds_gives_way_to_nobody(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        assert ward.refused(lambda: ward.begin("second", "operator-2")) == "TRANSITION_REFUSED"
        assert ward.lapses() == []


def test_an_activation_that_is_refused_ends_nothing(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        ward.list()
        second = ward.signed(mission("second", "operator-2"), "operator-2")
        spoiled = second.replace(b'"signature":"', b'"signature":"A', 1)
        for token in (spoiled, ward.signed(mission("second"), "operator-1")):
            ward.refused(lambda it=token: ward.management.activate(it))  # type: ignore[misc]
        later = scenarios.mission(
            mission="second", issuer="operator-2", version=2, supersedes="A" * 43
        )
        refused = ward.refused(lambda: ward.management.activate(ward.signed(later, "operator-2")))
        assert refused == "MISSION_UNKNOWN"
        assert (ward.status(), ward.lapses()) == ("active", [])


def test_nothing_lets_a_mission_go_on_by_a_signature_that_does_not_hold(folder: Path) -> None:
    """Its issuer has a certificate that holds again; what the lost one signed stays dead."""
    with EmergencyGate(folder, issuer="operator-2") as ward:
        ward.house.activate()
        ward.list("operator-2")
        again: Any = {"by": "operator-2", "of": "new"}
        ward.management.command(ward.order(Verb.SUSPEND, **again))
        assert ward.refused(lambda: ward.management.command(ward.order(Verb.RESUME, **again))) == (
            "CERTIFICATE_REVOKED"
        )
        choice = Selection(
            mid=ward.first.mid,
            version=1,
            mission=digest_of(Tag.MISSION, ward.first),
            grant=ward.first.actions[0].id,
            row=0,
            nonce=b64(scenarios.random_bytes(16)),
            expires_ms=ward.house.clock.wall_ms() + MINUTE_MS,
            issued_ms=ward.house.clock.wall_ms(),
        )
        chosen = sign_object(choice, Tag.SELECTION, folder_signer(folder / "new", "operator-2"))
        assert ward.refused(lambda: ward.management.select(chosen)) == "CERTIFICATE_REVOKED"
        following = scenarios.mission(
            mission="first",
            issuer="operator-2",
            version=2,
            supersedes=digest_of(Tag.MISSION, ward.first),
        )
        token = ward.signed(following, "operator-2", of="new")
        assert ward.refused(lambda: ward.management.activate(token)) == "CERTIFICATE_REVOKED"
        planner = ward.house.enter(ClientRole.PLANNER)
        (step,) = ward.house.propose(planner, SCAN)["steps"]
        assert step["released"] is False
        ward.house.advance(100)  # signed after the suspension
        ward.management.command(ward.order(Verb.COMPLETE, **again))
        assert ward.status() == "completed"


def test_somebody_elses_order_is_no_better_for_a_lost_signature(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        ward.list()
        for by in ("operator-2", "supervisor-1"):
            order = ward.order(Verb.REVOKE, by)
            assert ward.refused(lambda it=order: ward.management.command(it)) == "ROLE_DENIED"  # type: ignore[misc]
        mine = ward.order(Verb.REVOKE, "operator-1")
        assert ward.refused(lambda: ward.management.command(mine)) == "CERTIFICATE_REVOKED"


def test_a_gate_that_was_killed_with_a_release_open_serves_on_under_the_list(folder: Path) -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with EmergencyGate(folder, store=store, clock=clock, speed_up=1) as ward:
        ward.house.activate()
        ward.house.begin(ward.house.enter(ClientRole.PLANNER), GO)
        ward.house.advance(500)
        ward.house.crashes = True
    (folder / "trust/revocations/people.json").write_bytes(dead(folder, "operator-1"))
    with EmergencyGate(folder, store=store, clock=clock) as ward:
        planner = ward.house.enter(ClientRole.PLANNER)
        (step,) = ward.house.propose(planner, SCAN)["steps"]
        assert step["refusal"]["reason"] == "CERTIFICATE_REVOKED"
        held = ward.management.standing("first")
        assert (held.status, len(held.open)) == ("suspended", 1)
        officer = ward.house.enter(ClientRole.OPERATOR)
        revoked = ward.order(Verb.REVOKE, "safety-officer-1")
        officer.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=revoked))
        ward.begin("second", "operator-2")
        (step,) = ward.house.propose(planner, SCAN)["steps"]
        assert step["released"] is True


def test_what_nobody_knows_is_resolved_under_a_lost_signature(folder: Path) -> None:
    """By the issuer, whose later certificate holds."""
    store, clock = _Kept(MemoryStore()), HandClock()
    with EmergencyGate(folder, issuer="operator-2", store=store, clock=clock, speed_up=1) as ward:
        ward.house.activate()
        ward.house.begin(ward.house.enter(ClientRole.PLANNER), GO)
        ward.house.advance(500)
        ward.house.crashes = True
    with EmergencyGate(folder, issuer="operator-2", store=store, clock=clock) as ward:
        ward.list("operator-2")
        (ticket,) = ward.management.recover(unclean=True)
        more: Any = {"ticket": ticket, "outcome": Outcome.FAILED}
        ward.management.command(ward.order(Verb.RESOLVE, "operator-2", of="new", **more))
        held = ward.management.standing("first")
        assert (held.status, held.open) == ("suspended", ())


@pytest.mark.parametrize("who", ["operator-1", "scheduler-0"])
def test_a_mission_made_of_a_template_gives_way_when_either_signer_is_on_a_list(
    tmp_path: Path, who: str
) -> None:
    at = templates.folder()
    sim = templates.admitted(at)
    sim.gate.management.activate(templates.token(at=at))
    shutil.copytree(at, tmp_path / "auth")
    sim.gate.lists.install(dead(tmp_path, who))
    value = scenarios.mission(mission="second", issuer="operator-2")
    token = sign_object(value, Tag.MISSION, folder_signer(at, "operator-2"))
    sim.gate.management.activate(token)
    assert sim.gate.management.standing("deliver.1").status == "revoked"
    assert sim.gate.management.standing("second").status == "active"


def test_a_planners_stops_are_counted_under_a_lost_signature(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        ward.list()
        most = ward.first.budgets.planner_stops
        for n in range(most + 5):
            ward.house.stop(ClientRole.PLANNER, n + 1)
        assert ward.management.standing("first").planner_stops == most + 1
        assert len(ward.house.log("stop")) == most + 2  # the first past it, and then no more
        assert [r.open["what"] for r in ward.house.log("alert")] == ["planner stops"]


def test_status_and_metrics_show_the_mission_and_why_it_authorizes_nothing(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        auditor = ward.house.enter(ClientRole.AUDITOR)
        ward.house.activate()
        assert auditor.ask(Kind.STATUS)["mission"]["void"] is None
        ward.list()
        ward.house.service.queries.mission.changed()
        shown = auditor.ask(Kind.STATUS)["mission"]
        assert (shown["mid"], shown["status"]) == ("first", "active")
        assert shown["void"] == "CERTIFICATE_REVOKED"
        assert auditor.ask(Kind.METRICS)["mission_active"] == 1


def test_silence_is_told_of_under_a_lost_signature(folder: Path) -> None:
    with EmergencyGate(folder, planner_silence_ms=1_000) as ward:
        ward.house.activate()
        ward.list()
        ward.house.service.queries.mission.changed()
        for _ in range(3):
            ward.house.advance(1_000)
            ward.house.service._listen()
        assert [r.open["what"] for r in ward.house.log("alert")] == ["planner is silent"]


def test_silence_is_told_of_without_a_disk(folder: Path) -> None:
    disk = Disk()
    with EmergencyGate(folder, planner_silence_ms=1_000, store=disk) as ward:
        ward.house.activate()
        ward.house.service._listen()
        disk.dead = True
        ward.house.service.queries.mission.changed()
        with pytest.raises(EnvironmentFault):
            assert ward.house.service.queries.mission.status
        for _ in range(3):
            ward.house.advance(1_000)
            ward.house.service._listen()
        told = [alert["what"] for alert in ward.house.service.liveness.alerts]
        disk.dead = False
        assert "planner is silent" in told


def test_the_gate_answers_an_order_under_a_lost_signature_as_it_does_any(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        operator = ward.house.enter(ClientRole.OPERATOR)
        ward.house.activate()
        ward.list()
        second = ward.signed(mission("second", "operator-2"), "operator-2")
        told = operator.ask(Kind.ORDER, Order(act=OrderKind.ACTIVATE, token=second))
        assert told["standing"]["status"] == "active"
        resumed = ward.order(Verb.RESUME, "operator-1")
        with pytest.raises(Refused, match="CERTIFICATE_REVOKED"):
            operator.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=resumed))


def test_a_mission_whose_closing_is_over_lapses_at_the_next_activation(folder: Path) -> None:
    with EmergencyGate(folder, estimator=False, robot=False) as ward:
        ward.house.activate()
        plain = {**msgspec.to_builtins(ward.management.standing("first")), "status": "closing"}
        closing = msgspec.convert({**plain, "closes_ms": scenarios.START_MS + 1_000}, Standing)
        ward.house.gate.ledger.run(lambda act: act.hold(closing))
        ward.house.clock.ms += 2_000
        ward.begin("second", "operator-2")
        assert ward.lapses() == [("first", "completed", ["MISSION_COMPLETED"])]


def test_another_missions_token_under_a_digest_decides_and_ends_nothing(folder: Path) -> None:
    with EmergencyGate(folder) as ward:
        ward.house.activate()
        held = ward.management.standing("first").digest
        other = ward.signed(mission("second", "operator-2"), "operator-2")
        ward.house.gate.ledger.run(lambda act: act.keep_token(held, other))
        ward.house.gate.enforcer.inputs.forget()
        planner = ward.house.enter(ClientRole.PLANNER)
        (step,) = ward.house.propose(planner, SCAN)["steps"]
        assert step["refusal"]["reason"] == "STORE_CORRUPT"
        order = ward.order(Verb.REVOKE, "safety-officer-1")
        assert ward.refused(lambda: ward.management.command(order)) == "STORE_CORRUPT"
