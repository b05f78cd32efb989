# SPDX-License-Identifier: Apache-2.0
"""A policy that counts: signed, narrow, in time, and of this robot at this site.

Spec page: docs/spec/emergency.md#policy
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import Digest, PrincipalId, RobotId
from authguard_r.core.principals import Principal, Verifier
from authguard_r.core.quantities import Now, to_ms
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.enforcement.emergency.lint import lint_policy
from authguard_r.enforcement.emergency.policy import EmergencyPolicy
from authguard_r.site.model import Site, profile_digest, site_digest

POLICY_ROLES = frozenset({"safety_officer"})


class OpenedPolicy(Struct, frozen=True, kw_only=True):
    """A policy whose signature and lint hold; only `open_emergency` makes one.

    Whether it is in time, and its signer not revoked, is decided anew for every call.

    Args:
        policy: what was signed.
        token: the bytes that it came in.
        at: the instant at which its certificates held.
        digest: of the policy.
        signer: the safety officer.
        not_before_ms: when it begins.
        expiry_ms: when it ends.
    """

    policy: EmergencyPolicy
    token: bytes
    at: Now
    digest: Digest
    signer: PrincipalId
    not_before_ms: int
    expiry_ms: int


def open_emergency(
    data: bytes, *, verifier: Verifier, now: Now, site: Site, robot: RobotId
) -> OpenedPolicy:
    """Return the policy in a token signed by a safety officer.

    Args:
        data: the token, from anyone.
        verifier: certificates and signatures.
        now: the instant at which they, and the policy, must be valid.
        site: the signed site.
        robot: the robot in the gate's certificate.

    Raises:
        MalformedError: no canonical policy, another robot's, or not narrow.
        AuthenticityError: certificate, signature, role or scope does not hold, or it is over.
    """
    policy, hashed, signer = _open(data, verifier, now)
    _require_own(policy, site, robot)
    _require_scope(policy, signer)
    for unsound in lint_policy(policy, site):
        raise MalformedError(unsound.message, where=unsound.where, reason=Reason.SCHEMA_INVALID)
    opened = OpenedPolicy(
        policy=policy,
        token=data,
        at=now,
        digest=hashed,
        signer=signer.id,
        not_before_ms=to_ms(policy.not_before, where="emergency.not_before"),
        expiry_ms=to_ms(policy.expiry, where="emergency.expiry"),
    )
    _require_time(opened, now)
    return opened


def require_signer(opened: OpenedPolicy, *, verifier: Verifier) -> None:
    """Require that the signer was not revoked since the policy was opened.

    By the lists of now and the dates of then: a certificate that ended since, or a list that is
    past its next update, says nothing against a policy whose own end is signed.

    Raises:
        AuthenticityError: a certificate is on a list (`CERTIFICATE_REVOKED`).
    """
    _open(opened.token, verifier, opened.at)


def _open(data: bytes, verifier: Verifier, now: Now) -> tuple[EmergencyPolicy, Digest, Principal]:
    return open_token(
        data,
        EmergencyPolicy,
        tag=Tag.EMERGENCY_POLICY,
        roles=POLICY_ROLES,
        verifier=verifier,
        now=now,
    )


def _require_own(policy: EmergencyPolicy, site: Site, robot: RobotId) -> None:
    profile = site.robots[robot].profile if robot in site.robots else None
    bound = (
        ("robot", policy.robot, robot, Reason.ROBOT_MISMATCH),
        ("site", policy.site, site_digest(site), Reason.SITE_MISMATCH),
        (
            "profile",
            policy.profile,
            None if profile is None else profile_digest(profile),
            Reason.PROFILE_MISMATCH,
        ),
    )
    for field, got, wanted, reason in bound:
        if got != wanted:
            raise MalformedError(
                f"expected the policy of `{wanted}`, got `{got}`'s",
                where=f"emergency.{field}",
                reason=reason,
            )


def _require_scope(policy: EmergencyPolicy, signer: Principal) -> None:
    """Require a robot and regions that the signer's certificate names."""
    named = [region for c in policy.capabilities for region in c.regions]
    named += [c.destination for c in policy.capabilities if c.destination is not None]
    if not signer.scope.covers(policy.robot, named):
        field = "capabilities" if signer.scope.covers(policy.robot) else "robot"
        raise AuthenticityError(
            "expected a robot and regions that the signer's certificate names",
            reason=Reason.SIGNER_OUT_OF_SCOPE,
            where=f"emergency.{field}",
        )


def _require_time(opened: OpenedPolicy, now: Now) -> None:
    if now.utc_ms > opened.expiry_ms:
        raise AuthenticityError(
            f"the policy ended at {opened.policy.expiry}",
            reason=Reason.EXPIRED,
            where="emergency.expiry",
        )
    if now.utc_ms < opened.not_before_ms:
        raise AuthenticityError(
            f"the policy begins at {opened.policy.not_before}",
            reason=Reason.NOT_YET_VALID,
            where="emergency.not_before",
        )
