# SPDX-License-Identifier: Apache-2.0
"""ReplayGame: a mission that ended, its token, its actions and a restart; it stays ended.

Then an adversary who keeps every token, answer, choice, order, snapshot and key, and gives all of
it again after every step, across restarts, crashes, every ending and a store that was put back.

Source: section "Replay Game", theorem "Replay resistance".
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from authguard_r.approvals import Selection, answer
from authguard_r.core.action import Action
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of, unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest, GrantId, Identifier, MissionId
from authguard_r.core.lifecycle import TERMINAL, TRANSITIONS, Event, Status
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Command, StoreClaim, Verb
from authguard_r.server import proposals as proposals_module
from authguard_r.server.proposals import CommitRecorder, ProposalRecord, ProposalRegistry
from authguard_r.store.memory import MemoryStore
from authguard_r.store.transactions import Ledger, Transaction
from authguard_r.wire.disclosure import Disclosure
from fixtures import scenarios
from fixtures.restarting_gate import Station, copied, go, signer, way
from missionpair.ablation import without

ENDINGS = {Verb.REVOKE: "REVOKED", Verb.COMPLETE: "MISSION_COMPLETED"}


def command(verb: Verb, nonce: str, *, by: str = "operator-1") -> bytes:
    mission = scenarios.mission()
    value = Command(
        verb=verb,
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        nonce=b64(nonce.encode()),
        expires_ms=scenarios.START_MS + 600_000,
        issued_ms=scenarios.START_MS + ord(nonce[0]),  # one after the other, by their letters
    )
    return sign_object(value, Tag.COMMAND, scenarios.folder_signer(scenarios.trust_folder(), by))


def verb_of(token: bytes) -> Verb:
    """Return what a signed command orders."""
    return Verb(json.loads(unb64(json.loads(token)["payload"]))["verb"])


@pytest.mark.parametrize("verb", sorted(ENDINGS))
def test_a_mission_that_ended_is_never_accepted_again_not_even_after_a_restart(
    verb: Verb, tmp_path: Path
) -> None:
    sim = scenarios.simulation(store=tmp_path / "robot.db")
    sim.gate.management.activate(scenarios.token())
    first = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert first.outcome == "succeeded"
    sim.gate.management.command(command(verb, "end"))
    for round_ in range(2):
        with pytest.raises(AuthGuardError) as refused:
            sim.gate.management.activate(scenarios.token())
        assert str(refused.value.reason) == ENDINGS[verb]
        again = scenarios.propose(sim, scenarios.navigate("pharmacy", "station-101"))
        assert again.outcome is None
        assert len(sim.robot.trace) == (1 if round_ == 0 else 0)
        sim.gate.close()
        sim = scenarios.simulation(
            store=tmp_path / "robot.db",
            start=scenarios.world("pharmacy"),
            start_ms=scenarios.START_MS + 120_000,
        )
    sim.gate.close()


def test_a_one_time_action_is_used_up() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    sim.robot.state = scenarios.world("dock")
    sim.robot.pause(100)
    again = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert again.outcome is None
    assert [str(r) for r in again.judged.decision.reasons] == ["REPEAT_EXHAUSTED"]


def test_a_command_is_carried_out_once_and_only_for_who_may_give_it() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        sim.gate.management.command(command(Verb.REVOKE, "a", by="operator-2"))
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        sim.gate.management.command(command(Verb.COMPLETE, "b", by="safety-officer-1"))
    sim.gate.management.command(command(Verb.SUSPEND, "c", by="safety-officer-1"))
    with pytest.raises(AuthGuardError, match="EXPIRED"):
        sim.gate.management.command(command(Verb.SUSPEND, "c", by="safety-officer-1"))
    sim.gate.management.command(command(Verb.RESUME, "d"))
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome == "succeeded"


def test_no_event_leads_out_of_a_terminal_status() -> None:
    assert not [pair for pair in TRANSITIONS if pair[0] in TERMINAL]
    assert {Status.COMPLETED, Status.REVOKED, Status.EXPIRED, Status.SUPERSEDED} == TERMINAL
    assert {event for _, event in TRANSITIONS} == set(Event)


# an adversary who keeps everything and gives it again at every step


class Outside:
    """A counter that outlives stores."""

    def __init__(self) -> None:
        self.note: bytes | None = None

    def read(self) -> bytes | None:
        return self.note

    def write(self, note: bytes) -> None:
        self.note = note


@cache
def once(version: int = 1) -> Mission:
    """Return a mission of which everything may be done once."""
    drafted = scenarios.draft()
    grant = {**drafted["grants"][0], "until": [], "repeat": 1, "starts": 2}
    scan = next(g for g in drafted["grants"] if g["id"] == "look-out")
    two = [way("station-101"), way("station-103")]
    changes: dict[str, Any] = {
        "grants": [
            {**grant, "id": "easy", "rows": [way("pharmacy")]},
            {**grant, "id": "risky", "rows": [way("isolation-room")]},
            {**grant, "id": "chosen", "rows": two, "chooser": "operator"},
            {**scan, "id": "done", "repeat": 1, "starts": 2, "completes": True},
        ],
        "closing": None,
        "version": version,
    }
    if version > 1:
        changes["supersedes"] = digest_of(Tag.MISSION, once(version - 1))
    return scenarios.mission(**changes)


SCAN = Action(type="scan_obstacles", tool="lidar", params={})
CLIENT, EVIDENCE = Identifier("planner"), Digest(b64(bytes(32)))


class Replayer:
    """Keeps every signed byte and every key, and hands all of it in again."""

    def __init__(self, *, counter: Outside | None = None) -> None:
        self.here = Station(counter=counter)
        self.kept: list[tuple[str, bytes]] = []
        self.keys: list[str] = []
        self.used: list[Action] = []
        self.reasons: set[str] = set()

    def give(self, what: str, token: bytes) -> None:
        management = self.here.gate.management
        verbs: dict[str, Callable[[bytes], object]] = {
            "mission": management.activate,
            "command": management.command,
            "selection": management.select,
            "approval": management.approve,
        }
        verbs[what](token)

    def first(self, what: str, token: bytes) -> None:
        """Give what was just signed, and keep it."""
        self.give(what, token)
        self.kept.append((what, token))

    def sees(self) -> None:
        """Keep the estimator's newest word, after the gate has had it."""
        self.here.gate.enforcer.inputs.refresh()
        seen = self.here.robot.latest()
        assert seen is not None
        self.kept.append(("snapshot", seen))

    def order(self, verb: Verb) -> None:
        standing = self.here.standing("deliver-p1")
        assert standing is not None
        self.first("command", self.here.order(once(standing.version), verb))

    def does(self, action: Action) -> str:
        """Propose under a key of its own; what was used up is kept to be proposed again."""
        key = f"k{len(self.keys)}"
        before = ProposalRecord(evidence=EVIDENCE, planned=1, steps=())
        begun = self.here.submit(action, on_commit=CommitRecorder(CLIENT, key, before))
        if isinstance(begun, Report):
            return str(begun.judged.decision.reasons[0])  # type: ignore[union-attr]
        self.keys.append(key)
        report = self.here.finish(begun)
        self.used.append(action)
        return str(report.outcome)

    def approved(self, action: Action) -> str:
        assert self.does(action) == "APPROVAL_REQUIRED"
        standing = self.here.standing("deliver-p1")
        assert standing is not None
        verified = self.here.gate.ledger.run(self.here.gate.enforcer.inputs.active_mission)
        ((grant, request),) = standing.requests.items()
        value = answer(verified, grant, request, rid=scenarios.RID, verdict=ApprovalVerdict.APPROVE)
        self.first("approval", sign_object(value, Tag.APPROVAL, signer("supervisor-1")))
        return self.does(action)

    def choose(self, row: int) -> None:
        standing = self.here.standing("deliver-p1")
        assert standing is not None
        value = Selection(
            mid=standing.mid,
            version=standing.version,
            mission=standing.digest,
            grant=GrantId("chosen"),
            row=row,
            nonce=b64(b"choice" + bytes([row])),
            expires_ms=self.here.robot.wall_ms() + 600_000,
            issued_ms=self.here.robot.wall_ms() + 1 + len(self.kept),
        )
        self.first("selection", sign_object(value, Tag.SELECTION, signer("operator-1")))

    def replay(self) -> list[str]:
        """Give everything again, forwards and backwards; return what got through."""
        through = [what for kept in (self.kept, self.kept[::-1]) for what in self._again(kept)]
        return through + self._keys_again() + self._actions_again()

    def _again(self, kept: list[tuple[str, bytes]]) -> list[str]:
        through: list[str] = []
        for what, token in kept:
            before = self._everything()
            if what == "snapshot":
                reason = self._state_again(token)
            else:
                try:
                    self.give(what, token)
                    # an answer to a question that is over is kept with the log, and is no answer
                    reason = "APPROVAL_TIMEOUT" if what == "approval" else ""
                except AuthGuardError as error:
                    reason = str(error.reason)
            self.reasons.add(reason)
            # a stop is never refused: to suspend what is suspended changes nothing
            refused = reason or (what == "command" and verb_of(token) is Verb.SUSPEND)
            if not refused or self._everything() != before:
                through.append(what)
        return through

    def _everything(self) -> tuple[Any, ...]:
        act = self.here.gate.ledger.run(lambda act: (act.standing("deliver-p1"), act.active()))  # type: ignore[arg-type]
        return (*act, len(self.here.robot.trace))

    def _state_again(self, token: bytes) -> str:
        """Hand an old snapshot in for the newest; the one that the gate has stays."""
        inputs, robot = self.here.gate.enforcer.inputs, self.here.robot
        inputs.refresh()
        held, own = inputs.newest, robot._token
        robot._token = token
        try:
            inputs.refresh()
            same = token == inputs._held and inputs.newest is held
            return "STATE_REPLAYED" if same or self._stale(inputs, held) else ""
        finally:
            robot._token = own
            robot.pause(100)

    @staticmethod
    def _stale(inputs: Any, held: Any) -> bool:
        fault = inputs.fault
        return inputs.newest is held and fault is not None and fault.reason == "STATE_REPLAYED"

    def _keys_again(self) -> list[str]:
        """Ask with every key again: the same answer, nothing decided; another plan is refused."""
        proposals = ProposalRegistry(self.here.gate.ledger, Disclosure.FULL)
        through = []
        for key in self.keys:
            known = proposals.recall(CLIENT, key, EVIDENCE)
            if known is None or len(known.steps) != 1:
                through.append("key")
                continue
            with pytest.raises(AuthGuardError, match="KEY_REUSED"):
                proposals.recall(CLIENT, key, Digest(b64(bytes([1] * 32))))
        return through

    def _actions_again(self) -> list[str]:
        through = []
        for action in self.used:
            begun = self.here.submit(action)
            if not isinstance(begun, Report):
                through.append("action")
                self.here.abort(begun)
            elif begun.judged is not None:
                assert begun.judged.decision.reasons != ()
            else:
                assert begun.refusal is not None
        return through


