# SPDX-License-Identifier: Apache-2.0
"""Tokens under one root and under two, and why each is refused."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from authguard_r.authoring.keys.setup import Member, demo_members, init_folder
from authguard_r.core.encoding import Tag, b64, digest, encode_fast
from authguard_r.core.mission import FIRST_SCHEMA, DataClass, ProtectedField
from authguard_r.core.provenance import Label, SourceField
from authguard_r.core.token import read_token, sign_object
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from fixtures import decision_cases, scenarios

Json = dict[str, Any]


def token_vectors() -> Json:
    """Tokens under roots that live for a century, and why each is refused."""
    with TemporaryDirectory() as name:
        folder = trust_set_up(Path(name) / "one")
        content = trust_parts(folder, tokens(folder))
        both = trust_set_up(Path(name) / "two", Algorithm.ED25519, Algorithm.ML_DSA_65)
        return {
            **content,
            "hybrid": trust_parts(both, hybrid_tokens(both)),
            "now_ms": scenarios.START_MS,
            "roles": ["operator", "safety_officer"],
            "raw_digest_of_authentic": digest(Tag.RAW, content["vectors"][0]["token"].encode()),
            "note": b64(b"keys are made anew at each generation; only the public parts are here"),
        }


def trust_set_up(folder: Path, *algorithms: Any) -> Path:
    """Make a trust folder in which one more operator is confined to a robot and its regions."""
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    operator, regions = Role.OPERATOR, scenarios.mission().regions
    members = (
        *demo_members(scenarios.site(), (scenarios.RID,)),
        Member(id="confined", role=operator, robots=(scenarios.RID,), regions=regions),
        Member(id="no-robot", role=operator, regions=regions),
        Member(id="another-robot", role=operator, robots=(scenarios.OTHER,), regions=regions),
        Member(id="one-region-less", role=operator, robots=(scenarios.RID,), regions=regions[1:]),
    )
    known: dict[str, Any] = {"algorithms": algorithms} if algorithms else {}
    init_folder(folder, members, now=begin, days=36_500, **known)
    return folder


def trust_parts(folder: Path, made: dict[str, tuple[str, str | None]]) -> Json:
    """Return the public parts of a trust folder with tokens for them."""
    lists = {p.stem: p.read_text() for p in sorted((folder / "revocations").glob("*.json"))}
    authorities = {p.stem: p.read_text() for p in sorted((folder / "authorities").glob("*.pem"))}
    return {
        "root": (folder / "root.pem").read_text(),
        "authorities": authorities,
        "revocations": lists,
        "vectors": [{"name": n, "token": t, "expect": e or "ok"} for n, (t, e) in made.items()],
    }


def signed_mission(folder: Path, by: str, **changes: Any) -> str:
    """Return the hospital's mission with another issuer, signed by it."""
    mission = decision_cases.set_(scenarios.mission(), **{"issuer": by, **changes})
    return sign_object(mission, Tag.MISSION, folder_signer(folder, by)).decode()


def newer() -> dict[str, Any]:
    """Return what only the second language has."""
    policy = scenarios.mission().risk_policy
    weights = {ProtectedField.DESTINATION: 6, ProtectedField.OBJECT: 4}
    return {
        "sources": {SourceField.ROUTE: (Label.MODEL, Label.OPERATOR)},
        "retention": {DataClass.EVIDENCE: 86_400_000},
        "risk_policy": decision_cases.set_(policy, field_weights=weights),
    }


def unsound() -> dict[str, Any]:
    """Return source sets that break a rule of the language."""
    return {
        "labels unsorted": {SourceField.ROUTE: (Label.OPERATOR, Label.MODEL)},
        "a label twice": {SourceField.ROUTE: (Label.MODEL, Label.MODEL)},
        "a recording that a model may permit": {SourceField.RECORDING: (Label.MODEL,)},
        "a position that a camera may tell": {SourceField.POSITION: (Label.CAMERA,)},
        "obstacles that nobody's sensor saw": {SourceField.STATE: (Label.OPERATOR,)},
        "thresholds of a sensor's": {SourceField.APPROVAL_THRESHOLD: (Label.TRUSTED_SENSOR,)},
    }


def tokens(folder: Path) -> dict[str, tuple[str, str | None]]:
    """Return tokens under one root."""
    operator = folder_signer(folder, "operator-1")
    good = signed_mission(folder, "operator-1")
    other = sign_object(scenarios.mission(), Tag.SELECTION, operator).decode()
    late = "2030-01-01T00:00:00Z"
    return {
        "authentic": (good, None),
        "signed by a supervisor": (signed_mission(folder, "supervisor-1"), "ROLE_DENIED"),
        "another issuer in the mission": (
            signed_mission(folder, "operator-1", issuer="operator-9"),
            "ISSUER_MISMATCH",
        ),
        "another kind": (other, "WRONG_KIND"),
        "another kind relabeled": (other.replace(Tag.SELECTION, Tag.MISSION), "SIGNATURE_INVALID"),
        "ends before it begins": (
            signed_mission(folder, "operator-1", not_before=late),
            "SCHEMA_INVALID",
        ),
        "with source sets, weights of fields and retention": (
            signed_mission(folder, "operator-1", **newer()),
            None,
        ),
        "of the first language": (signed_mission(folder, "operator-1", schema=FIRST_SCHEMA), None),
        **{
            f"of the first language, with {name}": (
                signed_mission(folder, "operator-1", schema=FIRST_SCHEMA, **{name: value}),
                "SCHEMA_INVALID",
            )
            for name, value in newer().items()
        },
        **{
            name: (signed_mission(folder, "operator-1", sources=sources), "SCHEMA_INVALID")
            for name, sources in unsound().items()
        },
        "a space": (good.replace('":', '": ', 1), "NOT_CANONICAL"),
        "cut off": (good[:-10], "MALFORMED"),
        "by an operator of this robot and these regions": (
            signed_mission(folder, "confined"),
            None,
        ),
        "by an operator of no robot": (signed_mission(folder, "no-robot"), "SIGNER_OUT_OF_SCOPE"),
        "by an operator of another robot": (
            signed_mission(folder, "another-robot"),
            "SIGNER_OUT_OF_SCOPE",
        ),
        "by an operator of one region less": (
            signed_mission(folder, "one-region-less"),
            "SIGNER_OUT_OF_SCOPE",
        ),
    }


def hybrid_tokens(folder: Path) -> dict[str, tuple[str, str | None]]:
    """Return tokens under two roots, which want a signature under each."""
    good = signed_mission(folder, "operator-1")
    whole = read_token(good.encode())
    first, second = whole.endorsements
    foreign = read_token(signed_mission(folder, "confined", issuer="operator-1").encode())

    def made_of(*endorsements: Any) -> str:
        return encode_fast(decision_cases.set_(whole, endorsements=endorsements)).decode()

    return {
        "authentic": (good, None),
        "the other way round": (made_of(second, first), None),
        "without the second signature": (made_of(first), "SIGNATURE_MISSING"),
        "without the first signature": (made_of(second), "SIGNATURE_MISSING"),
        "the first signature twice": (made_of(first, first), "SIGNATURE_MISSING"),
        "the signatures exchanged": (
            made_of(
                decision_cases.set_(first, signature=second.signature),
                decision_cases.set_(second, signature=first.signature),
            ),
            "SIGNATURE_INVALID",
        ),
        "the second signature of another principal": (
            made_of(first, foreign.endorsements[1]),
            "ISSUER_MISMATCH",
        ),
    }
