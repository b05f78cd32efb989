# SPDX-License-Identifier: Apache-2.0
"""Certificates: chains that hold, with what they say, and one fault at a time.

What is expected is written here by hand, from docs/spec/token.md; nothing is asked of the code.
"""

from __future__ import annotations

from datetime import timedelta
from functools import cache
from typing import Any

from authguard_r.keys.certificate import Role
from making import certificate_faults as faults
from making import chains
from making.book import (
    DIGEST,
    LEAF,
    MEMBER,
    OPERATOR,
    PEOPLE,
    PROFILE,
    REGION,
    ROBOT,
    TEMPLATE,
    THRESHOLD,
    TOP,
    UNKNOWN,
    Book,
    ms,
    named,
)
from making.chains import authority, leaf, line, operator, own, root
from unit.keys.chains import EVERYWHERE, NOW, OIDS, PRINCIPAL, TODAY, Held, eku, san

Json = dict[str, Any]


def certificate_vectors() -> Json:
    """Chains under their roots at an instant: what the leaf says, or why it says nothing."""
    book = Book()
    good(book)
    scopes(book)
    groups(book)
    times(book)
    algorithms(book)
    two_roots(book)
    faults.leaves(book)
    faults.names(book)
    faults.authorities(book)
    faults.strangers(book)
    faults.keys(book)
    faults.spelled(book)
    machines(book)
    roots = demonstrations(book)
    return {
        "certificates": book.table.names(),
        "vectors": book.vectors,
        "machines": book.machines,
        "demonstration": roots,
        "roles": {str(role): oid.dotted_string for role, oid in OIDS.items()},
    }


def good(book: Book) -> None:
    """Every role, and what may be there without changing anything."""
    book.accept("an operator of every robot and region", leaf(PEOPLE))
    for role in Role:
        issuer = authority(TOP, (role,), f"of {role}")
        made = leaf(issuer, name=f"as {role}", role=(eku(role), True))
        book.accept(f"the role {role}", made, issuer, role=str(role))
    everyone = authority(TOP, tuple(Role), "of every role")
    book.accept("an authority of every role", leaf(everyone, name="one of all"), everyone)
    longest = "a" + "b" * 63
    book.accept(
        "the longest principal",
        leaf(PEOPLE, name="longest", names=named(PRINCIPAL + longest, *EVERYWHERE)),
        principal=longest,
    )
    book.accept(
        "names of other kinds beside it",
        leaf(
            PEOPLE,
            name="other kinds",
            names=named(OPERATOR, *EVERYWHERE, "https://hospital.example/operator-1"),
        ),
    )
    book.accept(
        "an unknown extension that is not critical",
        leaf(PEOPLE, name="not critical", extra=((UNKNOWN, False),)),
    )
    book.accept(
        "an alternative name that is critical",
        leaf(PEOPLE, name="critical name", names=(san(OPERATOR, *EVERYWHERE), True)),
    )
    bare = root("Bare root", extensions=())
    below = authority(bare, name="below a bare root")
    book.accept(
        "a root without any extension", leaf(below, name="below a bare root"), below, (bare,)
    )
    again = authority(TOP, name="people, certified anew")
    book.accept("an authority that was certified anew", leaf(PEOPLE), again)
    book.accept("the smallest serial number", leaf(PEOPLE, name="serial 1", serial=1), serial="1")


def scopes(book: Book) -> None:
    """Robots and regions one by one, all in so many words, or none."""
    cases: dict[str, tuple[tuple[str, ...], Json]] = {
        "one robot and one region": (
            (ROBOT + "courier-1", REGION + "dock"),
            {"robots": ["courier-1"], "regions": ["dock"]},
        ),
        "two robots and every region": (
            (ROBOT + "lifter-1", ROBOT + "courier-1", EVERYWHERE[1]),
            {"robots": ["courier-1", "lifter-1"]},
        ),
        "every robot and two regions": (
            (EVERYWHERE[0], REGION + "pharmacy", REGION + "dock"),
            {"regions": ["dock", "pharmacy"]},
        ),
        "no scope: for nothing": ((), {"robots": [], "regions": []}),
        "a robot without regions": (
            (ROBOT + "courier-1",),
            {"robots": ["courier-1"], "regions": []},
        ),
        "a profile": ((*EVERYWHERE, PROFILE + DIGEST), {"profile": DIGEST}),
    }
    for name, (uris, said) in cases.items():
        book.accept(name, leaf(PEOPLE, name=name, names=named(OPERATOR, *uris)), **said)


