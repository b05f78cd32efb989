# SPDX-License-Identifier: Apache-2.0
"""A private key in hardware, behind PKCS#11: it signs there and can never be had here.

The key is named by a URI (a strict part of RFC 7512), `python-pkcs11` speaks to the module, and a
key that could be read out, now or ever, is refused. Spec page: docs/spec/token.md#key-files
"""

from __future__ import annotations

import os
import re
from threading import Lock
from typing import TYPE_CHECKING, Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509 import CertificateSigningRequestBuilder
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.ed25519 import public_key as sound_key
from authguard_r.keys.signer import Passphrase, SigningKey

if TYPE_CHECKING:
    from pkcs11 import ObjectClass, Session, Token

SCHEME = "pkcs11:"
#: Longest URI, in characters.
MAX_URI = 2_048
#: A value: what RFC 7512 allows unescaped, and two-digit escapes for anything else.
_VALUE = re.compile(r"(?:[A-Za-z0-9\-._~:\[\]@!$'()*+,=&]|%[0-9A-Fa-f]{2})+")
_QUERY_VALUE = re.compile(r"(?:[A-Za-z0-9\-._~:\[\]@!$'()*+,=/?|]|%[0-9A-Fa-f]{2})+")
_ESCAPE = re.compile(rb"%([0-9A-Fa-f]{2})")
_PATH_NAMES = frozenset({"token", "serial", "object", "id", "type"})
_SECRETS = frozenset({"pin-value", "pin-source"})
#: An Ed25519 point: raw, or as PKCS#11 2.40 wraps it, in a DER octet string.
_POINT, _WRAPPED = 32, b"\x04\x20"
#: DER of the algorithm identifier of an Ed25519 signature.
_ED25519 = bytes.fromhex("300506032b6570")
_PROBE = b"authguard-r/key-probe/1\0"


class KeyUri(Struct, frozen=True, kw_only=True):
    """Which key of which token, behind which module.

    Args:
        module: absolute path of the PKCS#11 module; it runs in this process.
        token: the token's label.
        serial: the token's serial number.
        object: the key's label.
        id: the key's id.
    """

    module: str
    token: str | None = None
    serial: bytes | None = None
    object: str | None = None
    id: bytes | None = None


def is_key_uri(text: str) -> bool:
    """Return whether a text names a key in hardware rather than a file."""
    return text.startswith(SCHEME)


def read_key_uri(text: str) -> KeyUri:
    """Return what `pkcs11:token=T;object=O?module-path=M` names.

    Taken are `token`, `serial`, `object`, `id`, and `type=private`. A token and a key have to be
    named, and the module always: a default would load any module that is installed.

    Args:
        text: what a person typed.

    Raises:
        MalformedError: anything else, a PIN above all: every user can read arguments.
    """
    if not is_key_uri(text) or len(text) > MAX_URI:
        raise _malformed(f"expected `pkcs11:` and at most {MAX_URI} characters")
    path, _, query = text.removeprefix(SCHEME).partition("?")
    named = _attributes(path, ";", _VALUE, known=_PATH_NAMES)
    asked = _attributes(query, "&", _QUERY_VALUE, known=frozenset({"module-path"}))
    if "token" not in named and "serial" not in named:
        raise _malformed("expected `token=LABEL` or `serial=NUMBER`")
    if "object" not in named and "id" not in named:
        raise _malformed("expected `object=LABEL` or `id=BYTES`")
    if named.get("type", b"private") != b"private":
        raise _malformed("expected `type=private`, or no type")
    module = _text(asked.get("module-path", b""), "module-path")
    if not module.startswith("/"):
        raise _malformed("expected `?module-path=` and the absolute path of a PKCS#11 module")
    return KeyUri(
        module=module,
        token=_text(named["token"], "token") if "token" in named else None,
        serial=named.get("serial"),
        object=_text(named["object"], "object") if "object" in named else None,
        id=named.get("id"),
    )


class TokenKey:
    """An Ed25519 key in a token, for as long as its session lasts.

    Args:
        session: open, and logged in.
        key: the private key in it.
        public: the key that verifies it.
        where: the URI, for messages.
    """

    def __init__(self, session: Session, key: Any, public: Ed25519PublicKey, *, where: str) -> None:
        self._session = session
        self._key = key
        self._public = public
        self._where = where
        self._turn = Lock()

    def sign(self, data: bytes, /) -> bytes:
        """Return the token's signature over the data, verified: hardware can be at fault too.

        Raises:
            EnvironmentFault: the token is gone, or will not sign.
            AuthenticityError: what it made is no signature of its public key.
        """
        from pkcs11 import Mechanism, PKCS11Error

        try:
            with self._turn:  # a session signs one thing at a time
                signature = bytes(self._key.sign(data, mechanism=Mechanism.EDDSA))
        except PKCS11Error as error:
            raise _fault(f"the token does not sign: {_said(error)}", self._where) from error
        try:
            self._public.verify(signature, data)
        except InvalidSignature as error:
            raise _unfit("the token's signature is not its public key's", self._where) from error
        return signature

    def public_key(self) -> Ed25519PublicKey:
        """Return the key that verifies what it signs."""
        return self._public

    def close(self) -> None:
        """End the session; nothing is signed any more."""
        self._session.close()


