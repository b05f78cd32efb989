# SPDX-License-Identifier: Apache-2.0
"""Whatever is asked, in whatever order, and however often it is started anew: one witness never
signs two logs, and never a shorter one after a longer one.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import mkdtemp

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from authguard_r.audit.note import read_key
from authguard_r.core.errors import AuthGuardError
from authguard_r.witness.service import Witness, WitnessResponse, forget, open_witness, register
from authguard_r.witness.state import read_folder
from fixtures.witness_process import NOW_S, ORIGIN, Log, attested, make, request

LONGEST = 24
SIZES = st.integers(min_value=0, max_value=LONGEST)
#: One log, and what else its keys could sign: it goes on differently from these places.
FORKS = (LONGEST, 0, 1, 5, 8, 13)
LOG = Log().grow(LONGEST)
VIEWS = [LOG.fork(at, bytes([at + 1])).grow(LONGEST - at) for at in FORKS]
STRANGER = Log().grow(LONGEST)
VIEW = st.sampled_from(VIEWS)


class Witnessing(RuleBasedStateMachine):
    """The model is the list of what was cosigned since the log was registered."""

    folder: Path
    witness: Witness

    @initialize()
    def begin(self) -> None:
        self.folder = make(Path(mkdtemp(prefix="witness-")) / "w", LOG)
        self.key = read_key(read_folder(self.folder).identity.key, where="key")
        self.witness = open_witness(self.folder)
        self.signed: list[tuple[int, bytes]] = []
        self.is_known = True

    def ask(self, log: Log, body: bytes, size: int) -> WitnessResponse:
        answer = self.witness.answer(body, NOW_S)
        if answer.status == 200:
            assert attested(log, answer.body, self.key, size).time_s == NOW_S
            assert self.is_known
            self.signed.append((size, log.root(size)))
        return answer

    @rule(log=VIEW, old=SIZES, size=SIZES)
    def anything_is_asked(self, log: Log, old: int, size: int) -> None:
        self.ask(log, log.ask(old, size), size)

    @rule(log=VIEW, size=SIZES)
    def what_fits_is_asked(self, log: Log, size: int) -> None:
        known = self.signed[-1] if self.signed else (0, log.root(0))
        old = known[0]
        answer = self.ask(log, log.ask(old, size), size)
        honest = self.is_known and old <= size and log.root(old) == known[1]
        assert (answer.status == 200) is honest

    @rule(log=VIEW, other=VIEW, old=SIZES, size=SIZES, cut=st.integers(0, 3))
    def a_proof_of_something_else_is_sent(
        self, log: Log, other: Log, old: int, size: int, cut: int
    ) -> None:
        proof = other.proof(old, size)
        self.ask(log, request(old, proof[: len(proof) - cut], log.note(size)), size)

    @rule(old=SIZES, size=SIZES)
    def a_stranger_asks(self, old: int, size: int) -> None:
        answer = self.witness.answer(STRANGER.ask(old, size), NOW_S)
        assert answer.status == (403 if self.is_known else 404)

    @rule(at=st.integers(0, 400), byte=st.integers(0, 255), size=SIZES)
    def a_request_is_garbled(self, at: int, byte: int, size: int) -> None:
        body = bytearray(LOG.ask(self.signed[-1][0] if self.signed else 0, size))
        body[at % len(body)] = byte
        before = read_folder(self.folder).logs[ORIGIN]
        answer = self.witness.answer(bytes(body), NOW_S)
        if answer.status == 200:  # what was changed was no part of it
            self.signed.append((size, LOG.root(size)))
            assert bytes(body).endswith(LOG.note(size).encode())
        else:
            assert read_folder(self.folder).logs[ORIGIN] == before

    @rule()
    def it_is_started_anew(self) -> None:
        self.witness.close()
        self.witness = open_witness(self.folder)

    @precondition(lambda self: self.is_known)
    @rule()
    def the_log_is_forgotten(self) -> None:
        self.witness.close()
        forget(self.folder, ORIGIN, NOW_S)
        self.witness = open_witness(self.folder)
        self.is_known, self.signed = False, []

    @rule()
    def the_log_is_registered(self) -> None:
        self.witness.close()
        register(self.folder, LOG.texts, NOW_S, again=False)
        self.witness = open_witness(self.folder)
        self.is_known = True

    @precondition(lambda self: len(self.signed) > 1)
    @rule()
    def its_files_are_put_back(self) -> None:
        """An older copy of what it knows is noticed before it signs anything."""
        self.witness.close()
        (path,) = (self.folder / "logs").iterdir()
        newest = path.read_bytes()
        path.write_bytes(self.older)
        try:
            open_witness(self.folder).close()
        except AuthGuardError:
            path.write_bytes(newest)
        else:
            assert newest == self.older
        self.witness = open_witness(self.folder)

    @invariant()
    def what_was_signed_is_one_log_that_only_grows(self) -> None:
        sizes = [size for size, _ in self.signed]
        assert sizes == sorted(sizes)
        for log in VIEWS:
            if self.signed and log.root(sizes[-1]) == self.signed[-1][1]:
                assert all(log.root(size) == root for size, root in self.signed)
        (path,) = (self.folder / "logs").iterdir()
        if len(self.signed) < 2:
            self.older = path.read_bytes()

    def teardown(self) -> None:
        if hasattr(self, "witness"):
            self.witness.close()
            shutil.rmtree(self.folder.parent)


TestWitnessing = Witnessing.TestCase
TestWitnessing.settings = settings(max_examples=40, stateful_step_count=25)


def test_the_views_do_contradict_each_other() -> None:
    assert len({log.root() for log in VIEWS}) == len(FORKS)
