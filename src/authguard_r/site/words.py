# SPDX-License-Identifier: Apache-2.0
"""The standard vocabulary, and how a site takes words over from it.

One canonical type for each effect: two planners that call one effect by two names are held to the
same grant. A site says `words: standard` or lists the types that its robots can do; what it takes
over becomes part of its own signed vocabulary, so a later release of the standard changes no site.
Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any, cast

import msgspec
from msgspec.structs import replace

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import ActionType
from authguard_r.site.model import ActionModel
from authguard_r.site.strict import convert, read_yaml

_FILE = "words.yaml"


def standard_words() -> dict[ActionType, ActionModel]:
    """Return the standard vocabulary: each canonical action type with its model.

    The dict is the caller's own; changing it changes nothing elsewhere. None of these types is part
    of a site until the site names it.
    """
    return dict(_standard())


@cache
def _standard() -> tuple[tuple[ActionType, ActionModel], ...]:
    """Read the shipped file once; the models are frozen, the pairs a tuple."""
    text = files("authguard_r.site").joinpath(_FILE).read_text(encoding="utf-8")
    plain = read_yaml(text, where=_FILE)
    return tuple(convert(plain, dict[ActionType, ActionModel], where=_FILE).items())


def with_words(data: object, *, where: str) -> object:
    """Return a site's plain data with the types that `words` names put into its `vocabulary`.

    Data without `words` comes back as it is: its digest cannot change.

    Args:
        data: a site as read from YAML, from its author; any shape.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: `words` is no list of standard types, names one twice, or names one that
            the site's own `vocabulary` gives another content.
    """
    if not isinstance(data, dict) or "words" not in data:
        return data
    plain = cast("dict[str, Any]", data)
    taken = _taken(plain["words"], where=f"{where}:words")
    rest = {key: value for key, value in plain.items() if key != "words"}
    own = rest.get("vocabulary", {})
    if not isinstance(own, dict):
        return rest
    for word in taken.keys() & own.keys():
        place = f"{where}:vocabulary.{word}"
        mine = convert(own[word], ActionModel, where=place)
        if replace(mine, beside=False) != taken[word]:  # what may run together each site says
            raise MalformedError(
                f"expected the content that the standard vocabulary gives `{word}`, "
                "or `words` without it",
                where=place,
            )
    rest["vocabulary"] = {**msgspec.to_builtins(taken), **own}
    return rest


def _taken(words: object, *, where: str) -> dict[ActionType, ActionModel]:
    """Return the types that `words` names."""
    known = standard_words()
    if words == "standard":
        return known
    if not isinstance(words, list):
        raise MalformedError("expected `standard` or a list of its types", where=where)
    taken: dict[ActionType, ActionModel] = {}
    for number, word in enumerate(words):
        place = f"{where}[{number}]"
        if not isinstance(word, str) or word not in known:
            raise MalformedError(
                f"expected a type of the standard vocabulary, got `{word}`", where=place
            )
        if word in taken:
            raise MalformedError(f"expected each type once, got `{word}` again", where=place)
        taken[ActionType(word)] = known[ActionType(word)]
    return taken
