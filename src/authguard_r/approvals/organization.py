# SPDX-License-Identifier: Apache-2.0
"""The organization's own risk policy: what no operator can sign away.

It sits beside every mission's policy and the stricter of the two counts (`core.checks.approval`).
A gate holds the highest version that it has seen, so an older one does not come back.
Spec page: docs/spec/approval.md#the-organizations-policy
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest, Identifier, Positive, Timestamp
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token

#: Who may say what the organization demands.
POLICY_ROLES = frozenset({"safety_officer", "site_authority"})


class OrganizationPolicy(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What an organization demands of every action of its robots.

    Args:
        schema: version of this format.
        organization: whose policy it is.
        version: grows with every change; a gate takes none that is lower than it has seen.
        issued: when it was made; explains, decides nothing.
        policy: weights, thresholds and roles, as a mission's.
    """

    schema: Literal["authguard-r/risk-policy/1"]
    organization: Identifier
    version: Positive
    issued: Timestamp
    policy: RiskPolicy


class VerifiedPolicy(Struct, frozen=True, kw_only=True):
    """A policy whose signature holds. Made by `open_policy` only.

    Args:
        policy: what it says.
        digest: what was signed.
        signer: whose signature it is.
        token: the bytes that it came in.
    """

    policy: OrganizationPolicy
    digest: Digest
    signer: Identifier
    token: str


def require_sound_policy(policy: OrganizationPolicy) -> OrganizationPolicy:
    """Return the policy, once its thresholds are in order and its roles sorted and unique.

    Raises:
        MalformedError: they are not.
    """
    own = policy.policy
    if own.tau_1 > own.tau_2:
        raise _unsound("expected tau_1 <= tau_2", "risk-policy.policy.tau_1")
    if list(own.roles) != sorted(set(own.roles)):
        raise _unsound("expected roles sorted and unique", "risk-policy.policy.roles")
    return policy


def policy_digest(policy: OrganizationPolicy) -> Digest:
    """Return the digest under which gate and log name the policy."""
    return digest_of(Tag.RISK_POLICY, policy)


def open_policy(data: bytes, *, verifier: Verifier, now: Now) -> VerifiedPolicy:
    """Return the policy in a token signed by a site authority or a safety officer.

    Raises:
        MalformedError: no canonical policy, or one that is not sound.
        AuthenticityError: certificate, signature or role does not hold.
    """
    policy, digest, signer = open_token(
        data,
        OrganizationPolicy,
        tag=Tag.RISK_POLICY,
        roles=POLICY_ROLES,
        verifier=verifier,
        now=now,
    )
    return VerifiedPolicy(
        policy=require_sound_policy(policy),
        digest=digest,
        signer=signer.id,
        token=data.decode("ascii").strip(),
    )


def _unsound(message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.SCHEMA_INVALID)
