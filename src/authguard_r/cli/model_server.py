# SPDX-License-Identifier: Apache-2.0
"""The options that name a model server, for every command that may ask one."""

from __future__ import annotations

from typing import Annotated

import typer

BaseUrlOption = Annotated[
    str | None,
    typer.Option("--base-url", help="Address of the model server; no other server is contacted."),
]
ModelOption = Annotated[
    str | None, typer.Option("--model", help="The name of the model at the server.")
]
ApiKeyEnvOption = Annotated[
    str | None, typer.Option("--api-key-env", help="Environment variable with the key.")
]
#: Seconds that a model may take in all where no `--timeout` was given.
TIMEOUT_S = 120.0
_TIMEOUT = typer.Option(
    "--timeout",
    min=0.1,
    max=3600,
    show_default=str(TIMEOUT_S),
    help="Longest time for the model, in seconds.",
)
TimeoutOption = Annotated[float, _TIMEOUT]
#: For a command that refuses `--timeout` where no model is asked.
OptionalTimeoutOption = Annotated[float | None, _TIMEOUT]
