# SPDX-License-Identifier: Apache-2.0
"""What a machine believes and keeps: lists that are brought, and keys that it must not lose."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.keys.request import fingerprint
from authguard_r.cli import call
from authguard_r.core.encoding import encode_fast
from authguard_r.keys.envelope import is_sealed
from authguard_r.keys.trust import read_trust
from fixtures import scenarios
from fixtures.gate_process import RunningGate

EVERYWHERE = ("--every-robot", "--every-region")
OPERATOR = ("--role", "operator", "--principal", "operator-1", *EVERYWHERE)
LISTS = tuple(f"auth/revocations/{name}.json" for name in ("machines", "people", "root", "site"))


class Shell:
    """One working folder; every command's exit code and answer."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> tuple[int, str]:
        self._capsys.readouterr()
        code = call([str(word) for word in words])
        said = self._capsys.readouterr()
        assert "Traceback" not in said.out + said.err
        return code, said.out + said.err

    def json(self, *words: object) -> tuple[int, Any]:
        code, said = self(*words, "--json")
        return code, json.loads(said)


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.chdir(tmp_path)
    made = Shell(capsys)
    assert made("keys", "init", "auth", "--no-demo")[0] == 0
    return made


def member(shell: Shell, name: str = "op") -> None:
    """Give operator-1 key, certificate and trust folder."""
    assert shell("keys", "request", *OPERATOR, "--out", name)[0] == 0
    request = f"{name}/operator-1.request.json"
    assert shell("keys", "issue", "auth", request, "--yes")[0] == 0
    assert install(shell, name)[0] == 0


def install(shell: Shell, name: str = "op", *more: object) -> tuple[int, str]:
    root = fingerprint(read_trust(Path("auth")).roots)
    words = (f"{name}/operator-1.answer.json", "--key", f"{name}/operator-1.key.pem")
    return shell("keys", "install", *words, "--trust", f"{name}/trust", "--root", root, *more)


def numbers(folder: str) -> dict[str, int]:
    return {known.authority: known.number for known in read_trust(Path(folder)).lists.values()}


# lists


def test_every_list_is_brought_though_most_are_there_already(shell: Shell) -> None:
    member(shell)
    assert shell("keys", "revoke", "auth", "operator-1")[0] == 0
    for _ in range(2):
        code, told = shell.json("advanced", "revocations", "install", *LISTS, "--trust", "op/trust")
        assert (code, len(told["installed"])) == (0, 4)
        assert numbers("op/trust") == {"root": 1, "site": 1, "machines": 1, "people": 2}


def test_what_did_not_go_in_is_said_and_the_others_did(shell: Shell) -> None:
    member(shell)
    shutil.copy("auth/revocations/people.json", "older.json")
    for name in ("operator-1", "site"):
        assert shell("keys", "revoke", "auth", name)[0] == 0
    Path("junk.json").write_bytes(b"{}")
    words = ("advanced", "revocations", "install", "none.json", "junk.json", "older.json", *LISTS)
    code, told = shell.json(*words, "--trust", "op/trust")
    assert (code, told["error"]["code"]) == (5, "FILE_UNAVAILABLE")
    assert [(item["file"], item["at"]) for item in told["refused"]] == [
        ("none.json", "nowhere"),
        ("junk.json", "op/trust"),
    ]
    assert numbers("op/trust") == {"root": 2, "site": 1, "machines": 1, "people": 2}
    code, told = shell.json(
        "advanced", "revocations", "install", "older.json", LISTS[0], "--trust", "op/trust"
    )
    assert (code, told["error"]["code"]) == (4, "REVOCATION_STALE")
    code, said = shell(
        "advanced", "revocations", "install", "older.json", LISTS[0], "--trust", "op/trust"
    )
    assert code == 4
    assert "op/trust: machines number 1" in said
    assert "older.json, at op/trust: expected a list after number 2" in said


def test_a_gate_that_has_the_list_does_not_keep_it_from_the_folder(tmp_path: Path) -> None:
    own, copy = tmp_path / "own", tmp_path / "copy"
    for folder in (own, copy):  # the tests' own set-up is everybody's
        shutil.copytree(scenarios.trust_folder(), folder)
    with RunningGate(simulate=True, trust=own) as gate:
        assert call(["keys", "revoke", str(gate.trust), "supervisor-2"]) == 0
        lists = [str(path) for path in sorted((gate.trust / "revocations").glob("*.json"))]
        words = ["advanced", "revocations", "install", *lists, "--gate", str(gate.socket)]
        assert call(words) == 0
        assert call([*words, "--trust", str(copy)]) == 0
        assert numbers(str(copy))["people"] == 2


