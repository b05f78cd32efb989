# SPDX-License-Identifier: Apache-2.0
"""`authguard site`: validate and look at a site model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.out import emit
from authguard_r.site.check import faults
from authguard_r.site.model import Site, profile_digest, site_digest
from authguard_r.site.source import convert, read_site, read_text, read_yaml

app = typer.Typer(help="The site model: what every word of a mission means.", no_args_is_help=True)
SiteArgument = Annotated[Path, typer.Argument(help="The site model (YAML).")]


@app.command("check")
def check(site: SiteArgument, as_json: JsonFlag = False) -> int:
    """Name every fault of a site model with its place."""
    model = convert(read_yaml(read_text(site), where=str(site)), Site, where=str(site))
    found = faults(model)
    payload = {
        "site": model.id,
        "digest": site_digest(model),
        "faults": [msgspec.to_builtins(fault) for fault in found],
    }
    lines = [f"{fault.where}: {fault.message}" for fault in found]
    sound = f"{model.id}: sound, {len(model.regions)} regions, {len(model.objects)} objects"
    emit(payload, lines or [sound], as_json=as_json)
    return 4 if found else 0


@app.command("show")
def show(site: SiteArgument, as_json: JsonFlag = False) -> int:
    """Show regions, objects, robots and words of a site model."""
    model = read_site(site)
    lines = [f"{model.id} version {model.version}", f"digest {site_digest(model)}", "regions:"]
    lines += [
        f"  {region:20} floor {m.floor}  {', '.join(m.tags):12} {', '.join(m.names)}"
        for region, m in model.regions.items()
    ]
    lines += ["objects:"]
    lines += [
        f"  {item:20} {m.kind:10} at {m.home}  {', '.join(m.names)}"
        for item, m in model.objects.items()
    ]
    lines += ["robots:"]
    lines += [
        f"  {rid:20} profile {profile_digest(m.profile)}  {', '.join(m.profile.tools)}"
        for rid, m in model.robots.items()
    ]
    payload = {
        "site": model.id,
        "version": model.version,
        "digest": site_digest(model),
        "regions": list(model.regions),
        "objects": list(model.objects),
        "robots": {rid: profile_digest(m.profile) for rid, m in model.robots.items()},
        "vocabulary": list(model.vocabulary),
    }
    emit(payload, lines, as_json=as_json)
    return 0
