# SPDX-License-Identifier: Apache-2.0
"""LogGame: with the whole log in hand, the adversary changes it and keeps the anchor's approval.

The anchor is what an auditor has from elsewhere: the log's verifier key, the witnesses' keys and
how many of them he asks for, and in most rounds the newest checkpoint that they cosigned. He loses
when he takes for genuine what the gate did not write, or too little of it. The adversary may have
the log's own key, and those of fewer witnesses than are asked for.

Source: section "Audit-Tampering Game", theorem "Tamper evidence of the anchored log".
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import chain, combinations
from pathlib import Path
from random import Random

import apsw
import msgspec
import pytest

from authguard_r.audit.note import NoteKey
from authguard_r.audit.record import BOX, WRAP, LogRow, Sealed, Terminal, read_record, read_sealed
from authguard_r.audit.verify import Verification, of_checkpoint, verify_rows
from authguard_r.auditor.export_format import note_line, row_line
from authguard_r.cli.log_reading import reading
from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.quantities import Now
from authguard_r.core.token import open_token
from authguard_r.server.wiring import sign_terminal
from authguard_r.store.sqlite import open_store
from authguard_r.witness.rules import RequestFinding, WitnessedLog
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.audit_game import (
    QUORUM,
    WITNESSES,
    Auditor,
    Forged,
    Genuine,
    Honest,
    Told,
    auditor,
    first_touched,
    genuine,
    is_lost,
    same,
)
from fixtures.small_logs import checkpoint_of, rechained
from fixtures.tampering import (
    ATTACKS,
    Hands,
    chain_edit,
    changed_rows,
    destroy,
    destroy_all,
    forgers,
    fork,
    painted,
    random_forgery,
    random_hands,
)
from fixtures.verification_checks import CHECKS, plain

SEED = os.environ.get("AUTHGUARD_SEED", "20260")
#: Random rounds by default, and in a campaign.
ROUNDS, CAMPAIGN = amount(600, 2_000), int(os.environ.get("AUTHGUARD_ROUNDS", "100000"))
#: Fewer than the witnesses that are asked for.
FEW = QUORUM - 1


@cache
def log() -> Genuine:
    """Return the log of a real gate, long enough for several checkpoints."""
    return genuine(200, 25)


@cache
def short() -> Genuine:
    return genuine(60, 9)


@cache
def tiny() -> Genuine:
    return genuine(24, 5)


@cache
def closed() -> Genuine:
    """Return the log of a gate that seals: boxes for its readers, and their keys wrapped."""
    return genuine(60, 9, seals=True)


@cache
def tiny_closed() -> Genuine:
    return genuine(24, 5, seals=True)


def newest(of: Genuine) -> tuple[bytes, ...]:
    return (of.notes[of.size].encode(),)


def places(name: str, of: Genuine) -> list[tuple[int, Forged]]:
    """Return what an attack makes of a log, at every record where it can be done."""
    made = [(at, ATTACKS[name].make(list(of.rows), at)) for at in range(of.size)]
    found = [(at, Forged(tuple(rows), newest(of))) for at, rows in made if rows is not None]
    assert found
    return found


# the records


def named(name: str, forged: Forged, of: Genuine) -> str:
    """Return what has to be named, with a checkpoint of everything and none before."""
    first, kind = first_touched(forged.rows, of), ATTACKS[name].named
    if kind == "exact":
        return f"record {first}"
    if kind == "end":
        return f"record {len(forged.rows)}"
    if kind == "next" and first < of.size - 1:
        return f"record {first + 1}"
    return f"records 0 to {of.size - 1}"


@pytest.mark.complete
@pytest.mark.parametrize("of", [log, closed])
@pytest.mark.parametrize("name", ATTACKS)
def test_no_attack_on_any_record_keeps_the_anchor_and_the_first_is_named(
    name: str, of: Callable[[], Genuine]
) -> None:
    honest = auditor(of(), kept=of().size)
    for at, forged in places(name, of()):
        told = honest.hears(forged)
        assert not told.whole, (name, at)
        assert told.where == named(name, forged, of()), (name, at)


@pytest.mark.parametrize("name", ATTACKS)
def test_a_checkpoint_after_every_record_names_the_very_first_that_was_touched(name: str) -> None:
    rows = list(tiny().rows)
    every = [of_checkpoint(checkpoint_of(rows[:size], scenarios.RID)) for size in range(1, 25)]
    for at, forged in places(name, tiny()):
        found = verify_rows(forged.rows, anchors=every)
        assert found.where == f"record {first_touched(forged.rows, tiny())}", (name, at)


@pytest.mark.complete
@pytest.mark.parametrize("log_of", [tiny, tiny_closed])
@pytest.mark.parametrize("name", ATTACKS)
def test_without_the_checks_that_find_it_the_attack_wins(
    name: str, log_of: Callable[[], Genuine]
) -> None:
    """And any one of them is enough, somewhere: none of them is there for nothing."""
    of, caught = log_of(), ATTACKS[name].caught
    anchors = auditor(of, kept=of.size).knows()
    found = dict.fromkeys(caught, 0)
    for at, forged in places(name, of):
        assert plain(forged.rows, anchors).whole is verify_rows(forged.rows, anchors=anchors).whole
        told = plain(forged.rows, anchors, without=caught)
        assert is_lost(told, forged, of, kept=of.size), (name, at)
        for check in caught:
            found[check] += not plain(forged.rows, anchors, without=caught - {check}).whole
    assert all(found.values()), found


def test_every_check_is_what_some_attack_meets() -> None:
    assert frozenset().union(*(attack.caught for attack in ATTACKS.values())) == CHECKS


@pytest.mark.parametrize("log_of", [log, closed])
def test_what_was_destroyed_is_not_missed_and_raises_no_alarm(
    log_of: Callable[[], Genuine],
) -> None:
    """Undetectable by design: values, boxes and wrapped keys that are gone."""
    of = log_of()
    for kept in (None, of.size):
        honest = auditor(of, kept=kept)
        gone = [destroy(list(of.rows), at) for at in range(of.size)]
        for rows in (*gone, destroy_all(list(of.rows))):
            told = honest.hears(Forged(tuple(rows), newest(of)))
            assert (told.whole, told.anchored, told.size) == (True, "witnessed", of.size)
    assert sum(row.sealed != b"{}" for row in of.rows) > of.size // 2


@pytest.mark.complete
def test_of_a_sealed_log_nothing_but_what_is_gone_passes() -> None:
    """Any set of boxes and keys may be missing; each that is there is the one that was sealed."""
    of = tiny_closed()
    anchors = auditor(of, kept=of.size).knows()
    rest = {name: one for row in of.rows for name, one in read_sealed(row.sealed, where="").items()}

    def found(row: LogRow, values: dict[str, Sealed]) -> Verification:
        sealed = encode_fast(dict(sorted(values.items())))
        other = msgspec.structs.replace(row, sealed=sealed)
        rows = (*of.rows[: row.seq], other, *of.rows[row.seq + 1 :])
        return verify_rows(rows, anchors=anchors)

    for row in of.rows:
        whole = read_sealed(row.sealed, where="")
        for names in chain.from_iterable(combinations(whole, n) for n in range(len(whole) + 1)):
            left = {name: whole[name] for name in names}
            assert found(row, left).anchored_size == of.size
            # the control: the last of them is another record's of that name
            if names and rest[names[-1]] != whole[names[-1]]:
                told = found(row, {**left, names[-1]: rest[names[-1]]})
                assert (told.whole, told.where) == (False, f"record {row.seq}")
    assert {BOX, WRAP} <= {name.partition(".")[0] + "." for name in rest}


# older copies


def test_an_older_copy_is_cut_off_for_whoever_kept_a_newer_checkpoint() -> None:
    of = log()
    sizes = sorted(of.notes)
    for kept, size in ((kept, size) for size, kept in combinations(sizes, 2)):
        honest = auditor(of, kept=kept)
        old = (of.notes[size].encode(),)
        told = honest.hears(Forged(of.rows[:size], old))
        assert (told.whole, told.where) == (False, f"record {size}")
        more = rechained([*of.rows[:size], *map(painted, of.rows[size:])], size)
        told = honest.hears(Forged(tuple(more), old))
        assert (told.whole, told.where) == (False, f"records {size} to {kept - 1}")
        # the control: with the keys alone nothing says that there was more
        assert is_lost(
            auditor(of).hears(Forged(of.rows[:size], old)), Forged(of.rows[:size]), of, kept=kept
        )


def test_with_keys_alone_exactly_the_older_copies_that_were_cosigned_pass() -> None:
    """Undetectable by design, and the answer says for how many records somebody vouches.

    A log that begins with what a genuine checkpoint covers, cut off anywhere after it, or gone on
    in any way that is chained; nothing else, and never more than that is said to be vouched for.
    """
    of = short()
    honest = auditor(of)
    for size, note in of.notes.items():
        for end in range(of.size + 1):
            told = honest.hears(Forged(of.rows[:end], (note.encode(),)))
            assert told.whole is (end >= size)
            assert (told.anchored, told.size) == (
                ("witnessed", size) if told.whole else (told.anchored, 0)
            )
        for at in range(of.size):
            forged = Forged(tuple(fork(list(of.rows), at)), (note.encode(),))
            told = honest.hears(forged)
            assert told.whole is (at >= size)
            assert not is_lost(told, forged, of)
    for rows in (of.rows, of.rows[:9], ()):
        assert honest.hears(Forged(rows)).refused == "SIGNATURE_MISSING"


def test_what_comes_after_the_newest_checkpoint_is_only_chained_and_said_to_be() -> None:
    """Undetectable by design: records that nobody outside has heard of."""
    of = log()
    for kept in sorted(of.notes)[:-1]:
        honest = auditor(of, kept=kept)
        for rows in (of.rows[:kept], tuple(fork(list(of.rows), kept)), of.rows):
            told = honest.hears(Forged(rows, (of.notes[kept].encode(),)))
            assert (told.whole, told.size) == (True, kept)
        broken = (*of.rows[:kept], painted(of.rows[kept]), *of.rows[kept + 1 :])
        assert honest.hears(Forged(broken)).where == f"record {kept}"


# checkpoints


def everybody(of: Genuine) -> tuple[NoteKey, ...]:
    return tuple(one.named for one in of.witnesses)


def sets(of: Genuine, *, most: int = FEW) -> list[tuple[Honest, ...]]:
    """Return every set of at most so many witnesses."""
    return [found for count in range(most + 1) for found in combinations(of.witnesses, count)]


def forks(of: Genuine) -> list[list[LogRow]]:
    """Return logs that were never written: in another order of things from early and late on."""
    return [
        fork(list(of.rows), 0),
        fork(list(of.rows), of.size - 1),
        chain_edit(list(of.rows), 3),
        fork(list(of.rows), 9)[:20],
    ]


def test_a_checkpoint_of_another_key_is_none() -> None:
    of = short()
    hands = Hands(of)
    for rows in forks(of):
        for made in (hands.signed(rows), hands.under_its_id(rows), hands.resized(rows)):
            for note in (made, hands.transplanted(made)):
                forged = Forged(tuple(rows), (note.encode(),))
                refused = auditor(of).hears(forged).refused
                assert refused in {"SIGNATURE_MISSING", "SIGNATURE_INVALID"}
                assert not auditor(of, kept=of.size).hears(forged).whole
        # the controls: whoever takes the key from the adversary, or names none, is lost
        forged = Forged(tuple(rows), (hands.signed(rows).encode(),))
        for keys in ((forgers(of.keys[0].name),), ()):
            assert is_lost(Auditor(keys=keys).hears(forged), forged, of)


def test_the_log_of_another_robot_is_another_log() -> None:
    """With its own key's checkpoint on it, that the same witnesses would cosign."""
    of, other = short(), genuine(9, 9, scenarios.OTHER)
    forged = Forged(other.rows, newest(other))
    assert auditor(of).hears(forged).refused == "SIGNATURE_MISSING"
    assert auditor(of, kept=of.size).hears(forged).where == f"record {other.size}"
    # the control
    assert is_lost(Auditor(keys=other.keys).hears(forged), forged, of)


