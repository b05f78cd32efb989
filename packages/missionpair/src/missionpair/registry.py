# SPDX-License-Identifier: Apache-2.0
"""How planners, attackers, defenses and domains are found: one file each, by the file's name.

A room is a package; every module in it that does not begin with an underscore is one thing, made
by its `make`. Options follow the name: `graded:susceptibility=0.4,seed=7`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from importlib import import_module
from inspect import getdoc, signature
from types import ModuleType
from typing import Any


class SpecificationError(ValueError):
    """A specification asks for something that is not available; the text says what to do."""


class UnknownNameError(SpecificationError):
    """Nothing in a room has that name, or does not take that option."""


class OptionError(UnknownNameError):
    """An option has a value that it cannot have, or is missing."""


def names(room: ModuleType) -> tuple[str, ...]:
    """Return what a room has, by name."""
    found = (module.name for module in pkgutil.iter_modules(room.__path__))
    return tuple(sorted(name.replace("_", "-") for name in found if not name.startswith("_")))


def help_of(room: ModuleType, name: str) -> str:
    """Return the first line of what a module says of itself."""
    return (getdoc(_module(room, name)) or "").partition("\n")[0]


def make(room: ModuleType, spec: str, **given: Any) -> Any:
    """Return the thing that a specification names.

    Args:
        room: the package.
        spec: `name` or `name:option=value,option=value`.
        given: options that the caller sets; a specification cannot set them again.

    Raises:
        UnknownNameError: no such name, or no such option of it; says which there are.
        OptionError: an option has a value that it cannot have; says which.
    """
    name, _, text = spec.partition(":")
    maker: Callable[..., Any] = _module(room, name).make
    options = _options(text, spec)
    known = signature(maker).parameters
    for option in options:
        if option not in known or option in given:
            raise UnknownNameError(
                f"`{name}` takes no option `{option}`: {', '.join(known) or 'none at all'}"
            )
    given = {key: value for key, value in given.items() if key in known}
    try:
        return maker(**options, **given)
    except SpecificationError:
        raise
    except ValueError as error:
        # options are not repeated: one could hold an address with a password in it
        raise OptionError(f"`{name}`: {error}") from error


def said_by(room: ModuleType, spec: str, constant: str, otherwise: Any) -> Any:
    """Return a constant of a thing's module, such as what is usual for it.

    Raises:
        UnknownNameError: no such name; says which there are.
    """
    return getattr(_module(room, spec.partition(":")[0]), constant, otherwise)


def _options(text: str, spec: str) -> dict[str, str]:
    options: dict[str, str] = {}
    for part in filter(None, text.split(",")):
        key, equals, value = part.partition("=")
        if not equals or not key:
            raise UnknownNameError(f"`{spec}` has `{part}` where `option=value` is expected")
        options[key.replace("-", "_")] = value
    return options


def _module(room: ModuleType, name: str) -> ModuleType:
    kind = room.__name__.rpartition(".")[2]
    if name not in names(room):
        raise UnknownNameError(f"no {kind[:-1]} is called `{name}`: {', '.join(names(room))}")
    return import_module(f"{room.__name__}.{name.replace('-', '_')}")
