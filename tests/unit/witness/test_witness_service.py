# SPDX-License-Identifier: Apache-2.0
"""What a witness signs is on disk first, what it refuses is kept, and nobody else has its files."""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from authguard_r.audit.note import read_key, read_note
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.notes import verify_note
from authguard_r.witness import files, service, state
from authguard_r.witness.rules import RequestFinding
from authguard_r.witness.service import (
    WitnessResponse,
    forget,
    make_witness,
    open_witness,
    register,
)
from authguard_r.witness.state import (
    MOST_KEPT,
    open_book,
    read_acts,
    read_evidence,
    read_folder,
)
from fixtures import witness_process
from fixtures.witness_process import NAME, NOW_S, ORIGIN, Log, attested, make, opened, request

WITNESS_KINDS = (Algorithm.ED25519, Algorithm.ML_DSA_44)


@pytest.fixture
def log() -> Log:
    return Log().grow(20)


@pytest.fixture
def folder(tmp_path: Path, log: Log) -> Path:
    return make(tmp_path / "w", log)


def ask(folder: Path, body: bytes, time_s: int = NOW_S) -> WitnessResponse:
    with opened(folder) as witness:
        return witness.answer(body, time_s)


def newest(folder: Path, origin: str = ORIGIN) -> int:
    return state.read_log(read_folder(folder).logs[origin]).size


@pytest.mark.parametrize("algorithm", WITNESS_KINDS)
def test_a_cosignature_is_one_that_others_verify(
    tmp_path: Path, log: Log, algorithm: Algorithm
) -> None:
    folder = make(tmp_path / "w", log, algorithm=algorithm)
    key = read_key(read_folder(folder).identity.key, where="key")
    with opened(folder) as witness:
        for old, size in ((0, 5), (5, 5), (5, 16), (16, 20)):
            answer = witness.answer(log.ask(old, size), NOW_S + size)
            assert (answer.status, answer.content) == (200, service.TEXT)
            assert attested(log, answer.body, key, size).time_s == NOW_S + size
    kept = read_folder(folder).logs[ORIGIN]
    note = read_note(kept.note.encode(), where="kept")
    # the witness's file alone shows what the log signed, and that this witness signed it too
    assert len(verify_note(note, (*log.keys, key), where="kept")) == 2
    assert kept.time_s == NOW_S + 20


def test_a_log_costs_a_few_hundred_bytes(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0))
    (path,) = (folder / "logs").iterdir()
    assert path.stat().st_size < 1_000


def test_what_was_cosigned_is_known_by_the_next_start(folder: Path, log: Log) -> None:
    assert ask(folder, log.ask(0, 10)).status == 200
    assert ask(folder, log.fork(5).grow(5).ask(0, 10)).status == 409
    told = ask(folder, log.ask(0))
    assert (told.status, told.content, told.body) == (409, "text/x.tlog.size", b"10\n")
    assert ask(folder, log.ask(10)).status == 200
    assert ask(folder, log.ask(10)).body == b"20\n"


def test_logs_are_apart(folder: Path, log: Log) -> None:
    other = Log(origin="authguard-r/courier-2/audit").grow(3)
    assert ask(folder, other.ask(0)).status == 404
    register(folder, other.texts, NOW_S, again=False)
    assert ask(folder, log.ask(0)).status == ask(folder, other.ask(0)).status == 200
    assert (newest(folder), newest(folder, other.origin)) == (20, 3)


@pytest.mark.parametrize("identical", [True, False])
def test_of_requests_at_once_those_that_contradict_each_other_are_not_both_signed(
    tmp_path: Path, log: Log, identical: bool
) -> None:
    folder = make(tmp_path / "w", log)
    logs = [log if identical else log.fork(5, bytes([n])).grow(15) for n in range(8)]
    bodies = [one.ask(0) for one in logs]
    answers: list[WitnessResponse] = []
    with opened(folder) as witness:
        together = threading.Barrier(len(bodies))

        def send(body: bytes) -> None:
            together.wait()
            answers.append(witness.answer(body, NOW_S))

        threads = [threading.Thread(target=send, args=(body,)) for body in bodies]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(answer.status for answer in answers) == [200] + [409] * 7
    assert {answer.body for answer in answers if answer.status == 409} == {b"20\n"}


# what is refused


