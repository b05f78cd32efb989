# SPDX-License-Identifier: Apache-2.0
"""`authguard audit`: the folder of its commands, and the argument that they share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="The audit log: verify, read, replay, explain and export it.", no_args_is_help=True
)
StoreArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A store, or a log that was exported as JSON Lines.")
]
