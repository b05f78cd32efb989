# SPDX-License-Identifier: Apache-2.0
"""A store looked at without a gate: who can write it, whether it is whole, how it is anchored.

How-to: docs/howto/store.md
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import apsw

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.checkpoints import CHECKPOINT, NEWEST, WITNESSED
from authguard_r.audit.record import read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import decode
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now
from authguard_r.operations.checkup.advice import Advice, AdviceCode, fine, unsafe, warning
from authguard_r.operations.checkup.custody import file_advice
from authguard_r.store.clocks import SIMULATED
from authguard_r.store.sqlite import read_held, read_rows
from authguard_r.store.transactions import ClockWatermark
from authguard_r.wire.gate_limits import LIMITS

_HELP = "see docs/howto/store.md"


def store_advice(path: Path, now: Now, *, uid: int, deep: bool) -> Iterator[Advice]:
    """Yield what is to be said of a store.

    Args:
        path: its file; its folder exists.
        now: the wall clock.
        uid: the user that the gate runs as.
        deep: hold the whole log to its own links.
    """
    if not path.exists():
        message = "does not exist yet: a gate makes it when it first starts"
        mend = f"if there should be one, name it in the place of {path}"
        yield warning("store", AdviceCode.STORE, message, place=str(path), mend=mend)
        return
    beside = (path.with_name(f"{path.name}{end}") for end in ("-wal", "-shm"))
    segments = path.with_name(f"{path.name}.segments").glob("*.db")
    for file in (path, *beside, *sorted(segments)):
        if file.exists():
            yield from file_advice("store", file, uid=uid, secret=True)
    try:
        if deep:
            yield _chain(path)
        yield from _clock(path, now)
    except AuthGuardError as error:
        yield _unusable(path, error)
        return
    yield _anchor(path)


def _chain(path: Path) -> Advice:
    found = verify_rows(read_rows(path), terminal=None)
    if found.whole:
        return fine("store", AdviceCode.STORE, f"{found.size} records, whole", place=str(path))
    return unsafe(
        "store", AdviceCode.STORE, found.fault, place=f"{path}: {found.where}", mend=_HELP
    )


def _clock(path: Path, now: Now) -> Iterator[Advice]:
    """The wall clock must not be behind what was committed; a simulated log has its own time."""
    first, held = next(iter(read_rows(path)), None), read_held(path, "clock", "high")
    if first is None or held is None:
        return
    if read_record(first.record, where="record 0").open.get("clock") == SIMULATED:
        return
    behind = decode(held, ClockWatermark, where="store.clock").utc_ms - now.utc_ms
    if behind > LIMITS.skew_ms:
        yield unsafe(
            "clock",
            AdviceCode.CLOCK_BEHIND,
            f"{behind} ms behind the last commit: everything but stops is refused",
            place=str(path),
            mend="set the clock, or wait",
        )


def _unusable(path: Path, error: AuthGuardError) -> Advice:
    if isinstance(error.__cause__, apsw.BusyError | apsw.LockedError):
        return warning(
            "store",
            AdviceCode.STORE,
            "a running gate has it open, so its log was not checked",
            place=str(path),
            mend="authguard status asks the gate; look again when it has ended",
        )
    return unsafe("store", AdviceCode.STORE, str(error), place=str(path), mend=_HELP)


def witness_advice(config: GateConfig) -> Iterator[Advice]:
    """Yield what a gate's witnesses are worth."""
    many, quorum = len(config.witnesses), config.quorum
    if not many:
        return
    here = [place.url for place in config.witnesses if place.url.startswith("http:")]
    if many - len(here) < quorum:
        message = "the quorum needs a witness on this machine: root here puts back both"
        mend = "let witnesses of another operator be enough: docs/howto/witness.md"
        yield warning("witness", AdviceCode.WITNESS, message, place=", ".join(here), mend=mend)
    if 2 * quorum <= many:
        message = f"{quorum} of {many}: two logs can be witnessed at a time, each by others"
        mend = "let more than half have to agree"
        yield warning("witness", AdviceCode.WITNESS, message, place="gate.quorum", mend=mend)
    else:
        yield fine("witness", AdviceCode.WITNESS, f"{quorum} of {many} have to agree")


def counter_advice(counter: Path | None, store: Path, *, witnessed: bool = False) -> Advice:
    """Return what the outside counter of a store is worth.

    Args:
        counter: its file, None without one.
        store: the store's file.
        witnessed: there are witnesses, who do as well.
    """
    if counter is None and witnessed:
        return fine("counter", AdviceCode.COUNTER, "none; witnesses say how far the log has come")
    if counter is None:
        message = "no outside counter: a store that is rolled back, or deleted, is not noticed"
        mend = "authguard gate --counter FILE, or witnesses: docs/howto/rollback.md"
        return warning("counter", AdviceCode.COUNTER, message, place=str(store), mend=mend)
    place, folder = str(counter), counter.parent
    if not folder.is_dir():
        message = "its folder is not there: a gate that cannot read it decides nothing"
        mend = f"mount it, or: mkdir -m 700 {folder}"
        return unsafe("counter", AdviceCode.COUNTER, message, place=place, mend=mend)
    if folder.stat().st_dev == store.parent.stat().st_dev:
        message = "on the same file system as the store: a snapshot puts both back"
        mend = "keep it on another mount"
        return warning("counter", AdviceCode.COUNTER, message, place=place, mend=mend)
    return fine("counter", AdviceCode.COUNTER, "outside of the store's file system", place=place)


def _anchor(path: Path) -> Advice:
    beside = path.with_suffix(".checkpoint")
    told = "unanchored: a chain alone does not show that its end is missing"
    if read_held(path, CHECKPOINT, WITNESSED):
        told = "cosigned by witnesses; audit verify says how far, given their keys"
        return fine("anchor", AdviceCode.ANCHOR, told, place=str(path))
    if beside.is_file() or read_held(path, CHECKPOINT, NEWEST):
        told = (
            "its checkpoint is where the store is: anyone who can write one can replace the other"
        )
    return warning(
        "anchor",
        AdviceCode.ANCHOR,
        told,
        place=str(path),
        mend="keep the signed checkpoint elsewhere: audit verify --checkpoint",
    )
