# SPDX-License-Identifier: Apache-2.0
"""Who answers to which requests: the mission, its open requests, signers and signed answers.

The digests of scope and situation are the oracle's.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

from authguard_r.approvals import Selection
from authguard_r.core.approval import Approval
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.revocation import Revocation, sign_list
from authguard_r.keys.signer import FileSigner
from authguard_reference.approval import scope_of, situation_of
from fixtures import decision_cases, scenarios
from making.chains import authority, leaf, root, serial_of
from unit.keys.chains import EVERYWHERE, PRINCIPAL, Held, eku, key, san

Json = dict[str, Any]

DAY = timedelta(days=1)
BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
NOW_MS = scenarios.START_MS
#: When the open request ends, and how long the lists of the trust folder last.
OPEN_MS, LISTS_MS = NOW_MS + 120_000, NOW_MS + 20 * 86_400_000
DATES: Json = {"start": BEGIN - DAY, "end": BEGIN + 30 * DAY}
TOP = root("Vector root", **DATES)
PEOPLE = authority(TOP, name="people of approvals", **DATES)
ROBOT, REGION = "urn:authguard-r:robot:", "urn:authguard-r:region:"
MEMBERS = ("supervisor-1", "supervisor-2", "supervisor-3")
OTHERS = ("officer-1", "supervisor-3", "supervisor-4")
#: Where each way leads: nobody, one, or two are asked beside the issuer.
GOALS = ("pharmacy", "isolation-room", "plant-room")


def mission(**changes: Any) -> Mission:
    """Return the hospital's mission with a grant to each goal, under a policy that sees people."""
    base = scenarios.mission()
    way = decision_cases.set_(
        base.actions[0], chooser="operator", until=(), guards=(), starts=9, repeat=9
    )
    rows = [
        {"source": "dock", "destination": goal, "regions": sorted(["dock", goal])} for goal in GOALS
    ]
    grants = [
        {**decision_cases.plain(way), "id": f"to-{goal}", "alternatives": [row]}
        for goal, row in zip(GOALS, rows, strict=True)
    ]
    near = {
        "variable": "human_distance_mm",
        "comparison": "lt",
        "value": 1_000,
        "max_age_ms": 1_000,
    }
    policy = {**decision_cases.plain(base.risk_policy), "states": [{"guard": near, "weight": 30}]}
    fields: Json = {
        **decision_cases.plain(base),
        "actions": grants,
        "regions": sorted([*GOALS, "dock"]),
        "objects": [],
        "risk_policy": policy,
    }
    fields.pop("closing")
    return msgspec.convert({**fields, **changes}, Mission)


MISSION = mission()
DIGEST = digest_of(Tag.MISSION, MISSION)


def action(goal: str, **changes: Any) -> Json:
    """Return the way from the dock to a goal."""
    return {**decision_cases.plain(scenarios.navigate("dock", goal)), **changes}


def state(**readings: int) -> Json:
    """Return the robot at the dock; readings as given."""
    snapshot = scenarios.state("dock").snapshot
    kept = {
        n: decision_cases.set_(r, value=readings.get(n, r.value))
        for n, r in snapshot.readings.items()
    }
    plain = decision_cases.plain(decision_cases.set_(snapshot, readings=kept))
    return {"snapshot": plain, "arrived_mono_ms": scenarios.NOW.mono_ms}


STATES = {"nobody near": state(), "somebody near": state(human_distance_mm=500)}


def situation(goal: str, tier: int, near: str = "nobody near") -> str:
    """Return the digest of a situation on the way to a goal."""
    plain = decision_cases.plain(MISSION)
    grant = next(g for g in plain["actions"] if g["id"] == f"to-{goal}")
    facts, now = decision_cases.plain_facts(scenarios.facts()), decision_cases.plain(scenarios.NOW)
    return situation_of(plain, grant, tier, state=STATES[near], facts=facts, now=now)


def request(goal: str, tier: int, near: str = "nobody near", **changes: Any) -> Json:
    """Return the open request of a way."""
    return {
        "counter": 7,
        "scope": scope_of(action(goal)),
        "situation": situation(goal, tier, near),
        "required": tier,
        "expires_ms": OPEN_MS,
        **changes,
    }


