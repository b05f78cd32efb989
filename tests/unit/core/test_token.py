# SPDX-License-Identifier: Apache-2.0
"""Tokens: one way to be right, and every way to be wrong with its own code and place."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import timedelta
from functools import cache
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.encoding import (
    MAX_BYTES,
    Tag,
    b64,
    decode,
    digest,
    encode,
    encode_fast,
    unb64,
)
from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError
from authguard_r.core.mission import Closing, DataRights, Grant, Guard, Limit, Mission, Row
from authguard_r.core.principals import Signer
from authguard_r.core.reasons import Reason
from authguard_r.core.token import (
    Endorsement,
    Token,
    VerifiedMission,
    open_token,
    read_token,
    sign_object,
    verify_mission,
)
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import Trust, read_trust
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from unit.keys import chains
from unit.keys.chains import TODAY, Held, eku, house

replace = msgspec.structs.replace
OPERATORS = frozenset({"operator"})
ENDORSED = "token.endorsements[0]"
ALL = "token.endorsements"


@cache
def story() -> Mission:
    return scenarios.mission()


def mission(**changes: Any) -> Mission:
    return replace(story(), **changes)


@cache
def trust() -> Trust:
    return read_trust(scenarios.trust_folder())


@cache
def signer(name: str = "operator-1") -> Signer:
    return folder_signer(scenarios.trust_folder(), name)


def verified(
    data: bytes, *, by: Trust | None = None, now: Any = None, roles: frozenset[str] = OPERATORS
) -> VerifiedMission:
    return verify_mission(data, verifier=by or trust(), now=now or scenarios.NOW, roles=roles)


def refused(data: bytes, reason: Reason, where: str, **how: Any) -> AuthGuardError:
    """Assert that the mission token is refused for this reason in this place, and not otherwise."""
    with pytest.raises(AuthGuardError) as caught:
        verified(data, **how)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def token(value: object | None = None, **changes: Any) -> Token:
    return replace(read_token(sign_object(value or mission(), Tag.MISSION, signer())), **changes)


def endorse(payload: bytes, by: Signer, *, tag: Tag = Tag.MISSION) -> Endorsement:
    ((chain, signature),) = by.endorse(unb64(digest(tag, payload)))
    return Endorsement(chain=tuple(b64(der) for der in chain), signature=b64(signature))


def signed(payload: bytes, *by: Signer, kind: Tag = Tag.MISSION, tag: Tag = Tag.MISSION) -> bytes:
    """Return a token over any bytes, signed in earnest."""
    endorsements = tuple(endorse(payload, one, tag=tag) for one in by or (signer(),))
    return encode_fast(Token(kind=kind, payload=b64(payload), endorsements=endorsements))


# -- the right way ---------------------------------------------------------------------------------


def test_a_signed_mission_is_what_was_signed_by_whom_until_when() -> None:
    value = mission()
    found = verified(sign_object(value, Tag.MISSION, signer()))
    assert found.mission == value
    assert found.digest == digest(Tag.MISSION, encode(value))
    assert (found.issuer.id, found.issuer.role) == ("operator-1", "operator")
    assert found.issuer.usable_until_ms > scenarios.START_MS
    assert found.not_before_ms == scenarios.START_MS
    assert found.expiry_ms == scenarios.START_MS + 25 * 60_000


def test_a_verified_mission_indexes_what_it_holds_and_nothing_else() -> None:
    found = verified(sign_object(mission(), Tag.MISSION, signer()))
    assert found.objects == set(found.mission.objects)
    assert found.regions == set(found.mission.regions)
    assert found.limits == {limit.parameter: limit for limit in found.mission.limits}
    assert [indexed.grant for indexed in found.grants] == list(found.mission.actions)
    for kind, places in found.by_type.items():
        ours = [found.grants[place].grant for place in places]
        assert ours == [g for g in found.mission.actions if g.type == kind]
    for indexed in found.grants:
        assert list(indexed.limits.values()) == list(indexed.grant.limits)


def test_a_final_new_line_belongs_to_the_file_and_no_other_does() -> None:
    data = sign_object(mission(), Tag.MISSION, signer())
    assert data.endswith(b"}\n")
    assert verified(data).digest == verified(data[:-1]).digest
    refused(data + b"\n", Reason.NOT_CANONICAL, "token")
    refused(data[:-1] + b"\r\n", Reason.NOT_CANONICAL, "token")
    refused(b"\n" + data, Reason.NOT_CANONICAL, "token")


def test_one_principal_may_endorse_up_to_four_times() -> None:
    payload = encode(mission())
    assert verified(signed(payload, *[signer()] * 4)).issuer.id == "operator-1"


# -- bytes that are no token -----------------------------------------------------------------------


def test_a_token_cut_short_anywhere_is_malformed() -> None:
    data = sign_object(mission(), Tag.MISSION, signer()).removesuffix(b"\n")
    for length in [*range(0, len(data), 97), len(data) - 1]:
        with pytest.raises(MalformedError) as caught:
            verified(data[:length])
        assert caught.value.reason is Reason.MALFORMED
        assert caught.value.where == "token"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'{"endorsements"', b'{ "endorsements"'),
        (b'"kind":', b'"kind": '),
        (b'"kind":', b'"kind":"authguard-r/site/1","kind":'),
        (b'"kind":', b'"k\\u0069nd":'),
        (b"authguard-r/mission/1", b"authguard-r\\/mission\\/1"),
        (b"authguard-r/mission/1", b"\\u0061uthguard-r/mission/1"),
    ],
    ids=["white space", "white space 2", "duplicate key", "escaped key", "slash", "escape"],
)
def test_a_token_in_another_spelling_is_not_canonical(old: bytes, new: bytes) -> None:
    data = encode_fast(token())
    assert data.count(old) == 1
    refused(data.replace(old, new), Reason.NOT_CANONICAL, "token")


def test_a_token_with_its_keys_in_another_order_is_not_canonical() -> None:
    plain = json.loads(encode_fast(token()))
    data = json.dumps(dict(reversed(plain.items())), separators=(",", ":")).encode()
    refused(data, Reason.NOT_CANONICAL, "token")
    again = json.dumps(plain, separators=(",", ":"), sort_keys=True).encode()
    assert verified(again).mission == mission()


@pytest.mark.parametrize("field", ["kind", "payload", "endorsements"])
def test_a_token_without_a_field_is_malformed(field: str) -> None:
    plain = json.loads(encode_fast(token()))
    del plain[field]
    refused(encode(plain), Reason.MALFORMED, "token")


@pytest.mark.parametrize("field", ["alg", "iss", "verified", "roles", "key"])
def test_a_field_that_would_tell_us_how_to_verify_is_refused(field: str) -> None:
    """The algorithm comes from the certificate; a token has no say in it (L14)."""
    plain = json.loads(encode_fast(token()))
    refused(encode({**plain, field: "none"}), Reason.MALFORMED, "token")
    plain["endorsements"][0][field] = "none"
    refused(encode(plain), Reason.MALFORMED, ENDORSED)


@pytest.mark.parametrize("count", [0, 5, 100])
def test_a_token_with_no_or_too_many_endorsements_is_malformed(count: int) -> None:
    plain = json.loads(encode_fast(token()))
    plain["endorsements"] *= count
    refused(encode(plain), Reason.MALFORMED, "token.endorsements")


@pytest.mark.parametrize("length", [0, 1, 3, 9])
def test_a_chain_that_is_not_two_long_is_malformed(length: int) -> None:
    plain = json.loads(encode_fast(token()))
    chain = plain["endorsements"][0]["chain"]
    plain["endorsements"][0]["chain"] = (chain * 5)[:length]
    refused(encode(plain), Reason.MALFORMED, f"{ENDORSED}.chain")


@pytest.mark.parametrize("part", ["payload", "signature", "chain"])
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("AB", Reason.NOT_CANONICAL),  # stray bits: AA is the spelling
        ("A", Reason.MALFORMED),  # no whole byte
    ],
)
def test_base64_in_a_second_spelling_is_refused(part: str, text: str, reason: Reason) -> None:
    plain = json.loads(encode_fast(token()))
    if part == "payload":
        plain["payload"] = text
        refused(encode(plain), reason, "token.payload")
    else:
        plain["endorsements"][0][part] = [text, text] if part == "chain" else text
        refused(encode(plain), reason, f"{ENDORSED}.{part}")


@pytest.mark.parametrize("text", ["AA==", "A A", "A+/A", "AA\n", "\u0410A"])
def test_base64_with_anything_else_in_it_is_malformed(text: str) -> None:
    plain = json.loads(encode_fast(token()))
    plain["payload"] = text
    refused(encode(plain), Reason.MALFORMED, "token.payload")


def test_a_token_over_the_limit_is_malformed_without_being_read() -> None:
    error = refused(b"{" * (MAX_BYTES + 1), Reason.MALFORMED, "token")
    assert str(MAX_BYTES) in error.message
    huge = signed(b"x" * (MAX_BYTES * 3 // 4))
    assert len(huge) > MAX_BYTES
    refused(huge, Reason.MALFORMED, "token")


def test_bytes_that_are_nothing_like_a_token_are_malformed() -> None:
    for data in [
        b"",
        b"null",
        b"[]",
        b"0",
        b"\xff",
        b"\xef\xbb\xbf{}",
        b"{" * 5000,
        b"[" * 100_000,
    ]:
        with case(data):
            refused(data, Reason.MALFORMED, "token")


# -- another kind ----------------------------------------------------------------------------------


def test_a_token_of_another_kind_is_no_mission() -> None:
    """The kind is compared before a single certificate is looked at."""
    for kind in [tag for tag in Tag if tag is not Tag.MISSION]:
        with case(kind):
            error = refused(
                signed(encode(mission()), kind=kind, tag=kind), Reason.WRONG_KIND, "token.kind"
            )
            assert f"`{kind}`" in error.message


@pytest.mark.parametrize("kind", ["authguard-r/mission/2", "mission", "", "AUTHGUARD-R/MISSION/1"])
def test_a_kind_that_does_not_exist_is_malformed(kind: str) -> None:
    plain = json.loads(encode_fast(token()))
    plain["kind"] = kind
    refused(encode(plain), Reason.MALFORMED, "token.kind")


def test_a_signature_made_under_another_tag_does_not_hold() -> None:
    """A supervisor's approval of these bytes, say, is not a mission."""
    for tag in [tag for tag in Tag if tag is not Tag.MISSION]:
        with case(tag):
            data = signed(encode(mission()), kind=Tag.MISSION, tag=tag)
            refused(data, Reason.SIGNATURE_INVALID, "signature")


