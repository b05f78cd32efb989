# SPDX-License-Identifier: Apache-2.0
"""The sentences of the grammar: what an attack claims, how one speaks on a channel, what joins it.

They stand in `claims.toml`, `styles.toml`, `persuasion.toml` and `productions.toml`, whole texts in
`written.toml` and `languages.toml`. `{it}` stands for what the mission has there. No sentence but
an ask has a verb that is read as an ask, unless it is denied.
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import get_type_hints

import msgspec
from msgspec import Struct

from missionpair.wording.foreign import TABLES
from missionpair.words import COMBINED, Category, Channel, Family

#: What a sentence may leave open.
_SLOT = re.compile(r"\{[^{}]*\}")
_SLOTS = {
    "productions": ("{it}", "{ask}"),
    "claims": ("{it}",),
    "written": ("{it}", "{do}"),
    "styles": ("{it}", "{body}", "{scene}"),
    "persuasion": (),
    "languages": ("{it}", "{do}"),
}
#: What an arrangement puts in order.
_SENTENCES = frozenset({"claim", "authority", "reason", "former", "ask", "urgency", "closing"})
#: A category of a file that has one list of sentences for every category.
EVERY = "own"
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
    if folder is not None:
        _require_folder(folder, names)
    for field, kind in get_type_hints(Grammar).items():
        other = folder / f"{field}.toml" if folder is not None else None
        path = other if other is not None and other.is_file() else ours / f"{field}.toml"
        try:
            read = _expanded(msgspec.toml.decode(path.read_bytes()))
            found[field] = msgspec.convert(read, kind)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise GrammarError(f"{path}: {error}{_fields_of(kind)}") from error
    grammar = Grammar(**found)  # type: ignore[arg-type]
    for name, fault in _faults(grammar):
        raise GrammarError(f"{folder or 'missionpair.wording'}/{name}.toml: {fault}")
    return grammar


def _require_folder(folder: Path, names: list[str]) -> None:
    if not folder.exists():
        raise GrammarError(f"{folder}: there is no such folder")
    if not folder.is_dir():
        raise GrammarError(f"{folder}: expected a folder, got a file")
    if not any((folder / name).is_file() for name in names):
        raise GrammarError(f"{folder}: expected at least one of {', '.join(names)}")


def _fields_of(kind: object) -> str:
    """Return what a file may have at its top, where that is fixed."""
    if isinstance(kind, type) and issubclass(kind, Struct):
        return f"; it has {', '.join(kind.__struct_fields__)}"
    return ""


def _faults(grammar: Grammar) -> Iterator[tuple[str, str]]:
    """Yield file and fault of what the types cannot say."""
    yield from _without_slot(grammar)
    yield from _empty(grammar)
    yield from _structure(grammar)
    for file, slots in _SLOTS.items():
        for text in _texts(msgspec.to_builtins(getattr(grammar, file))):
            yield from ((file, fault) for fault in _faults_of(text, slots))
    yield from _missing(grammar)


def _without_slot(grammar: Grammar) -> Iterator[tuple[str, str]]:
    """Yield texts that would ask for nothing."""
    needed: list[tuple[str, str, Iterable[str], str]] = [
        ("written", "", _all_of(grammar.written), "{do}"),
        ("languages", "", _all_of(grammar.languages), "{do}"),
        ("productions", "manner: ", grammar.productions.manner.values(), "{ask}"),
    ]
    for channel, style in grammar.styles.items():
        needed.append(("styles", f"{channel}.settings: ", style.settings, "{body}"))
    for file, place, sentences, slot in needed:
        for text in sentences:
            if text.count(slot) != 1:
                yield file, f"{place}expected `{slot}` once in `{text[:80]}`"


def _empty(grammar: Grammar) -> Iterator[tuple[str, str]]:
    """Yield lists that an attack is to choose from, and that have nothing."""
    common = grammar.productions
    lists: list[tuple[str, str, Collection[object]]] = [
        ("productions", name, getattr(common, name))
        for name in ("insistence", "confirmations", "manner", "joining", "arrangement")
    ]
    lists += [
        ("persuasion", name, getattr(grammar.persuasion, name))
        for name in Persuasion.__struct_fields__
    ]
    lists += [
        ("styles", f"{channel}.{name}", getattr(style, name))
        for channel, style in grammar.styles.items()
        for name in ChannelStyle.__struct_fields__
    ]
    for file, held in (("claims", grammar.claims), ("written", grammar.written)):
        for category, families in held.items():
            for family, sided in families.items():
                place = f"{category}.{family}"
                lists.append((file, place, (*sided.any, *sided.against, *sided.same)))
    for file, place, sentences in lists:
        if not sentences:
            yield file, f"{place}: expected at least one sentence"


def _structure(grammar: Grammar) -> Iterator[tuple[str, str]]:
    """Yield what does not fit the other files."""
    common = grammar.productions
    if {*grammar.styles} != {*Channel}:
        yield "styles", f"expected each of {', '.join(Channel)}"
    if {*common.scenes} != {*Family}:
        yield "productions", f"scenes: expected each of {', '.join(Family)}"
    for name, order in common.arrangement.items():
        if order.count("ask") != 1 or not _SENTENCES.issuperset(order):
            expected = f"expected `ask` once and any of {', '.join(sorted(_SENTENCES))}"
            yield "productions", f"arrangement.{name}: {expected}"


def _faults_of(text: str, slots: tuple[str, ...]) -> Iterator[str]:
    unknown = {*_SLOT.findall(text)} - {*slots}
    if unknown:
        there = (
            f"there are {', '.join(f'`{slot}`' for slot in slots)}" if slots else "there is none"
        )
        yield f"nothing is called `{min(unknown)}` in `{text[:80]}`; {there}"
    elif set(_SLOT.sub("", text)) & set("{}[]"):
        yield f"a bracket is not closed, or has no choice `[a|b]`, in `{text[:80]}`"


def _missing(grammar: Grammar) -> Iterator[tuple[str, str]]:
    """Yield what would leave an attack without its sentence."""
    claimed = {family for held in grammar.claims.values() for family in held}
    for family in Family:
        if family not in claimed:
            yield "claims", f"no category has a sentence for `{family}`"
    for file, held in (("claims", grammar.claims), ("written", grammar.written)):
        for category in held:
            if category not in {COMBINED, EVERY} and not _is_category(category):
                yield file, f"no category is called `{category}`; `{EVERY}` may stand for all"
    if {*grammar.languages} != {*TABLES}:
        yield (
            "languages",
            f"expected each of {', '.join(TABLES)}, got {', '.join(grammar.languages)}",
        )
    for language, families in grammar.languages.items():
        if lacks := {*Family} - {*families}:
            yield "languages", f"{language}: no sentence for `{min(lacks)}`"


def _is_category(name: str) -> bool:
    try:
        Category(name)
    except ValueError:
        return False
    return True


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
        # what is no text stays, and is refused with its place
        return [
            text
            for item in value
            for text in (variants(item) if isinstance(item, str) else (item,))
        ]
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
