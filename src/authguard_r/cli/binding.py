# SPDX-License-Identifier: Apache-2.0
"""`authguard binding`: look at bindings and prove that nothing falls through them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.cli.inputs import JsonFlag, load_site
from authguard_r.cli.out import emit
from authguard_r.normalize.binding import Binding, binding_digest, require_sound, ways
from authguard_r.normalize.check import BindingReport, check_binding
from authguard_r.normalize.interface import Surface, read_interface
from authguard_r.normalize.rebuild import call_bytes
from authguard_r.normalize.samples import Sampler, probe_site
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_text
from authguard_r.site.words import standard_words

app = typer.Typer(help="Bindings: what each field of each tool means.", no_args_is_help=True)
BindingArgument = Annotated[str, typer.Argument(help="A shipped binding's name, or a file.")]
SiteChoice = Annotated[
    Path | None, typer.Option("--site", help="The site model; without it, the standard words.")
]
_ROS_FILES = ("*.action", "*.msg", "*.srv")


@app.command("check")
def check(
    binding: BindingArgument,
    site: SiteChoice = None,
    interface: Annotated[
        list[Path] | None,
        typer.Option(
            "--interface", help="What the tools say of themselves; a folder for ROS definitions."
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Prove that every field of every tool is bound, held and dispatched as authorized."""
    found = _read(binding)
    surfaces = tuple(s for path in interface or () for s in _surfaces(path))
    report = check_binding(found, _site(found, site), interface=surfaces)
    payload = {**msgspec.to_builtins(report), "digest": binding_digest(found)}
    emit(payload, _lines(report), as_json=as_json)
    return 4 if report.faults else 0


@app.command("list")
def list_command(as_json: JsonFlag = False) -> int:
    """Name the bindings that come with the package."""
    rows: list[dict[str, Any]] = []
    for name in shipped_names():
        found = _read(name)
        rows.append({"name": name, "tools": len(found.tools), "ways": len(ways(found))})
    lines = [f"{row['name']:16} {row['tools']:3} tools, {row['ways']:3} ways" for row in rows]
    emit({"bindings": rows}, lines, as_json=as_json)
    return 0


@app.command("show")
def show(binding: BindingArgument, site: SiteChoice = None, as_json: JsonFlag = False) -> int:
    """Show each way of a binding: what it means, and a call that means it."""
    found = _read(binding)
    model = _site(found, site)
    require_sound(found, model)
    sampler = Sampler(model)
    rows: list[dict[str, Any]] = []
    for way in ways(found):
        call = sampler.call(way)
        sample = None if call is None else call_bytes(call).decode()
        refused = model.vocabulary[way.tool.type].state_writing
        rows.append(
            {
                "where": way.place,
                "type": way.tool.type,
                "tool": way.tool.tool,
                "refused": refused,
                "sample": None if refused else sample,
            }
        )
    lines = [f"{found.id}: {len(found.tools)} tools", f"digest {binding_digest(found)}"]
    for row in rows:
        meaning = "never a planner's" if row["refused"] else f"by {row['tool']}"
        lines.append(f"{row['where']}: {row['type']} {meaning}")
        lines += [f"  {row['sample']}"] if row["sample"] else []
    payload = {"binding": found.id, "digest": binding_digest(found), "ways": rows}
    emit(payload, lines, as_json=as_json)
    return 0


def _read(name: str) -> Binding:
    return convert(binding_source(name), Binding, where=name)


def _site(binding: Binding, path: Path | None) -> Site:
    return probe_site(binding, standard_words()) if path is None else load_site(path)


def _surfaces(path: Path) -> tuple[Surface, ...]:
    if path.is_dir():
        files = sorted(file for pattern in _ROS_FILES for file in path.glob(pattern))
        return tuple(surface for file in files for surface in _surfaces(file))
    return read_interface(read_text(path), name=str(path))


def _lines(report: BindingReport) -> list[str]:
    fields = ", ".join(f"{count} {use}" for use, count in report.fields.items())
    faults = [f"{fault.where}: {fault.message}" for fault in report.faults]
    head = f"{report.binding}: {report.tools} tools, {report.ways} ways; fields: {fields}"
    groups = [f"  {', '.join(places)} meet: {effect}" for effect, places in report.groups.items()]
    return faults or [head, *groups]