def test_a_signature_over_the_bare_payload_does_not_hold() -> None:
    payload = encode(mission())
    ((_, over_it),) = signer().endorse(payload)
    bare = replace(endorse(payload, signer()), signature=b64(over_it))
    data = encode_fast(token(endorsements=(bare,)))
    refused(data, Reason.SIGNATURE_INVALID, "signature")


# -- another signer --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "who",
    [
        "supervisor-1",
        "safety-officer-1",
        "site-authority-1",
        "witness-1",
        "gate-courier-1",
        "estimator-courier-1",
    ],
)
def test_a_principal_in_another_role_may_not_sign_a_mission(who: str) -> None:
    value = mission(issuer=who)
    error = refused(sign_object(value, Tag.MISSION, signer(who)), Reason.ROLE_DENIED, ALL)
    assert "operator" in error.message


def test_the_roles_are_the_caller_s_and_no_role_means_nobody() -> None:
    data = sign_object(mission(), Tag.MISSION, signer())
    refused(data, Reason.ROLE_DENIED, ALL, roles=frozenset())
    assert verified(data, roles=frozenset({"supervisor", "operator"})).issuer.role == "operator"


def test_a_mission_that_names_another_issuer_is_refused() -> None:
    """A second operator cannot speak in the first one's name."""
    data = sign_object(mission(), Tag.MISSION, signer("operator-2"))
    refused(data, Reason.ISSUER_MISMATCH, "mission.issuer")
    own = sign_object(mission(issuer="operator-2"), Tag.MISSION, signer("operator-2"))
    assert verified(own).issuer.id == "operator-2"


