# SPDX-License-Identifier: Apache-2.0
"""A gate's process starts only with what was checked, and says what is wrong as a command does."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

from authguard_r.access.gate_config import Peer, default_config
from authguard_r.cli.gate import checked
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.server.files import (
    GateFiles,
    ask,
    asked,
    open_parts,
    parts_digest,
    require_checked,
)
from authguard_r.server.main import main
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios


@pytest.fixture
def files(tmp_path: Path) -> GateFiles:
    """Return the files of a demonstration's gate, each one that a test may change a copy."""
    trust = scenarios.trust_folder()
    for name in ("site.yaml", "binding.yaml"):
        shutil.copy(scenarios.HOSPITAL / name, tmp_path / name)
    peers = (Peer(uid=os.geteuid(), roles=(ClientRole.PLANNER,)),)
    config = default_config(scenarios.RID, peers, Mode.ENFORCE)
    token = sign_object(config, Tag.GATE, folder_signer(trust, "site-authority-1"))
    (tmp_path / "gate.token").write_bytes(token)
    return GateFiles(
        robot=scenarios.RID,
        trust=trust,
        site=tmp_path / "site.yaml",
        binding=str(tmp_path / "binding.yaml"),
        config=tmp_path / "gate.token",
        store=tmp_path / "robot.db",
        run=tmp_path / "run",
        key=trust / "keys" / "gate-courier-1.key.pem",
        cert=trust / "keys" / "gate-courier-1.cert.pem",
        demo=True,
        simulate=True,
    )


def refusal(files: GateFiles, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main([ask(files), "--json"])
    error = json.loads(capsys.readouterr().out)["error"]
    return code, error["where"], error["message"]


def test_what_was_checked_is_what_the_argument_names(files: GateFiles) -> None:
    found = checked(files)
    assert asked(ask(found)) == found
    assert found.checked == parts_digest(open_parts(files))
    assert files.run.is_dir()


def test_parts_that_were_not_checked_are_refused(files: GateFiles) -> None:
    found = checked(files)
    parts = open_parts(found)
    require_checked(found, parts)
    for wrong in (files, replace(found, checked="other")):
        with pytest.raises(EnvironmentFault, match="not the one that was checked"):
            require_checked(wrong, parts)


@pytest.mark.parametrize("changed", ["binding", "site", "config"])
def test_a_file_that_changed_after_the_check_starts_no_gate(
    files: GateFiles, changed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = checked(files)
    if changed == "config":
        peers = (Peer(uid=os.geteuid(), roles=(ClientRole.PLANNER,)),)
        other = default_config(scenarios.RID, peers, Mode.SHADOW)
        signer = folder_signer(files.trust, "site-authority-1")
        files.config.write_bytes(sign_object(other, Tag.GATE, signer))
    else:
        path = Path(files.binding) if changed == "binding" else files.site
        old, new = {"binding": ("navigate_to:", "drive_to:"), "site": ("Dock", "Berth")}[changed]
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
    code, where, message = refusal(found, capsys)
    assert (code, where) == (5, "setup")
    assert "authguard gate" in message
    assert not files.store.exists()


def test_a_gate_that_nobody_checked_does_not_start(
    files: GateFiles, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refusal(files, capsys)[:2] == (5, "setup")
    assert not files.store.exists()


def test_an_argument_that_names_no_files_is_an_error_and_no_traceback(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["{", "--json"]) == 5
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "INTERNAL_FAULT"


def test_a_path_that_is_no_utf_8_is_said(files: GateFiles) -> None:
    with pytest.raises(EnvironmentFault, match="UTF-8"):
        ask(replace(files, store=Path(os.fsdecode(b"robot-\xff.db"))))
