# SPDX-License-Identifier: Apache-2.0
"""A sealed key file opens with its passphrase alone, and asks for nothing that it may not."""

from __future__ import annotations

import base64
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.argon2 import Argon2id
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)

from authguard_r.core.encoding import b64, encode, unb64
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    MalformedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, generate
from authguard_r.keys.envelope import MAX_FILE, is_sealed, read_envelope, seal, unseal
from authguard_r.keys.signer import open_key_file, read_keys, read_signer
from fixtures.cases import case
from fixtures.gate_process import environment
from unit.keys import chains
from unit.keys.chains import house

SAID = "correct horse battery staple"
BEGIN, END = (f"-----{mark} AUTHGUARD-R ENCRYPTED KEY-----\n".encode() for mark in ("BEGIN", "END"))
LEAF = chains.leaf(house().people)
PEM = LEAF.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
SEALED = seal(PEM, SAID)


def armored(text: bytes) -> bytes:
    spelled = base64.b64encode(text)
    lines = [spelled[at : at + 64] + b"\n" for at in range(0, len(spelled), 64)]
    return BEGIN + b"".join(lines) + END


def inside(data: bytes = SEALED) -> Any:
    return msgspec.json.decode(base64.b64decode(data.removeprefix(BEGIN).removesuffix(END)))


def changed(**header: Any) -> bytes:
    """Return the sealed file with fields of its header changed; `None` takes one out."""
    plain = inside()
    for name, value in header.items():
        plain["header"].pop(name, None)
        if value is not None:
            plain["header"][name] = value
    return armored(encode(plain))


def refused(data: bytes, kind: type[AuthGuardError], said: str = SAID) -> AuthGuardError:
    with pytest.raises(AuthGuardError) as caught:
        unseal(data, said, where="my.key.pem")
    assert type(caught.value) is kind
    assert said not in str(caught.value)
    return caught.value


def test_what_was_sealed_is_what_opens() -> None:
    assert is_sealed(SEALED)
    assert not is_sealed(PEM)
    assert unseal(SEALED, SAID, where="f") == PEM
    assert unseal(SEALED.replace(b"\n", b"\r\n"), SAID, where="f") == PEM
    assert all(len(line) <= 64 for line in SEALED.splitlines())


def test_two_files_of_one_key_have_nothing_in_common() -> None:
    one, other = inside(), inside(seal(PEM, SAID))
    assert one["ciphertext"] != other["ciphertext"]
    assert all(one["header"][name] != other["header"][name] for name in ("salt", "nonce"))


def test_the_format_is_the_one_of_the_specification() -> None:
    """Opened by hand: Argon2id, AES-256-GCM, the header authenticated behind its domain."""
    plain = inside()
    header = plain["header"]
    assert {k: header[k] for k in ("cipher", "format", "kdf", "lanes", "memory_kib", "passes")} == {
        "cipher": "aes-256-gcm",
        "format": 1,
        "kdf": "argon2id",
        "lanes": 4,
        "memory_kib": 65_536,
        "passes": 3,
    }
    kdf = Argon2id(salt=unb64(header["salt"]), length=32, iterations=3, lanes=4, memory_cost=65_536)
    over = b"authguard-r/key-file/1\0" + encode(header)
    sealed = unb64(plain["ciphertext"])
    key = AESGCM(kdf.derive(SAID.encode()))
    assert key.decrypt(unb64(header["nonce"]), sealed, over) == PEM


def test_a_passphrase_is_text_however_a_keyboard_composes_it() -> None:
    composed, apart = "caf\u00e9 au lait, please", "cafe\u0301 au lait, please"
    assert unseal(seal(PEM, composed), apart, where="f") == PEM


def test_a_wrong_passphrase_and_a_changed_file_look_the_same() -> None:
    plain = inside()
    sealed = bytearray(unb64(plain["ciphertext"]))
    sealed[0] ^= 1
    flipped = armored(encode({**plain, "ciphertext": b64(bytes(sealed))}))
    short = armored(encode({**plain, "ciphertext": b64(b"short")}))
    told = {
        str(refused(SEALED, AuthenticityError, "correct horse battery stable")),
        str(refused(flipped, AuthenticityError)),
        str(refused(short, AuthenticityError)),
    }
    assert len(told) == 1
    assert "the passphrase is wrong, or the file was changed" in told.pop()