def test_the_logs_own_key_does_not_help_without_enough_witnesses() -> None:
    """Their cosignatures stripped, doubled, or taken from a genuine checkpoint."""
    of = short()
    for rows in forks(of):
        hands = Hands(of, owns=True)
        bare = hands.signed(rows)
        for colluders in sets(of):
            hands = Hands(of, owns=True, colluders=colluders)
            honest, answers = hands.asked(bare, rows)
            assert honest == bare
            assert set(answers) <= {
                RequestFinding.FORKED,
                RequestFinding.UNPROVEN,
                RequestFinding.IMPOSSIBLE,
            }
            assert len(answers) == WITNESSES - len(colluders)
            note, twice = hands.colluded(bare), hands.colluded(bare, twice=True)
            for made in (note, twice, hands.transplanted(note)):
                forged = Forged(tuple(rows), (made.encode(),))
                told = auditor(of).hears(forged)
                assert told.refused in {"SIGNATURE_MISSING", "SIGNATURE_INVALID"}
                assert not auditor(of, kept=of.size).hears(forged).whole
            # the control: for whoever asks for no more than collude
            forged = Forged(tuple(rows), (twice.encode(),))
            some = everybody(of) if colluders else ()
            asks = Auditor(keys=of.keys, witnesses=some, quorum=len(colluders))
            assert is_lost(asks.hears(forged), forged, of)


