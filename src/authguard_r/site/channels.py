# SPDX-License-Identifier: Apache-2.0
"""The ways on which a text reaches the planner, each with the label that its texts have.

A site may name channels of its own and trust a shipped one less. It can trust none more: text is
not a signature, whatever author it names.

Source: section "Provenance Labels", `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from authguard_r.core.errors import MalformedError
from authguard_r.core.provenance import TRUST, Label
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site

#: Text is not a signature: even the operator's own chat is no more than the model's.
CHANNELS: dict[str, Label] = {
    "operator": Label.MODEL,
    "supervisor": Label.MODEL,
    "estimator": Label.MODEL,
    "user": Label.MODEL,
    "chat": Label.MODEL,
    "tool": Label.MODEL,
    "model": Label.MODEL,
    "memory": Label.MEMORY,
    "retrieval": Label.RETRIEVAL,
    "document": Label.RETRIEVAL,
    "web": Label.RETRIEVAL,
    "audio": Label.AUDIO,
    "speech": Label.AUDIO,
    "camera": Label.CAMERA,
    "ocr": Label.CAMERA,
}
_CHANNEL = re.compile(r"[a-z][a-z0-9_]{0,31}")


def channel_labels(added: Mapping[str, str]) -> dict[str, Label]:
    """Return the label of every channel: the shipped table with a site's own channels.

    Args:
        added: label by channel name, as the site's people wrote it down. A shipped channel may be
            trusted less than the table has it (a `tool` that reads the web is `retrieval`).

    Raises:
        MalformedError: a name that is no channel name, an unknown label, or a label that is more
            than unsigned text can have: no text is an operator's, a supervisor's or a sensor's.
    """
    labels = dict(CHANNELS)
    for channel, word in added.items():
        _require(channel, word)
        labels[channel] = Label(word)
    return labels


def channel_faults(site: Site) -> Iterator[tuple[str, str]]:
    """Yield the channels of a site that it may not have, or not with that label."""
    for channel, word in site.channels.items():
        try:
            _require(channel, word)
        except MalformedError as error:
            yield error.where, error.message


def _require(channel: str, word: str) -> None:
    where = f"channels.{ascii(channel)[1:-1][:40]}"
    if _CHANNEL.fullmatch(channel) is None:
        raise MalformedError("expected a name of a-z, 0-9 and `_`", where=where)
    most = CHANNELS.get(channel, Label.MODEL)
    allowed = TRUST[TRUST.index(most) :]
    if word not in allowed:
        expected = ", ".join(allowed)
        raise MalformedError(
            f"expected {expected}, got `{ascii(str(word))[1:-1][:40]}`",
            where=where,
            reason=Reason.VALUE_INVALID,
        )
