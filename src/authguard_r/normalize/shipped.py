# SPDX-License-Identifier: Apache-2.0
"""The bindings that come with the package, by name.

Each speaks the standard vocabulary (`words: standard`) and fits any site that has its words.
Beside each stand the names of its interface's tools and fields, with which the check compares it.
Reference page: docs/reference/bindings.md
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from authguard_r.site.source import read_text, read_yaml

#: Where the shipped bindings lie in this package, and in it their interfaces.
FOLDER, INTERFACES = "bindings", "interfaces"
_SUFFIX = ".yaml"


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped bindings, sorted."""
    folder = files("authguard_r.normalize").joinpath(FOLDER)
    found = (item.name for item in folder.iterdir())
    return tuple(sorted(name.removesuffix(_SUFFIX) for name in found if name.endswith(_SUFFIX)))


def binding_source(name: str) -> Any:
    """Return the plain data of a shipped binding, or of the binding in a file.

    Args:
        name: a shipped name (`ros-mcp`), compared exactly, or else a path.

    Raises:
        EnvironmentFault: neither a shipped name nor a file that can be read.
        MalformedError: no strict YAML.
    """
    if name in shipped_names():
        return read_shipped(name, FOLDER)
    return read_yaml(read_text(Path(name)), where=name)


def read_shipped(name: str, *folders: str) -> Any:
    """Return the plain data of a file that comes with the package."""
    item = files("authguard_r.normalize").joinpath(*folders, name + _SUFFIX)
    return read_yaml(item.read_text(encoding="utf-8"), where=name)
