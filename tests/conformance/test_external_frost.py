# SPDX-License-Identifier: Apache-2.0
"""FROST(Ed25519, SHA-512) against the trace of RFC 9591 appendix E.1, byte for byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from authguard_r.core.encoding import unb64
from authguard_r.core.identifiers import PrincipalId
from authguard_r.frost import curve, signing
from authguard_r.frost.keys import Dealt, deal, public_key, require_share

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"
TRACE = EXTERNAL / "frost" / "frost-ed25519-sha512.json"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]


@pytest.fixture(scope="module")
def trace() -> Any:
    return json.loads(TRACE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def dealt(trace: Any) -> Dealt:
    inputs = trace["inputs"]
    secret = (inputs["group_secret_key"], *inputs["share_polynomial_coefficients"])
    return deal(
        PrincipalId("group"),
        (PrincipalId("one"), PrincipalId("two"), PrincipalId("three")),
        threshold=int(trace["config"]["MIN_PARTICIPANTS"]),
        coefficients=tuple(curve.Scalar(bytes.fromhex(item)) for item in secret),
    )


def test_the_dealer_gives_the_shares_and_the_key_of_the_trace(trace: Any, dealt: Dealt) -> None:
    told = trace["inputs"]
    assert public_key(dealt.group).hex() == told["group_public_key"]
    assert [
        {"identifier": share.identifier, "participant_share": unb64(share.secret).hex()}
        for share in dealt.shares
    ] == told["participant_shares"]
    for share in dealt.shares:
        require_share(share)


def test_both_rounds_give_the_numbers_of_the_trace(trace: Any, dealt: Dealt) -> None:
    first = trace["round_one_outputs"]["outputs"]
    assert [item["identifier"] for item in first] == trace["inputs"]["participant_list"]
    ready = {}
    for item in first:
        share = dealt.shares[item["identifier"] - 1]
        drawn = (
            bytes.fromhex(item["hiding_nonce_randomness"]),
            bytes.fromhex(item["binding_nonce_randomness"]),
        )
        nonces = signing.new_nonces(share, randomness=drawn)
        assert unb64(nonces.hiding).hex() == item["hiding_nonce"]
        assert unb64(nonces.binding).hex() == item["binding_nonce"]
        made = nonces.commitment
        assert unb64(made.hiding).hex() == item["hiding_nonce_commitment"]
        assert unb64(made.binding).hex() == item["binding_nonce_commitment"]
        ready[share.identifier] = nonces
    message = bytes.fromhex(trace["inputs"]["message"])
    session = signing.begin(dealt.group, tuple(n.commitment for n in ready.values()), message)
    assert [factor.hex() for factor in session.factors] == [i["binding_factor"] for i in first]

    parts = [signing.sign(session, dealt.shares[place - 1], n) for place, n in ready.items()]
    told = trace["round_two_outputs"]["outputs"]
    assert [
        {"identifier": part.identifier, "sig_share": unb64(part.share).hex()} for part in parts
    ] == told
    for part in parts:
        signing.verify_share(session, part)
    made_signature = signing.aggregate(session, tuple(parts))
    assert made_signature.hex() == trace["final_output"]["sig"]
    Ed25519PublicKey.from_public_bytes(public_key(dealt.group)).verify(made_signature, message)


def test_the_binding_factors_come_from_the_inputs_of_the_trace(trace: Any) -> None:
    for item in trace["round_one_outputs"]["outputs"]:
        hashed = curve.h1(bytes.fromhex(item["binding_factor_input"]))
        assert hashed.hex() == item["binding_factor"]