def story(game: Replayer) -> Iterator[str]:
    """A mission's life up to its last action; yield after every step."""
    game.first("mission", game.here.token(once()))
    yield "activated"
    assert game.does(go("pharmacy")) == "succeeded"
    game.sees()
    yield "one done"
    game.order(Verb.SUSPEND)
    yield "suspended"
    game.order(Verb.RESUME)
    yield "resumed"
    assert game.approved(go("isolation-room")) == "succeeded"
    yield "approved"
    game.choose(1)
    game.choose(0)
    yield "chosen"
    assert game.does(go("station-101")) == "succeeded"
    game.sees()
    yield "all but the last"


def revoked(game: Replayer) -> str:
    game.order(Verb.REVOKE)
    return "REVOKED"


def completed_by_order(game: Replayer) -> str:
    game.order(Verb.COMPLETE)
    return "MISSION_COMPLETED"


def completed(game: Replayer) -> str:
    assert game.does(SCAN) == "succeeded"
    return "MISSION_COMPLETED"


def expired(game: Replayer) -> str:
    game.here.jump(3_600_000)
    assert game.does(SCAN) == "EXPIRED"
    return "EXPIRED"


def superseded(game: Replayer) -> str:
    game.first("mission", game.here.token(once(2)))
    return "TRANSITION_REFUSED"


