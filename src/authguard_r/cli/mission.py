# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`: compile, review, sign, verify, and the acts that change authority."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    SiteOption,
    TrustOption,
    load_site,
    read_mission,
    wall_now,
)
from authguard_r.cli.out import emit
from authguard_r.compile.build import compile_draft
from authguard_r.compile.card import compare, review
from authguard_r.compile.draft import Draft
from authguard_r.core.encoding import Tag, b64, decode, digest, digest_of, encode, unb64
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission, require_schema
from authguard_r.core.token import read_token, sign_object
from authguard_r.keys.signer import read_signer
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site.source import convert, read_text, read_yaml

app = typer.Typer(help="Missions: from a draft to signed authority and back.", no_args_is_help=True)
MissionArgument = Annotated[Path, typer.Argument(help="A mission as `compile` wrote it.")]
TokenArgument = Annotated[Path, typer.Argument(help="A signed mission.")]


@app.command("compile")
def compile_command(
    draft: Annotated[Path, typer.Argument(help="A mission draft (YAML).")],
    site: SiteOption,
    supersedes: Annotated[
        Path | None, typer.Option("--supersedes", help="The token of the version before.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Where to write it.")] = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Turn a draft into the canonical mission, or ask what only a person can say (exit 3)."""
    plain = read_yaml(read_text(draft), where=str(draft))
    model = load_site(site)
    if supersedes is not None and isinstance(plain, dict):
        payload = unb64(read_token(read_file(supersedes)).payload, where="token.payload")
        old = decode(payload, Mission, where="mission")
        plain |= {"version": old.version + 1, "supersedes": digest(Tag.MISSION, payload)}
    mission = compile_draft(
        convert(plain, Draft, where=str(draft)), model, now=wall_now(now), nonce=b64(os.urandom(16))
    )
    target = out or draft.with_suffix(".mission.json")
    target.write_bytes(encode(mission) + b"\n")
    hashed = digest_of(Tag.MISSION, mission)
    payload_json = {
        "file": str(target),
        "digest": hashed,
        "mission": msgspec.to_builtins(mission),
        "card": list(review(mission, model)),
    }
    emit(payload_json, [f"{target}", f"digest {hashed}"], as_json=as_json)
    return 0


@app.command("review")
def review_command(
    mission: MissionArgument,
    site: SiteOption,
    against: Annotated[
        Path | None, typer.Option("--against", help="The version before; shows what is added.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Show the operator's card: what is granted, row by row, and what is not."""
    model, new = load_site(site), _read_mission(mission)
    lines = [*review(new, model)]
    changes: list[str] = []
    if against is not None:
        changes = list(compare(_read_mission(against), new, model))
        lines = ["Against the version before:", *(f"  {c}" for c in changes), *lines]
    payload = {"card": list(review(new, model)), "changes": changes, "digest": _digest(new)}
    emit(payload, lines, as_json=as_json)
    return 0


@app.command("sign")
def sign_command(
    mission: MissionArgument,
    key: Annotated[Path, typer.Option("--key", help="The issuer's key.")],
    cert: Annotated[Path, typer.Option("--cert", help="The key's certificate chain.")],
    site: Annotated[
        Path | None, typer.Option("--site", help="The site, to show the card before signing.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Where to write the token.")] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask; recorded as confirmed by a script.")
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Show the card, ask, and sign. The structure is signed, never the sentence."""
    opened = _read_mission(mission)
    require_schema(opened)
    card: list[str] = []
    if site is not None:
        card = list(review(opened, load_site(site)))
    if not yes:
        typer.echo("\n".join(card or [f"{opened.mid} version {opened.version}"]), err=as_json)
        typer.confirm("Sign exactly this?", abort=True, err=as_json)
    token = sign_object(opened, Tag.MISSION, read_signer(key, cert))
    target = out or mission.with_name(mission.name.removesuffix(".json") + ".token")
    target.write_bytes(token)
    confirmation = {
        "mission": _digest(opened),
        "request": opened.task,
        "card": digest(Tag.RAW, "\n".join(card).encode()) if card else None,
        "by": opened.issuer,
        "at_ms": wall_now(None).utc_ms,
        "how": "script" if yes else "interactive",
    }
    target.with_suffix(".confirmation.json").write_text(json.dumps(confirmation, indent=1) + "\n")
    payload = {"file": str(target), "digest": _digest(opened), "confirmation": confirmation}
    emit(payload, [f"{target}", f"digest {_digest(opened)}"], as_json=as_json)
    return 0


@app.command("verify")
def verify_command(
    token: TokenArgument, trust: TrustOption, now: NowOption = None, as_json: JsonFlag = False
) -> int:
    """Check certificate, signature and schema of a mission, and say whose it is."""
    at = wall_now(now)
    verified = read_mission(token, read_trust(trust), at)
    in_time = verified.not_before_ms <= at.utc_ms <= verified.expiry_ms
    payload = {
        "valid": True,
        "in_time": in_time,
        "mid": verified.mission.mid,
        "version": verified.mission.version,
        "digest": verified.digest,
        "issuer": verified.issuer.id,
        "role": verified.issuer.role,
    }
    lines = [
        f"authentic: {verified.mission.mid} version {verified.mission.version}",
        f"signed by {verified.issuer.id} ({verified.issuer.role})",
        f"digest {verified.digest}",
        "in time" if in_time else "NOT in time: it authorizes nothing now",
    ]
    emit(payload, lines, as_json=as_json)
    return 0 if in_time else 1


@app.command("show")
def show_command(token: TokenArgument, as_json: JsonFlag = False) -> int:
    """Print what a token says, without any claim that it is authentic."""
    opened = read_token(read_file(token))
    mission = decode(unb64(opened.payload, where="token.payload"), Mission, where="mission")
    payload = {"mission": msgspec.to_builtins(mission), "digest": _digest(mission)}
    lines = [json.dumps(payload["mission"], indent=2), "(not verified)"]
    emit(payload, lines, as_json=as_json)
    return 0


@app.command("diff")
def diff_command(
    old: TokenArgument,
    new: Annotated[Path, typer.Argument(help="The next version.")],
    site: SiteOption,
    as_json: JsonFlag = False,
) -> int:
    """Show what a new version changes, widening first."""
    changes = list(compare(_read_mission(old), _read_mission(new), load_site(site)))
    emit({"changes": changes}, changes, as_json=as_json)
    return 0


def _read_mission(path: Path) -> Mission:
    """Return a mission from `compile`'s file or from a token, unverified.

    Raises:
        MalformedError: neither.
    """
    data = read_file(path)
    if b'"endorsements"' in data:
        data = unb64(read_token(data).payload, where="token.payload")
    return decode(data.removesuffix(b"\n"), Mission, where="mission")


def _digest(mission: Mission) -> Digest:
    return digest_of(Tag.MISSION, mission)
