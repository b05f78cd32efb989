# SPDX-License-Identifier: Apache-2.0
"""What a process opens its key with, and whether it is the key that its work needs.

Spec page: docs/spec/token.md#key-files
"""

from __future__ import annotations

from pathlib import Path

from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Role
from authguard_r.keys.envelope import MAX_PASSPHRASE
from authguard_r.keys.files import read_private
from authguard_r.keys.pkcs11 import is_key_uri, open_key
from authguard_r.keys.signer import FileSigner, Passphrase, SigningKey, open_key_file
from authguard_r.keys.trust import Trust

#: Most bytes of a passphrase file: the longest passphrase in the longest spelling, and a newline.
_MOST_BYTES = 4 * MAX_PASSPHRASE + 2


def open_named(key: Path, passphrase: Passphrase | None) -> tuple[SigningKey, ...]:
    """Return the keys that a name leads to.

    Args:
        key: a file, or a `pkcs11:` URI.
        passphrase: gives the passphrase or PIN; None when no person can be asked.

    Raises:
        EnvironmentFault: a file or token is not there.
        MalformedError: a sealed file or a URI is damaged.
        AuthenticityError: the key does not open.
    """
    if is_key_uri(str(key)):
        return (open_key(str(key), passphrase),)
    return open_key_file(key, passphrase)


def read_passphrase(path: Path) -> str:
    """Return the one line in a file that only its owner can read.

    Raises:
        EnvironmentFault: it cannot be read, or others may read it.
        MalformedError: not one line of text.
    """
    data = read_private(path, where="--passphrase-file")
    try:
        text = data[: _MOST_BYTES + 1].decode("utf-8").removesuffix("\n").removesuffix("\r")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where="--passphrase-file") from error
    if not text or len(data) > _MOST_BYTES or not text.isprintable():
        raise MalformedError("expected one line of text", where="--passphrase-file")
    return text


def require_estimator(
    signer: FileSigner, trust: Trust, rid: RobotId, now: Now, *, where: Path
) -> None:
    """Require a key that the gate takes snapshots of, now and not at each of them.

    Args:
        signer: the key with its certificate.
        trust: the trust root.
        rid: whose estimator it has to be.
        now: the time that the certificate has to hold at.
        where: the certificate's file.

    Raises:
        AuthenticityError: the certificate does not hold, or is not this robot's estimator's.
    """
    leaf = trust.identify(signer.chain, now)
    if leaf.role is not Role.ESTIMATOR or leaf.robot != rid:
        raise AuthenticityError(
            f"expected the certificate of an estimator of `{rid}`",
            reason=Reason.ROLE_DENIED,
            where=str(where),
        )
