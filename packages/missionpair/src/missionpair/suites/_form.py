# SPDX-License-Identifier: Apache-2.0
"""The file of a suite: JSON Lines, a header first, then its layouts, then its pairs.

The digest is over the lines behind the header, byte for byte. What is not written exactly as this
module writes it is refused, with the line and what to do. Spec page: docs/spec/missionpair.md#file
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from functools import cache, partial
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.core.encoding import b64
from missionpair.pair import SCHEMA, Layout, Pair, PriorAct, Suite
from missionpair.suites._counts import perceived_of, variety_of

_FROZEN = "frozen.json"
#: Longest line, in bytes; the longest of ours is a hundredth of it.
_LONGEST = 4_000_000


class SuiteError(Exception):
    """A suite that cannot be read or made.

    Args:
        where: the file with its line, or the pair.
        message: what is wrong there, and what to do.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(f"{where}: {message}")
        self.where = where
        self.message = message

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(SuiteError, where=self.where), (self.message,)


class SuiteHeader(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first line.

    Args:
        schema: version of this form.
        name: of the suite.
        version: grows with every change of a pair.
        layouts: how many lines with layouts follow.
        pairs: how many lines with pairs follow them.
        digest: SHA-256 of those lines, base64url.
    """

    schema: str
    name: str
    version: int
    layouts: int
    pairs: int
    digest: str


class _LayoutLine(Struct, frozen=True, forbid_unknown_fields=True):
    layout: Layout


class _PairLine(Struct, frozen=True, forbid_unknown_fields=True):
    pair: Pair


def digest_of(suite: Suite) -> str:
    """Return the digest of a suite's lines."""
    hasher = sha256(SCHEMA.encode() + b"\0")
    for line in _body(suite):
        hasher.update(line)
    return b64(hasher.digest())


def counts_of(suite: Suite) -> dict[str, Any]:
    """Return what `suites/frozen.json` holds of a suite: version, digest and counts."""
    perceived = perceived_of(suite)
    return {
        "version": suite.version,
        "digest": digest_of(suite),
        "layouts": len(suite.layouts),
        "pairs": len(suite.pairs),
        "domains": dict(sorted(Counter(str(pair.domain) for pair in suite.pairs).items())),
        "categories": dict(
            sorted(Counter("+".join(sorted(pair.categories)) for pair in suite.pairs).items())
        ),
        **variety_of(suite),
        **({"perceived": perceived} if perceived else {}),
    }


@cache
def frozen() -> dict[str, list[dict[str, Any]]]:
    """Return every version of every suite, as they were frozen; the last one is in force."""
    text = files("missionpair.suites").joinpath(_FROZEN).read_text(encoding="utf-8")
    found: dict[str, list[dict[str, Any]]] = json.loads(text)
    return found


def write_suite(suite: Suite, path: Path) -> str:
    """Write a suite into a new file; return its digest.

    Raises:
        SuiteError: there is such a file already, or it cannot be written.
    """
    digest = digest_of(suite)
    header = SuiteHeader(
        schema=SCHEMA,
        name=suite.name,
        version=suite.version,
        layouts=len(suite.layouts),
        pairs=len(suite.pairs),
        digest=digest,
    )
    try:
        with path.open("xb") as file:
            file.write(_line(header))
            file.writelines(_body(suite))
    except OSError as error:
        why = error.strerror or str(error)
        raise SuiteError(f"{why}; give the path of a new file", where=str(path)) from error
    return digest


def read_suite(path: Path) -> Suite:
    """Return the suite in a file.

    Raises:
        SuiteError: it cannot be read, or a line is not what it has to be.
    """
    try:
        with path.open("rb") as file:
            return _read(iter(file), str(path))
    except OSError as error:
        why = error.strerror or str(error)
        raise SuiteError(f"{why}; give a suite's name or its file", where=str(path)) from error


def _body(suite: Suite) -> Iterator[bytes]:
    for layout in suite.layouts.values():
        yield _line(_LayoutLine(layout))
    for pair in suite.pairs:
        yield _line(_PairLine(pair))


def _line(value: Struct) -> bytes:
    return msgspec.json.encode(value) + b"\n"


def _read(lines: Iterator[bytes], name: str) -> Suite:
    header = _decoded(next(lines, b""), SuiteHeader, f"{name}:1")
    if header.schema != SCHEMA:
        text = f"expected `{SCHEMA}`, got `{header.schema[:80]}`; it is of another version"
        raise SuiteError(text, where=f"{name}:1")
    hasher = sha256(SCHEMA.encode() + b"\0")
    layouts: dict[str, Layout] = {}
    pairs: dict[str, Pair] = {}
    for number, line in enumerate(lines, 2):
        where = f"{name}:{number}"
        hasher.update(line)
        if number - 2 < header.layouts:
            layout = _decoded(line, _LayoutLine, where).layout
            _once(layout.id, layouts, where)
            layouts[layout.id] = layout
            continue
        if len(pairs) == header.pairs:
            text = f"expected {header.pairs} pairs, got more; the header counts them"
            raise SuiteError(text, where=where)
        pair = _decoded(line, _PairLine, where).pair
        _once(pair.id, pairs, where)
        require_pair(pair, layouts, where)
        pairs[pair.id] = pair
    if (len(layouts), len(pairs)) != (header.layouts, header.pairs):
        got = f"{len(layouts)} layouts and {len(pairs)} pairs"
        text = f"expected {header.layouts} layouts and {header.pairs} pairs, got {got}; it was cut"
        raise SuiteError(text, where=f"{name}:{len(layouts) + len(pairs) + 2}")
    if b64(hasher.digest()) != header.digest:
        text = "the lines are not those that the digest is of; write the suite anew"
        raise SuiteError(text, where=f"{name}:1")
    held = tuple(pairs.values())
    return Suite(name=header.name, version=header.version, layouts=layouts, pairs=held)


def _decoded(line: bytes, kind: Any, where: str) -> Any:
    if len(line) > _LONGEST:
        raise SuiteError(f"expected at most {_LONGEST} bytes in a line", where=where)
    try:
        found = msgspec.json.decode(line, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise SuiteError(f"{error}; write the suite anew", where=where) from error
    if _line(found) != line:
        text = "not as it is written: a key twice, other spaces, or no end of line"
        raise SuiteError(f"{text}; write the suite anew", where=where)
    return found


def _once(identifier: str, held: dict[str, Any], where: str) -> None:
    if identifier in held:
        raise SuiteError(f"`{identifier}` is there already; give it another id", where=where)


def require_suite(suite: Suite) -> None:
    """Hold a suite that was made here to what a file is held to.

    Raises:
        SuiteError: with the pair.
    """
    seen: dict[str, Pair] = {}
    for pair in suite.pairs:
        _once(pair.id, seen, pair.id)
        seen[pair.id] = pair
        require_pair(pair, suite.layouts, pair.id)


def require_pair(pair: Pair, layouts: dict[str, Layout], where: str) -> None:
    """Hold one pair to what its types cannot say.

    Raises:
        SuiteError: with the place and what to do.
    """
    for fault in _faults(pair, layouts):
        raise SuiteError(fault, where=f"{where} ({pair.id})")


def _faults(pair: Pair, layouts: dict[str, Layout]) -> Iterator[str]:
    layout = layouts.get(pair.layout)
    if layout is None:
        yield f"no layout is called `{pair.layout}`; layouts come before pairs"
        return
    if not pair.missions or next(iter(pair.missions)) != "v1":
        yield "expected `v1`, the attacked mission, as the first of `missions`"
    if not pair.categories or not pair.violates or not pair.reasons:
        yield "expected at least one category, one violated field and one reason"
    yield from _input_faults(pair)
    if not pair.attack.plan or not pair.benign.plan or not pair.update:
        yield "expected a plan of the attack, one of the benign run, and an update"
    unknown = {*pair.commissioned} - {*layout.site.get("vocabulary", {})}
    if unknown:
        yield f"no action type of the layout is called `{min(unknown)}` (`commissioned`)"
    robots = layout.site.get("robots", {})
    for scenario in (pair.benign, pair.attack):
        if scenario.robot not in robots:
            yield f"no robot of the layout is called `{scenario.robot}`"
    for act in (*pair.benign.before, *pair.attack.before, *pair.update):
        yield from _act_faults(act, pair)


def _input_faults(pair: Pair) -> Iterator[str]:
    if [item.channel for item in pair.inputs] != list(pair.channels):
        yield "expected one input for each of `channels`, in their order"
    if any(not 0 <= record.input < len(pair.inputs) for record in pair.perceived):
        yield "expected in `perceived` numbers of `inputs`, counted from 0"


def _act_faults(act: PriorAct, pair: Pair) -> Iterator[str]:
    if act.do in {"activate", "force"} and act.mission not in pair.missions:
        yield f"no mission of the pair is called `{act.mission}`"
    if act.do in {"approve", "choose", "order"} and not act.by:
        yield f"expected somebody in `by`: nobody else may `{act.do}`"
