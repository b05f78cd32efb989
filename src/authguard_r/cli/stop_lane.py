# SPDX-License-Identifier: Apache-2.0
"""`authguard advanced stop-process`: the process that serves stops and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.cli.inputs import JsonFlag, TrustOption
from authguard_r.core.identifiers import RobotId
from authguard_r.wire.output import emit


def stop_lane_command(
    run: Annotated[Path, typer.Option("--gate", help="The gate's run folder.")],
    robot: Annotated[str, typer.Option("--robot", help="The robot.")],
    trust: TrustOption,
    key: Annotated[Path, typer.Option("--key", help="The gate's own key.")],
    cert: Annotated[Path, typer.Option("--cert", help="The gate's certificate.")],
    config: Annotated[Path, typer.Option("--config", help="The signed gate configuration.")],
    as_json: JsonFlag = False,
) -> int:
    """Serve RUN/stop.sock until SIGTERM. A gate starts this process itself if none serves.

    Trust folder, key and configuration are read once, at the start.
    """
    from authguard_r.estop.files import EStopFiles
    from authguard_r.estop.startup import EStopReady, run_stop_process

    def say(ready: EStopReady) -> None:
        line = f"{ready.socket}: stops are served for {ready.robot} (pid {ready.pid})"
        emit(msgspec.to_builtins(ready), [line], as_json=as_json)

    files = EStopFiles(
        run=run, robot=RobotId(robot), trust=trust, key=key, cert=cert, config=config
    )
    run_stop_process(files, say)
    return 0
