# SPDX-License-Identifier: Apache-2.0
"""What a log is held against: checkpoints, each verified with keys that the user named.

Spec page: docs/spec/checkpoint.md#verification
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from authguard_r.audit.checkpoint import Checkpoint, origin_of, read_checkpoint
from authguard_r.audit.note import MAX_BYTES, Note, NoteKey, read_note
from authguard_r.audit.record import Terminal
from authguard_r.audit.verify import Anchor, of_checkpoint, of_terminal
from authguard_r.cli.inputs import wall_now
from authguard_r.cli.log_keys import keys_of
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.keys.notes import Attested, require_all, verify_note
from authguard_r.keys.trust import read_file, read_trust

_NO_KEY = "no key was named"


class AnchorOptions(Struct, frozen=True, kw_only=True):
    """What the user named.

    Args:
        kept: files with checkpoints that were kept elsewhere.
        keys: the log's.
        witnesses: theirs.
        quorum: how many witnesses it takes; 0 when none were asked for.
        trust: a trust folder.
    """

    kept: tuple[Path, ...] = ()
    keys: tuple[NoteKey, ...] = ()
    witnesses: tuple[NoteKey, ...] = ()
    quorum: int = 0
    trust: Path | None = None


class KnownLog(Struct, frozen=True, kw_only=True):
    """What is known of the log from outside of it.

    Args:
        anchors: what authentic checkpoints say, and what the file's own claim.
        cosigned: the witnesses of the longest one that enough of them have cosigned.
        ignored: why each other checkpoint that lay with the log says nothing.
    """

    anchors: tuple[Anchor, ...] = ()
    cosigned: tuple[Attested, ...] = ()
    ignored: tuple[str, ...] = ()


class _SeenCheckpoint(Struct, frozen=True):
    """One authentic checkpoint, and the witnesses that cosigned it."""

    checkpoint: Checkpoint
    cosigned: tuple[Attested, ...]


def known_of(asked: AnchorOptions, embedded: tuple[bytes, ...]) -> KnownLog:
    """Return what authentic checkpoints say: those that were kept, and those in the log's file.

    Args:
        asked: what the user named.
        embedded: notes that lie with the log; the log's writer chose them.

    Raises:
        EnvironmentFault: a checkpoint was named, and no key.
        MalformedError: a checkpoint that was named, or one that was to be verified, is not valid.
        AuthenticityError: its signature does not hold; or a key or witnesses were named, and no
            checkpoint is signed so.
    """
    inside, ignored = _embedded(asked, embedded)
    terminals, kept = [], []
    for path in asked.kept:
        data = read_file(path)
        if data.startswith(b"{"):
            terminals.append(_terminal(data, asked.trust))
        else:
            kept.append(_read(data[: MAX_BYTES + 1], asked, where=str(path)))
    seen = [*inside, *kept]
    _require_wanted(asked, seen, terminals=bool(terminals))
    enough = [item for item in seen if asked.quorum and _count(item) >= asked.quorum]
    longest = max(enough, key=lambda item: item.checkpoint.size, default=None)
    said = [of_checkpoint(item.checkpoint, witnessed=item in enough) for item in seen]
    claims = () if asked.keys or asked.trust else tuple(_claims(embedded))
    at = len(inside)  # what was kept elsewhere comes last: it is reported
    return KnownLog(
        anchors=(*claims, *said[:at], *map(of_terminal, terminals), *said[at:]),
        cosigned=() if longest is None else longest.cosigned,
        ignored=ignored,
    )


def _embedded(
    asked: AnchorOptions, notes: tuple[bytes, ...]
) -> tuple[list[_SeenCheckpoint], tuple[str, ...]]:
    """Return the authentic checkpoints that lie with the log, and why the others say nothing."""
    if not asked.keys and asked.trust is None:
        return [], tuple(_NO_KEY for _ in notes)
    seen, ignored = [], []
    for data in notes:
        try:
            seen.append(_read(data, asked, where="checkpoint"))
        except AuthenticityError as error:
            if error.reason is not Reason.SIGNATURE_MISSING:
                raise
            ignored.append(error.message)  # an older one, of a key that was rotated
        except EnvironmentFault as error:
            if not asked.kept:
                raise
            ignored.append(error.message)  # the folder holds no gate's certificate
    return seen, tuple(ignored)


def _claims(notes: tuple[bytes, ...]) -> Iterator[Anchor]:
    """Yield what each note in the log's file says, unverified: the log must match it.

    For those who name no key: who cuts a log off may leave its newest checkpoint in the file.
    """
    for data in notes:
        with suppress(MalformedError):  # that says nothing
            said = read_checkpoint(read_note(data, where="checkpoint").text, where="checkpoint")
            yield Anchor(by="claimed", size=said.size, head=said.chain, root=said.root)


def _require_wanted(asked: AnchorOptions, seen: list[_SeenCheckpoint], *, terminals: bool) -> None:
    """Require what naming a key or witnesses asks for: their absence is what a forger leaves.

    Raises:
        AuthenticityError: no checkpoint is signed so (`SIGNATURE_MISSING`).
    """
    if asked.quorum and max(map(_count, seen), default=0) < asked.quorum:
        most = max(map(_count, seen), default=0)
        raise _missing(f"expected cosignatures of {asked.quorum} witnesses, got {most}")
    if not seen and (asked.keys or (asked.trust is not None and not terminals)):
        raise _missing("expected a checkpoint that the named key signed")


def _count(seen: _SeenCheckpoint) -> int:
    """Return how many witnesses cosigned; one key under two names is one witness."""
    return len({attested.key.public for attested in seen.cosigned})


def _read(data: bytes, asked: AnchorOptions, *, where: str) -> _SeenCheckpoint:
    note = read_note(data, where=where)
    claimed = read_checkpoint(note.text, where=where)
    keys = tuple(key for key in asked.keys if key.name == claimed.origin)
    if not asked.keys:
        keys = _folder_keys(asked.trust, claimed)
    if not keys:
        raise _missing(f"expected a checkpoint of a named key, got one of `{claimed.origin}`")
    checkpoint = require_all(note, keys, where=where)
    return _SeenCheckpoint(checkpoint, _cosigned(note, asked.witnesses, where))


def _cosigned(note: Note, witnesses: tuple[NoteKey, ...], where: str) -> tuple[Attested, ...]:
    found = verify_note(note, witnesses, where=where)
    return tuple(attested for attested in found if attested.time_s is not None)


def _folder_keys(trust: Path | None, claimed: Checkpoint) -> tuple[NoteKey, ...]:
    """Return the log's keys that a trust folder gives."""
    if trust is None:
        raise _no_key("--log-key, or --trust")
    _, _, rest = claimed.origin.partition("/")
    robot = rest.partition("/")[0]
    if not is_identifier(robot) or claimed.origin != origin_of(RobotId(robot)):
        raise _missing(f"expected a checkpoint of a robot's log, got one of `{claimed.origin}`")
    return keys_of(trust, RobotId(robot))


def _terminal(data: bytes, trust: Path | None) -> Terminal:
    if trust is None:
        raise _no_key("--trust")
    terminal, _, _ = open_token(
        data,
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate", "witness"}),
        verifier=read_trust(trust),
        now=wall_now(None),
    )
    return terminal


def _no_key(option: str) -> EnvironmentFault:
    return EnvironmentFault(
        f"a checkpoint proves nothing without the key that signed it: name {option}",
        reason=Reason.FILE_UNAVAILABLE,
        where=option.partition(",")[0],
    )


def _missing(message: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.SIGNATURE_MISSING, where="checkpoint")
