# SPDX-License-Identifier: Apache-2.0
"""Files of keys and certificates: written whole or not at all, a trust folder never backwards.

Spec page: docs/spec/token.md#trust-folder
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.request import OpenedAnswer, fingerprint
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.trust import read_trust


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that a reader finds all of it, or what was there before.

    Raises:
        EnvironmentFault: nothing took its place.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with new.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError as error:
        raise EnvironmentFault(
            f"cannot write `{path}`: {error.strerror}",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(path),
        ) from error
    finally:
        with suppress(OSError):  # it has the place by now, or a half of it is nobody's
            new.unlink()


def install_answer(folder: Path, opened: OpenedAnswer) -> None:
    """Write a trust folder, or bring the one that is there up to date; its root never changes.

    Args:
        folder: the trust folder; may be absent.
        opened: an answer whose root a person, or the folder, stands behind.

    Raises:
        AuthenticityError: the folder has another root; nothing was written.
        EnvironmentFault: it could not be written.
    """
    roots = opened.trust.roots
    held: dict[str, RevocationList] = {}
    if (folder / "root.pem").exists():
        known = read_trust(folder)
        require_root(fingerprint(roots), fingerprint(known.roots), where=str(folder))
        held = {item.authority: item for item in known.lists.values()}
    for name in ("authorities", "revocations"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, found in opened.lists.items():
        if name not in held or held[name].number < found.number:
            write_whole(folder / "revocations" / f"{name}.json", found.signed)
    for name, certificate in opened.authorities.items():
        path = folder / "authorities" / f"{name}.pem"
        write_whole(path, certificate.public_bytes(Encoding.PEM))
    pem = b"".join(root.public_bytes(Encoding.PEM) for root in roots)
    write_whole(folder / "root.pem", pem)  # the last: without it there is no trust folder


def install_list(folder: Path, data: bytes, now: Now) -> RevocationList:
    """Put an authority's next list in the place of the one that a trust folder holds.

    Raises:
        AuthGuardError: it is none of this folder's authorities, or not newer; nothing was written.
    """
    _, found = read_trust(folder).read_newer(data, now)
    write_whole(folder / "revocations" / f"{found.authority}.json", found.signed)
    return found


def require_root(got: str, expected: str, *, where: str) -> None:
    """Require that a fingerprint is the expected one.

    Raises:
        AuthenticityError: it is another root's.
    """
    if got != expected:
        raise AuthenticityError(
            f"expected the root `{expected}`, got `{got}`",
            reason=Reason.CERTIFICATE_INVALID,
            where=where,
        )
