# SPDX-License-Identifier: Apache-2.0
"""Certificates with keys from seeds and serial numbers from names, in a table of their own.

ML-DSA signatures are hedged: two over one message differ. A certificate or list that says the same
as the one in the file that is there keeps that one's signature.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import timedelta
from functools import cache
from hashlib import sha256
from typing import Any

from cryptography import x509

from authguard_r.core.encoding import b64, unb64
from authguard_r.keys.algorithms import Algorithm, PrivateKey
from authguard_r.keys.certificate import Role
from making import ROOT
from unit.keys import chains as knobs
from unit.keys.chains import Held

Json = dict[str, Any]

ED, M44, M65, M87 = Algorithm
START, END = knobs.TODAY - timedelta(days=1), knobs.TODAY + timedelta(days=30)


def serial_of(name: str) -> int:
    """Return the serial number that a name has: 63 bits of its hash, none of them the sign."""
    return int.from_bytes(sha256(name.encode()).digest()[:8], "big") >> 1 | 1


def own(algorithm: Algorithm, name: str) -> PrivateKey:
    """Return the private key of a name."""
    return knobs.key_of(algorithm, name)


def root(
    subject: str = "Test root",
    algorithm: Algorithm = ED,
    *,
    key: PrivateKey | None = None,
    extensions: tuple[knobs.Extra, ...] | None = None,
    **changes: Any,
) -> Held:
    """Return a self-signed root; what is given is changed."""
    held = key or own(algorithm, subject)
    ids = knobs.key_ids(held.public_key(), held)
    said = ((knobs.ROOT_BASIC, True), knobs.CERTIFIES, *ids)
    public = changes.pop("public", held.public_key())
    fields = {"serial": serial_of(f"root {subject}"), "start": START, "end": END, **changes}
    made = knobs.certify(
        public,
        subject=subject,
        issuer=subject,
        by=held,
        extensions=said if extensions is None else extensions,
        **fields,
    )
    return Held(held, made)


def authority(
    issuer: Held, roles: tuple[Role, ...] = knobs.PEOPLE, name: str = "people", **changes: Any
) -> Held:
    """Return a role authority; what is given is changed."""
    return knobs.authority(issuer, roles, **{"serial": serial_of(f"authority {name}"), **changes})


def leaf(issuer: Held, principal: str = "operator-1", name: str = "", **changes: Any) -> Held:
    """Return a leaf; what is given is changed."""
    serial = serial_of(f"leaf {name or principal}")
    return knobs.leaf(issuer, principal, **{"serial": serial, **changes})


@cache
def line(algorithm: Algorithm) -> tuple[Held, Held]:
    """Return a root and its authority of people, of one algorithm."""
    top = root(f"Root {algorithm}", algorithm)
    return top, authority(top, own=own(algorithm, "people"))


@cache
def operator(algorithm: Algorithm) -> Held:
    """Return the leaf of `operator-1` under `line`, of the same algorithm."""
    return leaf(line(algorithm)[1], own=own(algorithm, "leaf operator-1"))


class Table:
    """Certificates under the names by which vectors speak of them.

    Args:
        file: the vectors that are there already; their hedged signatures are kept.
    """

    def __init__(self, file: str) -> None:
        path = ROOT / "vectors" / file
        self.before: Json = json.loads(path.read_text()) if path.exists() else {}
        self._names: dict[bytes, str] = {}

    def name(self, item: Held | bytes, name: str) -> str:
        """Return under which name a certificate is in the table: its first one."""
        der = item if isinstance(item, bytes) else item.der
        if name in self._names.values() and der not in self._names:
            raise SystemExit(f"two certificates `{name}`")
        return self._names.setdefault(der, name)

    def names(self) -> dict[str, str]:
        """Return the table: DER in base64url."""
        old = self.before.get("certificates", {})
        return {
            name: kept(b64(der), old.get(name), _signed_part) for der, name in self._names.items()
        }


def kept(new: str, old: str | None, says: Callable[[str], object]) -> str:
    """Return the old text if it says the same as the new one."""
    if old is None or old == new:
        return new
    return old if says(old) == says(new) else new


def _signed_part(text: str) -> object:
    try:
        found = x509.load_der_x509_certificate(unb64(text))
        return found.tbs_certificate_bytes, len(unb64(text))
    except ValueError:
        return text