def test_endorsements_of_two_principals_are_refused() -> None:
    payload = encode(mission())
    for pair in (("operator-1", "operator-2"), ("operator-2", "operator-1")):
        data = signed(payload, *(signer(name) for name in pair))
        refused(data, Reason.ISSUER_MISMATCH, "token.endorsements[1]")


def test_every_endorsement_must_verify_not_only_the_first() -> None:
    payload = encode(mission())
    good, bad = endorse(payload, signer()), endorse(b"other", signer())
    for pair in ((good, bad), (bad, good)):
        refused(encode_fast(token(endorsements=pair)), Reason.SIGNATURE_INVALID, "signature")
    second = replace(good, chain=(good.chain[0], good.chain[0]))
    refused(
        encode_fast(token(endorsements=(good, second))),
        Reason.CERTIFICATE_INVALID,
        "certificate.authority",
    )
    other_role = endorse(payload, signer("supervisor-1"))
    refused(
        encode_fast(token(endorsements=(good, other_role))),
        Reason.ISSUER_MISMATCH,
        "token.endorsements[1]",
    )


# -- another chain ---------------------------------------------------------------------------------


def at_house(leaf: Held | None = None, people: Held | None = None, **how: Any) -> bytes:
    """Return the story's mission signed by a leaf of the test's own authority."""
    held = leaf or chains.leaf(people or house().people)
    by = chains.FileSigner(held.key, (held.der, (people or house().people).der))
    return sign_object(mission(**how), Tag.MISSION, by)


