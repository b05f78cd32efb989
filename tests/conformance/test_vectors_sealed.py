# SPDX-License-Identifier: Apache-2.0
"""A reader that was written from the spec page alone gives the published answers, as ours does.

It shares no code with the gate, only other people's SHA-2 and SHA-3, HKDF, X25519, ML-KEM and
AES-GCM.
Source: docs/spec/sealed-fields.md
"""

from __future__ import annotations

import json
import subprocess
import sys
from base64 import urlsafe_b64decode, urlsafe_b64encode
from hashlib import sha3_256, sha256
from pathlib import Path
from typing import Any

import pytest
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.mlkem import MLKEM768PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand

from fixtures import scenarios

Json = dict[str, Any]
VECTORS: Json = json.loads((scenarios.ROOT / "vectors" / "sealed.json").read_text())
ROWS = VECTORS["rows"]
FIRST = 2
PARTS = ("action.act", "action.object", "action.params", "action.regions")
SPOKEN = ("approvers", "by", "caller", "digest", "grant", "members", "scheduler", "signer")


def test_the_published_file_is_what_the_generator_writes(tmp_path: Path) -> None:
    script = scenarios.ROOT / "vectors" / "generate_sealed.py"
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True)
    assert json.loads((tmp_path / "sealed.json").read_text()) == VECTORS


# the other reader


def unb64(text: str) -> bytes:
    return urlsafe_b64decode(text + "=" * (-len(text) % 4))


def b64(data: bytes) -> str:
    return urlsafe_b64encode(data).decode().rstrip("=")


