# SPDX-License-Identifier: Apache-2.0
"""The programs and packages of others that draw, read, speak and hear."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

#: Debian's package of each program.
_PACKAGES = {"tesseract": "tesseract-ocr", "espeak-ng": "espeak-ng", "flite": "flite"}
#: How long one text may take.
_SECONDS = 120
_VERSION = re.compile(r"\d+(?:\.\d+)+")


class PerceptionError(Exception):
    """A text cannot be drawn, read, spoken or heard; the message says what to do."""


def require_tools(modules: Iterable[str]) -> None:
    """Say at once what is not installed, before the first text.

    Args:
        modules: of the extra `perception`.

    Raises:
        PerceptionError: a program or a package is missing; names all of them and the commands.
    """
    packages = [name for name in modules if find_spec(name) is None]
    programs = [name for name in _PACKAGES if shutil.which(name) is None]
    said: list[str] = []
    if packages:
        said.append(f"no package {', '.join(packages)}: pip install 'missionpair[perception]'")
    if programs:
        wanted = " ".join(_PACKAGES[name] for name in programs)
        said.append(f"no program {', '.join(programs)}: apt-get install {wanted}")
    if said:
        raise PerceptionError("; ".join(said))


def package(name: str) -> Any:
    """Return a module of the extra `perception`.

    Raises:
        PerceptionError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        text = f"no package `{error.name}`; pip install 'missionpair[perception]'"
        raise PerceptionError(text) from error


def run(program: str, *arguments: str, stdin: bytes = b"") -> bytes:
    """Return what a program printed.

    Raises:
        PerceptionError: it is not installed, it failed, or it took too long.
    """
    done = _ended(program, *arguments, stdin=stdin)
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace")[-300:]
        raise PerceptionError(f"`{program}` failed with code {done.returncode}: {said}")
    return done.stdout


@cache
def version_of(program: str) -> str:
    """Return a program's name with its version, as it says it."""
    said = _ended(program, "--version")  # flite says it and fails
    found = _VERSION.search((said.stdout + said.stderr).decode(errors="replace"))
    return f"{program} {found[0]}" if found else program


def _ended(program: str, *arguments: str, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    if shutil.which(program) is None:
        text = f"no program `{program}`; install it: apt-get install {_PACKAGES[program]}"
        raise PerceptionError(text)
    # one thread: other texts are read at the same time
    env = {**os.environ, "OMP_THREAD_LIMIT": "1"}
    command = [program, *arguments]
    try:
        return subprocess.run(  # noqa: S603 - the program is one of `_PACKAGES`
            command, input=stdin, capture_output=True, check=False, timeout=_SECONDS, env=env
        )
    except subprocess.TimeoutExpired as error:
        raise PerceptionError(f"`{program}` took more than {_SECONDS} s") from error
    except OSError as error:
        raise PerceptionError(f"`{program}`: {error.strerror or error}") from error


def package_version(name: str) -> str:
    """Return a package's name with its version."""
    return f"{name} {version(name)}"
