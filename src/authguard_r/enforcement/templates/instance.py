# SPDX-License-Identifier: Apache-2.0
"""Instances: what a scheduler signs, held to its certificate and to the template it fills.

The scheduler adds no authority: its signature only picks, among missions that an operator's
signature covers, one to be carried out now. Spec page: docs/spec/template.md#instances
"""

from __future__ import annotations

from typing import Annotated, Protocol

from msgspec import Meta, Struct
from msgspec.structs import replace

from authguard_r.core.encoding import Tag, digest_of, unb64
from authguard_r.core.errors import AuthenticityError, AuthGuardError, RefusedError
from authguard_r.core.identifiers import Digest, MissionId, Timestamp
from authguard_r.core.mission import Mission
from authguard_r.core.principals import Principal, Signer, Verifier
from authguard_r.core.quantities import Now, to_ms
from authguard_r.core.reasons import Reason
from authguard_r.core.token import (
    VerifiedMission,
    index_mission,
    open_token,
    read_token,
    require_scope,
    sign_object,
)
from authguard_r.enforcement.templates.expansion import combinations, expand, filled, require_fill
from authguard_r.enforcement.templates.template import HoleName, Template, Value, require_sound

SCHEDULER_ROLES = frozenset({"scheduler"})


class Delegations(Verifier, Protocol):
    """A verifier that can also say which template a scheduler's certificate is bound to."""

    def scheduled_template(self, chain: tuple[bytes, ...], now: Now) -> Digest:
        """Return the digest of the one template that the chain's leaf may fill.

        Raises:
            AuthenticityError: the chain does not hold at `now`, or is not a scheduler's.
        """
        ...


