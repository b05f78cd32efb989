# SPDX-License-Identifier: Apache-2.0
"""`authguard mission template`: a mission signed once with holes, and who may fill them."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.authoring.compile.card import card_digest
from authguard_r.authoring.compile.lint import lint_alone
from authguard_r.authoring.keys.setup import Member, add_member
from authguard_r.authoring.templates.card import (
    every_mission,
    lint_template,
    require_known,
    review_template,
)
from authguard_r.authoring.templates.derive import compile_template, template_bytes
from authguard_r.cli.gateway import Orders
from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    SiteOption,
    TrustOption,
    load_site,
    wall_now,
)
from authguard_r.cli.mission_files import beside_token, lint_json, payload_of, warn
from authguard_r.cli.offline import CounterOption, NewOption, OfflineStore
from authguard_r.cli.orders import ORDER_MS, RobotOption, StoreOption, alone, managed
from authguard_r.cli.sign import (
    AcceptOption,
    ShownSite,
    SignerTrust,
    SignerView,
    TokenOut,
    YesOption,
    accepted_codes,
    agree,
    refuse_lint,
    require_issuer,
    require_shown,
    trust_folder_of,
    write_signed,
)
from authguard_r.cli.signing_key import (
    CertOption,
    KeyOption,
    OrderKeyOption,
    PassphraseFile,
    certificate_of,
    open_signer,
    signer_of,
)
from authguard_r.core.encoding import Tag, b64, decode, digest_of
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.enforcement.templates import (
    Template,
    TemplateStanding,
    open_template,
    require_sound,
)
from authguard_r.enforcement.templates.confirmation import confirm_template, confirmation_bytes
from authguard_r.keys.certificate import Role
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site.source import read_text, read_yaml
from authguard_r.wire.output import emit

TemplateFile = Annotated[Path, typer.Argument(help="A template, compiled or signed.")]
SignedTemplate = Annotated[Path, typer.Argument(help="A signed template.")]


def read_template(path: Path) -> Template:
    """Return a template from `compile`'s file or from a token: sound, its signature unread.

    Raises:
        MalformedError: neither.
    """
    template = decode(payload_of(path), Template, where="template")
    require_sound(template)
    return template


def template_digest(template: Template) -> Digest:
    """Return the digest that a signature over the template binds, and a scheduler's certificate."""
    return digest_of(Tag.TEMPLATE, template)


