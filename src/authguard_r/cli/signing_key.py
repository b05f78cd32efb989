# SPDX-License-Identifier: Apache-2.0
"""Where `--key` leads: a plain file, a sealed one, or hardware; and who says the passphrase."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.inputs import wall_now
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Leaf, LeafClaims, read_claims
from authguard_r.keys.key_access import open_named, read_passphrase
from authguard_r.keys.signer import FileSigner, Passphrase, SigningKey, certified, folder_signer
from authguard_r.keys.trust import read_trust

#: How the files of a key, its certificates and its request end, beside each other.
KEY_END, CERTIFICATE_END, REQUEST_END = ".key.pem", ".cert.pem", ".request.json"

KeyOption = Annotated[
    Path,
    typer.Option("--key", envvar="AUTHGUARD_KEY", help="Your private key: a file, or `pkcs11:`."),
]
#: The key of an order that the demonstration's own people may give, too.
OrderKeyOption = Annotated[
    Path | None,
    typer.Option(
        "--key",
        envvar="AUTHGUARD_KEY",
        help="Your private key (default: the key in a demonstration's trust folder).",
    ),
]
CertOption = Annotated[
    Path | None,
    typer.Option(
        "--cert", envvar="AUTHGUARD_CERT", help="The key's certificates (default: beside the key)."
    ),
]
PassphraseFile = Annotated[
    Path | None,
    typer.Option(
        "--passphrase-file",
        help="A file, mode 600, whose one line opens a sealed key or is the token's PIN.",
    ),
]


def certificate_of(key: Path, cert: Path | None) -> Path:
    """Return the file of a key's certificates: the one that was named, else the one beside it.

    Raises:
        typer.BadParameter: none was named, and the key's name does not say which it is.
    """
    if cert is not None:
        return cert
    if str(key).startswith("pkcs11:") or not key.name.endswith(KEY_END):
        text = f"name it: only for a key file NAME{KEY_END} it is NAME{CERTIFICATE_END} beside it"
        raise typer.BadParameter(text, param_hint="--cert")
    return key.with_name(key.name.removesuffix(KEY_END) + CERTIFICATE_END)


def signer_of(
    person: str,
    trust: Path,
    key: Path | None,
    cert: Path | None,
    passphrase_file: Path | None = None,
) -> FileSigner:
    """Return who signs an order: the key that was named, else a person of a demonstration.

    Args:
        person: whose key of the trust folder it is, where none was named.
        trust: the trust folder.
        key: as `open_signer`.
        cert: as `open_signer`.
        passphrase_file: as `open_signer`.
    """
    if key is not None:
        return open_signer(key, cert, passphrase_file)
    if cert is not None:
        raise typer.BadParameter("needs --key", param_hint="--cert")
    return folder_signer(trust, person)


def open_signer(
    key: Path, cert: Path | None = None, passphrase_file: Path | None = None
) -> FileSigner:
    """Return the signer of a `--key`: a file or a hardware key.

    Args:
        key: a file, or a `pkcs11:` URI.
        cert: the certificate chain; None: beside the key.
        passphrase_file: where the passphrase or PIN is; None: a person at the terminal says it,
            if one is needed. Never an argument and never the environment: others can read both.

    Raises:
        EnvironmentFault: a file or token is not there, or others may read the passphrase.
        MalformedError: a sealed file, a URI or a passphrase file is damaged.
        AuthenticityError: the key does not open or is not its certificate's.
    """
    return certified(open_keys(key, passphrase_file), certificate_of(key, cert))


def require_role(signer: FileSigner, roles: frozenset[str], trust: Path | None) -> PrincipalId:
    """Return whose key it is; refuse one that every gate would refuse for its role.

    Args:
        signer: the key.
        roles: that sign such a thing.
        trust: the trust folder; None: the owner of the key is unknown, and only its certificate's
            claim is checked.

    Raises:
        AuthenticityError: the certificate does not hold under the trust root, or claims nothing.
        RefusedError: it is of another role.
    """
    leaf: Leaf | LeafClaims = (
        read_claims(signer.chain[0])
        if trust is None
        else read_trust(trust).identify(signer.chain, wall_now(None))
    )
    if leaf.role not in roles:
        raise RefusedError(
            f"expected a signer in a role of {', '.join(sorted(roles))}, got `{leaf.role}`",
            reason=Reason.ROLE_DENIED,
            where="--cert",
        )
    return leaf.principal


def open_keys(key: Path, passphrase_file: Path | None = None) -> tuple[SigningKey, ...]:
    """Return the keys of a `--key`; as `open_signer`, without certificates."""
    return open_named(key, passphrase_of(passphrase_file))


def passphrase_of(path: Path | None) -> Passphrase | None:
    """Return what gives the passphrase: the file, else a person at the terminal, else nothing."""
    if path is not None:
        return lambda _: read_passphrase(path)
    return ask_passphrase if sys.stdin.isatty() else None


def ask_passphrase(what: str) -> str:
    """Return what a person types for a file or token; it is not shown.

    Raises:
        typer.Abort: standard input ended.
    """
    return _typed(f"passphrase or PIN of {what}: ")


def ask_new_passphrase(what: str) -> str:
    """Return what a person types twice, the same both times.

    Raises:
        typer.Abort: standard input ended.
        MalformedError: the two differ.
    """
    first = _typed(f"new passphrase of {what}: ")
    if _typed("the same again: ") != first:
        raise MalformedError("expected the same passphrase twice", where="passphrase")
    return first


def _typed(question: str) -> str:
    try:
        return getpass.getpass(question)
    except EOFError as error:
        raise typer.Abort from error
