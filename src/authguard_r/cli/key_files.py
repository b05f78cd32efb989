# SPDX-License-Identifier: Apache-2.0
"""`authguard keys protect`, `unprotect` and `public`: what lies in a key file, and how."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.signing_key import (
    KeyOption,
    PassphraseFile,
    ask_new_passphrase,
    open_keys,
    passphrase_of,
)
from authguard_r.core.errors import RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.envelope import is_sealed, seal, unseal
from authguard_r.keys.files import write_whole
from authguard_r.keys.key_access import read_passphrase
from authguard_r.keys.pkcs11 import TokenKey
from authguard_r.keys.signer import read_keys
from authguard_r.keys.trust import read_file
from authguard_r.wire.output import emit

KeyFile = Annotated[Path, typer.Argument(metavar="KEYFILE", help="A file of private keys.")]
KeyOut = Annotated[
    Path | None, typer.Option("--out", help="File to write (default: in its place).")
]


def protect_command(
    keyfile: KeyFile,
    passphrase_file: PassphraseFile = None,
    out: KeyOut = None,
    as_json: JsonFlag = False,
) -> int:
    """Encrypt a person's key file with a passphrase. Services cannot use such a file."""
    data = read_file(keyfile)
    if is_sealed(data):
        raise _refused("the key is sealed already", keyfile)
    read_keys(data, keyfile)
    new = seal(data, _new_passphrase(keyfile, passphrase_file))
    _write(keyfile, out, new, say="sealed", as_json=as_json)
    return 0


def unprotect_command(
    keyfile: KeyFile,
    passphrase_file: PassphraseFile = None,
    out: KeyOut = None,
    as_json: JsonFlag = False,
) -> int:
    """Decrypt a key file to plain PEM. Anyone who can read that file has the key."""
    data = read_file(keyfile)
    if not is_sealed(data):
        raise _refused("the key is not sealed", keyfile)
    passphrase = passphrase_of(passphrase_file)
    if passphrase is None:
        raise typer.BadParameter("no terminal to ask at", param_hint="--passphrase-file")
    plain = unseal(data, passphrase(str(keyfile)), where=str(keyfile))
    _write(keyfile, out, plain, say="plain", as_json=as_json)
    return 0


def public_command(
    key: KeyOption,
    passphrase_file: PassphraseFile = None,
    out: Annotated[Path | None, typer.Option("--out", help="File to write.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Print the public keys of a private key as PEM."""
    keys = open_keys(key, passphrase_file)
    form = (Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    text = b"".join(one.public_key().public_bytes(*form) for one in keys).decode("ascii")
    for one in keys:
        if isinstance(one, TokenKey):
            one.close()
    if out is not None:
        write_whole(out.resolve(), text.encode("ascii"), mode=0o644)
    emit({"public": text}, [str(out)] if out is not None else text.splitlines(), as_json=as_json)
    return 0


def _new_passphrase(keyfile: Path, path: Path | None) -> str:
    if path is not None:
        return read_passphrase(path)
    if passphrase_of(None) is None:
        raise typer.BadParameter("no terminal to ask at", param_hint="--passphrase-file")
    return ask_new_passphrase(str(keyfile))


def _write(keyfile: Path, out: Path | None, data: bytes, *, say: str, as_json: bool) -> None:
    target = out or keyfile
    # behind a link, the file is replaced and not the link; its own key, and no other one
    left = target.resolve() != keyfile.resolve()
    write_whole(target.resolve(), data, mode=0o600, over=not left)
    lines = [f"{target}: {say}", *([f"{keyfile}: left as it is"] if left else [])]
    emit({"file": str(target), "form": say}, lines, as_json=as_json)


def _refused(message: str, path: Path) -> RefusedError:
    return RefusedError(message, reason=Reason.TRANSITION_REFUSED, where=str(path))
