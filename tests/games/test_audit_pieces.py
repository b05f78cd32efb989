# SPDX-License-Identifier: Apache-2.0
"""The audit-tampering game against an auditor who has several processes verify.

Every attack at every record, on a log that is cut into many pieces: what is told is what one
process tells, in every word. Source: section "Audit-Tampering Game".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from authguard_r.audit import parallel
from authguard_r.audit.record import LogRow
from authguard_r.audit.verify import LogVerifier, Verification, verify_piece, verify_rows
from fixtures.audit_game import Auditor, Genuine, auditor, genuine
from fixtures.tampering import ATTACKS, destroy_all

#: Records of one piece.
PIECE = 7


@cache
def log() -> Genuine:
    return genuine(60, 9)


@cache
def closed() -> Genuine:
    """Return the log of a gate that seals."""
    return genuine(60, 9, seals=True)


def auditors(of: Genuine) -> tuple[Auditor, ...]:
    return auditor(of, kept=of.size), auditor(of, kept=min(of.notes)), Auditor(keys=())


def in_pieces(rows: list[LogRow], verifier: LogVerifier) -> Verification:
    """Join pieces of the rows for as long as that can be done, and let the rest be told."""
    first = 0
    while first < len(rows):
        cut = next((size for size in verifier.cuts if size > first), len(rows))
        part = rows[first : min(first + PIECE, cut)]
        piece = verify_piece(part, first, with_tree=True)
        if piece is None or not verifier.join(piece):
            break
        first += len(part)
    return verifier.finish(rows[first:])


@pytest.mark.complete
@pytest.mark.parametrize("log_of", [log, closed])
@pytest.mark.parametrize("name", ATTACKS)
def test_every_attack_on_any_record_is_told_alike_in_pieces(
    name: str, log_of: Callable[[], Genuine]
) -> None:
    of = log_of()
    for at in range(of.size):
        rows = ATTACKS[name].make(list(of.rows), at)
        for one in auditors(of) if rows is not None else ():
            known = one.knows((of.notes[of.size].encode(),)) if one.keys else ()
            told = verify_rows(rows or (), anchors=known)
            assert in_pieces(rows or [], LogVerifier(anchors=known)) == told, (name, at)


@pytest.mark.parametrize("name", ATTACKS)
def test_no_attack_escapes_the_processes_together(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = log()
    monkeypatch.setattr(parallel, "_ROWS", PIECE)
    monkeypatch.setattr(parallel, "_OWN_ROWS", 2)
    known = auditor(of, kept=of.size).knows()
    made = ATTACKS[name].make(list(of.rows), of.size // 3)
    assert made is not None
    found = parallel.verify_in_pieces(iter(made), jobs=2, anchors=known, alone=0)
    assert found == verify_rows(made, anchors=known)
    assert not found.whole


@pytest.mark.parametrize("log_of", [log, closed])
def test_the_genuine_log_and_one_whose_values_are_gone_are_whole_in_pieces(
    log_of: Callable[[], Genuine],
) -> None:
    of = log_of()
    for rows in (list(of.rows), destroy_all(list(of.rows))):
        for one in auditors(of):
            known = one.knows((of.notes[of.size].encode(),)) if one.keys else ()
            found = in_pieces(rows, LogVerifier(anchors=known))
            assert found == verify_rows(rows, anchors=known)
            assert found.whole