def test_as_many_witnesses_as_are_asked_for_are_enough_to_lie() -> None:
    """The bound is what it says; and a checkpoint that was kept holds even then."""
    of = short()
    for colluders in combinations(of.witnesses, QUORUM):
        for rows in forks(of):
            hands = Hands(of, owns=True, colluders=colluders)
            forged = Forged(tuple(rows), (hands.colluded(hands.signed(rows)).encode(),))
            assert is_lost(auditor(of).hears(forged), forged, of)
            assert not auditor(of, kept=of.size).hears(forged).whole
            # and the checkpoint has to be the colluders': without the log's key there is none
            outside = Hands(of, colluders=colluders)
            alone = Forged(tuple(rows), (outside.colluded(outside.signed(rows)).encode(),))
            assert auditor(of).hears(alone).refused == "SIGNATURE_MISSING"


def test_a_witness_that_never_saw_the_log_is_as_good_as_one_that_lies() -> None:
    """Undetectable by design, for one with keys alone: `colluders + unseen >= quorum`.

    Whoever has the log's key shows a fork to those who were kept from the genuine log. So the gate
    shows every checkpoint to all of them, not to as many as it needs.
    """
    of = short()
    rows = fork(list(of.rows), 0)
    for colluding in range(QUORUM):
        for unseen in range(WITNESSES - colluding + 1):
            some = [
                msgspec.structs.replace(
                    one, log=WitnessedLog(origin=one.log.origin, keys=one.log.keys)
                )
                if colluding <= number < colluding + unseen
                else one
                for number, one in enumerate(of.witnesses)
            ]
            there = msgspec.structs.replace(of, witnesses=tuple(some))
            hands = Hands(there, owns=True, colluders=tuple(some[:colluding]))
            note, answers = hands.asked(hands.colluded(hands.signed(rows)), rows)
            assert answers.count(RequestFinding.COSIGNED) == unseen
            forged = Forged(tuple(rows), (note.encode(),))
            lost = is_lost(auditor(of).hears(forged), forged, of)
            assert lost is (colluding + unseen >= QUORUM)
            assert not auditor(of, kept=of.size).hears(forged).whole


