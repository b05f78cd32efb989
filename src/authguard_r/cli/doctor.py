# SPDX-License-Identifier: Apache-2.0
"""`authguard doctor`: every unsafe or missing part of a set-up, with its mend (L7)."""

from __future__ import annotations

import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import apsw
import cryptography
import typer
from msgspec import Struct, to_builtins

from authguard_r.cli.inputs import JsonFlag, wall_now
from authguard_r.cli.out import emit
from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.trust import read_trust

_OLDEST_SQLITE = (3, 51, 3)


class Advice(Struct, frozen=True, kw_only=True):
    """One thing that was looked at.

    Args:
        part: what it is about.
        level: `ok`, `warning` (works, protects less) or `unsafe` (a real gate refuses).
        message: what was found.
        mend: what to do, empty when nothing is needed.
    """

    part: str
    level: str
    message: str
    mend: str = ""


def doctor(
    trust: Annotated[
        Path | None, typer.Option("--trust", help="A trust folder to look at.")
    ] = None,
    store: Annotated[Path | None, typer.Option("--store", help="A store to look at.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Name every unsafe or missing part of this set-up, and how to mend it."""
    advice = [*_machine()]
    if trust is not None:
        advice += _trust(trust)
    if store is not None:
        advice += _store(store)
    lines = [
        f"{a.level:8} {a.part}: {a.message}" + (f" -> {a.mend}" if a.mend else "") for a in advice
    ]
    unsafe = any(item.level == "unsafe" for item in advice)
    emit({"safe": not unsafe, "advice": [to_builtins(a) for a in advice]}, lines, as_json=as_json)
    return 5 if unsafe else 0


def _machine() -> Iterator[Advice]:
    version = ".".join(map(str, sys.version_info[:3]))
    yield Advice(part="python", level="ok", message=version)
    yield Advice(part="cryptography", level="ok", message=cryptography.__version__)
    built = apsw.sqlite_lib_version()
    sound = tuple(map(int, built.split("."))) >= _OLDEST_SQLITE
    yield Advice(
        part="sqlite",
        level="ok" if sound else "unsafe",
        message=built,
        mend="" if sound else "install apsw's own wheel: this SQLite can corrupt a WAL",
    )
    if not sys.platform.startswith("linux"):
        yield Advice(
            part="platform",
            level="unsafe",
            message=f"{sys.platform}: missions can be written and signed here, not enforced",
            mend="run the gate on Linux",
        )


def _trust(folder: Path) -> Iterator[Advice]:
    try:
        trust = read_trust(folder)
    except AuthGuardError as error:
        yield Advice(
            part="trust", level="unsafe", message=str(error), mend="authguard keys init DIR"
        )
        return
    if trust.demo:
        yield Advice(
            part="trust",
            level="warning",
            message="the root says `demo`: every private key lies in this folder",
            mend="make a set-up whose keys stay on their own machines",
        )
    now = wall_now(None)
    for key in sorted(folder.glob("keys/*.key.pem")):
        mode = stat.S_IMODE(key.stat().st_mode)
        if mode & 0o077:
            yield Advice(
                part=f"keys/{key.name}",
                level="unsafe",
                message=f"readable by others (mode {mode:o})",
                mend=f"chmod 600 {key}",
            )
    for cert in sorted(folder.glob("keys/*.cert.pem")):
        yield from _certificate(cert, folder, now.utc_ms)


def _certificate(path: Path, folder: Path, now_ms: int) -> Iterator[Advice]:
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding

    from authguard_r.core.quantities import Now, to_timestamp

    try:
        chain = x509.load_pem_x509_certificates(path.read_bytes())
        ders = tuple(c.public_bytes(Encoding.DER) for c in chain)
        leaf = read_trust(folder).identify(ders, Now(now_ms, 0))
    except (AuthGuardError, ValueError) as error:
        yield Advice(
            part=f"keys/{path.name}", level="unsafe", message=str(error), mend="issue it again"
        )
        return
    if leaf.not_after_ms - now_ms < 14 * 86_400_000:
        yield Advice(
            part=f"keys/{path.name}",
            level="warning",
            message=f"usable only until {to_timestamp(leaf.not_after_ms)}",
            mend="renew certificate and revocation lists",
        )


def _store(path: Path) -> Iterator[Advice]:
    from authguard_r.audit.verify import verify_rows
    from authguard_r.store.sqlite import read_rows

    if not path.parent.is_dir():
        yield Advice(
            part="store", level="unsafe", message=f"no folder `{path.parent}`", mend="mkdir"
        )
        return
    if not path.exists():
        yield Advice(part="store", level="ok", message="new: made when first used")
        return
    try:
        found = verify_rows(read_rows(path), terminal=None)
    except AuthGuardError as error:
        yield Advice(
            part="store", level="unsafe", message=str(error), mend="see docs/howto/store.md"
        )
        return
    level = "ok" if found.whole else "unsafe"
    yield Advice(part="store", level=level, message=found.fault or f"{found.size} records, whole")
    yield Advice(
        part="anchor",
        level="warning",
        message="a chain alone does not show that its end is missing",
        mend="keep the signed checkpoint elsewhere: audit verify --checkpoint",
    )
