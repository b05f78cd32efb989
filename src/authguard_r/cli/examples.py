# SPDX-License-Identifier: Apache-2.0
"""`authguard examples`: the example files, from an installed wheel."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.inputs import JsonFlag
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.sim.example import bundled_hospital
from authguard_r.wire.output import emit


def examples_command(
    out: Annotated[Path, typer.Option("--out", help="A new or empty folder.")],
    as_json: JsonFlag = False,
) -> int:
    """Copy the hospital example to a folder: site, binding, mission and planner replies."""
    try:
        if out.exists() and any(out.iterdir()):
            raise FileExistsError(f"expected a new or empty folder, got `{out}`")
        shutil.copytree(bundled_hospital(), out / "hospital", ignore=lambda *_: {"__pycache__"})
    except OSError as error:
        reason = Reason.FILE_UNAVAILABLE
        why = error.strerror or str(error)
        raise EnvironmentFault(why, reason=reason, where=str(out)) from error
    files = sorted(str(path) for path in out.rglob("*") if path.is_file())
    emit({"files": files}, [str(out / "hospital"), f"{len(files)} files"], as_json=as_json)
    return 0