def test_what_the_gates_own_key_writes_on_is_no_tampering() -> None:
    """Honest witnesses cosign it: all that was written is in front."""
    of = short()
    rows = rechained([*of.rows, painted(of.rows[7])], of.size)
    hands = Hands(of, owns=True)
    note, answers = hands.asked(hands.signed(rows), rows)
    assert set(answers) == {RequestFinding.COSIGNED}
    forged = Forged(tuple(rows), (note.encode(),))
    told = auditor(of, kept=of.size).hears(forged)
    assert (told.whole, told.anchored, told.size) == (True, "witnessed", of.size + 1)
    assert not is_lost(told, forged, of, kept=of.size)


def test_what_the_owner_alone_says_beyond_the_witnesses_is_not_told_as_witnessed() -> None:
    """An older checkpoint that they cosigned does not lend its witnesses to a newer one."""
    of = short()
    for kept in sorted(of.notes)[:-1]:
        rows = fork(list(of.rows), kept)
        forged = Forged(tuple(rows), (Hands(of, owns=True).signed(rows).encode(),))
        told = auditor(of, kept=kept).hears(forged)
        assert (told.anchored, told.size, told.witnessed) == ("checkpoint", of.size, kept)
        assert not is_lost(told, forged, of, kept=kept, owned=True)
        # the control: whoever takes the owner's word for the witnesses'
        assert is_lost(told, forged, of, kept=kept)


