# SPDX-License-Identifier: Apache-2.0
"""Reading a site model: strict YAML, the words it takes over, every fault with its place.

How-to: docs/howto/site.md
"""

from __future__ import annotations

from pathlib import Path

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import is_identifier
from authguard_r.site.check import faults
from authguard_r.site.model import Site
from authguard_r.site.names import shown
from authguard_r.site.sources import require_source_words
from authguard_r.site.strict import as_text, convert, read_text, read_yaml
from authguard_r.site.words import with_words

__all__ = [
    "as_text",
    "convert",
    "parse_site",
    "read_site",
    "read_text",
    "read_yaml",
    "require_sound",
]

#: The parts of a site that hold things by id.
_GROUPS = ("regions", "objects", "robots", "vocabulary", "people")


def parse_site(text: str, *, where: str) -> Site:
    """Return the site model in a YAML text, sound or not.

    Args:
        text: what an author wrote; trusted only once the site authority has signed it.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: not a site model, or `words` that the standard vocabulary does not have.
    """
    return site_of(with_words(read_yaml(text, where=where), where=where), where=where)


def site_of(data: object, *, where: str) -> Site:
    """Return plain data as a site model, sound or not.

    Raises:
        MalformedError: not a site model; says the first fault alone.
    """
    for group in _GROUPS:
        _require_ids(data, group, where=where)
    if isinstance(data, dict) and "sources" in data:
        require_source_words(data["sources"], where=f"{where}:sources")
    return convert(data, Site, where=where)


def _require_ids(data: object, group: str, *, where: str) -> None:
    """Require that the names in a group are ids; raise for the first one that is none."""
    things = data.get(group) if isinstance(data, dict) else None
    for item in things if isinstance(things, dict) else ():
        if not isinstance(item, str) or not is_identifier(item):
            raise MalformedError(
                f"expected an id of a-z, 0-9 and `_.:-`, got `{shown(str(item))}`",
                where=f"{where}:{group}",
            )


def require_sound(site: Site, *, where: str) -> Site:
    """Return the site itself once it has no fault.

    Raises:
        MalformedError: it has faults; the first is named, the others counted.
    """
    found = faults(site)
    if found:
        more = f" (and {len(found) - 1} more: `authguard site check`)" if len(found) > 1 else ""
        raise MalformedError(found[0].message + more, where=f"{where}:{found[0].where}")
    return site


def read_site(path: Path) -> Site:
    """Return the site model in a YAML file once it has no fault.

    Raises:
        EnvironmentFault: the file cannot be read.
        MalformedError: not a site model, or one with faults; the first is named.
    """
    return require_sound(parse_site(read_text(path), where=str(path)), where=str(path))
