# SPDX-License-Identifier: Apache-2.0
"""A process of ours makes no node outside its enclave, though ROS 2 would let it.

Source: lesson L7; docs/spec/ros-map.md#self-check
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from authguard_r.core.errors import EnvironmentFault
from authguard_r.integrations.ros.keystore import KEY, make_keystore
from authguard_r.integrations.ros.security import EXACTLY, require_security, security_faults
from fixtures.cases import case
from fixtures.ros_keystores import example, home, map_of, plain_map

GATE = "/authguard/gate"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "keystore"
    make_keystore(example(), folder)
    return folder


def environment(keystore: Path, **other: str | None) -> dict[str, str]:
    """Return the variables of a process that is in its enclave, but for these."""
    right = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(keystore),
        "ROS_DOMAIN_ID": "42",
    }
    return {name: value for name, value in {**right, **other}.items() if value is not None}


def test_with_exactly_the_right_words_and_files_it_is_in_its_enclave(made: Path) -> None:
    for more in (
        {},
        {"ROS_SECURITY_ENCLAVE_OVERRIDE": GATE},
        {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
    ):
        assert require_security(example(), GATE, environment(made, **more)) == made


def test_l7_a_wrong_word_is_a_refusal_and_not_a_plain_node(made: Path) -> None:
    for name, value in [
        ("ROS_SECURITY_ENABLE", None),
        ("ROS_SECURITY_ENABLE", "TRUE"),
        ("ROS_SECURITY_ENABLE", "True"),
        ("ROS_SECURITY_ENABLE", "1"),
        ("ROS_SECURITY_ENABLE", "true "),
        ("ROS_SECURITY_STRATEGY", None),
        ("ROS_SECURITY_STRATEGY", "enforce"),
        ("ROS_SECURITY_STRATEGY", "ENFORCE"),
        ("ROS_SECURITY_STRATEGY", "Permissive"),
        ("ROS_SECURITY_KEYSTORE", None),
        ("ROS_SECURITY_KEYSTORE", ""),
        ("ROS_SECURITY_KEYSTORE", "keystore"),
        ("ROS_SECURITY_KEYSTORE", "/nowhere"),
        ("ROS_SECURITY_ENCLAVE_OVERRIDE", "/llm/planner"),
        ("ROS_SECURITY_ENCLAVE_OVERRIDE", ""),
        ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
        ("RMW_IMPLEMENTATION", ""),
        ("ROS_DOMAIN_ID", None),
        ("ROS_DOMAIN_ID", "0"),
        ("ROS_DOMAIN_ID", "042"),
        ("FASTDDS_DEFAULT_PROFILES_FILE", "/nowhere.xml"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", ""),
    ]:
        with case(name, value):
            with pytest.raises(EnvironmentFault, match="a node that anyone can imitate") as failed:
                require_security(example(), GATE, environment(made, **{name: value}))
            assert failed.value.where == name
            if wanted := EXACTLY.get(name):
                got = "nothing" if value is None else f"`{value}`"
                assert f"expected exactly `{wanted}`, got {got}" in failed.value.message


def test_a_process_does_not_start_in_an_enclave_of_another_robot(tmp_path: Path) -> None:
    """The gate's own certificate names the map's robot, or its node refuses the gate."""
    make_keystore(map_of({**plain_map(), "robot": "courier-9"}), tmp_path / "other")
    with pytest.raises(EnvironmentFault, match="courier-9") as failed:
        require_security(example(), GATE, environment(tmp_path / "other"))
    assert failed.value.where == GATE


def test_every_wrong_word_is_named(made: Path) -> None:
    faults = security_faults(example(), GATE, {"ROS_SECURITY_KEYSTORE": "keystore"})
    named = [fault.where for fault in faults]
    assert named == [*EXACTLY, "ROS_DOMAIN_ID", "ROS_SECURITY_KEYSTORE"]
    faults = security_faults(example(), GATE, environment(made, ROS_SECURITY_KEYSTORE="/nowhere"))
    assert [fault.where for fault in faults] == ["ROS_SECURITY_KEYSTORE"]


@pytest.mark.parametrize("spoiled", ["mode", "gone", "permissions", "folder"])
def test_l7_missing_forged_or_open_files_are_a_refusal(
    made: Path, tmp_path: Path, spoiled: str
) -> None:
    keystore = Path(shutil.copytree(made, tmp_path / "keystore"))
    folder = home(keystore, GATE)
    if spoiled == "mode":
        (folder / KEY).chmod(0o644)
    elif spoiled == "gone":
        (folder / KEY).unlink()
    elif spoiled == "folder":
        shutil.rmtree(folder)
    else:
        shutil.copy(home(keystore, "/llm/planner") / "permissions.p7s", folder / "permissions.p7s")
    assert list(security_faults(example(), GATE, environment(keystore)))
    with pytest.raises(EnvironmentFault):
        require_security(example(), GATE, environment(keystore))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_key_of_another_user_is_a_refusal(made: Path, tmp_path: Path) -> None:
    keystore = Path(shutil.copytree(made, tmp_path / "keystore"))
    os.chown(home(keystore, GATE) / KEY, 65_534, 65_534)
    (fault,) = security_faults(example(), GATE, environment(keystore))
    assert "only its owner" in fault.message


def test_a_process_of_another_user_is_looked_at_as_that_user(made: Path) -> None:
    """Who asks for it before it starts is root; the key has to be the process's user's."""
    key = str(home(made, GATE) / KEY)
    mine, another = os.geteuid(), os.geteuid() + 1
    assert list(security_faults(example(), GATE, environment(made), uid=mine)) == []
    faults = list(security_faults(example(), GATE, environment(made), uid=another))
    assert [fault.where for fault in faults] == [key]
