# SPDX-License-Identifier: Apache-2.0
"""What a client of a gate requires of it, from the files that the client was started with."""

from __future__ import annotations

from authguard_r.client.handshake import Speaks
from authguard_r.normalize.binding import Binding, binding_digest
from authguard_r.site.model import Site, site_digest


def words_of(site: Site, binding: Binding) -> Speaks:
    """Return what a gate has to speak whose releases are rebuilt with this site and binding."""
    return Speaks(site=site_digest(site), binding=binding_digest(binding))