def canonical(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def commitment(name: str, item: Json) -> str:
    said = canonical({"name": name, "salt": item["salt"], "value": item["value"]})
    return b64(sha256(b"authguard-r/commitment/1\0" + said).digest())


def cipher_of(keys: list[bytes]) -> AESGCM:
    info = b"authguard-r/box/1\0"
    return AESGCM(HKDF(SHA256(), 32, salt=None, info=info).derive(b"".join(keys)))


def read(number: int, sealed: Json, keys: dict[str, bytes]) -> tuple[Json, Json]:
    """Return record and values as a reader with these keys of classes has them."""
    record = json.loads(ROWS[number]["record"])
    values = dict(sealed)
    for name in [name for name in sealed if name.startswith("box.")]:
        box, classes = values.pop(name)["value"], name[4:].split("+")
        if not keys.keys() >= set(classes):
            continue
        place = {"classes": classes, "mid": record["link"]["mid"]}
        place |= {"robot": VECTORS["robot"], "seq": number}
        text = cipher_of([keys[one] for one in classes]).decrypt(
            unb64(box["nonce"]), unb64(box["text"]), canonical(place)
        )
        found = json.loads(text)
        for field, item in found.items():
            if commitment(field, item) != record["committed"][field]:
                raise ValueError(field)
        values |= found
    if "links" in values:
        for name, digest in values["links"]["value"].items():
            assert record["link"][name] in {"-", record["committed"]["links"]}
            record["link"][name] = digest
    record["open"] |= {name: values[name]["value"] for name in SPOKEN if name in values}
    plain = {n: i["value"] for n, i in values.items() if n not in {"links", *SPOKEN}}
    if set(PARTS) <= plain.keys():
        plain["action"] = {k: v for part in PARTS for k, v in plain.pop(part).items()}
    return record, plain


# HPKE, base mode, of RFC 9180: section 5.1 and 4.1, for X25519 and for X-Wing

X25519_KEM, XWING_KEM = b"\x00\x20", b"\x64\x7a"
#: Bytes of ML-KEM-768's ciphertext and of a public key of X25519.
CT_M, CT_X = 1_088, 32


def extract(salt: bytes, label: bytes, suite: bytes, data: bytes) -> bytes:
    mac = HMAC(salt or bytes(32), SHA256())
    mac.update(b"HPKE-v1" + suite + label + data)
    return mac.finalize()


def expand(key: bytes, label: bytes, suite: bytes, info: bytes, size: int) -> bytes:
    told = size.to_bytes(2, "big") + b"HPKE-v1" + suite + label + info
    return HKDFExpand(SHA256(), size, told).derive(key)


def agreed(private: bytes, sent: bytes) -> tuple[bytes, bytes]:
    """Return what X25519 gives, and the public key of the private one."""
    mine = X25519PrivateKey.from_private_bytes(private)
    shared = mine.exchange(X25519PublicKey.from_public_bytes(sent))
    return shared, mine.public_key().public_bytes_raw()


def decapsulate(private: list[bytes], enc: bytes) -> tuple[bytes, bytes]:
    """Return the KEM's id and its shared secret."""
    *seeds, x25519 = private
    if not seeds:
        shared, public = agreed(x25519, enc)
        kem, context = b"KEM" + X25519_KEM, enc + public
        root = extract(b"", b"eae_prk", kem, shared)
        return X25519_KEM, expand(root, b"shared_secret", kem, context, 32)
    ct_m, ct_x = enc[:CT_M], enc[CT_M:]
    ss_x, pk_x = agreed(x25519, ct_x)
    ss_m = MLKEM768PrivateKey.from_seed_bytes(seeds[0]).decapsulate(ct_m)
    return XWING_KEM, sha3_256(ss_m + ss_x + ct_x + pk_x + b"\\./" + b"/^\\").digest()


def unwrap(private: list[bytes], wrapped: bytes, info: bytes) -> bytes:
    size = CT_X if len(private) == 1 else CT_M + CT_X
    kem, secret = decapsulate(private, wrapped[:size])
    hpke = b"HPKE" + kem + b"\x00\x01\x00\x02"
    schedule = b"\0" + extract(b"", b"psk_id_hash", hpke, b"")
    schedule += extract(b"", b"info_hash", hpke, info)
    root = extract(secret, b"secret", hpke, b"")
    key = expand(root, b"key", hpke, schedule, 32)
    nonce = expand(root, b"base_nonce", hpke, schedule, 12)
    return AESGCM(key).decrypt(nonce, wrapped[size:], b"")


def keys_of(role: str) -> dict[str, bytes]:
    """Return the keys that the log tells a role."""
    reader = VECTORS["readers"][role]
    private = [unb64(part) for part in reader["private"]]
    name = b64(sha256(b"authguard-r/raw/1\0" + unb64(reader["public"])).digest())
    found = {}
    for field, item in json.loads(ROWS[1]["sealed"]).items():
        for wrap in item["value"]:
            if wrap["reader"] == name:
                data = field.removeprefix("wrap.")
                bound = {"data": data, "keys": 1, "mid": "m-1", "reader": name}
                bound |= {"robot": VECTORS["robot"], "v": 1}
                found[data] = unwrap(private, unb64(wrap["text"]), canonical(bound))
    return found


@pytest.mark.parametrize("role", sorted(VECTORS["readers"]))
def test_another_reader_finds_the_keys_in_the_log(role: str) -> None:
    classes = VECTORS["readers"][role]["classes"]
    assert keys_of(role) == {one: unb64(VECTORS["keys"][one]) for one in classes}


def test_the_readers_of_the_file_have_a_key_of_each_kind() -> None:
    parts = {role: len(reader["private"]) for role, reader in VECTORS["readers"].items()}
    assert parts == {"auditor": 1, "porter": 1, "pq-auditor": 2}


@pytest.mark.parametrize("role", sorted(VECTORS["readers"]))
def test_another_reader_reads_what_ours_reads(role: str) -> None:
    reader = VECTORS["readers"][role]
    keys = {one: unb64(VECTORS["keys"][one]) for one in reader["classes"]}
    for number, expected in enumerate(reader["reads"], FIRST):
        record, values = read(number, json.loads(ROWS[number]["sealed"]), keys)
        link = record["link"]
        got = {"action": link["action"], "state": link["state"], "open": record["open"]}
        assert {**got, "values": values} == expected


@pytest.mark.parametrize("vector", VECTORS["refused"], ids=lambda vector: vector["name"])
def test_what_was_changed_opens_for_nobody(vector: Json) -> None:
    keys = {one: unb64(key) for one, key in VECTORS["keys"].items()}
    with pytest.raises((InvalidTag, ValueError)):
        read(vector["at"], json.loads(vector["sealed"]), keys)


def test_what_is_destroyed_is_gone_and_the_record_is_as_it_was() -> None:
    gone = VECTORS["destroyed"]
    record = json.loads(ROWS[gone["at"]]["record"])
    left, before = json.loads(gone["sealed"]), json.loads(ROWS[gone["at"]]["sealed"])
    assert before.keys() - left.keys() == set(gone["gone"])
    for name, item in left.items():
        assert commitment(name, item) == record["committed"][name]
    _, values = read(gone["at"], left, {one: unb64(k) for one, k in VECTORS["keys"].items()})
    assert "action.regions" not in values
    assert values["action.object"] == {"object": "cart-1"}
