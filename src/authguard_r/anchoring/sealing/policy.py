# SPDX-License-Identifier: Apache-2.0
"""What of a gate's log is sealed, for whom, and for how long: part of its signed configuration.

Spec page: docs/spec/sealed-fields.md#readers
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Base64Url, Count, Identifier
from authguard_r.core.mission import DataClass
from authguard_r.core.reasons import Reason
from authguard_r.keys.readers import ReaderPublic, read_public


class Reader(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One key that may read some classes of sealed fields.

    Args:
        role: who has the key: a word of the organization's; grants nothing else.
        classes: what it opens, sorted and unique.
        key: the public key, base64url (`authguard audit reader` prints it).
    """

    role: Identifier
    classes: Annotated[tuple[DataClass, ...], Meta(min_length=1)]
    key: Base64Url


class Retention(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How long the sealed fields of a class are kept after their mission's expiry.

    Args:
        data: the class.
        least_ms: they are not destroyed before, also not by an order.
        most_ms: the gate destroys them then by itself; 0: it never does.
    """

    data: DataClass
    least_ms: Count = 0
    most_ms: Count = 0


class SealingPolicy(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What of a log is sealed, for whom, and for how long.

    Args:
        readers: who may read; a class without readers is not sealed.
        retention: how long it is kept.
    """

    readers: tuple[Reader, ...] = ()
    retention: tuple[Retention, ...] = ()

    @property
    def classes(self) -> tuple[DataClass, ...]:
        """The classes that are sealed: those that a reader may read."""
        return tuple(sorted({one for reader in self.readers for one in reader.classes}))

    @property
    def least_ms(self) -> int:
        """The longest `least_ms` of all rules: before, no field of a mission is destroyed."""
        return max((rule.least_ms for rule in self.retention), default=0)

    @property
    def most_ms(self) -> dict[DataClass, int]:
        """How long the gate keeps a class at most; a class that is absent has no such bound."""
        return {rule.data: rule.most_ms for rule in self.retention if rule.most_ms}


def require_readers(readers: tuple[Reader, ...], *, where: str) -> tuple[ReaderPublic, ...]:
    """Return the keys of readers who have to have one each, and classes sorted and unique.

    Raises:
        MalformedError: one has no key that holds, or two have the same.
    """
    keys = tuple(
        read_public(reader.key, where=f"{where}[{number}].key")
        for number, reader in enumerate(readers)
    )
    for number, reader in enumerate(readers):
        if sorted(set(reader.classes)) != list(reader.classes):
            raise MalformedError(
                "expected classes sorted, each once",
                where=f"{where}[{number}].classes",
                reason=Reason.SCHEMA_INVALID,
            )
    if len({key.raw for key in keys}) != len(keys):
        raise MalformedError(
            "expected a key of its own for each reader", where=where, reason=Reason.SCHEMA_INVALID
        )
    return keys


def require_retention(
    rules: tuple[Retention, ...], readers: tuple[Reader, ...], *, where: str
) -> None:
    """Refuse rules about what is not sealed, two about one class, or one that contradicts itself.

    Raises:
        MalformedError: with the rule.
    """
    sealed = {one for reader in readers for one in reader.classes}
    least_ms = max((rule.least_ms for rule in rules), default=0)
    names = [rule.data for rule in rules]
    for number, rule in enumerate(rules):
        if rule.data not in sealed or 0 < rule.most_ms < least_ms:
            raise MalformedError(
                "expected a class that a reader may read, and `most_ms` not below any `least_ms`",
                where=f"{where}[{number}]",
                reason=Reason.SCHEMA_INVALID,
            )
    if sorted(set(names)) != names:
        raise MalformedError(
            "expected classes sorted, each once", where=where, reason=Reason.SCHEMA_INVALID
        )
