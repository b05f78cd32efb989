# SPDX-License-Identifier: Apache-2.0
"""Signed kinds that people write in YAML: each is a row, and all are signed and shown alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import typer
from msgspec import Struct

from authguard_r.cli.inputs import wall_now
from authguard_r.cli.sign import sign_shown
from authguard_r.cli.signing_key import require_role
from authguard_r.core.encoding import Tag
from authguard_r.core.quantities import Now
from authguard_r.enforcement.templates import claimed
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import Trust, read_file, read_trust
from authguard_r.wire.output import emit

T = TypeVar("T")
OutOption = Annotated[Path | None, typer.Option("--out", help="File for the token.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
TrustChoice = Annotated[Path | None, typer.Option("--trust", help="The trust folder.")]


class SignedKind(Struct, Generic[T], frozen=True, kw_only=True):
    """One kind of signed object.

    Args:
        tag: its domain-separation tag.
        type: its type.
        roles: the roles that may sign it.
        card: returns the lines for the person who signs it.
        payload: returns the JSON output for an object and its file.
        open: returns the object in a token once its signature is valid, and further JSON output;
            None: showing it needs more than a trust folder.
    """

    tag: Tag
    type: type[T]
    roles: frozenset[str]
    card: Callable[[T], list[str]]
    payload: Callable[[T, Path], dict[str, Any]]
    open: Callable[[bytes, Trust, Now], tuple[T, dict[str, Any]]] | None = None


def sign_kind(
    kind: SignedKind[T],
    value: T,
    file: Path,
    signer: FileSigner,
    *,
    trust: Path | None,
    out: Path | None,
    yes: bool,
    as_json: bool,
    card: list[str] | None = None,
    more: dict[str, Any] | None = None,
) -> int:
    """Show an object to the person who signs it, ask, sign, and write the token.

    Args:
        kind: the row.
        value: the object.
        file: where it was written in YAML; the token goes beside it unless `out` names a file.
        signer: the key.
        trust: the trust folder, for the roles of the key.
        out: where the token goes.
        yes: do not ask.
        as_json: print the payload.
        card: the lines that are shown; None: the kind's own.
        more: further JSON output.

    Raises:
        AuthGuardError: the key may not sign this kind, or the token could not be written.
    """
    require_role(signer, kind.roles, trust)
    target = out or file.with_suffix(".token")
    return sign_shown(
        value,
        kind.tag,
        signer,
        card=kind.card(value) if card is None else card,
        target=target,
        payload={**kind.payload(value, target), **(more or {})},
        yes=yes,
        as_json=as_json,
    )


def show_kind(
    kind: SignedKind[T], token: Path, *, trust: Path | None, now: str | None, as_json: bool
) -> int:
    """Show what a token holds; with a trust folder, once its signature holds.

    Raises:
        AuthGuardError: the token cannot be read, is not canonical or is not authentic.
    """
    data = read_file(token)
    if trust is None or kind.open is None:
        value, more = claimed(data, kind.type, tag=kind.tag), dict[str, Any]()
    else:
        value, more = kind.open(data, read_trust(trust), wall_now(now))
    note = ["not verified: name the trust folder with --trust"] if trust is None else []
    payload = {**kind.payload(value, token), "valid": None if trust is None else True, **more}
    emit(payload, [*note, *kind.card(value)], as_json=as_json)
    return 0
