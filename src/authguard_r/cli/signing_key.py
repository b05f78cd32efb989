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
from authguard_r.keys.signer import FileSigner, Passphrase, SigningKey, certified
from authguard_r.keys.trust import read_trust

PassphraseFile = Annotated[
    Path | None,
    typer.Option(
        "--passphrase-file",
        help="A file, mode 600, whose one line opens a sealed key or is the token's PIN.",
    ),
]


def open_signer(key: Path, cert: Path, passphrase_file: Path | None = None) -> FileSigner:
    """Return the signer of a `--key`: a file or a hardware key.

    Args:
        key: a file, or a `pkcs11:` URI.
        cert: the certificate chain.
        passphrase_file: where the passphrase or PIN is; None: a person at the terminal says it,
            if one is needed. Never an argument and never the environment: others can read both.

    Raises:
        EnvironmentFault: a file or token is not there, or others may read the passphrase.
        MalformedError: a sealed file, a URI or a passphrase file is damaged.
        AuthenticityError: the key does not open or is not its certificate's.
    """
    return certified(open_keys(key, passphrase_file), cert)


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
