# SPDX-License-Identifier: Apache-2.0
"""Proposals under their idempotency keys: a repeat is answered from what is recorded.

What had an effect is held in the store, in the same turn as the effect, so that a client that lost
its connection, or a gate that lost its power, never makes one proposal into two. What was refused
is remembered for a while only: deciding it again changes nothing.
Spec page: docs/spec/gate-protocol.md#idempotency
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from msgspec import Struct, structs

from authguard_r.audit.record import Record, Sealed, read_record, read_sealed
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.report import Report
from authguard_r.server.replayed_response import replayed_step
from authguard_r.store.transactions import Ledger, Transaction, read_held
from authguard_r.wire.disclosure import Disclosure, disclosed
from authguard_r.wire.gate_limits import LIMITS

_KIND = "proposal"


class ProposalAnswer(Struct, frozen=True, kw_only=True):
    """The results of a proposal so far.

    Args:
        evidence: digest of the planner's exact bytes.
        planned: steps of the plan.
        steps: what the planner sees of each step that was reached.
        on_refusal: what the enforcer did after a refusal.
    """

    evidence: Digest
    planned: int
    steps: tuple[dict[str, Any], ...]
    on_refusal: str | None = None


#: Numbers of a step's records in the log: its decision, its outcome (-1 while it has none).
Numbers = tuple[int, int]


class ProposalRecord(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is held of a proposal: where the log has it.

    Args:
        evidence: digest of the planner's exact bytes.
        planned: steps of the plan.
        steps: of each step that had an effect.
    """

    evidence: Digest
    planned: int
    steps: tuple[Numbers, ...]


class CommitRecorder:
    """Holds one step of a proposal in the turn of its decision and of its outcome.

    Args:
        client: whose proposal it is.
        key: its key.
        before: what is held of it without this step.
    """

    def __init__(self, client: Identifier, key: str, before: ProposalRecord) -> None:
        self._place = _place(client, key)
        self._before = before
        self.numbers: tuple[Numbers, ...] = ()

    def __call__(self, act: Transaction, report: Report, seq: int) -> None:
        """Hold the number of the record that this turn has just made (`running.Keep`)."""
        self.numbers = ((seq, -1),) if report.outcome is None else ((self._decided(), seq),)
        steps = (*self._before.steps, *self.numbers)
        act.put(_KIND, self._place, encode_fast(structs.replace(self._before, steps=steps)))

    def _decided(self) -> int:
        return self.numbers[0][0]


class ProposalRegistry:
    """What is recorded of proposals, by client and key.

    Args:
        ledger: where effects are held.
        disclosure: how much a planner sees.
    """

    def __init__(self, ledger: Ledger, disclosure: Disclosure) -> None:
        self._ledger = ledger
        self._disclosure = disclosure
        self._known: OrderedDict[str, ProposalAnswer] = OrderedDict()

    def recall(self, client: Identifier, key: str, evidence: Digest) -> ProposalAnswer | None:
        """Return the results of an earlier proposal under this key, None for a new one.

        Raises:
            RefusedError: another plan came under it (`KEY_REUSED`).
            StoreError: the store cannot be read, or does not hold what it says.
        """
        place = _place(client, key)
        known = self._known.get(place) or self._ledger.peek(lambda turn: self._told(turn, place))
        if known is not None:
            require_same_plan(known.evidence, evidence)
        return known

    def _told(self, turn: Turn, place: str) -> ProposalAnswer | None:
        """Return what is held under a key, read again from the log."""
        held = turn.get(_KIND, place)
        if held is None:
            return None
        kept = read_held(held, ProposalRecord, _KIND)
        steps = tuple(disclosed(self._step(turn, *n), self._disclosure) for n in kept.steps)
        return ProposalAnswer(evidence=kept.evidence, planned=kept.planned, steps=steps)

    def _step(self, turn: Turn, decided: int, ended: int) -> dict[str, Any]:
        decision, sealed = self._record(turn, decided)
        if ended < 0:
            return replayed_step(decision, sealed, None, {})
        return replayed_step(decision, sealed, *self._record(turn, ended))

    def _record(self, turn: Turn, number: int) -> tuple[Record, dict[str, Sealed]]:
        rows = turn.rows(number, 1)
        where = f"record {number}"
        if not rows:
            raise StoreError("the log has no such record", where=where, reason=Reason.STORE_CORRUPT)
        row = self._ledger.opened(rows[0])
        return read_record(row.record, where=where), read_sealed(row.sealed, where=where)

    def remember(self, client: Identifier, key: str, answered: ProposalAnswer) -> None:
        """Remember an answer for a while."""
        self._known[_place(client, key)] = answered
        if len(self._known) > LIMITS.remembered_answers:
            self._known.popitem(last=False)


def require_same_plan(known: Digest, evidence: Digest) -> None:
    """Require that a key names one plan only.

    Raises:
        RefusedError: another plan came under it (`KEY_REUSED`).
    """
    if known != evidence:
        raise RefusedError(
            "another plan came under this key; a new one needs a new key",
            reason=Reason.KEY_REUSED,
            where="proposal.key",
        )


def _place(client: Identifier, key: str) -> str:
    return f"{client} {key}"  # neither may hold a space
