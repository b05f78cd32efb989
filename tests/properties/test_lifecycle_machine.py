# SPDX-License-Identifier: Apache-2.0
"""A mission's whole life in any order, beside a small model of it written from the spec pages.

Hand in, activate, supersede, propose, ask, approve, deny, wait, order, end, kill and begin again:
the gate and the model give the same verdict with the same reasons, refuse the same orders for the
same reason, and hold the same standing. The model decides with the reference and keeps its registry
as docs/spec/standing.md, lifecycle.md and approval.md say, in plain data.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

import authguard_reference as oracle
from authguard_r.authoring.keys.setup import read_authority, write_revocations
from authguard_r.core.action import Action
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.enforcement.leases import Running
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.normalize import Step
from authguard_r.store.issued_missions import registered
from authguard_r.store.transactions import Transaction
from authguard_reference.approval import fits, scope_of, situation_of
from authguard_reference.place import guard_finding
from authguard_reference.policy import instant_ms
from authguard_reference.risk import tier_of
from authguard_reference.standing import STATUS_REFUSAL
from fixtures import scenarios
from fixtures.decision_cases import plain, plain_facts
from fixtures.restarting_gate import Station, go, signer, way
from missionpair.bench import Bench, BenchScene, make_bench

Json = dict[str, Any]
FACTS = plain_facts(scenarios.facts())
FINAL = {"completed", "revoked", "expired", "superseded"}
NAMES = ("one", "two")
VERSIONS = (1, 2, 3)
APPROVERS = ("supervisor-1", "supervisor-2", "safety-officer-1")
ACTIONS: dict[str, Action] = {
    "low": go("pharmacy"),
    "low, faster": go("pharmacy", speed=700),
    "too fast": go("pharmacy", speed=1_400),
    "elevated": go("isolation-room"),
    "high": go("office-1"),
    "high, faster": go("office-1", speed=700),
    "done": Action(type="scan_obstacles", tool="lidar", params={}),
    "home": go("station-101"),
}


@cache
def mission(name: str, version: int) -> Mission:
    """Return a version of a mission; the second wants more, the third allows less."""
    draft = scenarios.draft()
    drive = {**draft["grants"][0], "until": [], "chooser": "planner"}
    scan = next(grant for grant in draft["grants"] if grant["id"] == "look-out")
    seen = [{"variable": "battery_permille", "ge": 1, "max_age": "2 s"}]
    wide = {"repeat": 2, "starts": 3}
    low = {"repeat": 1, "starts": 1} if version == 3 else {"repeat": 3, "starts": 4}
    rows = [way("office-1" if (name, version) != ("two", 2) else "office-2")]
    grants = [
        {**drive, **low, "id": "low", "rows": [way("pharmacy")]},
        {**drive, **wide, "id": "elevated", "rows": [way("isolation-room")], "done_when": seen},
        {**drive, **wide, "id": "high", "rows": rows, "irreversible": True},
        {**drive, **wide, "id": "home", "rows": [way("station-101")], "after": ["done"]},
        {**scan, "id": "done", "repeat": min(version, 2), "starts": 4, "completes": True},
    ]
    changes: Json = {
        "mission": name,
        "version": version,
        "window": {"for": "40 min"},
        "grants": grants,
        "closing": {"grants": ["home"], "for": "10 min"} if name == "one" else None,
        "risk_policy": {**draft["risk_policy"], "tau_2": 40, "valid": "2 min"},
        "budgets": {
            **draft["budgets"],
            "actions": 8,
            "prompts": 4,
            "rate": {"count": 3, "per": "10 s"},
        },
    }
    if version > 1:
        changes["supersedes"] = digest_of(Tag.MISSION, mission(name, version - 1))
    return scenarios.mission(**changes)


@cache
def plain_mission(name: str, version: int) -> Json:
    return plain(mission(name, version))  # type: ignore[no-any-return]


@cache
def token(name: str, version: int) -> bytes:
    return sign_object(mission(name, version), Tag.MISSION, signer("operator-1"))


def fresh_standing(name: str, version: int) -> Json:
    digest = digest_of(Tag.MISSION, mission(name, version))
    return {"mid": name, "version": version, "digest": digest, "rid": scenarios.RID}


def status_of(name: str, version: int, act: Transaction) -> str | None:
    """Return the registry's status of exactly this version."""
    found = registered(act, name, digest_of(Tag.MISSION, mission(name, version)))  # type: ignore[arg-type]
    return None if found is None else str(found.status)


class Refused(Exception):  # noqa: N818 - it is an answer of the model
    """The model refuses an order, for this reason."""