LAST = {end.__name__: end for end in (revoked, completed_by_order, completed, expired, superseded)}
AGAIN: dict[str, Callable[[Replayer], None]] = {
    "at once": lambda _: None,
    "after a restart": lambda game: game.here.restart(),
    "after a crash": lambda game: game.here.kill(),
}


@pytest.mark.parametrize("again", AGAIN)
@pytest.mark.parametrize("ending", LAST)
def test_nothing_that_was_kept_works_a_second_time(ending: str, again: str) -> None:
    game = Replayer(counter=Outside())
    for step in story(game):
        if again == "after a restart":
            game.here.restart()
        assert game.replay() == [], step
    reason = LAST[ending](game)
    AGAIN[again](game)
    for _ in range(2):
        assert game.replay() == []
    assert reason in game.reasons
    assert "EXPIRED" in game.reasons  # every order has its nonce
    standing = game.here.standing("deliver-p1")
    assert standing is not None
    assert {name: use.starts for name, use in standing.uses.items() if name != "done"} == {
        "easy": 1,
        "risky": 1,
        "chosen": 1,
    }
    assert standing.requests == {}


def accept(game: Replayer) -> bytes:
    """Return the signed order to go on with the store as it lies there."""
    rows = game.here.store.rows()
    number = game.here.gate.anchor.number
    claim = StoreClaim(
        store=Digest(b64(rows[0].link)),
        size=len(rows),
        head=Digest(b64(rows[-1].link)),
        number=number,
    )
    value = Command(
        verb=Verb.ACCEPT_STORE,
        mid=MissionId(str(scenarios.RID)),
        version=1,
        mission=claim.store,
        nonce=b64(b"accept-the-store"),
        expires_ms=game.here.robot.wall_ms() + 120_000,
        accepts=claim,
    )
    return sign_object(value, Tag.COMMAND, signer("operator-1"))