def open_key(uri: str, pin: Passphrase | None) -> TokenKey:
    """Return a key in hardware that signs, after it signed once to show that it does.

    Args:
        uri: which key.
        pin: asked once; a token counts wrong answers and locks.

    Raises:
        MalformedError: the URI is not valid.
        EnvironmentFault: the extra, the module or the token is not there.
        AuthenticityError: there is no such key, the PIN is wrong, or the key is not to be trusted:
            not Ed25519, or it can be read out or could once.
    """
    named = read_key_uri(uri)
    try:
        from pkcs11 import PKCS11Error
    except ImportError as error:
        raise _fault("keys in hardware need `pip install 'authguard-r[pkcs11]'`", uri) from error
    if pin is None:
        raise _unfit("the token needs a PIN: name a file with --passphrase-file", uri)
    try:
        return _open(named, pin, where=uri)
    except PKCS11Error as error:
        raise _fault(f"the token or its module fails: {_said(error)}", uri) from error


def request_of(builder: CertificateSigningRequestBuilder, key: SigningKey) -> bytes:
    """Return a PKCS#10 request, DER, by an Ed25519 key that is somewhere else.

    The library signs with keys that it holds only. So a stand-in signs the same request, and its
    point and signature, each of a fixed length, give way to the key's own.

    Raises:
        EnvironmentFault: the key does not sign.
    """
    stand_in = Ed25519PrivateKey.generate()
    written = builder.sign(stand_in, None).tbs_certrequest_bytes
    before, _, after = written.partition(stand_in.public_key().public_bytes_raw())
    said = before + key.public_key().public_bytes_raw() + after
    return _der(0x30, said + _ED25519 + _der(0x03, b"\0" + key.sign(said)))


def _der(tag: int, body: bytes) -> bytes:
    size = len(body)
    long = b"" if size < 0x80 else size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes([tag, 0x80 | len(long) if long else size]) + long + body


def _open(named: KeyUri, pin: Passphrase, *, where: str) -> TokenKey:
    from pkcs11 import lib

    tokens = list(lib(named.module).get_tokens(named.token, named.serial))
    if len(tokens) != 1:
        message = f"expected one token of this name, found {len(tokens)}; is it plugged in?"
        raise _fault(message, where)
    session = _log_in(tokens[0], pin(where), where=where)
    try:
        key = _key_in(session, named, where=where)
        key.sign(_PROBE + os.urandom(32))
    except BaseException:
        session.close()
        raise
    return key


def _log_in(token: Token, pin: str, *, where: str) -> Session:
    from pkcs11 import PinIncorrect, PinInvalid, PinLenRange
    from pkcs11 import UserAlreadyLoggedIn as LoggedIn

    try:
        return token.open(user_pin=pin)
    except LoggedIn:
        return token.open()  # a token knows processes, not sessions: this one gave its PIN
    except (PinIncorrect, PinInvalid, PinLenRange) as error:
        raise _unfit("the PIN is wrong; a token locks after a few of these", where) from error


def _key_in(session: Session, named: KeyUri, *, where: str) -> TokenKey:
    """Return the one key of that name, with its public part, when it never left the token."""
    from pkcs11 import Attribute, ObjectClass

    key = _one(session, ObjectClass.PRIVATE_KEY, named.object, named.id, where=where)
    if not key[Attribute.NEVER_EXTRACTABLE] or not key[Attribute.ALWAYS_SENSITIVE]:
        raise _unfit(
            "the key can be read out of its token, or was put into it; make one inside", where
        )
    number = key[Attribute.ID]
    public = _one(session, ObjectClass.PUBLIC_KEY, named.object, number, where=where)
    point = bytes(public[Attribute.EC_POINT])
    if len(point) == _POINT + len(_WRAPPED):
        point = point.removeprefix(_WRAPPED)
    return TokenKey(session, key, sound_key(point, where=where), where=where)


def _one(
    session: Session, kind: ObjectClass, label: str | None, number: bytes | None, *, where: str
) -> Any:
    """Return the one Edwards key of a kind and name."""
    from pkcs11 import Attribute, KeyType

    wanted: dict[Attribute, Any] = {Attribute.CLASS: kind, Attribute.KEY_TYPE: KeyType.EC_EDWARDS}
    named = {Attribute.LABEL: label, Attribute.ID: number}
    wanted |= {name: value for name, value in named.items() if value is not None}
    found = list(session.get_objects(wanted))  # to the end: a search left open blocks the session
    if len(found) != 1:
        part = "private" if kind is type(kind).PRIVATE_KEY else "public"
        raise _unfit(
            f"expected one {part} Ed25519 key of this name in the token, found {len(found)}", where
        )
    return found[0]


def _attributes(
    text: str, separator: str, value: re.Pattern[str], *, known: frozenset[str]
) -> dict[str, bytes]:
    """Return the decoded values of `name=value`, each name known and at most once."""
    found: dict[str, bytes] = {}
    for part in text.split(separator) if text else ():
        name, _, spelled = part.partition("=")
        if name in _SECRETS:
            raise _malformed(f"a PIN has no place in a URI (`{name}`); use --passphrase-file")
        if name not in known or name in found:
            raise _malformed(f"expected each of {', '.join(sorted(known))} at most once")
        if value.fullmatch(spelled) is None:
            raise _malformed(f"expected a value of `{name}`, with special characters as %XX")
        raw = spelled.encode("ascii")
        found[name] = _ESCAPE.sub(lambda hit: bytes.fromhex(hit[1].decode("ascii")), raw)
    return found


def _text(data: bytes, name: str) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _malformed(f"expected UTF-8 in `{name}`") from error
    if "\0" in text:
        raise _malformed(f"expected text in `{name}`")
    return text


def _said(error: Exception) -> str:
    """Return what the library says: often nothing but the name of the error."""
    return str(error) or type(error).__name__


def _malformed(message: str) -> MalformedError:
    # the text itself is not repeated: it may contain a PIN
    return MalformedError(message, where="pkcs11 URI")


def _fault(message: str, where: str) -> EnvironmentFault:
    return EnvironmentFault(message, reason=Reason.SERVICE_UNAVAILABLE, where=where)


def _unfit(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=where)
