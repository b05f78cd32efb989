# SPDX-License-Identifier: Apache-2.0
"""Source sets as people write them, in a site or in a draft: each word is held to its vocabulary.

Spec page: docs/spec/provenance.md#source-sets
"""

from __future__ import annotations

from enum import StrEnum

from authguard_r.core.errors import MalformedError
from authguard_r.core.provenance import WIDEST, Label, SourceField
from authguard_r.core.reasons import Reason


def require_source_words(given: object, *, where: str) -> None:
    """Require fields and labels that there are, and for each field some labels that may set it.

    Args:
        given: plain data, `{field: [label, ...]}`.
        where: the place of it.

    Raises:
        MalformedError: with the place of the first that is wrong, and what is allowed there.
    """
    if not isinstance(given, dict):
        raise MalformedError("expected `{field: [label, ...]}`", where=where)
    for name, labels in given.items():
        place = f"{where}.{name}"
        field = SourceField(require_word(name, SourceField, place))
        if not isinstance(labels, list | tuple) or not labels:
            text = f"expected a list of at least one of {', '.join(sorted(WIDEST[field]))}"
            raise MalformedError(text, where=place, reason=Reason.SCHEMA_INVALID)
        for number, word in enumerate(labels):
            label = Label(require_word(word, Label, f"{place}[{number}]"))
            if label not in WIDEST[field]:
                allowed = " or ".join(sorted(WIDEST[field]))
                text = f"`{name}` can be set by {allowed} only, got `{label}`"
                raise MalformedError(text, where=place, reason=Reason.SCHEMA_INVALID)


def require_word(word: object, known: type[StrEnum], where: str) -> str:
    """Return a word of a closed vocabulary.

    Raises:
        MalformedError: `NAME_UNKNOWN`, with every word that there is.
    """
    if not isinstance(word, str) or word not in set(map(str, known)):
        text = f"expected one of {', '.join(known)}, got `{word}`"
        raise MalformedError(text, where=where, reason=Reason.NAME_UNKNOWN)
    return word
