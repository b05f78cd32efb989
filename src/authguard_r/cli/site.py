# SPDX-License-Identifier: Apache-2.0
"""`authguard site`: check, look at, compare, import, sign and verify a site model."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.authoring.compile.draft import DraftRisk
from authguard_r.authoring.compile.unlisted import unlisted_names
from authguard_r.authoring.drafting.profile import read_profile
from authguard_r.authoring.site.change import changes, line_of
from authguard_r.authoring.site.nav2 import import_map
from authguard_r.authoring.site.picture import picture
from authguard_r.authoring.site.proposal import SiteProposal, identifier, millimeters, to_yaml
from authguard_r.authoring.site.scene import import_scene
from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    TrustOption,
    claimed_site,
    load_site,
    text_of,
    wall_now,
)
from authguard_r.cli.signing_key import CertOption, KeyOption, PassphraseFile, open_signer
from authguard_r.core.errors import MalformedError
from authguard_r.keys.files import write_whole
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site.check import faults, unreviewed
from authguard_r.site.model import (
    ActionModel,
    Site,
    ancestors,
    profile_digest,
    site_digest,
    stopping_mm,
)
from authguard_r.site.names import shown
from authguard_r.site.places import adjacent
from authguard_r.site.signed import is_token, read_signed_site, sign_site
from authguard_r.site.source import as_text, convert
from authguard_r.site.text_faults import text_faults
from authguard_r.wire.output import emit

SiteArgument = Annotated[Path, typer.Argument(help="The site model (YAML, or a signed token).")]
ForeignArgument = Annotated[Path, typer.Argument(help="The file to import.")]
#: Most names in one note.
_NAMED = 8
OutOption = Annotated[Path, typer.Option("--out", help="Where to write the site (YAML).")]
IdOption = Annotated[
    str | None, typer.Option("--id", help="The site's id (default: from the file's name).")
]
FloorOption = Annotated[int, typer.Option("--floor", help="The floor.")]


def check_command(site: SiteArgument, as_json: JsonFlag = False) -> int:
    """Check a site model and print every fault with its place."""
    data = read_file(site)
    found = () if is_token(data) else text_faults(as_text(data, where=str(site)), where=str(site))
    if found:
        where = f"{site}:{found[0].where}"
        first = {"code": "MALFORMED", "message": found[0].message, "where": where}
        told = {"error": first, "faults": [msgspec.to_builtins(fault) for fault in found]}
        emit(told, [f"{fault.where}: {fault.message}" for fault in found], as_json=as_json)
        return 4
    model = claimed_site(site)
    found, left = faults(model), unreviewed(model)
    notes = [] if found else _unlisted_notes(model)
    payload = {
        "site": model.id,
        "digest": site_digest(model),
        "faults": [msgspec.to_builtins(fault) for fault in found],
        "unreviewed": list(left),
        "notes": notes,
    }
    lines = [f"{fault.where}: {fault.message}" for fault in found]
    if not found:
        lines.append(
            f"{model.id}: sound, {len(model.regions)} regions, {len(model.objects)} objects"
        )
    lines += [f"{place}: unreviewed; it cannot be signed so" for place in left]
    lines += [f"note: {note}" for note in notes]
    emit(payload, lines, as_json=as_json)
    return 4 if found else 0


def _unlisted_notes(site: Site) -> list[str]:
    """Return what the shipped risk policy does not list, and what a drafted mission then asks."""
    able = {name for robot in site.robots.values() for name in robot.profile.tools}
    grantable = [n for n, model in site.vocabulary.items() if n in able and not model.state_writing]
    shipped = convert(read_profile().risk_policy, DraftRisk, where="profile")
    names = unlisted_names(
        shipped, site, types=grantable, objects=site.objects, regions=site.regions
    )
    if not names:
        return []
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    note = (
        f"the default risk policy does not list {', '.join(names[:_NAMED])}{more}: a drafted "
        f"mission weighs each {shipped.otherwise}; from {shipped.tau_1} on it asks a second "
        f"person, from {shipped.tau_2} on {shipped.t} people"
    )
    return [note]


def show_command(
    site: SiteArgument,
    svg: Annotated[
        Path | None, typer.Option("--svg", help="File for a drawing of the map.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Show regions, objects, robots and names of a site model."""
    model = load_site(site)
    if svg is not None:
        write_whole(svg, picture(model).encode("utf-8"))
    payload = {
        "site": model.id,
        "version": model.version,
        "digest": site_digest(model),
        "regions": list(model.regions),
        "objects": list(model.objects),
        "robots": {rid: profile_digest(m.profile) for rid, m in model.robots.items()},
        "vocabulary": list(model.vocabulary),
        "adjacent": [msgspec.to_builtins(pair) for pair in adjacent(model)],
        "model": msgspec.to_builtins(model),
        "svg": None if svg is None else str(svg),
    }
    emit(payload, [*_places(model), *_words(model)], as_json=as_json)
    return 0


