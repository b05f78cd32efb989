# SPDX-License-Identifier: Apache-2.0
"""People behind an action are distinct people, whoever of a group has signed.

What the gate counts is held to every way in which the groups' signers can have been chosen, one by
one, and to the oracle; then a whole gate, with answers, denials and revocations in between.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations, product
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.checks.people import MOST_NEEDS, fewest_people, people_behind
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.principals import Principal
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import FileSigner
from authguard_reference.people import fewest as fewest_of_reference
from authguard_reference.people import people_behind as behind_of_reference
from fixtures import approvals, scenarios
from fixtures.amount import amount
from fixtures.decision_cases import plain
from missionpair.bench import Bench, BenchScene, make_bench

RELAXED = settings(database=None, derandomize=True, suppress_health_check=list(HealthCheck))
SEEDS = st.integers(min_value=0, max_value=2**63)
PEOPLE = [f"supervisor-{n}" for n in range(1, 6)]


def principal(name: str, threshold: int = 1, members: tuple[str, ...] = ()) -> Principal:
    return Principal(
        id=PrincipalId(name),
        role="supervisor",
        scope=scenarios.EVERYWHERE,
        usable_until_ms=1 << 50,
        threshold=threshold,
        members=frozenset(map(PrincipalId, members)),
    )


def somebody(rnd: Random, name: str, *, unknown: float = 0.1) -> Principal:
    """Return a person, or a group of some; of a few groups nobody knows the members."""
    if rnd.random() < 0.5:
        return principal(rnd.choice(PEOPLE))
    if rnd.random() < unknown:
        return principal(name, threshold=2)
    members = rnd.sample(PEOPLE, rnd.randint(1, len(PEOPLE)))
    return principal(name, rnd.randint(1, min(3, len(members))), tuple(members))


def ways(who: Principal) -> Iterator[frozenset[str]]:
    """Yield every set of people who can have signed, one by one."""
    if who.members:
        yield from map(frozenset, combinations(sorted(who.members), who.threshold))
    else:
        yield frozenset({who.id})


def is_unknown(who: Principal) -> bool:
    return who.threshold > 1 and not who.members


def brute_force(issuer: Principal, approvers: list[Principal]) -> int:
    """Return the fewest people behind it, over every way in which all can have signed."""
    own = issuer.members or {issuer.id}
    known = [a for a in approvers if not is_unknown(a) and not is_unknown(issuer)]
    others = [a for a in known if all(signed - own for signed in ways(a))]
    # a group of nobody knows whom has two signers at least: one is not the one issuer
    unknown = any(is_unknown(a) for a in approvers) and len(own) == 1 and not is_unknown(issuer)
    if not others:
        return 2 if unknown else 1
    chosen = product(ways(issuer), *(ways(a) for a in others))
    return min(len(frozenset().union(*signed)) for signed in chosen)


def test_of_all_ways_in_which_groups_can_have_signed_the_one_with_fewest_people_counts() -> None:
    found: Counter[int] = Counter()

    @settings(RELAXED, max_examples=amount(400, 4_000))
    @given(SEEDS)
    def holds(seed: int) -> None:
        rnd = Random(seed)
        issuer = somebody(rnd, "issuers")
        approvers = [somebody(rnd, f"board-{n}") for n in range(rnd.randrange(5))]
        count = people_behind(issuer, approvers)
        assert count == brute_force(issuer, approvers)
        assert count == behind_of_reference([plain(a) for a in approvers], plain(issuer))
        found[count] += 1

    holds()
    assert {1, 2, 3, 4, 5} <= {*found}, found


def test_more_groups_than_can_be_looked_at_never_count_too_much() -> None:
    """No more than in one way in which they can have signed; the oracle leaves out the same."""
    for seed in range(amount(60, 600)):
        rnd = Random(seed)
        people = [PrincipalId(f"p-{n}") for n in range(30)]
        groups = []
        for _ in range(rnd.randint(4, 12)):
            members = frozenset(rnd.sample(people, rnd.randint(2, 30)))
            groups.append((rnd.randint(1, len(members)), members))
        count = fewest_people(groups)
        assert count == fewest_of_reference(groups)
        assert max(needed for needed, _ in groups if needed < MOST_NEEDS) <= count
        assert count <= len(frozenset().union(*(members for _, members in groups)))
        chosen = frozenset[PrincipalId]().union(
            *(frozenset(sorted(members)[:needed]) for needed, members in groups)
        )
        assert count <= len(chosen)  # one way in which they can have signed


def test_no_group_has_more_signers_than_members() -> None:
    issuer, two = principal("operator-1"), principal("board", 5, ("supervisor-1", "supervisor-2"))
    for approvers, count in (([two], 3), ([two, two], 3), ([two, principal("supervisor-3")], 4)):
        assert people_behind(issuer, approvers) == count
        assert behind_of_reference([plain(a) for a in approvers], plain(issuer)) == count
    assert people_behind(two, [principal("supervisor-3")]) == 3


def test_one_more_approval_never_makes_fewer_people() -> None:
    for seed in range(amount(200, 2_000)):
        rnd = Random(seed)
        issuer = somebody(rnd, "issuers")
        approvers = [somebody(rnd, f"board-{n}") for n in range(4)]
        counts = [people_behind(issuer, approvers[:n]) for n in range(5)]
        assert counts == sorted(counts)


# the same at a gate: answers, denials and revocations in any order


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


@dataclass
class Answers:
    """A gate with an open request, and everything that was handed in."""

    bench: Bench
    rnd: Random
    lists: list[FileSigner]
    given: list[tuple[Principal, FileSigner]] = field(default_factory=list)
    gone: list[FileSigner] = field(default_factory=list)
    denied: bool = False
    named: int = 0

    def __post_init__(self) -> None:
        self.needed = self.rnd.randint(2, 5)
        risk = {"tau_2": 31, "t": self.needed}
        self.issuer = principal("operator-1")
        if self.rnd.random() < 0.5:
            members = tuple(self.rnd.sample(PEOPLE, self.rnd.randint(1, 4)))
            self.issuer = principal("duty-officers", self.rnd.randint(1, len(members)), members)
            self.scene: BenchScene = approvals.scene_of_group(
                self.bench, *members, threshold=self.issuer.threshold, **risk
            )
        else:
            self.scene = approvals.scene(self.bench, "isolation-room", **risk)
        assert approvals.outcome(self.scene) == ["APPROVAL_REQUIRED"]

    def answers(self, verdict: ApprovalVerdict) -> None:
        self.named += 1  # a name is one group's for ever: a revoked one is not given again
        who = somebody(self.rnd, f"board-{self.named}", unknown=0)
        names = tuple(who.members)
        key = approvals.key_of(
            self.bench.folder, who.id, Role.SUPERVISOR, threshold=who.threshold, members=names
        )
        value = approvals.approval(self.scene, verdict=verdict)
        self.scene.sim.gate.management.approve(approvals.signed(self.bench, value, key))
        if verdict is ApprovalVerdict.APPROVE:
            self.given.append((who, key))
        else:
            self.denied = True
            self.gone.append(key)  # and is revoked, sooner or later

    def revokes(self) -> None:
        """Revoke somebody who approved, and everybody who denied."""
        if self.given and self.rnd.random() < 0.5:
            self.gone.append(self.given.pop(self.rnd.randrange(len(self.given)))[1])
        self.lists += self.gone
        self.gone = []
        number = len(self.lists) + 2
        approvals.revoke(self.bench.folder, self.scene, *self.lists, number=number)

    @property
    def expected(self) -> list[str]:
        if self.denied:
            return ["APPROVAL_DENIED"]
        behind = brute_force(self.issuer, [who for who, _ in self.given])
        return [] if behind >= self.needed else ["APPROVAL_REQUIRED"]


def test_a_gate_releases_what_enough_people_approve_whoever_is_revoked_in_between(
    bench: Bench,
) -> None:
    found: Counter[str] = Counter()
    revoked: list[FileSigner] = []

    @settings(RELAXED, max_examples=amount(40, 300))
    @given(SEEDS)
    def holds(seed: int) -> None:
        rnd = Random(seed)
        here = Answers(bench, rnd, revoked)
        for _ in range(rnd.randint(1, 6)):
            here.answers(ApprovalVerdict.DENY if rnd.random() < 0.06 else ApprovalVerdict.APPROVE)
            if here.gone or rnd.random() < 0.2:
                revoked.append(approvals.key_of(bench.folder, "nobody", Role.SUPERVISOR))
                here.revokes()
        reasons = approvals.outcome(here.scene)
        assert reasons == here.expected
        assert (here.scene.sim.robot.state.region == "dock") == (reasons != [])
        found[reasons[0] if reasons else "released"] += 1

    holds()
    for outcome in ("released", "APPROVAL_REQUIRED", "APPROVAL_DENIED"):
        assert found[outcome] >= amount(4, 30), found