def compile_command(
    draft: Annotated[Path, typer.Argument(help="A template draft (YAML).")],
    site: SiteOption,
    out: Annotated[Path | None, typer.Option("--out", help="File to write.")] = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Compile a draft with holes to a template, or print the questions that are open (exit 3)."""
    plain = read_yaml(read_text(draft), where=str(draft))
    template = compile_template(plain, load_site(site), now=wall_now(now))
    target = out or draft.with_suffix(".template.json")
    write_whole(target, template_bytes(template), mode=PRIVATE)
    hashed = template_digest(template)
    payload = {"file": str(target), "digest": hashed, "template": msgspec.to_builtins(template)}
    emit(payload, [f"{target}", f"digest {hashed}"], as_json=as_json)
    return 0


def review_command(template: TemplateFile, site: SiteOption, as_json: JsonFlag = False) -> int:
    """Show the card: every hole with all its values, and every mission that results."""
    opened = read_template(template)
    missions = every_mission(opened)
    reading = _read(opened, missions, site)
    payload = {
        "card": list(reading.card),
        "card_digest": card_digest(reading.card),
        "combinations": len(missions),
        "digest": template_digest(opened),
        "lint": lint_json(reading.findings),
    }
    emit(payload, reading.lines(), as_json=as_json)
    return 0


def sign_command(
    template: Annotated[Path, typer.Argument(help="A template as `compile` wrote it.")],
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
    """Show every mission of a template, ask once, and sign. Every combination must be valid."""
    require_shown(site, yes=yes)
    opened, signer = read_template(template), open_signer(key, cert, passphrase_file)
    missions = every_mission(opened)
    require_issuer(missions[0], signer, trust_folder_of(trust, certificate_of(key, cert)))
    reading = _read(opened, missions, site)
    accepted = accepted_codes(accept or [], reading)
    if unaccepted := reading.unaccepted(accepted):
        return refuse_lint(reading, unaccepted, as_json=as_json)
    question = f"Sign exactly this, for {opened.instances} missions?"
    agreed = agree(reading, accepted, question, yes=yes, as_json=as_json)
    confirmation = confirm_template(
        opened, card=agreed.card, how=agreed.how, accepted=agreed.accepted, now=agreed.now
    )
    target = out or template.with_name(template.name.removesuffix(".json") + ".token")
    token = sign_object(opened, Tag.TEMPLATE, signer)
    beside = write_signed(target, token, confirmation_bytes(confirmation))
    hashed = template_digest(opened)
    payload = {
        "file": str(target),
        "digest": hashed,
        "card": list(reading.card),
        "combinations": len(missions),
        "confirmation": {"card": None, **msgspec.to_builtins(confirmation)},
        "confirmation_file": str(beside),
        "lint": lint_json(reading.findings),
    }
    shown = reading.lines() if yes else []
    emit(payload, [*shown, f"{target}", f"digest {hashed}"], as_json=as_json)
    return 0


def _read(template: Template, missions: tuple[Mission, ...], site: Path | None) -> SignerView:
    """Return card and lint of every combination; without the site only what needs none."""
    if site is None:
        each = dict.fromkeys(found for mission in missions for found in lint_alone(mission))
        return SignerView(findings=tuple(each))
    model = load_site(site)
    require_known(template, model)
    card = tuple(review_template(template, missions, model))
    return SignerView(card=card, findings=lint_template(missions, model))


def show_command(template: TemplateFile, as_json: JsonFlag = False) -> int:
    """Print the template in a token. The signature is not verified."""
    opened = read_template(template)
    payload: dict[str, Any] = {
        "template": msgspec.to_builtins(opened),
        "digest": template_digest(opened),
    }
    lines = [f"{opened.template}: at most {opened.instances} missions, until {opened.not_after}"]
    lines += [
        f"  {name} ({hole.kind}): {', '.join(map(str, hole.values))}"
        for name, hole in sorted(opened.holes.items())
    ]
    emit(payload, [*lines, f"digest {payload['digest']}", "(not verified)"], as_json=as_json)
    return 0


def issue_command(
    template: SignedTemplate,
    trust: TrustOption,
    name: Annotated[str, typer.Option("--name", help="The scheduler's name.")] = "scheduler-1",
    days: Annotated[
        int, typer.Option("--days", help="Days that the certificate is valid.", min=1)
    ] = 30,
    as_json: JsonFlag = False,
) -> int:
    """Make a scheduler's key and a certificate that is bound to this template (demonstration)."""
    from authguard_r.enforcement.inputs import ISSUER_ROLES

    at = wall_now(None)
    held = open_template(
        read_file(template), verifier=read_trust(trust), now=at, roles=ISSUER_ROLES
    )
    member = Member(id=name, role=Role.SCHEDULER, robots=None, regions=None, template=held.digest)
    add_member(trust, member, now=datetime.now(UTC), days=days)
    signer = folder_signer(trust, name)
    read_trust(trust).scheduled_template(signer.chain, wall_now(None))  # it holds, or says why not
    key, cert = f"keys/{name}.key.pem", f"keys/{name}.cert.pem"
    payload = {"scheduler": name, "template": held.digest, "key": key, "cert": cert}
    lines = [f"{trust}: {key}  {cert}", f"may fill {held.template.template} ({held.digest})"]
    emit(payload, lines, as_json=as_json)
    return 0


def admit_command(
    template: SignedTemplate,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    robot: RobotOption = None,
    counter: CounterOption = None,
    new: NewOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Give the gate a signed template; from then on its scheduler may fill it in."""
    data, beside = read_file(template), beside_token(template)
    said = read_file(beside) if beside.exists() else None
    if said is None:
        warn("no confirmation lies next to the token: the log will record no confirmation")

    def act(orders: Orders) -> TemplateStanding:
        return orders.template(data, confirmation=said)

    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter, new=new)
    return _manage(place, act, as_json=as_json)


def withdraw_command(
    template: SignedTemplate,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    robot: RobotOption = None,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """End a template with a signed order; all its missions end, the active one too."""
    opened = read_template(template)
    signer = signer_of(opened.mission["issuer"], trust, key, cert, passphrase_file)
    command = Command(
        verb=Verb.WITHDRAW,
        mid=MissionId(opened.template),
        version=1,
        mission=template_digest(opened),
        nonce=b64(os.urandom(16)),
        expires_ms=wall_now(None).utc_ms + ORDER_MS,
    )
    signed = sign_object(command, Tag.COMMAND, signer)
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
    return _manage(place, lambda m: m.template(signed), as_json=as_json)


def _manage(
    place: OfflineStore, act: Callable[[Orders], TemplateStanding], *, as_json: bool
) -> int:
    """Have one act about a template done, by the gate that holds the store or on the store."""
    held, by_gate = managed(place, act)
    status = "withdrawn" if held.withdrawn else "here"
    line = f"{held.template}: {status}, {held.used} of {held.instances} missions made"
    payload = {"template": msgspec.to_builtins(held), "status": status, "by_gate": by_gate}
    emit(payload, [line, *alone(by_gate, place)], as_json=as_json)
    return 0
