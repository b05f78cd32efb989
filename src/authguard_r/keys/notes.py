# SPDX-License-Identifier: Apache-2.0
"""Signatures on notes: a log's own over its checkpoints, and witnesses' cosignatures.

Kinds are C2SP's: Ed25519 over the text (`0x01`), a witness's Ed25519 (`0x04`) or ML-DSA-44
(`0x06`) cosignature with its time. ML-DSA over the text has no number there; it takes `0xff` and
a name. Spec page: docs/spec/checkpoint.md#signatures
"""

from __future__ import annotations

from collections.abc import Iterable

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.mldsa import (
    MLDSA44PublicKey,
    MLDSA65PublicKey,
    MLDSA87PublicKey,
)
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.audit.checkpoint import Checkpoint, origin_of, read_checkpoint
from authguard_r.audit.note import Note, NoteKey, NoteSignature
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import (
    Algorithm,
    PublicKey,
    algorithm_of,
    require_signature,
    require_sound,
)
from authguard_r.keys.loading import key_of, load
from authguard_r.keys.signer import SigningKey
from authguard_r.keys.trust import Trust, pairs

#: Under each signature type, the keys that can have it.
_TEXT_KINDS: dict[bytes, type[PublicKey]] = {
    b"\x01": Ed25519PublicKey,
    b"\xffauthguard-r/ml-dsa-44/1\x00": MLDSA44PublicKey,
    b"\xffauthguard-r/ml-dsa-65/1\x00": MLDSA65PublicKey,
    b"\xffauthguard-r/ml-dsa-87/1\x00": MLDSA87PublicKey,
}
_ED25519_COSIGNATURE, _ML_DSA_COSIGNATURE = b"\x04", b"\x06"
_COSIGNATURE_KINDS: dict[bytes, type[PublicKey]] = {
    _ED25519_COSIGNATURE: Ed25519PublicKey,
    _ML_DSA_COSIGNATURE: MLDSA44PublicKey,
}
_TIME_BYTES = 8
_MOST_TIME = (1 << 63) - 1
_WHERE = "note"


class Attested(Struct, frozen=True):
    """A signature that holds.

    Args:
        key: whose.
        time_s: when a witness says that it was the newest that it had seen, seconds since 1970;
            None from a log, which says no time.
    """

    key: NoteKey
    time_s: int | None = None


def log_key(name: str, key: PublicKey) -> NoteKey:
    """Return a log's public key as notes name it."""
    return _named(name, key, _TEXT_KINDS)


def witness_key(name: str, key: PublicKey) -> NoteKey:
    """Return a witness's public key as notes name it.

    Raises:
        AuthenticityError: an algorithm that there are no cosignatures with (`KEY_INVALID`).
    """
    return _named(name, key, _COSIGNATURE_KINDS)


def gate_keys(
    certificates: tuple[x509.Certificate, ...], *, robot: RobotId, trust: Trust, now: Now
) -> tuple[NoteKey, ...]:
    """Return the keys that sign the checkpoints of a robot's log, out of its gate's certificates.

    Args:
        certificates: leaf and authority of each key, from anyone.
        robot: whose log it is.
        trust: the roots; under two there are two keys, and both have to sign.
        now: the instant at which the certificates have to be valid.

    Raises:
        AuthenticityError: they do not hold, are another's, or a root is without its key.
    """
    ders = [
        (leaf.public_bytes(Encoding.DER), authority.public_bytes(Encoding.DER))
        for leaf, authority in pairs(certificates)
    ]
    leaves = [trust.identify(chain, now) for chain in ders]
    for chain in ders:
        named, _ = trust.gate_identity(chain, now)
        if named != robot:
            raise AuthenticityError(
                f"expected the gate's certificate of `{robot}`, got `{named}`'s",
                reason=Reason.ROBOT_MISMATCH,
                where="certificate",
            )
    if {leaf.root for leaf in leaves} != set(range(len(trust.roots))):
        raise AuthenticityError(
            "expected a certificate under every root",
            reason=Reason.SIGNATURE_MISSING,
            where="certificate",
        )
    return tuple(log_key(origin_of(robot), leaf.key) for leaf in leaves)


def leaf_key(chain: tuple[bytes, ...]) -> PublicKey:
    """Return the public key of a chain's leaf certificate; its owner is not verified.

    Raises:
        AuthenticityError: an unknown algorithm, or an unsound key.
    """
    return key_of(load(chain[0], where=_WHERE), where=_WHERE)


def sign_text(text: str, name: str, signer: Signer) -> tuple[NoteSignature, ...]:
    """Return a log's signatures over a note's text, one of each key that has to sign."""
    return tuple(
        NoteSignature(name, log_key(name, leaf_key(chain)).id, signature)
        for chain, signature in signer.endorse(text.encode())
    )


