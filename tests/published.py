# SPDX-License-Identifier: Apache-2.0
"""Reads what the published vectors share: trust, facts and states, for whoever is held to them."""

from __future__ import annotations

import json
from typing import Any

import msgspec
from cryptography import x509

import worlds
from authguard_r.core.encoding import unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.facts import ActionKind, ParameterKind, RegionFacts, RobotFacts, SiteFacts
from authguard_r.core.geometry import polygon
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.keys.algorithms import require_sound
from authguard_r.keys.revocation import read_list
from authguard_r.keys.trust import Trust

Json = dict[str, Any]


def load(name: str) -> Json:
    """Return a file of vectors."""
    content: Json = json.loads((worlds.ROOT / "vectors" / name).read_text())
    return content


def named(vector: Json) -> str:
    """Return what a vector is about."""
    return str(vector["name"])


def refusal(error: AuthGuardError) -> Json:
    """Return a refusal as vectors have it."""
    return {"reason": str(error.reason), "where": error.where}


def trust_in(content: Json) -> Trust:
    """Return the trust in a file's root, authorities and lists, all of them DER."""
    root = x509.load_der_x509_certificate(unb64(content["root"]))
    certificates = {"root": content["root"], **content["authorities"]}
    lists = {}
    for name, der in certificates.items():
        key = x509.load_der_x509_certificate(unb64(der)).public_key()
        data = content["revocations"][name].encode()
        lists[unb64(der)] = read_list(data, authority=name, key=require_sound(key, where=name))
    return Trust((root,), lists)


def facts_from(plain: dict[str, Any]) -> SiteFacts:
    """Read facts from the specification's shape."""
    robot = plain["robot"]
    return SiteFacts(
        digest=plain["digest"],
        robot=RobotFacts(
            rid=robot["rid"],
            profile=robot["profile"],
            tools={kind: frozenset(tools) for kind, tools in robot["tools"].items()},
        ),
        regions={
            name: RegionFacts(
                polygon(r["map"], r["floor"], tuple(tuple(p) for p in r["points"])),
                frozenset(r["tags"]),
                frozenset(r.get("around", ())),
            )
            for name, r in plain["regions"].items()
        },
        objects=plain["objects"],
        vocabulary={
            name: ActionKind(
                fields=frozenset(kind["fields"]),
                params={p: msgspec.convert(v, ParameterKind) for p, v in kind["params"].items()},
                **{k: v for k, v in kind.items() if k not in {"fields", "params"}},
            )
            for name, kind in plain["vocabulary"].items()
        },
        risk=tuple(msgspec.convert(policy, RiskPolicy) for policy in plain.get("risk", ())),
    )


def attested(plain: Json | None, facts: SiteFacts) -> AttestedState | None:
    """Return a state as the gate has it after its arrival."""
    if plain is None:
        return None
    snapshot = msgspec.convert(plain["snapshot"], Snapshot)
    return attest(snapshot, facts, arrived_mono_ms=plain["arrived_mono_ms"])
