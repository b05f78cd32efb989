# SPDX-License-Identifier: Apache-2.0
"""Files that move: canonical or refused, and no malformed number enters through any of them."""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.core.action import scope_of
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.checks.approval import Situation
from authguard_r.core.encoding import Tag, b64, digest_of, encode, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import GrantId, MissionId
from authguard_r.frost import curve, signing
from authguard_r.frost.messages import Ballot, message_of, read, written
from fixtures import scenarios
from fixtures.cases import case
from fixtures.threshold_groups import (
    BAD_POINTS,
    BAD_SCALARS,
    dealt,
    finished,
    generated,
    prepared,
    spoiled,
)

MADE = dealt(2, 3)
SESSION, READY = prepared(MADE.shares[:2], b"m")
SECRETS, OFFERS, GIVEN = generated(2, 3)
SCOPE = scope_of(scenarios.navigate("dock", "pharmacy"))
SITUATION = Situation(guards=(True, False), tier=3)
APPROVAL = Approval(
    mid=MissionId("deliver-p1"),
    version=1,
    mission=digest_of(Tag.RAW, "mission"),
    rid=scenarios.RID,
    grant=GrantId("go"),
    scope=digest_of(Tag.SCOPE, SCOPE),
    situation=digest_of(Tag.SITUATION, SITUATION),
    counter=1,
    expires_ms=scenarios.START_MS,
    verdict=ApprovalVerdict.APPROVE,
)
FILES: dict[str, Any] = {
    "group": MADE.group,
    "share": MADE.shares[0],
    "plan": SECRETS[0].plan,
    "offer": OFFERS[0],
    "contribution": GIVEN[0],
    "secret": SECRETS[0],
    "ballot": Ballot(approval=APPROVAL, scope=SCOPE, situation=SITUATION),
    "commitment": READY[0][1].commitment,
    "nonces": READY[0][1],
    "signature share": signing.sign(SESSION, *READY[0]),
}
#: Every place where a point or a scalar enters from a file.
POINTS = [
    ("group", "commitment"),
    ("offer", "commitment"),
    ("offer", "proof_point"),
    ("commitment", "hiding"),
    ("commitment", "binding"),
]
SCALARS = [
    ("share", "secret"),
    ("offer", "proof_scalar"),
    ("secret", "coefficients"),
    ("nonces", "hiding"),
    ("nonces", "binding"),
    ("signature share", "share"),
]


def refused(name: str, plain: dict[str, object]) -> str:
    with pytest.raises(MalformedError) as caught:
        read(encode(plain), type(FILES[name]), where=name)
    return str(caught.value)


def replaced(name: str, field: str, raw: bytes) -> dict[str, object]:
    held = getattr(FILES[name], field)
    value = (b64(raw), *held[1:]) if isinstance(held, tuple) else b64(raw)
    return spoiled(FILES[name], **{field: value})


def test_every_file_is_read_as_it_was_written() -> None:
    for name, value in FILES.items():
        with case(name):
            assert read(written(value), type(value), where=name) == value


def test_unknown_fields_other_kinds_and_other_spellings_are_refused() -> None:
    for name, value in FILES.items():
        with case(name):
            assert "unknown field" in refused(name, spoiled(value, more=1))
            assert "invalid value" in refused(name, spoiled(value, kind="frost/other/1")).lower()
            for data in (
                written(value) + b"\n",
                b" " + written(value),
                written(value)[:-3],
                b"",
                b"[]",
            ):
                with pytest.raises(MalformedError):
                    read(data, type(value), where=name)
            for field in spoiled(value):
                lacking = {key: item for key, item in spoiled(value).items() if key != field}
                refused(name, lacking)


def test_a_malformed_point_is_refused_wherever_it_enters() -> None:
    for name, field in POINTS:
        for bad in BAD_POINTS:
            with case(name, field, bad):
                message = refused(name, replaced(name, field, BAD_POINTS[bad]))
                assert "point" in message or "length" in message


def test_a_malformed_point_is_refused_inside_another_file() -> None:
    for bad in BAD_POINTS:
        with case(bad):
            group = replaced("group", "commitment", BAD_POINTS[bad])
            refused("share", spoiled(MADE.shares[0], group=group))
            commitment = replaced("commitment", "hiding", BAD_POINTS[bad])
            refused("nonces", spoiled(FILES["nonces"], commitment=commitment))


def test_a_malformed_scalar_is_refused_wherever_it_enters() -> None:
    for name, field in SCALARS:
        for bad in BAD_SCALARS:
            with case(name, field, bad):
                message = refused(name, replaced(name, field, BAD_SCALARS[bad]))
                assert "scalar" in message or "length" in message


def test_numbers_that_are_no_base64url_are_refused() -> None:
    for text in ("=" * 43, "+" * 43, "\u00e9" * 43):
        with pytest.raises(ValueError, match="base64url"):
            curve.point(text)
    with pytest.raises(ValueError, match="32 bytes, got 3"):
        curve.scalar("AAAA")


def test_values_out_of_bounds_are_refused() -> None:
    for name, changes in [
        ("group", {"threshold": 1}),
        ("group", {"threshold": 65}),
        ("group", {"threshold": 3}),
        ("group", {"threshold": True}),
        ("group", {"members": ["member-1"]}),
        ("group", {"members": ["member-1", "member-1"]}),
        ("group", {"members": ["Member-1", "member-2"]}),
        ("group", {"commitment": list(MADE.group.commitment[:1])}),
        ("share", {"identifier": 0}),
        ("share", {"identifier": 4}),
        ("share", {"identifier": 65}),
        ("commitment", {"identifier": 0}),
        ("secret", {"identifier": 4}),
        ("secret", {"coefficients": [*SECRETS[0].coefficients, SECRETS[0].coefficients[0]]}),
        ("offer", {"box": "=" * 43}),
        ("secret", {"box": "+" * 43}),
        ("contribution", {"sealed": "A" * 129}),
        ("contribution", {"recipient": -1}),
        ("plan", {"threshold": 4}),
    ]:
        with case(name, changes):
            refused(name, spoiled(FILES[name], **changes))


def test_a_ballot_shows_the_action_that_its_approval_names() -> None:
    """L20: the page shows A while B is signed."""
    other = scope_of(scenarios.navigate("dock", "icu-corridor"))
    assert "the action that the approval names" in refused(
        "ballot", spoiled(FILES["ballot"], scope=other)
    )
    milder = Situation(guards=(True, True), tier=1)
    assert "the situation that the approval names" in refused(
        "ballot", spoiled(FILES["ballot"], situation=milder)
    )
    sly = {**spoiled(FILES["ballot"]), "scope": {**spoiled(SCOPE), "more": 1}}  # type: ignore[arg-type]
    refused("ballot", sly)


def test_what_is_signed_is_what_an_approval_token_is_signed_over() -> None:
    assert message_of(FILES["ballot"]) == unb64(digest_of(Tag.APPROVAL, APPROVAL))


def test_secrets_are_not_printed() -> None:
    shown = repr(FILES["nonces"])
    assert FILES["nonces"].hiding not in shown
    assert FILES["nonces"].binding not in shown
    assert finished(SECRETS[0], OFFERS, GIVEN).secret not in repr(MADE)