def tidy(standing: Json) -> Json:
    """Leave out what is zero or empty, so that two ways of writing nothing compare equal."""
    kept = {name: value for name, value in standing.items() if value not in (0, [], {})}
    if "uses" in kept:
        uses = {grant: tidy(use) for grant, use in kept["uses"].items()}
        kept["uses"] = {grant: use for grant, use in uses.items() if use}
        if not kept["uses"]:
            del kept["uses"]
    if "spent" in kept:
        kept["spent"] = tidy(kept["spent"])
        if not kept["spent"]:
            del kept["spent"]
    return kept


def advanced(standing: Json, event: str) -> Json | None:
    """docs/spec/lifecycle.md; None where the table refuses."""
    status = oracle.TRANSITIONS[standing["status"]].get(event)
    return None if status is None else {**standing, "status": status}


def grant_of(of: Json, name: str) -> Json:
    return next(grant for grant in of["actions"] if grant["id"] == name)


class Model:
    """The registry as the pages have it: a standing for each mission, one of them active."""

    def __init__(self) -> None:
        self.registry: dict[str, Json] = {}
        self.beside: dict[tuple[str, int], str] = {}  # a next version that was handed in
        self.active: str | None = None
        self.answers: dict[tuple[str, int], list[Json]] = {}
        self.asked: dict[tuple[str, int], Json] = {}  # the action that each request is about
        self.spent_nonces: set[bytes] = set()
        self.stopped_ms = 0  # when an operator stopped the robot, and no resume came since
        self.halted_ms: dict[str, int] = {}  # when a mission was suspended last
        self.newest_ms: dict[object, int] = {}  # when the newest order about one was signed

    def hold(self, name: str, standing: Json, now_ms: int) -> None:
        """Hold a standing, and since when it is suspended."""
        was = self.registry.get(name, {}).get("status")
        if standing["status"] == "suspended" != was:
            self.halted_ms[name] = now_ms
        self.registry[name] = standing

    def stop(self, now_ms: int) -> None:
        """Let an operator's stop stand, and suspend what is active."""
        self.stopped_ms = now_ms
        if self.active is not None:
            standing = self.registry[self.active]
            event = "complete" if standing["status"] == "closing" else "suspend"
            self.hold(self.active, advanced(standing, event) or standing, now_ms)

    def _in_order(self, verb: str, name: str, more: Json, key: object) -> None:
        """Refuse an order that was signed before what it would undo; `key`: of which version."""
        if verb == "resolve":
            return
        over = [self.newest_ms.get(key, 0)]
        if verb == "resume":
            over += [self.stopped_ms, self.halted_ms.get(name, 0)]
        if more["issued_ms"] <= max(over):
            raise Refused("ORDER_TOO_OLD")

    def mission(self, name: str) -> Json:
        """Return the version that the registry has."""
        return plain_mission(name, self.registry[name]["version"])

    # standing.md, handing in

    def hand_in(self, name: str, version: int, now_ms: int) -> None:
        self.end_issued(now_ms)
        offered = plain_mission(name, version)
        if now_ms > instant_ms(offered["expiry"]):
            raise Refused("EXPIRED")
        known = self._lapsed(name, now_ms) if name in self.registry else None
        self._never_handed_in(name, version)
        fresh = fresh_standing(name, version)
        if known is None:
            if version != 1:
                raise Refused("MISSION_UNKNOWN")
            self.registry[name] = {**fresh, "status": "issued"}
            return
        self._require_next(known, version)
        self._update(known, fresh, offered)
        self.beside[name, version] = "issued"

    def end_issued(self, now_ms: int, of: str | None = None) -> None:
        """End what is issued and ended by itself; `of` one mission, or of every mission."""
        for name in NAMES if of is None else (of,):
            known = self.registry.get(name)
            if known is not None and known["status"] == "issued":
                known = self.registry[name] = self._lapsed(name, now_ms)
            for version in VERSIONS:
                if self.beside.get((name, version)) == "issued":
                    ended = self._ended_beside(name, version, now_ms)
                    self.beside[name, version] = ended or "issued"

    def _ended_beside(self, name: str, version: int, now_ms: int) -> str | None:
        known = self._lapsed(name, now_ms)
        if known["version"] >= version or known["status"] == "completed":
            return "superseded"
        if known["status"] in FINAL:
            return str(known["status"])
        is_over = now_ms > instant_ms(plain_mission(name, version)["expiry"])
        return "expired" if is_over else None

    def is_issued(self) -> bool:
        """True while a version of any mission is issued."""
        first = (standing["status"] for standing in self.registry.values())
        return "issued" in {*first, *self.beside.values()}

    def _never_handed_in(self, name: str, version: int) -> None:
        status = self.beside.get((name, version))
        if status is not None:
            raise Refused(STATUS_REFUSAL[status] or "TRANSITION_REFUSED")

    def _require_next(self, known: Json, version: int) -> None:
        if version <= known["version"]:
            raise Refused(STATUS_REFUSAL[known["status"]] or "TRANSITION_REFUSED")
        if version != known["version"] + 1:
            raise Refused("SUPERSEDED")

    # standing.md, activation

    def activate(self, name: str, version: int, now_ms: int) -> None:
        self.end_issued(now_ms)
        offered = plain_mission(name, version)
        if now_ms > instant_ms(offered["expiry"]):
            raise Refused("EXPIRED")
        held = None if self.active is None else self._lapsed(self.active, now_ms)
        if held is not None and held["status"] not in FINAL and self.active != name:
            raise Refused("TRANSITION_REFUSED")
        known = held if name == self.active else self.registry.get(name)
        fresh = fresh_standing(name, version)
        if self.beside.get((name, version)) != "issued":
            self._never_handed_in(name, version)
        if known is None:
            if version != 1:
                raise Refused("MISSION_UNKNOWN")
            standing = {**fresh, "status": "active"}
        elif (version, known["status"]) == (known["version"], "issued"):
            standing = {**known, "status": "active"}
        else:
            self._require_next(known, version)
            standing = self._update(known, fresh, offered)
        if self.stopped_ms or (known is not None and known["status"] == "suspended"):
            standing = {**standing, "status": "suspended"}
        if held is not None and self.active is not None:
            self.registry[self.active] = held
        self.hold(name, standing, now_ms)
        self.active = name
        self.beside.pop((name, version), None)
        self.end_issued(now_ms, name)

    def _lapsed(self, name: str, now_ms: int) -> Json:
        standing = self.registry[name]
        if standing["status"] in FINAL:
            return standing
        if now_ms > instant_ms(self.mission(name)["expiry"]):
            return {**standing, "status": "expired"}
        if standing["status"] == "closing" and now_ms > standing.get("closes_ms", 0):
            return {**standing, "status": "completed"}
        return standing

    def _update(self, known: Json, fresh: Json, offered: Json) -> Json:
        if advanced(known, "supersede") is None:
            raise Refused("TRANSITION_REFUSED")
        before = plain_mission(known["mid"], known["version"])
        for grant in offered["actions"]:
            same = [old for old in before["actions"] if old["id"] == grant["id"]]
            for old in same:
                kept = all(old[field] == grant[field] for field in ("type", "tool", "alternatives"))
                used = known.get("uses", {}).get(grant["id"], {}).get("starts", 0)
                if not kept or grant["starts"] < used:
                    raise Refused("TRANSITION_REFUSED")
        dies = ("requests", "selected", "closes_ms")
        carried = {field: value for field, value in known.items() if field not in dies}
        return {**carried, **fresh, "status": "active"}

    # standing.md, commands

    def command(
        self, verb: str, name: str, version: int, by: str, *, nonce: bytes, more: Json
    ) -> None:
        self.end_issued(more["now_ms"])
        if nonce in self.spent_nonces:
            raise Refused("EXPIRED")
        standing = self.registry.get(name)
        status = self.beside.get((name, version))
        if status is not None:
            standing = {**fresh_standing(name, version), "status": status}
        if standing is None or standing["version"] != version:
            raise Refused("MISSION_UNKNOWN")
        narrows = by == "safety-officer-1" and verb in {"suspend", "revoke"}
        if by != "operator-1" and not narrows:
            raise Refused("ROLE_DENIED")
        key = name if status is None else (name, version)
        self._in_order(verb, name, more, key)
        if status is not None or standing["status"] == "issued":
            if verb == "resolve" or advanced(standing, verb) is None:
                raise Refused("TRANSITION_REFUSED")
            self.newest_ms[key] = more["issued_ms"]
            self.spent_nonces.add(nonce)
            if status is None:
                self.registry[name] = {**standing, "status": "revoked"}
            else:
                self.beside[name, version] = "revoked"
            self.end_issued(more["now_ms"], name)
            return
        after: Json | None
        if verb == "resolve":
            after = self._resolved(standing, more)
        elif verb == "resume" and standing.get("open"):
            after = None
        elif verb == "suspend" and standing["status"] == "suspended":
            after = standing
            self.halted_ms[name] = max(self.halted_ms[name], more["now_ms"])
        else:
            after = advanced(standing, verb)
        if after is None:
            raise Refused("TRANSITION_REFUSED")
        self.spent_nonces.add(nonce)
        if verb != "resolve":
            self.newest_ms[name] = more["issued_ms"]
        if verb == "resume":
            self.stopped_ms = 0
        self.hold(name, self.finished(after, more["now_ms"]), more["now_ms"])
        if self.registry[name]["status"] in FINAL:
            self.active = None
            self.end_issued(more["now_ms"], name)

    def _resolved(self, standing: Json, more: Json) -> Json | None:
        opened = [item for item in standing.get("open", []) if item["ticket"] == more["ticket"]]
        if not opened:
            return None
        return oracle.settle(
            standing,
            plain_mission(standing["mid"], standing["version"]),
            ticket=more["ticket"],
            outcome=more["outcome"],
            used=opened[0]["reserved"],
        )

    def finished(self, standing: Json, now_ms: int) -> Json:
        """standing.md: complete when each completing grant has its successes; of this version."""
        of = plain_mission(standing["mid"], standing["version"])
        if standing["status"] != "active" or not oracle.is_complete(standing, of):
            return standing
        if of.get("closing") is None:
            return {**standing, "status": "completed"}
        return {
            **standing,
            "status": "closing",
            "closes_ms": now_ms + of["closing"]["for_ms"],
        }

    # standing.md, recovery

    def recover(self, *, unclean: bool, state: Json, now: Json) -> None:
        if self.active is None:
            return
        standing = self.registry[self.active]
        if not standing.get("open") and (not unclean or standing["status"] in FINAL):
            return
        of = self.mission(self.active)
        for release in standing.get("open", []):
            guards = grant_of(of, release["grant"]).get("done_when", [])
            if guards and all(guard_finding(guard, state, FACTS, now) == "" for guard in guards):
                standing = oracle.settle(
                    standing,
                    of,
                    ticket=release["ticket"],
                    outcome="succeeded",
                    used=release["reserved"],
                )
        if standing.get("open") or unclean:
            standing = advanced(standing, "suspend") or standing
        self.hold(self.active, self.finished(standing, now["utc_ms"]), now["utc_ms"])

    # approval.md and standing.md, release

    def propose(self, judged: Any) -> Json:
        """Decide, and change what a decision changes; labels and state are what the gate saw."""
        assert self.active is not None
        standing, of = self.registry[self.active], self.mission(self.active)
        now, action = plain(judged.now), plain(judged.action)
        seen: Json = {
            "state": {
                "snapshot": plain(judged.state.snapshot),
                "arrived_mono_ms": judged.state.arrived_mono_ms,
            },
            "facts": FACTS,
            "now": now,
        }
        decision = oracle.decide(
            of,
            digest=standing["digest"],
            usable_until_ms=judged.verified.issuer.usable_until_ms,
            action=action,
            standing=standing,
            approvals=[
                answer
                for request in standing.get("requests", {}).values()
                for answer in self.answers.get((self.active, request["counter"]), [])
            ],
            **seen,
        )
        grant = grant_of(of, decision["grant"])
        requests = standing.get("requests", {})
        others = {name: request for name, request in requests.items() if name != grant["id"]}
        if decision["verdict"] == "accept":
            spend = {"motion_ms": grant["max_ms"]} if action["type"] == "navigate" else {}
            standing = oracle.release(
                standing,
                grant["id"],
                ticket=judged.ticket,
                spend=spend,
                now=now,
                per_ms=of["budgets"]["rate"]["per_ms"],
            )
        elif decision["verdict"] == "request_approval":
            tier = tier_of(of["risk_policy"], decision["risk"])
            question = {
                "scope": scope_of(action),
                "situation": situation_of(of, grant, tier, **seen),
                "required": decision["required"],
            }
            known = requests.get(grant["id"], {})
            if any(known.get(field) != question[field] for field in ("scope", "situation")):
                counter = standing.get("counter", 0) + 1
                self.asked[self.active, counter] = action
                until = now["utc_ms"] + of["risk_policy"]["valid_ms"]
                asked = {**question, "counter": counter, "expires_ms": until}
                standing = {
                    **standing,
                    "requests": {**others, grant["id"]: asked},
                    "counter": counter,
                    "prompts": standing.get("prompts", 0) + 1,
                }
        else:
            if {"APPROVAL_DENIED", "APPROVAL_TIMEOUT"} & {*decision["reasons"]}:
                standing = {**standing, "requests": others}
            if now["utc_ms"] > instant_ms(of["expiry"]):
                standing = advanced(standing, "expire") or standing
        self.registry[self.active] = standing
        return decision

    def answer(self, given: Json, now: Json) -> None:
        """Keep an answer to an open request; a denial that fits closes it (approval.md)."""
        said = given["approval"]
        named = said["mid"], said["counter"]
        self.answers.setdefault(named, []).append(given)
        standing = self.registry[said["mid"]]
        request = standing["requests"][said["grant"]]
        if said["verdict"] != "deny" or self.active != said["mid"]:
            return
        of, expected = self.mission(said["mid"]), {"rid": scenarios.RID, "counter": named[1]}
        seen: Json = {"policies": [of["risk_policy"]], "action": self.asked[named], "now": now}
        if now["utc_ms"] <= request["expires_ms"] and fits(given, expected, of, **seen):
            requests = {**standing["requests"], said["grant"]: {**request, "denied": True}}
            self.registry[said["mid"]] = {**standing, "requests": requests}

    def settle(self, name: str, ticket: str, outcome: str, used: Json, now_ms: int) -> None:
        standing = self.registry[name]
        of = plain_mission(name, standing["version"])
        after = oracle.settle(standing, of, ticket=ticket, outcome=outcome, used=used)
        self.registry[name] = self.finished(after, now_ms)


