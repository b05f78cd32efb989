# SPDX-License-Identifier: Apache-2.0
"""`authguard run --safety` with rules: refused in words, told at the end, verified and replayed."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.cli import call
from authguard_r.core.encoding import Tag
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import sign_object
from authguard_r.safety import Rule, default_config
from fixtures import scenarios

HOSPITAL = scenarios.HOSPITAL
NOW = to_timestamp(scenarios.START_MS)


class Shell:
    """A folder with a signed mission and signed rules."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._capsys = capsys
        (folder / "m.token").write_bytes(scenarios.token())

    def sign(self, **formulas: str) -> None:
        rules = tuple(Rule(id=name, formula=text) for name, text in formulas.items())
        config = msgspec.structs.replace(
            default_config(scenarios.site(), scenarios.RID), rules=rules
        )
        officer = scenarios.folder_signer(scenarios.trust_folder(), "safety-officer-1")
        (self.folder / "s.token").write_bytes(sign_object(config, Tag.SAFETY, officer))

    def run(self, reply: str, *more: str) -> tuple[int, Any]:
        return self(
            "run",
            *("--token", self.folder / "m.token", "--trust", scenarios.trust_folder()),
            *("--site", HOSPITAL / "site.yaml", "--binding", HOSPITAL / "binding.yaml"),
            *("--plan", HOSPITAL / "replies" / f"{reply}.json", "--store", self.folder / "r.db"),
            *("--safety", self.folder / "s.token", "--robot", scenarios.RID, "--now", NOW, *more),
        )

    def __call__(self, *words: object) -> tuple[int, Any]:
        code = call([*map(str, words), "--json"])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, json.loads(out.out)


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))
    return Shell(tmp_path, capsys)


def test_a_rule_refuses_a_step_and_the_log_is_whole_and_replays(shell: Shell) -> None:
    shell.sign(light="G (type = pick -> params.force_mn <= 11999)", home="F destination = dock")
    code, ran = shell.run("01-collect")
    assert code == 1
    assert [step["outcome"] for step in ran["steps"]] == ["accept", "accept"]
    found = ran["steps"][1]["safety"]["findings"]
    assert [(item["hazard"], item["field"]) for item in found] == [("RULE", "rules.light")]
    assert ran["rules_open"] == ["home"]
    store = shell.folder / "r.db"
    assert shell("audit", "verify", store, "--trust", scenarios.trust_folder())[0] == 0
    code, again = shell("audit", "replay", store, "--trust", scenarios.trust_folder())
    assert (code, again["decisions"], again["differ"], again["not_replayable"]) == (0, 2, 0, 0)


def test_without_rules_none_is_open(shell: Shell) -> None:
    shell.sign()
    code, ran = shell.run("01-collect")
    assert (code, ran["rules_open"]) == (0, [])


def test_a_signed_rule_that_is_none_ends_the_command_with_its_place(shell: Shell) -> None:
    shell.sign(first="G type != pick", second="G colour = red")
    code, told = shell.run("01-collect")
    assert code == 4
    assert "safety.rules[1].formula:3" in json.dumps(told)
    assert not (shell.folder / "r.db").exists()
