# SPDX-License-Identifier: Apache-2.0
"""The words a person uses for places and things, to the ids that are signed.

One spelling, one thing: a name is looked up exactly as the site spells it. Nothing is taken
because it is close; what is close is only shown. Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import NoReturn

from msgspec import Struct

from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site

OBJECT, REGION = "object", "region"
#: A name longer than this is compared with nothing and shown cut.
_LONGEST = 80


class SiteNames(Struct, frozen=True):
    """Every spelling that the site knows: by kind of thing, the ids that bear it."""

    known: dict[str, dict[str, tuple[str, ...]]]

    def resolve(
        self, text: str, kind: str, *, where: str, questions: CompileQuestions
    ) -> str | None:
        """Return the one id that the text is a spelling of, or None once it was asked about.

        Args:
            text: an id or a name, from the draft.
            kind: what is meant: `object` or `region`.
            where: the draft path.
            questions: gets a question when several things bear the name.

        Raises:
            MalformedError: the site has no such thing; close spellings are named, none is taken.
        """
        return self._one(text, self.known[kind].get(text, ()), kind, where, questions)

    def value(self, text: str, *, where: str, questions: CompileQuestions) -> str | None:
        """Return what a condition compares with: an id as it stands, or what a name stands for.

        Raises:
            MalformedError: neither an id nor a name of the site.
        """
        if is_identifier(text):
            return text
        found = tuple(item for known in self.known.values() for item in known.get(text, ()))
        return self._one(text, found, "object or region", where, questions)

    def _one(
        self, text: str, found: tuple[str, ...], kind: str, where: str, questions: CompileQuestions
    ) -> str | None:
        if not found:
            self._refuse(text, kind, where)
        if len(found) > 1:
            questions.ask(f"Which {kind} is meant by `{text}`?", where, sorted(found))
            return None
        return found[0]

    def _refuse(self, text: str, kind: str, where: str) -> NoReturn:
        spelled = {s for k, names in self.known.items() if k in kind for s in names}
        raise unknown(text, kind, spelled, where=where)


def unknown(text: str, kind: str, spelled: Iterable[str], *, where: str) -> MalformedError:
    """Return the refusal of a word that the site does not have, with what is close to it.

    Args:
        text: the word, from the draft.
        kind: what was meant.
        spelled: the words that the site has.
        where: the draft path.
    """
    near = get_close_matches(text, sorted(spelled), 3) if len(text) <= _LONGEST else []
    close = f"; close to it: {', '.join(f'`{name}`' for name in sorted(near))}" if near else ""
    message = f"the site has no {kind} `{text[:_LONGEST]}`{close}"
    return MalformedError(message, where=where, reason=Reason.NAME_UNKNOWN)


def names_of(site: Site) -> SiteNames:
    """Return every spelling of the site's objects and regions."""
    objects: dict[str, list[str]] = {}
    regions: dict[str, list[str]] = {}
    for item, thing in site.objects.items():
        for name in {item, *thing.names}:
            objects.setdefault(name, []).append(item)
    for region, model in site.regions.items():
        for name in {region, *model.names}:
            regions.setdefault(name, []).append(region)
    return SiteNames(
        {
            OBJECT: {name: tuple(items) for name, items in objects.items()},
            REGION: {name: tuple(items) for name, items in regions.items()},
        }
    )
