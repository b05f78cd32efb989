# SPDX-License-Identifier: Apache-2.0
"""ML-DSA against vectors that nobody here wrote: Wycheproof, and NIST's key generation.

A vector with a context that is not empty is of another protocol: our signatures have none, so we
refuse also those of them that are `valid`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.mldsa import (
    MLDSA44PrivateKey,
    MLDSA44PublicKey,
    MLDSA65PrivateKey,
    MLDSA65PublicKey,
    MLDSA87PrivateKey,
    MLDSA87PublicKey,
)
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import PrivateKey, PublicKey, require_signature, require_sound

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"
PUBLIC: dict[int, Callable[[bytes], PublicKey]] = {
    44: MLDSA44PublicKey.from_public_bytes,
    65: MLDSA65PublicKey.from_public_bytes,
    87: MLDSA87PublicKey.from_public_bytes,
}
PRIVATE: dict[int, Callable[[bytes], PrivateKey]] = {
    44: MLDSA44PrivateKey.from_seed_bytes,
    65: MLDSA65PrivateKey.from_seed_bytes,
    87: MLDSA87PrivateKey.from_seed_bytes,
}
#: Vectors without a context by what is published: valid, invalid.
COUNTS = {44: (75, 98), 65: (77, 126), 87: (69, 165)}

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]
each = pytest.mark.parametrize("size", PUBLIC)


def read(name: str) -> Any:
    return json.loads((EXTERNAL / name).read_text(encoding="utf-8"))


def groups(size: int) -> list[tuple[bytes, Any]]:
    published = read(f"wycheproof/mldsa_{size}_verify_test.json")["testGroups"]
    return [(bytes.fromhex(group["publicKey"]), group) for group in published]


def key_of(size: int, raw: bytes) -> PublicKey | None:
    """Return the key, None when the library has none for these bytes."""
    try:
        return PUBLIC[size](raw)
    except ValueError:
        return None


def holds(key: PublicKey | None, test: Any) -> bool:
    """Return whether we take the vector; nothing but a refusal may leave the check."""
    if key is None:
        return False
    try:
        require_signature(key, bytes.fromhex(test["sig"]), bytes.fromhex(test["msg"]), where="here")
    except AuthenticityError as error:
        return error.reason is not Reason.SIGNATURE_INVALID
    return True


@each
def test_our_verification_agrees_with_every_wycheproof_vector_without_a_context(size: int) -> None:
    wrong: list[str] = []
    seen: Counter[str] = Counter()
    for raw, group in groups(size):
        key = key_of(size, raw)
        for test in group["tests"]:
            if test.get("ctx"):
                continue
            seen[test["result"]] += 1
            if holds(key, test) != (test["result"] == "valid"):
                wrong.append(f"tcId {test['tcId']} {test['comment']}")
    assert wrong == []
    assert (seen["valid"], seen["invalid"]) == COUNTS[size]


@each
def test_no_vector_with_a_context_holds(size: int) -> None:
    with_one = [
        (key_of(size, raw), test)
        for raw, group in groups(size)
        for test in group["tests"]
        if test.get("ctx")
    ]
    assert {test["result"] for _, test in with_one} == {"valid", "invalid"}
    assert not any(holds(key, test) for key, test in with_one)


@each
def test_every_wycheproof_key_enters_but_those_that_are_zero_or_of_another_length(
    size: int,
) -> None:
    """A key with t1 = 0 is no fault of verification, says the set; it is one of the key (L15)."""
    zeros = 0
    for raw, group in groups(size):
        key = key_of(size, raw)
        flags = {flag for test in group["tests"] for flag in test["flags"]}
        assert (key is None) == ("IncorrectPublicKeyLength" in flags)
        if key is None:
            continue
        der = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
        assert der.hex() == group["publicKeyDer"]
        if "ZeroPublicKey" not in flags:
            assert require_sound(key, where="key") is key
            continue
        zeros += 1
        with pytest.raises(AuthenticityError) as caught:
            require_sound(key, where="key")
        assert caught.value.reason is Reason.KEY_INVALID
    assert zeros >= 1


@each
def test_a_valid_vector_holds_for_no_other_key_or_message(size: int) -> None:
    valid = [
        (key_of(size, raw), test)
        for raw, group in groups(size)
        for test in group["tests"]
        if test["result"] == "valid" and not test.get("ctx")
    ]
    for (key, test), (other_key, other) in zip(valid, valid[1:] + valid[:1], strict=True):
        assert holds(key, test)
        if other["msg"] != test["msg"]:
            assert not holds(key, {**test, "msg": other["msg"]})
        if other_key != key:
            assert not holds(other_key, test)


@each
def test_nist_s_seeds_give_the_published_public_keys(size: int) -> None:
    published = read("rustcrypto_mldsa_acvp/key-gen.json")["testGroups"]
    (group,) = [found for found in published if found["parameterSet"] == f"ML-DSA-{size}"]
    assert len(group["tests"]) == 25
    for test in group["tests"]:
        key = PRIVATE[size](bytes.fromhex(test["seed"]))
        raw = key.public_key().public_bytes_raw()
        assert raw.hex() == test["pk"].lower()
        require_signature(key.public_key(), key.sign(raw), raw, where="here")
        assert key_of(size, raw) == key.public_key()