def test_cosignatures_that_were_stripped_are_missed_and_those_that_were_kept_hold() -> None:
    of = short()
    forged = Forged(of.rows, (Hands(of).stripped().encode(),))
    assert auditor(of).hears(forged).refused == "SIGNATURE_MISSING"
    assert auditor(of, kept=of.size).hears(forged).anchored == "witnessed"
    # the control: whoever asks for no witness takes a fork of the owner's for the log
    rows = fork(list(of.rows), 0)
    theirs = Forged(tuple(rows), (Hands(of, owns=True).signed(rows).encode(),))
    assert is_lost(Auditor(keys=of.keys).hears(theirs), theirs, of)


# the file


def as_export(forged: Forged, path: Path) -> Path:
    notes = [note_line(note) for note in forged.notes]
    path.write_bytes(b"".join([*map(row_line, forged.rows), *notes]))
    return path


def as_store(of: Genuine, path: Path) -> Path:
    """Return the store's file, as the gate left it."""
    store = open_store(path)

    def job(turn) -> None:  # type: ignore[no-untyped-def]
        for row in of.rows:
            turn.append(row.record, row.sealed, row.link)
        turn.put("checkpoint", "newest", of.notes[of.size].encode())

    store.run(job)
    store.close()
    return path


def rewrite(path: Path, rows: tuple[LogRow, ...]) -> None:
    """Put these rows into a store's file, whatever its triggers say."""
    connection = apsw.Connection(str(path))
    for (name,) in list(connection.execute("SELECT name FROM sqlite_schema WHERE type='trigger'")):
        connection.execute(f'DROP TRIGGER "{name}"')
    with connection:
        connection.execute("DELETE FROM audit")
        connection.executemany("INSERT INTO audit VALUES (?, ?, ?, ?)", map(tuple_of, rows))
    connection.close()


def tuple_of(row: LogRow) -> tuple[int, bytes, bytes, bytes]:
    return row.seq, row.record, row.sealed, row.link


@pytest.mark.parametrize("name", ATTACKS)
def test_the_same_is_told_of_a_file_that_was_written_to(name: str, tmp_path: Path) -> None:
    of = tiny()
    honest = auditor(of, kept=of.size)
    store = as_store(of, tmp_path / "robot.db")
    assert honest.reads(store).size == of.size
    for at, forged in places(name, of)[::5]:
        told = honest.hears(forged)
        assert honest.reads(as_export(forged, tmp_path / "log.jsonl")) == told, (name, at)
        numbers = [row.seq for row in forged.rows]
        if len(set(numbers)) == len(numbers) and numbers == sorted(numbers):
            rewrite(store, forged.rows)  # a store's file has each number once, and in order
            assert honest.reads(store) == told, (name, at)


def test_no_byte_of_an_export_can_be_changed_unseen(tmp_path: Path) -> None:
    """A bit anywhere, of rows and of the checkpoint; what is accepted says what it said."""
    of = tiny()
    whole = as_export(Forged(of.rows, newest(of)), tmp_path / "log.jsonl").read_bytes()
    honest = auditor(of, kept=of.size)
    rnd, path = Random(SEED), tmp_path / "changed.jsonl"
    for _ in range(1_500):
        data = bytearray(whole)
        data[rnd.randrange(len(data))] ^= 1 << rnd.randrange(8)
        path.write_bytes(data)
        told = honest.reads(path)
        assert not told.whole or read_again(honest, path, of)


def read_again(honest: Auditor, path: Path, of: Genuine) -> bool:
    """Return whether an accepted file holds what was written."""
    with reading(path) as log_:
        forged = Forged(tuple(log_.rows), log_.notes)
    return not is_lost(honest.hears(forged), forged, of, kept=of.size)


# at random


class Score:
    """How random rounds ended."""

    def __init__(self) -> None:
        self.ended: Counter[str] = Counter()
        self.tricks: Counter[str] = Counter()
        self.closed = 0
        self.lost: list[str] = []


