# SPDX-License-Identifier: Apache-2.0
"""A key in hardware is named exactly, never leaves its token, and its signatures are checked."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pkcs11
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding
from pkcs11 import ObjectClass

from authguard_r.authoring.keys.request import WantedCertificate, make_request, open_request
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.identifiers import PrincipalId
from authguard_r.keys.certificate import Role
from authguard_r.keys.pkcs11 import (
    MAX_URI,
    KeyUri,
    TokenKey,
    is_key_uri,
    open_key,
    read_key_uri,
)
from authguard_r.keys.signer import certified
from fixtures.cases import case
from fixtures.hardware_token import MODULE, Token, needs_token
from unit.keys import chains
from unit.keys.chains import house

AT = "?module-path=/usr/lib/m.so"


# -- the name --------------------------------------------------------------------------------------


def test_a_uri_names_a_key_in_a_token_behind_a_module() -> None:
    assert read_key_uri("pkcs11:token=My%20token;object=op-1" + AT) == KeyUri(
        module="/usr/lib/m.so", token="My token", object="op-1"
    )
    assert read_key_uri("pkcs11:id=%01%fF;serial=12ab;type=private" + AT) == KeyUri(
        module="/usr/lib/m.so", serial=b"12ab", id=b"\1\xff"
    )
    assert read_key_uri("pkcs11:object=caf%c3%a9&co;token=a=b" + AT).object == "caf\u00e9&co"


def test_any_other_text_is_no_name_of_a_key() -> None:
    for text in [
        "",
        "file:token=a;object=b" + AT,
        "PKCS11:token=a;object=b" + AT,
        "pkcs11:",
        "pkcs11:" + AT,
        "pkcs11:token=a" + AT,
        "pkcs11:object=b" + AT,
        "pkcs11:token=a;object=b",
        "pkcs11:token=a;object=b?",
        "pkcs11:token=a;object=b?module-path=",
        "pkcs11:token=a;object=b?module-path=m.so",
        "pkcs11:token=a;object=b?module-name=softhsm2",
        "pkcs11:token=a;object=b;module-path=/m.so",
        "pkcs11:token=a;object=b" + AT + "&module-path=/other.so",
        "pkcs11:token=a;token=a;object=b" + AT,
        "pkcs11:token=a;object=b;type=cert" + AT,
        "pkcs11:token=a;object=b;slot-id=1" + AT,
        "pkcs11:token=a;object=b;" + AT,
        "pkcs11:token=;object=b" + AT,
        "pkcs11:token;object=b" + AT,
        "pkcs11:token=a b;object=b" + AT,
        "pkcs11:token=a/b;object=b" + AT,
        "pkcs11:token=a%2;object=b" + AT,
        "pkcs11:token=a%zz;object=b" + AT,
        "pkcs11:token=%ff;object=b" + AT,
        "pkcs11:token=a%00b;object=b" + AT,
        "pkcs11:token=\u00e9;object=b" + AT,
        "pkcs11:token=a;object=b" + AT + "%00",
        "pkcs11:token=a;object=b" + AT + "#x",
        "pkcs11:token=a;object=" + "b" * MAX_URI + AT,
    ]:
        with case(text):
            with pytest.raises(MalformedError) as caught:
                read_key_uri(text)
            assert caught.value.where == "pkcs11 URI"


@pytest.mark.parametrize("name", ["pin-value", "pin-source"])
@pytest.mark.parametrize("form", ["pkcs11:token=a;object=b?{}=4711", "pkcs11:token=a;{}=4711"])
def test_a_pin_in_a_uri_is_refused_and_not_repeated(name: str, form: str) -> None:
    with pytest.raises(MalformedError) as caught:
        read_key_uri(form.format(name))
    assert "--passphrase-file" in caught.value.message
    assert "4711" not in str(caught.value)


def test_a_file_is_no_uri() -> None:
    assert is_key_uri("pkcs11:x")
    assert not is_key_uri("keys/pkcs11:x")


def test_without_the_extra_the_mend_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pkcs11", None)
    with pytest.raises(EnvironmentFault) as caught:
        open_key("pkcs11:token=a;object=b" + AT, lambda _: "1234")
    assert "authguard-r[pkcs11]" in caught.value.message


def test_a_module_that_is_none_is_a_fault_of_the_world(tmp_path: Path) -> None:
    for path in (tmp_path / "none.so", Path(__file__)):
        with pytest.raises(EnvironmentFault) as caught:
            open_key(f"pkcs11:token=a;object=b?module-path={path}", lambda _: "1234")
        assert "module fails" in caught.value.message


# -- the key ---------------------------------------------------------------------------------------


@pytest.fixture
def token(tmp_path: Path) -> Iterator[Token]:
    with Token(tmp_path) as made:
        yield made


def opened(token: Token, name: str = "operator-1") -> TokenKey:
    return open_key(token.uri(name), lambda _: token.pin)


def refused(token: Token, kind: type[AuthGuardError], *, name: str = "operator-1") -> str:
    with pytest.raises(AuthGuardError) as caught:
        opened(token, name)
    assert type(caught.value) is kind
    assert caught.value.where == token.uri(name)
    assert token.pin not in str(caught.value)
    return caught.value.message


def point_of(key: Ed25519PrivateKey) -> bytes:
    return b"\x04\x20" + key.public_key().public_bytes_raw()


@needs_token
def test_a_key_in_a_token_signs_as_its_leaf(token: Token, tmp_path: Path) -> None:
    token.make("operator-1")
    token.make("operator-2", id=b"\2")
    key = opened(token)
    leaf = chains.leaf(house().people, public=key.public_key())
    held = (leaf.certificate, house().people.certificate)
    path = tmp_path / "cert.pem"
    path.write_bytes(b"".join(one.public_bytes(Encoding.PEM) for one in held))
    signer = certified((key,), path)
    found = house().trust().verify(b"go", signer.endorse(b"go"), chains.NOW)
    assert found.id == "operator-1"
    with pytest.raises(AuthenticityError):
        certified((opened(token, "operator-2"),), path)


@needs_token
@pytest.mark.parametrize("name", ["o", "operator-1", "x" * 60])
def test_a_key_in_a_token_asks_for_its_certificate(token: Token, name: str) -> None:
    """The library that reads the request checks that the token signed it."""
    token.make("operator-1")
    wanted = WantedCertificate(principal=PrincipalId(name), role=Role.OPERATOR, every_robot=True)
    key = opened(token)
    assert open_request(make_request(wanted, (key,))).keys == (key.public_key(),)


@needs_token
def test_a_key_is_found_by_its_id_and_its_tokens_serial_too(token: Token) -> None:
    token.make("operator-1", id=b"\1")
    token.make("operator-1", id=b"\2")
    assert "found 2" in refused(token, AuthenticityError)
    (serial,) = (t.serial.decode() for t in pkcs11.lib(MODULE).get_tokens() if t.label)
    at = f"?module-path={MODULE}"
    one, two = (
        open_key(f"pkcs11:serial={serial};id=%0{n}{at}", lambda _: token.pin) for n in (1, 2)
    )
    assert one.public_key() != two.public_key()


@needs_token
def test_a_wrong_pin_is_refused_and_asked_once(token: Token) -> None:
    token.make("operator-1")
    for pin in ("000000", ""):
        asked: list[str] = []
        with pytest.raises(AuthenticityError) as caught:
            open_key(token.uri("operator-1"), lambda what: asked.append(what) or pin)  # noqa: B023
        assert "PIN is wrong" in caught.value.message
        assert asked == [token.uri("operator-1")]
    with pytest.raises(AuthenticityError) as caught:
        open_key(token.uri("operator-1"), None)
    assert "needs a PIN" in caught.value.message
    assert opened(token).sign(b"x")


@needs_token
def test_a_token_that_is_not_there_or_not_one(token: Token) -> None:
    with pytest.raises(EnvironmentFault) as caught:
        open_key(token.uri("x", token="another"), lambda _: token.pin)
    assert "found 0" in caught.value.message
    token.add(token.label)
    assert "found 2" in refused(token, EnvironmentFault)


@needs_token
def test_a_key_that_can_be_read_out_is_refused(token: Token) -> None:
    token.make("open", id=b"\1", extractable=True)
    token.make("told", id=b"\2", sensitive=False)
    for name in ("open", "told"):
        assert "read out" in refused(token, AuthenticityError, name=name)


@needs_token
def test_half_a_pair_and_no_pair_are_refused(token: Token) -> None:
    token.make("operator-1")
    assert "private Ed25519 key" in refused(token, AuthenticityError, name="nobody")
    token.drop("operator-1", ObjectClass.PUBLIC_KEY)
    assert "public Ed25519 key" in refused(token, AuthenticityError)


@needs_token
def test_a_key_of_another_algorithm_is_refused(token: Token) -> None:
    with token.session() as session:
        session.generate_keypair(pkcs11.KeyType.RSA, 2048, store=True, label="operator-1")
    assert "found 0" in refused(token, AuthenticityError)


@needs_token
def test_a_signature_that_is_not_its_public_keys_never_leaves(token: Token) -> None:
    token.make("operator-1")
    token.drop("operator-1", ObjectClass.PUBLIC_KEY)
    token.put_public("operator-1", point_of(Ed25519PrivateKey.generate()))
    assert "not its public key's" in refused(token, AuthenticityError)


@needs_token
@pytest.mark.parametrize("point", [b"\x04\x20" + bytes(32), bytes(57), b"\1"], ids=len)
def test_an_unsound_point_is_refused_at_this_door_too(token: Token, point: bytes) -> None:
    token.make("operator-1")
    token.drop("operator-1", ObjectClass.PUBLIC_KEY)
    token.put_public("operator-1", point)
    refused(token, AuthenticityError)


@needs_token
def test_a_raw_point_is_a_point(token: Token) -> None:
    token.make("operator-1")
    key = opened(token)
    raw = key.public_key().public_bytes_raw()
    key.close()
    token.drop("operator-1", ObjectClass.PUBLIC_KEY)
    token.put_public("operator-1", raw)
    assert opened(token).public_key() == key.public_key()


@needs_token
def test_a_token_that_is_gone_signs_nothing(token: Token) -> None:
    token.make("operator-1")
    key = opened(token)
    key.close()
    with pytest.raises(EnvironmentFault) as caught:
        key.sign(b"x")
    assert "does not sign" in caught.value.message


@needs_token
def test_a_key_that_vanished_meanwhile_is_said(token: Token) -> None:
    token.make("operator-1")
    key = opened(token)
    pkcs11.lib(MODULE).reinitialize()  # as pulling the token out does: every session is over
    with pytest.raises(EnvironmentFault) as caught:
        key.sign(b"x")
    assert caught.value.where == token.uri("operator-1")
