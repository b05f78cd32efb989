# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`, second half: the acts that change authority, by the gate or on its store."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import typer

from authguard_r.approvals import Selection
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.file_kinds import TOKEN, expecting
from authguard_r.cli.gateway import Orders, Remote, running_gate
from authguard_r.cli.inputs import (
    JsonFlag,
    SiteOption,
    TokenArgument,
    TrustOption,
    gate_robot,
    load_site,
    read_mission,
    wall_now,
)
from authguard_r.cli.mission_files import beside_token, warn
from authguard_r.cli.offline import CounterOption, NewOption, OfflineStore, offline
from authguard_r.cli.signing_key import CertOption, OrderKeyOption, PassphraseFile, signer_of
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest, GrantId
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.token import VerifiedMission, read_token, sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.enforcement.templates import instantiate, open_template
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site import formatting
from authguard_r.site.model import Site
from authguard_r.wire.output import emit

T = TypeVar("T")
StoreOption = Annotated[
    Path, typer.Option("--store", envvar="AUTHGUARD_STORE", help="The robot's store.")
]
RobotOption = Annotated[
    str | None, typer.Option("--robot", help="The robot, if the trust folder has several gates.")
]
ConfirmationOption = Annotated[
    Path | None,
    typer.Option(
        "--confirmation", help="The confirmation of its signing (default: beside the token)."
    ),
]
TemplateOption = Annotated[
    Path | None,
    typer.Option("--template", help="The signed template, when TOKEN is an instance of it."),
]


class KnownOutcome(StrEnum):
    """How a release can be said to have ended; an unknown end needs no signature."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"
    NOT_STARTED = "not_started"
    ABORTED = "aborted"


#: How long a signed order is worth anything, in milliseconds.
ORDER_MS = 120_000


def issue_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    confirmation: ConfirmationOption = None,
    robot: RobotOption = None,
    counter: CounterOption = None,
    new: NewOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Give the gate a signed mission, its next version, or an instance of a template.

    The mission is not activated.
    """
    data, said = _handed(token, confirmation)
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter, new=new)
    return manage(place, lambda m: m.issue(data, confirmation=said), as_json=as_json)


def activate_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    confirmation: ConfirmationOption = None,
    robot: RobotOption = None,
    counter: CounterOption = None,
    new: NewOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Give the gate a signed mission, its next version, or a template's instance; activate it."""
    data, said = _handed(token, confirmation)
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter, new=new)
    then = f"an operator's stop or an open action suspends it; next: authguard resume {token}"
    return manage(
        place, lambda m: m.activate(data, confirmation=said), suspended=then, as_json=as_json
    )


def _handed(token: Path, named: Path | None) -> tuple[bytes, bytes | None]:
    """Return a token and the record of its signing; a missing record is warned of."""
    data, said = read_file(token), _confirmation(token, named)
    with expecting(token, data, TOKEN):
        kind = read_token(data).kind
    if said is None and kind is not Tag.INSTANCE:
        warn("no confirmation lies next to the token: the log will record no confirmation")
    return data, said


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
        key: OrderKeyOption = None,
        cert: CertOption = None,
        passphrase_file: PassphraseFile = None,
        robot: RobotOption = None,
        template: TemplateOption = None,
        counter: CounterOption = None,
        as_json: JsonFlag = False,
    ) -> int:
        verified = opened_mission(token, trust, template)
        signer = signer_of(verified.mission.issuer, trust, key, cert, passphrase_file)
        place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
        return manage(
            place,
            lambda m: m.command(signed_order(verified, signer, verb, simulated_ms(m, trust))),
            as_json=as_json,
        )

    order.__doc__ = {
        Verb.REVOKE: "End a mission now; the gate refuses its next action.",
        Verb.COMPLETE: "Declare a mission complete.",
        Verb.SUSPEND: "Suspend a mission until it is resumed.",
        Verb.RESUME: "Resume a suspended mission.",
    }[verb]
    return order


revoke_command = _order(Verb.REVOKE)
complete_command = _order(Verb.COMPLETE)
suspend_command = _order(Verb.SUSPEND)
resume_command = _order(Verb.RESUME)


def resolve_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    ticket: Annotated[str, typer.Option("--ticket", help="The open release.")],
    outcome: Annotated[KnownOutcome, typer.Option("--outcome", help="How it ended.")],
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    robot: RobotOption = None,
    template: TemplateOption = None,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Sign how an action ended that the gate could not observe."""
    verified = opened_mission(token, trust, template)
    signer = signer_of(verified.mission.issuer, trust, key, cert, passphrase_file)
    signed = signed_order(
        verified, signer, Verb.RESOLVE, ticket=Digest(ticket), outcome=Outcome(outcome)
    )
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
    return manage(place, lambda m: m.command(signed), as_json=as_json)


def choose_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    grant: Annotated[str, typer.Option("--grant", help="The grant.")],
    row: Annotated[
        int, typer.Option("--row", help="Number of the row, from 0 (see `review`).", min=0)
    ],
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    robot: RobotOption = None,
    template: TemplateOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")] = False,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Sign the choice of one row that a grant offers; at a terminal, show the row and ask first."""
    verified = opened_mission(token, trust, template)
    signer = signer_of(verified.mission.issuer, trust, key, cert, passphrase_file)
    shown = row_lines(verified.mission, grant, row, load_site(site, trust))
    asks = not yes and sys.stdin.isatty()  # without a terminal, the command is the order
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
        expires_ms=at.utc_ms + ORDER_MS,
        issued_ms=at.utc_ms,
    )
    signed = sign_object(selection, Tag.SELECTION, signer)
    said = [] if asks else shown
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
    return manage(place, lambda m: m.select(signed), said, as_json=as_json)


