# SPDX-License-Identifier: Apache-2.0
"""Defaults of options, from an `authguard.toml` that only the user or root can write.

How-to: docs/howto/defaults.md
"""

from __future__ import annotations

import os
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

#: The file, looked for in the working folder and above it.
FILE = "authguard.toml"
#: The options that have a default. Each is an entry of the file, and `AUTHGUARD_GATE` and so on.
NAMES = ("gate", "trust", "site", "store", "key", "cert")
#: Most bytes of the file.
MAX_BYTES = 1 << 16


class Defaults(Struct, frozen=True, kw_only=True):
    """What a file says.

    Args:
        path: the file; None: there is none that counts.
        values: the defaults by the name of their option; paths are absolute.
        ignored: why a file that is there does not count, for people; empty: none is left out.
    """

    path: Path | None = None
    values: Mapping[str, str] = {}
    ignored: str = ""


def working_defaults() -> Defaults:
    """Return the defaults of this process's working folder; none where there is no such folder."""
    try:
        return read_defaults(Path.cwd(), Path.home().resolve())
    except (OSError, RuntimeError):
        return Defaults()


def read_defaults(folder: Path, home: Path) -> Defaults:
    """Return the defaults of a working folder.

    The nearest file counts, and no other. A file above the home folder is not looked at. One that
    others can write, or that cannot be read, gives no defaults: nobody else decides what is signed.

    Args:
        folder: the working folder.
        home: the home folder.
    """
    for place in (folder, *folder.parents):
        if place in home.parents:
            break
        path = place / FILE
        try:
            found = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        except OSError as error:
            return _ignored(path, error.strerror or "it cannot be read")
        with os.fdopen(found, "rb") as file:
            why = _why_not(os.fstat(found))
            return _ignored(path, why) if why else _parsed(path, file.read(MAX_BYTES + 1))
    return Defaults()


def _why_not(found: os.stat_result) -> str:
    """Return why a file does not count; empty: it does."""
    if not stat.S_ISREG(found.st_mode):
        return "it is no plain file"
    if found.st_uid not in {0, os.geteuid()}:
        return f"its owner is neither you nor root but user {found.st_uid}"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "others may write it: chmod go-w"
    return ""


def _parsed(path: Path, data: bytes) -> Defaults:
    """Return what the bytes of a file say."""
    if len(data) > MAX_BYTES:
        return _ignored(path, f"it has more than {MAX_BYTES} bytes")
    try:
        told = tomllib.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        return _ignored(path, f'{error}; each line is NAME = "VALUE", with the quotes')
    for name, value in told.items():
        if name not in NAMES:
            return _ignored(path, f"unknown key `{name}`; allowed: {', '.join(NAMES)}")
        if not isinstance(value, str) or not value:
            return _ignored(path, f"`{name}`: expected a text in quotes")
    return Defaults(path=path, values={k: _absolute(path.parent, v) for k, v in told.items()})


def _absolute(folder: Path, value: str) -> str:
    """Return a path of the file: relative ones begin at the file's folder."""
    return value if value.startswith("pkcs11:") else str(folder / value)


def _ignored(path: Path, why: str) -> Defaults:
    return Defaults(ignored=f"{path} is not used: {why}")
