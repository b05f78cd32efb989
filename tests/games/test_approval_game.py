# SPDX-License-Identifier: Apache-2.0
"""ApprovalGame: fewer keys than people are needed, and every approval that was ever signed.

The adversary has the issuer's key, those of t - 2 approvers, and of people whose answer does not
count; honest people sign for it whatever it asks, but for the one tuple in question. It may alter,
replay and reorder, end and kill the gate. It wins when a risky action is released without the
people it needs. Each condition is then taken out by itself: without it, the adversary wins.
Source: theorem "High-risk approval"; the game is ours (docs/spec/approval.md#the-game).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from random import Random
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import msgspec
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from authguard_r.approvals import open_approval
from authguard_r.approvals.preapprovals import VerifiedApprovals
from authguard_r.core import decide as gate
from authguard_r.core.action import Action, ActionScope
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.checks import approval as check
from authguard_r.core.checks.people import people_behind
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission
from authguard_r.core.token import read_token, sign_object
from authguard_r.enforcement import enforcer
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.management import answers
from authguard_r.enforcement.report import Report
from authguard_r.keys import trust as keys
from authguard_r.keys.algorithms import PrivateKey
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import FileSigner, open_key_file
from authguard_reference.approval import scope_of, situation_of
from authguard_reference.risk import rho
from fixtures import approvals, scenarios
from fixtures.amount import amount
from fixtures.decision_cases import plain, plain_facts
from fixtures.restarting_gate import Station, go, trust, way

replace = msgspec.structs.replace
FACTS = scenarios.facts()
FACTS_PLAIN = plain_facts(FACTS)
OTHER_DIGEST = Digest(b64(bytes([7] * 32)))
#: The highest tier asks four people: the issuer and three more.
T = 4
HOUR_MS = 3_600_000
#: What needs t people, two and one.
HIGH, ELEVATED, LOW = go("office-1"), go("isolation-room"), go("pharmacy")

HONEST = ("supervisor-3", "supervisor-4", "safety-officer-3")
#: Approvers whose keys are stolen: with the issuer's, one fewer than t.
THIEVES = ("supervisor-1", "supervisor-2")


def stolen(name: str) -> PrivateKey:
    return open_key_file(scenarios.trust_folder() / "keys" / f"{name}.key.pem")[0]


@cache
def key(name: str) -> FileSigner:
    """Return a key of somebody by the name of what is wrong, or right, with it."""
    person, _, kind = name.partition("/")
    more: dict[str, Any] = {
        "": {"key": stolen(person)} if person in THIEVES else {},
        "second": {},
        "operator": {"role": Role.OPERATOR},
        "other-robot": {"robots": (str(scenarios.OTHER),)},
        "other-region": {"regions": ("dock", "pharmacy")},
        "ends-soon": {"days": 1},
        "pair": {"threshold": 2, "members": THIEVES},
        "with-issuer": {"threshold": 3, "members": ("operator-1", *THIEVES)},
        "key-of-the-issuer": {"key": stolen("operator-1")},
        "key-of-a-thief": {"key": stolen(THIEVES[0])},
    }[kind]
    role = more.pop("role", Role.SAFETY_OFFICER if "officer" in person else Role.SUPERVISOR)
    return approvals.key_of(scenarios.trust_folder(), person, role, **more)


@cache
def mission(version: int = 1, mid: str = "ask") -> Mission:
    """Return a mission whose ways need one, two and t people, and one more while one is near."""
    near = {"variable": "human_distance_mm", "lt": 4_000, "max_age": "1 s"}
    plain_draft = scenarios.draft()
    grant = plain_draft["grants"][0]
    wide = {**grant, "repeat": 100, "starts": 100, "until": [], "chooser": "planner"}
    gripped = [
        {"object": item, "source": "dock", "regions": ["dock"]}
        for item in ("package-p1", "package-p2")
    ]
    grips = {"type": "pick", "tool": "gripper", "limits": {"force_mn": ["1 N", "20 N"]}}
    grants = [
        {**wide, "id": "risky", "rows": [way("isolation-room"), way("office-1")]},
        {**wide, "id": "risky-too", "rows": [way("plant-room")]},
        {**wide, "id": "easy", "rows": [way("pharmacy")]},
        {**wide, **grips, "id": "risky-grip", "rows": gripped},
    ]
    risk = {
        **plain_draft["risk_policy"],
        "object_classes": {"medicine": 40},
        "tau_2": 40,
        "t": T,
        "valid": "30 h",
        "states": [{"guard": near, "weight": 30}],
    }
    budgets = {**plain_draft["budgets"], "prompts": 100, "motion": "90 h", "actions": 200}
    changes: dict[str, Any] = {
        "mission": mid,
        "window": {"for": "60 h"},
        "grants": grants,
        "risk_policy": risk,
        "budgets": {**budgets, "rate": {"count": 100, "per": "1 s"}},
        "closing": None,
        "version": version,
    }
    if version > 1:
        changes["supersedes"] = digest_of(Tag.MISSION, mission(version - 1, mid))
    return scenarios.mission(**changes)


@dataclass
class Game:
    """The challenger: a robot and its gate, honest people, and a book of what they signed.

    Args:
        thieves: how many approvers' keys are stolen, beside the issuer's.
    """

    thieves: int = len(THIEVES)
    kept: list[bytes] = field(default_factory=list)
    book: list[tuple[str, Approval]] = field(default_factory=list)
    used: set[int] = field(default_factory=set)
    wins: list[str] = field(default_factory=list)
    released: int = 0
    version: int = 1

    def __post_init__(self) -> None:
        self.here = Station()
        self.here.gate.management.activate(self.here.token(mission()))

    # what the adversary may do

    def propose(self, action: Any = HIGH) -> list[str]:
        """Propose; judge a release, and bring the robot back. Return the reasons of a refusal."""
        begun = self.here.submit(action)
        report = begun if isinstance(begun, Report) else begun.report
        if report.judged is None:
            return [str(report.refusal.reason)]  # type: ignore[union-attr]
        if not isinstance(begun, Report):
            self.released += 1
            self._judge(report)
            self.here.abort(begun)
        return [str(reason) for reason in report.judged.decision.reasons]

    def open(self, **changes: Any) -> Approval | None:
        """Return what an honest person would sign for the open question, with fields changed."""
        standing = self.here.standing("ask")
        assert standing is not None
        if not standing.requests:
            return None
        grant, request = next(iter(standing.requests.items()))
        fields: dict[str, Any] = {
            "mid": standing.mid,
            "version": standing.version,
            "mission": standing.digest,
            "rid": scenarios.RID,
            "grant": grant,
            "scope": request.scope,
            "situation": request.situation,
            "counter": request.counter,
            "expires_ms": request.expires_ms,
            "verdict": ApprovalVerdict.APPROVE,
        }
        return Approval(**{**fields, **changes})

    def asks(self, *people: str, **changes: Any) -> list[bytes]:
        """Let honest people sign; everything goes into the book, and the adversary keeps it."""
        value = self.open(**changes)
        if value is None:
            return []
        self.book += [(person, value) for person in people]
        return self._signed(value, *people)

    def forges(self, *names: str, **changes: Any) -> list[bytes]:
        """Sign with stolen keys."""
        value = self.open(**changes)
        return [] if value is None else self._signed(value, *names)

    def _signed(self, value: Approval, *names: str) -> list[bytes]:
        made = [sign_object(value, Tag.APPROVAL, key(name)) for name in names]
        self.kept += made
        return made

    def hand_in(self, *tokens: bytes) -> None:
        for token in tokens:
            try:
                self.here.gate.management.approve(token)
            except AuthGuardError:
                continue

    def steals(self) -> None:
        """Hand in an answer of every approver whose key is stolen."""
        self.hand_in(*self.forges(*THIEVES[: self.thieves]))

    def supersede(self) -> None:
        self.version += 1
        self.here.gate.management.activate(self.here.token(mission(self.version)))

    # who wins

    def _judge(self, report: Any) -> None:
        """Hold a release against the book; everything is worked out by the reference."""
        judged = report.judged
        now, state, grant = plain(judged.now), judged.state, judged.decision.match.indexed.grant
        seen = {
            "state": {"snapshot": plain(state.snapshot), "arrived_mono_ms": state.arrived_mono_ms},
            "facts": FACTS_PLAIN,
            "now": now,
        }
        own = plain(mission(self.version))
        policy = own["risk_policy"]
        risk = rho(policy, plain(judged.action), seen["state"], FACTS_PLAIN, now)
        tier = 1 if risk < policy["tau_1"] else 2 if risk < policy["tau_2"] else 3
        needed = (1, 2, policy["t"])[tier - 1]
        assert needed == judged.decision.need.required
        if needed == 1:
            return
        request = judged.standing.requests.get(grant.id)
        counter = 0 if request is None else request.counter
        tuple_ = {
            "mid": "ask",
            "version": self.version,
            "mission": digest_of(Tag.MISSION, mission(self.version)),
            "rid": scenarios.RID,
            "grant": grant.id,
            "scope": scope_of(plain(judged.action)),
            "situation": situation_of(own, plain(grant), tier, **seen),
            "counter": counter,
        }
        about = [
            (person, value)
            for person, value in self.book
            if all(getattr(value, name) == wanted for name, wanted in tuple_.items())
        ]
        honest = {
            person
            for person, value in about
            if value.verdict is ApprovalVerdict.APPROVE and judged.now.utc_ms <= value.expires_ms
        }
        if len(honest) + self.thieves < needed - 1:
            self.wins.append(f"{len(honest)} honest people, {needed} needed")
        if any(value.verdict is ApprovalVerdict.DENY for _, value in about):
            self.wins.append("somebody denied it")
        if counter in self.used:
            self.wins.append("a second action out of one question")
        self.used.add(counter)


# the enumerated strategies; each is given to adversaries with and without approvers' keys

Strategy = Callable[[Game, Callable[[], None]], None]
STRATEGIES: dict[str, Strategy] = {}


def strategy(move: Strategy) -> Strategy:
    STRATEGIES[move.__name__] = move
    return move


@strategy
def nobody_answers(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    between()
    game.propose()


@strategy
def stolen_keys_alone(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    between()
    game.propose()


@strategy
def the_issuer_answers_too(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.asks(*HONEST[: 2 - game.thieves])
    game.steals()
    game.hand_in(*game.kept, *game.forges("operator-1"))
    between()
    game.propose()


@strategy
def one_person_has_two_keys(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    seconds = [f"{name}/second" for name in THIEVES[: game.thieves]]
    game.hand_in(*game.forges(*seconds))
    game.hand_in(*game.forges(*seconds, expires_ms=scenarios.START_MS + 60_000))  # another answer
    game.hand_in(*game.asks(*HONEST[: 2 - game.thieves]), *game.kept, *game.kept)
    between()
    game.propose()


@strategy
def the_issuer_has_a_second_name(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    game.hand_in(*game.forges("shadow/key-of-the-issuer"))
    game.hand_in(*game.asks(*HONEST[: 2 - game.thieves]))
    between()
    game.propose()


@strategy
def an_approver_has_a_second_name(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    if game.thieves:
        game.hand_in(*game.forges("shadow/key-of-a-thief", "shadow/key-of-a-thief"))
    between()
    game.propose()


@strategy
def a_group_is_added_to_its_members(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    if game.thieves:
        game.hand_in(*game.forges("night-shift/pair"))
    between()
    game.propose()


@strategy
def a_group_of_which_one_is_the_issuer(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.steals()
    if game.thieves:
        game.hand_in(*game.forges("day-shift/with-issuer"))
    between()
    game.propose()


def ineligible(kind: str) -> Strategy:
    def move(game: Game, between: Callable[[], None]) -> None:
        game.propose()
        game.steals()
        game.hand_in(*game.forges(*[f"stolen-{n}/{kind}" for n in range(T)]))
        if kind == "ends-soon":
            game.here.jump(24 * HOUR_MS + HOUR_MS)
        between()
        game.propose()

    return move


for _kind in ("operator", "other-robot", "other-region", "ends-soon"):
    STRATEGIES[f"people_who_may_not_answer: {_kind}"] = ineligible(_kind)


#: What honest people sign for the asking: anything that is not the very question.
ELSEWHERE: dict[str, Callable[[Approval], dict[str, Any]]] = {
    "mid": lambda _: {"mid": "other"},
    "version": lambda own: {"version": own.version + 1},
    "mission": lambda _: {"mission": OTHER_DIGEST},
    "rid": lambda _: {"rid": str(scenarios.OTHER)},
    "grant": lambda _: {"grant": "risky-too"},
    "scope": lambda _: {"scope": OTHER_DIGEST},
    "situation": lambda _: {"situation": OTHER_DIGEST},
    "counter": lambda own: {"counter": own.counter + 1},
    "expires_ms": lambda _: {"expires_ms": scenarios.START_MS + 60_000},
}


def elsewhere(name: str) -> Strategy:
    def move(game: Game, between: Callable[[], None]) -> None:
        game.propose()
        game.steals()
        own = game.open()
        assert own is not None
        game.hand_in(*game.asks(*HONEST, **ELSEWHERE[name](own)))
        if name == "expires_ms":
            game.here.jump(120_000)
        between()
        game.propose()

    return move


for _name in ELSEWHERE:
    STRATEGIES[f"signed_for_another: {_name}"] = elsewhere(_name)


#: What is carried out, and for each field of it an action that differs in that field alone.
DRIVE = replace(go("office-1"), route=("public-corridor",))
GRIP = Action(
    type="pick",
    tool="gripper",
    object="package-p1",
    source="dock",
    params={"force_mn": 2_000},
)
DIFFERENT: dict[str, tuple[Action, dict[str, Any]]] = {
    "type": (DRIVE, {"type": "pick"}),
    "tool": (DRIVE, {"tool": "gripper"}),
    "object": (GRIP, {"object": "package-p2"}),
    "source": (DRIVE, {"source": "pharmacy"}),
    "destination": (DRIVE, {"destination": "isolation-room"}),
    "route": (DRIVE, {"route": ("dock", "public-corridor")}),
    "params": (DRIVE, {"params": {"speed_mm_s": 700}}),
}


def signed_for_another_action(name: str) -> Strategy:
    """All answer the open question, but for an action that differs in one field."""

    def move(game: Game, between: Callable[[], None]) -> None:
        action, other = DIFFERENT[name][0], replace(DIFFERENT[name][0], **DIFFERENT[name][1])
        game.propose(action)
        game.steals()
        scope = digest_of(Tag.SCOPE, check.scope_of(other))
        game.hand_in(*game.asks(*HONEST, scope=scope))
        between()
        game.propose(action)

    return move


def the_question_of_another_action(name: str) -> Strategy:
    """All answer for one action; another, as risky, is proposed that differs in one field."""

    def move(game: Game, between: Callable[[], None]) -> None:
        action, other = DIFFERENT[name][0], replace(DIFFERENT[name][0], **DIFFERENT[name][1])
        game.propose(other)
        game.hand_in(*game.asks(*HONEST))
        between()
        game.propose(action)

    return move


for _name in DIFFERENT:
    STRATEGIES[f"signed_for_another_action: {_name}"] = signed_for_another_action(_name)
    STRATEGIES[f"the_question_of_another_action: {_name}"] = the_question_of_another_action(_name)


@strategy
def the_question_of_another_situation(game: Game, between: Callable[[], None]) -> None:
    """What one approved while nobody was near is done with a person beside the robot."""
    game.propose(ELEVATED)
    game.steals()
    game.hand_in(*game.asks(*HONEST[:1]))
    between()
    game.here.somebody(near=True)
    game.propose(ELEVATED)
    game.hand_in(*game.kept)
    game.propose(ELEVATED)


@strategy
def the_action_once_more(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.hand_in(*game.asks(*HONEST))
    assert game.propose() == []
    between()
    for _ in range(2):
        game.hand_in(*reversed(game.kept))
        game.propose()


@strategy
def the_version_before(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.hand_in(*game.asks(*HONEST))
    game.supersede()
    between()
    game.propose()
    game.hand_in(*game.kept)
    game.propose()


@strategy
def after_the_time(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.hand_in(*game.asks(*HONEST))
    game.here.jump(30 * HOUR_MS + 60_000)
    between()
    game.propose()
    game.hand_in(*game.kept)
    game.propose()


@strategy
def past_a_denial(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    denial = game.asks("safety-officer-1", verdict=ApprovalVerdict.DENY)
    game.hand_in(*game.asks(*HONEST), *denial)
    between()
    game.propose()
    game.hand_in(*game.asks(*HONEST[: 2 - game.thieves]), *game.kept)
    game.propose()


@strategy
def past_a_denial_whose_certificate_ends(game: Game, between: Callable[[], None]) -> None:
    game.propose()
    game.hand_in(*game.asks("safety-officer-1/ends-soon", verdict=ApprovalVerdict.DENY))
    game.hand_in(*game.asks(*HONEST))
    game.here.jump(24 * HOUR_MS + HOUR_MS)
    between()
    game.propose()


@strategy
def altered_bytes(game: Game, between: Callable[[], None]) -> None:
    """Honest people denied, or signed for the past: their signatures under the right words."""
    game.propose()
    game.steals()
    wanted = game.open()
    assert wanted is not None
    stale = [
        *game.asks(*HONEST, counter=wanted.counter + 9),
        *game.asks(*HONEST, verdict=ApprovalVerdict.DENY, counter=wanted.counter + 8),
    ]
    right = read_token(sign_object(wanted, Tag.APPROVAL, key(THIEVES[0])))
    for token in stale:
        taken = read_token(token)
        game.hand_in(_bytes(replace(taken, payload=right.payload)))
        game.hand_in(_bytes(replace(right, endorsements=taken.endorsements)))
        both = (*right.endorsements, *taken.endorsements)
        game.hand_in(_bytes(replace(right, endorsements=both)))
        game.hand_in(flipped(token, Random(len(game.kept))))
    between()
    game.propose()


def _bytes(token: Any) -> bytes:
    return msgspec.json.encode(token, order="sorted")


def flipped(token: bytes, rnd: Random) -> bytes:
    raw = bytearray(token)
    raw[rnd.randrange(len(raw))] ^= 1 << rnd.randrange(7)
    return bytes(raw)


BETWEEN: dict[str, Callable[[Game], Callable[[], None]]] = {
    "at once": lambda _: lambda: None,
    "after a restart": lambda game: game.here.restart,
    "after a crash": lambda game: lambda: crash(game),
}


def crash(game: Game) -> None:
    """Kill the gate; the issuer lets the mission go on, as it must before anything is released."""
    from authguard_r.enforcement.signed_orders import Verb

    game.here.kill()
    resume = game.here.order(mission(game.version), Verb.RESUME)
    game.here.gate.management.command(resume)


def play(name: str, *, thieves: int = len(THIEVES), between: str = "at once") -> Game:
    game = Game(thieves=thieves)
    STRATEGIES[name](game, BETWEEN[between](game))
    return game


#: How many keys are stolen, and what comes between; the last ones are for the complete run.
WAYS = [
    (len(THIEVES), "at once"),
    (0, "at once"),
    (len(THIEVES), "after a crash"),
    (len(THIEVES), "after a restart"),
    (0, "after a restart"),
    (0, "after a crash"),
]


@pytest.mark.parametrize(("thieves", "between"), WAYS[: amount(3, len(WAYS))])
@pytest.mark.parametrize("name", STRATEGIES)
def test_no_strategy_wins(name: str, thieves: int, between: str) -> None:
    game = play(name, thieves=thieves, between=between)
    assert game.wins == []
    standing = game.here.standing("ask")
    assert standing is not None
    assert standing.actions == game.released
    assert standing.open == ()


@pytest.mark.parametrize("thieves", [0, len(THIEVES)])
def test_the_people_that_are_needed_move_the_robot(thieves: int) -> None:
    game = Game(thieves=thieves)
    assert game.propose() == ["APPROVAL_REQUIRED"]
    game.steals()
    for person in HONEST[: T - 1 - thieves]:
        assert game.propose() == ["APPROVAL_REQUIRED"]
        game.hand_in(*game.asks(person))
    assert game.propose() == []
    assert (game.released, game.wins) == (1, [])


@pytest.mark.parametrize("name", ActionScope.__struct_fields__)
def test_an_approval_counts_for_the_very_action_and_for_none_that_differs_in_a_field(
    name: str,
) -> None:
    action, other = DIFFERENT[name][0], replace(DIFFERENT[name][0], **DIFFERENT[name][1])
    for strategies in (signed_for_another_action, the_question_of_another_action):
        game = Game()
        strategies(name)(game, lambda: None)
        assert (game.released, game.wins) == (0, [])
        assert game.propose(action) == ["APPROVAL_REQUIRED"]
        game.hand_in(*game.asks(*HONEST))
        assert game.propose(action) == []
        assert (game.released, game.wins) == (1, [])
    assert scope_of(plain(action)) == digest_of(Tag.SCOPE, check.scope_of(action))
    assert scope_of(plain(other)) == digest_of(Tag.SCOPE, check.scope_of(other))


def test_the_scope_of_an_approval_is_every_field_of_the_action_but_who_proposed_it_and_why() -> (
    None
):
    beside = {"provenance", "meta"}
    assert {*ActionScope.__struct_fields__} == {*Action.__struct_fields__} - beside == {*DIFFERENT}


# what each condition is worth


def forgiving(change: Callable[[Any, Any, Any, Any], Any]) -> Any:
    """`_fits` of an answer that says what one condition wants to hear."""
    real = check._fits
    return patch.object(
        check,
        "_fits",
        lambda item, case, grant, request: real(
            change(item, case, grant, request), case, grant, request
        ),
    )


def saying(**fields: Callable[[Any, Any, Any], Any]) -> Any:
    def change(item: Any, case: Any, grant: Any, request: Any) -> Any:
        said = {name: get(case, grant, request) for name, get in fields.items()}
        return replace(item, approval=replace(item.approval, **said))

    return forgiving(change)


def by(**fields: Any) -> Any:
    return forgiving(lambda item, *_: replace(item, approver=replace(item.approver, **fields)))


def everything_ever_taken_in(*, then: bool = False) -> Any:
    """Without the key in the store: every answer that is held, whatever it was for.

    Args:
        then: as authentic as when it began, whatever has ended since.
    """

    def answers(self: InputVerifier, act: Any, standing: Any) -> VerifiedApprovals:
        at = scenarios.NOW if then else act.now
        held = self._ledger.store._held  # type: ignore[attr-defined]
        tokens = [
            token
            for (kind, _), value in held.items()
            if kind == "approvals"
            for token in msgspec.json.decode(value)
        ]
        opened = []
        for token in tokens:
            try:
                opened.append(open_approval(token.encode(), verifier=trust(), now=at))
            except AuthGuardError:
                continue
        return VerifiedApprovals(approvals=tuple(opened), tokens=tuple(tokens))

    return patch.object(InputVerifier, "answers", answers)


def keeping_all() -> Any:
    """Without the look at what was asked: an answer is kept whatever it is for."""
    return patch.object(answers, "is_asked", lambda *_: True)


def any_name() -> Any:
    return patch.object(InputVerifier, "_require_one_name", lambda *_: None)


def asked(**fields: str) -> Any:
    """Step 7, with the open question taken for the one that is to be asked."""
    real = gate.check_approval

    def passes(case: Any, grant: Any, need: Any) -> Any:
        request = case.standing.requests.get(grant.id)
        if request is not None and need.required > 1:
            need = replace(need, **{name: getattr(request, name) for name in fields})
        return real(case, grant, need)

    return patch.object(gate, "check_approval", passes)


def scope_without(name: str) -> Any:
    """An approval's scope in which one field is the same for every action."""
    real, blank = check.scope_of, {"type": "any", "tool": "any", "route": (), "params": {}}
    return patch.object(
        check,
        "scope_of",
        lambda action: replace(real(action), **{name: blank.get(name)}),
    )


