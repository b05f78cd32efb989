# SPDX-License-Identifier: Apache-2.0
"""What a store's witnesses have confirmed, and what they say against it.

One checkpoint is sent out at a time, the newest when the round begins. A round is over when enough
witnesses have cosigned it or all have answered. Everything here is called by the one thread that
holds the store; only bytes leave it. Spec page: docs/spec/rollback.md#witnesses
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import StrEnum

from msgspec import Struct

from authguard_r.anchoring.checkpoints import WITNESSED, Checkpoints
from authguard_r.anchoring.evidence import Discrepancy, Doubt
from authguard_r.anchoring.places import WitnessPlace, require_place
from authguard_r.anchoring.witnesses import (
    SIZE_TYPE,
    Courier,
    WitnessReply,
    cosignature,
    cosigned,
    request,
)
from authguard_r.audit.checkpoint import read_checkpoint, read_size
from authguard_r.audit.note import Note
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Count
from authguard_r.core.reasons import Reason
from authguard_r.wire.gate_limits import LIMITS

_OK, _CONFLICT, _UNPROCESSABLE = 200, 409, 422


class Stand(StrEnum):
    """How a gate stands with one witness."""

    UNASKED = "unasked"
    COSIGNED = "cosigned"
    UNREACHABLE = "unreachable"
    REFUSES = "refuses"
    AHEAD = "ahead"
    CONTRADICTS = "contradicts"


_DOUBTS = {Stand.AHEAD: Discrepancy.BEHIND, Stand.CONTRADICTS: Discrepancy.FORKED}


class WitnessPolicy(Struct, frozen=True, kw_only=True):
    """Whom a gate asks, and how many of them have to agree.

    Args:
        places: the witnesses.
        quorum: so many cosignatures make a checkpoint `witnessed`.
        silence_ms: nothing was witnessed for this long, though there is something: an alert; 0:
            none.
    """

    places: tuple[WitnessPlace, ...] = ()
    quorum: Count = 0
    silence_ms: Count = 0


class _Witness:
    """One witness: what is known of it."""

    def __init__(self, place: WitnessPlace) -> None:
        self.key = require_place(place, where="witness")
        self.courier = Courier(place.url)
        self.stand = Stand.UNASKED
        self.size = 0  # what it cosigned last, as far as we know
        self.done = ""  # the text that it cosigned last
        self.confirmed = False
        self.muted = False
        self.sent: Note | None = None
        self.old = 0
        self._told = 0
        self._again_ms = 0
        self._pause_ms = LIMITS.witness_retry_ms

    def wants(self, text: str, now_ms: int) -> bool:
        """Return whether it is to be asked about this checkpoint now."""
        return self.sent is None and self.done != text and now_ms >= self._again_ms

    def send(self, note: Note, old: int, proof: tuple[bytes, ...]) -> None:
        """Ask it for a cosignature; `old` is the size that it presumably has."""
        self.sent, self.old = note, old
        self.courier.send(request(old, proof, note))

    def told(self) -> bool:
        """Count a size that the witness sent; False when these were too many in a row."""
        self._told += 1
        return self._told <= LIMITS.witness_sizes

    def settled(self, stand: Stand) -> None:
        """Note how an exchange ended."""
        self.stand, self.sent, self._told = stand, None, 0

    def failed(self, stand: Stand, now_ms: int) -> None:
        """Leave it alone for a while, each time for longer."""
        self.settled(stand)
        self._again_ms = now_ms + self._pause_ms
        self._pause_ms = min(2 * self._pause_ms, LIMITS.witness_most_retry_ms)

    def agreed(self, note: Note, size: int) -> None:
        """Note that it cosigned."""
        self.settled(Stand.COSIGNED)
        self.size, self.done, self.confirmed, self.muted = size, note.text, True, False
        self._again_ms, self._pause_ms = 0, LIMITS.witness_retry_ms

    def anew(self) -> None:
        """Ask it from the beginning, and raise no doubt that there is already."""
        self.muted = self.muted or self.stand in _DOUBTS
        self.size, self.done, self._again_ms = 0, "", 0


class Quorum:
    """The witnesses of one store.

    Args:
        checkpoints: what they are asked about.
        policy: who they are.
        mono_ms: the monotonic clock.
        utc_ms: trusted time, for what is shown.
    """

    def __init__(
        self,
        checkpoints: Checkpoints,
        policy: WitnessPolicy,
        *,
        mono_ms: Callable[[], int],
        utc_ms: Callable[[], int],
    ) -> None:
        self._checkpoints = checkpoints
        self._policy = policy
        self._mono_ms, self._utc_ms = mono_ms, utc_ms
        self._witnesses = tuple(_Witness(place) for place in policy.places)
        self._note: Note | None = None  # what goes round, with the cosignatures that came
        self._since_ms = mono_ms()
        self._silent = False
        #: The newest number of records that enough witnesses have cosigned, and when, in UTC.
        self.witnessed, self.witnessed_ms = 0, 0

    @property
    def named(self) -> bool:
        """True where there are witnesses."""
        return bool(self._witnesses)

    @property
    def confirmed(self) -> int:
        """How many have cosigned something since the gate started."""
        return sum(witness.confirmed for witness in self._witnesses)

    def begin(self) -> None:
        """Read what the store holds of earlier cosignatures; each is verified.

        Raises:
            AuthGuardError: it cannot be read.
        """
        note = self._checkpoints.held(WITNESSED)
        if note is None:
            return
        size = read_checkpoint(note.text, where="checkpoint").size
        found = cosigned(note, tuple(witness.key for witness in self._witnesses))
        times = sorted((one.time_s or 0 for one in found), reverse=True)
        for witness in self._witnesses:
            if any(one.key == witness.key for one in found):
                witness.size = size
        if len(found) >= self._policy.quorum > 0:
            self.witnessed, self.witnessed_ms = size, 1_000 * times[self._policy.quorum - 1]

    def require(self) -> None:
        """Refuse while too few witnesses have confirmed this store since the start.

        Raises:
            EnvironmentFault: they have not.
        """
        if self.confirmed < self._policy.quorum:
            raise EnvironmentFault(
                f"{self.confirmed} of {self._policy.quorum} witnesses have confirmed the log "
                "since the start",
                reason=Reason.STORE_UNAVAILABLE,
                where="witnesses",
            )

    def ask(self, within_s: float) -> Doubt | None:
        """Let the newest checkpoint go round, and wait for answers, so long at most.

        Raises:
            StoreError: what the store holds cannot be read or written.
        """
        end = time.monotonic() + within_s
        doubt = self.turn()
        while self._away() and time.monotonic() < end:
            time.sleep(LIMITS.witness_look_s)
            found = self.turn() if doubt is None else self._taken()  # all who doubt are heard
            doubt = doubt or found
        return doubt

    def turn(self) -> Doubt | None:
        """Take in answers, and ask each witness that has not cosigned the newest checkpoint.

        Raises:
            StoreError: what the store holds cannot be read or written.
        """
        doubt = self._taken()
        if doubt is not None:
            return doubt
        if self._note is None or self._is_witnessed(self._note) or not self._away():
            newest = self._checkpoints.newest
            if newest is not None and (self._note is None or newest.text != self._note.text):
                self._note = newest
        if self._note is not None:
            for witness in self._witnesses:
                if witness.wants(self._note.text, self._mono_ms()):
                    self._send(witness, self._note, witness.size)
        return None

    def accept(self) -> None:
        """Raise no more of the doubts that there are: a person has accepted the store.

        For this run of the gate alone, and until the witness cosigns: one that stays ahead is
        lost until its owner lets it forget the log.

        Raises:
            StoreError: what the store holds cannot be read or written.
        """
        self._taken()
        for witness in self._witnesses:
            witness.anew()
        self._note, self.witnessed, self.witnessed_ms = None, 0, 0

    def silence(self, unwitnessed: int) -> bool | None:
        """Return True when a silence begins, False when it ends, None when nothing changed.

        Args:
            unwitnessed: records that too few witnesses have cosigned.
        """
        now_ms, limit_ms = self._mono_ms(), self._policy.silence_ms
        if self.confirmed >= self._policy.quorum and not unwitnessed:
            self._since_ms = now_ms
        late = bool(self.named and limit_ms) and now_ms - self._since_ms > limit_ms
        if late is self._silent:
            return None
        self._silent = late
        return late

    def shown(self) -> dict[str, object]:
        """Return what `status` says."""
        return {
            "quorum": self._policy.quorum,
            "confirmed": self.confirmed,
            "witnessed": self.witnessed,
            "witnessed_ms": self.witnessed_ms,
            "witnesses": [
                {"name": witness.key.name, "state": str(witness.stand), "size": witness.size}
                for witness in self._witnesses
            ],
        }

    def _away(self) -> list[_Witness]:
        return [witness for witness in self._witnesses if witness.sent is not None]

    def _is_witnessed(self, note: Note) -> bool:
        agreed = sum(witness.done == note.text for witness in self._witnesses)
        return agreed >= self._policy.quorum

    def _send(self, witness: _Witness, note: Note, old: int) -> None:
        size = read_checkpoint(note.text, where="checkpoint").size
        witness.send(note, old, self._checkpoints.proof(old, size))

    def _taken(self) -> Doubt | None:
        """Take in what came; return the first doubt."""
        found = [self._take(witness) for witness in self._away()]
        return next(filter(None, found), None)

    def _take(self, witness: _Witness) -> Doubt | None:
        """Take in what one witness answered, if it has."""
        answer, note = witness.courier.answer(), witness.sent
        if answer is None or note is None:
            return None
        if answer.status == _OK:
            self._cosigned(witness, note, answer)
        elif answer.status == _CONFLICT:
            return self._told(witness, note, answer)
        elif answer.status == _UNPROCESSABLE and witness.old:
            return self._doubt(witness, Stand.CONTRADICTS, witness.old)
        else:
            stand = Stand.REFUSES if answer.status else Stand.UNREACHABLE
            witness.failed(stand, self._mono_ms())
        return None

    def _cosigned(self, witness: _Witness, note: Note, answer: WitnessReply) -> None:
        """Keep a cosignature that holds."""
        going = self._note
        current = going is not None and going.text == note.text
        merged = cosignature(answer, going if going is not None and current else note, witness.key)
        if merged is None:
            witness.failed(Stand.REFUSES, self._mono_ms())
            return
        size = read_checkpoint(note.text, where="checkpoint").size
        witness.agreed(note, size)
        if not current:
            return  # it was slow: another checkpoint goes round, and it is asked about that one
        self._note = merged
        witnessed = self._is_witnessed(merged)
        if witnessed:
            self.witnessed, self.witnessed_ms = size, self._utc_ms()
            self._since_ms = self._mono_ms()
        self._checkpoints.keep(merged, witnessed=witnessed)

    def _told(self, witness: _Witness, note: Note, answer: WitnessReply) -> Doubt | None:
        """Take in the size that a witness has: prove from there, if the log got so far."""
        size, sent = _size(answer), read_checkpoint(note.text, where="checkpoint").size
        if size is not None and size > sent:
            return self._doubt(witness, Stand.AHEAD, size)
        if witness.old == sent and size in (None, sent):
            return self._doubt(witness, Stand.CONTRADICTS, sent)
        if size is None or size == witness.old or not witness.told():
            witness.failed(Stand.REFUSES, self._mono_ms())
        else:
            self._send(witness, note, size)
        return None

    def _doubt(self, witness: _Witness, stand: Stand, size: int) -> Doubt | None:
        witness.failed(stand, self._mono_ms())
        return None if witness.muted else Doubt(_DOUBTS[stand], witness.key.name, size)


def _size(answer: WitnessReply) -> int | None:
    """Return the size in a 409; None when there is none."""
    kind, body = answer.kind.partition(";")[0].strip(), answer.body
    if kind != SIZE_TYPE or not body.endswith(b"\n"):
        return None
    try:
        return read_size(body[:-1].decode("ascii", "replace"), where="witness")
    except MalformedError:
        return None
