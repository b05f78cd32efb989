# SPDX-License-Identifier: Apache-2.0
"""`audit verify`, `export` and `key`: what a stranger does with one file and one public key."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit import parallel
from authguard_r.audit.note import Note, NoteSignature, read_note
from authguard_r.audit.record import LogRow, Terminal
from authguard_r.auditor.export_format import MAX_LINE, note_line, row_line
from authguard_r.cli import call, log_verify
from authguard_r.cli.gateway import GateAddress
from authguard_r.cli.log_export import COLUMNS, cell
from authguard_r.cli.logs import ReadableLog
from authguard_r.core.encoding import Tag, b64, encode
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.token import sign_object
from authguard_r.keys.algorithms import Algorithm, generate
from authguard_r.keys.notes import cosign, log_key, sign_text, witness_key
from authguard_r.keys.signer import read_signer
from authguard_r.store.sqlite import open_store
from fixtures import scenarios
from fixtures.cases import case
from fixtures.small_logs import ROBOT, checkpoint_of, edited, log_of

SIZE = 9
ROWS = log_of(SIZE)
AT = 1_763_620_000
Json = dict[str, Any]


class Desk:
    """One folder with an exported log and its store, and what the last command printed."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._capsys = capsys
        self.signer = read_signer(*self.gate("key"), *self.gate("cert"))
        self.note = self.signed(ROWS)
        code, told = self.json("audit", "key", "--trust", "trust")
        assert code == 0
        (self.key,) = told["keys"]

    def gate(self, kind: str, robot: str = ROBOT) -> tuple[Path]:
        return (self.folder / "trust" / "keys" / f"gate-{robot}.{kind}.pem",)

    def __call__(self, *arguments: str) -> tuple[int, str]:
        code = call([str(argument) for argument in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out or out.err

    def json(self, *arguments: str) -> tuple[int, Any]:
        code, out = self(*arguments, "--json")
        return code, json.loads(out)

    def signed(self, rows: list[LogRow]) -> Note:
        said = checkpoint_of(rows)
        return Note(said.text(), sign_text(said.text(), said.origin, self.signer))

    def export(self, rows: list[LogRow], note: Note | None, name: str = "log.jsonl") -> str:
        lines = [row_line(row) for row in rows]
        lines += [] if note is None else [note_line(note.encode())]
        (self.folder / name).write_bytes(b"".join(lines))
        return name

    def store(self, rows: list[LogRow], note: Note | None, name: str = "robot.db") -> str:
        store = open_store(self.folder / name)

        def job(turn: Any) -> None:
            for row in rows:
                turn.append(row.record, row.sealed, row.link)
            if note is not None:
                turn.put("checkpoint", "newest", note.encode())

        store.run(job)
        store.close()
        return name

    def keep(self, note: Note, name: str = "kept.note") -> str:
        (self.folder / name).write_bytes(note.encode())
        return name


@pytest.fixture
def session(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Desk:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    return Desk(tmp_path, capsys)


# verify


def test_a_checkpoint_in_the_file_says_nothing_until_a_key_is_named(session: Desk) -> None:
    for name in (session.export(ROWS, session.note), session.store(ROWS, session.note)):
        code, told = session.json("audit", "verify", name)
        assert (code, told["anchored"], told["anchored_size"]) == (0, "unanchored", 0)
        assert told["not_verified"] == ["no key was named"]
        code, text = session("audit", "verify", name)
        assert "not verified: no key was named" in text
        assert "no outside checkpoint shows" in text
        code, told = session.json("audit", "verify", name, "--log-key", session.key)
        assert (code, told["anchored"], told["anchored_size"]) == (0, "checkpoint", SIZE)
        assert (told["told_by"], told["fault"], told["where"]) == (None, "", "")
        code, text = session("audit", "verify", name, "--trust", "trust")
        assert (code, f"anchored: checkpoint, {SIZE} of {SIZE} records" in text) == (0, True)
        assert "the checkpoint lies where the log lies" in text


def test_a_checkpoint_that_was_kept_elsewhere_shows_that_the_end_is_gone(session: Desk) -> None:
    kept = session.keep(session.note)
    cut = session.export(ROWS[:6], session.signed(ROWS[:6]))
    assert session.json("audit", "verify", cut, "--log-key", session.key)[0] == 0
    code, told = session.json(
        "audit", "verify", cut, "--log-key", session.key, "--checkpoint", kept
    )
    assert (code, told["whole"], told["where"]) == (1, False, "record 6")
    whole = session(
        "audit", "verify", session.store(ROWS, None), "--log-key", session.key, "--checkpoint", kept
    )
    assert (whole[0], "the file's own" in whole[1]) == (0, False)
    early = session.keep(session.signed(ROWS[:3]), "early.note")
    given = ("--log-key", session.key, "--checkpoint", early, "--checkpoint", kept)
    code, told = session.json("audit", "verify", session.export(ROWS, None), *given)
    assert (code, told["anchors"]) == (0, [["checkpoint", 3], ["checkpoint", SIZE]])
    code, told = session.json("audit", "verify", session.export(ROWS, None), "--checkpoint", kept)
    assert (code, told["error"]["where"]) == (5, "--log-key")


def test_a_log_that_is_not_whole_says_what_it_was_held_to(session: Desk) -> None:
    own = generate(Algorithm.ED25519)
    witness = witness_key("w.example", own.public_key())
    cosigned = cosign(session.note.text, witness.name, own, AT)
    kept = session.keep(Note(session.note.text, (*session.note.signatures, cosigned)))
    said = Terminal(log=ROBOT, size=5, head=Digest(b64(ROWS[4].link)), time_ms=AT * 1_000)
    Path("terminal").write_bytes(sign_object(said, Tag.CHECKPOINT, session.signer))
    key, at = ("--log-key", session.key), ("--checkpoint", kept)
    claimed = f"a checkpoint in its file, signed by no key that was named, of {SIZE} records"
    plain, quorum = f"a checkpoint of {SIZE} records", ("--witness", witness.text())
    cosigned_too = f"a checkpoint, cosigned by enough witnesses, of {SIZE} records"
    digest = "a signed terminal digest of 5 records"
    checkpoint, vouched = ["checkpoint", SIZE], ["witnessed", SIZE]
    both = ("--trust", "trust", "--checkpoint", "terminal", *at)
    changed = [*ROWS[:2], edited(ROWS[2], open={}), *ROWS[3:]]
    cases = (
        (None, (), [], ["nothing outside of it"]),
        (session.note, (), [["claimed", SIZE]], [claimed]),
        (session.note, key, [checkpoint], [plain]),
        (None, (*key, *at), [checkpoint], [plain]),
        (None, (*key, *at, *quorum), [vouched], [cosigned_too]),
        (None, both, [["signed-terminal", 5], checkpoint], [digest, plain]),
    )
    # of what was cut off nobody knows who has nothing to hold it to
    for rows, where, asked in (
        (ROWS[:4], "record 4", cases[1:]),
        (changed, "record 2", cases),
    ):
        for note, given, told_of, words in asked:
            name = session.export(rows, note)
            code, told = session.json("audit", "verify", name, *given)
            assert (code, told["where"], told["held_to"]) == (1, where, told_of)
            assert told["anchored"] == "unanchored"  # what it was held to vouches for none of it
            code, text = session("audit", "verify", name, *given)
            first, *rest = text.splitlines()
            assert (code, first.startswith(f"NOT WHOLE at {where}: ")) == (1, True)
            assert rest == [f"  compared with {word}" for word in words]
    whole = session.json("audit", "verify", session.export(ROWS, None), *both)[1]
    assert whole["held_to"] == whole["anchors"] == [["signed-terminal", 5], checkpoint]
    assert "compared with" not in session("audit", "verify", "log.jsonl", *both)[1]


def test_a_key_that_signed_nothing_here_is_not_authentic(session: Desk) -> None:
    own = generate(Algorithm.ED25519)
    other = log_key(checkpoint_of(ROWS).origin, own.public_key()).text()
    code, told = session.json(
        "audit", "verify", session.export(ROWS, session.note), "--log-key", other
    )
    assert (code, told["error"]["code"]) == (4, "SIGNATURE_MISSING")
    for given in (("--log-key", session.key), ("--trust", "trust")):
        code, told = session.json("audit", "verify", session.export(ROWS, None), *given)
        assert (code, told["error"]["code"]) == (4, "SIGNATURE_MISSING")
    (line,) = session.note.signatures
    turned = NoteSignature(line.name, line.key_id, bytes(64))
    forged = session.export(ROWS, Note(session.note.text, (turned,)))
    code, told = session.json("audit", "verify", forged, "--log-key", session.key)
    assert (code, told["error"]["code"]) == (4, "SIGNATURE_INVALID")
    assert session.json("audit", "verify", forged, "--log-key", "no key")[0] == 4


def test_the_checkpoint_of_another_log_is_not_this_ones(session: Desk) -> None:
    for origin in ("authguard-r/lifter-1/audit", "example.com/log", "authguard-r/../audit"):
        text = session.note.text.replace(checkpoint_of(ROWS).origin, origin)
        note = Note(text, sign_text(text, origin, session.signer))
        name = session.export(ROWS, note)
        code, told = session.json("audit", "verify", name, "--log-key", session.key)
        assert (code, told["error"]["code"]) == (4, "SIGNATURE_MISSING")
        assert session.json("audit", "verify", name, "--trust", "trust")[0] in {4, 5}


def test_a_trust_folder_without_the_gates_certificate_needs_a_key(session: Desk) -> None:
    session.gate("cert")[0].rename("gate.pem")
    name = session.export(ROWS, session.note)
    assert session.json("audit", "verify", name, "--trust", "trust")[0] == 5
    code, told = session.json(
        "audit", "key", "--trust", "trust", "--robot", ROBOT, "--cert", "gate.pem"
    )
    assert (code, told) == (0, {"robot": ROBOT, "keys": [session.key]})
    assert (
        session.json("audit", "verify", name, "--trust", "trust", "--log-key", session.key)[0] == 0
    )
    assert session.json("audit", "key", "--trust", "trust", "--robot", ROBOT)[0] == 5


def test_witnesses_are_counted_by_their_keys(session: Desk) -> None:
    own = [generate(Algorithm.ED25519) for _ in range(3)]
    keys = [witness_key(f"w{n}.example", key.public_key()) for n, key in enumerate(own)]
    text = session.note.text
    lines = [cosign(text, key.name, held, AT) for key, held in zip(keys, own, strict=True)]
    name = session.export(ROWS, Note(text, (*session.note.signatures, *lines[:2])))
    given = ["--log-key", session.key]
    for key in keys:
        given += ["--witness", key.text()]
    code, told = session.json("audit", "verify", name, *given, "--quorum", "2")
    assert (code, told["anchored"]) == (0, "witnessed")
    assert told["cosigned"] == [
        {"witness": "w0.example", "time_s": AT},
        {"witness": "w1.example", "time_s": AT},
    ]
    assert "cosigned by w0.example at 2025-" in session("audit", "verify", name, *given[:6])[1]
    code, told = session.json("audit", "verify", name, *given)  # all three
    assert (code, told["error"]["code"]) == (4, "SIGNATURE_MISSING")
    assert session.json("audit", "verify", name, *given, "--quorum", "4")[0] == 2
    assert session.json("audit", "verify", name, *given, "--quorum", "0")[0] == 2
    # one key under two names is one witness
    twin = witness_key("twin.example", own[0].public_key())
    twice = (lines[0], cosign(text, twin.name, own[0], AT))
    name = session.export(ROWS, Note(text, (*session.note.signatures, *twice)))
    pair = ["--log-key", session.key, "--witness", keys[0].text(), "--witness", twin.text()]
    assert session.json("audit", "verify", name, *pair)[0] == 4
    assert session.json("audit", "verify", name, *pair, "--quorum", "1")[0] == 0
    # a log's own key is no witness, whatever it is called
    assert session.json("audit", "verify", name, *given[:2], "--witness", session.key)[0] == 4


def test_what_is_no_export_is_unreadable(session: Desk) -> None:
    good = row_line(ROWS[0])
    last = note_line(session.note.encode())
    doubled = good.removesuffix(b"}\n") + b',"seq":0}\n'
    for text in (
        *(b"{", b"{}\n", b'{"seq":0}\n', good + b"\xff\n", good + b"\n", doubled, last + good),
        *(good + last + last, b'{"checkpoint":1}\n', b'{"checkpoint":"","x":1}\n'),
        good.replace(b'"link":"', b'"link":"=') + last,
        b"{" + b" " * MAX_LINE + good,
    ):
        Path("junk.jsonl").write_bytes(text)
        code, told = session.json("audit", "verify", "junk.jsonl")
        assert (code, told["error"]["code"] != "INTERNAL_FAULT") == (4, True), text[:60]
    Path("empty.jsonl").write_bytes(b"")
    assert session.json("audit", "verify", "empty.jsonl")[0] == 4


def test_an_export_that_is_spelled_in_another_way_is_read(session: Desk) -> None:
    lines = [json.dumps(json.loads(row_line(row))) for row in ROWS]
    Path("loose.jsonl").write_text("\n".join(lines))
    assert session.json("audit", "verify", "loose.jsonl")[1]["whole"]


# by several processes


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Processes help from the first record on; returns how many were wanted each time."""
    wanted: list[int] = []

    def verify(rows: Any, *, jobs: int, anchors: Any) -> Any:
        wanted.append(jobs)
        return parallel.verify_in_pieces(rows, jobs=jobs, anchors=anchors, alone=0)

    monkeypatch.setattr(log_verify, "verify_in_pieces", verify)
    monkeypatch.setattr(parallel, "_ROWS", 16)
    monkeypatch.setattr(parallel, "_OWN_ROWS", 4)
    return wanted


def test_any_number_of_processes_tells_the_same_of_a_store_and_an_export(
    session: Desk, soon: list[int]
) -> None:
    rows = log_of(200)
    bad = [*rows[:170], edited(rows[170], open={}), *rows[171:]]
    note = session.signed(rows)
    for number, given in enumerate((rows, bad, rows[:90])):
        for name in (session.export(given, note), session.store(given, note, f"{number}.db")):
            told = [
                session.json("audit", "verify", name, "--log-key", session.key, "--jobs", jobs)
                for jobs in "123"
            ]
            assert told[0] == told[1] == told[2]
            assert (told[0][0], told[0][1]["whole"]) == ((0, True) if given is rows else (1, False))
    assert set(soon) == {1, 2, 3}
    (session.folder / "cut.jsonl").write_bytes((session.folder / "log.jsonl").read_bytes()[:-900])
    told = [session.json("audit", "verify", "cut.jsonl", "--jobs", jobs) for jobs in "123"]
    assert told[0] == told[1] == told[2]
    assert told[0][0] == 4


def test_without_being_asked_there_are_as_many_as_processors(
    session: Desk, soon: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_verify, "usable_jobs", lambda: 2)
    assert session("audit", "verify", session.export(ROWS, None))[0] == 0
    assert soon == [2]
    for jobs in ("0", "-1", "65", "many"):
        assert session.json("audit", "verify", "log.jsonl", "--jobs", jobs)[0] == 2
    assert soon == [2]


def test_beside_a_gate_that_tells_its_log_no_process_is_started(
    session: Desk, soon: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = GateAddress(pid=7, robot=ROBOT, socket="gate.sock")

    @contextmanager
    def told(_: Path) -> Iterator[ReadableLog]:
        yield ReadableLog(iter(ROWS), gate)

    monkeypatch.setattr(log_verify, "reading", told)
    assert session("audit", "verify", "robot.db", "--jobs", "4")[0] == 0
    assert soon == [1]


def test_a_process_that_is_killed_is_said_and_the_log_is_not_called_whole(
    session: Desk, soon: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = parallel._Helper

    class Killed(real):  # type: ignore[misc, valid-type]
        def __init__(self) -> None:
            super().__init__()
            os.kill(self.process.pid, signal.SIGKILL)
            os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOWAIT)

    monkeypatch.setattr(parallel, "_Helper", Killed)
    name = session.export(ROWS, None)
    code, text = session("audit", "verify", name, "--jobs", "2")
    assert code == 5
    assert text.startswith("INTERNAL_FAULT: not verified: a process that helped ended (code -9)")
    code, told = session.json("audit", "verify", name, "--jobs", "2")
    assert (code, set(told)) == (5, {"error"})


# export


def test_an_export_is_the_store_and_is_exported_to_itself(session: Desk) -> None:
    store = session.store(ROWS, session.note)
    assert session.json("audit", "export", store, "--out", "a.jsonl") == (
        0,
        {"file": "a.jsonl", "lines": SIZE + 1},
    )
    assert Path("a.jsonl").read_bytes() == Path(session.export(ROWS, session.note)).read_bytes()
    assert Path("a.jsonl").stat().st_mode & 0o777 == 0o600
    for line in Path("a.jsonl").read_bytes().splitlines():
        assert encode(json.loads(line)) == line
    assert session("audit", "export", "a.jsonl", "--out", "b.jsonl")[0] == 0
    assert Path("b.jsonl").read_bytes() == Path("a.jsonl").read_bytes()
    code, told = session.json("audit", "export", store, "--out", "a.jsonl")
    assert (code, told["error"]["where"]) == (5, "--out")
    assert session.json("audit", "export", store)[0] == 2
    assert session("audit", "export", "none.db")[0] == 4


def test_an_export_goes_to_standard_output(session: Desk, monkeypatch: Any) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="utf-8"))
    assert call(["audit", "export", session.store(ROWS, None)]) == 0
    assert raw.getvalue() == Path(session.export(ROWS, None)).read_bytes()


def test_a_table_has_a_line_for_each_record(session: Desk) -> None:
    code, _ = session(
        "audit", "export", session.store(ROWS, session.note), "--format", "csv", "--out", "t"
    )
    assert code == 0
    with Path("t").open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    assert head == list(COLUMNS)
    assert [line[0] for line in lines] == [str(n) for n in range(SIZE)]
    row = dict(zip(head, lines[2], strict=True))
    assert (row["kind"], row["decision"], row["mission"]) == ("decision", "reject", "m-1")
    assert (row["action"], row["destination"]) == ("navigate", "room-2")
    assert row["reasons"].startswith("RATE_LIMITED ")
    assert json.loads(row["open"])["deviation"] == [2, 7]


def test_no_cell_is_a_formula() -> None:
    for sign in ["=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b"]:
        with case(sign):
            assert cell(f"{sign}cmd|' /C calc'!A0").startswith("'")
            assert cell("x=1") == "x=1"
            assert (cell("-"), cell(None), cell(7), cell(["a"])) == ("-", "", "7", '["a"]')
            assert cell(-7) == "'-7"
            assert "\n" not in cell("a\nb\x1b[2J")


def test_a_damaged_store_is_not_exported_as_if_it_were_text() -> None:
    with pytest.raises(MalformedError):
        row_line(LogRow(0, b"\xff", b"{}", b""))
    with pytest.raises(MalformedError):
        note_line(b"\xff")


def test_a_note_reads_back_from_an_export(session: Desk) -> None:
    line = Path(session.export(ROWS, session.note)).read_bytes().splitlines()[-1]
    assert read_note(json.loads(line)["checkpoint"].encode(), where="") == session.note
