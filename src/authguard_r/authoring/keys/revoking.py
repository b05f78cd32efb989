# SPDX-License-Identifier: Apache-2.0
"""Revocation lists on the authority's machine: which certificates are dead, until when lists hold.

Spec page: docs/spec/token.md#revocation
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

from msgspec import Struct

from authguard_r.authoring.keys.folder import alone, certified, require_lasting, survey
from authguard_r.authoring.keys.setup import read_key, write_revocations
from authguard_r.core.errors import EnvironmentFault, RefusedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.signer import Passphrase
from authguard_r.keys.trust import read_trust


class Revoked(Struct, frozen=True, kw_only=True):
    """What a revocation did.

    Args:
        lists: the new lists by their authority's name.
        unread: files that may hold a certificate of the name, which then was not revoked.
    """

    lists: dict[str, RevocationList]
    unread: tuple[Path, ...]


def revoke(
    folder: Path,
    *,
    principal: str | None,
    serial: int | None,
    now: datetime,
    days: int,
    authority: str | None = None,
    passphrase: Passphrase | None = None,
) -> Revoked:
    """Write the next list of each authority that gave a principal, or a serial number, something.

    A file that cannot be read stops nothing; it is named, for it may hold one more.

    Args:
        folder: a set-up with the authority's private keys.
        principal: everything that this one has; an authority's own name revokes that authority.
        serial: one certificate.
        now: when the lists are signed.
        days: until their next update.
        authority: whose list a serial number goes on, when no file here says it.
        passphrase: says the passphrase of an authority's key that is sealed.

    Raises:
        RefusedError: there is no such certificate, or no such authority.
        EnvironmentFault: an authority's key is not here; nothing was written.
    """
    with alone(folder):
        found = survey(folder)
        dead: dict[str, set[int]] = {}
        for item in found.given:
            if principal == item.leaf.principal or serial == item.leaf.serial:
                dead.setdefault(item.authority, set()).add(item.leaf.serial)
        certified_here = certified(folder)
        for name, (certificate, root) in certified_here.items():
            if principal == name or serial == certificate.serial_number:
                dead.setdefault(root, set()).add(certificate.serial_number)
        if serial is not None and authority in certified_here:
            dead.setdefault(authority, set()).add(serial)
        unread = tuple(found.unread) if serial is None else ()
        if not dead:
            names = ", ".join(path.name for path in found.unread)
            past = f"; cannot read {names}: `--serial` with `--authority` needs no file"
            raise RefusedError(
                f"nothing was given to `{principal or serial}`{past if names else ''}",
                reason=Reason.CERTIFICATE_INVALID,
                where=str(folder),
            )
        return Revoked(
            lists=sign_next_lists(folder, dead, now=now, days=days, passphrase=passphrase),
            unread=unread,
        )


def renew_lists(
    folder: Path, *, now: datetime, days: int, passphrase: Passphrase | None = None
) -> dict[str, RevocationList]:
    """Sign and write the next list of each authority whose private key the folder holds.

    Raises:
        EnvironmentFault: it holds none; nothing was written.
    """
    with alone(folder):
        dead: dict[str, set[int]] = {name: set() for name in signing_here(folder)}
        if not dead:
            raise EnvironmentFault(
                f"`{folder}` has no authority's private key: sign lists on the authority's machine",
                reason=Reason.FILE_UNAVAILABLE,
                where=str(folder),
            )
        return sign_next_lists(folder, dead, now=now, days=days, passphrase=passphrase)


def sign_next_lists(
    folder: Path,
    dead: dict[str, set[int]],
    *,
    now: datetime,
    days: int,
    passphrase: Passphrase | None,
) -> dict[str, RevocationList]:
    """Sign and write the next list of each named authority: its serials so far, and the new ones.

    The caller holds the folder's lock.

    Raises:
        AuthenticityError: an authority's certificate is over; nothing was written.
        EnvironmentFault: the folder has no key of an authority; nothing was written.
    """
    require_lasting(folder, dead, Now(int(now.timestamp()) * 1000, 0))
    before = {known.authority: known for known in read_trust(folder).lists.values()}
    keys = {name: read_key(folder, name, passphrase) for name in dead}
    for name, serials in dead.items():
        write_revocations(
            folder,
            name,
            keys[name],
            serials=tuple(before[name].serials | serials),
            now=now,
            number=before[name].number + 1,
            days=days,
        )
    after = {known.authority: known for known in read_trust(folder).lists.values()}
    return {name: after[name] for name in dead}


def signing_here(folder: Path) -> Iterable[str]:
    """Return the authorities whose private keys this folder holds, the roots among them."""
    known = (item.authority for item in read_trust(folder).lists.values())
    return [name for name in known if (folder / "keys" / f"{name}.key.pem").exists()]