def signers() -> dict[str, Held]:
    """Return who answers, each with a certificate."""
    someone: dict[str, tuple[Role, tuple[str, ...]]] = {
        "supervisor-1": (Role.SUPERVISOR, EVERYWHERE),
        "supervisor-2": (Role.SUPERVISOR, EVERYWHERE),
        "supervisor-3": (Role.SUPERVISOR, EVERYWHERE),
        "officer-1": (Role.SAFETY_OFFICER, EVERYWHERE),
        "operator-1": (Role.OPERATOR, EVERYWHERE),
        "operator-2": (Role.OPERATOR, EVERYWHERE),
        "issuer-as-supervisor": (Role.SUPERVISOR, EVERYWHERE),
        "of-courier": (
            Role.SUPERVISOR,
            (ROBOT + "courier-1", REGION + "dock", REGION + "plant-room"),
        ),
        "of-lifter": (Role.SUPERVISOR, (ROBOT + "lifter-1", EVERYWHERE[1])),
        "of-no-plant": (Role.SUPERVISOR, (EVERYWHERE[0], REGION + "dock")),
        "of-no-dock": (Role.SUPERVISOR, (EVERYWHERE[0], REGION + "plant-room")),
        "of-nothing": (Role.SUPERVISOR, ()),
        "gone": (Role.SUPERVISOR, EVERYWHERE),
        "short": (Role.SUPERVISOR, EVERYWHERE),
        "board-2": (Role.SUPERVISOR, (*EVERYWHERE, *_group(2, *MEMBERS))),
        "board-1": (Role.SUPERVISOR, (*EVERYWHERE, *_group(1, *MEMBERS))),
        "board-3-issuer": (Role.SUPERVISOR, (*EVERYWHERE, *_group(3, "operator-1", *MEMBERS))),
        "board-2-issuer": (Role.SUPERVISOR, (*EVERYWHERE, *_group(2, "operator-1", *MEMBERS))),
        "board-1-issuer": (Role.SUPERVISOR, (*EVERYWHERE, *_group(1, "operator-1", *MEMBERS))),
        "board-2-same": (Role.SUPERVISOR, (*EVERYWHERE, *_group(2, *MEMBERS[:2]))),
        "board-2-others": (Role.SUPERVISOR, (*EVERYWHERE, *_group(2, *OTHERS))),
    }
    found = {name: _certified(name, role, names) for name, (role, names) in someone.items()}
    role = (eku(Role.SUPERVISOR), True)
    found["stranger"] = leaf(
        strangers(), "supervisor-1", "stranger of approvals", role=role, **DATES
    )
    gates = (eku(Role.WITNESS), True)
    found["witness"] = leaf(witnesses(), "witness-1", "witness", role=gates, **DATES)
    return found


def witnesses() -> Held:
    """Return the authority of witnesses."""
    return authority(TOP, (Role.WITNESS,), "witnesses of approvals", subject="Witnesses", **DATES)


def strangers() -> Held:
    """Return the authority of people under a root that nobody here trusts."""
    own = key("foreign people")
    return authority(root("Another root", **DATES), name="foreign of approvals", own=own, **DATES)


def _group(threshold: int, *members: str) -> tuple[str, ...]:
    names = [f"urn:authguard-r:member:{name}" for name in members]
    return (f"urn:authguard-r:threshold:{threshold}", *names)


def _certified(name: str, role: Role, names: tuple[str, ...]) -> Held:
    principal = "operator-1" if name == "issuer-as-supervisor" else name
    dates = {**DATES, "end": BEGIN + timedelta(seconds=60)} if name == "short" else DATES
    said = (san(PRINCIPAL + principal, *names), False)
    return leaf(
        PEOPLE, principal, f"{name} of approvals", role=(eku(role), True), names=said, **dates
    )


