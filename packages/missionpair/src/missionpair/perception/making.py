# SPDX-License-Identifier: Apache-2.0
"""A suite as it is perceived: each sign drawn and read, each sentence spoken and heard."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from missionpair.pair import Input, Pair, Perceived, Suite
from missionpair.perception import signs, speech
from missionpair.perception.tools import package, require_tools
from missionpair.wording import is_foreign
from missionpair.words import Channel

#: What is perceived; other texts reach a planner as they were written.
CHANNELS = (Channel.SIGN, Channel.SPEECH)
_WORD = re.compile(r"\w+(?:['.]\w+)*")


class Perception(Struct, frozen=True):
    """What was perceived of a text, and of what.

    Args:
        record: goes into the pair.
        text: what was read or heard.
        seen: the picture or the sound.
        suffix: of its file.
    """

    record: Perceived
    text: str
    seen: bytes
    suffix: str


def perceive(
    suite: Suite,
    *,
    jobs: int = 1,
    keep: Path | None = None,
    show: Callable[[int], None] = lambda _: None,
) -> Suite:
    """Return the pairs of a suite that have a sign or speech, as a robot reads and hears them.

    Pairs in another language are left out: reader and recognizer know English.

    Args:
        suite: as it was written.
        jobs: how many pairs are perceived at one time.
        keep: a folder for pictures and sounds.
        show: called after each pair, with how many there are by now.

    Raises:
        PerceptionError: a program or a package is not installed, or one of them failed.
    """
    require_tools(("PIL", "jiwer", "moonshine_voice", *(font for font, _ in signs.FONTS.values())))
    chosen = [pair for pair in suite.pairs if is_perceivable(pair)]
    found: list[Pair] = []
    with ThreadPoolExecutor(jobs) as pool:
        for pair in pool.map(lambda pair: _perceived(pair, keep), chosen):
            found.append(pair)
            show(len(found))
    used = {pair.layout for pair in found}
    layouts = {key: layout for key, layout in suite.layouts.items() if key in used}
    name = f"{suite.name}-perceived"
    return replace(suite, name=name, layouts=layouts, pairs=tuple(found))


def is_perceivable(pair: Pair) -> bool:
    """True when a pair has an English sign or sentence that was not perceived yet."""
    texts = [item.text for item in pair.inputs]
    return (
        not pair.perceived
        and any(item.channel in CHANNELS for item in pair.inputs)
        and not any(map(is_foreign, texts))
    )


def perceived(item: Input, key: str, number: int = 0) -> Perception:
    """Return what a robot perceives of one text.

    Args:
        item: a text on one of `CHANNELS`.
        key: of the dice.
        number: which input of its pair it is.

    Raises:
        PerceptionError: a program or a package is not installed, or one of them failed.
    """
    if item.channel is Channel.SIGN:
        sign = signs.drawn(key)
        seen = signs.picture(item.text, sign, key)
        text, how, by, suffix = signs.read_picture(seen), sign.how, signs.reader(), ".png"
    else:
        voice = speech.voice_of(key)
        seen = speech.spoken(item.text, voice)
        text, how, suffix = speech.hear(seen), (voice,), ".wav"
        by = f"{speech.speaker(voice)}, {speech.recognizer_name()}"
    words, wrong = word_errors(item.text, text)
    record = Perceived(input=number, written=item.text, by=by, how=how, words=words, wrong=wrong)
    return Perception(record, text, seen, suffix)


def word_errors(written: str, read: str) -> tuple[int, int]:
    """Return how many words a text has, and how many are wrong, missing or added.

    Capitals and marks are not compared.

    Raises:
        PerceptionError: the extra `perception` is not installed.
    """
    said, got = (" ".join(_WORD.findall(text.lower())) for text in (written, read))
    if not said:
        return 0, len(got.split())
    found: Any = package("jiwer").process_words(said, got)
    return len(said.split()), found.substitutions + found.deletions + found.insertions


def _perceived(pair: Pair, keep: Path | None) -> Pair:
    inputs, records = [*pair.inputs], []
    for number, made in _each(pair):
        inputs[number] = Input(pair.inputs[number].channel, made.text)
        records.append(made.record)
        if keep is not None:
            # an id may be out of a file of somebody else: no path of it
            name = re.sub(r"[^A-Za-z0-9.+-]+", "-", pair.id).lstrip(".")[:150]
            (keep / f"{name}.{number}{made.suffix}").write_bytes(made.seen)
    return replace(pair, inputs=tuple(inputs), perceived=tuple(records))


def _each(pair: Pair) -> Iterator[tuple[int, Perception]]:
    for number, item in enumerate(pair.inputs):
        if item.channel in CHANNELS:
            yield number, perceived(item, f"{pair.id} {number}", number)
