# SPDX-License-Identifier: Apache-2.0
"""`authguard init`: from a tool list to a set-up that refuses everything."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.authoring.onboarding.listing import MAX_LIST, Source, list_text
from authguard_r.authoring.onboarding.skeleton import Skeleton, make_skeleton
from authguard_r.cli.inputs import JsonFlag
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.wire.output import emit


def init_command(
    listing: Annotated[
        Path,
        typer.Argument(
            metavar="LIST",
            help="The tool list: a `tools/list` result, a tools array, or ROS names with types. "
            "`-` reads it from standard input.",
        ),
    ],
    source: Annotated[Source, typer.Option("--from", help="The kind of list.")],
    out: Annotated[Path, typer.Option("--out", help="A new or empty folder.")],
    robot: Annotated[str, typer.Option("--robot", help="The robot's id.")] = "robot-1",
    keys: Annotated[bool, typer.Option("--keys/--no-keys", help="Make demonstration keys.")] = True,
    as_json: JsonFlag = False,
) -> int:
    """Create a site, a binding and keys for a list of tools. The binding refuses every call."""
    if not is_identifier(robot):
        raise typer.BadParameter("expected an id of a-z, 0-9 and `_.:-`", param_hint="--robot")
    _require_empty(out)
    where = "standard input" if str(listing) == "-" else str(listing)
    text = list_text(_bytes(listing), where=where)
    made = make_skeleton(text, source=source, robot=RobotId(robot), where=where)
    files = {
        "site.yaml": made.site,
        "binding.yaml": made.binding,
        "interface.yaml": made.interface,
    }
    out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        with (out / name).open("x", encoding="utf-8") as file:
            file.write(content)
    if keys:
        members = demo_members(made.model, (RobotId(robot),))
        init_folder(out / "trust", members, now=datetime.now(UTC))
    payload = {
        "folder": str(out),
        "files": [*files, *(["trust"] if keys else [])],
        "robot": robot,
        "tools": made.report.tools,
        "ways": made.report.ways,
        "fields": made.report.fields,
        "unmapped": list(made.report.unmapped or ()),
    }
    emit(payload, _lines(made, out, robot=robot, keys=keys), as_json=as_json)
    return 0


def _require_empty(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise EnvironmentFault(
            f"expected a new or empty folder, got `{folder}`",
            reason=Reason.FILE_UNAVAILABLE,
            where="--out",
        )


def _bytes(path: Path) -> bytes:
    """Return the list, or as much of it as shows that it is too long."""
    if str(path) == "-":
        return sys.stdin.buffer.read(MAX_LIST + 1)
    with path.open("rb") as file:
        return file.read(MAX_LIST + 1)


def _lines(made: Skeleton, out: Path, *, robot: str, keys: bool) -> list[str]:
    report = made.report
    site, binding, interface = (out / f"{n}.yaml" for n in ("site", "binding", "interface"))
    parts = f"--site {site} --binding {binding}"
    return [
        f"{out}: {report.tools} tools, {report.ways} ways, all refused",
        f"  site.yaml       one unreviewed place; `{robot}`, which can do nothing yet",
        f"  binding.yaml    {report.fields['refused']} fields refused, none mapped",
        "  interface.yaml  the list, for `binding check`",
        *(
            ["  trust/          demonstration keys: anyone who reads them has every role"]
            if keys
            else []
        ),
        "next:",
        f"  authguard binding check {binding} --site {site} --interface {interface} --strict",
        *(
            _trial(out, parts, robot)
            if keys
            else ["  run the gate in shadow mode: docs/howto/gate.md"]
        ),
        "  let the robot do its ordinary work; end the gate; then",
        f"  authguard learn {out / 'robot.db'} {parts} --out {out / 'learned'}",
        "  read what is proposed, line by line; compile, review and sign what is right",
    ]


def _trial(out: Path, parts: str, robot: str) -> list[str]:
    """Return the commands of a gate that judges and records, and releases nothing."""
    trust, config = f"--trust {out / 'trust'}", out / "gate.token"
    make = f"--demo --mode shadow --robot {robot} {trust} --out {config}"
    serve = f"--config {config} --store {out / 'robot.db'} --gate {out / 'run'}"
    return [
        f"  authguard gate-config make {make}",
        f"  authguard doctor {out}",
        f"  authguard gate --demo {trust} {parts} {serve}",
    ]
