# SPDX-License-Identifier: Apache-2.0
"""Readers and retention of sealed fields as people write them into a gate configuration.

How-to: docs/howto/gate-config.md
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import typer
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.sealing.policy import Reader, Retention
from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.core.mission import DataClass
from authguard_r.keys.readers import read_public
from authguard_r.keys.trust import read_file
from authguard_r.site.formatting import quantity
from authguard_r.site.source import convert

_DAY_MS = 86_400_000


class RetentionForm(
    Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, rename={"data": "class"}
):
    """How long sealed fields of one class are kept, as people write it.

    Args:
        data: the class; written as `class`.
        least: as `30 d`: they are not destroyed before, counted from the mission's expiry.
        most: as `90 d`: the gate destroys them then; left out or `0 d`: it never does.
    """

    data: DataClass
    least: Quantity | None = None
    most: Quantity | None = None


def readers_of(readers: tuple[Reader, ...]) -> tuple[Reader, ...]:
    """Return readers as they are signed: classes sorted, each once."""
    return tuple(replace(one, classes=tuple(sorted(set(one.classes)))) for one in readers)


def retention_of(rules: tuple[RetentionForm, ...], *, where: str) -> tuple[Retention, ...]:
    """Return rules as they are signed: sorted, in milliseconds.

    Raises:
        MalformedError: no quantity of time.
        ClarificationError: one without its unit.
    """
    found = (
        Retention(
            data=rule.data,
            least_ms=_ms(rule.least, f"{where}[{number}].least"),
            most_ms=_ms(rule.most, f"{where}[{number}].most"),
        )
        for number, rule in enumerate(rules)
    )
    return tuple(sorted(found, key=lambda rule: rule.data))


def reader_named(text: str) -> Reader:
    """Return the reader that a `ROLE:class,class:KEY` on the command line names.

    KEY is the public key, or a file with it, as `authguard audit reader --show` prints it.

    Raises:
        BadParameter: it is neither.
    """
    role, _, rest = text.partition(":")
    classes, colon, key = rest.partition(":")
    known = [str(data) for data in DataClass]
    if not colon or not set(classes.split(",")) <= set(known):
        message = f"expected ROLE:class,class:KEY with classes of {', '.join(known)}, got `{text}`"
        raise typer.BadParameter(message, param_hint="--reader")
    try:
        spelled = key
        if Path(key).is_file():
            spelled = read_file(Path(key)).decode("ascii", "replace").strip()
        read_public(spelled, where="--reader")
        named = Reader(
            role=convert(role, Identifier, where="--reader"),
            classes=tuple(DataClass(name) for name in classes.split(",")),
            key=spelled,
        )
    except MalformedError as error:
        raise typer.BadParameter(error.message, param_hint="--reader") from error
    return named


def written_readers(config: GateConfig) -> str:
    """Return who may read, as people edit it."""
    readers = [
        f'  - {{role: {one.role}, classes: [{", ".join(one.classes)}], key: "{one.key}"}}\n'
        for one in config.readers
    ]
    return f"readers:\n{''.join(readers)}" if readers else "readers: []\n"


def sealing_card(config: GateConfig) -> Iterator[str]:
    """Yield who may read what of the log, and for how long, for the person who signs it."""
    for number, one in enumerate(config.readers):
        name = read_public(one.key, where=f"gate.readers[{number}].key").name
        yield f"  reader {one.role}: {', '.join(one.classes)}, with the key {name}"
    for rule in config.retention:
        after = f"after {_time(rule.most_ms)}" if rule.most_ms else "by order alone"
        yield f"  {rule.data}: stored for at least {_time(rule.least_ms)}, destroyed {after}"


def _ms(value: Quantity | None, where: str) -> int:
    return 0 if value is None else to_integer(value, "ms", where=where)


def _time(value_ms: int) -> str:
    days, rest = divmod(value_ms, _DAY_MS)
    return quantity(value_ms, "ms") if rest else f"{days} d"
