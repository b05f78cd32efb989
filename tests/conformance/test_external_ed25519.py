# SPDX-License-Identifier: Apache-2.0
"""Ed25519 against vectors that nobody here wrote: Wycheproof, and RFC 8032 section 7.1."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import require_signature
from authguard_r.keys.ed25519 import public_key

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]


def read(name: str) -> Any:
    return json.loads((EXTERNAL / name).read_text(encoding="utf-8"))


def verdict(key: bytes, message: bytes, signature: bytes) -> Reason | None:
    """Return why our verification refuses, None when it accepts; nothing else may leave it."""
    try:
        require_signature(public_key(key, where="key"), signature, message, where="signature")
    except AuthenticityError as error:
        return error.reason
    return None


def test_our_verification_agrees_with_all_151_wycheproof_vectors() -> None:
    """`valid` is accepted, `invalid` refused, and the reason is the signature's.

    This set holds no `acceptable` vector; were there one, we would refuse it, because a
    signature that only some verifiers accept must not decide authority.
    """
    wrong: list[str] = []
    seen: Counter[tuple[str, Reason | None]] = Counter()
    for group in read("wycheproof/ed25519_test.json")["testGroups"]:
        key = bytes.fromhex(group["publicKey"]["pk"])
        for test in group["tests"]:
            found = verdict(key, bytes.fromhex(test["msg"]), bytes.fromhex(test["sig"]))
            seen[test["result"], found] += 1
            if (found is None) != (test["result"] == "valid"):
                wrong.append(f"tcId {test['tcId']} {test['comment']}: {found}")
    assert wrong == []
    assert seen == {("valid", None): 88, ("invalid", Reason.SIGNATURE_INVALID): 63}


def test_every_wycheproof_key_enters_as_the_raw_key_in_its_der() -> None:
    """The keys of the set are sound, so a refusal above is never the key's."""
    for group in read("wycheproof/ed25519_test.json")["testGroups"]:
        raw = bytes.fromhex(group["publicKey"]["pk"])
        key = public_key(raw, where="key")
        assert key.public_bytes(Encoding.Raw, PublicFormat.Raw) == raw
        der = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
        assert der.hex() == group["publicKeyDer"]


def test_a_valid_vector_holds_for_no_other_message_key_or_signature() -> None:
    """Cross over: each valid signature is held against the next valid vector's message and key."""
    valid = [
        (
            bytes.fromhex(group["publicKey"]["pk"]),
            bytes.fromhex(test["msg"]),
            bytes.fromhex(test["sig"]),
        )
        for group in read("wycheproof/ed25519_test.json")["testGroups"]
        for test in group["tests"]
        if test["result"] == "valid"
    ]
    for (key, message, signature), (other_key, other_message, other_signature) in zip(
        valid, valid[1:] + valid[:1], strict=True
    ):
        assert verdict(key, message, signature) is None
        if signature != other_signature:
            assert verdict(key, message, other_signature) is Reason.SIGNATURE_INVALID
        if key != other_key:
            assert verdict(other_key, message, signature) is Reason.SIGNATURE_INVALID
        if message != other_message:
            assert verdict(key, other_message, signature) is Reason.SIGNATURE_INVALID


@pytest.mark.parametrize("number", [0, 1, 2], ids=["TEST 1", "TEST 2", "TEST 3"])
def test_rfc_8032_seeds_give_its_keys_and_signatures_byte_for_byte(number: int) -> None:
    vector = read("rfc8032/vectors.json")[number]
    key = Ed25519PrivateKey.from_private_bytes(bytes.fromhex(vector["seed"]))
    raw = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    message = bytes.fromhex(vector["msg"])
    assert raw.hex() == vector["pk"]
    assert key.sign(message).hex() == vector["sig"]
    assert verdict(raw, message, bytes.fromhex(vector["sig"])) is None