def diff_command(
    old: Annotated[Path, typer.Argument(help="The old version.")],
    new: Annotated[Path, typer.Argument(help="The new version.")],
    as_json: JsonFlag = False,
) -> int:
    """Show what a new version changes, changed meanings of names first (exit 1)."""
    before, after = load_site(old), load_site(new)
    found = changes(before, after)
    payload = {
        "old": site_digest(before),
        "new": site_digest(after),
        "changes": [msgspec.to_builtins(change) for change in found],
    }
    emit(payload, [line_of(change) for change in found] or ["no difference"], as_json=as_json)
    return 1 if found else 0


def sign_command(
    site: SiteArgument,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    out: Annotated[Path | None, typer.Option("--out", help="File for the token.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Sign a site model. It must have no fault and no `unreviewed` entry."""
    model = load_site(site)
    token = sign_site(model, open_signer(key, cert, passphrase_file), where=str(site))
    target = out or site.with_suffix(".token")
    write_whole(target, token)
    payload = {"file": str(target), "digest": site_digest(model)}
    emit(payload, [f"{target}", f"digest {site_digest(model)}"], as_json=as_json)
    return 0


def verify_command(
    token: Annotated[Path, typer.Argument(help="A signed site model.")],
    trust: TrustOption,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Verify certificate and signature of a site model, check it, and print who signed it."""
    opened = read_signed_site(
        read_file(token), verifier=read_trust(trust), now=wall_now(now), where=str(token)
    )
    payload = {
        "valid": True,
        "site": opened.site.id,
        "version": opened.site.version,
        "digest": opened.digest,
        "signer": opened.signer.id,
        "role": opened.signer.role,
    }
    lines = [
        f"authentic: {opened.site.id} version {opened.site.version}",
        f"signed by {opened.signer.id} ({opened.signer.role})",
        f"digest {opened.digest}",
    ]
    emit(payload, lines, as_json=as_json)
    return 0


def scene_graph_command(
    file: ForeignArgument,
    out: OutOption,
    radius: Annotated[
        str, typer.Option("--radius", help="Half the side of a region's square, in meters.")
    ] = "0.5",
    site_id: IdOption = None,
    floor: FloorOption = 0,
    as_json: JsonFlag = False,
) -> int:
    """Draft a site model from a scene graph (JSON: regions, objects, connections)."""
    proposal = import_scene(
        text_of(read_file(file), str(file)),
        site=_id(site_id, file),
        floor=floor,
        radius_mm=_meters(radius, "--radius"),
        where=str(file),
    )
    return _written(proposal, file, out, as_json=as_json)


def nav2_map_command(
    file: ForeignArgument,
    out: OutOption,
    min_area: Annotated[
        str, typer.Option("--min-area", help="Ignore free space below this area, in m2.")
    ] = "1",
    site_id: IdOption = None,
    floor: FloorOption = 0,
    as_json: JsonFlag = False,
) -> int:
    """Draft a site model from a map server's map (YAML and PGM)."""
    proposal = import_map(
        file,
        site=_id(site_id, file),
        floor=floor,
        min_area_mm2=_meters(min_area, "--min-area") * 1000,
    )
    return _written(proposal, file, out, as_json=as_json)


def _written(proposal: SiteProposal, file: Path, out: Path, *, as_json: bool) -> int:
    write_whole(out, to_yaml(proposal, where=str(file)).encode("utf-8"))
    model = proposal.site
    payload = {
        "file": str(out),
        "site": model.id,
        "regions": list(model.regions),
        "objects": list(model.objects),
        "doors": len(model.doors),
        "missing": list(proposal.missing),
    }
    told = f"{len(model.regions)} regions, {len(model.objects)} objects, {len(model.doors)} doors"
    lines = [f"{out}: {told}", "before it is signed:", *(f"  {m}" for m in proposal.missing)]
    emit(payload, lines, as_json=as_json)
    return 0


def _id(given: str | None, file: Path) -> str:
    """Return the id that was asked for, or one made of the file's name."""
    try:
        return identifier(file.stem if given is None else given, where="--id")
    except MalformedError as error:
        raise typer.BadParameter(error.message, param_hint="--id") from error


def _meters(text: str, option: str) -> int:
    """Return an option in meters (or square meters) as whole thousandths, at least one tenth."""
    try:
        value = millimeters(Decimal(text), where=option)
    except (ArithmeticError, MalformedError) as error:
        raise typer.BadParameter("expected a number such as 0.5", param_hint=option) from error
    if value < 100:
        raise typer.BadParameter("expected at least 0.1", param_hint=option)
    return value


def _places(model: Site) -> list[str]:
    """Return where things are, for people."""
    lines = [f"{model.id} version {model.version}", f"digest {site_digest(model)}", "regions:"]
    for region, m in model.regions.items():
        inside = "".join(f" in {parent}" for parent in ancestors(model, region))
        names = ", ".join(map(shown, m.names))
        lines.append(f"  {region:20} floor {m.floor}  {', '.join(m.tags):12} {names}{inside}")
    lines += ["doors:"]
    lines += [
        f"  {' - '.join(door.between)} at {door.at[0]}, {door.at[1]} mm"
        + (f", open while {door.variable}" if door.variable else "")
        for door in model.doors
    ]
    lines += ["objects:"]
    lines += [
        f"  {item:20} {m.kind:10} at {m.home}  {', '.join(map(shown, m.names))}"
        for item, m in model.objects.items()
    ]
    return lines


def _words(model: Site) -> list[str]:
    """Return who acts and how, for people; parts that the site does not have are left out."""
    lines = ["robots:"]
    for rid, m in model.robots.items():
        lines.append(
            f"  {rid:20} profile {profile_digest(m.profile)}  {', '.join(m.profile.tools)}"
        )
        way = stopping_mm(m.profile, m.profile.max_speed_mm_s)
        if way is not None:
            lines.append(f"  {'':20} stops within {way} mm from {m.profile.max_speed_mm_s} mm/s")
    parts: dict[str, Any] = {
        "words": [f"{kind:20} {_kind(m)}" for kind, m in model.vocabulary.items()],
        "people": [
            f"{person:20} {', '.join(m.roles)}  {', '.join(map(shown, m.names))}"
            for person, m in model.people.items()
        ],
        "emergency places": [
            f"{region:20} {purpose}"
            for region, purpose in (model.emergency.places if model.emergency else {}).items()
        ],
        "baseline": list(model.baseline),
        "channels": [f"{channel:20} {label}" for channel, label in model.channels.items()],
    }
    for title, told in parts.items():
        if told:
            lines += [f"{title}:", *(f"  {line}" for line in told)]
    return lines


def _kind(model: ActionModel) -> str:
    """Return what a word can do at worst, for people: impacts of 0 to 3, then its flags."""
    flags = ("moves", "waits", "records", "stores", "transmits", "state_writing", "beside")
    told = [f"physical {model.physical}", f"privacy {model.privacy}"]
    return ", ".join([*told, *(flag for flag in flags if getattr(model, flag))])