def refused_at_house(data: bytes, reason: Reason, where: str) -> None:
    refused(data, reason, where, by=house().trust(), now=chains.NOW)


def test_the_test_s_own_house_is_sound() -> None:
    found = verified(at_house(), by=house().trust(), now=chains.NOW)
    assert found.issuer.id == "operator-1"


def test_a_token_of_a_foreign_root_is_refused_both_ways() -> None:
    where = "certificate.authority"
    refused_at_house(
        sign_object(mission(), Tag.MISSION, signer()), Reason.CERTIFICATE_INVALID, where
    )
    refused(at_house(), Reason.CERTIFICATE_INVALID, where)


@pytest.mark.parametrize(
    "dates",
    [
        {"start": TODAY - timedelta(days=9), "end": TODAY - timedelta(seconds=1)},
        {"start": TODAY + timedelta(seconds=1), "end": TODAY + timedelta(days=9)},
    ],
    ids=["expired", "future"],
)
def test_a_certificate_out_of_its_time_is_refused_in_its_place(dates: dict[str, Any]) -> None:
    refused_at_house(
        at_house(chains.leaf(house().people, **dates)),
        Reason.CERTIFICATE_EXPIRED,
        "certificate.leaf",
    )
    refused_at_house(
        at_house(people=chains.authority(house().root, **dates)),
        Reason.CERTIFICATE_EXPIRED,
        "certificate.authority",
    )


def test_a_revoked_signer_is_refused_and_a_stale_list_refuses_all() -> None:
    leaf = chains.leaf(house().people, serial=41)
    revoked = house().trust(revoked={house().people.der: frozenset({41})})
    refused(at_house(leaf), Reason.CERTIFICATE_REVOKED, "certificate", by=revoked, now=chains.NOW)
    stale = house().trust(days=-1)
    refused(at_house(leaf), Reason.REVOCATION_STALE, "revocations", by=stale, now=chains.NOW)


def test_a_chain_in_the_wrong_order_is_refused() -> None:
    good = token().endorsements[0]
    swapped = replace(good, chain=good.chain[::-1])
    refused(
        encode_fast(token(endorsements=(swapped,))),
        Reason.CERTIFICATE_INVALID,
        "certificate.authority",
    )


def test_a_leaf_cannot_stand_in_for_an_authority() -> None:
    """A stolen operator key must not make a second operator."""
    stolen = chains.leaf(house().people)
    forged = chains.leaf(stolen, "operator-2", role=(eku(Role.OPERATOR), True))
    by = chains.FileSigner(forged.key, (forged.der, stolen.der))
    data = sign_object(mission(issuer="operator-2"), Tag.MISSION, by)
    refused_at_house(data, Reason.CERTIFICATE_INVALID, "certificate.authority")


def test_the_chain_of_another_principal_does_not_carry_the_signature() -> None:
    good = token().endorsements[0]
    other = endorse(encode(mission()), signer("operator-2"))
    mixed = replace(good, chain=other.chain)
    refused(encode_fast(token(endorsements=(mixed,))), Reason.SIGNATURE_INVALID, "signature")


def test_a_chain_of_garbage_is_refused() -> None:
    for place in [0, 1]:
        for data in [b"", b"junk", b"\x30\x80", bytes(5000)]:
            with case(place, data):
                good = token().endorsements[0]
                chain = list(good.chain)
                chain[place] = b64(data)
                bad = replace(good, chain=tuple(chain))
                refused(
                    encode_fast(token(endorsements=(bad,))),
                    Reason.CERTIFICATE_INVALID,
                    ("certificate.leaf", "certificate.authority")[place],
                )


# -- another payload -------------------------------------------------------------------------------


def test_a_payload_with_one_byte_changed_does_not_hold() -> None:
    payload = encode(mission())
    genuine = token()
    for at in range(0, len(payload), 31):
        changed = payload[:at] + bytes([payload[at] ^ 1]) + payload[at + 1 :]
        refused(
            encode_fast(replace(genuine, payload=b64(changed))),
            Reason.SIGNATURE_INVALID,
            "signature",
        )


