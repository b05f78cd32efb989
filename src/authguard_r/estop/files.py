# SPDX-License-Identifier: Apache-2.0
"""The files that a stop process is started with, and how the gate hands their paths over.

Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.identifiers import RobotId
from authguard_r.keys.trust import read_file

#: Names the configuration that the serving stop process has read; in the run folder.
CONFIG = "stop-lane.config"
#: Grows with what a stop process understands: the gate ends an older one.
_UNDERSTOOD = b"2"


class EStopFiles(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a stop process is started with.

    Args:
        run: the run folder; the gate's user owns it.
        robot: whose stop process it is.
        trust: the trust folder.
        key: the gate's own key.
        cert: its certificate and its authority's.
        config: the signed gate configuration.
    """

    run: Path
    robot: RobotId
    trust: Path
    key: Path
    cert: Path
    config: Path


def ask(files: EStopFiles) -> str:
    """Return the argument that names these files to the stop process."""
    names = ("run", "trust", "key", "cert", "config")
    paths = {name: getattr(files, name).absolute() for name in names}
    return msgspec.json.encode(replace(files, **paths), enc_hook=str).decode()


def asked(argument: str) -> EStopFiles:
    """Return the files that an argument names."""
    return msgspec.json.decode(argument, type=EStopFiles, dec_hook=lambda kind, it: kind(it))


def config_digest(files: EStopFiles) -> str:
    """Return the SHA-256 of the configuration that a stop process reads, to recognize an older one.

    Raises:
        EnvironmentFault: the configuration cannot be read.
    """
    return sha256(read_file(files.config) + _UNDERSTOOD).hexdigest()