@pytest.mark.parametrize(
    "field",
    [
        {"lanes": 2},
        {"passes": 4},
        {"memory_kib": 65_537},
        {"salt": b64(bytes(16))},
        {"nonce": b64(bytes(12))},
    ],
    ids=lambda field: next(iter(field)),
)
def test_every_field_of_the_header_is_authentic(field: dict[str, Any]) -> None:
    assert refused(changed(**field), AuthenticityError).reason is Reason.KEY_INVALID


def test_a_file_asks_for_nothing_out_of_bounds() -> None:
    """Refused before anything is derived: no passphrase and no memory were needed."""
    for field, place in [
        ({"memory_kib": 100 << 20}, "memory_kib"),
        ({"memory_kib": 65_535}, "memory_kib"),
        ({"memory_kib": -1}, "memory_kib"),
        ({"memory_kib": True}, "memory_kib"),
        ({"passes": 2}, "passes"),
        ({"passes": 11}, "passes"),
        ({"lanes": 0}, "lanes"),
        ({"lanes": 17}, "lanes"),
        ({"lanes": "4"}, "lanes"),
        ({"kdf": "pbkdf2"}, "kdf"),
        ({"cipher": "aes-128-cbc"}, "cipher"),
        ({"cipher": None}, "header"),
        ({"more": 1}, "header"),
        ({"nonce": b64(bytes(11))}, "nonce"),
        ({"nonce": "*"}, "nonce"),
        ({"salt": ""}, "salt"),
        ({"salt": b64(bytes(32))}, "salt"),
    ]:
        with case(field, place):
            with pytest.raises(MalformedError) as caught:
                read_envelope(changed(**field), where="my.key.pem")
            assert caught.value.where.startswith("my.key.pem: envelope.header")
            assert caught.value.where.endswith(place)
            assert "restore the file from a copy" in caught.value.message
            refused(changed(**field), MalformedError)


def test_a_later_format_is_told_from_damage() -> None:
    plain = {"header": {"format": 2, "anything": [1]}, "sealed": "x"}
    error = refused(armored(encode(plain)), MalformedError)
    assert "format 1, got 2" in error.message
    assert error.where == "my.key.pem: envelope.header.format"


def test_damage_is_malformed_with_its_place() -> None:
    for data in [
        b"",
        BEGIN,
        BEGIN + END,
        SEALED[:-20],
        SEALED[20:],
        SEALED + SEALED,
        b"note\n" + SEALED,
        SEALED + PEM,
        SEALED.replace(b"\n", b"\n\n"),
        SEALED.replace(b"A", b"*"),
        SEALED.replace(b"A", b"\xff"),
        armored(b"{"),
        armored(b"\xff"),
        armored(b"[" * 5_000),
        armored(b'{"header":{"format":"1"}}'),
        armored(b" " + encode(inside())),
        armored(encode({**inside(), "ciphertext": "*"})),
        armored(encode({**inside(), "more": 1})),
        armored(bytes(MAX_FILE)),
    ]:
        with case(data):
            error = refused(data, MalformedError)
            assert error.where.startswith("my.key.pem")
            assert "restore the file" in error.message


def test_every_cut_and_every_flipped_byte_is_refused() -> None:
    """Most are no envelope any more; what still reads like one is caught by the key."""
    left = []
    for at in range(len(SEALED) - 1):
        for data in (SEALED[:at], SEALED[:at] + bytes([SEALED[at] ^ 1]) + SEALED[at + 1 :]):
            with suppress(MalformedError):
                read_envelope(data, where="f")
                left.append(data)
    for data in left[::25]:  # a tenth of a second each
        refused(data, AuthenticityError)


@pytest.mark.parametrize("said", ["", "eleven char", "x" * 1_025, "a lone \ud800 surrogate"])
def test_a_passphrase_that_seals_is_long_and_text(said: str) -> None:
    with pytest.raises(MalformedError) as caught:
        seal(PEM, said)
    assert caught.value.where == "passphrase"