def test_the_signature_of_another_mission_does_not_carry_over() -> None:
    """The attack: take a signature for the dock, put it under a mission for the office."""
    wide = mission(regions=(*mission().regions, "zoo"))
    genuine = token()
    data = encode_fast(replace(genuine, payload=b64(encode(wide))))
    refused(data, Reason.SIGNATURE_INVALID, "signature")
    other = token(wide).endorsements
    refused(
        encode_fast(replace(genuine, endorsements=other)), Reason.SIGNATURE_INVALID, "signature"
    )


@pytest.mark.parametrize("length", [0, 1, 32, 63, 65, 4096])
def test_a_signature_of_another_length_does_not_hold(length: int) -> None:
    good = token().endorsements[0]
    bad = replace(good, signature=b64(bytes(length)))
    refused(encode_fast(token(endorsements=(bad,))), Reason.SIGNATURE_INVALID, "signature")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'{"actions":[', b'{ "actions":['),
        (b'"expiry":', b'"expiry":"2099-01-01T00:00:00Z","expiry":'),
        (b'"on_refusal":"hold"', b'"on_refusal":"\\u0068old"'),
        (b'"task":', b'"supersedes":null,"task":'),
        (b'"id":"look-out"', b'"guards":[],"id":"look-out"'),
    ],
    ids=["white space", "duplicate key", "escape", "null", "default"],
)
def test_signed_bytes_in_another_spelling_are_refused_although_the_signature_holds(
    old: bytes, new: bytes
) -> None:
    payload = encode(mission())
    assert payload.count(old) == 1
    with pytest.raises(MalformedError) as caught:
        verified(signed(payload.replace(old, new)))
    assert caught.value.reason is Reason.NOT_CANONICAL
    assert caught.value.where == "mission"


def test_signed_nonsense_is_malformed_in_its_place() -> None:
    for old, new, where in [
        (b'"version":1', b'"version":1.0', "mission.version"),
        (b'"version":1', b'"version":1e0', "mission.version"),
        (b'"version":1', b'"version":-1', "mission.version"),
        (b'"version":1', b'"version":"1"', "mission.version"),
        (b'"version":1', b'"version":true', "mission.version"),
        (b'"version":1', b'"version":9007199254740992', "mission.version"),
        (b'"version":1', b'"version":1,"widen":true', "mission"),
        (b'"on_refusal":"hold"', b'"on_refusal":"go"', "mission.on_refusal"),
        (b'"rid":"courier-1"', b'"rid":"Courier-1"', "mission.rid"),
        (b'"nonce":"AAAAAAAAAAAAAAAAAAAAAA"', b'"nonce":"A"', "mission.nonce"),
        (
            b'"schema":"authguard-r/mission/2"',
            b'"schema":"authguard-r/mission/3"',
            "mission.schema",
        ),
    ]:
        with case(old, new, where):
            payload = encode(mission())
            assert payload.count(old) == 1
            refused(signed(payload.replace(old, new)), Reason.MALFORMED, where)


@pytest.mark.parametrize("payload", [b"", b"{}", b"null", b"\xff", b"[" * 9999])
def test_a_signed_payload_that_is_no_mission_is_malformed(payload: bytes) -> None:
    refused(signed(payload), Reason.MALFORMED, "mission")


def test_an_object_of_another_kind_is_opened_in_its_own_name() -> None:
    row = Row(object="package-p1")
    data = sign_object(row, Tag.SELECTION, signer())
    opened, hashed, by = open_token(
        data, Row, tag=Tag.SELECTION, roles=OPERATORS, verifier=trust(), now=scenarios.NOW
    )
    assert (opened, hashed, by.id) == (row, digest(Tag.SELECTION, encode(row)), "operator-1")
    broken = signed(b'{"object":0}', kind=Tag.SELECTION, tag=Tag.SELECTION)
    with pytest.raises(MalformedError) as caught:
        open_token(
            broken, Row, tag=Tag.SELECTION, roles=OPERATORS, verifier=trust(), now=scenarios.NOW
        )
    assert caught.value.where == "selection.object"


# -- anything at all -------------------------------------------------------------------------------


@settings(max_examples=amount(30, 150))
@given(st.binary(max_size=200))
def test_no_bytes_raise_anything_but_malformed(data: bytes) -> None:
    with pytest.raises(MalformedError):
        verified(data)


@settings(max_examples=amount(30, 150))
@given(st.data())
def test_no_change_of_a_token_s_bytes_is_accepted_or_raises_anything_else(
    data: st.DataObject,
) -> None:
    """Outside the certificates, which `unit/keys/test_certificate.py` changes byte by byte."""
    whole = sign_object(mission(), Tag.MISSION, signer())
    chain_end = whole.index(b'"signature"')
    at = data.draw(st.integers(chain_end, len(whole) - 2))
    change = data.draw(st.binary(max_size=3).filter(lambda new: new != whole[at : at + 1]))
    with pytest.raises(AuthGuardError):
        verified(whole[:at] + change + whole[at + 1 :])