def groups(book: Book) -> None:
    """A group's key: how many of whom."""
    people = [f"supervisor-{number}" for number in (1, 2, 3)]
    members = tuple(MEMBER + name for name in people)
    for threshold in (1, 2, 3):
        uris = (PRINCIPAL + "board-1", *EVERYWHERE, f"{THRESHOLD}{threshold}", *members)
        held = leaf(PEOPLE, "board-1", f"board of {threshold}", names=named(*uris))
        name = f"a group of three, of whom {threshold} sign"
        book.accept(name, held, principal="board-1", threshold=threshold, members=people)
    bad: dict[str, tuple[str, ...]] = {
        "a threshold without members": (THRESHOLD + "2",),
        "members without a threshold": members,
        "a threshold of none": (THRESHOLD + "0", *members),
        "a threshold above the members": (THRESHOLD + "4", *members),
        "two thresholds": (THRESHOLD + "2", THRESHOLD + "2", *members),
        "a threshold with a zero before it": (THRESHOLD + "02", *members),
        "a threshold below none": (THRESHOLD + "-1", *members),
        "a threshold in words": (THRESHOLD + "two", *members),
        "one member twice, of whom two sign": (THRESHOLD + "2", members[0], members[0]),
        "a member that is no identifier": (THRESHOLD + "2", *members, MEMBER + "Nobody Here"),
    }
    for name, uris in bad.items():
        whole = named(PRINCIPAL + "board-1", *EVERYWHERE, *uris)
        book.refuse(name, leaf(PEOPLE, "board-1", name, names=whole))


def times(book: Book) -> None:
    """Each certificate's first and last instant, and the second outside of them."""
    second, day = timedelta(seconds=1), timedelta(days=1)
    dates = {
        "expired a second ago": (TODAY - 9 * day, TODAY - second, False),
        "not valid for another second": (TODAY + second, TODAY + 9 * day, False),
        "in its last second": (TODAY - 9 * day, TODAY, True),
        "in its first second": (TODAY, TODAY + 9 * day, True),
    }
    for said, (start, end, holds) in dates.items():
        for part in ("leaf", "authority", "root"):
            name = (
                f"a {part} that is {said}"
                if holds
                else f"a {part} that {said}".replace("that not", "that is not")
            )
            when: Json = {"start": start, "end": end}
            top = root(**when) if part == "root" else TOP
            issuer = authority(top, **when) if part == "authority" else authority(top)
            one = leaf(issuer, name=name, **(when if part == "leaf" else {}))
            if holds:
                book.accept(name, one, issuer, (top,), not_after_ms=ms(end))
            else:
                where = f"certificate.{part}"
                book.refuse(
                    name, one, issuer, roots=(top,), reason="CERTIFICATE_EXPIRED", where=where
                )
    minute = leaf(PEOPLE, name="one minute", start=TODAY, end=TODAY + 60 * second)
    last = ms(TODAY) + 60_000
    book.accept("the last millisecond", minute, now_ms=last, not_after_ms=last)
    book.refuse("a millisecond too late", minute, reason="CERTIFICATE_EXPIRED", now_ms=last + 1)
    book.refuse(
        "a millisecond too early", minute, reason="CERTIFICATE_EXPIRED", now_ms=ms(TODAY) - 1
    )


def algorithms(book: Book) -> None:
    """Each algorithm from root to leaf; under one root, one beside another."""
    for algorithm in (chains.M44, chains.M65, chains.M87):
        top, people = line(algorithm)
        book.table.name(top, f"root {algorithm}")
        book.table.name(people, f"people {algorithm}")
        held = operator(algorithm)
        book.table.name(held, f"operator-1 {algorithm}")
        book.accept(
            f"{algorithm} from root to leaf", held, people, (top,), algorithm=str(algorithm)
        )
    top, people = line(chains.M65)
    book.accept("an Ed25519 leaf under an ML-DSA root", weak(), people, (top,))
    near = leaf(PEOPLE, name="ml-dsa-44 under ed25519", own=own(chains.M44, "leaf operator-1"))
    book.accept("an ML-DSA leaf under an Ed25519 root", near, algorithm=str(chains.M44))


