# SPDX-License-Identifier: Apache-2.0
"""LogGame: with the whole log in hand, the adversary changes it and keeps the anchor's approval.

Source: section "Audit-Tampering Game", theorem "Tamper evidence of the anchored log".
"""

from __future__ import annotations

from functools import cache
from random import Random

import msgspec

import worlds
from authguard_r.assembly import sign_terminal
from authguard_r.audit.record import Record, Terminal, read_record
from authguard_r.audit.verify import Row, verify_rows
from authguard_r.core.chain import link
from authguard_r.core.encoding import Tag, b64, encode_fast
from authguard_r.core.quantities import Now
from authguard_r.core.token import open_token

ATTACKS = 3_000


@cache
def anchored_log() -> tuple[tuple[Row, ...], Terminal]:
    """Return a log of real decisions and the authentic terminal digest over it."""
    sim = worlds.simulation()
    sim.gate.management.activate(worlds.token())
    for goal in ("station-103", "pharmacy", "office-1", "station-101", "plant-room"):
        worlds.propose(sim, worlds.navigate(sim.robot.state.region, goal))
    token = sign_terminal(sim.gate, sim.signer)
    terminal, _, _ = open_token(
        token,
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate"}),
        verifier=sim.gate.trust,
        now=Now(worlds.START_MS + 60_000, 0),
    )
    return sim.gate.ledger.store.rows(), terminal  # type: ignore[attr-defined]


def rechained(rows: list[Row], start: int) -> list[Row]:
    """Return the rows with every link from `start` on worked out anew: a consistent forgery."""
    done = rows[:start]
    for seq, row in enumerate(rows[start:], start):
        record = read_record(row.record, where="")
        prev = b64(done[-1].link if done else bytes(32))
        linked = msgspec.structs.replace(record.link, prev=prev, seq=seq)
        forged = msgspec.structs.replace(record, link=linked)
        done.append(Row(seq, encode_fast(forged), row.sealed, link(linked)))
    return done


def tampered(rnd: Random, rows: tuple[Row, ...]) -> list[Row]:
    """Return a log that is not the one that was anchored."""
    log, at = list(rows), rnd.randrange(len(rows))
    trick = rnd.randrange(8)
    if trick == 0:
        return log[:at]
    if trick == 1:
        return log[:at] + log[at + 1 :]
    if trick == 2:
        return rechained(log[:at] + log[at + 1 :], at)
    if trick == 3:
        other = rnd.randrange(len(rows))
        log[at], log[other] = log[other], log[at]
        return log
    if trick == 4:
        return rechained([*log[:at], log[rnd.randrange(len(rows))], *log[at:]], at)
    if trick == 5:
        return rechained([edited(log[at]) if n == at else r for n, r in enumerate(log)], at)
    field = rnd.choice(["record", "sealed", "link"])
    data = bytearray(getattr(log[at], field))
    data[rnd.randrange(len(data))] ^= 1 << rnd.randrange(8)
    log[at] = Row(
        **{
            **{f: getattr(log[at], f) for f in ("seq", "record", "sealed", "link")},
            field: bytes(data),
        }
    )
    return log


def edited(row: Row) -> Row:
    """Return the row with its decision turned into its opposite."""
    record: Record = read_record(row.record, where="")
    turned = "accept" if record.link.decision != "accept" else "reject"
    linked = msgspec.structs.replace(record.link, decision=turned)
    return Row(
        row.seq, encode_fast(msgspec.structs.replace(record, link=linked)), row.sealed, row.link
    )


def test_no_tampering_keeps_the_anchor() -> None:
    rows, terminal = anchored_log()
    assert verify_rows(rows, terminal=terminal).whole
    rnd = Random(3)
    for _ in range(ATTACKS):
        log = tampered(rnd, rows)
        kept = tuple(log[: terminal.size]) == rows  # what comes after the anchor is not covered
        assert kept or not verify_rows(log, terminal=terminal).whole


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
