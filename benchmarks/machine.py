# SPDX-License-Identifier: Apache-2.0
"""What the numbers were measured on: machine, interpreter, libraries, commit."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import apsw

LIBRARIES = ("apsw", "biscuit-python", "cedarpy", "cryptography", "msgspec", "rfc8785")
_ROOT = Path(__file__).resolve().parent.parent


def describe(folder: Path) -> dict[str, Any]:
    """Return everything that a reader needs to compare; no names, no paths.

    Args:
        folder: where the stores lie, for the kind of its file system.
    """
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "commit": _git("rev-parse", "HEAD"),
        "changed_since_commit": bool(_git("status", "--porcelain", "--", "src", "packages")),
        "machine": {
            "cpu": _cpu(),
            "cores": os.cpu_count(),
            "system": f"{platform.system()} {platform.release().split('-')[0]}",
            "architecture": platform.machine(),
            "file_system": _file_system(folder),
        },
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "sqlite": apsw.sqlite_lib_version(),
        "libraries": dict(_libraries()),
    }


def _libraries() -> Iterator[tuple[str, str]]:
    """Yield the libraries that are installed here, with their versions."""
    for name in LIBRARIES:
        with suppress(PackageNotFoundError):
            yield name, version(name)


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(_ROOT), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:  # there is no git
        return "unknown"
    return done.stdout.strip() if done.returncode == 0 else "unknown"


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _file_system(folder: Path) -> str:
    """Return the kind of file system of the longest mount point above the folder."""
    try:
        mounts = Path("/proc/mounts").read_text("utf-8").splitlines()
    except OSError:
        return "unknown"
    above = {str(part) for part in (folder.resolve(), *folder.resolve().parents)}
    found = [line.split()[1:3] for line in mounts if line.split()[1] in above]
    return max(found, key=lambda mount: len(mount[0]))[1] if found else "unknown"
