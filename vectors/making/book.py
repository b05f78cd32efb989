# SPDX-License-Identifier: Apache-2.0
"""Where vectors of certificates are written down: chains by name, with what they say or why not."""

from __future__ import annotations

from typing import Any

from cryptography import x509
from cryptography.x509.oid import ObjectIdentifier

from making import chains
from making.chains import END, authority, leaf, root
from unit.keys.chains import NOW, PRINCIPAL, Held, san

Json = dict[str, Any]

ROBOT, REGION = "urn:authguard-r:robot:", "urn:authguard-r:region:"
PROFILE, TEMPLATE = "urn:authguard-r:profile:", "urn:authguard-r:template:"
THRESHOLD, MEMBER = "urn:authguard-r:threshold:", "urn:authguard-r:member:"
OPERATOR = PRINCIPAL + "operator-1"
DIGEST, OTHER = "A" * 43, "B" * 42 + "A"
LEAF, AUTHORITY = "certificate.leaf", "certificate.authority"
TOP = root()
PEOPLE = authority(TOP)
UNKNOWN = x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4"), b"\x05\x00")
POLICIES = x509.CertificatePolicies([x509.PolicyInformation(ObjectIdentifier("1.2.3.5"), None)])


def ms(moment: Any) -> int:
    """Return an instant in milliseconds since 1970."""
    return int(moment.timestamp()) * 1000


class Book:
    """The vectors so far, with the table of their certificates."""

    def __init__(self) -> None:
        self.table = chains.Table("certificate.json")
        self.vectors: list[Json] = []
        self.machines: list[Json] = []
        for name, held in (("root", TOP), ("people", PEOPLE), ("operator-1", leaf(PEOPLE))):
            self.table.name(held, name)

    def chain(self, name: str, held: tuple[Held | bytes, ...], roots: tuple[Held, ...]) -> Json:
        """Return a vector's certificates by name."""
        parts = ("leaf", "authority", "third")
        return {
            "name": name,
            "chain": [
                self.table.name(c, f"{name}: {p}") for c, p in zip(held, parts, strict=False)
            ],
            "roots": [self.table.name(r, f"{name}: root {n}") for n, r in enumerate(roots)],
        }

    def accept(
        self,
        name: str,
        one: Held,
        issuer: Held = PEOPLE,
        roots: tuple[Held, ...] = (TOP,),
        *,
        now_ms: int = NOW.utc_ms,
        **said: Any,
    ) -> None:
        """Add a chain that holds; what it says, where that is not the usual."""
        usual: Json = {
            "principal": "operator-1",
            "role": "operator",
            "robots": None,
            "regions": None,
            "profile": None,
            "template": None,
            "threshold": 1,
            "members": [],
            "algorithm": "ed25519",
            "root": 0,
            "serial": str(one.certificate.serial_number),
            "authority_serial": str(issuer.certificate.serial_number),
            "not_after_ms": ms(END),
        }
        chain = self.chain(name, (one, issuer), roots)
        self.vectors.append({**chain, "now_ms": now_ms, "expect": {**usual, **said}})

    def refuse(
        self,
        name: str,
        *held: Held | bytes,
        roots: tuple[Held, ...] = (TOP,),
        reason: str = "CERTIFICATE_INVALID",
        where: str = LEAF,
        now_ms: int = NOW.utc_ms,
    ) -> None:
        """Add a chain that does not hold: a leaf of the usual authority, or a whole chain."""
        whole = (*held, PEOPLE) if len(held) == 1 else held
        refusal = {"reason": reason, "where": where}
        self.vectors.append({**self.chain(name, whole, roots), "now_ms": now_ms, "expect": refusal})


def named(*uris: str) -> tuple[x509.SubjectAlternativeName, bool]:
    """Return an alternative name of these URIs."""
    return san(*uris), False
