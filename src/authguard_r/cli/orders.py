# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`, second half: the acts that change authority, on a store no gate holds."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.approvals import Selection
from authguard_r.assembly import folder_signer, offline_gate
from authguard_r.cli.inputs import (
    JsonFlag,
    SiteOption,
    TrustOption,
    gate_robot,
    load_site,
    read_mission,
    wall_now,
)
from authguard_r.cli.mission import TokenArgument, app
from authguard_r.cli.out import emit
from authguard_r.commands import Command, Verb
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.token import sign_object, verify_mission
from authguard_r.intake import ISSUER_ROLES
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.management import Management

StoreOption = Annotated[Path, typer.Option("--store", help="The robot's store.")]
KeyOption = Annotated[
    Path | None, typer.Option("--key", help="Who gives the order (default: the demo issuer).")
]
CertOption = Annotated[Path | None, typer.Option("--cert", help="The key's certificate chain.")]
RobotOption = Annotated[
    str | None, typer.Option("--robot", help="Which gate of the folder this store is of.")
]
#: How long a signed order is worth anything, in milliseconds.
_ORDER_MS = 120_000


@app.command("activate")
def activate_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    confirmation: Annotated[
        Path | None, typer.Option("--confirmation", help="What `sign` wrote beside the token.")
    ] = None,
    robot: RobotOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Take in a signed mission (or the active one's next version) and make it active."""
    data = read_file(token)
    said = None if confirmation is None else read_file(confirmation)
    return _manage(
        store,
        trust,
        site,
        robot,
        lambda m: m.activate(data, confirmation=said),
        as_json=as_json,
    )


def _order(verb: Verb) -> Callable[..., int]:
    """Return the command that gives one signed order."""

    def order(
        token: TokenArgument,
        trust: TrustOption,
        site: SiteOption,
        store: StoreOption,
        key: KeyOption = None,
        cert: CertOption = None,
        robot: RobotOption = None,
        as_json: JsonFlag = False,
    ) -> int:
        signer = _issuer(token, trust, key, cert)
        signed = _command(token, trust, signer, verb)
        return _manage(store, trust, site, robot, lambda m: m.command(signed), as_json=as_json)

    order.__doc__ = {
        Verb.REVOKE: "End a mission for good; the next action is refused.",
        Verb.COMPLETE: "Declare a mission complete.",
        Verb.SUSPEND: "Hold a mission until it is resumed.",
        Verb.RESUME: "Let a suspended mission go on.",
    }[verb]
    return order


for _verb in (Verb.REVOKE, Verb.COMPLETE, Verb.SUSPEND, Verb.RESUME):
    app.command(str(_verb))(_order(_verb))


@app.command("resolve")
def resolve_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    ticket: Annotated[str, typer.Option("--ticket", help="The open release.")],
    outcome: Annotated[Outcome, typer.Option("--outcome", help="What became of it.")],
    key: KeyOption = None,
    cert: CertOption = None,
    robot: RobotOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Say, signed, how a release ended that nobody could observe."""
    signer = _issuer(token, trust, key, cert)
    signed = _command(token, trust, signer, Verb.RESOLVE, ticket=Digest(ticket), outcome=outcome)
    return _manage(store, trust, site, robot, lambda m: m.command(signed), as_json=as_json)


@app.command("choose")
def choose_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    grant: Annotated[str, typer.Option("--grant", help="The grant.")],
    row: Annotated[int, typer.Option("--row", help="Index of the row, from 0.", min=0)],
    key: KeyOption = None,
    cert: CertOption = None,
    robot: RobotOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Choose, signed, one of the rows that a grant offers."""
    signer = _issuer(token, trust, key, cert)
    at = wall_now(None)
    verified = read_mission(token, read_trust(trust), at)
    selection = Selection(
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        grant=GrantId(grant),
        row=row,
        nonce=b64(os.urandom(16)),
        expires_ms=at.utc_ms + _ORDER_MS,
    )
    signed = sign_object(selection, Tag.SELECTION, signer)
    return _manage(store, trust, site, robot, lambda m: m.select(signed), as_json=as_json)


def _manage(
    store: Path,
    trust: Path,
    site: Path,
    robot: str | None,
    act: Callable[[Management], Standing],
    *,
    as_json: bool,
) -> int:
    """Do one management act on a store that no gate holds, and show the standing."""
    gate = offline_gate(trust, load_site(site, trust), rid=gate_robot(trust, robot), store=store)
    try:
        standing = act(gate.management)
    finally:
        gate.close()
    payload = {"standing": msgspec.to_builtins(standing), "status": str(standing.status)}
    lines = [f"{standing.mid} version {standing.version}: {standing.status}"]
    lines += [f"  open release {release.ticket}" for release in standing.open]
    emit(payload, lines, as_json=as_json)
    return 0


def _issuer(token: Path, trust: Path, key: Path | None, cert: Path | None) -> FileSigner:
    """Return who gives the order: the keys named, else the demo folder's issuer."""
    if key is not None and cert is not None:
        return read_signer(key, cert)
    if key is not None or cert is not None:
        raise typer.BadParameter("--key and --cert go together", param_hint="--key")
    verified = verify_mission(
        read_file(token), verifier=read_trust(trust), now=wall_now(None), roles=ISSUER_ROLES
    )
    return folder_signer(trust, verified.mission.issuer)


def _command(
    token: Path,
    trust: Path,
    signer: FileSigner,
    verb: Verb,
    *,
    ticket: Digest | None = None,
    outcome: Outcome | None = None,
) -> bytes:
    at = wall_now(None)
    verified = read_mission(token, read_trust(trust), at)
    command = Command(
        verb=verb,
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        nonce=b64(os.urandom(16)),
        expires_ms=at.utc_ms + _ORDER_MS,
        ticket=ticket,
        outcome=outcome,
    )
    return sign_object(command, Tag.COMMAND, signer)


__all__ = ["app"]
