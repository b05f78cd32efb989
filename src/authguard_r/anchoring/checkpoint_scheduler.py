# SPDX-License-Identifier: Apache-2.0
"""When checkpoints are made, and that they are witnessed: beside decisions, never inside one.

Spec page: docs/spec/rollback.md#checkpoints
"""

from __future__ import annotations

from contextlib import suppress

from msgspec import Struct

from authguard_r.anchoring.checkpoints import Checkpoints, held_notes
from authguard_r.anchoring.evidence import BY_STORE, Discrepancy, Doubt
from authguard_r.anchoring.quorum import Quorum, WitnessPolicy
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Count, Positive, RobotId
from authguard_r.core.principals import Signer
from authguard_r.store.transactions import Ledger

#: The comparison at the start waits no longer for witnesses, in seconds; nor does the end.
START_S, END_S = 2.0, 2.0


class CheckpointPolicy(Struct, frozen=True, kw_only=True):
    """When checkpoints are made, and who witnesses them.

    Args:
        records: after so many records.
        every_ms: after so long, if anything is new.
        witnesses: whom they are shown to.
    """

    records: Positive = 256
    every_ms: Count = 60_000
    witnesses: WitnessPolicy = WitnessPolicy()


class CheckpointScheduler:
    """Makes the checkpoints of one store and has them witnessed.

    Args:
        ledger: the store.
        robot: whose it is.
        signer: the gate's own key; None makes no checkpoints and asks no witness.
        policy: when, and whom.
    """

    def __init__(
        self,
        ledger: Ledger,
        *,
        robot: RobotId,
        signer: Signer | None,
        policy: CheckpointPolicy = CheckpointPolicy(),  # noqa: B008 - frozen
    ) -> None:
        self._ledger = ledger
        self._policy = policy
        self._checkpoints = Checkpoints(ledger, robot=robot, signer=signer)
        self._quorum = Quorum(
            self._checkpoints, policy.witnesses, mono_ms=ledger.mono_ms, utc_ms=ledger.last_ms
        )
        self._due = True  # the first is made as soon as there is time
        self._at_ms = ledger.mono_ms()
        self._endings = ledger.endings

    def compare(self) -> Doubt | None:
        """Return whether the store is what its own newest checkpoint and tree say."""
        fits = self._checkpoints.fits()
        return None if fits else Doubt(Discrepancy.CHECKPOINT_DIFFERS, BY_STORE)

    def begin(self) -> Doubt | None:
        """Show the log to the witnesses before anything is served; they may take `START_S`.

        Raises:
            AuthGuardError: the store cannot be read or written; what waits for witnesses waits.
        """
        if not self._quorum.named:
            return None
        self._quorum.begin()
        self.make()
        return self._quorum.ask(START_S)

    def require(self) -> None:
        """Refuse while too few witnesses have confirmed this store since the start.

        Raises:
            EnvironmentFault: they have not.
        """
        self._quorum.require()

    def make(self) -> None:
        """Make a checkpoint of everything that is committed. Not inside a turn.

        Raises:
            AuthGuardError: it is not held, or the key cannot be used.
        """
        self._checkpoints.make()
        self._due, self._at_ms = False, self._ledger.mono_ms()

    def tick(self) -> Doubt | None:
        """Make a checkpoint if one is due, a page at a time, and see to the witnesses.

        Raises:
            AuthGuardError: the store cannot be read or written now.
        """
        self._due = self._ended() or self._due
        if self._is_due() and self._checkpoints.step():
            self._due, self._at_ms = False, self._ledger.mono_ms()
        return self._quorum.turn()

    def end(self) -> None:
        """Make a last checkpoint and show it to the witnesses; they may take `END_S`."""
        with suppress(AuthGuardError):
            self.make()
            self._quorum.ask(END_S if self._quorum.confirmed else 0.0)

    def accepted(self, why: Discrepancy) -> None:
        """Go on with a store that a person has accepted.

        Raises:
            AuthGuardError: nothing goes on.
        """
        if why is Discrepancy.CHECKPOINT_DIFFERS:
            self._checkpoints.restart()
        self._quorum.accept()
        self._due = True

    def silence(self) -> bool | None:
        """Return True when a silence of the witnesses begins, False when it ends, else None."""
        return self._quorum.silence(self.unwitnessed)

    @property
    def unwitnessed(self) -> int:
        """How many records too few witnesses have cosigned."""
        return self._ledger.peek(lambda turn: turn.head())[0] - self._quorum.witnessed

    def shown(self) -> dict[str, object]:
        """Return what `status` says."""
        notes = self._ledger.peek(held_notes)
        told: dict[str, object] = {"checkpoint": self._checkpoints.size, "notes": list(notes)}
        if self._quorum.named:
            told["witness"] = {**self._quorum.shown(), "unwitnessed": self.unwitnessed}
        return told

    def _is_due(self) -> bool:
        new = self._ledger.peek(lambda turn: turn.head())[0] - self._checkpoints.size
        late = self._ledger.mono_ms() - self._at_ms >= self._policy.every_ms
        return new > 0 and (self._due or late or new >= self._policy.records)

    def _ended(self) -> bool:
        """Return whether a mission has come to an end since this was last asked."""
        before, self._endings = self._endings, self._ledger.endings
        return self._endings != before
