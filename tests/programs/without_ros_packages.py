# SPDX-License-Identifier: Apache-2.0
"""Run a program that wants ROS packages of which PyPI has no wheels.

python tests/programs/without_ros_packages.py PROGRAM ...

`rosidl_runtime_py` is made here as far as messages go, over the real types of rclpy. The others are
there for their names alone: who uses one fails.
"""

from __future__ import annotations

import runpy
import sys
from collections import OrderedDict
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

#: Packages with names that are imported, and that nothing here uses.
NAMES = {
    "cv_bridge": ("CvBridge",),
    "nav2_msgs.action": ("NavigateToPose",),
    "tf2_geometry_msgs": ("do_transform_pose",),
    "tf2_ros": ("Buffer", "LookupException", "TransformListener", "TransformStamped"),
    "tf_transformations": ("euler_from_quaternion", "quaternion_from_euler"),
}


class Absent(Exception):  # noqa: N818 - it stands for exceptions and classes alike
    """Takes anything and does nothing."""

    Goal = Feedback = Result = object

    def __init__(self, *_: Any, **__: Any) -> None:
        super().__init__()

    def unregister(self) -> None:
        """Let go, as a listener does at the end."""


def type_of(name: str) -> Any:
    """Return the namespaced type that `package/kind/Name` names."""
    namespaced = import_module("rosidl_parser.definition").NamespacedType
    *spaces, last = name.split("/")
    return namespaced(spaces, last)


def class_of(namespaced: Any) -> Any:
    """Return the class of a namespaced type."""
    return getattr(import_module(".".join(namespaced.namespaces)), namespaced.name)


def set_fields(message: Any, values: dict[str, Any]) -> None:
    """Put values into a message, by field; one that it does not have is an AttributeError."""
    for name, value in values.items():
        now = getattr(message, name)
        if isinstance(value, dict):
            set_fields(now, value)
        else:
            setattr(message, name, type(now)(value))


def fields_of(message: Any) -> Any:
    """Return a message as plain data."""
    if not hasattr(message, "get_fields_and_field_types"):
        return message
    names = message.get_fields_and_field_types()
    return OrderedDict((name, fields_of(getattr(message, name))) for name in names)


def main() -> None:
    """Put the modules in their places and run the program."""
    found: dict[str, dict[str, Any]] = {
        name: dict.fromkeys(names, Absent) for name, names in NAMES.items()
    }
    found |= {
        "rosidl_runtime_py.convert": {"message_to_ordereddict": fields_of},
        "rosidl_runtime_py.import_message": {"import_message_from_namespaced_type": class_of},
        "rosidl_runtime_py.set_message": {"set_message_fields": set_fields},
        "rosidl_runtime_py.utilities": {"get_namespaced_type": type_of},
    }
    for name, values in found.items():
        package, _, last = name.rpartition(".")
        made = ModuleType(name)
        vars(made).update(values)
        if package:
            parent = sys.modules.setdefault(package, ModuleType(package))
            parent.__path__ = []
            setattr(parent, last, made)
        sys.modules[name] = made
    del sys.argv[0]
    sys.path[0] = str(Path(sys.argv[0]).parent)
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
