# SPDX-License-Identifier: Apache-2.0
"""`authguard audit reader`: make or show the key of a person who reads sealed fields.

It signs nothing and grants nothing: the site authority's signed configuration says what is sealed
for it. How-to: docs/howto/audit.md
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.signing_key import PassphraseFile, ask_new_passphrase, passphrase_of
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.mission import DataClass
from authguard_r.core.reasons import Reason
from authguard_r.keys.envelope import seal
from authguard_r.keys.files import write_whole
from authguard_r.keys.key_access import read_passphrase
from authguard_r.keys.readers import ReaderPublic, new_reader, read_reader
from authguard_r.wire.output import emit


def reader_command(
    keyfile: Annotated[Path, typer.Argument(metavar="KEYFILE", help="A new file for the key.")],
    hybrid: Annotated[
        bool,
        typer.Option("--hybrid", help="ML-KEM-768 with X25519, against quantum computers."),
    ] = False,
    protect: Annotated[
        bool, typer.Option("--protect", help="Ask for a passphrase and encrypt the file.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    show: Annotated[
        bool, typer.Option("--show", help="Print the public key of an existing file.")
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Make the key of a reader of sealed fields; print its line for the gate configuration.

    The private key stays with the reader. The author of the gate configuration needs only the
    public key. With --show, only the public key is printed.
    """
    if show:
        if hybrid or protect:
            text = "it changes nothing of a key that is there"
            raise typer.BadParameter(text, param_hint="--show")
        public = read_reader(keyfile, passphrase_of(passphrase_file)).public
        emit(_payload(keyfile, public), [public.text()], as_json=as_json)
        return 0
    public = _make(keyfile, hybrid=hybrid, protect=protect, passphrase_file=passphrase_file)
    lines = [
        f"{keyfile}: the private key; it opens what is sealed for it, and signs and grants nothing",
        f"public key {public.name}, for the gate configuration's readers, with what it may read:",
        f'  - {{role: ROLE, classes: [{", ".join(DataClass)}], key: "{public.text()}"}}',
    ]
    emit(_payload(keyfile, public), lines, as_json=as_json)
    return 0


def _make(
    keyfile: Path, *, hybrid: bool, protect: bool, passphrase_file: Path | None
) -> ReaderPublic:
    """Write a new key; return the public one.

    Raises:
        EnvironmentFault: something lies there, or it cannot be written.
        MalformedError: the passphrase is too short, or not the same twice.
    """
    if os.path.lexists(keyfile):
        message = f"`{keyfile}` is there already; --show prints its public key"
        raise EnvironmentFault(message, reason=Reason.FILE_UNAVAILABLE, where=str(keyfile))
    passphrase = None
    if passphrase_file is not None:
        passphrase = read_passphrase(passphrase_file)
    elif protect:
        if passphrase_of(None) is None:
            raise typer.BadParameter("no terminal to ask at", param_hint="--passphrase-file")
        passphrase = ask_new_passphrase(str(keyfile))
    key = new_reader(hybrid=hybrid)
    data = key.pem() if passphrase is None else seal(key.pem(), passphrase)
    write_whole(keyfile, data, mode=0o600)
    return key.public


def _payload(keyfile: Path, public: ReaderPublic) -> dict[str, Any]:
    return {"file": str(keyfile), "key": public.text(), "name": public.name}
