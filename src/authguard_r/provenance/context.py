# SPDX-License-Identifier: Apache-2.0
"""What the planner could have seen: channel, label, and which places and things it mentions.

The label decides how far a planner's free choice is trusted. Mentions are evidence for people
(`influenced_by`), never authority: no decision rests on matching text.

Source: section "Provenance Labels", `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.provenance import Label, least_trusted
from authguard_r.core.reasons import Reason
from authguard_r.provenance.mentions import MentionMatch, MentionNames, NameStart
from authguard_r.provenance.numerals import read_tokens
from authguard_r.site.channels import CHANNELS, channel_labels

__all__ = [
    "CHANNELS",
    "KEPT",
    "MAX_INPUT",
    "WINDOW",
    "ContextLedger",
    "Influence",
    "channel_labels",
]

#: Inputs of all channels over which a name may be split, beside each channel's own last one.
WINDOW = 4
#: Inputs of one channel kept for one value: the first half and the last half of them.
KEPT = 8
#: Most bytes (UTF-8) of one input that is looked through; 0.6 s for the worst of them.
MAX_INPUT = 128 * 1024
#: Characters on either side of the border between two inputs that a split name may take up.
_SPAN = 64


class Influence(Struct, frozen=True, kw_only=True):
    """One input that mentioned a value which a proposal then carried.

    Args:
        field: the action's field.
        value: the id that was mentioned and carried.
        channel: where the input came from.
        label: its label.
        evidence: digest of the input's text.
        how: how near the mention is to the site's spelling; `split` when it takes more inputs,
            `unread` when the input was too long to be looked through and may have mentioned it.
    """

    field: str
    value: str
    channel: str
    label: Label
    evidence: Digest
    how: MentionMatch = MentionMatch.EXACT


class _Input(Struct, frozen=True):
    channel: str
    label: Label
    evidence: Digest


class _NamedInput(Struct, frozen=True):
    """One input that named a value, and how."""

    source: _Input
    how: MentionMatch


class _Tail(Struct, frozen=True):
    """The end of one or more inputs in a row, which the next one may go on with.

    Args:
        text: their last characters.
        parts: each input with the place in `text` where it ends, in order.
        opening: the names that may begin there; None when none may, and then there is no text.
    """

    text: str = ""
    parts: tuple[tuple[_Input, int], ...] = ()
    opening: NameStart | None = None

    def within(self, start: int) -> tuple[_Input, ...]:
        """Return the inputs that have a part of what begins at `start`."""
        return tuple(item for item, end in self.parts if end > start)


_NOTHING = _Tail()


class ContextLedger:
    """Every input that reached the planner during one mission.

    All work on a text is done when it is added; asking costs no more than the answer is long.

    Args:
        spellings: external spelling of each place and thing, with its id; or the same made ready
            (`MentionNames`), for a caller with many ledgers of one site.
        channels: a site's own channels (`channel_labels`).

    Raises:
        MalformedError: a channel that may not have its label.
    """

    def __init__(
        self, spellings: dict[str, str] | MentionNames, *, channels: Mapping[str, str] | None = None
    ) -> None:
        self._labels = channel_labels(channels or {})
        self._names: dict[str, str] | MentionNames = spellings
        self._base = Label.MODEL
        self._named: dict[str, tuple[_NamedInput, ...]] = {}
        self._unread: tuple[_NamedInput, ...] = ()
        self._answers: dict[tuple[str, str], tuple[Influence, ...]] = {}
        self._recent: deque[_Tail] = deque(maxlen=WINDOW)
        self._last: dict[str, _Tail] = {}

    def add(self, channel: str, text: str) -> None:
        """Note one input; call it before the planner sees the text.

        Raises:
            MalformedError: a channel without a label, nothing is noted; or a text of more than
                `MAX_INPUT` bytes (`INPUT_TOO_LARGE`). That one is not looked through, but its label
                counts and `influences` names it as `unread` for every value, so that a caller who
                goes on all the same has lowered the base. A long text can be added in parts
                instead: names over their borders are found.
        """
        label = self._labels.get(channel)
        if label is None:
            raise MalformedError(
                f"expected a channel of {', '.join(sorted(self._labels))}, got `{channel[:40]}`",
                where="context.channel",
            )
        self._base = least_trusted(frozenset({self._base, label}))
        self._answers.clear()
        data = text.encode("utf-8", "surrogatepass")
        noted = _Input(channel, label, digest(Tag.RAW, data))
        if len(data) > MAX_INPUT:
            self._unread = _kept(self._unread, _NamedInput(noted, MentionMatch.UNREAD))
            raise MalformedError(
                f"expected a text of at most {MAX_INPUT} bytes, got {len(data)}",
                where="context.text",
                reason=Reason.INPUT_TOO_LARGE,
            )
        names = self._names
        if not isinstance(
            names, MentionNames
        ):  # most missions never hear a word: made when there is one
            names = self._names = MentionNames(names)
        for mention in names.find(text):
            self._note(mention.ids, noted, mention.how)
        self._look_across(names, noted, text)

    def base(self) -> Label:
        """Return the least trusted label of anything that the planner could have seen."""
        return self._base

    def influences(self, action: Action) -> tuple[Influence, ...]:
        """Return the inputs that mentioned a value of the action, or may have, field by field."""
        carried: list[tuple[str, Any]] = [
            ("object", action.object),
            ("source", action.source),
            ("destination", action.destination),
            *((f"route[{n}]", region) for n, region in enumerate(action.route)),
        ]
        return tuple(
            influence
            for field, value in carried
            if value in self._named or (value is not None and self._unread)
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
                for named in (*self._named.get(value, ()), *self._unread)
            )
        return known

    def _note(self, ids: tuple[str, ...], source: _Input, how: MentionMatch) -> None:
        """Keep that an input named these; a flood of others does not push the first ones out."""
        for item in ids:
            self._named[item] = _kept(self._named.get(item, ()), _NamedInput(source, how))

    def _look_across(self, names: MentionNames, source: _Input, text: str) -> None:
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
                        self._note(mention.ids, part, MentionMatch.SPLIT)
        chain = self._recent[-1] if self._recent else _NOTHING
        own = self._last.get(source.channel, _NOTHING)
        self._recent.append(_extended(names, chain, source, text))
        self._last[source.channel] = (
            self._recent[-1] if own == chain else _extended(names, own, source, text)
        )


def _kept(named: tuple[_NamedInput, ...], new: _NamedInput) -> tuple[_NamedInput, ...]:
    """Return the inputs to keep after one more: of each channel the first ones and the last."""
    if any(known.source == new.source for known in named):
        return named
    mine = [known for known in named if known.source.channel == new.source.channel]
    left = [known for known in named if len(mine) < KEPT or known is not mine[KEPT // 2]]
    return (*left, new)


def _head(text: str) -> str:
    """Return the beginning of a text, without a word that is cut."""
    end = min(len(text), _SPAN)
    while 0 < end < len(text) and text[end].isalnum() and text[end - 1].isalnum():
        end -= 1
    return text[:end]


def _extended(names: MentionNames, tail: _Tail, source: _Input, text: str) -> _Tail:
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
