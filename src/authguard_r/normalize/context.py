# SPDX-License-Identifier: Apache-2.0
"""What the planner could have seen: channel, label, and which places and things it mentions.

The label decides how far a planner's free choice is trusted. Mentions are evidence for people
(`influenced_by`), never authority: no decision rests on matching text.

Source: section "Provenance Labels", `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

import re
from typing import Any

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.provenance import Label, least_trusted

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


class Influence(Struct, frozen=True, kw_only=True):
    """One input that mentioned a value which a proposal then carried.

    Args:
        field: the action's field.
        value: the id that was mentioned and carried.
        channel: where the input came from.
        label: its label.
        evidence: digest of the input's text.
    """

    field: str
    value: str
    channel: str
    label: Label
    evidence: Digest


class _Input(Struct, frozen=True):
    channel: str
    label: Label
    evidence: Digest
    mentions: frozenset[str]


class ContextLedger:
    """Every input that reached the planner during one mission.

    Args:
        spellings: external spelling of each place and thing, with its id.
    """

    def __init__(self, spellings: dict[str, str]) -> None:
        self._inputs: list[_Input] = []
        self._ids = {name.casefold(): item for name, item in spellings.items()}
        words = sorted((re.escape(name) for name in self._ids), key=len, reverse=True)
        self._pattern = re.compile(rf"(?<!\w)(?:{'|'.join(words) or '(?!)'})(?!\w)")

    def add(self, channel: str, text: str) -> None:
        """Note one input; call it before the planner sees the text.

        Raises:
            MalformedError: a channel that nobody gave a label.
        """
        label = CHANNELS.get(channel)
        if label is None:
            raise MalformedError(
                f"expected a channel of {', '.join(sorted(CHANNELS))}, got `{channel[:40]}`",
                where="context.channel",
            )
        folded = " ".join(text.casefold().split())
        mentions = frozenset(self._ids[m.group()] for m in self._pattern.finditer(folded))
        evidence = digest(Tag.RAW, text.encode("utf-8", "surrogatepass"))
        self._inputs.append(_Input(channel, label, evidence, mentions))

    def base(self) -> Label:
        """Return the least trusted label of anything that the planner could have seen."""
        return least_trusted(frozenset(item.label for item in self._inputs))

    def influences(self, action: Action) -> tuple[Influence, ...]:
        """Return the inputs that mentioned a value of the action."""
        carried: list[tuple[str, Any]] = [
            ("object", action.object),
            ("destination", action.destination),
            *((f"route[{n}]", region) for n, region in enumerate(action.route)),
        ]
        return tuple(
            Influence(
                field=field,
                value=value,
                channel=item.channel,
                label=item.label,
                evidence=item.evidence,
            )
            for field, value in carried
            for item in self._inputs
            if value is not None and value in item.mentions
        )
