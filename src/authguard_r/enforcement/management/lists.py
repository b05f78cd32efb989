# SPDX-License-Identifier: Apache-2.0
"""Revocation lists that come while a gate runs, and the newest that it ever had.

A list is signed by its authority, so anyone may install it. It never gives way to an older one: its
number is above that of the list in force, and what was in force once is held in the store, in the
same commit as its record. What was verified before is verified anew. Spec page:
docs/spec/token.md#revocation
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256

from msgspec import Struct

from authguard_r.audit.record import Entry
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthenticityError, MalformedError, StoreError
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.management.parts import attempt, refuse
from authguard_r.keys.loading import key_of, load
from authguard_r.keys.revocation import RevocationList, read_list
from authguard_r.keys.trust import Trust
from authguard_r.store.transactions import Ledger, Transaction

#: The number of an authority's first list: nothing older could come in its place.
_FIRST = 1


class Received(Struct, frozen=True, kw_only=True):
    """A list that was taken in.

    Args:
        authority: whose it is.
        number: its number.
        next_update: after this it is stale.
        serials: how many certificates it names.
    """

    authority: str
    number: int
    next_update: str
    serials: int


class Lists:
    """The revocation lists of one gate.

    Args:
        ledger: store and trusted time.
        inputs: verifies anew what it verified before.
        trust: where the lists are in force.
        chain: the gate's own certificates.
        dismissed: called when a list revokes these: the gate releases nothing any more.
    """

    def __init__(
        self,
        ledger: Ledger,
        inputs: InputVerifier,
        trust: Trust,
        *,
        chain: tuple[bytes, ...],
        dismissed: Callable[[], None],
    ) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self._trust = trust
        self._chain = chain
        self._dismissed = dismissed

    def install(self, data: bytes) -> Received:
        """Take a newer list in: every decision after this returns uses it.

        The very list that is in force is so already: nothing is written, and nothing is wrong.

        Args:
            data: the signed list; anyone may bring it.

        Raises:
            MalformedError: no list, or of no authority that is here.
            AuthenticityError: its signature does not hold, or it is not newer than the one in
                force, or stale already (`REVOCATION_STALE`).
            EnvironmentFault: it could not be written; the one before is in force.
        """

        def read(act: Transaction) -> RevocationList | tuple[bytes, RevocationList]:
            there = self._trust.in_force(data, act.now)
            return self._trust.read_newer(data, act.now) if there is None else there

        known = attempt(self._ledger, read)
        if isinstance(known, RevocationList):
            return _received(known)
        der, found = known
        before = self._trust.lists[der]

        def job(act: Transaction) -> None:
            now = self._trust.lists[der]
            if now != found and now.number >= found.number:
                raise refuse(Reason.REVOCATION_STALE, "another list came first", "revocations")
            _hold(act, der, found, by="order")
            # inside the turn: a decision of any later one is made under the new list
            self._trust.put_in_force({der: found})
            self._inputs.doubt(act.now)

        try:
            self._ledger.run(job, essential=True)
        except BaseException:
            if self._trust.lists[der] == found:
                self._trust.put_in_force({der: before})
            raise
        self._require_own()
        return _received(found)

    def _require_own(self) -> None:
        """Tell when the gate itself was revoked."""
        try:
            self._trust.gate_identity(self._chain, self._ledger.now())
        except AuthenticityError:
            self._dismissed()

    def begin(self) -> bool:
        """Put in force the newest of what the folder and the store hold, when a gate starts.

        Returns:
            True when the store had a newer one than the folder.

        Raises:
            StoreError: what the store holds is not what was put there.
        """
        stored: dict[bytes, RevocationList] = {}
        unheld: dict[bytes, RevocationList] = {}
        for der, known in self._trust.lists.items():
            held = self._held(der, known.authority)
            least = _FIRST if held is None else held.number
            if held is not None and least > known.number:
                stored[der] = held
            elif known.number > least:
                unheld[der] = known
        if stored:
            self._trust.put_in_force(stored)
        if unheld:
            quietly(lambda: self._ledger.run(lambda act: _hold_all(act, unheld), essential=True))
        return bool(stored)

    def _held(self, der: bytes, name: str) -> RevocationList | None:
        """Return the newest list of an authority that the store has."""
        data = self._ledger.peek(lambda turn: turn.get("revocations", _key(der)))
        if data is None:
            return None
        try:
            key = key_of(load(der, where=name), where=name)
            return read_list(data, authority=name, key=key)
        except (AuthenticityError, MalformedError) as error:
            raise StoreError(
                error.message, where="store.revocations", reason=Reason.STORE_CORRUPT
            ) from error


def _hold_all(act: Transaction, lists: dict[bytes, RevocationList]) -> None:
    for der, found in lists.items():
        _hold(act, der, found, by="folder")


def _hold(act: Transaction, der: bytes, found: RevocationList, *, by: str) -> None:
    """Hold a list as the newest that was ever in force, and record that it is."""
    act.put("revocations", _key(der), found.signed)
    told = _received(found)
    act.record(
        Entry(
            kind="revocation",
            time_ms=act.now.utc_ms,
            decision="revocation",
            open={
                "what": f"list {told.number} of {told.authority}",
                "authority": told.authority,
                "number": told.number,
                "next_update": told.next_update,
                "serials": told.serials,
                "by": by,
            },
            sealed={"list": found.signed.decode("ascii").strip()},
        )
    )


def _received(found: RevocationList) -> Received:
    return Received(
        authority=found.authority,
        number=found.number,
        next_update=to_timestamp(found.next_update_ms),
        serials=len(found.serials),
    )


def _key(der: bytes) -> str:
    """Return what an authority's list is held under: another certificate has none of it."""
    return b64(sha256(der).digest())