@cache
def weak() -> Held:
    """Return an Ed25519 leaf of an ML-DSA authority."""
    return leaf(line(chains.M65)[1], name="ed25519 under ml-dsa-65")


def two_roots(book: Book) -> None:
    """Under two roots a chain is of its root's algorithm all the way."""
    top, people = line(chains.M65)
    both = (TOP, top)
    book.accept("under the first of two roots", leaf(PEOPLE), roots=both)
    held = operator(chains.M65)
    said: Json = {"algorithm": str(chains.M65), "root": 1}
    book.accept("under the second of two roots", held, people, both, **said)
    mixed: dict[str, tuple[Held, Held]] = {
        "an Ed25519 leaf under an ML-DSA root, of two": (
            weak(),
            people,
        ),
        "an ML-DSA leaf under an Ed25519 root, of two": (
            leaf(PEOPLE, name="ml-dsa-65 under ed25519", own=own(chains.M65, "leaf operator-1")),
            PEOPLE,
        ),
        "ML-DSA-44 under ML-DSA-65, of two": (
            leaf(people, name="44 under 65", own=own(chains.M44, "leaf operator-1")),
            people,
        ),
    }
    between = authority(top, name="ed25519 between", own=own(chains.ED, "people"))
    mixed["an Ed25519 authority between ML-DSA, of two"] = (
        leaf(between, name="under a weak authority", own=own(chains.M65, "leaf operator-1")),
        between,
    )
    for name, (one, issuer) in mixed.items():
        book.refuse(name, one, issuer, roots=both, where="certificate")


def machines(book: Book) -> None:
    """What gates, estimators and schedulers need of their own certificates."""
    issuer = authority(TOP, (Role.GATE, Role.ESTIMATOR, Role.SCHEDULER), "machines")
    book.table.name(issuer, "machines")
    one, two, all_of = (ROBOT + "courier-1",), (ROBOT + "courier-1", ROBOT + "lifter-1"), EVERYWHERE
    profile, template = PROFILE + DIGEST, TEMPLATE + DIGEST
    robot: Json = {"robot": "courier-1"}
    cases: list[tuple[str, Role, Role, tuple[str, ...], Json | None]] = [
        ("a gate of one robot and its profile", Role.GATE, Role.GATE, (*one, profile), {**robot, "profile": DIGEST}),
        ("a gate without a profile", Role.GATE, Role.GATE, one, None),
        ("a gate without a robot", Role.GATE, Role.GATE, (profile,), None),
        ("a gate of two robots", Role.GATE, Role.GATE, (*two, profile), None),
        ("a gate of every robot", Role.GATE, Role.GATE, (*all_of, profile), None),
        ("an estimator in a gate's place", Role.GATE, Role.ESTIMATOR, (*one, profile), None),
        ("an estimator of one robot", Role.ESTIMATOR, Role.ESTIMATOR, one, robot),
        ("an estimator without a robot", Role.ESTIMATOR, Role.ESTIMATOR, (), None),
        ("an estimator of two robots", Role.ESTIMATOR, Role.ESTIMATOR, two, None),
        ("an estimator of every robot", Role.ESTIMATOR, Role.ESTIMATOR, all_of, None),
        ("a gate in an estimator's place", Role.ESTIMATOR, Role.GATE, one, None),
        ("a scheduler of one template", Role.SCHEDULER, Role.SCHEDULER, (*all_of, template), {"template": DIGEST}),
        ("a scheduler without a template", Role.SCHEDULER, Role.SCHEDULER, all_of, None),
        ("a gate in a scheduler's place", Role.SCHEDULER, Role.GATE, one, None),
    ]  # fmt: skip
    for name, wanted, role, uris, said in cases:
        names = named(PRINCIPAL + "machine-1", *uris)
        held = leaf(issuer, "machine-1", name, role=(eku(role), True), names=names)
        refusal = {"reason": "ROLE_DENIED", "where": LEAF}
        vector = book.chain(name, (held, issuer), (TOP,))
        book.machines.append(
            {**vector, "now_ms": NOW.utc_ms, "as": str(wanted), "expect": said or refusal}
        )


def demonstrations(book: Book) -> list[Json]:
    """Roots that say that they are for demonstration, and one that does not."""
    subjects = {"Site root": False, "A demo root": True, "DEMO": True, "Democracy Hospital": True}
    return [
        {"root": book.table.name(root(subject), f"root {subject}"), "demo": demo}
        for subject, demo in subjects.items()
    ]