# -- the schema ------------------------------------------------------------------------------------


def grants(number: int, **changes: Any) -> Mission:
    """Return the mission with one grant changed."""
    actions = list(mission().actions)
    actions[number] = replace(actions[number], **changes)
    return mission(actions=tuple(actions))


def row(**changes: Any) -> Mission:
    """Return the mission with the first row of its first grant changed."""
    first, *rest = mission().actions[0].alternatives
    return grants(0, alternatives=(replace(first, **changes), *rest))


def risk(**changes: Any) -> Mission:
    return mission(risk_policy=replace(mission().risk_policy, **changes))


LOW, HIGH = Limit(parameter="a_mm", low=0, high=9), Limit(parameter="b_mm", low=0, high=9)
EMPTY = Limit(parameter="a_mm", low=9, high=8)
NOT_BEFORE = "2030-01-01T00:00:00Z"

#: One entry for each rule under "Schema validity" in docs/spec/mission-language.md.
BROKEN: dict[str, tuple[Callable[[], Mission], str]] = {
    "task is not NFC": (lambda: mission(task="Cafe\u0301"), "task"),
    "version 1 supersedes": (lambda: mission(supersedes="A" * 43), "supersedes"),
    "version 2 supersedes nothing": (lambda: mission(version=2), "supersedes"),
    "ends before it begins": (
        lambda: mission(not_before="2030-01-01T00:00:01Z", expiry=NOT_BEFORE),
        "expiry",
    ),
    "tau_1 above tau_2": (lambda: risk(tau_1=61), "risk_policy.tau_2"),
    "objects not ascending": (lambda: mission(objects=("b", "a")), "objects"),
    "objects repeat": (lambda: mission(objects=("a", "a")), "objects"),
    "regions not ascending": (
        lambda: mission(regions=mission().regions[::-1]),
        "regions",
    ),
    "regions repeat": (lambda: mission(regions=("dock", "dock")), "regions"),
    "roles not ascending": (
        lambda: risk(roles=("supervisor", "safety_officer")),
        "risk_policy.roles",
    ),
    "roles repeat": (lambda: risk(roles=("supervisor",) * 2), "risk_policy.roles"),
    "after not ascending": (
        lambda: grants(0, after=("pick-p1", "go-home")),
        "actions[0].after",
    ),
    "after repeats": (lambda: grants(0, after=("pick-p1",) * 2), "actions[0].after"),
    "until not ascending": (
        lambda: grants(0, until=("pick-p1", "go-home")),
        "actions[0].until",
    ),
    "until repeats": (lambda: grants(0, until=("pick-p1",) * 2), "actions[0].until"),
    "closing not ascending": (
        lambda: mission(closing=Closing(grants=("pick-p1", "go-home"), for_ms=1)),
        "closing.grants",
    ),
    "closing repeats": (
        lambda: mission(closing=Closing(grants=("go-home",) * 2, for_ms=1)),
        "closing.grants",
    ),
    "a row's regions not ascending": (
        lambda: row(regions=("pharmacy", "dock")),
        "actions[0].alternatives[0].regions",
    ),
    "a row's regions repeat": (
        lambda: row(regions=("dock", "dock", "pharmacy")),
        "actions[0].alternatives[0].regions",
    ),
    "limits not ascending": (lambda: mission(limits=(HIGH, LOW)), "limits"),
    "limits repeat a parameter": (lambda: mission(limits=(LOW, LOW)), "limits"),
    "a limit is empty": (lambda: mission(limits=(EMPTY,)), "limits[0].high"),
    "a grant's limits not ascending": (
        lambda: grants(1, limits=(HIGH, LOW)),
        "actions[1].limits",
    ),
    "a grant's limits repeat": (lambda: grants(1, limits=(LOW, LOW)), "actions[1].limits"),
    "a grant's limit is empty": (
        lambda: grants(1, limits=(EMPTY, HIGH)),
        "actions[1].limits[0].high",
    ),
    "two grants of one id": (lambda: grants(0, id="look-out"), "actions"),
    "after names no grant": (lambda: grants(2, after=("nothing",)), "actions[2].after"),
    "until names no grant": (lambda: grants(2, until=("nothing",)), "actions[2].until"),
    "closing names no grant": (
        lambda: mission(closing=Closing(grants=("nothing",), for_ms=1)),
        "closing.grants",
    ),
    "after names itself": (lambda: grants(2, after=("go-to-101",)), "actions[2].id"),
    "until names itself": (lambda: grants(2, until=("go-to-101",)), "actions[2].id"),
    "fewer starts than successes": (lambda: grants(3, repeat=3, starts=2), "actions[3].starts"),
    "a row twice": (
        lambda: grants(1, alternatives=mission().actions[1].alternatives * 2),
        "actions[1].alternatives",
    ),
    "a row's source not among its regions": (
        lambda: row(regions=("pharmacy", "public-corridor")),
        "actions[0].alternatives[0].regions",
    ),
    "a row's destination not among its regions": (
        lambda: row(regions=("dock", "public-corridor")),
        "actions[0].alternatives[0].regions",
    ),
}