def test_what_a_log_signed_and_should_not_have_is_kept(folder: Path, log: Log) -> None:
    fork = log.fork(5).grow(20)
    ask(folder, log.ask(0, 10))
    for body in (log.ask(3), log.ask(2, 8), fork.ask(10, 10), fork.ask(10)):
        ask(folder, body, NOW_S + 1)
    found = read_evidence(folder)
    assert {one.finding for one in found} == {"stale", "behind", "forked", "unproven"}
    forked = next(one for one in found if one.finding is RequestFinding.FORKED)
    # two signatures of one log over two logs: whoever knows its key can see that
    for note in (forked.note, forked.against):
        assert len(verify_note(read_note(note.encode(), where="kept"), log.keys, where="kept")) == 1
    assert forked.note != forked.against
    assert forked.time_s == NOW_S + 1


def test_what_anybody_can_send_is_not_kept(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0, 10))
    before = sorted(folder.rglob("*"))
    stranger = Log().grow(20)
    for body in (b"", stranger.ask(10), request(21, (), log.note()), Log(origin="x").ask(0)):
        answer = ask(folder, body)
        assert answer.status in {400, 403, 404}
    assert sorted(folder.rglob("*")) == before


def test_evidence_is_bounded_and_nothing_is_kept_twice(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0, 10))
    with opened(folder) as witness:
        told = [witness.answer(log.ask(1), NOW_S).told["kept"] for _ in range(2)]
        assert told == [True, False]
        for number in range(MOST_KEPT + 4):
            fork = log.fork(5, bytes([number, 1])).grow(10)
            kept = witness.answer(fork.ask(10, 10), NOW_S).told["kept"]
            assert kept is (number < MOST_KEPT)
    assert len(read_evidence(folder)) == MOST_KEPT + 1


def test_signatures_of_others_are_not_stored(folder: Path, log: Log) -> None:
    others = Log().grow(20).note().signatures * 20
    note = witness_process.Note(log.text(), (*others, *log.note().signatures))
    assert ask(folder, request(0, (), note)).status == 200
    kept = read_note(read_folder(folder).logs[ORIGIN].note.encode(), where="kept")
    assert [one.name for one in kept.signatures] == [ORIGIN, NAME]


def test_a_refusal_stands_when_it_cannot_be_kept(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0, 10))
    with opened(folder) as witness:
        (folder / "evidence").rmdir()
        answer = witness.answer(log.ask(1), NOW_S)
    assert answer.status == 409
    assert "evidence" not in answer.body.decode()
    assert answer.told["fault"]


# faults


