# SPDX-License-Identifier: Apache-2.0
"""`authguard audit`: the folder of its commands, and the argument that they share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

StoreArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A store, or an exported log (JSON Lines).")
]