#: As near to the fault as a sound mission can be.
SOUND: dict[str, Callable[[], Mission]] = {
    "task in NFC": lambda: mission(task="Caf\u00e9"),
    "version 2 supersedes": lambda: mission(version=2, supersedes="A" * 43),
    "ends as it begins": lambda: mission(not_before=NOT_BEFORE, expiry=NOT_BEFORE),
    "tau_1 equals tau_2": lambda: risk(tau_1=60),
    "objects empty": lambda: mission(objects=()),
    "objects ascending": lambda: mission(objects=("a", "b")),
    "roles ascending": lambda: risk(roles=("a", "b")),
    "limits ascending": lambda: mission(limits=(LOW, HIGH)),
    "a limit of one value": lambda: mission(limits=(replace(LOW, high=0),)),
    "after two": lambda: grants(0, after=("go-home", "pick-p1"), until=()),
    "as many starts as successes": lambda: grants(3, repeat=2, starts=2),
    "rows that differ in one field": lambda: grants(
        1, alternatives=(Row(object="package-p1"), Row(object="package-p1", regions=("dock",)))
    ),
    "closing absent": lambda: mission(closing=None),
    "a guard more": lambda: mission(
        guards=(Guard(variable="x", comparison="eq", value=True, max_age_ms=0),) * 2
    ),
}


def test_a_signed_mission_that_breaks_one_rule_is_schema_invalid_in_its_place() -> None:
    for name, (make, where) in BROKEN.items():
        with case(name):
            refused(sign_object(make(), Tag.MISSION, signer()), Reason.SCHEMA_INVALID, where)


def test_a_signed_mission_that_just_keeps_the_rule_is_accepted() -> None:
    for name, make in SOUND.items():
        with case(name):
            value = make()
            assert verified(sign_object(value, Tag.MISSION, signer())).mission == value


def plain_mission(path: str, value: Any) -> bytes:
    """Return the mission's canonical bytes with the value at a path replaced."""
    whole = json.loads(encode(mission()))
    *steps, last = (int(step) if step.isdecimal() else step for step in path.split("."))
    inner = whole
    for step in steps:
        inner = inner[step]
    inner[last] = value
    return encode_fast(whole)


GRANT, ROW = (
    {
        "chooser": "planner",
        "data": {},
        "irreversible": False,
        "max_ms": 1,
        "repeat": 1,
        "starts": 1,
    },
    {"regions": ["a"]},
)
#: The last value that the types of docs/spec/mission-language.md allow, and the first that they
#: do not.
BOUNDS: dict[str, tuple[Any, Any]] = {
    "version": (1, 0),
    "mid": ("a" * 64, "a" * 65),
    "rid": ("0", ""),
    "issuer": ("a_.:-", "_a"),
    "profile": ("-_" * 21 + "A", "A" * 42),
    "site": ("A" * 43, "A" * 42 + "="),
    "nonce": ("_" * 22, "A" * 23),
    "task": ("x", ""),
    "place_max_age_ms": (0, -1),
    "on_refusal": ("ask", "retry"),
    "not_before": ("0001-01-01T00:00:00Z", "2030-01-01T00:00:00.5Z"),
    "expiry": ("9999-12-31T23:59:59Z", "2030-01-01T00:00:00+00:00"),
    "objects": ([], None),
    "guards": ([], {}),
    "risk_policy.t": (2, 1),
    "risk_policy.tau_2": (2**53 - 1, 2**53),
    "risk_policy.privacy": (0, -1),
    "risk_policy.valid_ms": (1, 0),
    "risk_policy.otherwise": (0, True),
    "risk_policy.roles": (["a"], []),
    "risk_policy.types": ({"a": 0}, {"a": -1}),
    "risk_policy.parameters.0.full_scale": (1, 0),
    "budgets.actions": (0, -1),
    "budgets.prompts": (0, "0"),
    "budgets.rate.count": (1, 0),
    "budgets.rate.per_ms": (1, 0),
    "closing.for_ms": (1, 0),
    "closing.grants": (["look-out"], []),
    "actions.0.repeat": (1, 0),
    "actions.0.starts": (1, 0),
    "actions.0.max_ms": (1, 0),
    "actions.0.chooser": ("planner", "model"),
    "actions.0.irreversible": (True, 1),
    "actions.0.limits.0.low": (-(2**53) + 1, -(2**53)),
    "guards.0.comparison": ("ne", "like"),
    "guards.0.value": ("nothing", "Nothing"),
    "guards.0.max_age_ms": (0, -1),
}


