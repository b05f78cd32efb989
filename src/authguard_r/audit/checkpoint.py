# SPDX-License-Identifier: Apache-2.0
"""A checkpoint: how long a log was, the root of its tree, and where its chain ended.

It is useful when it is kept where writers of the log cannot change it: by a witness, an auditor or
an outside counter. The text is C2SP's tlog-checkpoint with one extension line. Spec page:
docs/spec/checkpoint.md
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.audit.note import decode64, encode64
from authguard_r.audit.tree import HASH_BYTES
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId

#: Begins the extension line with L_{size-1}.
_CHAIN = "chain "
#: Most records that a checkpoint may speak of.
_MOST = (1 << 53) - 1


class Checkpoint(Struct, frozen=True, kw_only=True):
    """What a checkpoint says, signed or not.

    Args:
        origin: which log; `origin_of` a robot's.
        size: number of records.
        root: of the tree over their links, 32 bytes.
        chain: L_{size-1}; None in a checkpoint of another program's log.
    """

    origin: str
    size: int
    root: bytes
    chain: bytes | None = None

    def text(self) -> str:
        """Return the note's text."""
        lines = [self.origin, str(self.size), encode64(self.root)]
        lines += [] if self.chain is None else [_CHAIN + encode64(self.chain)]
        return "".join(f"{line}\n" for line in lines)


def origin_of(robot: RobotId) -> str:
    """Return the name of a robot's log; also the name of the keys that sign its checkpoints."""
    return f"authguard-r/{robot}/audit"


def read_checkpoint(text: str, *, where: str) -> Checkpoint:
    """Return what a note's text says as a checkpoint.

    Extension lines of others are theirs, and stay unread.

    Raises:
        MalformedError: it is no checkpoint.
    """
    lines = text.split("\n")
    if len(lines) < 4 or lines.pop() != "" or not all(lines):
        raise MalformedError("expected origin, size and root, a line each", where=where)
    origin, size, root, *more = lines
    chains = [line.removeprefix(_CHAIN) for line in more if line.startswith(_CHAIN)]
    if len(chains) > 1:
        raise MalformedError("expected one `chain` line", where=where)
    return Checkpoint(
        origin=origin,
        size=read_size(size, where=where),
        root=_hash(root, where),
        chain=_hash(chains[0], where) if chains else None,
    )


def read_size(text: str, *, where: str) -> int:
    """Return a number of records in decimal, spelled in the one way.

    Raises:
        MalformedError: it is no checkpoint.
    """
    if not (text.isascii() and text.isdigit()) or len(text) > 16:
        raise MalformedError("expected a number of records", where=where)
    size = int(text)
    if str(size) != text or size > _MOST:
        raise MalformedError("expected a number of records without leading zeros", where=where)
    return size


def _hash(text: str, where: str) -> bytes:
    data = decode64(text, where=where)
    if len(data) != HASH_BYTES:
        raise MalformedError(f"expected a hash of {HASH_BYTES} bytes", where=where)
    return data