def one_round(seed: str, score: Score) -> None:
    """Play once: an adversary, an auditor, and what was told."""
    rnd = Random(seed)
    drawn = rnd.random()
    of = log() if drawn < 0.25 else closed() if drawn < 0.5 else short()
    score.closed += of is closed()
    hands = random_hands(rnd, of, most=FEW)
    forged, done = random_forgery(rnd, hands)
    kept = rnd.choice((of.size, of.size, of.size, rnd.choice(sorted(of.notes)), None))
    told = auditor(of, kept=kept).hears(forged)
    first = first_touched(forged.rows, of)
    harmed = first < (of.size if kept is None else kept)
    score.tricks.update(done)
    if is_lost(told, forged, of, kept=kept or 0, owned=hands.owns):
        score.lost.append(f"{seed}: {done}, kept {kept}, {told}")
    elif told.whole:
        score.ended["rolled back" if harmed else "beyond" if first < of.size else "whole"] += 1
        assert not harmed or (kept is None and told.witnessed in of.notes), seed
    else:
        score.ended["refused" if told.refused else "named"] += 1
        require_named(told, first, hands, seed)
        pure = set(done) <= {"destroyed", "note:newest", "note:older", "note:none"}
        assert not pure or kept is None, f"{seed}: a false alarm"


def require_named(told: Told, first: int, hands: Hands, seed: str) -> None:
    """Require that what is named is not before the first that was touched, and no later span."""
    if told.refused or hands.owns:  # a checkpoint of the owner's own may speak of another log
        return
    numbers = [int(word) for word in told.where.split() if word.isdigit()]
    assert first <= numbers[-1], seed
    assert len(numbers) == 1 or numbers[0] <= first, seed


def play(rounds: int) -> Score:
    score = Score()
    for number in range(rounds):
        one_round(f"{SEED} {number}", score)
    print(f"AUTHGUARD_SEED={SEED}: {rounds} rounds, {dict(score.ended)}, {dict(score.tricks)}")
    assert score.lost == []
    # most rounds do harm, and every kind of answer came
    assert score.ended["named"] + score.ended["refused"] > rounds // 2
    assert score.ended["whole"] > rounds // 50
    assert rounds // 6 < score.closed < rounds // 3
    assert rounds < 10_000 or (score.ended["rolled back"] and score.ended["beyond"])
    return score


def test_no_random_tampering_keeps_the_anchor() -> None:
    play(ROUNDS)


@pytest.mark.nightly
def test_no_random_tampering_of_a_long_campaign_keeps_the_anchor() -> None:
    play(CAMPAIGN)


def test_random_tampering_wins_against_one_who_asks_nobody() -> None:
    """The control of the random rounds: a chain that is whole in itself is enough for him."""
    of, lost = short(), 0
    for number in range(300):
        rnd = Random(f"{SEED} {number}")
        forged, _ = random_forgery(rnd, random_hands(rnd, of, most=FEW))
        lost += is_lost(Auditor(keys=()).hears(forged), forged, of, kept=of.size)
    assert lost > 30


# by a terminal digest


@cache
def anchored_log() -> tuple[tuple[LogRow, ...], Terminal]:
    """Return a log of real decisions and the authentic terminal digest over it."""
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    for goal in ("station-103", "pharmacy", "office-1", "station-101", "plant-room"):
        scenarios.propose(sim, scenarios.navigate(sim.robot.state.region, goal))
    token = sign_terminal(sim.gate, sim.signer)
    terminal, _, _ = open_token(
        token,
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate"}),
        verifier=sim.gate.trust,
        now=Now(scenarios.START_MS + 60_000, 0),
    )
    return sim.gate.ledger.store.rows(), terminal  # type: ignore[attr-defined]


def test_no_tampering_keeps_the_anchor() -> None:
    rows, terminal = anchored_log()
    assert verify_rows(rows, terminal=terminal).anchored == "signed-terminal"
    rnd = Random(SEED)
    for attack in ATTACKS.values():
        for at in range(len(rows)):
            made = attack.make(list(rows), at)
            assert made is None or not verify_rows(made, terminal=terminal).whole
    for _ in range(1_000):
        made, done = changed_rows(rnd, list(rows))
        kept = all(map(same, made[: terminal.size], rows)) and len(made) >= terminal.size
        assert kept or not verify_rows(made, terminal=terminal).whole, done


def test_a_shortened_log_verifies_without_an_anchor_and_says_that_it_has_none() -> None:
    rows, terminal = anchored_log()
    found = verify_rows(rows[:-2], terminal=None)
    assert found.whole
    assert found.anchored == "unanchored"
    assert not verify_rows(rows[:-2], terminal=terminal).whole


def test_every_decision_and_refusal_left_a_record() -> None:
    rows, _ = anchored_log()
    kinds = [read_record(row.record, where="").kind for row in rows]
    assert kinds[:2] == ["genesis", "management"]
    assert kinds.count("decision") == 5
