# SPDX-License-Identifier: Apache-2.0
"""`authguard binding`: look at bindings and prove that nothing falls through them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.authoring.binding.check import BindingReport, check_binding
from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.cli.inputs import JsonFlag, SiteOption, load_site
from authguard_r.core.errors import MalformedError
from authguard_r.integrations.tools.tool_schemas import ToolForm, tool_schemas
from authguard_r.normalize.binding import Binding, binding_digest, require_sound, ways
from authguard_r.normalize.interface import (
    Surface,
    listed_interface,
    read_interface,
    shipped_interface,
)
from authguard_r.normalize.rebuild import call_bytes
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_text, read_yaml
from authguard_r.site.words import standard_words
from authguard_r.wire.output import emit

BindingArgument = Annotated[
    str, typer.Argument(help="Name of a binding of this package, or a file.")
]
SiteChoice = Annotated[
    Path | None, typer.Option("--site", help="The site model (default: the standard vocabulary).")
]
_ROS_FILES = ("*.action", "*.msg", "*.srv")
_UNSHOWN = "no interface given: nothing shows that every field is bound"


def check_command(
    binding: BindingArgument,
    site: SiteChoice = None,
    interface: Annotated[
        list[str] | None,
        typer.Option(
            "--interface",
            help="The tools' own description: a file, a folder of ROS definitions, or a "
            "shipped binding's name. A shipped binding is compared with its own without it.",
        ),
    ] = None,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Exit 1 when a tool has no interface to compare."),
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Check that every field of every tool is bound, checked, and sent as authorized."""
    found = _read(binding)
    report = check_binding(found, _site(found, site), interface=compared_with(binding, interface))
    payload = {**msgspec.to_builtins(report), "digest": binding_digest(found)}
    emit(payload, _lines(report), as_json=as_json)
    if report.faults:
        return 4
    return 1 if strict and (report.interface is None or report.uncompared) else 0


def list_command(as_json: JsonFlag = False) -> int:
    """List the bindings that are part of this package."""
    rows: list[dict[str, Any]] = []
    for name in shipped_names():
        found = _read(name)
        rows.append({"name": name, "tools": len(found.tools), "ways": len(ways(found))})
    lines = [f"{row['name']:16} {row['tools']:3} tools, {row['ways']:3} ways" for row in rows]
    emit({"bindings": rows}, lines, as_json=as_json)
    return 0


def show_command(
    binding: BindingArgument, site: SiteChoice = None, as_json: JsonFlag = False
) -> int:
    """Show each tool of a binding: what it means, and a sample call."""
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
        meaning = "refused to every planner" if row["refused"] else f"by {row['tool']}"
        lines.append(f"{row['where']}: {row['type']} {meaning}")
        lines += [f"  {row['sample']}"] if row["sample"] else []
    payload = {"binding": found.id, "digest": binding_digest(found), "ways": rows}
    emit(payload, lines, as_json=as_json)
    return 0


def schemas_command(
    binding: BindingArgument,
    site: SiteOption,
    form: Annotated[
        ToolForm, typer.Option("--form", help="Whose form: the protocol of the model's server.")
    ] = ToolForm.OPENAI,
    as_json: JsonFlag = False,
) -> int:
    """Print the tools of a binding as JSON, ready for the `tools` of a request to a model.

    Refused fields, and tools that no planner may use, are left out. Names, ranges and units are
    the site's; a mission allows fewer. The gate reads every call by the binding.
    """
    found, model = _read(binding), load_site(site)
    require_sound(found, model)
    tools = form.tools(tool_schemas(found, model))
    emit({"form": form, "tools": tools}, [json.dumps(tools, indent=2)], as_json=as_json)
    return 0


def _read(name: str) -> Binding:
    return convert(binding_source(name), Binding, where=name)


def _site(binding: Binding, path: Path | None) -> Site:
    return probe_site(binding, standard_words()) if path is None else load_site(path)


def compared_with(binding: str, given: list[str] | None) -> tuple[Surface, ...]:
    """Return what to compare with: what is given, else what a shipped binding is for."""
    if not given:
        return shipped_interface(binding) or ()
    return tuple(surface for name in given for surface in _surfaces(name))


def _surfaces(name: str) -> tuple[Surface, ...]:
    """Return a shipped interface, or a file's or folder's; an empty one would prove nothing."""
    found = shipped_interface(name)
    if found is None and Path(name).is_dir():
        files = sorted(file for pattern in _ROS_FILES for file in Path(name).glob(pattern))
        found = tuple(s for f in files for s in read_interface(read_text(f), name=str(f)))
    elif found is None and Path(name).suffix == ".yaml":
        found = listed_interface(read_yaml(read_text(Path(name)), where=name), where=name)
    elif found is None:
        found = read_interface(read_text(Path(name)), name=name)
    if not found:
        raise MalformedError("expected a tool or a message", where=name)
    return found


def _lines(report: BindingReport) -> list[str]:
    fields = ", ".join(f"{count} {use}" for use, count in report.fields.items())
    faults = [f"{fault.where}: {fault.message}" for fault in report.faults]
    head = f"{report.binding}: {report.tools} tools, {report.ways} ways; fields: {fields}"
    groups = [f"  {', '.join(places)} meet: {effect}" for effect, places in report.groups.items()]
    return [*(faults or [head, *groups]), *_assumed(report), *_compared(report)]


def _assumed(report: BindingReport) -> list[str]:
    """Return the line that lists the tools whose answers are not checked for success."""
    if not report.assumed:
        return []
    places = ", ".join(report.assumed)
    return [
        f"warning: any answer that is no error counts as done; say `succeeds` or `fails`: {places}"
    ]


def _compared(report: BindingReport) -> list[str]:
    """Return the lines that say what shows that every field is bound, or that nothing does."""
    if report.interface is None:
        return [_UNSHOWN]
    if report.uncompared:
        return [f"the interface says nothing of {', '.join(report.uncompared)}"]
    if report.faults:
        return []
    return [f"interface: {report.interface} tools or messages, every field bound"]
