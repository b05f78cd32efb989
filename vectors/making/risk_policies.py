# SPDX-License-Identifier: Apache-2.0
"""The organization's policy as a signed token: taken with what it says, or refused."""

from __future__ import annotations

from typing import Any

from authguard_r.core.encoding import Tag, b64, digest, encode, unb64
from authguard_r.keys.certificate import Role
from authguard_r.keys.revocation import Revocation, sign_list
from fixtures import scenarios
from making.answers import BEGIN, DATES, DAY, TOP
from making.chains import authority, leaf
from unit.keys.chains import Held, eku

Json = dict[str, Any]

ROLES = (Role.SITE_AUTHORITY, Role.SAFETY_OFFICER, Role.OPERATOR)
SIGNERS = authority(TOP, ROLES, "signers of policies", subject="Policies", **DATES)


def signer(role: Role) -> Held:
    """Return somebody in a role."""
    name = str(role).replace("_", "-")
    return leaf(SIGNERS, name, f"{name} of policies", role=(eku(role), True), **DATES)


def token(said: Json, role: Role = Role.SITE_AUTHORITY, tag: Tag = Tag.RISK_POLICY) -> str:
    """Return a token over plain data, whatever it says."""
    held, payload = signer(role), encode(said)
    signature = held.key.sign(unb64(digest(tag, payload)))
    own = {"chain": [b64(held.der), b64(SIGNERS.der)], "signature": b64(signature)}
    return encode({"kind": str(tag), "payload": b64(payload), "endorsements": [own]}).decode()


def organization_vectors(policy: Json) -> Json:
    """Return tokens of an organization's policy under their root, with what each is taken for."""
    whole: Json = {
        "schema": "authguard-r/risk-policy/1",
        "organization": "hospital-trust",
        "version": 3,
        "issued": f"{BEGIN:%Y-%m-%dT%H:%M:%SZ}",
        "policy": policy,
    }

    def own(**changes: Any) -> Json:
        return {**whole, "policy": {**policy, **changes}}

    def without(field: str) -> Json:
        return {**whole, "policy": {k: v for k, v in policy.items() if k != field}}

    tokens: dict[str, tuple[str, str]] = {
        "of a site authority": (token(whole), "ok"),
        "of a safety officer": (token(whole, Role.SAFETY_OFFICER), "ok"),
        "of an operator": (token(whole, Role.OPERATOR), "ROLE_DENIED"),
        "signed as a mission": (token(whole, tag=Tag.MISSION), "WRONG_KIND"),
        "two thresholds that are one": (token(own(tau_1=60, tau_2=60)), "ok"),
        "thresholds out of order": (token(own(tau_1=61, tau_2=60)), "SCHEMA_INVALID"),
        "roles out of order": (token(own(roles=["supervisor", "operator"])), "SCHEMA_INVALID"),
        "a role twice": (token(own(roles=["operator", "operator"])), "SCHEMA_INVALID"),
        "no role": (token(own(roles=[])), "MALFORMED"),
        "a t of 2": (token(own(t=2)), "ok"),
        "a t of 1": (token(own(t=1)), "MALFORMED"),
        "a t of 64": (token(own(t=64)), "ok"),
        "a t of 65": (token(own(t=65)), "MALFORMED"),
        "a weight below zero": (token(own(types={"navigate": -1})), "MALFORMED"),
        "a request that never lives": (token(own(valid_ms=0)), "MALFORMED"),
        "a full scale of 0": (
            token(own(parameters=[{**policy["parameters"][0], "full_scale": 0}])),
            "MALFORMED",
        ),
        "without a second threshold": (token(without("tau_2")), "MALFORMED"),
        "a field more": (token(own(tau_3=90)), "MALFORMED"),
        "another schema": (
            token({**whole, "schema": "authguard-r/risk-policy/2"}),
            "MALFORMED",
        ),
        "the version 0": (token({**whole, "version": 0}), "MALFORMED"),
    }
    lists = {}
    for name, held in (("root", TOP), ("policies", SIGNERS)):
        revocation = Revocation(
            authority=name,
            number=1,
            issued=f"{BEGIN - DAY:%Y-%m-%dT%H:%M:%SZ}",
            next_update=f"{BEGIN + 20 * DAY:%Y-%m-%dT%H:%M:%SZ}",
            serials=(),
        )
        lists[name] = sign_list(revocation, held.key).decode()
    return {
        "root": b64(TOP.der),
        "authorities": {"policies": b64(SIGNERS.der)},
        "revocations": lists,
        "now_ms": scenarios.START_MS,
        "organization": [
            {"name": name, "token": text, "expect": expect}
            for name, (text, expect) in tokens.items()
        ],
    }