def trusted() -> Json:
    """Return root, authorities and lists; the list of people revokes `gone`."""
    gone = serial_of("leaf gone of approvals")
    held = {"people": PEOPLE, "witnesses": witnesses()}
    texts = {}
    for name, owner, serials in (
        ("root", TOP, ()),
        ("people", PEOPLE, (str(gone),)),
        ("witnesses", held["witnesses"], ()),
    ):
        revocation = Revocation(
            authority=name,
            number=1,
            issued=f"{BEGIN - DAY:%Y-%m-%dT%H:%M:%SZ}",
            next_update=f"{BEGIN + 20 * DAY:%Y-%m-%dT%H:%M:%SZ}",
            serials=serials,
        )
        texts[name] = sign_list(revocation, owner.key).decode()
    return {
        "root": b64(TOP.der),
        "authorities": {name: b64(one.der) for name, one in held.items()},
        "revocations": texts,
    }


class Answers:
    """Signed answers by name; each signer's certificate is made once."""

    def __init__(self) -> None:
        self.signers = signers()
        self.tokens: dict[str, Json] = {}

    def signer(self, by: str) -> FileSigner:
        """Return who signs as `by`."""
        held = self.signers[by]
        above = {"witness": witnesses().der, "stranger": strangers().der}.get(by, PEOPLE.der)
        return FileSigner(held.key, (held.der, above))

    def give(self, name: str, by: str, goal: str = "plant-room", **changes: Any) -> str:
        """Sign an answer to the usual request of a goal; what is given is changed."""
        tier = GOALS.index(goal) + 1
        asked = request(goal, tier)
        fields: Json = {
            "mid": MISSION.mid,
            "version": 1,
            "mission": DIGEST,
            "rid": "courier-1",
            "grant": f"to-{goal}",
            "scope": asked["scope"],
            "situation": asked["situation"],
            "counter": 7,
            "expires_ms": OPEN_MS,
            "verdict": "approve",
            **changes,
        }
        value = msgspec.convert(fields, Approval)
        return self.put(name, by, sign_object(value, Tag.APPROVAL, self.signer(by)).decode())

    def put(self, name: str, by: str, token: str) -> str:
        """Keep a token under a name."""
        self.tokens[name] = {"by": by, "token": token}
        return name


def principals(answers: Answers) -> dict[str, Json]:
    """Return whom each signer's certificate makes them, as the specification has it."""
    groups = {
        "board-2": 2,
        "board-1": 1,
        "board-3-issuer": 3,
        "board-2-issuer": 2,
        "board-1-issuer": 1,
        "board-2-same": 2,
        "board-2-others": 2,
    }
    members = {"board-2-same": MEMBERS[:2], "board-2-others": OTHERS}
    roles = {
        "officer-1": "safety_officer",
        "operator-1": "operator",
        "operator-2": "operator",
        "witness": "witness",
    }
    scopes: dict[str, tuple[list[str] | None, list[str] | None]] = {
        "of-courier": (["courier-1"], ["dock", "plant-room"]),
        "of-lifter": (["lifter-1"], None),
        "of-no-plant": (None, ["dock"]),
        "of-no-dock": (None, ["plant-room"]),
        "of-nothing": ([], []),
    }
    found: dict[str, Json] = {}
    for name in answers.signers:
        robots, regions = scopes.get(name, (None, None))
        found[name] = {
            "id": {
                "issuer-as-supervisor": "operator-1",
                "witness": "witness-1",
                "stranger": "supervisor-1",
            }.get(name, name),
            "role": roles.get(name, "supervisor"),
            "scope": {"robots": robots, "regions": regions},
            "usable_until_ms": NOW_MS + 60_000 if name == "short" else LISTS_MS,
        }
        if name in groups:
            issuer = ["operator-1"] if name.endswith("issuer") else []
            found[name] |= {
                "threshold": groups[name],
                "members": [*issuer, *members.get(name, MEMBERS)],
            }
    return found


def selection() -> Selection:
    """Return a choice: signed by a supervisor, but no answer."""
    fields: Json = {
        "mid": MISSION.mid,
        "version": 1,
        "mission": DIGEST,
        "grant": "to-plant-room",
        "row": 0,
        "nonce": b64(bytes(16)),
        "expires_ms": OPEN_MS,
    }
    return msgspec.convert(fields, Selection)