def test_a_gate_that_is_not_there_does_not_keep_it_from_the_folder(shell: Shell) -> None:
    member(shell)
    assert shell("keys", "revoke", "auth", "operator-1")[0] == 0
    words = (
        "advanced",
        "revocations",
        "install",
        LISTS[1],
        "--gate",
        "nowhere",
        "--trust",
        "op/trust",
    )
    code, told = shell.json(*words)
    assert (code, [item["at"] for item in told["refused"]]) == (5, ["gate"])
    assert numbers("op/trust")["people"] == 2


# answers


def test_an_answer_that_was_changed_on_the_way_is_not_installed(shell: Shell) -> None:
    member(shell)
    answer = Path("op/operator-1.answer.json")
    before = answer.read_bytes()
    honest = json.loads(before)
    assert shell("keys", "init", "other", "--no-demo")[0] == 0
    shutil.move("auth", "honest")
    shutil.move("other", "auth")
    member(shell, "two")
    shutil.move("auth", "other")
    shutil.move("honest", "auth")
    other = json.loads(Path("two/operator-1.answer.json").read_bytes())
    for part in ("authorities", "lists"):
        honest[part]["people"] = other[part]["people"]
    answer.write_bytes(encode_fast(honest) + b"\n")
    trust = {path: path.read_bytes() for path in Path("op/trust").rglob("*") if path.is_file()}
    code, said = install(shell)
    assert (code, "CERTIFICATE_INVALID" in said) == (4, True)
    assert trust == {path: path.read_bytes() for path in trust}
    answer.write_bytes(before)
    assert install(shell)[0] == 0


# private keys


def held() -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in Path().rglob("*.key.pem")}


def test_no_command_writes_over_a_private_key(shell: Shell) -> None:
    member(shell)
    Path("said").write_text("words that nobody knows\n")
    Path("said").chmod(0o600)
    key, root = "op/operator-1.key.pem", "auth/keys/root.key.pem"
    before = held()
    site = scenarios.HOSPITAL / "site.yaml"
    for words in (
        ("keys", "public", "--key", key, "--out", key),
        ("keys", "public", "--key", key, "--out", root),
        ("keys", "protect", key, "--passphrase-file", "said", "--out", root),
        ("keys", "issue", "auth", "op/operator-1.request.json", "--yes", "--out", root),
        ("risk-policy", "make", "--organization", "h", "--site", site, "--out", key),
        ("site", "show", site, "--svg", key),
    ):
        code, told = shell.json(*words)
        assert (code, told["error"]["code"]) == (5, "FILE_UNAVAILABLE"), words
        assert held() == before, words
    assert install(shell, "op", "--cert", key)[0] == 5
    assert held() == before
    # in its own place it is only another form of the same key
    assert shell("keys", "protect", key, "--passphrase-file", "said", "--out", key)[0] == 0
    assert is_sealed(Path(key).read_bytes())
    out = ("--out", "op/sub/../operator-1.key.pem")
    Path("op/sub").mkdir()
    assert shell("keys", "unprotect", key, "--passphrase-file", "said", *out)[0] == 0
    assert held() == before


def test_a_half_made_request_says_how_to_go_on(shell: Shell) -> None:
    Path("op/operator-1.request.json").mkdir(parents=True)
    assert shell("keys", "request", *OPERATOR, "--out", "op")[0] == 5
    before = held()
    assert Path("op/operator-1.key.pem") in before
    Path("op/operator-1.request.json").rmdir()
    code, said = shell("keys", "request", *OPERATOR, "--out", "op")
    assert (code, "keys request --key op/operator-1.key.pem" in said) == (5, True)
    words = ("--key", "op/operator-1.key.pem", "--out", "op")
    assert shell("keys", "request", *OPERATOR, *words)[0] == 0
    assert held() == before
    assert shell("keys", "issue", "auth", "op/operator-1.request.json", "--yes")[0] == 0


# set-ups


@pytest.mark.parametrize(
    "words",
    [
        ("--no-demo", "--robot", "lifter-1"),
        ("--authorities", "people"),
        ("--demo", "--authorities", "people,site"),
        ("--no-demo", "--authorities", ""),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(shell: Shell, words: tuple[str, ...]) -> None:
    code, told = shell.json("keys", "init", "new", *words)
    assert (code, told["error"]["code"], Path("new").exists()) == (2, "USAGE", False)
