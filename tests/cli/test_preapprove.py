# SPDX-License-Identifier: Apache-2.0
"""`authguard approvals preapprove`: a person says yes to what is shown, or nothing is signed."""

from __future__ import annotations

import io
import json
import shutil
import sys
from pathlib import Path

import pytest

from authguard_r.cli import call
from fixtures import scenarios

SITE = ["--site", "h/site.yaml"]
PLACE = ["--trust", "trust", *SITE, "--store", "robot.db"]
SIGNER = [
    *("--key", "trust/keys/supervisor-1.key.pem"),
    *("--cert", "trust/keys/supervisor-1.cert.pem"),
]
SOME = ["--row", "0", "--most-risk", "40", "--valid", "10 min"]


class Shell:
    """One working folder with an active mission in its store, and what the last command printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: str, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call(list(arguments))
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def preapprove(self, *arguments: str, stdin: bytes = b"") -> tuple[int, str]:
        command = ["approvals", "preapprove", "m.token", "--grant", "go-to-pharmacy", *arguments]
        return self(*command, *SIGNER, *PLACE, stdin=stdin)

    def left(self) -> list[int]:
        """Return how many releases each pre-approval of the mission covers still."""
        shown = json.loads(self("audit", "show", "robot.db", "--json")[1])
        told = [r for r in shown["records"] if r["open"].get("verb") == "preapprove"]
        return [record["open"]["uses"] for record in told]


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    made = Shell(capsys, monkeypatch)
    assert made("mission", "compile", "h/mission.yaml", *SITE, "--out", "m.json")[0] == 0
    stem = "trust/keys/operator-1"
    keys = ("--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem")
    assert made("mission", "sign", "m.json", *keys, *SITE, "--out", "m.token", "--yes")[0] == 0
    assert made("mission", "activate", "m.token", *PLACE, "--new")[0] == 0
    return made


@pytest.mark.parametrize("stdin", [b"", b"n\n"])
def test_without_a_yes_nothing_is_signed(shell: Shell, stdin: bytes) -> None:
    code, out = shell.preapprove(*SOME, "--uses", "1", stdin=stdin)
    assert code != 0
    assert "up to risk 40, 1 use(s)" in out
    assert shell.left() == []


def test_what_was_shown_is_signed_and_recorded_once(shell: Shell) -> None:
    code, out = shell.preapprove(*SOME, "--uses", "2", stdin=b"y\n")
    assert code == 0, out
    assert "the gate took it in" in out
    assert shell.left() == [2]
    code, out = shell.preapprove("--uses", "0", "--yes")
    assert code == 0, out
    assert "withdrawn" in out
    assert shell.left() == [2, 0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--uses", "1"], "--row"),
        (["--uses", "1", "--row", "0", "--most-risk", "40"], "--valid"),
        ([*SOME[:4], "--valid", "9007199254740991 ms", "--uses", "1"], "before the mission's"),
        ([*SOME[:4], "--valid", "10", "--uses", "1"], "unit"),
        (["--row", "0", "--most-risk", "60", "--valid", "1 min", "--uses", "1"], "tau_2"),
        (["--row", "9", "--most-risk", "40", "--valid", "1 min", "--uses", "1"], "has rows 0"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_recorded(
    shell: Shell, arguments: list[str], told: str
) -> None:
    code, out = shell.preapprove(*arguments, "--yes")
    assert code != 0
    assert told in out
    assert shell.left() == []
