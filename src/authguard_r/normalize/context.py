# SPDX-License-Identifier: Apache-2.0
"""What the planner could have seen: channel, label, and which places and things it mentions.

The label decides how far a planner's free choice is trusted. Mentions are evidence for people
(`influenced_by`), never authority: no decision rests on matching text.

Source: section "Provenance Labels", `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.provenance import TRUST, Label, least_trusted
from authguard_r.core.reasons import Reason
from authguard_r.normalize.mentions import How, Names, Opening
from authguard_r.normalize.numerals import read_tokens

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
#: Inputs, whatever their channel, that a name may be split over beside each channel's own last one.
WINDOW = 4
#: Inputs of one channel kept for one value: the first half and the last half of them.
KEPT = 8
#: Characters on either side of the border between two inputs that a split name may take up.
_SPAN = 64
_CHANNEL = re.compile(r"[a-z][a-z0-9_]{0,31}")


class Influence(Struct, frozen=True, kw_only=True):
    """One input that mentioned a value which a proposal then carried.

    Args:
        field: the action's field.
        value: the id that was mentioned and carried.
        channel: where the input came from.
        label: its label.
        evidence: digest of the input's text.
        how: how near the mention is to the site's spelling; `split` when it takes more inputs.
    """

    field: str
    value: str
    channel: str
    label: Label
    evidence: Digest
    how: How = How.EXACT


class _Input(Struct, frozen=True):
    channel: str
    label: Label
    evidence: Digest


class _Named(Struct, frozen=True):
    """One input that named a value, and how."""

    source: _Input
    how: How


class _Tail(Struct, frozen=True):
    """The end of one or more inputs in a row, which the next one may go on with.

    Args:
        text: their last characters.
        parts: each input with the place in `text` where it ends, in order.
        opening: the names that may begin there; None when none may, and then there is no text.
    """

    text: str = ""
    parts: tuple[tuple[_Input, int], ...] = ()
    opening: Opening | None = None

    def within(self, start: int) -> tuple[_Input, ...]:
        """Return the inputs that have a part of what begins at `start`."""
        return tuple(item for item, end in self.parts if end > start)


_NOTHING = _Tail()


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
        where = f"channels.{ascii(channel)[1:-1][:40]}"
        if _CHANNEL.fullmatch(channel) is None:
            raise MalformedError("expected a name of a-z, 0-9 and `_`", where=where)
        most = CHANNELS.get(channel, Label.MODEL)
        allowed = TRUST[TRUST.index(most) :]
        if word not in allowed:
            expected = ", ".join(allowed)
            raise MalformedError(
                f"expected {expected}, got `{ascii(word)[1:-1][:40]}`",
                where=where,
                reason=Reason.VALUE_INVALID,
            )
        labels[channel] = Label(word)
    return labels


class ContextLedger:
    """Every input that reached the planner during one mission.

    All work on a text is done when it is added; asking costs no more than the answer is long.

    Args:
        spellings: external spelling of each place and thing, with its id.
        channels: a site's own channels (`channel_labels`).

    Raises:
        MalformedError: a channel that may not have its label.
    """

    def __init__(
        self, spellings: dict[str, str], *, channels: Mapping[str, str] | None = None
    ) -> None:
        self._labels = channel_labels(channels or {})
        self._spellings = spellings
        self._names: Names | None = None
        self._base = Label.MODEL
        self._named: dict[str, tuple[_Named, ...]] = {}
        self._answers: dict[tuple[str, str], tuple[Influence, ...]] = {}
        self._recent: deque[_Tail] = deque(maxlen=WINDOW)
        self._last: dict[str, _Tail] = {}

    def add(self, channel: str, text: str) -> None:
        """Note one input; call it before the planner sees the text.

        Raises:
            MalformedError: a channel that nobody gave a label.
        """
        label = self._labels.get(channel)
        if label is None:
            raise MalformedError(
                f"expected a channel of {', '.join(sorted(self._labels))}, got `{channel[:40]}`",
                where="context.channel",
            )
        self._base = least_trusted(frozenset({self._base, label}))
        self._answers.clear()
        if self._names is None:  # most missions never hear a word: made when there is one
            self._names = Names(self._spellings)
        evidence = digest(Tag.RAW, text.encode("utf-8", "surrogatepass"))
        noted = _Input(channel, label, evidence)
        for mention in self._names.find(text):
            self._note(mention.ids, noted, mention.how)
        self._look_across(self._names, noted, text)

    def base(self) -> Label:
        """Return the least trusted label of anything that the planner could have seen."""
        return self._base

    def influences(self, action: Action) -> tuple[Influence, ...]:
        """Return the inputs that mentioned a value of the action, field by field."""
        carried: list[tuple[str, Any]] = [
            ("object", action.object),
            ("source", action.source),
            ("destination", action.destination),
            *((f"route[{n}]", region) for n, region in enumerate(action.route)),
        ]
        return tuple(
            influence
            for field, value in carried
            if value in self._named
            for influence in self._influences(field, value)
        )

    def _influences(self, field: str, value: str) -> tuple[Influence, ...]:
        """Return what influenced one field, worked out once for as long as nothing is added."""
        known = self._answers.get((field, value))
        if known is None:
            known = self._answers[(field, value)] = tuple(
                Influence(
                    field=field,
                    value=value,
                    channel=named.source.channel,
                    label=named.source.label,
                    evidence=named.source.evidence,
                    how=named.how,
                )
                for named in self._named[value]
            )
        return known

    def _note(self, ids: tuple[str, ...], source: _Input, how: How) -> None:
        """Keep that an input named these; a flood of others does not push the first ones out."""
        for item in ids:
            named = self._named.get(item, ())
            if any(known.source == source for known in named):
                continue
            mine = [known for known in named if known.source.channel == source.channel]
            kept = named
            if len(mine) >= KEPT:
                kept = tuple(known for known in named if known is not mine[KEPT // 2])
            self._named[item] = (*kept, _Named(source, how))

    def _look_across(self, names: Names, source: _Input, text: str) -> None:
        """Note names that begin in an earlier input and end in this one; keep this one's end."""
        head = _head(text)
        words = read_tokens(head)
        before: dict[str, list[_Tail]] = {}
        for tail in dict.fromkeys((*self._last.values(), *self._recent)):
            if words and tail.opening is not None and names.goes_on(tail.opening, words[0]):
                before.setdefault(tail.text, []).append(tail)
        for begun, tails in before.items():
            for mention in names.find(f"{begun}\n{head}"):
                if mention.start < len(begun) < mention.end - 1:
                    parts = [part for tail in tails for part in tail.within(mention.start)]
                    for part in (*parts, source):
                        self._note(mention.ids, part, How.SPLIT)
        chain = self._recent[-1] if self._recent else _NOTHING
        own = self._last.get(source.channel, _NOTHING)
        self._recent.append(_extended(names, chain, source, text))
        self._last[source.channel] = (
            self._recent[-1] if own == chain else _extended(names, own, source, text)
        )


def _head(text: str) -> str:
    """Return the beginning of a text, without a word that is cut."""
    end = min(len(text), _SPAN)
    while 0 < end < len(text) and text[end].isalnum() and text[end - 1].isalnum():
        end -= 1
    return text[:end]


def _extended(names: Names, tail: _Tail, source: _Input, text: str) -> _Tail:
    """Return the end of a row of inputs after one more, from where the earliest name may begin."""
    whole = f"{tail.text}\n{text}" if tail.text else text
    cut = max(0, len(whole) - _SPAN)
    while 0 < cut < len(whole) and whole[cut - 1].isalnum() and whole[cut].isalnum():
        cut += 1
    opening = names.opening(whole[cut:])
    if opening is None:
        return _NOTHING
    cut += opening.start
    end = whole[cut:]
    parts = tuple((item, at - cut) for item, at in tail.parts if at > cut)
    return _Tail(end, (*parts, (source, len(end))), opening)
