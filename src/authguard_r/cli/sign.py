# SPDX-License-Identifier: Apache-2.0
"""`authguard mission sign`: show the card, refuse what was not accepted, ask, sign, record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from msgspec import Struct

from authguard_r.authoring.compile.card import card_digest, review
from authguard_r.authoring.compile.lint import (
    LintCode,
    LintFinding,
    errors,
    finding_lines,
    lint,
    lint_alone,
)
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.inputs import JsonFlag, load_site, wall_now
from authguard_r.cli.mission_files import (
    beside_token,
    lint_json,
    mission_digest,
    read_unverified,
    warn,
)
from authguard_r.cli.signing_key import (
    CertOption,
    KeyOption,
    PassphraseFile,
    certificate_of,
    open_signer,
    require_role,
)
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.confirmation import ConfirmationMode, confirm, confirmation_bytes
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.keys.signer import FileSigner
from authguard_r.wire.output import emit

_NO_SITE = "name the site with --site: the card that you sign is made from it"

ShownSite = Annotated[
    Path | None,
    typer.Option(
        "--site",
        envvar="AUTHGUARD_SITE",
        help="The site model, for card and findings; only --yes works without.",
    ),
]
AcceptOption = Annotated[
    list[str] | None,
    typer.Option("--accept", help="Code of an error to accept; repeatable."),
]
SignerTrust = Annotated[
    Path | None,
    typer.Option(
        "--trust",
        envvar="AUTHGUARD_TRUST",
        help="The trust folder (default: the folder of --cert).",
    ),
]
TokenOut = Annotated[Path | None, typer.Option("--out", help="File for the token.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask; the record says `script`.")]


class SignerView(Struct, frozen=True, kw_only=True):
    """What the signer gets to see; without the site there is no card, and little lint."""

    card: tuple[str, ...] = ()
    findings: tuple[LintFinding, ...] = ()

    def lines(self) -> list[str]:
        """Return all of it."""
        return [*self.card, *finding_lines(self.findings)]

    def unaccepted(self, accepted: tuple[LintCode, ...]) -> list[LintCode]:
        """Return the lint errors that the signer did not accept."""
        return sorted(set(errors(self.findings)).difference(accepted))


class Agreed(Struct, frozen=True, kw_only=True):
    """How the signer came to sign: what a confirmation records of it."""

    card: Digest | None
    how: ConfirmationMode
    accepted: tuple[LintCode, ...]
    now: Now


def sign_command(
    mission: Annotated[Path, typer.Argument(help="A mission as `compile` wrote it.")],
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    site: ShownSite = None,
    accept: AcceptOption = None,
    trust: SignerTrust = None,
    out: TokenOut = None,
    yes: YesOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Show the card, ask, and sign. The signature covers the structure, not the sentence."""
    require_shown(site, yes=yes)
    opened, signer = read_unverified(mission), open_signer(key, cert, passphrase_file)
    require_issuer(opened, signer, trust_folder_of(trust, certificate_of(key, cert)))
    reading = _read(opened, site)
    accepted = accepted_codes(accept or [], reading)
    if unaccepted := reading.unaccepted(accepted):
        return refuse_lint(reading, unaccepted, as_json=as_json)
    agreed = agree(reading, accepted, "Sign exactly this?", yes=yes, as_json=as_json)
    confirmation = confirm(
        opened, card=agreed.card, how=agreed.how, accepted=agreed.accepted, now=agreed.now
    )
    target = out or mission.with_name(mission.name.removesuffix(".json") + ".token")
    token = sign_object(opened, Tag.MISSION, signer)
    beside = write_signed(target, token, confirmation_bytes(confirmation))
    payload = {
        "file": str(target),
        "digest": mission_digest(opened),
        "card": list(reading.card),
        "confirmation": {"card": None, **msgspec.to_builtins(confirmation)},
        "confirmation_file": str(beside),
        "lint": lint_json(reading.findings),
    }
    shown = reading.lines() if yes else []
    emit(payload, [*shown, f"{target}", f"digest {mission_digest(opened)}"], as_json=as_json)
    return 0


def _read(mission: Mission, site: Path | None) -> SignerView:
    """Return card and lint; without the site only what can be found without it."""
    if site is None:
        return SignerView(findings=lint_alone(mission))
    model = load_site(site)
    return SignerView(card=review(mission, model), findings=lint(mission, model))


