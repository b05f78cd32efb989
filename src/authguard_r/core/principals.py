# SPDX-License-Identifier: Apache-2.0
"""Principals: who signed, what their certificate allows, and the ports that sign and verify.

Source: `eq:signature`. Spec page: docs/spec/token.md
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from msgspec import Struct

from authguard_r.core.identifiers import Identifier, PrincipalId, RegionId, RobotId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now

#: A chain, leaf certificate and its role authority's in DER, and a signature by the leaf's key.
Endorsed = tuple[tuple[bytes, ...], bytes]


class Scope(Struct, frozen=True, kw_only=True):
    """What a certificate confines its holder to; what it does not name is outside.

    Args:
        robots: whose missions and orders; None when it says "every robot" in so many words.
        regions: where; None when it says "every region".
    """

    robots: frozenset[RobotId] | None
    regions: frozenset[RegionId] | None

    def covers(self, rid: RobotId, regions: Iterable[RegionId] = ()) -> bool:
        """True when the robot and every region lie inside."""
        near = self.regions is None or self.regions.issuperset(regions)
        return near and (self.robots is None or rid in self.robots)


class Principal(Struct, frozen=True, kw_only=True):
    """Who a verified certificate speaks for. Made by a `Verifier` only.

    Args:
        id: the principal's id from the certificate.
        role: the role in its extended key usage.
        scope: the robots and regions that it may sign for.
        usable_until_ms: when its certificates or the revocation list end, whichever is first.
        threshold: how many people stand behind one signature of a group's key.
        members: the group's people; empty for one person.
    """

    id: PrincipalId
    role: Identifier
    scope: Scope
    usable_until_ms: int
    threshold: int = 1
    members: frozenset[PrincipalId] = frozenset()

    @property
    def label(self) -> Label:
        """The label of what it signs: an operator's, or that of a role above operators."""
        return Label.OPERATOR if self.role == Label.OPERATOR else Label.SUPERVISOR


class Verifier(Protocol):
    """Certificates and signatures (steps 1 and 2)."""

    def verify(self, message: bytes, endorsements: tuple[Endorsed, ...], now: Now) -> Principal:
        """Return the one principal who signed `message`, with every key that has to.

        Raises:
            AuthenticityError: a chain, revocation or signature does not hold at `now`, they are
                not of one principal, or a root has none.
        """
        ...


class Signer(Protocol):
    """Holds private keys and lends their signatures, never themselves."""

    @property
    def chain(self) -> tuple[bytes, ...]:
        """Leaf certificate and its role authority's, DER; of the first key."""
        ...

    def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
        """Return chain and signature over `message` of each key that signs for this principal."""
        ...
