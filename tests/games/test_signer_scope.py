# SPDX-License-Identifier: Apache-2.0
"""A certificate confines its holder to robots and regions; what it does not name is outside.

Each attack is by somebody with a real key in the right role, signing beyond that certificate. The
gate refuses, nothing is used up, nothing moves, and the same words by somebody with the scope pass.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.audit.record import read_record
from authguard_r.authoring.keys.setup import Member, add_member, init_folder
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation, simulate
from fixtures import scenarios, templates
from missionpair.bench import Bench, BenchScene, approve, propose
from missionpair.suite import restricted

GO = scenarios.navigate("dock", "pharmacy")
BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1_000, UTC)
LATER = scenarios.START_MS + 3_600_000
REGIONS = tuple(scenarios.mission().regions)
#: Everything that the way into the isolation room names.
WAY = ("dock", "isolation-room")
Where = tuple[str, ...] | None
_names = itertools.count()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("scope") / "trust"
    init_folder(
        made, scenarios.demo_members(scenarios.site(), (scenarios.RID, scenarios.OTHER)), now=BEGIN
    )
    return made


def certified(
    folder: Path, role: Role, robots: Where, regions: Where, *, template: str | None = None
) -> str:
    """Certify one more principal and return its name."""
    name = f"{str(role).replace('_', '-')}-x{next(_names)}"
    member = Member(id=name, role=role, robots=robots, regions=regions, template=template)
    add_member(folder, member, now=BEGIN, days=30)
    return name


def gate(folder: Path, **kwargs: Any) -> Simulation:
    """Return a gate that started after everybody was certified."""
    return simulate(
        folder,
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=scenarios.START_MS,
        **{"store": None, **kwargs},
    )


def sign(folder: Path, value: object, tag: Tag, by: str) -> bytes:
    return sign_object(value, tag, folder_signer(folder, by))


def refused(sim: Simulation, act: Callable[[], object], where: str | None = None) -> None:
    """Assert the reason, one record of it, and that nothing else is another than before."""
    store, mid = sim.gate.ledger.store, scenarios.mission().mid
    size, before = len(store.rows()), sim.gate.management.standing(mid)
    with pytest.raises(AuthGuardError) as caught:
        act()
    assert caught.value.reason is Reason.SIGNER_OUT_OF_SCOPE
    assert where is None or caught.value.where == where
    assert sim.gate.management.standing(mid) == before
    assert len(store.rows()) == size + 1
    record = read_record(store.rows()[-1].record, where="")
    assert (record.kind, record.open["reasons"]) == ("refusal", ["SIGNER_OUT_OF_SCOPE"])
    assert sim.robot.trace == []


# missions

OUTSIDE: dict[str, tuple[Where, Where, str]] = {
    "no robot and no region": ((), (), "mission.rid"),
    "no robot": ((), None, "mission.rid"),
    "another robot": (("lifter-1",), None, "mission.rid"),
    "a robot whose name begins the same": (("courier-10", "courier-"), None, "mission.rid"),
    "no region": (None, (), "mission.regions"),
    "all regions but the last": (("courier-1",), REGIONS[:-1], "mission.regions"),
    "all regions but the first": (("courier-1",), REGIONS[1:], "mission.regions"),
    "regions that stand around the mission's": (None, ("hospital", "ward"), "mission.regions"),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_mission_beyond_its_signer_s_certificate_is_not_activated(
    folder: Path, name: str
) -> None:
    robots, regions, where = OUTSIDE[name]
    by = certified(folder, Role.OPERATOR, robots, regions)
    sim = gate(folder)
    token = sign(folder, scenarios.mission(issuer=by), Tag.MISSION, by)
    refused(sim, lambda: sim.gate.management.activate(token), where)
    assert scenarios.propose(sim, GO).refusal.reason is Reason.NO_ACTIVE_MISSION


@pytest.mark.parametrize(
    ("robots", "regions"),
    [
        (("courier-1",), REGIONS),
        (("courier-1", "lifter-1"), (*REGIONS, "office-2")),
        (None, REGIONS),
        (("courier-1",), None),
    ],
)
def test_a_mission_inside_its_signer_s_certificate_is_carried_out(
    folder: Path, robots: Where, regions: Where
) -> None:
    by = certified(folder, Role.OPERATOR, robots, regions)
    sim = gate(folder)
    token = sign(folder, scenarios.mission(issuer=by), Tag.MISSION, by)
    assert sim.gate.management.activate(token).status == "active"
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED


def test_a_next_version_that_leaves_the_certificate_changes_nothing(folder: Path) -> None:
    by = certified(folder, Role.OPERATOR, ("courier-1",), REGIONS)
    sim = gate(folder)
    first = scenarios.mission(issuer=by)
    sim.gate.management.activate(sign(folder, first, Tag.MISSION, by))
    grants = [dict(grant) for grant in scenarios.draft()["grants"]]
    grants[0]["rows"] = [
        *grants[0]["rows"],
        {"source": "office-2", "destination": "pharmacy", "regions": ["office-2", "pharmacy"]},
    ]
    wider = scenarios.mission(
        issuer=by, version=2, supersedes=digest_of(Tag.MISSION, first), grants=grants
    )
    assert "office-2" in wider.regions
    token = sign(folder, wider, Tag.MISSION, by)
    refused(sim, lambda: sim.gate.management.activate(token), "mission.regions")
    assert sim.gate.management.standing(first.mid).version == 1


# templates


@pytest.mark.parametrize("narrow", ["issuer", "scheduler"])
@pytest.mark.parametrize("name", ["another robot", "no region", "all regions but the last"])
def test_an_instance_beyond_its_scheduler_s_or_its_issuer_s_certificate_is_not_made(
    folder: Path, name: str, narrow: str
) -> None:
    robots, regions, _ = OUTSIDE[name]
    if regions:
        regions = ("dock",)
    wide: tuple[Where, Where] = (None, None)
    issuer = certified(folder, Role.OPERATOR, *((robots, regions) if narrow == "issuer" else wide))
    template = templates.edited((("issuer",), issuer))
    hashed = templates.digest(template)
    scheduler = certified(
        folder,
        Role.SCHEDULER,
        *((robots, regions) if narrow == "scheduler" else wide),
        template=hashed,
    )
    sim = gate(folder)
    sim.gate.management.template(sign(folder, template, Tag.TEMPLATE, issuer))
    made = templates.instance(template=hashed)
    token = templates.token(made, by=scheduler, at=folder)
    refused(sim, lambda: sim.gate.management.activate(token))
    assert sim.gate.management.standing(made.mid) is None
    other = certified(folder, Role.SCHEDULER, None, None, template=hashed)
    if narrow == "scheduler":
        again = gate(folder)
        again.gate.management.template(sign(folder, template, Tag.TEMPLATE, issuer))
        token = templates.token(made, by=other, at=folder)
        assert again.gate.management.activate(token).status == "active"


def withdrawal(folder: Path, hashed: str, by: str) -> bytes:
    value = Command(
        verb=Verb.WITHDRAW,
        mid=templates.template().template,
        version=1,
        mission=hashed,
        nonce=b64(by.encode()),
        expires_ms=LATER,
    )
    return sign(folder, value, Tag.COMMAND, by)


def test_a_safety_officer_of_another_robot_withdraws_no_template(folder: Path) -> None:
    foreign = certified(folder, Role.SAFETY_OFFICER, ("lifter-1",), None)
    own = certified(folder, Role.SAFETY_OFFICER, ("courier-1",), ())
    sim = gate(folder)
    sim.gate.management.template(sign(folder, templates.template(), Tag.TEMPLATE, "operator-1"))
    hashed = templates.digest()
    refused(sim, lambda: sim.gate.management.template(withdrawal(folder, hashed, foreign)))
    assert sim.gate.management.template(withdrawal(folder, hashed, own)).withdrawn


# orders


def order(folder: Path, mission: Mission, verb: Verb, by: str) -> bytes:
    value = Command(
        verb=verb,
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        nonce=b64(f"{verb}-{by}".encode()),
        expires_ms=LATER,
    )
    return sign(folder, value, Tag.COMMAND, by)


@pytest.mark.parametrize("verb", [Verb.SUSPEND, Verb.REVOKE])
@pytest.mark.parametrize("robots", [(), ("lifter-1",)], ids=["of none", "of another"])
def test_a_safety_officer_of_another_robot_gives_no_order_here(
    folder: Path, robots: Where, verb: Verb
) -> None:
    by = certified(folder, Role.SAFETY_OFFICER, robots, None)
    own = certified(folder, Role.SAFETY_OFFICER, ("courier-1",), ())
    sim, mission = gate(folder), scenarios.mission()
    sim.gate.management.activate(sign(folder, mission, Tag.MISSION, "operator-1"))
    refused(sim, lambda: sim.gate.management.command(order(folder, mission, verb, by)))
    assert sim.gate.management.standing(mission.mid).status == "active"
    done = sim.gate.management.command(order(folder, mission, verb, own))
    assert done.status == ("suspended" if verb is Verb.SUSPEND else "revoked")


# choices


def choice(folder: Path, mission: Mission, grant: str, by: str) -> bytes:
    value = Selection(
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        grant=grant,
        row=0,
        nonce=b64(by.encode()),
        expires_ms=LATER,
        issued_ms=scenarios.START_MS,
    )
    return sign(folder, value, Tag.SELECTION, by)


@pytest.mark.parametrize(
    ("robots", "regions"),
    [
        ((), None),
        (("lifter-1",), None),
        (("courier-1",), ()),
        (("courier-1",), ("dock", "public-corridor")),
        (("courier-1",), ("pharmacy", "public-corridor")),
        (("courier-1",), ("dock", "pharmacy")),
    ],
    ids=["no robot", "another robot", "no region", "no destination", "no source", "no way"],
)
def test_a_supervisor_who_has_no_say_there_chooses_nothing(
    folder: Path, robots: Where, regions: Where
) -> None:
    by = certified(folder, Role.SUPERVISOR, robots, regions)
    row = ("dock", "pharmacy", "public-corridor")
    own = certified(folder, Role.SUPERVISOR, ("courier-1",), row)
    grants = [
        {**grant, "chooser": "supervisor"} if grant["id"] == "go-to-pharmacy" else grant
        for grant in scenarios.draft()["grants"]
    ]
    sim, mission = gate(folder), scenarios.mission(grants=grants)
    sim.gate.management.activate(sign(folder, mission, Tag.MISSION, "operator-1"))
    data = choice(folder, mission, "go-to-pharmacy", by)
    refused(sim, lambda: sim.gate.management.select(data))
    assert sim.gate.management.standing(mission.mid).selected == {}
    after = sim.gate.management.select(choice(folder, mission, "go-to-pharmacy", own))
    assert after.selected == {"go-to-pharmacy": 0}


# answers


def asked(folder: Path) -> tuple[Bench, BenchScene]:
    """Return the scene in which two supervisors are asked about the isolation room."""
    bench = Bench(folder, scenarios.site(), scenarios.binding(), scenarios.START_MS)
    scene = restricted(bench)
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    return bench, scene


def reasons(scene: BenchScene) -> list[str]:
    judged = propose(scene)[-1].judged
    assert judged is not None
    return [str(reason) for reason in judged.decision.reasons]


@pytest.mark.parametrize(
    ("robots", "regions"),
    [
        ((), None),
        (("lifter-1",), None),
        (("courier-1",), ()),
        (("courier-1",), ("dock",)),
        (("courier-1",), ("isolation-room",)),
        (("courier-1",), ("dock", "office-1", "pharmacy")),
    ],
    ids=["no robot", "another robot", "no region", "no destination", "no source", "elsewhere"],
)
def test_the_answer_of_a_supervisor_who_has_no_say_there_does_not_count(
    folder: Path, robots: Where, regions: Where
) -> None:
    by = certified(folder, Role.SUPERVISOR, robots, regions)
    own = certified(folder, Role.SUPERVISOR, ("courier-1",), WAY)
    bench, scene = asked(folder)
    approve(bench, scene, "supervisor-1", by)
    before = scene.standing()
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing() == before
    assert scene.sim.robot.trace == []
    approve(bench, scene, own)
    assert propose(scene)[-1].outcome is Outcome.SUCCEEDED


def test_the_denial_of_a_supervisor_who_has_no_say_there_does_not_count(folder: Path) -> None:
    foreign = certified(folder, Role.SUPERVISOR, ("courier-1",), ("office-1",))
    own = certified(folder, Role.SUPERVISOR, ("courier-1",), WAY)
    bench, scene = asked(folder)
    approve(bench, scene, foreign, verdict=ApprovalVerdict.DENY)
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    approve(bench, scene, "supervisor-1", "supervisor-2")
    approve(bench, scene, own, verdict=ApprovalVerdict.DENY)
    assert reasons(scene) == ["APPROVAL_DENIED"]


def test_a_mission_s_verified_issuer_says_what_its_certificate_names(folder: Path) -> None:
    by = certified(folder, Role.OPERATOR, ("courier-1",), REGIONS)
    sim = gate(folder)
    sim.gate.management.activate(sign(folder, scenarios.mission(issuer=by), Tag.MISSION, by))
    verified = sim.gate.ledger.run(sim.gate.enforcer.inputs.active_mission)
    assert verified.issuer.scope.robots == frozenset({"courier-1"})
    assert verified.issuer.scope.regions == frozenset(REGIONS)
    narrow = msgspec.structs.replace(verified.issuer.scope, regions=frozenset())
    assert narrow.covers(scenarios.RID)
    assert not narrow.covers(scenarios.RID, ["dock"])
    assert not narrow.covers(scenarios.OTHER)
