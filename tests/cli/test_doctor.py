# SPDX-License-Identifier: Apache-2.0
"""The doctor looks at the whole set-up: exit 0 when nothing is unsafe, 5 when something is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.cli import call
from authguard_r.core.encoding import Tag
from authguard_r.core.token import sign_object
from unit.gate.robots import ME, config, peers, robot

LEVELS = {"ok", "warning", "unsafe"}


def doctor(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = call(["doctor", *words, "--json"])
    told = json.loads(capsys.readouterr().out)
    for item in told.get("advice", ()):
        assert set(item) == {"part", "level", "code", "message", "place", "mend"}
        assert item["level"] in LEVELS
        assert item["mend"] or item["level"] == "ok"
    return code, told


def codes(told: dict[str, Any], level: str) -> set[str]:
    return {item["code"] for item in told["advice"] if item["level"] == level}


@pytest.fixture
def demo(tmp_path: Path, monkeypatch: Any) -> list[str]:
    """A whole set-up in one folder, as the first hour makes it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds.trust_folder(), "trust")
    Path("run").mkdir()
    signer = folder_signer(Path("trust"), "site-authority-1")
    Path("gate.token").write_bytes(sign_object(config(), Tag.GATE, signer))
    return [
        *("--trust", "trust", "--site", str(worlds.HOSPITAL / "site.yaml")),
        *("--binding", str(worlds.HOSPITAL / "binding.yaml"), "--store", "robot.db"),
        *("--run", "run", "--config", "gate.token", "--key", "trust/keys/gate-courier-1.key.pem"),
        *("--cert", "trust/keys/gate-courier-1.cert.pem"),
    ]


def test_a_trial_in_one_folder_is_warned_of_and_not_refused(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    code, told = doctor(capsys, *demo)
    assert (code, told["safe"]) == (0, True), codes(told, "unsafe")
    assert {"DEMO_ROOT", "UNCOMPARED", "USER"} <= codes(told, "warning")
    assert call(["doctor", *demo]) == 0
    assert "warning  trust: the root says `demo`" in capsys.readouterr().out


def test_a_store_that_is_not_there_is_said_and_no_mend_has_to_be_guessed(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, told = doctor(capsys, *demo)
    store = next(item for item in told["advice"] if item["part"] == "store")
    assert (store["level"], store["place"]) == ("warning", "robot.db")
    assert "does not exist yet" in store["message"]
    mend = next(item["mend"] for item in told["advice"] if item["part"] == "binding")
    binding, site = demo[demo.index("--binding") + 1], demo[demo.index("--site") + 1]
    assert mend == f"authguard binding check {binding} --site {site} --interface FILE"
    Path("file").write_text("")
    demo[demo.index("--run") + 1] = "file"
    code, told = doctor(capsys, *demo)
    assert (code, "expected a folder" in str(told["advice"])) == (5, True)


def test_one_unsafe_part_is_5_and_named(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("trust/keys/gate-courier-1.key.pem").chmod(0o640)
    code, told = doctor(capsys, *demo)
    assert (code, told["safe"], codes(told, "unsafe")) == (5, False, {"KEY_MODE"})


@pytest.mark.parametrize("part", ["--site", "--binding", "--config"])
def test_a_part_that_cannot_be_read_is_unsafe(
    demo: list[str], part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("junk").write_text("[")
    words = [*demo]
    words[words.index(part) + 1] = "junk"
    code, told = doctor(capsys, *words)
    assert code == 5
    assert {item["place"] for item in told["advice"] if item["level"] == "unsafe"} >= {"junk"}
    words[words.index(part) + 1] = "missing"
    assert doctor(capsys, *words)[0] == 5


def test_a_part_without_what_it_is_read_by_is_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(capsys, "--config", "gate.token")[0] == 2
    assert doctor(capsys, "--binding", "ros-mcp")[0] == 2
    assert doctor(capsys, "--user", "no-such-user-here")[0] == 4


def test_a_shipped_binding_is_compared_with_its_own_interface(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*demo]
    words[words.index("--binding") + 1] = "ros-mcp"
    _, told = doctor(capsys, *words)
    assert not any("compared with no interface" in item["message"] for item in told["advice"])


def test_a_folder_that_init_made_is_looked_at_whole_and_says_what_is_still_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tools.json").write_text('[{"type": "function", "name": "go"}]')
    assert call(["init", "--from", "openai", "tools.json", "--out", "cell"]) == 0
    capsys.readouterr()
    code, told = doctor(capsys, "cell")
    assert code == 0
    said = {item["message"]: item["place"] for item in told["advice"]}
    assert said["`robot-1` can do nothing yet"] == "robots.robot-1.profile.tools"
    assert any(text.startswith("unreviewed") for text in said)
    assert any("every field bound" in text for text in said)
    assert doctor(capsys, "cell", "--interface", "missing")[0] == 5
    site = Path("cell/site.yaml")
    site.write_text(site.read_text().replace("tools: {}", "tools: {wait: [base]}"))
    code, told = doctor(capsys, "cell")
    assert code == 5
    mends = [item["mend"] for item in told["advice"] if item["level"] == "unsafe"]
    assert mends == ["make keys for it: authguard keys init FOLDER --site cell/site.yaml"]
    assert doctor(capsys, "tools.json")[0] == 2


def test_a_robots_own_folders_are_safe_for_its_user_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup = robot(tmp_path)
    words = [
        *("--trust", str(setup.trust), "--key", str(setup.key), "--cert", str(setup.chain)),
        *("--store", str(setup.store), "--run", str(setup.run)),
    ]
    code, told = doctor(capsys, *words, "--user", str(ME))
    assert (code, codes(told, "unsafe")) == (0, set())
    code, told = doctor(capsys, *words, "--user", str(ME + 1))
    assert code == 5
    assert {"KEY_OWNER", "OWNER"} <= codes(told, "unsafe")


def test_roles_that_one_user_has_are_unsafe(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, *others = peers()
    both = replace(first, roles=tuple(sorted((*first.roles, *second.roles))))
    signer = folder_signer(Path("trust"), "site-authority-1")
    shared = config(peers=(both, *others))
    Path("gate.token").write_bytes(sign_object(shared, Tag.GATE, signer))
    code, told = doctor(capsys, *demo)
    # in one folder nothing is apart anyway; a gate that is no trial refuses it
    assert (code, "SHARED_USER" in codes(told, "warning")) == (0, True)
