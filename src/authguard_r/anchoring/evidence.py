# SPDX-License-Identifier: Apache-2.0
"""What a place outside of a store says of it: a counter, a witness, its own signed checkpoint.

Spec page: docs/spec/rollback.md#at-the-start
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

#: Says of a doubt that it is the counter's, or the store's own.
BY_COUNTER, BY_STORE = "counter", "store"


class Discrepancy(StrEnum):
    """What does not fit between a store and what is kept outside of it."""

    BEHIND = "behind"
    REPLACED = "replaced"
    FORKED = "forked"
    CHECKPOINT_DIFFERS = "checkpoint_differs"
    COUNTER_MISSING = "counter_missing"
    COUNTER_BEHIND = "counter_behind"
    COUNTER_FOREIGN = "counter_foreign"
    COUNTER_UNREADABLE = "counter_unreadable"
    COUNTER_NOT_NAMED = "counter_not_named"


SAID = {
    Discrepancy.BEHIND: "the log has fewer records than were counted: an older copy was restored",
    Discrepancy.REPLACED: "another store was counted: this one is new, or not this robot's last",
    Discrepancy.FORKED: "the log is not the one that was counted: a copy of it went on elsewhere",
    Discrepancy.CHECKPOINT_DIFFERS: "the log is not the one of its own checkpoint: it was changed",
    Discrepancy.COUNTER_MISSING: "the store was counted, and the counter is gone",
    Discrepancy.COUNTER_BEHIND: "the counter is older than the store knows: it was rolled back",
    Discrepancy.COUNTER_FOREIGN: "the counter is damaged, or not written by this robot's gate",
    Discrepancy.COUNTER_UNREADABLE: "the counter cannot be read",
    Discrepancy.COUNTER_NOT_NAMED: "the store was counted, and no counter was named",
}


class Doubt(Struct, frozen=True):
    """Why nothing goes on with a store.

    Args:
        why: what does not fit.
        by: who says so: `counter`, `store`, or a witness's name.
        size: how many records that place knows of; None when it does not say.
    """

    why: Discrepancy
    by: str
    size: int | None = None