@pytest.mark.parametrize("step", ["activated", "one done", "resumed", "approved", "chosen"])
def test_a_store_that_was_put_back_brings_nothing_back(step: str) -> None:
    game, copy = Replayer(counter=Outside()), None
    for name in story(game):
        if name == step:
            game.here.restart()  # counts
            copy = copied(game.here.store)
    game.here.restart()
    assert copy is not None
    game.here.store = copy
    game.here.kill()
    for what, token in game.kept:
        if what != "snapshot":
            with pytest.raises(AuthGuardError, match="ROLLED_BACK"):
                game.give(what, token)
    assert game.here.submit(SCAN).refusal.reason is Reason.ROLLED_BACK  # type: ignore[union-attr]
    order = accept(game)
    game.here.gate.management.accept_store(order)
    with pytest.raises(AuthGuardError, match=r"EXPIRED|ROLLED_BACK"):
        game.here.gate.management.accept_store(order)
    game.used = []  # what is lost nobody knows; nothing is released before a new `resume`
    game.keys = []
    for again in AGAIN.values():
        again(game)
        assert game.replay() == []
    assert game.does(go("pharmacy")) == "MISSION_SUSPENDED"
    assert game.here.robot.trace == []


# what each part is worth: without it, a replay gets through


def no_nonces() -> Any:
    """Forget what was carried out, and when the newest order was signed: either stops a replay."""
    real, gone = Transaction.get, {"command", "order", "suspended"}
    return patch.object(
        Transaction, "get", lambda self, kind, key: None if kind in gone else real(self, kind, key)
    )


def no_registry() -> Any:
    return patch.object(Transaction, "standing", lambda *_: None)


def no_last_snapshot() -> Any:
    nothing = property(lambda _: (-1, -1), lambda *_: None)
    return patch.object(Ledger, "snapshot", nothing, create=True)


CONTROLS: dict[str, tuple[Callable[[], Any], str]] = {
    "nonces": (no_nonces, "command"),
    "nonces of choices": (no_nonces, "selection"),
    "the registry": (no_registry, "mission"),
    "the last snapshot": (no_last_snapshot, "snapshot"),
    "uses": (lambda: without("check_uses"), "action"),
    "keys": (
        lambda: patch.object(proposals_module.ProposalRegistry, "_told", lambda *_: None),
        "key",
    ),
}


@pytest.mark.parametrize("name", CONTROLS)
def test_without_one_part_a_replay_gets_through(name: str) -> None:
    game = Replayer()
    for _ in story(game):
        pass
    assert game.replay() == []
    out, through = CONTROLS[name]
    with out():
        assert through in game.replay()


def test_a_store_that_is_not_kept_forgets_it_all_and_the_counter_says_so() -> None:
    """What lies in memory only is gone with the gate (L14)."""
    game = Replayer()
    for _ in story(game):
        pass
    game.here.store = MemoryStore()
    game.here.kill()
    assert "mission" in game.replay()
    counted = Replayer(counter=Outside())
    for _ in story(counted):
        pass
    counted.here.restart()
    counted.here.store = MemoryStore()
    counted.here.kill()
    with pytest.raises(AuthGuardError, match="ROLLED_BACK"):
        counted.give("mission", counted.here.token(once()))