class Life(RuleBasedStateMachine):
    """One robot, two missions of three versions each, and everybody who has a say."""

    def __init__(self) -> None:
        super().__init__()
        self.here, self.model = Station(), Model()
        self.running: Running | None = None
        self.first = True
        self.old: list[tuple[bytes, Any]] = []

    def now_ms(self) -> int:
        return self.here.robot.wall_ms()

    def ordered(self, act: Callable[[], object], expected: Callable[[], None]) -> None:
        """Give an order to both; they say the same."""
        try:
            expected()
            wanted = None
        except Refused as refused:
            wanted = str(refused)
        try:
            act()
            got = None
        except AuthGuardError as error:
            got = str(error.reason)
        assert got == wanted

    # authority

    @initialize()
    def somebody_begins(self) -> None:
        self.activate("one", 1)

    @rule(name=st.sampled_from(NAMES))
    def activate_the_first(self, name: str) -> None:
        self.activate(name, 1)

    @rule(name=st.sampled_from(NAMES), version=st.sampled_from(VERSIONS))
    def activate(self, name: str, version: int) -> None:
        now = self.now_ms()
        self.ordered(
            lambda: self.here.gate.management.activate(token(name, version)),
            lambda: self.model.activate(name, version, now),
        )

    @rule(name=st.sampled_from(NAMES), version=st.sampled_from([1, 2, 2, 3]))
    def hand_in(self, name: str, version: int) -> None:
        now = self.now_ms()
        self.ordered(
            lambda: self.here.gate.management.issue(token(name, version)),
            lambda: self.model.hand_in(name, version, now),
        )

    @precondition(lambda self: self.model.beside)
    @rule(
        verb=st.sampled_from(["revoke", "suspend", "complete"]),
        by=st.sampled_from(["operator-1", "safety-officer-1", "operator-2"]),
        pick=st.integers(0, 9),
    )
    def command_a_version_beside(self, verb: str, by: str, pick: int) -> None:
        name, version = sorted(self.model.beside)[pick % len(self.model.beside)]
        self._order(verb, name, version, by, {})

    @precondition(lambda self: self.model.active is not None)
    @rule()
    def supersede(self) -> None:
        name = str(self.model.active)
        version = self.model.registry[name]["version"] + 1
        if version in VERSIONS:
            self.activate(name, version)

    @precondition(lambda self: self.model.registry)
    @rule(
        verb=st.sampled_from(["resume"] * 6 + ["suspend"] * 3 + ["complete", "revoke"]),
        by=st.sampled_from(["operator-1"] * 4 + ["safety-officer-1", "operator-2"]),
        stale=st.booleans(),
        pick=st.integers(0, 9),
    )
    def command(self, verb: str, by: str, stale: bool, pick: int) -> None:
        name = sorted(self.model.registry)[pick % len(self.model.registry)]
        version = self.model.registry[name]["version"]
        if stale and version > 1:
            version -= 1
        self._order(verb, name, version, by, {})

    def _order(self, verb: str, name: str, version: int, by: str, more: Json) -> None:
        issued_ms = self.now_ms() + len(self.old) + 1  # one after the other
        signed = {**more, "issued_ms": issued_ms}
        made = self.here.order(mission(name, version), Verb(verb), by, **signed)
        more = {**signed, "now_ms": self.now_ms()}
        self.old.append((made, (verb, name, version, by, more)))
        self._give(made, verb, name, version, by, more)

    def _give(self, made: bytes, verb: str, name: str, version: int, by: str, more: Json) -> None:
        self.ordered(
            lambda: self.here.gate.management.command(made),
            lambda: self.model.command(verb, name, version, by, nonce=made, more=more),
        )

    @precondition(lambda self: self.old)
    @rule(pick=st.integers(0, 99))
    def an_old_order_again(self, pick: int) -> None:
        made, (verb, name, version, by, more) = self.old[pick % len(self.old)]
        if self.now_ms() <= more["now_ms"] + 600_000:
            self._give(made, verb, name, version, by, {**more, "now_ms": self.now_ms()})

    @precondition(lambda self: self._status() == "suspended")
    @rule()
    def the_issuer_lets_it_go_on(self) -> None:
        standing = self.model.registry[str(self.model.active)]
        for release in standing.get("open", []):
            if self.running is None:
                more = {"ticket": release["ticket"], "outcome": "failed"}
                self._order("resolve", standing["mid"], standing["version"], "operator-1", more)
        self._order("resume", standing["mid"], standing["version"], "operator-1", {})

    def _status(self) -> str:
        active = self.model.active
        return "" if active is None else str(self.model.registry[active]["status"])

    @precondition(lambda self: any(s.get("open") for s in self.model.registry.values()))
    @rule(outcome=st.sampled_from(["succeeded", "failed", "not_started"]))
    def resolve(self, outcome: str) -> None:
        if self.running is not None:
            return
        standing = next(s for s in self.model.registry.values() if s.get("open"))
        more = {"ticket": standing["open"][0]["ticket"], "outcome": outcome}
        self._order("resolve", standing["mid"], standing["version"], "operator-1", more)

    # what is proposed and answered

    @rule(name=st.sampled_from(sorted(ACTIONS)), then=st.sampled_from(["ends", "ends", "runs"]))
    def propose(self, name: str, then: str) -> None:
        begun = self.here.submit(ACTIONS[name])
        if self.first:
            self._recover(unclean=False)
            self.first = False
        report = begun if isinstance(begun, Report) else begun.report
        if report.judged is None:
            assert self.model.active is None
            why = "MISSION_NOT_ACTIVE" if self.model.is_issued() else "NO_ACTIVE_MISSION"
            assert str(report.refusal.reason) == why  # type: ignore[union-attr]
            return
        expected = self.model.propose(report.judged)
        decision = report.judged.decision
        reasons = [str(reason) for reason in decision.reasons]
        assert (str(decision.verdict), reasons) == (expected["verdict"], expected["reasons"])
        if expected["verdict"] != "accept":
            return
        assert report.judged.released, report.judged.safety
        if isinstance(begun, Running):
            self.running = begun
            if then == "ends":
                self.it_runs_to_its_end()
        else:  # the controller was busy
            assert str(report.outcome) == "not_started"
            self._settled(report, {})

    @precondition(lambda self: self._status() in {"active", "closing"})
    @rule(
        name=st.sampled_from(["elevated", "high", "high, faster"]),
        between=st.sampled_from(["", "", "", "late", "restart", "one fewer", "denied"]),
        then=st.sampled_from(["ends", "runs"]),
    )
    def propose_and_be_approved(self, name: str, between: str, then: str) -> None:
        """Ask, let everybody answer who is needed, and propose again."""
        self.propose(name, then)
        standing = self.model.registry.get(str(self.model.active), {})
        for _, request in sorted(standing.get("requests", {}).items()):
            people = APPROVERS[: request["required"] - 1 - (between == "one fewer")]
            for person in people:
                self._answer(standing, request, person, ApprovalVerdict.APPROVE)
            if between == "denied":
                self._answer(standing, request, APPROVERS[2], ApprovalVerdict.DENY)
        if between == "late" and self.running is None:
            self.here.jump(121_000)
        if between == "restart":
            self.the_gate_is_restarted()
        self.propose(name, then)

    def _settled(self, report: Report, used: Json) -> None:
        judged = report.judged
        assert judged is not None
        name, outcome = judged.verified.mission.mid, str(report.outcome)
        self.model.settle(name, judged.ticket, outcome, used, self.now_ms())

    @precondition(lambda self: self.running is not None)
    @rule()
    def it_runs_to_its_end(self) -> None:
        assert self.running is not None
        running, self.running = self.running, None
        self._end(running, lambda: self.here.finish(running))

    @precondition(lambda self: self.running is not None)
    @rule()
    def it_is_stopped(self) -> None:
        assert self.running is not None
        running, self.running = self.running, None
        self._end(running, lambda: self.here.abort(running))

    def _end(self, running: Running, end: Callable[[], Report]) -> None:
        judged = running.report.judged
        assert judged is not None
        standing = self.model.registry[judged.verified.mission.mid]
        lasts = standing["digest"] == judged.verified.digest
        lasts = lasts and standing["status"] in {"active", "closing"}
        over = running._handle.outcome() is not None
        report = end()
        if not lasts and not over:
            assert str(report.outcome) == "aborted"
        # `finish` has put the robot back since: it took one more tick than the outcome
        judged_at = self.here.gate.ledger.standing(judged.verified.mission.mid)
        assert judged_at is not None
        self._settled_at(report, plain(running._handle.used()), judged_at.closes_ms)

    def _settled_at(self, report: Report, used: Json, closes_ms: int) -> None:
        """The outcome's own instant is not told; where it matters, `closes_ms` has to fit it."""
        before = self.model.registry[report.judged.verified.mission.mid]  # type: ignore[union-attr]
        self._settled(report, used)
        after = self.model.registry[before["mid"]]
        if after["status"] == "closing" and before["status"] != "closing":
            assert 0 <= after["closes_ms"] - closes_ms <= 200
            after["closes_ms"] = closes_ms

    @precondition(lambda self: self.running is not None)
    @rule(seconds=st.sampled_from([1, 10, 100]))
    def it_goes_on_and_nobody_looks(self, seconds: int) -> None:
        self.here.robot.pause(seconds * 1_000)

    @precondition(lambda self: any(s.get("requests") for s in self.model.registry.values()))
    @rule(
        by=st.sampled_from([*APPROVERS, *APPROVERS, "operator-1", "operator-2"]),
        verdict=st.sampled_from([ApprovalVerdict.APPROVE] * 4 + [ApprovalVerdict.DENY]),
        pick=st.integers(0, 9),
    )
    def answer(self, by: str, verdict: ApprovalVerdict, pick: int) -> None:
        asking = [
            (standing, request)
            for standing in self.model.registry.values()
            for _, request in sorted(standing.get("requests", {}).items())
        ]
        self._answer(*asking[pick % len(asking)], by, verdict)

    def _answer(self, standing: Json, request: Json, by: str, verdict: ApprovalVerdict) -> None:
        grant = next(name for name, known in standing["requests"].items() if known == request)
        value = Approval(
            mid=standing["mid"],
            version=standing["version"],
            mission=standing["digest"],
            rid=scenarios.RID,
            grant=grant,
            scope=request["scope"],
            situation=request["situation"],
            counter=request["counter"],
            expires_ms=request["expires_ms"],
            verdict=verdict,
        )
        made = sign_object(value, Tag.APPROVAL, signer(by))
        item = self.here.gate.management.approve(made)
        self.model.answer(plain(item), {"utc_ms": self.now_ms()})

    # the world and the gate

    @precondition(lambda self: self.running is None)
    @rule(seconds=st.sampled_from([1, 12, 12, 12, 121, 121, 601, 1_300]))
    def time_passes(self, seconds: int) -> None:
        self.here.jump(seconds * 1_000)

    @rule()
    def the_gate_is_restarted(self) -> None:
        self.running = None
        self.here.restart()
        self._begun(unclean=False)

    @rule()
    def the_gate_is_killed(self) -> None:
        self.running = None
        self.here.kill()
        self._begun(unclean=True)

    def _begun(self, *, unclean: bool) -> None:
        assert self.here.unclean is unclean
        self.first = True
        self._recover(unclean=unclean)

    def _recover(self, *, unclean: bool) -> None:
        state = self.here.gate.enforcer.inputs.state
        assert state is not None
        now = {"utc_ms": self.now_ms(), "mono_ms": self.here.gate.ledger.mono_ms()}
        snapshot = {"snapshot": plain(state.snapshot), "arrived_mono_ms": state.arrived_mono_ms}
        self.model.recover(unclean=unclean, state=snapshot, now=now)

    @rule()
    def an_operator_stops_the_robot(self) -> None:
        self.here.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)  # type: ignore[arg-type]
        if self.running is not None:
            self.it_is_stopped_already()
        self.model.stop(self.now_ms())

    def it_is_stopped_already(self) -> None:
        """What was stopped is settled after the suspension; the order makes no difference here."""
        running, self.running = self.running, None
        assert running is not None
        name = running.report.judged.verified.mission.mid  # type: ignore[union-attr]
        standing = self.model.registry[name]
        if name == self.model.active:
            event = "complete" if standing["status"] == "closing" else "suspend"
            self.model.hold(name, advanced(standing, event) or standing, self.now_ms())
        report = self.here.abort(running)
        self._settled(report, plain(running._handle.used()))

    @invariant()
    def both_hold_the_same(self) -> None:
        for name in NAMES:
            standing = self.here.standing(name)
            held = None if standing is None else tidy(plain(standing))
            wanted = self.model.registry.get(name)
            assert held == (None if wanted is None else tidy(wanted))
        for (name, version), status in self.model.beside.items():
            assert self.here.gate.ledger.run(partial(status_of, name, version)) == status


