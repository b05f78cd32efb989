# SPDX-License-Identifier: Apache-2.0
"""`authguard keys revoke`, `lists`, `show` and `authguard advanced revocations`.

How-to: docs/howto/keys.md
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.authoring.keys.folder import as_given
from authguard_r.authoring.keys.install import install_list
from authguard_r.authoring.keys.request import fingerprint
from authguard_r.authoring.keys.revoking import renew_lists, revoke
from authguard_r.cli.gateway import GATE_SOCKET, GateOption, connect_as, socket_in
from authguard_r.cli.inputs import JsonFlag, wall_now
from authguard_r.cli.key_answers import LIST_DAYS
from authguard_r.cli.signing_key import PassphraseFile, passphrase_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.keys.algorithms import algorithm_of
from authguard_r.keys.certificate import Leaf
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.trust import (
    ROOT_LISTS,
    Trust,
    pairs,
    read_certificates,
    read_file,
    read_trust,
)
from authguard_r.wire.messages import ClientRole
from authguard_r.wire.output import emit, emit_error, exit_code

FolderArgument = Annotated[Path, typer.Argument(help="The authority's folder.")]
ListDays = Annotated[
    int, typer.Option("--days", min=1, max=3_650, help="Days until the next update.")
]
_DAY_MS = 86_400_000


def revoke_command(
    folder: FolderArgument,
    name: Annotated[
        str | None, typer.Argument(help="A principal, with all its certificates, or an authority.")
    ] = None,
    serial: Annotated[
        int | None, typer.Option("--serial", help="One certificate by its serial number.")
    ] = None,
    authority: Annotated[
        str | None,
        typer.Option("--authority", help="With --serial: the authority of the certificate."),
    ] = None,
    days: ListDays = LIST_DAYS,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """On the authority's machine: sign the next revocation list with these certificates.

    Exit 1 when a file cannot be read that may be a further certificate of the name.
    """
    if (name is None) is (serial is None):
        raise typer.BadParameter("name a principal, or a serial number", param_hint="NAME")
    if authority is not None and serial is None:
        raise typer.BadParameter("it goes with a serial number", param_hint="--authority")
    done = revoke(
        folder,
        principal=name,
        serial=serial,
        authority=authority,
        now=datetime.now(UTC),
        days=days,
        passphrase=passphrase_of(passphrase_file),
    )
    return _tell_lists(folder, done.lists, unread=done.unread, as_json=as_json)


def lists_command(
    folder: FolderArgument,
    days: ListDays = LIST_DAYS,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """On the authority's machine: sign every revocation list again before it expires."""
    said = passphrase_of(passphrase_file)
    lists = renew_lists(folder, now=datetime.now(UTC), days=days, passphrase=said)
    return _tell_lists(folder, lists, unread=(), as_json=as_json)


def _tell_lists(
    folder: Path, lists: dict[str, RevocationList], *, unread: tuple[Path, ...], as_json: bool
) -> int:
    told: list[dict[str, Any]] = [
        {
            "file": str(folder / "revocations" / f"{name}.json"),
            "authority": name,
            "number": found.number,
            "next_update": to_timestamp(found.next_update_ms),
            "serials": sorted(str(serial) for serial in found.serials),
        }
        for name, found in sorted(lists.items())
    ]
    lines = [
        f"{item['file']}: number {item['number']}, {len(item['serials'])} revoked, "
        f"until {item['next_update']}"
        for item in told
    ]
    lines += ["bring them to every machine: authguard advanced revocations install"]
    lines += [
        f"CANNOT READ {path}: what it certified may still be valid; "
        "`--serial` with `--authority` needs no file"
        for path in unread
    ]
    emit({"lists": told, "unread": [str(path) for path in unread]}, lines, as_json=as_json)
    return 1 if unread else 0


