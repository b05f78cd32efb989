# SPDX-License-Identifier: Apache-2.0
"""`authguard ros`: a keystore and its check, as users and other programs call them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import call, ros
from authguard_r.integrations.ros.keystore import KEY
from fixtures.ros_keystores import EXAMPLE, example, home, resign


def told(capsys: Any) -> dict[str, Any]:
    """Return the one object that a command printed."""
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_keystore_is_made_and_found_sound(tmp_path: Path, capsys: Any) -> None:
    folder = tmp_path / "keystore"
    assert call(["ros", "keystore", str(EXAMPLE), str(folder), "--json"]) == 0
    made = told(capsys)
    assert (made["domain"], len(made["enclaves"])) == (42, 8)
    assert call(["ros", "check", str(EXAMPLE), "--keystore", str(folder)]) == 0
    assert "/authguard/gate alone can move the robot" in capsys.readouterr().out
    assert call(["ros", "keystore", str(EXAMPLE), str(folder)]) == 5
    assert "new or empty folder" in capsys.readouterr().err


def test_who_else_could_move_the_robot_is_named(tmp_path: Path, capsys: Any) -> None:
    folder = tmp_path / "keystore"
    assert call(["ros", "keystore", str(EXAMPLE), str(folder)]) == 0
    capsys.readouterr()
    change = {"<topic>rt/llm/cmd_vel</topic>": "<topic>rt/*</topic>"}
    resign(folder, "/llm/planner", "permissions", change)
    assert call(["ros", "check", str(EXAMPLE), "--keystore", str(folder), "--json"]) == 1
    faults = told(capsys)["faults"]
    assert {fault["where"] for fault in faults} == {"/llm/planner"}
    assert "MAY_ACTUATE" in {fault["code"] for fault in faults}


def test_this_shell_is_looked_at_as_an_enclaves_process(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "keystore"
    assert call(["ros", "keystore", str(EXAMPLE), str(folder)]) == 0
    right = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(folder),
        "ROS_DOMAIN_ID": str(example().domain),
    }
    for name, value in right.items():
        monkeypatch.setenv(name, value)
    plain = ["ros", "check", str(EXAMPLE), "--enclave", "/authguard/gate"]
    assert call(plain) == 0
    assert "its security enforced" in capsys.readouterr().out
    words = [*plain, "--json"]
    capsys.readouterr()
    assert call(words) == 0
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "TRUE")
    home(folder, "/authguard/gate").joinpath(KEY).chmod(0o644)
    capsys.readouterr()
    assert call(words) == 1
    codes = {fault["code"] for fault in told(capsys)["faults"]}
    assert codes == {"SECURITY_NOT_ENFORCED", "KEY_EXPOSED"}


def test_a_map_alone_is_read_and_shown(capsys: Any, tmp_path: Path) -> None:
    assert call(["ros", "check", str(EXAMPLE)]) == 0
    said = capsys.readouterr().out
    assert "navigate: action /llm/navigate_to_pose -> /navigate_to_pose" in said
    assert "nothing shows who can move the robot" in said
    wrong = tmp_path / "map.yaml"
    wrong.write_text(EXAMPLE.read_text().replace("public: /llm/light", "public: /light"))
    assert call(["ros", "check", str(wrong), "--json"]) == 4
    assert told(capsys)["error"]["where"].endswith("mediated.light.public")


@pytest.mark.parametrize("command", ["keystore", "check"])
def test_without_the_extra_it_says_so(
    command: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros, "find_spec", lambda name: None)
    words = {
        "keystore": ["ros", "keystore", str(EXAMPLE), str(tmp_path / "x")],
        "check": ["ros", "check", str(EXAMPLE), "--keystore", str(tmp_path)],
    }
    assert call(words[command]) == 5
    assert "authguard-r[ros]" in capsys.readouterr().err
    shutil.rmtree(tmp_path)


def test_a_keystore_that_would_not_be_sound_is_said_so(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check is other code than the maker: here the maker forgets to sign for this domain."""
    from authguard_r.integrations.ros import keystore

    monkeypatch.setattr(keystore, "governance", lambda domain: keystore_of(domain + 1))
    assert call(["ros", "keystore", str(EXAMPLE), str(tmp_path / "x")]) == 4
    assert "the keystore is not sound" in capsys.readouterr().err


def keystore_of(domain: int) -> bytes:
    """Return the governance of another domain."""
    from authguard_r.integrations.ros.documents import governance

    return governance(domain)
