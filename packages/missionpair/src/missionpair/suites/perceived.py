# SPDX-License-Identifier: Apache-2.0
"""Signs that Tesseract read and sentences that a recognizer heard: pairs of `full`, as perceived.

`_perceived.json` holds what was read and heard. How it is made: docs/spec/missionpair.md#perception
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from missionpair.pair import Input, Pair, Perceived, Suite
from missionpair.registry import UnknownNameError
from missionpair.suites import full
from missionpair.suites._form import SuiteError, read_suite

VERSION = 1
_DATA = "_perceived.json"


class _Data(Struct, frozen=True, forbid_unknown_fields=True):
    """By the id of a pair of `full`: its texts as they were perceived, and of what."""

    version: int
    inputs: dict[str, tuple[str, ...]]
    perceived: dict[str, tuple[Perceived, ...]]


def make(text: str = "read") -> Suite:
    """Return the suite; with `text=written` the same pairs with their texts as they were written.

    Raises:
        UnknownNameError: `text` is neither `read` nor `written`.
        SuiteError: `full` has another version than what was perceived.
    """
    if text not in {"read", "written"}:
        raise UnknownNameError(
            f"`perceived`: `text` is `{text[:80]}`: expected `read` or `written`"
        )
    raw = files("missionpair.suites").joinpath(_DATA).read_bytes()
    data = msgspec.json.decode(raw, type=_Data)
    whole = full.make()
    if data.version != whole.version:
        why = f"perceived of version {data.version} of `full`, which has version {whole.version}"
        raise SuiteError(f"{why}; perceive it anew", where=_DATA)
    chosen = [pair for pair in whole.pairs if pair.id in data.inputs]
    pairs = [_perceived(pair, data) for pair in chosen] if text == "read" else chosen
    used = {pair.layout for pair in pairs}
    layouts = {key: layout for key, layout in whole.layouts.items() if key in used}
    return Suite(name="perceived", version=VERSION, layouts=layouts, pairs=tuple(pairs))


def _perceived(pair: Pair, data: _Data) -> Pair:
    texts, records = data.inputs[pair.id], data.perceived[pair.id]
    for record in records:
        if pair.inputs[record.input].text != record.written:
            raise SuiteError("it has another text by now; perceive it anew", where=pair.id)
    inputs = tuple(map(Input, pair.channels, texts))
    return replace(pair, inputs=inputs, perceived=records)


def keep(suite: Suite) -> None:
    """Keep what was perceived of `full` as this suite's data."""
    inputs = {pair.id: tuple(item.text for item in pair.inputs) for pair in suite.pairs}
    data = _Data(suite.version, inputs, {pair.id: pair.perceived for pair in suite.pairs})
    text = msgspec.json.format(msgspec.json.encode(data), indent=1)
    Path(__file__).with_name(_DATA).write_bytes(text + b"\n")


if __name__ == "__main__":
    keep(read_suite(Path(sys.argv[1])))
