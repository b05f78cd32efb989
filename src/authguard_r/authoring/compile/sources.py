# SPDX-License-Identifier: Apache-2.0
"""Source sets, weights of fields and retention, as people write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from authguard_r.audit.deviation import Weights
from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.core.checks.provenance import wider_sources
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.mission import DataClass, ProtectedField
from authguard_r.core.provenance import WIDEST, Label, SourceField, allowed_of
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site
from authguard_r.site.sources import require_source_words, require_word

_MS = "ms"
#: So many digits at least no whole number of the encoding has.
_DIGITS = 17


def build_sources(given: Mapping[str, tuple[str, ...]], site: Site) -> dict[str, list[str]]:
    """Return AllowedSrc(f) of a draft, sorted.

    Raises:
        MalformedError: no field or no label of that name, or a set wider than the site's.
    """
    require_source_words(dict(given), where="sources")
    signed = {SourceField(field): tuple(map(Label, labels)) for field, labels in given.items()}
    for field in wider_sources(allowed_of(signed), allowed_of(site.sources)):
        allowed = ", ".join(site.sources.get(field, sorted(WIDEST[field])))
        text = f"expected labels that the site allows: {allowed}"
        raise MalformedError(text, where=f"sources.{field}", reason=Reason.PROVENANCE_DENIED)
    return {field: sorted(set(labels)) for field, labels in given.items()}


def build_retention(
    given: Mapping[str, Quantity], asked: CompileQuestions
) -> dict[str, int | None]:
    """Return how long the sealed fields of each class are kept, in milliseconds.

    Raises:
        MalformedError: no class of that name.
    """
    for data in given:
        require_word(data, DataClass, f"retention.{data}")
    kept = {
        data: asked.integer(length, _MS, field=f"retention.{data}")
        for data, length in given.items()
    }
    for data, length in kept.items():
        if length is not None and length < 1:
            text = "expected a time above zero, such as `720 h`"
            raise MalformedError(text, where=f"retention.{data}", reason=Reason.SCHEMA_INVALID)
    return kept


def read_weights(given: Mapping[str, object], *, where: str) -> Weights:
    """Return w_j as a person wrote them, by the name of the field.

    Raises:
        MalformedError: with the place: no protected field, or no whole number above zero.
    """
    for name, weight in given.items():
        require_word(name, ProtectedField, where)
        if type(weight) is not int or not 0 < weight <= MAX_INTEGER:
            text = f"expected a whole number above zero, got `{weight}`"
            raise MalformedError(text, where=f"{where}.{name}", reason=Reason.VALUE_INVALID)
    return {ProtectedField(name): weight for name, weight in given.items() if type(weight) is int}


def given_weights(texts: Iterable[str], *, where: str) -> Weights:
    """Return w_j as options on a command line write them, `FIELD=N` each.

    Raises:
        MalformedError: as `read_weights`.
    """
    given: dict[str, object] = {}
    for text in texts:
        name, equals, number = text.partition("=")
        if not equals or name in given:
            fault = f"expected FIELD=N, each field once, got `{text[:80]}`"
            raise MalformedError(fault, where=where, reason=Reason.VALUE_INVALID)
        is_whole = number.isascii() and number.isdecimal() and len(number) < _DIGITS
        given[name] = int(number) if is_whole else number
    return read_weights(given, where=where)
