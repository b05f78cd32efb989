# SPDX-License-Identifier: Apache-2.0
"""Whether the task's words speak of what a mission grants, by the site's own names.

Evidence for a signer's eye, never authority: a word that is missing makes a finding, and a word
that is there permits nothing. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from authguard_r.core.identifiers import ObjectId, RegionId
from authguard_r.site.model import Site

_WORD = re.compile(r"\w+")
_SENTENCE_END = re.compile(r"[.!?](?=\s|$)")
#: What makes a sentence forbid something; in doubt it does, for that only costs a signer a look.
_DENIAL = re.compile(
    r"\b(?:no|not|never|neither|nor|none|nowhere|cannot|without|unless|except|excluding|avoid\w*"
    r"|bypass\w*|skip\w*|forbid\w*|forbidden|prohibit\w*|off\W+limits|clear\s+of|away|out\s+of|outside"
    r"|instead\s+of|rather\s+than|around|dont|\w+n\Wt)\b"
)
#: Verbs and nouns that ask for an action type; a type that is not here is asked for by its own id.
_ASKING: dict[str, str] = {
    "announce": "announce say speak tell call",
    "dock": "dock return charge",
    "find": "find search locate look",
    "inspect": "inspect look check examine see",
    "pick": "pick carry bring deliver fetch take collect get grab transport move grasp hand put",
    "place": "place put carry bring deliver drop set leave transport move take hand",
    "put_in": "put place carry bring deliver drop set leave store move",
    "read_sensor": "read sensor measure sample",
    "record_video": "record video film",
    "survey": "survey map scan explore inspect",
    "take_photo": "photo photograph picture image inspect",
    "throw": "throw toss",
    "wait": "wait stay pause",
}
_RIGHTS: dict[str, str] = {
    "record": "record video film photo photograph picture image inspect survey scan read",
    "store": "store keep save archive record",
    "transmit": "transmit send show share upload report",
}


def words_of(text: str) -> tuple[str, ...]:
    """Return the words of a text, case folded."""
    return tuple(_WORD.findall(text.casefold().replace("_", " ")))


def affirmed(task: str) -> tuple[str, ...]:
    """Return the words of the sentences that forbid nothing.

    What a sentence forbids ends with the sentence, not with a comma: "never go through Office 1,
    Office 2" forbids both. Where one is left out stands an empty word, which no name holds, so
    that the words around it make no name together.
    """
    kept: list[str] = []
    for sentence in _SENTENCE_END.split(task):
        denied = _DENIAL.search(sentence.casefold().replace("_", " ")) is not None
        kept += [""] if denied else words_of(sentence)
    return tuple(kept)


def mentions(task: tuple[str, ...], names: Iterable[str]) -> bool:
    """True when the task holds all words of one of the names, in their order and side by side."""
    return any(_holds(task, words_of(name)) for name in names)


def region_names(region: RegionId, site: Site) -> tuple[str, ...]:
    """Return every spelling of a region, none when the site does not know it."""
    model = site.regions.get(region)
    return () if model is None else (region, *model.names)


def object_names(item: ObjectId, site: Site) -> tuple[str, ...]:
    """Return every spelling of an object, and its class when no other object is of it."""
    model = site.objects.get(item)
    if model is None:
        return ()
    alike = [other for other in site.objects.values() if other.kind == model.kind]
    return (item, *model.names, *((model.kind,) if len(alike) == 1 else ()))


def asks_for_type(task: tuple[str, ...], kind: str) -> bool:
    """True when the task asks for actions of this type."""
    verbs = _ASKING.get(kind)
    if verbs is None:
        return all(_speaks(task, word) for word in words_of(kind))
    return any(_speaks(task, verb) for verb in verbs.split())


def asks_for_right(task: tuple[str, ...], right: str) -> bool:
    """True when the task asks to record, store or transmit."""
    return any(_speaks(task, verb) for verb in _RIGHTS[right].split())


def _holds(task: tuple[str, ...], name: tuple[str, ...]) -> bool:
    ends = len(task) - len(name) + 1
    return bool(name) and any(task[n : n + len(name)] == name for n in range(ends))


def _speaks(task: tuple[str, ...], verb: str) -> bool:
    """True when the verb is in the task, in any of its regular forms."""
    stem = verb.removesuffix("e")
    forms = {verb, f"{verb}s", f"{verb}es", f"{stem}ed", f"{stem}ing", f"{verb}{verb[-1]}ing"}
    if verb.endswith("y"):
        forms |= {f"{verb[:-1]}ies", f"{verb[:-1]}ied"}
    return not forms.isdisjoint(task)
