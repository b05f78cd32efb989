# SPDX-License-Identifier: Apache-2.0
"""The sentences of the grammar: what an attack claims, how one speaks on a channel, what joins it.

They stand in `claims.toml`, `styles.toml` and `productions.toml`, whole texts in `written.toml`.
`{it}` stands for what the
mission has there. No sentence but an ask has a verb that is read as an ask, unless it is denied.
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

import re
from importlib.resources import files
from typing import TypeVar

import msgspec
from msgspec import Struct

from missionpair.words import Channel, Family

T = TypeVar("T")

_CHOICE = re.compile(r"\[([^\[\]]*\|[^\[\]]*)\]")


class Sided(Struct, frozen=True, forbid_unknown_fields=True):
    """Sentences about what the mission has, by what the attack does with it.

    Args:
        against: the attack leads away from it.
        same: the attack asks for that very place or thing.
        any: fit both.
    """

    against: tuple[str, ...] = ()
    same: tuple[str, ...] = ()
    any: tuple[str, ...] = ()

    def of(self, *, same: bool) -> tuple[str, ...]:
        """Return those that contradict nothing."""
        return (*self.any, *(self.same if same else self.against))


class ChannelStyle(Struct, frozen=True, forbid_unknown_fields=True):
    """How one speaks on a channel.

    Args:
        authority: by whose word.
        reason: why.
        urgency: how soon.
        former: what becomes of the plan before, where the attack leads away from it.
        further: what becomes of the rest, where the attack asks for a part of the mission.
        closing: how the text ends.
        settings: how it stands there; `{body}` is the text, `{scene}` what the camera sees.
    """

    authority: tuple[str, ...]
    reason: tuple[str, ...]
    urgency: tuple[str, ...]
    former: tuple[str, ...]
    further: tuple[str, ...]
    closing: tuple[str, ...]
    settings: tuple[str, ...]


class Productions(Struct, frozen=True, forbid_unknown_fields=True):
    """What is the same for every claim and channel.

    Args:
        nothing: stands for `{it}` where the mission names nothing there.
        insistence: said where it was said before, and nothing came of it.
        confirmations: what a second channel says to confirm the first.
        manner: how an ask is put; `{ask}` begins with its verb.
        joining: what stands before the first of several asks, later ones and the last.
        arrangement: in which order the sentences stand.
        scenes: what the camera sees where an attacker altered the scene.
    """

    nothing: str
    insistence: tuple[str, ...]
    confirmations: tuple[str, ...]
    manner: dict[str, str]
    joining: dict[str, tuple[str, str, str]]
    arrangement: dict[str, tuple[str, ...]]
    scenes: dict[Family, Sided]


class Persuasion(Struct, frozen=True, forbid_unknown_fields=True):
    """What is said around claim and ask where they come in three turns.

    Args:
        opening: before anything is claimed.
        bridge: with the claim.
        last: before the ask.
    """

    opening: tuple[str, ...]
    bridge: tuple[str, ...]
    last: tuple[str, ...]


def variants(sentence: str) -> tuple[str, ...]:
    """Return every sentence that one with choices stands for: `[a|b] is` for two."""
    found = _CHOICE.search(sentence)
    if found is None:
        return (sentence,)
    head, tail = sentence[: found.start()], sentence[found.end() :]
    return tuple(
        text for choice in found[1].split("|") for text in variants(f"{head}{choice}{tail}")
    )


def _read(name: str, kind: type[T]) -> T:
    """Return a file's content, with every choice made in every way."""
    plain = msgspec.toml.decode(files("missionpair.wording").joinpath(name).read_bytes())
    return msgspec.convert(_expanded(plain), kind)


def _expanded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _expanded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [text for item in value for text in variants(item)]
    return value


PRODUCTIONS = _read("productions.toml", Productions)
#: Whole texts, by category and family.
WRITTEN = _read("written.toml", dict[str, dict[Family, Sided]])
#: What is claimed, by category (`combined` is one) and family.
CLAIMS = _read("claims.toml", dict[str, dict[Family, Sided]])
#: Whole texts in other languages, by language and family.
LANGUAGES = _read("languages.toml", dict[str, dict[Family, Sided]])
PERSUASION = _read("persuasion.toml", Persuasion)
STYLES = _read("styles.toml", dict[Channel, ChannelStyle])


def sentences_of(
    held: dict[str, dict[Family, Sided]], category: str, family: Family, *, same: bool
) -> tuple[str, ...]:
    """Return what an attack may say.

    Args:
        held: `CLAIMS` or `WRITTEN`.
        category: what it changes; of one that is not known, or not of ours, every category that
            the family is a reason for.
        family: what it claims.
        same: it asks for the very place or thing that the mission has there.
    """
    those = [held[category]] if category in held else held.values()
    return tuple(text for one in those if family in one for text in one[family].of(same=same))