def never_over() -> Any:
    """Step 7, with a question that does not run out."""
    real = gate.check_approval

    def passes(case: Any, grant: Any, need: Any) -> Any:
        standing = case.standing
        for_ever = {
            name: replace(request, expires_ms=1 << 50)
            for name, request in standing.requests.items()
        }
        return real(replace(case, standing=replace(standing, requests=for_ever)), grant, need)

    return patch.object(gate, "check_approval", passes)


def kept_open() -> Any:
    real = enforcer.reserve
    return patch.object(
        enforcer,
        "reserve",
        lambda standing, *rest, **more: replace(
            real(standing, *rest, **more), requests=standing.requests
        ),
    )


def counted(count: Callable[[Any, list[Any]], int]) -> Any:
    return patch.object(check, "people_behind", count)


def _people(approvers: list[Any]) -> set[str]:
    return {item.id for item in approvers if not item.members}


def never_closing() -> Any:
    """Without the mark that a denial leaves when it comes in."""
    return patch.object(answers, "deny_request", lambda standing, _: standing)


def _mission_of(name: str) -> Any:
    return lambda case, grant, request: getattr(case.verified.mission, name)


def _request_of(name: str) -> Any:
    return lambda case, grant, request: getattr(request, name)


#: What is taken out, and the strategy that wins then. Where two conditions hold the same thing,
#: both are taken out; `test_the_store_s_key_alone_is_not_what_holds` shows the other one alone.
CONTROLS: dict[str, tuple[Callable[[], tuple[Any, ...]], str]] = {
    "mid": (
        lambda: (everything_ever_taken_in(), keeping_all(), saying(mid=_mission_of("mid"))),
        "signed_for_another: mid",
    ),
    "version": (
        lambda: (saying(version=_mission_of("version")),),
        "signed_for_another: version",
    ),
    "mission": (
        lambda: (saying(mission=lambda case, *_: case.verified.digest),),
        "signed_for_another: mission",
    ),
    "rid": (lambda: (saying(rid=lambda *_: scenarios.RID),), "signed_for_another: rid"),
    "grant": (
        lambda: (saying(grant=lambda case, grant, request: grant.id),),
        "signed_for_another: grant",
    ),
    "scope": (lambda: (saying(scope=_request_of("scope")),), "signed_for_another: scope"),
    "situation": (
        lambda: (saying(situation=_request_of("situation")),),
        "signed_for_another: situation",
    ),
    "counter": (
        lambda: (
            everything_ever_taken_in(),
            keeping_all(),
            saying(counter=_request_of("counter")),
        ),
        "signed_for_another: counter",
    ),
    "expires_ms": (
        lambda: (saying(expires_ms=_request_of("expires_ms")),),
        "signed_for_another: expires_ms",
    ),
    "usable_until_ms": (
        lambda: (everything_ever_taken_in(then=True), by(usable_until_ms=1 << 50)),
        "people_who_may_not_answer: ends-soon",
    ),
    "role": (lambda: (by(role="supervisor"),), "people_who_may_not_answer: operator"),
    "issuer": (
        lambda: (
            by(id="nobody"),
            counted(lambda who, approvers: people_behind(replace(who, id="nobody"), approvers)),
        ),
        "the_issuer_answers_too",
    ),
    "robots": (
        lambda: (by(scope=scenarios.EVERYWHERE),),
        "people_who_may_not_answer: other-robot",
    ),
    "regions": (
        lambda: (by(scope=scenarios.EVERYWHERE),),
        "people_who_may_not_answer: other-region",
    ),
    "people, not answers": (
        lambda: (counted(lambda _, approvers: 1 + len(approvers)),),
        "one_person_has_two_keys",
    ),
    "nobody twice": (
        lambda: (
            counted(
                lambda issuer, approvers: (
                    1
                    + len(_people(approvers))
                    + sum(a.threshold - (issuer.id in a.members) for a in approvers if a.members)
                )
            ),
        ),
        "a_group_is_added_to_its_members",
    ),
    "less the issuer": (
        lambda: (
            counted(
                lambda _, approvers: (
                    1
                    + max(
                        len(_people(approvers)),
                        *[a.threshold for a in approvers if a.members],
                        0,
                    )
                )
            ),
        ),
        "a_group_of_which_one_is_the_issuer",
    ),
    "the issuer's key, one name": (lambda: (any_name(),), "the_issuer_has_a_second_name"),
    "an approver's key, one name": (lambda: (any_name(),), "an_approver_has_a_second_name"),
    "a denial": (
        lambda: (
            patch.object(check, "ApprovalVerdict", SimpleNamespace(DENY=None)),
            never_closing(),
        ),
        "past_a_denial",
    ),
    "a denial, once it came in": (
        lambda: (never_closing(),),
        "past_a_denial_whose_certificate_ends",
    ),
    **{
        f"{name} of the action": (
            lambda name=name: (scope_without(name),),
            f"signed_for_another_action: {name}",
        )
        for name in DIFFERENT
    },
    "the request's scope": (lambda: (asked(scope=""),), "the_question_of_another_action: params"),
    "the request's situation": (
        lambda: (asked(situation=""),),
        "the_question_of_another_situation",
    ),
    "the request's end": (
        lambda: (never_over(), saying(expires_ms=lambda *_: 1 << 50)),
        "after_the_time",
    ),
    "used once": (lambda: (kept_open(),), "the_action_once_more"),
    "the signature": (
        lambda: (patch.object(keys, "require_signature", lambda *_, **__: None),),
        "altered_bytes",
    ),
    "the check itself": (
        lambda: (patch.object(gate, "check_approval", lambda *_: ()),),
        "nobody_answers",
    ),
}


