# SPDX-License-Identifier: Apache-2.0
"""ROS 2 names and types, as the executor resolves them: absolute, whole, and never a pattern.

Spec page: docs/spec/ros-map.md#names
"""

from __future__ import annotations

import re
from enum import StrEnum

#: Longest name, in characters; DDS has 255 with its own prefix and ending.
MAX_NAME = 200
_NAME = re.compile(r"(/[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*)+")
_ENCLAVE = re.compile(r"(/[A-Za-z0-9][A-Za-z0-9_-]*)+")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9]*)")


class TypePart(StrEnum):
    """The second part of a type's name."""

    MESSAGE = "msg"
    SERVICE = "srv"
    ACTION = "action"


def is_name(text: str) -> bool:
    """True of an absolute name: no `~`, no remapping, nothing hidden, no slash at its end."""
    return len(text) <= MAX_NAME and _NAME.fullmatch(text) is not None


def is_enclave(text: str) -> bool:
    """True of an enclave's name, which is a folder's path below the keystore's `enclaves`."""
    return len(text) <= MAX_NAME and _ENCLAVE.fullmatch(text) is not None


def part_of(kind: str) -> TypePart | None:
    """Return the second part of a type's name such as `std_srvs/srv/SetBool`; None: it has none."""
    found = _TYPE.fullmatch(kind)
    return None if found is None else TypePart(found[2])


def is_below(name: str, root: str) -> bool:
    """True of a name under another, part by part: `/llm/x` is below `/llm`, `/llmx` is not."""
    return name.startswith(root + "/")