class Instance(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One filling of a template, signed by its scheduler.

    Args:
        template: digest of the signed template.
        fill: a value for every hole.
        mid: the mission's name: the template's, a dot, and something fresh.
        nonce: 16 fresh random bytes.
        not_before: first second of the mission's validity.
        expiry: last instant of it.
    """

    template: Digest
    fill: dict[HoleName, Value]
    mid: MissionId
    nonce: Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_-]{22}\Z")]
    not_before: Timestamp
    expiry: Timestamp


class VerifiedTemplate(Struct, frozen=True, kw_only=True):
    """A template whose certificate, signature and rules hold; only `open_template` makes one.

    Args:
        template: as signed.
        digest: of its bytes.
        issuer: who signed it, and issues every mission of it.
    """

    template: Template
    digest: Digest
    issuer: Principal


class Instantiated(Struct, frozen=True, kw_only=True):
    """The mission of one instance; only `instantiate` makes one.

    Args:
        mission: as if the template's issuer had signed it.
        template: what it was made of.
        scheduler: who filled it.
    """

    mission: VerifiedMission
    template: VerifiedTemplate
    scheduler: Principal


def open_template(
    token: bytes, *, verifier: Verifier, now: Now, roles: frozenset[str]
) -> VerifiedTemplate:
    """Return the template in a token once its signature and its rules hold.

    Args:
        token: bytes from anyone.
        verifier: checks chain, revocation and signature.
        now: the instant at which certificates must be valid.
        roles: who may issue missions, and so templates.

    Raises:
        MalformedError: not a canonical template, or not sound.
        AuthenticityError: a certificate or signature does not hold, or the signer is not the
            issuer that its mission names.
    """
    template, hashed, signer = open_token(
        token, Template, tag=Tag.TEMPLATE, roles=roles, verifier=verifier, now=now
    )
    require_sound(template)
    first = filled(template, next(combinations(template)))
    if first.issuer != signer.id:
        raise AuthenticityError(
            f"expected the signature of `{first.issuer}`, got `{signer.id}`",
            reason=Reason.ISSUER_MISMATCH,
            where="template.mission.issuer",
        )
    return VerifiedTemplate(template=template, digest=hashed, issuer=signer)


def open_instance(token: bytes, *, verifier: Delegations, now: Now) -> tuple[Instance, Principal]:
    """Return an instance and its scheduler, whose every certificate is for this very template.

    Raises:
        MalformedError: not a canonical instance.
        AuthenticityError: a certificate or signature does not hold, or the certificate is bound to
            another template (`ROLE_DENIED`).
    """
    instance, _, signer = open_token(
        token, Instance, tag=Tag.INSTANCE, roles=SCHEDULER_ROLES, verifier=verifier, now=now
    )
    for number, endorsement in enumerate(read_token(token).endorsements):
        chain = tuple(unb64(der) for der in endorsement.chain)
        if verifier.scheduled_template(chain, now) != instance.template:
            raise AuthenticityError(
                f"expected the scheduler of template `{instance.template}`",
                reason=Reason.ROLE_DENIED,
                where=f"token.endorsements[{number}]",
            )
    return instance, signer


def instantiate(
    token: bytes, template: VerifiedTemplate, *, verifier: Delegations, now: Now
) -> Instantiated:
    """Return the mission that an instance token makes of its template.

    Args:
        token: the instance, from anyone.
        template: the template that the token must name.
        verifier: checks chains, revocation, signatures, and what the scheduler is bound to.
        now: the instant at which certificates must be valid.

    Raises:
        MalformedError: not a canonical instance, or its combination is no schema-valid mission.
        AuthenticityError: a certificate or signature does not hold, or is for another template.
        RefusedError: what it says is outside what the template's issuer signed.
    """
    instance, scheduler = open_instance(token, verifier=verifier, now=now)
    mission = covered(instance, template.template, template.digest)
    require_scope(mission, template.issuer)
    require_scope(mission, scheduler)
    # the mission ends with the first of both people's certificates
    until = min(template.issuer.usable_until_ms, scheduler.usable_until_ms)
    issuer = replace(template.issuer, usable_until_ms=until)
    verified = index_mission(mission, digest_of(Tag.MISSION, mission), issuer)
    return Instantiated(mission=verified, template=template, scheduler=scheduler)


def covered(instance: Instance, template: Template, hashed: Digest) -> Mission:
    """Return the mission that an instance makes of a sound template, once the template covers it.

    Args:
        instance: what is asked for; another part checks its signature.
        template: what was signed.
        hashed: the template's digest.

    Raises:
        MalformedError: its combination is no schema-valid mission.
        RefusedError: what it says is outside what was signed.
    """
    if instance.template != hashed:
        raise _outside(Reason.MISSION_UNKNOWN, "expected an instance of this template", "template")
    require_fill(template, instance.fill)
    below = f"{template.template}."
    if not instance.mid.startswith(below) or instance.mid == below:
        raise _outside(Reason.META_MISMATCH, f"expected a name that begins `{below}`", "mid")
    _require_window(instance, template)
    return expand(
        template,
        instance.fill,
        mid=instance.mid,
        nonce=instance.nonce,
        not_before=instance.not_before,
        expiry=instance.expiry,
    )


def _require_window(instance: Instance, template: Template) -> None:
    first = to_ms(instance.not_before, where="instance.not_before")
    last = to_ms(instance.expiry, where="instance.expiry")
    if last - first > template.for_ms:
        raise _outside(
            Reason.VALUE_OUT_OF_RANGE,
            f"expected at most {template.for_ms} ms of validity, got {last - first}",
            "expiry",
        )
    if last > to_ms(template.not_after, where="template.not_after"):
        raise _outside(Reason.EXPIRED, f"expected at most {template.not_after}", "expiry")


def _outside(reason: Reason, message: str, field: str) -> AuthGuardError:
    return RefusedError(message, reason=reason, where=f"instance.{field}")


def sign_instance(instance: Instance, signer: Signer) -> bytes:
    """Return the token of an instance."""
    return sign_object(instance, Tag.INSTANCE, signer)
