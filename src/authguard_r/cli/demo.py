# SPDX-License-Identifier: Apache-2.0
"""`authguard demo`: the paper's hospital story."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.inputs import JsonFlag


def demo_command(
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for keys, tokens and log.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Run the hospital story: sign, hijack by a notice, refusal, signed update, delivery."""
    from authguard_r.cli.demo_story import tell

    return tell(out, as_json=as_json)