def install_command(
    files: Annotated[list[Path], typer.Argument(help="Signed lists: `revocations/NAME.json`.")],
    gate: GateOption = None,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="A trust folder to install into; without --gate, only there."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Install newer revocation lists at a running gate and in a trust folder.

    Each list goes to each place, also when another list fails. A list that a place already has is
    no fault. Refused lists are printed at the end. The lists are signed: any user may install
    them.
    """
    faults: list[_Fault] = []
    told: list[dict[str, Any]] = []
    lists: dict[Path, bytes] = {}
    for path in files:
        with _kept(faults, str(path), "nowhere"):
            lists[path] = read_file(path)
    if gate is not None or trust is None:
        where = socket_in(gate, GATE_SOCKET)
        roles = (ClientRole.OPERATOR,)
        with _kept(faults, "every list", "gate"), connect_as(where, roles) as client:
            for path, data in lists.items():
                with _kept(faults, str(path), "gate"):
                    told.append({"at": "gate", **client.revocations(data)})
    for path, data in lists.items():
        if trust is not None:
            with _kept(faults, str(path), str(trust)):
                told.append({"at": str(trust), **_in_folder(trust, data)})
    return _tell_brought(told, faults, as_json=as_json)


class _Fault(Struct, frozen=True, kw_only=True):
    """A list that a place did not take, and why."""

    file: str
    at: str
    error: AuthGuardError


@contextmanager
def _kept(faults: list[_Fault], file: str, at: str) -> Generator[None]:
    """Keep what goes wrong for the end: the other lists and the other place wait for it."""
    try:
        yield
    except AuthGuardError as error:
        faults.append(_Fault(file=file, at=at, error=error))


def _tell_brought(told: list[dict[str, Any]], faults: list[_Fault], *, as_json: bool) -> int:
    """Say what each place has now, then what it did not take; the first fault is the exit code."""
    lines = [
        f"{item['at']}: {item['authority']} number {item['number']}, "
        f"{item['serials']} revoked, until {item['next_update']}"
        for item in told
    ]
    refused = [
        {"file": f.file, "at": f.at, "code": str(f.error.reason), "message": f.error.message}
        for f in faults
    ]
    if not faults:
        emit({"installed": told}, lines, as_json=as_json)
        return 0
    first = faults[0].error
    error = {"code": str(first.reason), "message": first.message, "where": first.where}
    emit({"installed": told, "refused": refused, "error": error}, lines, as_json=as_json)
    for fault in () if as_json else faults:
        message = f"{fault.file}, at {fault.at}: {fault.error.message}"
        emit_error(fault.error.reason, message, fault.error.where, as_json=False, code=0)
    return exit_code(first)


def _in_folder(trust: Path, data: bytes) -> dict[str, Any]:
    found = install_list(trust, data, wall_now(None))
    return {
        "authority": found.authority,
        "number": found.number,
        "next_update": to_timestamp(found.next_update_ms),
        "serials": len(found.serials),
    }


def show_command(
    folder: Annotated[Path, typer.Argument(help="A trust folder, or the authority's.")],
    as_json: JsonFlag = False,
) -> int:
    """Show who may sign what, for which robots and until when, and the age of the lists."""
    trust, now = read_trust(folder), wall_now(None)
    paths = [*sorted(folder.glob("keys/*.cert.pem")), *sorted(folder.glob("issued/*.cert.pem"))]
    found: list[dict[str, Any]] = []
    unread: dict[Path, str] = {}
    for path in paths:
        try:
            found.append(_shown(trust, path, now))
        except AuthGuardError as error:
            unread[path] = error.message
    lists = [_freshness(known, now) for known in trust.lists.values()]
    lines = [
        f"{f['principal']:24} {f['role']:16} until {f['until']}  {f['algorithm']}, {_for(f)}"
        + ("" if f["holds"] else f"  {f['why']}")
        for f in found
    ]
    lines += [
        f"{'list of ' + item['authority']:24} {'number ' + str(item['number']):16} "
        f"{'STALE since' if item['left_days'] < 0 else 'until'} {item['next_update']}  "
        f"{item['serials']} revoked"
        for item in lists
    ]
    lines += [f"CANNOT READ {path}: {why}" for path, why in unread.items()]
    root = fingerprint(trust.roots)
    lines.append(f"{'root':24} {root}")
    files = [str(path) for path in unread]
    payload = {
        "demo": trust.demo,
        "root": root,
        "principals": found,
        "lists": lists,
        "unread": files,
    }
    emit(payload, lines, as_json=as_json)
    return 0


def _shown(trust: Trust, path: Path, now: Now) -> dict[str, Any]:
    """Return what a principal's certificates say, and why they do not hold, if they do not."""
    chains = pairs(read_certificates(path, most=2 * len(ROOT_LISTS)))
    said = [_said(trust, chain, now) for chain in chains]
    leaves, first = [leaf for leaf, _ in said], said[0][0]
    above = [certificate for chain in chains for certificate in chain]
    end = min(certificate.not_valid_after_utc for certificate in (*above, *trust.roots))
    why = next((reason for _, reason in said if reason is not None), None)
    return {
        "principal": first.principal,
        "role": str(first.role),
        "algorithm": "+".join(algorithm_of(leaf.key) for leaf in leaves),
        "robot": first.robot,
        "scope": {"robots": _names(first.scope.robots), "regions": _names(first.scope.regions)},
        "serial": str(first.serial),
        "serials": [str(leaf.serial) for leaf in leaves],
        "until": f"{end:%Y-%m-%dT%H:%M:%SZ}",
        "holds": why is None,
        "why": why,
        "file": f"{path.parent.name}/{path.name}",
    }


def _said(
    trust: Trust, chain: tuple[x509.Certificate, x509.Certificate], now: Now
) -> tuple[Leaf, str | None]:
    """Return what a certificate says, or said while it held, and why it does not hold now."""
    leaf, authority = (certificate.public_bytes(Encoding.DER) for certificate in chain)
    try:
        return trust.identify((leaf, authority), now), None
    except AuthGuardError as error:
        return as_given(chain, trust), str(error.reason)


def _names(named: Iterable[str] | None) -> list[str] | None:
    return None if named is None else sorted(named)


def _for(shown: dict[str, Any]) -> str:
    """Return a scope in words; null is every scope, and an empty list is no scope."""
    said = []
    for kind in ("robot", "region"):
        named = shown["scope"][f"{kind}s"]
        said.append(f"every {kind}" if named is None else " ".join(named) or f"no {kind}")
    return ", ".join(said)


def _freshness(known: RevocationList, now: Now) -> dict[str, Any]:
    return {
        "authority": known.authority,
        "number": known.number,
        "serials": len(known.serials),
        "next_update": to_timestamp(known.next_update_ms),
        "left_days": (known.next_update_ms - now.utc_ms) // _DAY_MS,
    }
