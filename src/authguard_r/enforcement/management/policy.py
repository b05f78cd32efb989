# SPDX-License-Identifier: Apache-2.0
"""The organization's risk policy over time: a gate refuses a policy older than one it has seen.

Spec page: docs/spec/approval.md#the-organizations-policy
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.audit.record import NONE
from authguard_r.core.encoding import encode_fast
from authguard_r.core.identifiers import Digest, Identifier, Positive
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.management.parts import entry, refuse
from authguard_r.store.transactions import Transaction, read_held

_KIND, _KEY = "risk-policy", "highest"
_WHERE = "risk-policy"


class SeenVersion(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The highest version that this gate has seen."""

    organization: Identifier
    version: Positive
    digest: Digest


def hold_policy(act: Transaction, policy: VerifiedPolicy | None) -> None:
    """Hold a policy as the highest that was seen; the same one again changes nothing.

    Raises:
        RefusedError: it may not be in force here; nothing was changed.
    """
    held = act.get(_KIND, _KEY)
    seen = None if held is None else read_held(held, SeenVersion, _KIND)
    if policy is None:
        if seen is not None:
            told = f"`{seen.organization}`'s policy, version {seen.version} or later"
            raise refuse(Reason.SUPERSEDED, f"expected {told}, got none", _WHERE)
        return
    own = policy.policy
    now = SeenVersion(organization=own.organization, version=own.version, digest=policy.digest)
    if seen is not None:
        if now == seen:
            return
        _require_newer(now, seen)
    act.put(_KIND, _KEY, encode_fast(now))
    opened: dict[str, object] = {
        "verb": "risk-policy",
        "by": policy.signer,
        "organization": own.organization,
        "version": own.version,
        "digest": policy.digest,
    }
    act.record(entry(act, NONE, opened, {"token": policy.token}))


def _require_newer(now: SeenVersion, seen: SeenVersion) -> None:
    if now.organization != seen.organization:
        told = f"expected the policy of `{seen.organization}`, got `{now.organization}`'s"
        raise refuse(Reason.ISSUER_MISMATCH, told, f"{_WHERE}.organization")
    if now.version < seen.version:
        told = f"expected version {seen.version} or later, got {now.version}"
        raise refuse(Reason.SUPERSEDED, told, f"{_WHERE}.version")
    if now.version == seen.version:
        told = f"version {seen.version} was another policy before; a change is a new version"
        raise refuse(Reason.SUPERSEDED, told, f"{_WHERE}.version")