QUICK = settings(
    max_examples=60,
    stateful_step_count=40,
    database=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
Life.TestCase.settings = QUICK
TestLife = Life.TestCase


def test_an_outcome_of_the_version_before_is_held_to_the_version_in_force() -> None:
    """It ended before anybody looked; the next version wants one more of it before it is done."""
    life = Life()
    life.somebody_begins()
    life.propose("done", "runs")
    life.it_goes_on_and_nobody_looks(100)
    life.activate("one", 2)
    life.it_runs_to_its_end()
    life.both_hold_the_same()
    assert life._status() == "active"
    life.propose("done", "ends")
    life.both_hold_the_same()
    assert life._status() == "closing"


def test_a_mission_that_is_activated_under_an_operators_stop_is_suspended() -> None:
    life = Life()
    life.somebody_begins()
    life.an_operator_stops_the_robot()
    life.command("complete", "operator-1", stale=False, pick=0)
    life.activate("two", 1)
    life.both_hold_the_same()
    assert life.model.registry["two"]["status"] == "suspended"
    life.here.jump(50)
    life.command("resume", "operator-1", stale=False, pick=1)
    life.both_hold_the_same()
    assert life.model.registry["two"]["status"] == "active"


def revoke(bench: Bench, scene: BenchScene, name: str) -> None:
    """Revoke a principal, and let the gate have the new list."""
    leaf = x509.load_der_x509_certificate(folder_signer(bench.folder, name).chain[0])
    authority = read_authority(bench.folder, "people")
    at = datetime.fromtimestamp(scene.sim.robot.wall_ms() / 1_000, UTC)
    serials = (leaf.serial_number,)
    write_revocations(
        bench.folder, "people", authority.key, serials=serials, now=at, number=2, days=30
    )
    scene.sim.gate.lists.install((bench.folder / "revocations" / "people.json").read_bytes())


def test_an_outcome_under_a_version_whose_signer_was_revoked_completes_nothing(
    tmp_path: Path,
) -> None:
    """It is recorded and counts; whether all is done, nobody can say any more."""
    bench = make_bench(tmp_path / "trust")
    scene = BenchScene(sim=bench.simulation(), mission=mission("one", 1), plan=b"")
    gate, robot = scene.sim.gate, scene.sim.robot
    gate.management.activate(bench.sign(mission("one", 1)))
    running = gate.enforcer.submit(
        Step(action=ACTIONS["done"], attested=()),
        planner=Identifier("planner"),
        evidence=Digest(b64(bytes(32))),
        context=scene.sim.binder.context(),
    )
    assert isinstance(running, Running)
    robot.pause(10_000)
    gate.management.activate(bench.sign(mission("one", 2)))
    revoke(bench, scene, "operator-1")
    report = running.poll()
    assert report is not None
    assert (str(report.outcome), report.outcome_recorded) == ("succeeded", True)
    standing = gate.management.standing(mission("one", 1).mid)
    assert standing is not None
    assert (standing.status, standing.uses["done"].successes) == ("active", 1)


def test_a_proposal_after_the_end_expires_the_mission_whatever_else_ran_out() -> None:
    """The question is closed and the mission is expired, by one refusal."""
    life = Life()
    life.somebody_begins()
    life.propose("high", "ends")
    life.time_passes(41 * 60)
    life.propose("high", "ends")
    life.both_hold_the_same()
    standing = life.model.registry["one"]
    assert (standing["status"], standing.get("requests", {})) == ("expired", {})


class _Long(Life):
    pass


@pytest.mark.nightly
def test_a_long_campaign_of_lives() -> None:
    _Long.TestCase.settings = settings(
        QUICK, max_examples=3_000, stateful_step_count=80, derandomize=False
    )
    _Long.TestCase("runTest").runTest()