def row_lines(mission: Mission, grant: str, number: int, site: Site) -> list[str]:
    """Return the row in the card's words; none when there is no such row, which the gate refuses.

    A choice that is not possible leaves its record like any other order, so it is not stopped here.
    """
    named = next((g for g in mission.actions if g.id == grant), None)
    if named is None or number >= len(named.alternatives):
        return []
    return [
        f"{named.id}: {named.type} with {named.tool}",
        f"  row {number}: {formatting.row(named.alternatives[number], site)}",
    ]


def manage(
    place: OfflineStore,
    act: Callable[[Orders], Standing],
    said: Iterable[str] = (),
    *,
    suspended: str = "",
    as_json: bool,
) -> int:
    """Have one order carried out, by the gate that has the store open or on the store itself.

    Args:
        place: store, trust root and site.
        act: the order.
        said: lines to print first.
        suspended: what to say of a mission that is suspended after the order.
        as_json: print one JSON object.
    """
    standing, by_gate = managed(place, act)
    payload = {"standing": msgspec.to_builtins(standing), "status": str(standing.status)}
    lines = [*said, f"{standing.mid} version {standing.version}: {standing.status}"]
    lines += [f"  open release {release.ticket}" for release in standing.open]
    lines += [suspended] if suspended and standing.status is Status.SUSPENDED else []
    emit({**payload, "by_gate": by_gate}, [*lines, *alone(by_gate, place)], as_json=as_json)
    return 0


def alone(by_gate: bool, place: OfflineStore) -> list[str]:
    """Return the line that says that no robot has heard of it."""
    return [] if by_gate else [f"no gate answered: this is in the store {place.store} alone"]


def managed(place: OfflineStore, act: Callable[[Orders], T]) -> tuple[T, bool]:
    """Do an act of management, by the gate that holds the store or on the store itself.

    Returns:
        What came of it, and whether a gate did it.

    Raises:
        AuthGuardError: it was refused, or the store is held and its gate does not answer.
    """
    with running_gate(place.store, place.trust, gate_robot(place.trust, place.robot)) as running:
        if running is not None:
            return act(running), True
        with offline(place) as gate:
            return act(gate.management), False


def opened_mission(token: Path, trust: Path, template: Path | None) -> VerifiedMission:
    """Return the mission that an order is about: signed itself, or made of a template."""
    from authguard_r.enforcement.inputs import ISSUER_ROLES

    anchor, at = read_trust(trust), wall_now(None)
    data = read_file(token)
    with expecting(token, data, TOKEN):
        kind = read_token(data).kind
    if kind is not Tag.INSTANCE:
        return read_mission(token, anchor, at)
    if template is None:
        raise typer.BadParameter("an instance needs its template", param_hint="--template")
    held = open_template(read_file(template), verifier=anchor, now=at, roles=ISSUER_ROLES)
    return instantiate(data, held, verifier=anchor, now=at).mission


def simulated_ms(orders: Orders, trust: Path) -> int:
    """Return the clock of a demonstration's gate that simulates its robot; 0 for every other.

    Simulated time runs ahead of the signer's clock while the robot moves. A trust root that is not
    a demonstration's takes no time from a gate.
    """
    if not isinstance(orders, Remote) or not read_trust(trust).demo:
        return 0
    return orders.simulated_ms()


def signed_order(
    verified: VerifiedMission,
    signer: FileSigner,
    verb: Verb,
    at_ms: int = 0,
    *,
    ticket: Digest | None = None,
    outcome: Outcome | None = None,
) -> bytes:
    """Return a signed command about a mission, valid for two minutes.

    Args:
        verified: the mission.
        signer: who gives the order.
        verb: the order.
        at_ms: a simulated clock that the order must not be behind.
        ticket: the open release, for `resolve`.
        outcome: how it ended, for `resolve`.
    """
    now_ms = max(wall_now(None).utc_ms, at_ms)
    command = Command(
        verb=verb,
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        nonce=b64(os.urandom(16)),
        expires_ms=now_ms + ORDER_MS,
        issued_ms=now_ms,
        ticket=ticket,
        outcome=outcome,
    )
    return sign_object(command, Tag.COMMAND, signer)