class Fuse:
    """The disk fails at the n-th call that changes it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, left: int) -> None:
        self.left = left
        self.calls = 0
        self.order: list[str] = []
        for name in ("open", "write", "fsync"):
            monkeypatch.setattr(files.os, name, self._burning(name, getattr(os, name)))
        monkeypatch.setattr(Path, "replace", self._burning("replace", Path.replace))

    def _burning(self, name: str, call: Callable[..., object]) -> Callable[..., object]:
        def burn(*words: object, **more: object) -> object:
            self.calls += 1
            self.order.append(name)
            if self.calls == self.left:
                raise OSError(28, "No space left on device")
            return call(*words, **more)

        return burn


def test_nothing_is_answered_before_it_is_on_disk(
    folder: Path, log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(folder) as witness, monkeypatch.context() as patched:
        fuse = Fuse(patched, 0)
        assert witness.answer(log.ask(0), NOW_S).status == 200
    once = ["open", "write", "fsync", "replace", "open", "fsync"]
    assert fuse.order == [*once, *once]  # the log's file, then the mark


@pytest.mark.parametrize("left", range(1, 13))
def test_whatever_fails_nothing_is_signed_and_the_next_try_is(
    folder: Path, log: Log, monkeypatch: pytest.MonkeyPatch, left: int
) -> None:
    fork = log.fork(5).grow(15)
    with opened(folder) as witness:
        with monkeypatch.context() as patched:
            fuse = Fuse(patched, left)
            answer = witness.answer(log.ask(0), NOW_S)
            assert fuse.calls >= left
        assert (answer.status, answer.told["event"]) == (503, "unable")
        assert NAME.encode() not in answer.body
        assert "No space" in str(answer.told["fault"])
        # nobody has a cosignature, so either log may be the one that goes on
        assert witness.answer(fork.ask(0), NOW_S).status == 200
    assert newest(folder) == 20
    assert ask(folder, log.ask(20)).status == 409


@pytest.mark.parametrize("left", range(1, 13))
def test_a_start_after_a_failure_knows_at_least_what_was_signed(
    folder: Path, log: Log, monkeypatch: pytest.MonkeyPatch, left: int
) -> None:
    ask(folder, log.ask(0, 10))
    with opened(folder) as witness, monkeypatch.context() as patched:
        Fuse(patched, left)
        assert witness.answer(log.ask(10), NOW_S).status == 503
    size = newest(folder)
    assert size in {10, 20}
    assert ask(folder, log.ask(size)).status == 200


# the folder


def test_a_folder_is_its_owners_alone(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0))
    ask(folder, log.ask(0))
    for path in (folder, *folder.rglob("*")):
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path


def fails(folder: Path) -> EnvironmentFault:
    with pytest.raises(EnvironmentFault) as told:
        open_witness(folder)
    return told.value


@pytest.mark.parametrize("name", [".", "witness.key.pem", "witness.json", "logs", "evidence"])
@pytest.mark.parametrize("mode", [0o040, 0o002])
def test_a_folder_that_others_reach_is_not_served(folder: Path, name: str, mode: int) -> None:
    path = folder / name
    path.chmod(path.stat().st_mode | mode)
    assert "chmod" in fails(folder).message


def test_a_logs_file_that_others_can_write_is_not_read(folder: Path) -> None:
    (path,) = (folder / "logs").iterdir()
    path.chmod(0o622)
    assert fails(folder).where == str(path)


def test_a_folder_that_others_could_replace_is_not_served(folder: Path) -> None:
    folder.parent.chmod(0o777)
    assert fails(folder).where == str(folder.parent)
    folder.parent.chmod(0o1777)
    open_witness(folder).close()
    folder.parent.chmod(0o700)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files away")
def test_a_folder_of_another_user_is_not_served(folder: Path) -> None:
    os.chown(folder / "logs", 65_534, -1)
    assert "65534" in fails(folder).message
    os.chown(folder / "logs", 0, -1)
    os.chown(folder.parent, 65_534, -1)
    assert "65534" in fails(folder).message
    os.chown(folder.parent, 0, -1)


def test_a_link_or_a_pipe_is_no_folder_of_ours(folder: Path) -> None:
    (folder / "logs").rename(folder / "moved")
    (folder / "logs").symlink_to(folder / "moved")
    assert "expected a file or a folder" in fails(folder).message
    (folder / "logs").unlink()
    (folder / "moved").rename(folder / "logs")
    key = folder / "witness.key.pem"
    key.unlink()
    os.mkfifo(key, 0o600)
    assert "expected a file or a folder" in fails(folder).message


def test_two_processes_do_not_hold_one_folder(folder: Path, log: Log) -> None:
    with opened(folder):
        assert "another process" in fails(folder).message
        with pytest.raises(EnvironmentFault, match="another process"):
            register(folder, log.texts, NOW_S, again=False)
        assert read_folder(folder).identity.name == NAME  # looking is free
    open_witness(folder).close()


def test_a_lock_that_is_a_link_is_not_followed(folder: Path, tmp_path: Path) -> None:
    (folder / "lock").unlink(missing_ok=True)
    (folder / "lock").symlink_to(tmp_path / "elsewhere")
    assert "lock" in fails(folder).message
    assert not (tmp_path / "elsewhere").exists()


# what is older than it was


def old_copy(folder: Path, log: Log, what: str) -> None:
    """Put something back as it was before 20 records were cosigned."""
    ask(folder, log.ask(0, 10))
    copy = folder.with_name("copy")
    shutil.copytree(folder, copy)
    ask(folder, log.ask(10, 15))
    ask(folder, log.ask(15))
    if (folder / what).is_dir():
        shutil.rmtree(folder / what)
        shutil.copytree(copy / what, folder / what)
    else:
        shutil.copy(copy / what, folder / what)


def test_files_that_were_put_back_are_not_served(folder: Path, log: Log) -> None:
    old_copy(folder, log, "logs")
    told = fails(folder)
    assert told.reason is Reason.ROLLED_BACK
    assert "retire" in told.message


def test_a_whole_folder_that_was_put_back_is_caught_by_a_mark_elsewhere(
    tmp_path: Path, log: Log
) -> None:
    (tmp_path / "other").mkdir()
    folder = make(tmp_path / "w", log, mark=tmp_path / "other" / "mark")
    assert not (folder / "mark").exists()
    old_copy(folder, log, ".")
    assert fails(folder).reason is Reason.ROLLED_BACK


def test_a_mark_that_lags_by_a_crash_is_caught_up(folder: Path, log: Log) -> None:
    old_copy(folder, log, "mark")
    assert ask(folder, log.ask(20)).status == 200
    assert newest(folder) == 20


def gone(folder: Path, name: str) -> None:
    path = folder / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize("name", ["mark", "witness.key.pem", "witness.json", "logs", "evidence"])
def test_a_folder_in_which_something_is_missing_is_not_served(
    folder: Path, log: Log, name: str
) -> None:
    ask(folder, log.ask(0))
    gone(folder, name)
    fails(folder)
    assert name == "witness.json" or not (folder / name).exists()  # nothing begins anew


def test_a_witness_that_lost_its_logs_does_not_begin_anew(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0))
    (path,) = (folder / "logs").iterdir()
    path.unlink()
    assert fails(folder).reason is Reason.ROLLED_BACK


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda data: data[:-5],
    "empty": lambda data: b"",
    "not canonical": lambda data: data + b"\n",
    "another note": lambda data: data.replace(b"\\n20\\n", b"\\nxx\\n"),
    "another key": lambda data: data.replace(b"audit+", b"audit+0"),
    "too long": lambda data: data + b" " * files.MAX_BYTES,
}


@pytest.mark.parametrize("how", DAMAGE)
def test_a_damaged_file_is_named_and_not_served(folder: Path, log: Log, how: str) -> None:
    ask(folder, log.ask(0))
    (path,) = (folder / "logs").iterdir()
    path.write_bytes(DAMAGE[how](path.read_bytes()))
    assert fails(folder).reason is Reason.STORE_CORRUPT


def test_a_file_under_anothers_name_is_not_served(folder: Path) -> None:
    (path,) = (folder / "logs").iterdir()
    path.rename(path.with_name("0" * 32 + ".json"))
    assert fails(folder).reason is Reason.STORE_CORRUPT


def test_files_of_another_witness_are_not_served(folder: Path, tmp_path: Path) -> None:
    other = make(tmp_path / "other", Log())
    for name in ("mark", "witness.key.pem"):
        kept = (folder / name).read_bytes()
        shutil.copy(other / name, folder / name)
        assert fails(folder).reason in {Reason.STORE_CORRUPT, Reason.KEY_INVALID}
        (folder / name).write_bytes(kept)
    wrong = make(tmp_path / "wrong", algorithm=Algorithm.ML_DSA_44)
    shutil.copy(wrong / "witness.key.pem", folder / "witness.key.pem")
    assert fails(folder).reason is Reason.KEY_INVALID
    (folder / "witness.key.pem").write_text("no key", encoding="ascii")
    with pytest.raises(AuthenticityError):
        open_witness(folder)


def test_a_key_of_an_algorithm_that_cosigns_nothing_is_not_served(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
    )

    key = service.generate(Algorithm.ML_DSA_65)
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "witness.key.pem").write_bytes(pem)
    assert fails(folder).reason is Reason.KEY_INVALID


def test_a_folder_of_a_newer_program_is_left_alone(folder: Path) -> None:
    path = folder / "witness.json"
    path.write_bytes(path.read_bytes().replace(b'"format":1', b'"format":2'))
    assert fails(folder).reason is Reason.STORE_NEWER


# making, registering, forgetting


def test_a_witness_is_made_once(folder: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    with pytest.raises(EnvironmentFault):
        make(folder)
    assert {path: path.read_bytes() for path in before} == before
    (tmp_path / "empty").mkdir(mode=0o700)
    open_witness(make(tmp_path / "empty")).close()
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o755)
    with pytest.raises(EnvironmentFault, match="chmod"):
        make(tmp_path / "open")
    with pytest.raises(EnvironmentFault):
        make(tmp_path / "no" / "such")
    with pytest.raises(EnvironmentFault, match="mark"):
        make(tmp_path / "second", mark=folder / "mark")


@pytest.mark.parametrize(
    "name", ["", "a b", "a+b", "a\nb", "a\x7fb", "\udcff", "x" * 256, "ä" * 128]
)
def test_a_name_that_no_cosignature_can_have_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(MalformedError):
        make_witness(tmp_path / "w", name=name, algorithm=Algorithm.ML_DSA_44, mark=None)
    assert not (tmp_path / "w").exists()


def test_the_longest_names_are_cosigned(tmp_path: Path) -> None:
    log = Log(origin="ä" * 127 + "x").grow(2)
    folder = tmp_path / "w"
    make_witness(folder, name="x" * 255, algorithm=Algorithm.ML_DSA_44, mark=None)
    register(folder, log.texts, NOW_S, again=False)
    assert ask(folder, log.ask(0)).status == 200
    with pytest.raises(MalformedError):
        register(folder, Log(origin="x" * 256).texts, NOW_S, again=False)


def test_a_witness_signs_with_what_there_are_cosignatures_with(tmp_path: Path) -> None:
    with pytest.raises(AuthenticityError):
        make_witness(tmp_path / "w", name=NAME, algorithm=Algorithm.ML_DSA_65, mark=None)
    assert not (tmp_path / "w").exists()


def test_other_keys_replace_a_logs_only_when_somebody_says_so(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0, 10))
    old, log.signers = log.fork(20), Log().signers
    with pytest.raises(RefusedError):
        register(folder, log.texts, NOW_S, again=False)
    assert ask(folder, log.ask(10)).status == 403
    assert register(folder, log.texts, NOW_S, again=True).changed
    assert not register(folder, log.texts, NOW_S, again=True).changed
    assert newest(folder) == 10  # a new key is no new log
    assert ask(folder, log.ask(0)).body == b"10\n"
    assert ask(folder, old.ask(10)).status == 403
    assert ask(folder, log.ask(10)).status == 200
    assert [act.act for act in read_acts(folder)] == ["add", "replace"]


def test_a_hybrid_log_is_the_same_in_any_order_of_its_keys(tmp_path: Path) -> None:
    log = Log(Algorithm.ED25519, Algorithm.ML_DSA_65).grow(3)
    folder = make(tmp_path / "w", log)
    assert not register(folder, log.texts[::-1], NOW_S, again=False).changed
    assert ask(folder, log.ask(0)).status == 200
    assert ask(folder, request(3, (), log.sign(log.text(), but=1))).status == 403


def test_a_log_is_forgotten_by_an_act_that_stays(folder: Path, log: Log) -> None:
    fork = log.fork(5).grow(15)
    ask(folder, log.ask(0))
    ask(folder, fork.ask(20))
    with pytest.raises(RefusedError):
        forget(folder, "another", NOW_S)
    known = forget(folder, ORIGIN, NOW_S + 9)
    with pytest.raises(RefusedError):
        forget(folder, ORIGIN, NOW_S)
    assert ask(folder, fork.ask(0)).status == 404
    assert register(folder, log.texts, NOW_S, again=False).changed
    assert ask(folder, fork.ask(0)).status == 200
    acts = read_acts(folder)
    assert [act.act for act in acts] == ["add", "forget", "add"]
    assert (acts[1].time_s, acts[1].note) == (NOW_S + 9, known.note)
    assert [one.finding for one in read_evidence(folder)] == ["forked"]
    # what is found from now on has room of its own
    for number in range(MOST_KEPT):
        assert ask(folder, log.fork(5, bytes([number])).grow(15).ask(20)).told["kept"]


def test_what_was_forgotten_does_not_come_back(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0))
    copy = folder.with_name("copy")
    shutil.copytree(folder / "logs", copy)
    forget(folder, ORIGIN, NOW_S)
    shutil.rmtree(folder / "logs")
    shutil.copytree(copy, folder / "logs")
    assert fails(folder).reason is Reason.ROLLED_BACK


def test_a_line_of_acts_that_a_crash_cut_is_left_out(folder: Path, log: Log) -> None:
    with (folder / "acts.jsonl").open("ab") as acts:
        acts.write(b'{"act":"for\n')
    forget(folder, ORIGIN, NOW_S)
    assert [act.act for act in read_acts(folder)] == ["add", "forget"]


def test_an_act_that_cannot_be_written_down_is_not_done(folder: Path, log: Log) -> None:
    (folder / "acts.jsonl").unlink()
    (folder / "acts.jsonl").mkdir()
    book = open_book(folder)
    with pytest.raises(EnvironmentFault):
        book.forget(ORIGIN, NOW_S)
    assert book.log(ORIGIN) is not None
    book.close()


def test_nothing_that_was_written_holds_a_float_or_a_secret(folder: Path, log: Log) -> None:
    ask(folder, log.ask(0))
    ask(folder, log.ask(0))
    for path in folder.rglob("*.json"):
        assert b"PRIVATE" not in path.read_bytes()
        json.loads(path.read_bytes(), parse_float=pytest.fail)


def test_every_fault_of_a_folder_is_one_of_ours(tmp_path: Path) -> None:
    for path in (tmp_path / "absent", Path("/dev/null"), Path("/dev/null/x")):
        with pytest.raises(AuthGuardError):
            open_witness(path)
        with pytest.raises(AuthGuardError):
            read_folder(path)