def test_each_field_of_a_mission_ends_where_its_type_ends() -> None:
    for path, values in BOUNDS.items():
        with case(path, values):
            last, beyond = values
            assert decode(plain_mission(path, last), Mission)
            with pytest.raises(MalformedError) as caught:
                decode(plain_mission(path, beyond), Mission)
            assert caught.value.reason is Reason.MALFORMED
            place = re.sub(r"\.(\d+)", r"[\1]", path)
            assert caught.value.where in {place, f"{place}[...]"}


def test_a_task_a_grant_list_and_a_row_list_end_at_their_longest() -> None:
    rows = [{"object": f"p{n}"} for n in range(257)]
    one = {**GRANT, "alternatives": [ROW], "tool": "y", "type": "x"}
    actions = [{**one, "id": f"g{n}"} for n in range(65)]
    for path, longest, beyond in (
        ("task", "x" * 2000, "x" * 2001),
        ("actions", actions[:64], actions),
        ("actions", actions[:1], []),
        ("actions.0.alternatives", rows[:256], rows),
        ("actions.0.alternatives", rows[:1], []),
        ("risk_policy.t", 64, 65),
    ):
        assert decode(plain_mission(path, longest), Mission)
        with pytest.raises(MalformedError) as caught:
            decode(plain_mission(path, beyond), Mission)
        assert caught.value.reason is Reason.MALFORMED


def test_what_a_grant_does_not_say_it_does_not_grant() -> None:
    """Absent never means anything (docs/spec/mission-language.md)."""
    bare = decode(
        b'{"alternatives":[{}],"chooser":"operator","data":{},"id":"a","irreversible":false,'
        b'"max_ms":1,"repeat":1,"starts":1,"tool":"b","type":"c"}',
        Grant,
    )
    assert (bare.data.record, bare.data.store, bare.data.transmit) == (False, False, False)
    assert (bare.limits, bare.guards, bare.after, bare.until, bare.done_when) == ((),) * 5
    assert bare.completes is False
    assert bare.alternatives == (Row(object=None, source=None, destination=None, regions=()),)
    for right in ("record", "store", "transmit"):
        given = decode(f'{{"{right}":true}}'.encode(), DataRights)
        assert [getattr(given, name) for name in ("record", "store", "transmit")].count(True) == 1


def test_what_was_verified_cannot_be_changed_afterwards() -> None:
    found = verified(sign_object(mission(), Tag.MISSION, signer()))
    for value, field in (
        (found, "expiry_ms"),
        (found.mission, "rid"),
        (found.mission.actions[0], "starts"),
        (found.mission.actions[0].alternatives[0], "destination"),
        (found.mission.limits[0], "high"),
        (found.mission.budgets, "actions"),
        (found.mission.risk_policy, "tau_1"),
        (found.issuer, "role"),
        (found.grants[0], "grant"),
        (token(), "payload"),
        (token().endorsements[0], "chain"),
    ):
        with pytest.raises(AttributeError):
            setattr(value, field, None)


def test_a_schema_fault_is_named_only_after_the_signature_held() -> None:
    """Paper order: a stranger learns nothing of the rules from an unsigned mission."""
    bad = mission(task="Cafe\u0301")
    genuine = token()
    data = encode_fast(replace(genuine, payload=b64(encode(bad))))
    refused(data, Reason.SIGNATURE_INVALID, "signature")
    data = sign_object(bad, Tag.MISSION, signer("operator-2"))
    refused(data, Reason.ISSUER_MISMATCH, "mission.issuer")


def test_an_authenticity_error_is_no_malformed_error() -> None:
    data = sign_object(mission(), Tag.MISSION, signer("operator-2"))
    assert isinstance(refused(data, Reason.ISSUER_MISMATCH, "mission.issuer"), AuthenticityError)
