# SPDX-License-Identifier: Apache-2.0
"""What an operator of a witness types, and what each mistake is answered with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.note import read_key
from authguard_r.cli import call
from authguard_r.keys.algorithms import Algorithm
from fixtures.witness_process import NAME, NOW_S, ORIGIN, Log, make, opened


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> tuple[int, str]:
        code = call(["witness", *map(str, words)])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *words: object) -> tuple[int, Any]:
        code, out = self(*words, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def log() -> Log:
    return Log().grow(20)


@pytest.mark.parametrize(("algorithm", "kind"), [("ed25519", b"\x04"), ("ml-dsa-44", b"\x06")])
def test_init_prints_the_key_that_others_know_it_by(
    shell: Shell, tmp_path: Path, algorithm: str, kind: bytes
) -> None:
    folder = tmp_path / "w"
    code, text = shell("init", folder, "--name", NAME, "--algorithm", algorithm)
    assert code == 0
    key = read_key(text, where="key")
    assert (key.name, key.kind) == (NAME, kind)
    assert shell.json("show", folder) == (
        0,
        {"name": NAME, "key": key.text(), "logs": [], "evidence": [], "acts": []},
    )
    assert folder.stat().st_mode & 0o777 == 0o700
    assert (folder / "witness.key.pem").stat().st_mode & 0o777 == 0o600
    # a second time would be a second witness under one name
    code, told = shell.json("init", folder, "--name", NAME)
    assert (code, told["error"]["code"]) == (5, "FILE_UNAVAILABLE")
    assert shell.json("show", folder)[1]["key"] == key.text()


def test_mistakes_at_init_make_nothing(shell: Shell, tmp_path: Path) -> None:
    folder = tmp_path / "w"
    assert shell.json("init", folder, "--name", "a b")[0] == 4
    assert shell.json("init", folder)[0] == 2
    assert shell.json("init", folder, "--name", NAME, "--algorithm", "rsa")[0] == 2
    assert shell.json("init", folder, "--name", NAME, "--algorithm", "ml-dsa-65")[0] == 2
    assert not folder.exists()


def test_a_log_is_added_shown_and_forgotten(shell: Shell, tmp_path: Path, log: Log) -> None:
    folder = make(tmp_path / "w")
    code, told = shell.json("add", folder, "--log", log.texts[0])
    assert (code, told) == (0, {"origin": ORIGIN, "keys": [log.texts[0]], "changed": True})
    assert shell("add", folder, "--log", log.texts[0]) == (0, f"{ORIGIN}: known already\n")
    with opened(folder) as witness:
        witness.answer(log.ask(0, 10), NOW_S)
        witness.answer(log.fork(3).grow(7).ask(10), NOW_S)
    code, told = shell.json("show", folder)
    assert [(one["size"], one["time_s"]) for one in told["logs"]] == [(10, NOW_S)]
    assert [one["finding"] for one in told["evidence"]] == ["forked"]
    code, text = shell("show", folder)
    assert f"{ORIGIN}: 10 records, root " in text
    assert "  1 forked\n" in text
    code, told = shell.json("forget", folder, ORIGIN)
    assert (code, told["origin"], ORIGIN in told["note"]) == (0, ORIGIN, True)
    code, told = shell.json("forget", folder, ORIGIN)
    assert (code, told["error"]["code"]) == (1, "TRANSITION_REFUSED")
    code, told = shell.json("show", folder)
    assert told["logs"] == []
    assert [act["act"] for act in told["acts"]] == ["add", "forget"]


def test_a_hybrid_log_and_a_changed_key(shell: Shell, tmp_path: Path) -> None:
    folder = make(tmp_path / "w")
    hybrid = Log(Algorithm.ED25519, Algorithm.ML_DSA_65)
    words = [word for text in hybrid.texts for word in ("--log", text)]
    code, text = shell("add", folder, *words)
    assert (code, text) == (0, f"{ORIGIN}: registered\n  2 keys, which all have to sign\n")
    assert "none yet" in shell("show", folder)[1]
    other = Log().texts[0]
    assert shell.json("add", folder, "--log", other)[0] == 1
    assert shell.json("add", folder, "--log", other, "--replace")[0] == 0


@pytest.mark.parametrize("text", ["", "x", "a+b+c", "x" * 5_000, "\udcff"])
def test_what_is_no_key_is_refused(shell: Shell, tmp_path: Path, text: str) -> None:
    folder = make(tmp_path / "w")
    assert shell.json("add", folder, "--log", text)[0] == 4
    assert shell.json("add", folder)[0] == 2


def test_a_witness_that_serves_is_not_changed_under_its_feet(
    shell: Shell, tmp_path: Path, log: Log
) -> None:
    folder = make(tmp_path / "w", log)
    with opened(folder):
        for words in (("add", folder, "--log", log.texts[0]), ("forget", folder, ORIGIN)):
            code, told = shell.json(*words)
            assert (code, "another process" in told["error"]["message"]) == (5, True)
        assert shell.json("show", folder)[0] == 0


def test_no_witness_is_said_to_be_none(shell: Shell, tmp_path: Path, log: Log) -> None:
    for folder in (tmp_path, tmp_path / "absent", Path("/dev/null")):
        for words in (
            ("show", folder),
            ("serve", folder),
            ("forget", folder, ORIGIN),
            ("add", folder, "--log", log.texts[0]),
        ):
            assert shell.json(*words)[0] == 5


@pytest.mark.parametrize("listen", ["", "x", "localhost:80", "127.0.0.1", "0.0.0.0:0"])
def test_serve_says_where_it_cannot_listen(shell: Shell, tmp_path: Path, listen: str) -> None:
    folder = make(tmp_path / "w")
    code, told = shell.json("serve", folder, "--listen", listen)
    assert (code, told["error"]["where"]) == (4, "--listen")
