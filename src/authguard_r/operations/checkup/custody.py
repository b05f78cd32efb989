# SPDX-License-Identifier: Apache-2.0
"""Who can read the keys, and who can put something else in the place of a file.

A mode says what the system enforces; access lists beyond modes are not looked at.
How-to: docs/howto/deploy.md
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from types import MappingProxyType

from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.certificate import Role, read_claims
from authguard_r.keys.files import holds_key, holds_plain_key
from authguard_r.keys.loading import load_pem
from authguard_r.keys.signer import read_keys
from authguard_r.operations.checkup.advice import Advice, AdviceCode, fine, unsafe, warning

#: Most files that are looked through for keys in one folder.
_MOST_FILES = 4_096
#: Whose key can have a passphrase: a person can be asked.
_PEOPLE = frozenset({Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER, Role.SITE_AUTHORITY})
#: Where no trust folder says whose keys are an authority's.
_NOBODY: Mapping[bytes, str] = MappingProxyType({})
KEY_END, CERTIFICATE_END = ".key.pem", ".cert.pem"


def key_advice(path: Path, *, uid: int | None) -> Iterator[Advice]:
    """Yield whether a private key is its own user's alone.

    Args:
        path: the key.
        uid: the user that the gate runs as, for the gate's own key; None: it is another's.
    """
    part, place = f"keys/{path.name}", str(path)
    try:
        found = path.stat()
    except OSError as error:
        yield _absent(part, path, error)
        return
    mode = stat.S_IMODE(found.st_mode)
    if mode & 0o077:
        yield unsafe(
            part,
            AdviceCode.KEY_MODE,
            f"readable by others (mode {mode:o})",
            place=place,
            mend=f"chmod 600 {path}",
        )
    elif uid is not None and found.st_uid != uid:
        yield unsafe(
            part,
            AdviceCode.KEY_OWNER,
            f"owned by user {found.st_uid}, and the gate runs as {uid}",
            place=place,
            mend=f"chown {uid} {path}",
        )
    elif uid is not None:
        yield fine(part, AdviceCode.KEY_MODE, "only its user may read it", place=place)


def plain_advice(path: Path) -> Iterator[Advice]:
    """Yield that a person's key lies open: a copy of the file, or of a backup, is the key.

    A service's key is plain and has to be: no person is there to ask.
    """
    if holds_plain_key(path) and (role := role_of(path)) in _PEOPLE:
        yield warning(
            f"keys/{path.name}",
            AdviceCode.KEY_PLAIN,
            f"a person's key, of role `{role}`, in a plain file",
            place=str(path),
            mend=f"authguard keys protect {path}",
        )


def file_advice(part: str, path: Path, *, uid: int, secret: bool = False) -> Iterator[Advice]:
    """Yield whether others could change a file, or with `secret` read it.

    Args:
        part: what the file is, for people.
        path: the file.
        uid: the user that the gate runs as; it and root may own what the gate trusts.
        secret: others should not read it either.
    """
    try:
        found = path.stat()
    except OSError as error:
        yield _absent(part, path, error)
        return
    yield from _status_advice(part, path, found, uid=uid)
    mode = stat.S_IMODE(found.st_mode)
    if secret and mode & 0o044:
        yield warning(
            part,
            AdviceCode.READABLE,
            f"readable by others (mode {mode:o}); its contents are not encrypted",
            place=str(path),
            mend=f"chmod go-rwx {path}",
        )


def folder_advice(paths: Iterable[Path], *, uid: int) -> Iterator[Advice]:
    """Yield every folder on the way to the paths in which others could swap what lies there.

    In a folder with the sticky bit, like `/tmp`, a user cannot touch what another user put there.
    """
    folders = {f for p in paths for f in (*p.absolute().parents, *p.resolve().parents)}
    for folder in sorted(folders):
        try:
            found = folder.stat()
        except OSError:
            continue  # what does not exist holds nothing yet
        yield from _status_advice("folder", folder, found, uid=uid)


def _status_advice(part: str, path: Path, found: os.stat_result, *, uid: int) -> Iterator[Advice]:
    mode = stat.S_IMODE(found.st_mode)
    # the group of root is root's; the members of any other group are not checked here
    others = mode & (0o022 if found.st_gid != 0 else 0o002)
    sticky = stat.S_ISDIR(found.st_mode) and mode & stat.S_ISVTX
    if others and not sticky:
        yield unsafe(
            part,
            AdviceCode.WRITABLE,
            f"writable by others (mode {mode:o})",
            place=str(path),
            mend=f"chmod go-w {path}",
        )
    if found.st_uid not in {0, uid}:
        yield unsafe(
            part,
            AdviceCode.OWNER,
            f"owned by user {found.st_uid}, and the gate runs as {uid}",
            place=str(path),
            mend=f"chown {uid} {path}",
        )


def stray_advice(
    folders: Iterable[Path],
    *,
    own: Path | None,
    uid: int,
    flat: Iterable[Path] = (),
    authorities: Mapping[bytes, str] = _NOBODY,
) -> Iterator[Advice]:
    """Yield every private key that lies where the gate can use it and is not the gate's own.

    An estimator works on the robot too; its key is no stray while another user owns it alone.

    Args:
        folders: what to look through, with everything below.
        own: the gate's key; None when it is unknown, so only what is certainly another's is
            reported.
        uid: the user that the gate runs as.
        flat: what to look through without what is below.
        authorities: names of roots and authorities by their public keys.
    """
    found = [path for folder in folders for path in _keys_in(folder.rglob("*"))]
    found += [path for folder in flat for path in _keys_in(folder.glob("*"))]
    mine = None if own is None else own.resolve()
    for real, path in sorted({path.resolve(): path for path in found}.items()):
        if real == mine:
            continue
        role, authority = role_of(path), _authority_of(path, authorities)
        known = authority is not None or role not in {None, Role.GATE, Role.ESTIMATOR}
        if (own is None and not known) or (role is Role.ESTIMATOR and _is_anothers(path, uid)):
            continue
        yield unsafe(
            "stray key",
            AdviceCode.STRAY_KEY,
            f"a private key on the gate's machine, {_whose(role, authority)}",
            place=str(path),
            mend=f"move {path} to the machine where it signs",
        )


def authority_key_advice(folder: Path, authorities: Mapping[bytes, str]) -> Iterator[Advice]:
    """Yield every authority's private key in a trust folder, where no gate was named beside it.

    Under its own name it is at home on the authority's machine, and nowhere else; which machine
    this is, a folder does not say.

    Args:
        folder: the trust folder.
        authorities: names of roots and authorities by their public keys.
    """
    for path in sorted(_keys_in(folder.rglob("*"))):
        name = _authority_of(path, authorities)
        if name is None:
            continue
        home = path.parent == folder / "keys" and path.name == f"{name}{KEY_END}"
        yield (warning if home else unsafe)(
            "stray key",
            AdviceCode.STRAY_KEY,
            f"the private key {_whose(None, name)}",
            place=str(path),
            mend=f"on any machine but the authority's own: move {path} there",
        )


def _whose(role: Role | None, authority: str | None) -> str:
    if authority is not None:
        return f"of the authority `{authority}`: anyone who has it can act as anyone"
    return "whose it is, nothing here says" if role is None else f"of role `{role}`"


def _authority_of(path: Path, authorities: Mapping[bytes, str]) -> str | None:
    """Return the authority whose private key a file holds, if it is one's and can be read."""
    try:
        keys = read_keys(path.read_bytes(), path) if authorities else ()
    except (OSError, AuthGuardError):
        return None
    names = (authorities.get(key.public_key().public_bytes_raw()) for key in keys)
    return next((name for name in names if name is not None), None)


def _keys_in(paths: Iterable[Path]) -> Iterator[Path]:
    for path in islice(paths, _MOST_FILES):
        if path.is_file() and holds_key(path):
            yield path


def role_of(key: Path | None, chain: Path | None = None) -> Role | None:
    """Return what a key's certificate claims; it decides only what people see.

    Args:
        key: the key.
        chain: its certificate; None: the one beside it.
    """
    if chain is None and key is not None:
        chain = key.with_name(key.name.removesuffix(KEY_END) + CERTIFICATE_END)
    if chain is None:
        return None
    try:
        leaf = load_pem(chain.read_bytes(), where=str(chain))[0]
        return read_claims(leaf.public_bytes(Encoding.DER)).role
    except (OSError, AuthGuardError):
        return None


def _is_anothers(path: Path, uid: int) -> bool:
    found = path.stat()
    return found.st_uid not in {uid, 0} and not stat.S_IMODE(found.st_mode) & 0o077


def _absent(part: str, path: Path, error: OSError) -> Advice:
    return unsafe(
        part,
        AdviceCode.MISSING,
        f"cannot be looked at: {error.strerror}",
        place=str(path),
        mend="name a file that is there",
    )
