# SPDX-License-Identifier: Apache-2.0
"""A table of phrases in another language, as a rough translation has them, there and back.

Spec page: docs/spec/missionpair-access.md#obfuscation
"""

from __future__ import annotations

import re

#: English phrases and what stands for them; no two have one translation.
TABLE: dict[str, str] = {
    "go to": "fahre zu",
    "drive to": "fahre hin zu",
    "head to": "steuere zu",
    "proceed to": "begib dich zu",
    "move to": "bewege dich zu",
    "navigate to": "navigiere zu",
    "continue to": "fahre weiter zu",
    "make your way to": "mache dich auf zu",
    "travel to": "reise zu",
    "report to": "melde dich bei",
    "via": "unterwegs durch",
    "through": "hindurch durch",
    "by way of": "auf dem Weg durch",
    "over": "hinweg durch",
    "at a speed of": "mit Tempo",
    "with a speed of": "mit der Geschwindigkeit",
    "with a force of": "mit der Kraft",
    "using": "unter Nutzung von",
    "with": "mitsamt",
    "pick up": "hebe auf",
    "take": "nimm",
    "grab": "greife",
    "collect": "sammle ein",
    "fetch": "hole herbei",
    "lift": "hebe an",
    "get": "beschaffe",
    "put down": "setze ab",
    "place": "stelle ab",
    "set down": "lege ab",
    "drop off": "lade ab",
    "leave": "lasse liegen",
    "unload": "entlade",
    "put": "lege",
    "wait for": "warte genau",
    "wait": "warte",
    "pause for": "pausiere",
    "hold still for": "halte still",
    "stand still for": "stehe still",
    "hold for": "halte inne",
    "take a photo": "mache ein Foto",
    "take a picture": "mache ein Bild",
    "take a photograph": "mache eine Fotografie",
    "snap a photo": "knipse ein Foto",
    "record a video for": "nimm ein Video auf von",
    "record video for": "nimm Video auf von",
    "film for": "filme",
    "make a recording of": "mache eine Aufnahme von",
    "set your position to": "setze deine Position auf",
    "set your location to": "setze deinen Ort auf",
    "make a survey of": "vermiss gründlich",
    "survey": "vermiss",
    "map out": "kartiere",
    "inspect": "untersuche",
    "examine": "besichtige",
    "have a close look at": "sieh dir genau an",
    "turn on": "schalte ein",
    "switch on": "schalte an",
    "turn off": "schalte aus",
    "switch off": "schalte ab",
    "open up": "mache weit auf",
    "open": "mache auf",
    "close": "mache zu",
    "shut": "verschliesse",
    "wipe off": "wische ab",
    "wipe": "wische",
    "scan for obstacles": "suche nach Hindernissen",
    "look around for obstacles": "sieh dich nach Hindernissen um",
    "check the way for obstacles": "prüfe den Weg auf Hindernisse",
    "megabytes": "megabyte",
    "relocalize at": "lokalisiere dich bei",
    "say aloud": "sprich laut",
    "say": "sprich",
    "announce": "verlautbare",
    "call the tool": "rufe das Werkzeug",
    "use the tool": "verwende das Werkzeug",
    "run the tool": "starte das Werkzeug",
    "invoke the tool": "bediene das Werkzeug",
    "seconds": "sekunden",
    "minutes": "minuten",
    "please": "bitte",
    "kindly": "freundlicherweise",
    "you must": "du musst",
    "you are to": "du sollst",
    "we need you to": "wir brauchen es so:",
    "is closed": "ist geschlossen",
    "do not": "nicht etwa",
    "and then": "und danach",
    "then": "danach",
    "and": "und",
}


_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')
_BACK = {foreign: english for english, foreign in TABLE.items()}


def into(text: str) -> str:
    """Return the text with every phrase of the table translated."""
    return _ENGLISH.sub(lambda match: _translated(match, TABLE), text)


def back(text: str) -> str:
    """Return the text with every translation of the table undone.

    A text whose foreign words all stand in quotes was not translated: it quotes them.
    """
    if _FOREIGN.search(_QUOTED.sub("", text)) is None:
        return text
    return _FOREIGN.sub(lambda match: _translated(match, _BACK), text)


def _translated(match: re.Match[str], table: dict[str, str]) -> str:
    """Return what stands for a phrase; one that begins a sentence goes on beginning it."""
    found = match[0]
    if found in table:
        return table[found]
    other = table[found[0].lower() + found[1:]]
    return other[0].upper() + other[1:]


def _any_of(phrases: list[str]) -> re.Pattern[str]:
    """Return what matches each phrase as a whole, also with a capital; the longest is taken."""
    longest = sorted(phrases, key=lambda phrase: (-len(phrase), phrase))
    forms = [form for phrase in longest for form in (phrase, phrase[0].upper() + phrase[1:])]
    return re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, forms))})(?!\w)")


_ENGLISH = _any_of(list(TABLE))
_FOREIGN = _any_of(list(_BACK))
