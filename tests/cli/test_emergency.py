# SPDX-License-Identifier: Apache-2.0
"""`authguard emergency`: a policy is written, looked through, signed and shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import main
from authguard_r.site.source import read_text
from fixtures import scenarios


@pytest.fixture
def site(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    marked = read_text(scenarios.HOSPITAL / "site.yaml") + "emergency: {places: {dock: charging}}\n"
    path.write_text(marked)
    return path


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict[str, Any]]:
    try:
        code = main([str(word) for word in (*words, "--json")])
    except SystemExit as ended:
        code = int(ended.code or 0)
    return code, json.loads(capsys.readouterr().out)


def test_the_shipped_policy_is_sound_at_the_marked_site_alone(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = scenarios.HOSPITAL / "emergency.yaml"
    assert run(capsys, "emergency", "policy", "check", shipped, "--site", site) == (
        0,
        {"findings": []},
    )
    plain = scenarios.HOSPITAL / "site.yaml"
    code, told = run(capsys, "emergency", "policy", "check", shipped, "--site", plain)
    assert code == 1
    assert [found["where"] for found in told["findings"]] == [
        "emergency.capabilities[0].destination"
    ]


def test_what_make_writes_can_be_signed_and_shown(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made, token = tmp_path / "made.yaml", tmp_path / "made.token"
    at = ("--site", site)
    assert (
        run(capsys, "emergency", "policy", "make", *at, "--robot", scenarios.RID, "--out", made)[0]
        == 0
    )
    keys = ("--trust", scenarios.trust_folder())
    code, signed = run(
        capsys, "emergency", "policy", "sign", made, *at, *keys, "--yes", "--out", token
    )
    assert (code, [c["id"] for c in signed["policy"]["capabilities"]]) == (
        0,
        ["go-dock", "call-help"],
    )
    code, shown = run(capsys, "emergency", "policy", "show", token, *at, *keys)
    assert (code, shown["valid"], shown["policy"]) == (0, True, signed["policy"])
    code, shown = run(capsys, "emergency", "policy", "show", token)
    assert (code, shown["valid"]) == (0, None)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("robot: courier-1", "robot: nobody", 4),
        ("max: 5 min", "max: '5'", 3),
        ("speed_mm_s: 0.3 m/s", "speed_mm_s: 9 m/s", 4),
        ("days: 90", "days: 0", 4),
        ("aim: safe_place", "aim: conquer", 4),
    ],
)
def test_one_thing_that_is_wrong_is_not_signed(
    old: str,
    new: str,
    code: int,
    site: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "policy.yaml"
    file.write_text(read_text(scenarios.HOSPITAL / "emergency.yaml").replace(old, new))
    token = tmp_path / "policy.token"
    words = ("--site", site, "--trust", scenarios.trust_folder(), "--yes", "--out", token)
    assert run(capsys, "emergency", "policy", "sign", file, *words)[0] == code
    assert not token.exists()


def test_another_roles_key_signs_nothing(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = scenarios.trust_folder() / "keys" / "operator-1"
    key = ("--key", f"{name}.key.pem", "--cert", f"{name}.cert.pem")
    token = tmp_path / "policy.token"
    words = ("--site", site, "--trust", scenarios.trust_folder(), "--yes", "--out", token)
    shipped = scenarios.HOSPITAL / "emergency.yaml"
    code, told = run(capsys, "emergency", "policy", "sign", shipped, *words, *key)
    assert (code, told["error"]["code"]) == (1, "ROLE_DENIED")
    assert not token.exists()


def test_a_call_where_no_gate_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _ = run(capsys, "emergency", "call", "go-to-dock", "--gate", tmp_path)
    assert code == 5
