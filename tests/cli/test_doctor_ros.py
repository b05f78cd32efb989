# SPDX-License-Identifier: Apache-2.0
"""`authguard doctor --ros` and `ros check --binding`: what a robot on ROS 2 has, before it starts.

One sound robot, and one thing changed each time. Types are looked at in tests/ros/test_doctor.py.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from authguard_r.cli import call, ros
from authguard_r.cli.doctor_ros import rmw_advice
from authguard_r.integrations.ros.keystore import KEY, PRIVATE
from authguard_r.operations.checkup.advice import Level
from fixtures.ros_keystores import EXAMPLE, home, plain_map, resign
from fixtures.scenarios import ROOT

SITE = ROOT / "examples" / "ros" / "site.yaml"
BINDING = ROOT / "examples" / "ros" / "binding.yaml"
GATE = "/authguard/gate"
Advice = dict[str, str]


@pytest.fixture
def keystore(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A keystore, and this process's variables as its processes want them."""
    folder = tmp_path / "keystore"
    assert call(["ros", "keystore", str(EXAMPLE), str(folder)]) == 0
    shutil.rmtree(folder / PRIVATE)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(folder))
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    monkeypatch.delenv("ROS_SECURITY_ENCLAVE_OVERRIDE", raising=False)
    return folder


def asked(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, list[Advice]]:
    """Return the exit code, and what was found of ROS."""
    capsys.readouterr()
    code = call(["doctor", *map(str, words), "--json"])
    told: dict[str, list[Advice]] = json.loads(capsys.readouterr().out)
    for item in told["advice"]:
        assert item["mend"] or item["level"] == "ok"
        assert item["place"] or item["level"] != "unsafe"
    return code, told["advice"]


def of(code: str, found: list[Advice], level: str = "unsafe") -> list[Advice]:
    return [item for item in found if (item["code"], item["level"]) == (code, level)]


def changed_map(folder: Path, change: Any) -> Path:
    plain = plain_map()
    change(plain)
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(plain))
    return path


