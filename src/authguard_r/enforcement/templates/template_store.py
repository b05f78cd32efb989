# SPDX-License-Identifier: Apache-2.0
"""What a gate keeps of templates: tokens, which are verified again, and what was used.

Spec page: docs/spec/template.md#at-the-gate
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.identifiers import Count, Digest
from authguard_r.core.mission import Rate
from authguard_r.core.quantities import Now

#: How the bytes of a pair begin: a mission's token begins with `{"endorsements"`.
_PAIR = b'{"instance":'


class KeptTemplate(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """A template that was taken in, held under its digest for good.

    Args:
        token: the signed template.
        used: missions made of it so far.
        recent: monotonic times of the last of them, as many as its window can count.
        withdrawn: no mission is made of it any more, and none of it authorizes anything.
    """

    token: str
    used: Count = 0
    recent: tuple[int, ...] = ()
    withdrawn: bool = False

    def in_window(self, rate: Rate, now: Now) -> tuple[int, ...]:
        """Return the times that the rate's window still counts."""
        return tuple(at for at in self.recent if at > now.mono_ms - rate.per_ms)


class TemplateStanding(Struct, frozen=True, kw_only=True):
    """How far a template is used on this robot.

    Args:
        template: its name.
        digest: of its bytes.
        instances: most missions that are made of it.
        used: missions made of it so far.
        withdrawn: none is made any more.
    """

    template: str
    digest: Digest
    instances: int
    used: int
    withdrawn: bool


class InstancePair(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a mission made of a template is verified from: held where a mission's token is."""

    instance: str
    template: str


def is_pair(held: bytes) -> bool:
    """True when what is held under a mission's digest says that it is a pair."""
    return held.startswith(_PAIR)
