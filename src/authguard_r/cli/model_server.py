# SPDX-License-Identifier: Apache-2.0
"""The options that name a model server, for every command that may ask one."""

from __future__ import annotations

from typing import Annotated

import typer

BaseUrlOption = Annotated[
    str | None, typer.Option("--base-url", help="The model server; nothing else is spoken to.")
]
ModelOption = Annotated[str | None, typer.Option("--model", help="The model's name there.")]
ApiKeyEnvOption = Annotated[
    str | None, typer.Option("--api-key-env", help="Environment variable with the key.")
]
TimeoutOption = Annotated[
    float,
    typer.Option("--timeout", min=0.1, max=3600, help="Seconds that the model may take in all."),
]
#: Seconds that a model may take in all where no `--timeout` was given.
TIMEOUT_S = 120.0