@contextmanager
def taken_out(name: str) -> Iterator[None]:
    with ExitStack() as stack:
        for out in CONTROLS[name][0]():
            stack.enter_context(out)
        yield


@pytest.mark.parametrize("name", CONTROLS)
def test_without_one_condition_the_adversary_wins(name: str) -> None:
    winning = CONTROLS[name][1]
    assert play(winning).wins == []
    with taken_out(name):
        assert play(winning).wins != []
    assert play(winning).wins == []


def test_every_field_of_an_answer_has_a_control() -> None:
    assert {*Approval.__struct_fields__} - {"verdict"} <= {*CONTROLS}
    for winning in {winning for _, winning in CONTROLS.values()}:
        assert winning in STRATEGIES


@pytest.mark.parametrize("name", STRATEGIES)
def test_the_store_s_key_alone_is_not_what_holds(name: str) -> None:
    with everything_ever_taken_in(), keeping_all():
        assert play(name).wins == []


# sequences that nobody thought of

PLACES = {"low": LOW, "elevated": ELEVATED, "high": HIGH, "high too": go("plant-room")}


class Sequences(RuleBasedStateMachine):
    """The adversary's moves in any order; honest people sign for the very question too."""

    def __init__(self) -> None:
        super().__init__()
        self.game = Game(thieves=len(THIEVES))

    @rule(place=st.sampled_from(sorted(PLACES)))
    def proposes(self, place: str) -> None:
        self.game.propose(PLACES[place])

    @rule(person=st.sampled_from(HONEST), at_once=st.booleans())
    def somebody_answers_the_very_question(self, person: str, at_once: bool) -> None:
        made = self.game.asks(person)
        if at_once:
            self.game.hand_in(*made)

    @rule(person=st.sampled_from(HONEST), name=st.sampled_from(sorted(ELSEWHERE)))
    def somebody_signs_something_else(self, person: str, name: str) -> None:
        own = self.game.open()
        if own is not None:
            self.game.hand_in(*self.game.asks(person, **ELSEWHERE[name](own)))

    @rule(person=st.sampled_from(HONEST))
    def somebody_denies(self, person: str) -> None:
        self.game.hand_in(*self.game.asks(person, verdict=ApprovalVerdict.DENY))

    @rule(
        name=st.sampled_from(
            [
                *THIEVES,
                *[f"{name}/second" for name in THIEVES],
                "operator-1",
                "night-shift/pair",
                "day-shift/with-issuer",
                *[f"stolen-{n}/{kind}" for n in range(2) for kind in ("operator", "other-robot")],
            ]
        )
    )
    def a_stolen_key_signs(self, name: str) -> None:
        self.game.hand_in(*self.game.forges(name))

    @precondition(lambda self: self.game.kept)
    @rule(seed=st.integers(0, 1 << 20), bent=st.booleans())
    def old_answers_come_again(self, seed: int, bent: bool) -> None:
        rnd = Random(seed)
        some = rnd.sample(self.game.kept, min(4, len(self.game.kept)))
        self.game.hand_in(*[flipped(token, rnd) if bent else token for token in some])

    @rule(near=st.booleans())
    def somebody_comes_or_goes(self, near: bool) -> None:
        self.game.here.somebody(near=near)

    @rule(minutes=st.sampled_from([1, 90, 30 * 60 + 1]))
    def time_passes(self, minutes: int) -> None:
        self.game.here.jump(minutes * 60_000)

    @rule()
    def the_gate_is_restarted(self) -> None:
        self.game.here.restart()

    @rule()
    def the_gate_is_killed(self) -> None:
        standing = self.game.here.standing("ask")
        assert standing is not None
        if standing.status == "active":
            crash(self.game)

    @precondition(lambda self: self.game.version < 4)
    @rule()
    def the_mission_is_superseded(self) -> None:
        try:
            self.game.supersede()
        except AuthGuardError:
            self.game.version -= 1

    @invariant()
    def nobody_wins(self) -> None:
        assert self.game.wins == []


QUICK = settings(
    max_examples=amount(10, 40),
    stateful_step_count=25,
    database=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
Sequences.TestCase.settings = QUICK
TestSequences = Sequences.TestCase


class _Long(Sequences):
    pass


@pytest.mark.nightly
def test_no_sequence_of_a_long_campaign_wins() -> None:
    _Long.TestCase.settings = settings(
        QUICK, max_examples=3_000, stateful_step_count=60, derandomize=False
    )
    _Long.TestCase("runTest").runTest()
