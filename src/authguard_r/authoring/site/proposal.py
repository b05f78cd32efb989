# SPDX-License-Identifier: Apache-2.0
"""What an import makes: a site that is sound as geometry and contains only what the file states.

A foreign file knows where things are, not who may go there. What it does not say is written as
`unreviewed`, as a weight that nothing lifts, or left empty, and listed; a site authority signs only
what a person has gone through. How-to: docs/howto/site.md#import
"""

from __future__ import annotations

import re
from decimal import ROUND_HALF_EVEN, Decimal
from typing import Any

import msgspec
import yaml
from msgspec import Struct

from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER, Identifier, is_identifier
from authguard_r.site.model import Site
from authguard_r.site.names import shown
from authguard_r.site.source import parse_site, require_sound

#: Grams of a thing whose mass is unknown: too heavy for any robot until a person weighs it.
UNKNOWN_MASS_G = 1_000_000_000
_FOREIGN = re.compile(r"[^a-z0-9_.:-]+")


class SiteProposal(Struct, frozen=True, kw_only=True):
    """A site made from a foreign file.

    Args:
        site: what the file says; sound, and without authority like any unsigned site.
        missing: what a person has to add or to look at, one line each.
    """

    site: Site
    missing: tuple[str, ...]


class _Dumper(yaml.SafeDumper):
    """A dumper that writes equal parts twice: the strict reader takes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - the library's signature
        return True


def to_yaml(proposal: SiteProposal, *, where: str) -> str:
    """Return the file that an author goes on with; reading it gives exactly the proposal's site.

    Args:
        proposal: the site and what it lacks, which goes into comments.
        where: the foreign file's name, for places in messages.

    Raises:
        MalformedError: the file would be longer than a site may be, or the site has faults.
    """
    require_sound(proposal.site, where=where)  # before it is written: a reader changes line breaks
    plain = {"schema": proposal.site.schema, **msgspec.to_builtins(proposal.site)}
    body = yaml.dump(
        plain, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True,
        width=100,
    )  # fmt: skip
    head = "".join(f"#   {line}\n" for line in proposal.missing)
    text = f"# Imported. Before the site authority signs this:\n{head}{body}"
    if len(text.encode()) > MAX_BYTES:
        raise MalformedError(f"expected a site of at most {MAX_BYTES} bytes", where=where)
    if parse_site(text, where=where) != proposal.site:
        raise RuntimeError("a site was written that reads as another")  # pragma: no cover
    return text


def identifier(name: str, *, where: str) -> Identifier:
    """Return the id of a foreign name: lower case, `-` for each character that no id has.

    Raises:
        MalformedError: nothing that an id can hold is left, or too much.
    """
    made = _FOREIGN.sub("-", name.lower()).strip("_.:-")
    if not is_identifier(made):
        raise MalformedError(
            f"expected a name that an id can be made of, got `{shown(name)}`", where=where
        )
    return made


def millimeters(meters: object, *, where: str) -> int:
    """Return a length in meters, as a person or a program wrote it, in whole millimeters.

    Rounded half to even, as positions are; the decimal that was written counts, not the binary
    number that stands nearest to it.

    Args:
        meters: an integer, a float or a decimal.
        where: its place, for messages.

    Raises:
        MalformedError: no number, or one that is on no site.
    """
    return int((exact(meters, where=where) * 1000).to_integral_value(ROUND_HALF_EVEN))


def exact(number: object, *, where: str) -> Decimal:
    """Return a number as the decimal that was written.

    Raises:
        MalformedError: no finite number, or one beyond any site.
    """
    if isinstance(number, bool) or not isinstance(number, int | float | Decimal):
        raise MalformedError(f"expected a number, got `{shown(str(number))}`", where=where)
    value = Decimal(repr(number) if isinstance(number, float) else number)
    if not value.is_finite() or abs(value) > MAX_INTEGER // 1_000_000:
        raise MalformedError("expected a number that fits into a site model", where=where)
    return value
