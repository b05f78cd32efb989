# SPDX-License-Identifier: Apache-2.0
"""Tokens: canonical bytes with the signatures over them, and the missions they prove.

A token carries bytes, not an object. They are verified as bytes, decoded, encoded again and
compared; only then is there a `VerifiedMission`. The algorithm comes from the certificate, never
from the token. Source: `eq:signature`, `alg:authguard` steps 1 to 3. Spec page: docs/spec/token.md
"""

from __future__ import annotations

from typing import Annotated, TypeVar

from msgspec import Meta, Struct

from authguard_r.core.encoding import Tag, b64, decode, digest, encode_fast, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import ActionType, Digest, ObjectId, ParameterId, RegionId
from authguard_r.core.mission import Grant, Limit, Mission, require_schema
from authguard_r.core.principals import Endorsed, Principal, Signer, Verifier
from authguard_r.core.provenance import AllowedSources, allowed_of
from authguard_r.core.quantities import Now, to_ms
from authguard_r.core.reasons import Reason

T = TypeVar("T")


class Endorsement(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One signature and the certificates that say whose it is.

    Args:
        chain: leaf certificate, then its role authority's, DER in base64url.
        signature: over the 32 bytes of the payload's digest under the token's tag.
    """

    chain: Annotated[tuple[str, ...], Meta(min_length=2, max_length=2)]
    signature: str


class Token(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """T = (M, sigma, cert_U), for every kind of signed object.

    Args:
        kind: the tag that the signatures are bound to.
        payload: the canonical bytes, base64url.
        endorsements: at least one; each must verify.
    """

    kind: Tag
    payload: str
    endorsements: Annotated[tuple[Endorsement, ...], Meta(min_length=1, max_length=4)]


class IndexedGrant(Struct, frozen=True):
    """A grant with its limits keyed by parameter, and what its rows say of object and places."""

    grant: Grant
    limits: dict[ParameterId, Limit]
    rows: frozenset[tuple[str | None, str | None, str | None]]


class VerifiedMission(Struct, frozen=True, kw_only=True):
    """A mission whose certificate, signature and schema hold; steps 1 to 3 are behind it.

    The type is the proof: only `verify_mission` makes one. Whether it is in time, active and for
    this robot is decided anew for every action.
    """

    mission: Mission
    digest: Digest
    issuer: Principal
    not_before_ms: int
    expiry_ms: int
    objects: frozenset[ObjectId]
    regions: frozenset[RegionId]
    limits: dict[ParameterId, Limit]
    sources: AllowedSources
    grants: tuple[IndexedGrant, ...]
    by_type: dict[ActionType, tuple[int, ...]]


def read_token(data: bytes) -> Token:
    """Return the token that the bytes spell.

    Raises:
        MalformedError: they spell none.
    """
    return decode(data.removesuffix(b"\n"), Token, where="token")


def open_token(
    data: bytes, kind: type[T], *, tag: Tag, roles: frozenset[str], verifier: Verifier, now: Now
) -> tuple[T, Digest, Principal]:
    """Return the object in a token once every signature over it holds.

    Args:
        data: the token's bytes, from anyone.
        kind: the struct inside.
        tag: the one tag that is accepted here.
        roles: roles that may sign this kind.
        verifier: checks chain, revocation and signature.
        now: the instant at which certificates must be valid.

    Raises:
        MalformedError: not a canonical token of this kind.
        AuthenticityError: a certificate or signature does not hold, or the role may not sign this.
    """
    token = read_token(data)
    if token.kind is not tag:
        text = f"expected a token of kind `{tag}`, got `{token.kind}`"
        raise MalformedError(text, where="token.kind", reason=Reason.WRONG_KIND)
    payload = unb64(token.payload, where="token.payload")
    hashed = digest(tag, payload)
    endorsements = tuple(
        _opened(endorsement, where=f"token.endorsements[{number}]")
        for number, endorsement in enumerate(token.endorsements)
    )
    # (1) the certificates, (2) the signatures
    signer = verifier.verify(unb64(hashed), endorsements, now)
    if signer.role not in roles:
        text = f"expected a signer in a role of {', '.join(sorted(roles))}, got `{signer.role}`"
        raise AuthenticityError(text, reason=Reason.ROLE_DENIED, where="token.endorsements")
    return decode(payload, kind, where=str(tag).split("/")[1]), hashed, signer


def _opened(endorsement: Endorsement, *, where: str) -> Endorsed:
    chain = tuple(unb64(certificate, where=f"{where}.chain") for certificate in endorsement.chain)
    return chain, unb64(endorsement.signature, where=f"{where}.signature")


def verify_mission(
    data: bytes, *, verifier: Verifier, now: Now, roles: frozenset[str]
) -> VerifiedMission:
    """Return the mission in a token after steps 1 to 3 of `alg:authguard` (time apart).

    Raises:
        MalformedError: not canonical, or `SCHEMA_INVALID`.
        AuthenticityError: a certificate or signature does not hold, or the signer is not the
            issuer that the mission names.
    """
    mission, hashed, signer = open_token(
        data, Mission, tag=Tag.MISSION, roles=roles, verifier=verifier, now=now
    )
    if mission.issuer != signer.id:
        text = f"expected the signature of `{mission.issuer}`, got `{signer.id}`"
        raise AuthenticityError(text, reason=Reason.ISSUER_MISMATCH, where="mission.issuer")
    require_scope(mission, signer)
    # (3) the schema
    require_schema(mission)
    return index_mission(mission, hashed, signer)


def require_scope(mission: Mission, signer: Principal) -> None:
    """Require that the mission's robot and regions lie inside its signer's certificate.

    Raises:
        AuthenticityError: `SIGNER_OUT_OF_SCOPE`.
    """
    if not signer.scope.covers(mission.rid, mission.regions):
        where = "mission.regions" if signer.scope.covers(mission.rid) else "mission.rid"
        text = "expected a robot and regions that the signer's certificate names"
        raise AuthenticityError(text, reason=Reason.SIGNER_OUT_OF_SCOPE, where=where)


def index_mission(mission: Mission, hashed: Digest, issuer: Principal) -> VerifiedMission:
    """Return the mission with its sets and limits keyed for look-up; checks nothing."""
    grants = tuple(
        IndexedGrant(
            grant,
            {limit.parameter: limit for limit in grant.limits},
            frozenset((row.object, row.source, row.destination) for row in grant.alternatives),
        )
        for grant in mission.actions
    )
    by_type: dict[ActionType, tuple[int, ...]] = {}
    for place, grant in enumerate(mission.actions):
        by_type[grant.type] = (*by_type.get(grant.type, ()), place)
    return VerifiedMission(
        mission=mission,
        digest=hashed,
        issuer=issuer,
        not_before_ms=to_ms(mission.not_before, where="mission.not_before"),
        expiry_ms=to_ms(mission.expiry, where="mission.expiry"),
        objects=frozenset(mission.objects),
        regions=frozenset(mission.regions),
        limits={limit.parameter: limit for limit in mission.limits},
        sources=allowed_of(mission.sources),
        grants=grants,
        by_type=by_type,
    )


def sign_object(value: object, tag: Tag, signer: Signer) -> bytes:
    """Return a token over the object's canonical bytes, with a final newline for files."""
    payload = encode_fast(decode(encode_fast(value), type(value)))  # what none reads, none signs
    endorsements = tuple(
        Endorsement(chain=tuple(b64(der) for der in chain), signature=b64(signature))
        for chain, signature in signer.endorse(unb64(digest(tag, payload)))
    )
    token = Token(kind=tag, payload=b64(payload), endorsements=endorsements)
    return encode_fast(token) + b"\n"