def test_an_empty_passphrase_opens_nothing() -> None:
    with pytest.raises(MalformedError) as caught:
        unseal(SEALED, "", where="f")
    assert caught.value.where == "passphrase"


def test_more_than_a_file_of_keys_is_not_sealed() -> None:
    with pytest.raises(MalformedError) as caught:
        seal(bytes(MAX_FILE), SAID)
    assert caught.value.where == "key"


#: In a process of its own: one that lives long may have the memory from what it freed.
SCARCE = """
import resource, sys
from pathlib import Path

from authguard_r.core.errors import EnvironmentFault
from authguard_r.keys.envelope import unseal

sealed, said = sys.stdin.buffer.read(), sys.argv[1]
pages = int(Path("/proc/self/statm").read_text().split()[0])
before = resource.getrlimit(resource.RLIMIT_AS)
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (24 << 20), before[1]))
try:
    unseal(sealed, said, where="my.key.pem")
except EnvironmentFault as error:
    sys.stderr.write(error.message)
finally:
    resource.setrlimit(resource.RLIMIT_AS, before)
sys.stdout.buffer.write(unseal(sealed, said, where="my.key.pem"))
"""


def test_too_little_memory_is_said() -> None:
    words = [sys.executable, "-c", SCARCE, SAID]
    env = environment(measured=True)
    done = subprocess.run(words, input=SEALED, capture_output=True, check=True, env=env)
    assert b"64 MiB" in done.stderr
    assert SAID.encode() not in done.stderr
    assert done.stdout == PEM


# -- the file as a signer --------------------------------------------------------------------------


def files(folder: Path, key: bytes) -> tuple[Path, Path]:
    chain = [one.certificate.public_bytes(Encoding.PEM) for one in (LEAF, house().people)]
    paths = folder / "key.pem", folder / "cert.pem"
    paths[0].write_bytes(key)
    paths[1].write_bytes(b"".join(chain))
    return paths


def test_a_sealed_file_signs_once_its_passphrase_was_said(tmp_path: Path) -> None:
    asked: list[str] = []

    def person(what: str) -> str:
        asked.append(what)
        return SAID

    signer = read_signer(*files(tmp_path, SEALED), person)
    found = house().trust().verify(b"go", signer.endorse(b"go"), chains.NOW)
    assert found.id == "operator-1"
    assert asked == [str(tmp_path / "key.pem")]


def test_nobody_is_asked_for_a_plain_file(tmp_path: Path) -> None:
    def nobody(what: str) -> str:
        raise AssertionError(what)

    assert read_signer(*files(tmp_path, PEM), nobody).chain == house().chain(LEAF)


def test_a_sealed_file_with_nobody_to_ask_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AuthenticityError) as caught:
        read_signer(*files(tmp_path, SEALED))
    assert "--passphrase-file" in caught.value.message
    assert caught.value.where == str(tmp_path / "key.pem")


def test_two_keys_of_one_principal_are_sealed_in_one_file(tmp_path: Path) -> None:
    pair = [generate(name) for name in (Algorithm.ED25519, Algorithm.ML_DSA_65)]
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    path = tmp_path / "two.pem"
    path.write_bytes(seal(b"".join(key.private_bytes(*form) for key in pair), SAID))
    found = open_key_file(path, lambda _: SAID)
    assert [key.public_key() for key in found] == [key.public_key() for key in pair]


def test_what_was_sealed_is_still_held_to_be_keys(tmp_path: Path) -> None:
    path = tmp_path / "key.pem"
    path.write_bytes(seal(b"a shopping list", SAID))
    with pytest.raises(AuthenticityError) as caught:
        open_key_file(path, lambda _: SAID)
    assert caught.value.where == str(path)


def test_pem_that_another_tool_encrypted_is_refused_with_the_mend() -> None:
    pkcs8 = LEAF.key.private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")
    )
    old = b"-----BEGIN EC PRIVATE KEY-----\nProc-Type: 4,ENCRYPTED\n\nAAAA\n-----END EC PRIVATE KEY"
    for data in (pkcs8, old + b"-----\n", PEM + pkcs8):
        with pytest.raises(AuthenticityError) as caught:
            read_keys(data, Path("key.pem"))
        assert "authguard keys protect" in caught.value.message
