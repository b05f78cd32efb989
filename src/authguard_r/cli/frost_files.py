# SPDX-License-Identifier: Apache-2.0
"""The files of `authguard advanced frost` as the commands read, write and show them."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.cli.signing_key import passphrase_of
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.identifiers import PrincipalId, is_identifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.frost.keys import public_key
from authguard_r.frost.messages import Ballot, Group, Share, digest, read, written
from authguard_r.frost.nonces import write_new
from authguard_r.keys.envelope import is_sealed, unseal
from authguard_r.keys.trust import read_file

T = TypeVar("T", bound=Struct)


def load(path: Path, kind: type[T]) -> T:
    """Return the object in a file.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: it holds no sound one of this kind.
    """
    return read(read_file(path), kind, where=path.name)


def load_share(path: Path, passphrase_file: Path | None = None) -> Share:
    """Return a secret share, plain or sealed; whether it fits, `require_share` says.

    Raises:
        EnvironmentFault: it cannot be read, or is sealed and there is no passphrase.
        MalformedError: it holds none.
        AuthenticityError: the passphrase is wrong, or the file was changed.
    """
    return read(opened(path, passphrase_file), Share, where=path.name)


def opened(path: Path, passphrase_file: Path | None = None) -> bytes:
    """Return what is in a file, plain or sealed.

    Raises:
        EnvironmentFault: it cannot be read, or is sealed and there is no passphrase.
        MalformedError: it is sealed and damaged.
        AuthenticityError: the passphrase is wrong, or the file was changed.
    """
    data = read_file(path)
    if not is_sealed(data):
        return data
    said = passphrase_of(passphrase_file)
    if said is None:
        raise EnvironmentFault(
            "the share is encrypted: name the file with its passphrase, --passphrase-file",
            reason=Reason.KEY_INVALID,
            where=str(path),
        )
    return unseal(data, said(str(path)), where=str(path))


def load_all(paths: tuple[Path, ...], kind: type[T]) -> tuple[T, ...]:
    """Return the objects in several files."""
    return tuple(load(path, kind) for path in paths)


def store(path: Path, value: Struct) -> None:
    """Write a new file that only its owner can read.

    Raises:
        StoreError: it is there already, or cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_new(path, written(value))


def names(members: tuple[str, ...]) -> tuple[PrincipalId, ...]:
    """Return members as principals.

    Raises:
        MalformedError: one is no identifier.
    """
    for name in members:
        if not is_identifier(name):
            raise MalformedError(f"expected an identifier, got `{name}`", where="--member")
    return tuple(map(PrincipalId, members))


def impossible(error: ValueError) -> MalformedError:
    """Return what is wrong with a group that cannot be."""
    return MalformedError(str(error), where="group")


def owner(share: Share) -> PrincipalId:
    """Return whose share it is."""
    return share.group.members[share.identifier - 1]


def require_absent(*paths: Path) -> None:
    """Require that nothing would be written over, before anything is made.

    Raises:
        EnvironmentFault: a file is there.
    """
    for path in paths:
        if path.exists():
            raise EnvironmentFault(
                f"expected no file `{path}`", reason=Reason.FILE_UNAVAILABLE, where=str(path)
            )


def group_lines(group: Group) -> list[str]:
    """Return a group for people; two people who compare equal digests have the same group."""
    return [
        f"{group.id}: {group.threshold} of {len(group.members)} sign together",
        *(f"  {place} {name}" for place, name in enumerate(group.members, 1)),
        f"key {public_key(group).hex()}",
        f"digest {digest(group)}",
    ]


def ballot_lines(ballot: Ballot) -> list[str]:
    """Return what would be signed, from the very values that are hashed."""
    approval, scope = ballot.approval, ballot.scope
    answer = "APPROVE" if approval.verdict is ApprovalVerdict.APPROVE else "DENY"
    places = (("object", scope.object), ("from", scope.source), ("to", scope.destination))
    return [
        f"{answer} this one action of robot {approval.rid}:",
        f"  {scope.type} with {scope.tool}",
        *(f"  {name} {value}" for name, value in places if value is not None),
        *([f"  by way of {', '.join(scope.route)}"] if scope.route else []),
        *(f"  {name} {value}" for name, value in sorted(scope.params.items())),
        f"mission {approval.mid} version {approval.version}, grant {approval.grant}",
        f"  digest {approval.mission}",
        f"risk tier {ballot.situation.tier}; {_held(ballot.situation.guards)}",
        f"request {approval.counter}, expires {to_timestamp(approval.expires_ms)}",
    ]


def _held(guards: tuple[bool, ...]) -> str:
    """Return how many of the mission's and the grant's conditions held."""
    return f"{sum(guards)} of {len(guards)} conditions held" if guards else "no conditions"


def plain(value: Struct) -> object:
    """Return an object as it is printed; never called with a secret."""
    return msgspec.to_builtins(value)
