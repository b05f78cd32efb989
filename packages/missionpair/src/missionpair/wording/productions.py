# SPDX-License-Identifier: Apache-2.0
"""The sentences of the grammar: what an attack claims, how one speaks on a channel, what joins it.

They stand in `claims.toml`, `styles.toml`, `persuasion.toml` and `productions.toml`, whole texts in
`written.toml` and `languages.toml`. `{it}` stands for what the mission has there. No sentence but
an ask has a verb that is read as an ask, unless it is denied.
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from importlib.resources import files
from pathlib import Path

import msgspec
from msgspec import Struct

from missionpair.words import Channel, Family

#: What a sentence may leave open.
_SLOT = re.compile(r"\{[^{}]*\}")
_SLOTS = frozenset({"{it}", "{do}", "{ask}", "{body}", "{scene}"})
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


class Grammar(Struct, frozen=True, eq=False):
    """All sentences, one file for each field.

    Args:
        productions: what is the same for every claim and channel.
        claims: what is claimed, by category (`combined` is one) and family.
        written: whole texts, in the same way.
        styles: how one speaks, by channel.
        persuasion: what is said around claim and ask in three turns.
        languages: whole texts in other languages, by language and family.
    """

    productions: Productions
    claims: dict[str, dict[Family, Sided]]
    written: dict[str, dict[Family, Sided]]
    styles: dict[Channel, ChannelStyle]
    persuasion: Persuasion
    languages: dict[str, dict[Family, Sided]]


class GrammarError(ValueError):
    """A folder with sentences that cannot be used; the message says where and why."""


def read_grammar(folder: Path | None = None) -> Grammar:
    """Return our sentences, with those of a folder's files in their place.

    Args:
        folder: has at least one of our files, by our name, in our form; None for ours alone.

    Raises:
        GrammarError: it has none of them, or one that cannot be read.
    """
    found: dict[str, object] = {}
    ours = files("missionpair.wording")
    names = [f"{field}.toml" for field in Grammar.__struct_fields__]
    if folder is not None and not any((folder / name).is_file() for name in names):
        raise GrammarError(f"{folder}: expected at least one of {', '.join(names)}")
    for name in names:
        other = folder / name if folder is not None else None
        path = other if other is not None and other.is_file() else ours / name
        try:
            found[name.removesuffix(".toml")] = _expanded(msgspec.toml.decode(path.read_bytes()))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise GrammarError(f"{path}: {error}") from error
    where = folder or "missionpair.wording"
    try:
        grammar = msgspec.convert(found, Grammar)
    except msgspec.ValidationError as error:
        raise GrammarError(f"{where}: {error}") from error
    for fault in _faults(grammar):
        raise GrammarError(f"{where}: {fault}")
    return grammar


def _faults(grammar: Grammar) -> Iterator[str]:
    """Yield what the types cannot say: a text without its ask would attack nothing."""
    needed: list[tuple[str, Iterable[str], str]] = [
        (f"{name}.toml", _all_of(held), "{do}")
        for name, held in (("written", grammar.written), ("languages", grammar.languages))
    ]
    for channel, style in grammar.styles.items():
        needed.append((f"styles.toml, {channel}.settings", style.settings, "{body}"))
    needed.append(("productions.toml, manner", grammar.productions.manner.values(), "{ask}"))
    for place, sentences, slot in needed:
        for text in sentences:
            if text.count(slot) != 1:
                yield f"{place}: expected `{slot}` once in `{text[:80]}`"
    for text in _texts(msgspec.to_builtins(grammar)):
        unknown = set(_SLOT.findall(text)) - _SLOTS
        if unknown:
            yield f"nothing is called `{min(unknown)}` in `{text[:80]}`"
    if {*grammar.styles} != {*Channel}:
        yield f"styles.toml: expected each of {', '.join(Channel)}"


def _texts(value: object) -> Iterator[str]:
    """Yield every text in plain data."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from (text for item in value.values() for text in _texts(item))
    elif isinstance(value, list | tuple):
        yield from (text for item in value for text in _texts(item))


def _all_of(held: dict[str, dict[Family, Sided]]) -> Iterator[str]:
    for families in held.values():
        for sided in families.values():
            yield from (*sided.against, *sided.same, *sided.any)


def _expanded(value: object) -> object:
    """Return a file's content, with every choice made in every way."""
    if isinstance(value, dict):
        return {key: _expanded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [text for item in value for text in variants(item)]
    return value


OURS = read_grammar()
PRODUCTIONS, STYLES = OURS.productions, OURS.styles
CLAIMS, WRITTEN, LANGUAGES = OURS.claims, OURS.written, OURS.languages


def sentences_of(
    held: dict[str, dict[Family, Sided]], category: str, family: Family, *, same: bool
) -> tuple[str, ...]:
    """Return what an attack may say.

    Args:
        held: a grammar's claims, or its whole texts.
        category: what it changes; of one that is not known, or not of ours, every category that
            the family is a reason for.
        family: what it claims.
        same: it asks for the very place or thing that the mission has there.
    """
    those = [held[category]] if category in held else held.values()
    return tuple(text for one in those if family in one for text in one[family].of(same=same))
