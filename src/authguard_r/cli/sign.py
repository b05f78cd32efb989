# SPDX-License-Identifier: Apache-2.0
"""`authguard mission sign`: show the card, refuse what was not accepted, ask, sign, record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from msgspec import Struct

from authguard_r.cli.inputs import JsonFlag, load_site, wall_now
from authguard_r.cli.mission_files import lint_json, mission_digest, read_unverified, write_whole
from authguard_r.cli.out import emit
from authguard_r.compile.card import card_digest, review
from authguard_r.compile.confirmation import How, confirm, confirmation_bytes
from authguard_r.compile.lint import Code, LintFinding, errors, finding_lines, lint
from authguard_r.core.encoding import Tag
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import read_signer


class _Reading(Struct, frozen=True, kw_only=True):
    """What the signer gets to see; without the site there is nothing to see."""

    card: tuple[str, ...] = ()
    findings: tuple[LintFinding, ...] = ()

    def lines(self) -> list[str]:
        """Return all of it."""
        return [*self.card, *finding_lines(self.findings)]


def sign_command(
    mission: Annotated[Path, typer.Argument(help="A mission as `compile` wrote it.")],
    key: Annotated[Path, typer.Option("--key", help="The issuer's key.")],
    cert: Annotated[Path, typer.Option("--cert", help="The key's certificate chain.")],
    site: Annotated[
        Path | None, typer.Option("--site", help="The site, to show card and lint before signing.")
    ] = None,
    accept: Annotated[
        list[str] | None,
        typer.Option("--accept", help="A lint error to sign nevertheless; may be repeated."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Where to write the token.")] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask; recorded as confirmed by a script.")
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Show the card, ask, and sign. The structure is signed, never the sentence."""
    opened = read_unverified(mission)
    reading = _Reading()
    if site is not None:
        model = load_site(site)
        reading = _Reading(card=review(opened, model), findings=lint(opened, model))
    accepted = _accepted(accept or [], reading)
    open_errors = sorted(set(errors(reading.findings)).difference(accepted))
    if open_errors:
        return _refused(reading, open_errors, as_json=as_json)
    if not yes:
        shown = reading.lines() or [f"{opened.mid} version {opened.version}"]
        typer.echo("\n".join(shown), err=as_json)
        typer.confirm("Sign exactly this?", abort=True, err=as_json)
    token = sign_object(opened, Tag.MISSION, read_signer(key, cert))
    target = out or mission.with_name(mission.name.removesuffix(".json") + ".token")
    payload = _write(target, token, opened, reading, accepted, yes=yes)
    emit(payload, [f"{target}", f"digest {mission_digest(opened)}"], as_json=as_json)
    return 0


def _write(
    target: Path,
    token: bytes,
    mission: Mission,
    reading: _Reading,
    accepted: tuple[Code, ...],
    *,
    yes: bool,
) -> dict[str, Any]:
    """Write the confirmation, then the token: no token is without its confirmation."""
    confirmation = confirm(
        mission,
        card=card_digest(reading.card) if reading.card else None,
        how=How.SCRIPT if yes else How.INTERACTIVE,
        accepted=accepted,
        now=wall_now(None),
    )
    beside = target.with_suffix(".confirmation.json")
    write_whole(beside, confirmation_bytes(confirmation))
    write_whole(target, token)
    return {
        "file": str(target),
        "digest": mission_digest(mission),
        "confirmation": msgspec.to_builtins(confirmation),
        "confirmation_file": str(beside),
        "lint": lint_json(reading.findings),
    }


def _accepted(names: list[str], reading: _Reading) -> tuple[Code, ...]:
    """Return the codes that the signer accepts; only what was found can be accepted."""
    found = errors(reading.findings)
    for name in names:
        if name not in found:
            raise typer.BadParameter(
                f"there is no lint error `{name}` to accept", param_hint="--accept"
            )
    return tuple(code for code in found if code in names)


def _refused(reading: _Reading, codes: list[Code], *, as_json: bool) -> int:
    """Say what the signer has to mend or accept, and sign nothing."""
    message = f"mend it, or accept each by name: {' '.join(f'--accept {code}' for code in codes)}"
    where = next(f.where for f in reading.findings if f.code in codes)
    if as_json:
        error = {"code": "LINT", "message": message, "where": where}
        emit({"error": error, "lint": lint_json(reading.findings)}, (), as_json=True)
    else:
        typer.echo("\n".join([*reading.lines(), f"LINT: {message}"]), err=True)
    return 1
