# SPDX-License-Identifier: Apache-2.0
"""The honest side of the audit-tampering game: a gate's log, its witnesses, an auditor, the truth.

A real gate writes, its own key signs checkpoints, real witnesses cosign them. The auditor is the
product: `known_of` for checkpoints, `verify_rows` for records. The truth is told by a comparison
with what the gate wrote, which no auditor has.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import msgspec
from msgspec import Struct

import sealed
import worlds
from authguard_r.anchoring.checkpoints import Checkpoints
from authguard_r.anchoring.witnesses import request
from authguard_r.assembly import folder_signer
from authguard_r.audit.boxes import DataClass
from authguard_r.audit.checkpoint import origin_of
from authguard_r.audit.note import (
    Note,
    NoteKey,
    NoteSignature,
    read_key,
    read_signatures,
)
from authguard_r.audit.record import read_sealed
from authguard_r.audit.verify import Anchor, Row, verify_rows
from authguard_r.cli.log_anchors import Asked, known_of
from authguard_r.cli.log_reading import reading
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.notes import cosign, leaf_key, log_key
from authguard_r.keys.signer import FileSigner, SigningKey
from authguard_r.witness.desk import Witness, make_witness, open_witness, register
from authguard_r.witness.rules import Finding, Log, judge, read_request

#: Witnesses, and how many of them an auditor asks for.
WITNESSES, QUORUM = 5, 3
TIME_S = worlds.START_MS // 1_000
GOALS = ("station-103", "pharmacy", "office-1", "station-101", "plant-room", "dock")


class Honest(Struct, frozen=True):
    """A witness that keeps to its rules: what it has signed, and the key it signs with."""

    name: str
    key: SigningKey
    named: NoteKey
    log: Log

    def ask(self, body: bytes) -> tuple[Finding, NoteSignature | None]:
        """Return its answer to a request, and its cosignature if it gives one."""
        asked = read_request(body)
        found = judge(asked, self.log).finding
        if found is not Finding.COSIGNED:
            return found, None
        return found, cosign(asked.note.text, self.name, self.key, TIME_S)


class Genuine(Struct, frozen=True):
    """What really happened.

    Args:
        robot: whose log it is.
        rows: as the gate wrote them.
        notes: under each size, the checkpoint that every witness cosigned.
        signer: the gate's own.
        keys: the log's.
        witnesses: as they are after the newest checkpoint.
        folder: for files.
    """

    robot: RobotId
    rows: tuple[Row, ...]
    notes: dict[int, Note]
    signer: FileSigner
    keys: tuple[NoteKey, ...]
    witnesses: tuple[Honest, ...]
    folder: Path

    @property
    def size(self) -> int:
        """How many records there are; the newest checkpoint covers them."""
        return len(self.rows)

    def kept(self, size: int | None = None) -> Path:
        """Return the file in which an auditor keeps a checkpoint, the newest unless it says."""
        at = self.size if size is None else size
        path = self.folder / f"kept-{at}.note"
        if not path.exists():
            path.write_bytes(self.notes[at].encode())
        return path


@cache
def genuine(
    records: int, step: int, robot: RobotId = worlds.RID, *, seals: bool = False
) -> Genuine:
    """Return the log of a gate that decided, refused, stopped and changed missions.

    Args:
        records: how many at least; a decision makes several.
        step: a checkpoint about every so many of them, and one at the end.
        robot: whose.
        seals: for an auditor, and a porter who reads regions alone.
    """
    folder = Path(mkdtemp(prefix="authguard-game-"))
    signer = folder_signer(worlds.trust_folder(), f"gate-{robot}")
    keys = (log_key(origin_of(robot), leaf_key(signer.chain)),)
    notes: dict[int, Note] = {}
    rnd = Random(records)
    with ExitStack() as stack:
        if seals:
            readers = (sealed.reader("auditor"), sealed.reader("porter", DataClass.REGION))
            sealing = sealed.sealing(folder / "robot.db", sealed.policy(*readers), rid=robot)
            sim = stack.enter_context(sealing)
        else:
            sim = worlds.simulation(rid=robot)
        checkpoints = Checkpoints(sim.gate.ledger, robot=robot, signer=signer)
        witnesses = [stack.enter_context(_Open(folder, n, keys)) for n in range(WITNESSES)]
        if robot == worlds.RID:
            sim.gate.management.activate(worlds.token())
        while _size(sim) < records:
            for _ in range(step):
                if _size(sim) >= records:
                    break
                if rnd.random() < 0.3:
                    sim.gate.enforcer.stop(by="person", is_planner=rnd.random() < 0.2)
                sim.robot.state = worlds.world("dock")
                worlds.propose(sim, worlds.navigate("dock", rnd.choice(GOALS)))
            old = max(notes, default=0)
            checkpoints.make()
            assert checkpoints.newest is not None
            body = request(old, checkpoints.proof(old, checkpoints.size), checkpoints.newest)
            answers = [witness.answer(body, TIME_S) for witness in witnesses]
            assert {answer.status for answer in answers} == {200}
            made = [read_signatures(answer.body, where="")[0] for answer in answers]
            newest = checkpoints.newest
            notes[checkpoints.size] = Note(newest.text, (*newest.signatures, *made))
        seen = tuple(map(_honest, witnesses, [keys[0].name] * WITNESSES))
        size = _size(sim)
        rows = tuple(Row(*row) for row in sim.gate.ledger.peek(lambda turn: turn.rows(0, size)))
    assert {one.log.size for one in seen} == {len(rows)} == {max(notes)}
    return Genuine(robot, rows, notes, signer, keys, seen, folder)


class _Open:
    """A witness of its own, in its folder, for as long as it is entered."""

    def __init__(self, folder: Path, number: int, keys: tuple[NoteKey, ...]) -> None:
        path = folder / f"witness-{number}"
        make_witness(path, name=f"witness-{number}", algorithm=Algorithm.ED25519, mark=None)
        register(path, tuple(key.text() for key in keys), TIME_S, again=False)
        self._witness = open_witness(path)

    def __enter__(self) -> Witness:
        return self._witness

    def __exit__(self, *_: object) -> None:
        self._witness.close()


def _honest(witness: Witness, origin: str) -> Honest:
    log = witness.book.log(origin)
    assert log is not None
    key = read_key(witness.book.identity.key, where="witness")
    return Honest(witness.name, witness._key, key, log)


def _size(sim) -> int:  # type: ignore[no-untyped-def]
    return sim.gate.ledger.peek(lambda turn: turn.head())[0]  # type: ignore[no-any-return]


# what an adversary hands over


class Forged(Struct, frozen=True):
    """A log as an adversary hands it over: rows, and the notes that lie with them."""

    rows: tuple[Row, ...]
    notes: tuple[bytes, ...] = ()


# the auditor


class Told(Struct, frozen=True, kw_only=True):
    """What the auditor was told in the end.

    Args:
        whole: nothing was found: the log was accepted.
        anchored: what vouches for it.
        size: for how many records.
        witnessed: for how many of them enough witnesses do.
        where: what was named.
        refused: the reason, where nothing was even read.
    """

    whole: bool
    anchored: str = ""
    size: int = 0
    witnessed: int = 0
    where: str = ""
    refused: str = ""


class Auditor(Struct, frozen=True, kw_only=True):
    """Somebody who trusts neither the robot nor its owner.

    Args:
        keys: the log's, from somebody he trusts.
        witnesses: theirs.
        quorum: how many of them he asks for.
        kept: files of checkpoints that he has from before.
    """

    keys: tuple[NoteKey, ...]
    witnesses: tuple[NoteKey, ...] = ()
    quorum: int = 0
    kept: tuple[Path, ...] = ()

    def hears(self, forged: Forged) -> Told:
        """Return the answer to a log that was handed over."""
        try:
            return self._answer(forged.rows, forged.notes)
        except AuthGuardError as error:
            return Told(whole=False, refused=str(error.reason))

    def reads(self, path: Path) -> Told:
        """Return the answer to a log that was handed over as a file: a store, or an export."""
        try:
            with reading(path) as log:
                return self._answer(log.rows, log.notes)
        except AuthGuardError as error:
            return Told(whole=False, refused=str(error.reason))

    def knows(self, notes: tuple[bytes, ...] = ()) -> tuple[Anchor, ...]:
        """Return what he holds against a log that comes with these notes."""
        asked = Asked(keys=self.keys, witnesses=self.witnesses, quorum=self.quorum, kept=self.kept)
        return _anchors_of(asked, notes, tuple(path.read_bytes() for path in self.kept))

    def _answer(self, rows, notes) -> Told:  # type: ignore[no-untyped-def]
        found = verify_rows(rows, anchors=self.knows(notes))
        return Told(
            whole=found.whole,
            anchored=found.anchored,
            size=found.anchored_size,
            witnessed=max((size for by, size in found.anchors if by == "witnessed"), default=0),
            where=found.where,
        )


@cache
def _anchors_of(
    asked: Asked,
    notes: tuple[bytes, ...],
    files: tuple[bytes, ...],
) -> tuple[Anchor, ...]:
    """Return what is known: a game asks the same of thousands of logs.

    Args:
        asked: what the auditor named.
        notes: those that came with the log.
        files: what the paths of `asked` hold now: they may hold something else later.
    """
    return known_of(asked, notes).anchors


def auditor(log: Genuine, *, kept: int | None = None) -> Auditor:
    """Return an auditor with every key; with a checkpoint of this size, or with none."""
    return Auditor(
        keys=log.keys,
        witnesses=tuple(one.named for one in log.witnesses),
        quorum=QUORUM,
        kept=() if kept is None else (log.kept(kept),),
    )


# the truth


def same(row: Row, genuine: Row) -> bool:
    """Return whether a row is the one that was written, values that were destroyed apart."""
    if row == genuine:
        return True
    if (row.seq, row.record, row.link) != (genuine.seq, genuine.record, genuine.link):
        return False
    return row.sealed in (b"{}", genuine.sealed) or is_part(row.sealed, genuine.sealed)


def is_part(sealed: bytes, genuine: bytes) -> bool:
    """Return whether these are some of the values, each as it was."""
    try:
        left, whole = read_sealed(sealed, where=""), read_sealed(genuine, where="")
    except MalformedError:
        return False
    return (
        sealed == encode_fast({n: whole[n] for n in whole if n in left})
        and left.items() <= whole.items()
    )


def first_touched(rows: tuple[Row, ...], log: Genuine) -> int:
    """Return the number of the first record that is not what was written; none: all there were."""
    pairs = zip(rows, log.rows, strict=False)
    wrong = (number for number, (row, was) in enumerate(pairs) if not same(row, was))
    return next(wrong, min(len(rows), log.size))


def is_lost(
    told: Told, forged: Forged, log: Genuine, *, kept: int = 0, owned: bool = False
) -> bool:
    """Return whether the adversary won: the auditor took for genuine what is not.

    He is told for how many records somebody vouches. All of these have to be what was written, and
    no fewer than he knew of. A checkpoint that the gate's key made after the newest one speaks of
    more; then everything that was written has to be in front.

    Args:
        told: the answer.
        forged: what was handed over.
        log: what really happened.
        kept: how many records the auditor knew of.
        owned: the log's own key was the adversary's: what it alone vouches for is told as that,
            and only the witnesses' word counts.
    """
    if not told.whole:
        return False
    first, size = first_touched(forged.rows, log), told.witnessed if owned else told.size
    if size > log.size:
        return first < log.size
    return size < max(kept, 1) or first < size


def rows_of(rows: list[Row]) -> tuple[Row, ...]:
    """Return rows that are numbered as they lie: what a store's file cannot help doing."""
    return tuple(msgspec.structs.replace(row, seq=seq) for seq, row in enumerate(rows))