def test_a_sound_robot_is_said_to_be_one(
    keystore: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--ros", EXAMPLE, "--binding", BINDING, "--site", SITE)
    _, found = asked(capsys, *words)
    assert [item["code"] for item in found if item["level"] == "unsafe"] == []
    assert (
        of("BINDING", found, "ok")[-1]["message"] == "every mediated name is a way of the binding"
    )
    assert "42, 4 mediated" in of("ROS_MAP", found, "ok")[0]["message"]
    assert GATE in of("ROS_SECURITY", found, "ok")[0]["message"]
    assert of("ROS_CLOCK", found, "ok")
    # what cannot be known here is not said to be well
    assert of("ROS_TYPE", found, "warning")
    assert not of("ROS_RMW", found, "ok")
    assert of("ROS_KEYSTORE", found, "ok") == []


def test_without_a_map_nothing_of_ros_is_looked_at(
    keystore: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, found = asked(capsys)
    assert [item for item in found if item["code"].startswith("ROS_")] == []


def test_a_map_with_a_fault_is_unsafe_and_nothing_else_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed_map(tmp_path, lambda plain: plain.update(domain=500))
    code, found = asked(capsys, "--ros", path)
    (fault,) = [item for item in found if item["part"].startswith("ros")]
    assert (code, fault["code"], fault["level"]) == (5, "ROS_MAP", "unsafe")
    assert fault["place"] == f"{path}:domain"
    assert asked(capsys, "--ros", tmp_path / "none.yaml")[0] == 5


def rename(plain: dict[str, Any]) -> None:
    plain["mediated"]["light"]["private"] = "/lamp"


def other_robot(plain: dict[str, Any]) -> None:
    plain["robot"] = "courier-9"


def wrong_kind(plain: dict[str, Any]) -> None:
    plain["mediated"]["drive"]["kind"] = "message"


MISFITS = {
    "a name that is no way": (rename, "mediated.light"),
    "another's robot": (other_robot, "map.robot"),
    "what moves as one message": (wrong_kind, "mediated.drive.kind"),
}


@pytest.mark.parametrize(("change", "place"), MISFITS.values(), ids=MISFITS.keys())
def test_a_map_that_the_node_would_not_serve_is_named_by_both_commands(
    change: Any, place: str, keystore: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed_map(tmp_path, change)
    words = ["--binding", str(BINDING), "--site", str(SITE)]
    code, found = asked(capsys, "--ros", path, *words)
    assert code == 5
    assert place in of("BINDING", found)[0]["message"]
    assert call(["ros", "check", str(path), *words, "--json"]) == 4
    assert json.loads(capsys.readouterr().out)["error"]["where"] == place


def test_streams_of_a_robot_that_nobody_knows_to_stand_are_named(
    keystore: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = yaml.safe_load(SITE.read_text())
    del plain["robots"]["courier-1"]["profile"]["brake_mm_s2"]
    del plain["robots"]["courier-1"]["profile"]["reaction_ms"]
    site = tmp_path / "site.yaml"
    site.write_text(yaml.safe_dump(plain))
    code = call(["ros", "check", str(EXAMPLE), "--binding", str(BINDING), "--site", str(site)])
    assert code == 4
    assert "how it brakes (at mediated.drive)" in capsys.readouterr().err


def test_check_says_that_every_name_is_a_way(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ros", "check", str(EXAMPLE), "--binding", str(BINDING)]
    assert call([*words, "--site", str(SITE)]) == 0
    assert "every mediated name is a way of" in capsys.readouterr().out
    assert call(words) == 2
    assert "expected both or neither" in capsys.readouterr().err


WRONG = {
    "capitals": ("ROS_SECURITY_ENABLE", "TRUE", "export ROS_SECURITY_ENABLE=true"),
    "a permissive word": ("ROS_SECURITY_STRATEGY", "enforce", "export ROS_SECURITY_STRATEGY"),
    "another domain": ("ROS_DOMAIN_ID", "0", "export ROS_DOMAIN_ID=42"),
    "another enclave": ("ROS_SECURITY_ENCLAVE_OVERRIDE", "/llm/planner", "unset ROS_SECURITY_ENC"),
    "a relative keystore": ("ROS_SECURITY_KEYSTORE", "keystore", "authguard ros keystore"),
}


@pytest.mark.parametrize(("name", "value", "mend"), WRONG.values(), ids=WRONG.keys())
def test_a_variable_that_ros_would_take_for_no_security_is_unsafe(
    name: str,
    value: str,
    mend: str,
    keystore: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(name, value)
    code, found = asked(capsys, "--ros", EXAMPLE)
    (fault,) = of("ROS_SECURITY", found)
    assert (code, fault["place"]) == (5, name)
    assert mend in fault["mend"]


def test_a_process_is_looked_at_as_its_own_user_in_its_own_enclave(
    keystore: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = home(keystore, "/llm/planner") / KEY
    assert asked(capsys, "--ros", EXAMPLE, "--enclave", "/llm/planner")[0] == 0
    someone = os.geteuid() + 1
    code, found = asked(
        capsys, "--ros", EXAMPLE, "--enclave", "/llm/planner", "--user", str(someone)
    )
    assert code == 5
    assert of("ROS_SECURITY", found)[0]["place"] == str(key)
    code, found = asked(capsys, "--ros", EXAMPLE, "--enclave", "/llm/nobody")
    assert (code, of("ROS_SECURITY", found)[0]["place"]) == (5, "--enclave")


def test_one_user_with_two_keys_is_unsafe_and_in_a_demonstration_warned_of(
    keystore: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = ("--ros", EXAMPLE, "--keystore", keystore)
    code, found = asked(capsys, *words)
    assert code == 5
    (fault,) = of("SHARED_USER", found)
    assert "/authguard/gate, /authguard/deadman, /llm/planner" in fault["message"]
    assert of("ROS_KEYSTORE", found, "ok")
    trust = tmp_path / "trust"
    assert call(["keys", "init", str(trust)]) == 0
    code, found = asked(capsys, *words, "--trust", trust)
    assert (code, len(of("SHARED_USER", found, "warning"))) == (0, 1)


@pytest.mark.skipif(os.geteuid() != 0, reason="folders are given to their users")
def test_a_user_for_each_enclave_is_safe_until_another_can_write(
    keystore: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["/authguard/gate", "/authguard/deadman", "/llm/planner", "/authguard/estimator"]
    names += ["/authguard/display", "/robot/navigation", "/robot/base", "/robot/camera"]
    for number, name in enumerate(names, 70_001):
        folder = home(keystore, name)
        for path in (folder, *folder.iterdir()):
            os.chown(path, number, number)
        folder.chmod(0o700)
    words = ("--ros", EXAMPLE, "--keystore", keystore, "--user", "70001")
    # who keeps the keystore is root; the folders of a test are not his alone
    code, found = asked(capsys, *words)
    assert (of("SHARED_USER", found), of("ROS_SECURITY", found)) == ([], [])
    assert (code, [i for i in found if i["level"] == "unsafe"]) == (0, [])
    governance = home(keystore, GATE) / "governance.p7s"
    os.chown(governance, 70_003, 70_003)
    code, found = asked(capsys, *words)
    assert (code, [item["place"] for item in of("OWNER", found)]) == (5, [str(governance)])


def test_who_else_could_move_the_robot_and_an_open_key_are_named(
    keystore: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made = tmp_path / "made"
    assert call(["ros", "keystore", str(EXAMPLE), str(made)]) == 0
    resign(made, "/llm/planner", "permissions", {"<topic>rt/llm/cmd_vel": "<topic>rt/*"})
    home(made, GATE).joinpath(KEY).chmod(0o640)
    code, found = asked(capsys, "--ros", EXAMPLE, "--keystore", made)
    told = {item["message"].partition(":")[0] for item in of("ROS_KEYSTORE", found)}
    assert (code, {"MAY_ACTUATE", "KEY_EXPOSED"} <= told) == (5, True)
    # both authorities' keys lie there as they were made
    assert len(of("STRAY_KEY", found, "warning")) == 2
    code, found = asked(capsys, "--ros", EXAMPLE, "--keystore", tmp_path / "none")
    assert (code, of("ROS_KEYSTORE", found)[0]["place"]) == (5, str(tmp_path / "none"))


def test_who_may_say_what_time_it_is_is_named(
    keystore: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def simulated(plain: dict[str, Any]) -> None:
        plain["processes"]["/robot/camera"]["publishes"] = ["/clock"]

    _, found = asked(capsys, "--ros", changed_map(tmp_path, simulated))
    assert [item["place"] for item in of("ROS_CLOCK", found)] == ["processes./robot/camera"]


def test_a_middleware_without_security_is_known_by_its_own_words(tmp_path: Path) -> None:
    library = tmp_path / "lib" / "librmw_fastrtps_shared_cpp.so"
    library.parent.mkdir()
    library.write_bytes(b"\0This Fast DDS version doesn't have the security libraries\0")
    found = rmw_advice({"AMENT_PREFIX_PATH": f"/none:{tmp_path}"})
    assert (found.level, found.place) == (Level.UNSAFE, str(library))
    # another is not asked by this library
    other = rmw_advice({"AMENT_PREFIX_PATH": str(tmp_path), "RMW_IMPLEMENTATION": "rmw_zenoh_cpp"})
    assert (other.level, "rmw_fastrtps_cpp" in other.mend) == (Level.WARNING, True)
    library.write_bytes(b"\0")
    same = rmw_advice({"LD_LIBRARY_PATH": str(library.parent)})
    assert (same.level, "not known" in same.message) == (Level.WARNING, True)


def test_without_the_extra_keystores_are_not_said_to_be_well(
    keystore: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros, "find_spec", lambda _: None)
    code, found = asked(capsys, "--ros", EXAMPLE, "--keystore", keystore)
    assert (code, of("LIBRARY", found)[0]["mend"]) == (5, "pip install 'authguard-r[ros]'")
    assert of("ROS_SECURITY", found, "ok") == []


def test_what_goes_with_a_map_is_usage_without_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(["doctor", "--keystore", str(tmp_path)]) == 2
    assert call(["doctor", "--enclave", GATE]) == 2
    assert "Traceback" not in capsys.readouterr().err