def require_shown(site: Path | None, *, yes: bool) -> None:
    """Refuse to ask a person about something that is not shown."""
    if site is None and not yes:
        raise typer.BadParameter(_NO_SITE, param_hint="--site")


def agree(
    reading: SignerView, accepted: tuple[LintCode, ...], question: str, *, yes: bool, as_json: bool
) -> Agreed:
    """Ask a person, unless a script signs, and say what was agreed to.

    Args:
        reading: what was shown; without a card nothing was.
        accepted: lint errors that were accepted by name.
        question: what a person is asked.
        yes: a script signs.
        as_json: where the question goes.
    """
    if not reading.card:
        warn(f"no card was shown, and the confirmation says so; {_NO_SITE}")
    person = not yes and confirm_shown(reading.lines(), question, as_json=as_json)
    return Agreed(
        card=card_digest(reading.card) if reading.card else None,
        how=ConfirmationMode.INTERACTIVE if person else ConfirmationMode.SCRIPT,
        accepted=accepted,
        now=wall_now(None),
    )


def trust_folder_of(trust: Path | None, cert: Path) -> Path | None:
    """Return the folder that was named, else the one that the certificate lies in."""
    around = cert.absolute().parent.parent
    return around if trust is None and (around / "root.pem").is_file() else trust


def require_issuer(mission: Mission, signer: FileSigner, folder: Path | None) -> None:
    """Refuse a key that every gate would refuse; a signature by the wrong person is no mission.

    Without a trust folder the owner of the key is unknown, but a certificate that does not even
    claim to be the issuer's is refused all the same.

    Raises:
        AuthenticityError: the certificate does not hold under the trust root, or claims nothing.
        RefusedError: its role issues no missions, or it belongs to another person.
    """
    from authguard_r.enforcement.inputs import ISSUER_ROLES

    if folder is None:
        warn("whose key it is was not checked; name the trust folder with --trust")
    principal = require_role(signer, ISSUER_ROLES, folder)
    if principal != mission.issuer:
        raise RefusedError(
            f"expected the key of `{mission.issuer}`, got `{principal}`'s",
            reason=Reason.ISSUER_MISMATCH,
            where="mission.issuer",
        )


def sign_shown(
    value: object,
    tag: Tag,
    signer: FileSigner,
    *,
    card: list[str],
    target: Path,
    payload: dict[str, Any],
    yes: bool,
    as_json: bool,
) -> int:
    """Show what is to be signed, ask, sign, write the token, say where; without a yes, nothing.

    Args:
        value: what is signed.
        tag: its kind.
        signer: the key, whose role was looked at before.
        card: the value for the person who signs it.
        target: where the token goes.
        payload: the JSON output.
        yes: a script signs: no question is asked, and what was signed is shown afterwards.
        as_json: print the payload; the question goes to standard error.

    Raises:
        typer.Abort: the person said no.
        EnvironmentFault: the token could not be written.
    """
    if not yes:
        confirm_shown(card, "Sign exactly this?", as_json=as_json)
    write_whole(target, sign_object(value, tag, signer))
    emit(payload, [*(card if yes else []), str(target)], as_json=as_json)
    return 0


def write_signed(target: Path, token: bytes, confirmation: bytes) -> Path:
    """Write the confirmation, then the token: no token is without its confirmation.

    Both say what a robot is to do: their owner alone reads them.
    """
    beside = beside_token(target)
    write_whole(beside, confirmation, mode=PRIVATE)
    write_whole(target, token, mode=PRIVATE)
    return beside


def accepted_codes(names: list[str], reading: SignerView) -> tuple[LintCode, ...]:
    """Return the codes that the signer accepts; only what was found can be accepted."""
    found = errors(reading.findings)
    for name in names:
        if name not in found:
            raise typer.BadParameter(
                f"there is no lint error `{name}` to accept", param_hint="--accept"
            )
    return tuple(code for code in found if code in names)


def refuse_lint(reading: SignerView, codes: list[LintCode], *, as_json: bool) -> int:
    """Say what the signer has to fix or accept, and sign nothing."""
    accepted = " ".join(f"--accept {code}" for code in codes)
    message = f"correct the draft, or accept each by name: {accepted}"
    where = next(f.where for f in reading.findings if f.code in codes)
    if as_json:
        error = {"code": "LINT", "message": message, "where": where}
        emit({"error": error, "lint": lint_json(reading.findings)}, (), as_json=True)
    else:
        typer.echo("\n".join([*reading.lines(), f"LINT: {message}"]), err=True)
    return 1
