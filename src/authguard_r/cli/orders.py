# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`, second half: the acts that change authority, on a store no gate holds."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.approvals import Selection
from authguard_r.assembly import folder_signer, offline_gate
from authguard_r.cli.ask import confirm_shown
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
from authguard_r.cli.mission_files import beside_token, warn
from authguard_r.cli.out import emit
from authguard_r.commands import Command, Verb
from authguard_r.compile import spoken
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.token import sign_object, verify_mission
from authguard_r.intake import ISSUER_ROLES
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.management import Management
from authguard_r.site.model import Site

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
        Path | None,
        typer.Option(
            "--confirmation", help="The record of its signing (default: the one beside the token)."
        ),
    ] = None,
    robot: RobotOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Take in a signed mission (or the active one's next version) and make it active."""
    data = read_file(token)
    said = _confirmation(token, confirmation)
    if said is None:
        warn("no confirmation lies beside the token: the log will say that none was given")
    return _manage(
        store,
        trust,
        site,
        robot,
        lambda m: m.activate(data, confirmation=said),
        as_json=as_json,
    )


def _confirmation(token: Path, named: Path | None) -> bytes | None:
    """Return the record of the signing: the one that was named, else the one beside the token."""
    beside = beside_token(token)
    if named is None and not beside.exists():
        return None
    return read_file(beside if named is None else named)


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
    row: Annotated[
        int, typer.Option("--row", help="Its number, from 0, as `review` shows it.", min=0)
    ],
    key: KeyOption = None,
    cert: CertOption = None,
    robot: RobotOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for scripts.")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Choose, signed, one of the rows that a grant offers; at a terminal it shows it and asks."""
    signer = _issuer(token, trust, key, cert)
    verified = read_mission(token, read_trust(trust), wall_now(None))
    shown = _row_lines(verified.mission, grant, row, load_site(site, trust))
    asks = not yes and sys.stdin.isatty()  # where nobody is, the command is the order
    if asks:
        if not shown:
            raise typer.BadParameter("the mission has no such row", param_hint="--row")
        confirm_shown(shown, "Choose exactly this?", as_json=as_json)
    at = wall_now(None)
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
    said = [] if asks else shown
    return _manage(store, trust, site, robot, lambda m: m.select(signed), said, as_json=as_json)


def _row_lines(mission: Mission, grant: str, number: int, site: Site) -> list[str]:
    """Return the row in the card's words; none when there is no such row, which the gate refuses.

    A choice that is not possible leaves its record like any other order, so it is not stopped here.
    """
    named = next((g for g in mission.actions if g.id == grant), None)
    if named is None or number >= len(named.alternatives):
        return []
    return [
        f"{named.id}: {named.type} with {named.tool}",
        f"  row {number}: {spoken.row(named.alternatives[number], site)}",
    ]


def _manage(
    store: Path,
    trust: Path,
    site: Path,
    robot: str | None,
    act: Callable[[Management], Standing],
    said: Iterable[str] = (),
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
    lines = [*said, f"{standing.mid} version {standing.version}: {standing.status}"]
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
