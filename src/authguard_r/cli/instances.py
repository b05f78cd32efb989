# SPDX-License-Identifier: Apache-2.0
"""`authguard mission instance`: a scheduler fills a signed template."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.inputs import JsonFlag, NowOption, wall_now
from authguard_r.cli.mission_files import mission_digest, warn
from authguard_r.cli.sign import trust_folder_of
from authguard_r.cli.signing_key import (
    CertOption,
    KeyOption,
    PassphraseFile,
    certificate_of,
    open_signer,
)
from authguard_r.cli.templates import SignedTemplate, read_template, template_digest
from authguard_r.core.encoding import b64
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates import (
    Hole,
    HoleKind,
    Instance,
    Template,
    covered,
    sign_instance,
)
from authguard_r.enforcement.templates.template import HoleName, Value
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import read_trust
from authguard_r.wire.output import emit


def sign_command(
    template: SignedTemplate,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    fill: Annotated[
        list[str] | None, typer.Option("--fill", help="HOLE=VALUE; repeat for every hole.")
    ] = None,
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the mission; `TEMPLATE.` comes before it.")
    ] = None,
    lasts: Annotated[
        str | None,
        typer.Option("--for", help="How long it is valid: `10 min` (default: the longest)."),
    ] = None,
    now: NowOption = None,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="The trust folder (default: the folder of --cert)."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="File for the token.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Fill in every hole with one of its values, and sign, without a question."""
    opened, signer = read_template(template), open_signer(key, cert, passphrase_file)
    _require_bound(opened, signer, trust_folder_of(trust, certificate_of(key, cert)))
    at = wall_now(now)
    length = opened.for_ms if lasts is None else to_integer(lasts, "ms", where="--for")
    instance = Instance(
        template=template_digest(opened),
        fill=_read_fill(fill or [], opened),
        mid=MissionId(f"{opened.template}.{name or os.urandom(8).hex()}"),
        nonce=b64(os.urandom(16)),
        not_before=to_timestamp(at.utc_ms),
        expiry=to_timestamp(at.utc_ms + length),
    )
    mission = covered(instance, opened, instance.template)
    target = out or template.with_name(f"{instance.mid}.token")
    write_whole(target, sign_instance(instance, signer), mode=PRIVATE)
    payload = {
        "file": str(target),
        "mid": instance.mid,
        "task": mission.task,
        "digest": mission_digest(mission),
        "expiry": instance.expiry,
    }
    lines = [f"{target}", f"{instance.mid}: {mission.task}", f"digest {payload['digest']}"]
    emit(payload, lines, as_json=as_json)
    return 0


def _require_bound(template: Template, signer: FileSigner, folder: Path | None) -> None:
    """Refuse a key that every gate would refuse; without a trust folder this is unknown.

    Raises:
        AuthenticityError: the certificate does not hold, or is no scheduler's.
        RefusedError: it is bound to another template.
    """
    if folder is None:
        warn("whose key it is was not checked; name the trust folder with --trust")
        return
    bound = read_trust(folder).scheduled_template(signer.chain, wall_now(None))
    if bound != template_digest(template):
        raise RefusedError(
            f"the certificate is bound to template `{bound}`",
            reason=Reason.ROLE_DENIED,
            where="--cert",
        )


def _read_fill(said: list[str], template: Template) -> dict[HoleName, Value]:
    """Return the values by hole; each hole once."""
    found: dict[HoleName, Value] = {}
    for text in said:
        name, equals, value = text.partition("=")
        hole = HoleName(name)
        if not equals or hole in found:
            raise typer.BadParameter(
                "expected hole=value, each hole once", param_hint=f"--fill {text}"
            )
        found[hole] = _value(value, template.holes.get(hole), text)
    return found


def _value(text: str, hole: Hole | None, said: str) -> Value:
    if hole is None or hole.kind is not HoleKind.INTEGER:
        return text
    try:
        return int(text)
    except ValueError as error:
        raise typer.BadParameter("expected an integer", param_hint=f"--fill {said}") from error