def cosign(text: str, name: str, key: SigningKey, time_s: int) -> NoteSignature:
    """Return a witness's cosignature: at `time_s` this was the newest that it had seen.

    Args:
        text: a checkpoint's; that it follows from the last one has been verified.
        name: the witness's.
        key: the witness's.
        time_s: seconds since 1970.

    Raises:
        MalformedError: the text is no checkpoint.
        AuthenticityError: an algorithm that there are no cosignatures with.
    """
    named = witness_key(name, key.public_key())
    said = _cosigned(named, read_checkpoint(text, where=_WHERE), text, time_s)
    stamp = time_s.to_bytes(_TIME_BYTES, "big")
    return NoteSignature(name, named.id, stamp + key.sign(said))


def verify_note(note: Note, keys: Iterable[NoteKey], *, where: str) -> tuple[Attested, ...]:
    """Return which of these keys signed the note; signatures of unknown keys are not looked at.

    Args:
        note: from anyone.
        keys: the trusted ones.
        where: for errors.

    Raises:
        AuthenticityError: a signature that says it is one of these keys' is not
            (`SIGNATURE_INVALID`), or a key is unsound.
        MalformedError: a cosignature on something that is no checkpoint.
    """
    known = {(key.name, key.id): key for key in keys}
    found: dict[NoteKey, Attested] = {}
    for signature in note.signatures:
        key = known.get((signature.name, signature.key_id))
        if key is not None:
            found.setdefault(key, _verified(note.text, key, signature.signature, where))
    return tuple(found.values())


def require_all(note: Note, keys: tuple[NoteKey, ...], *, where: str) -> Checkpoint:
    """Return the checkpoint in a note that every one of a log's keys has signed.

    Raises:
        AuthenticityError: a signature is not there (`SIGNATURE_MISSING`) or does not hold.
        MalformedError: the note is no checkpoint.
    """
    signed = {attested.key for attested in verify_note(note, keys, where=where)}
    missing = [key.name for key in keys if key not in signed]
    if missing or not keys:
        raise AuthenticityError(
            f"expected a signature of {missing[0] if missing else 'a known key'}",
            reason=Reason.SIGNATURE_MISSING,
            where=where,
        )
    return read_checkpoint(note.text, where=where)


def _verified(text: str, key: NoteKey, signature: bytes, where: str) -> Attested:
    kinds = {**_TEXT_KINDS, **_COSIGNATURE_KINDS}
    public = _load(key, kinds.get(key.kind), where)
    if key.kind in _TEXT_KINDS:
        require_signature(public, signature, text.encode(), where=where)
        return Attested(key)
    time_s = int.from_bytes(signature[:_TIME_BYTES], "big")
    if len(signature) < _TIME_BYTES or time_s > _MOST_TIME:
        raise MalformedError("expected a time before the signature", where=where)
    said = _cosigned(key, read_checkpoint(text, where=where), text, time_s)
    require_signature(public, signature[_TIME_BYTES:], said, where=where)
    return Attested(key, time_s)


def _cosigned(key: NoteKey, checkpoint: Checkpoint, text: str, time_s: int) -> bytes:
    """Return what a cosignature is over."""
    if key.kind == _ED25519_COSIGNATURE:
        return f"cosignature/v1\ntime {time_s}\n{text}".encode()
    return b"".join(
        (
            b"subtree/v1\n\x00",
            _counted(key.name),
            time_s.to_bytes(_TIME_BYTES, "big"),
            _counted(checkpoint.origin),
            bytes(8),  # from the first leaf on
            checkpoint.size.to_bytes(8, "big"),
            checkpoint.root,
        )
    )


def _counted(text: str) -> bytes:
    """Return a text with its length before it, in one byte."""
    data = text.encode()
    if not 0 < len(data) < 1 << 8:
        raise MalformedError("expected a name of 1 to 255 bytes", where=_WHERE)
    return bytes((len(data),)) + data


def _named(name: str, key: PublicKey, kinds: dict[bytes, type[PublicKey]]) -> NoteKey:
    for kind, of in kinds.items():
        if isinstance(key, of):
            return NoteKey(name, kind, key.public_bytes_raw())
    raise _unusable(f"no note is signed so with {algorithm_of(key)}", name)


def _load(key: NoteKey, of: type[PublicKey] | None, where: str) -> PublicKey:
    if of is None:
        raise _unusable(f"expected a key of {', '.join(Algorithm)}", where)
    try:
        loaded = of.from_public_bytes(key.public)
    except ValueError as error:
        raise _unusable(str(error), where) from error
    return require_sound(loaded, where=where)


def _unusable(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=where)
