# SPDX-License-Identifier: Apache-2.0
"""What a witness answers: a request and what it knows of the log in, a verdict out.

Pure, and in the order of C2SP's tlog-witness. No client is trusted: only the log's own keys say
that a checkpoint is the log's, and only the proof says that it follows from the last one. Spec
page: docs/spec/witness.md#answers
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.audit.checkpoint import Checkpoint, read_checkpoint, read_size
from authguard_r.audit.note import Note, NoteKey, NoteSignature, decode64, read_note
from authguard_r.audit.tree import EMPTY_ROOT, HASH_BYTES, verify_consistency
from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import require_all, verify_note

#: Longest request, in bytes: the longest proof, a hybrid log's signatures and some cosignatures.
MAX_BYTES = 1 << 15
#: Most lines of a proof; a tree of 2^63 records needs no more.
MAX_PROOF = 63
_WHERE = "request"
_OLD = "old "


class RequestFinding(StrEnum):
    """What a request was found to be."""

    COSIGNED = "cosigned"
    MALFORMED = "malformed"
    UNKNOWN = "unknown"
    UNSIGNED = "unsigned"
    IMPOSSIBLE = "impossible"
    STALE = "stale"
    BEHIND = "behind"
    FORKED = "forked"
    UNPROVEN = "unproven"


#: Under each finding, the status of HTTP that says it.
STATUS: dict[RequestFinding, int] = {
    RequestFinding.COSIGNED: 200,
    RequestFinding.MALFORMED: 400,
    RequestFinding.UNKNOWN: 404,
    RequestFinding.UNSIGNED: 403,
    RequestFinding.IMPOSSIBLE: 400,
    RequestFinding.STALE: 409,
    RequestFinding.BEHIND: 409,
    RequestFinding.FORKED: 409,
    RequestFinding.UNPROVEN: 422,
}
#: What the log itself signed and could not have followed from what was cosigned, or was not shown
#: to: worth keeping.
KEPT = frozenset(
    {RequestFinding.STALE, RequestFinding.BEHIND, RequestFinding.FORKED, RequestFinding.UNPROVEN}
)


class WitnessedLog(Struct, frozen=True, kw_only=True):
    """What a witness knows of a log.

    Args:
        origin: its name.
        keys: that all have to sign its checkpoints; from the witness's operator.
        size: of the newest checkpoint that was cosigned, 0 when none was.
        root: of that checkpoint's tree.
    """

    origin: str
    keys: tuple[NoteKey, ...]
    size: int = 0
    root: bytes = EMPTY_ROOT


class WitnessRequest(Struct, frozen=True, kw_only=True):
    """A request that has the right form; nothing in it is verified.

    Args:
        old: how long the log was when it was cosigned last, as its sender says.
        proof: that what is asked for follows from that.
        note: the checkpoint with its signatures.
        checkpoint: what the note says.
    """

    old: int
    proof: tuple[bytes, ...]
    note: Note
    checkpoint: Checkpoint


class WitnessVerdict(Struct, frozen=True, kw_only=True):
    """What is to be answered.

    Args:
        finding: what the request was found to be.
        message: why, for the client; no secret, and nothing of the request.
        size: of the newest checkpoint that was cosigned, where that is the answer.
    """

    finding: RequestFinding
    message: str
    size: int | None = None

    @property
    def status(self) -> int:
        """The status of HTTP that says it."""
        return STATUS[self.finding]


def read_request(body: bytes) -> WitnessRequest:
    """Return what a request's body asks.

    Raises:
        MalformedError: it is no request to cosign a checkpoint.
    """
    if len(body) > MAX_BYTES:
        raise MalformedError(f"expected at most {MAX_BYTES} bytes", where=_WHERE)
    head, blank, note_bytes = body.partition(b"\n\n")
    if not blank or not head.isascii():
        raise MalformedError("expected an old size, a proof, an empty line, a note", where=_WHERE)
    first, *lines = head.decode("ascii").split("\n")
    if not first.startswith(_OLD):
        raise MalformedError("expected `old` and a size on the first line", where=_WHERE)
    if len(lines) > MAX_PROOF:
        raise MalformedError(f"expected at most {MAX_PROOF} hashes", where=_WHERE)
    note = read_note(note_bytes, where=_WHERE)
    return WitnessRequest(
        old=read_size(first.removeprefix(_OLD), where=_WHERE),
        proof=tuple(map(_hash, lines)),
        note=note,
        checkpoint=read_checkpoint(note.text, where=_WHERE),
    )


def judge(asked: WitnessRequest, log: WitnessedLog | None) -> WitnessVerdict:
    """Return the answer to a request, in the order of the specification.

    (1) the origin is known, (2) every key of the log has signed, (3) the old size is no larger than
    the checkpoint's, (4) the old size is that of the newest checkpoint that was cosigned, (5) a
    checkpoint of that size has its root, (6) the proof holds.

    Args:
        asked: from anyone.
        log: of the checkpoint's origin, None where it is not known.
    """
    found = asked.checkpoint
    # (1) origin
    if log is None:
        return WitnessVerdict(finding=RequestFinding.UNKNOWN, message="no such log is known here")
    # (2) signatures
    if (unsigned := _unsigned(asked.note, log)) is not None:
        return WitnessVerdict(finding=RequestFinding.UNSIGNED, message=unsigned)
    # (3) sizes
    if asked.old > found.size:
        return WitnessVerdict(
            finding=RequestFinding.IMPOSSIBLE, message="the old size is larger than the new"
        )
    # (4) what was cosigned last
    if asked.old != log.size:
        return WitnessVerdict(finding=_conflict(found, log), message="another size", size=log.size)
    # (5) the same size
    if _is_fork(found, log):
        return WitnessVerdict(
            finding=RequestFinding.FORKED, message="another root was cosigned for this size"
        )
    # (6) the proof
    if not verify_consistency(asked.old, found.size, log.root, found.root, asked.proof):
        return WitnessVerdict(
            finding=RequestFinding.UNPROVEN, message="the consistency proof is not valid"
        )
    return WitnessVerdict(finding=RequestFinding.COSIGNED, message="")


def own_part(note: Note, keys: tuple[NoteKey, ...]) -> Note:
    """Return a note with the signatures of these keys alone: what others appended is not kept."""
    ours = {(key.name, key.id) for key in keys}
    signatures = (one for one in note.signatures if (one.name, one.key_id) in ours)
    return Note(note.text, tuple({(s.name, s.key_id): s for s in signatures}.values()))


def require_log_keys(keys: tuple[NoteKey, ...]) -> str:
    """Return the origin of the log whose keys these are.

    Raises:
        AuthenticityError: one cannot sign a log's checkpoints (`KEY_INVALID`).
        MalformedError: it is missing, the same one comes twice, or they are of several logs.
    """
    origins = {key.name for key in keys}
    if len(origins) != 1 or len(set(keys)) != len(keys):
        raise MalformedError("expected different keys of one log", where="--log")
    for key in keys:
        _require_usable(key)
    return origins.pop()


def _require_usable(key: NoteKey) -> None:
    """Require a sound key that signs texts: it must refuse a signature that was never made."""
    asked = Note("no checkpoint\n", (NoteSignature(key.name, key.id, bytes(64)),))
    try:
        verify_note(asked, (key,), where="--log")
    except MalformedError as error:
        raise AuthenticityError(
            "expected a log's key, got a witness's", reason=Reason.KEY_INVALID, where="--log"
        ) from error
    except AuthenticityError as error:
        if error.reason is not Reason.SIGNATURE_INVALID:
            raise


def _unsigned(note: Note, log: WitnessedLog) -> str | None:
    try:
        require_all(note, log.keys, where=_WHERE)
    except AuthGuardError:
        return "expected a signature of each of the log's keys"
    return None


def _conflict(found: Checkpoint, log: WitnessedLog) -> RequestFinding:
    """Return what a checkpoint is whose sender took another one for the newest."""
    if _is_fork(found, log):
        return RequestFinding.FORKED
    return RequestFinding.BEHIND if found.size < log.size else RequestFinding.STALE


def _is_fork(found: Checkpoint, log: WitnessedLog) -> bool:
    return found.size == log.size and found.root != log.root


def _hash(line: str) -> bytes:
    data = decode64(line, where=_WHERE)
    if len(data) != HASH_BYTES:
        raise MalformedError(f"expected hashes of {HASH_BYTES} bytes", where=_WHERE)
    return data
