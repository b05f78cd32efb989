# SPDX-License-Identifier: Apache-2.0
"""Who may be what at a gate, from a user's name to the signed number."""

from __future__ import annotations

import json
import os
import pwd
import shutil
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import open_gate_config
from authguard_r.cli import call
from authguard_r.keys.trust import read_trust
from fixtures import scenarios
from fixtures.small_witness import SmallWitness

KEY = "trust/keys/{}.key.pem"
CERT = "trust/keys/{}.cert.pem"
#: A user that every machine has, besides root.
USER = next(entry for entry in pwd.getpwall() if 0 < entry.pw_uid < 65_534)


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: str) -> tuple[int, str]:
        code = call(list(words))
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *words: str) -> tuple[int, Any]:
        code, out = self(*words, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    return Shell(capsys)


MAKE = ["gate-config", "make", "--robot", "courier-1", "--out", "gate.yaml"]
PEERS = ["--peer", f"{USER.pw_name}:planner", "--peer", "70001:controller,estimator"]


def signing(name: str = "site-authority-1") -> list[str]:
    return [
        "gate-config",
        "sign",
        "gate.yaml",
        "--key",
        KEY.format(name),
        "--cert",
        CERT.format(name),
        "--yes",
    ]


def test_names_become_numbers_and_the_gate_reads_them(shell: Shell) -> None:
    code, made = shell.json(*MAKE, *PEERS)
    assert code == 0
    assert made["users"] == {str(USER.pw_uid): USER.pw_name, "70001": None}
    code, signed = shell.json(*signing())
    assert (code, signed["file"]) == (0, "gate.token")
    config = open_gate_config(
        Path("gate.token").read_bytes(),
        verifier=read_trust(Path("trust")),
        now=scenarios.NOW,
        robot=scenarios.RID,
    )
    assert {peer.uid: [*peer.roles] for peer in config.peers} == {
        USER.pw_uid: ["planner"],
        70001: ["controller", "estimator"],
    }
    code, text = shell("gate-config", "show", "gate.token", "--trust", "trust")
    assert code == 0
    assert "not verified" not in text
    assert USER.pw_name in text
    assert "no such user here" in text


def test_people_write_quantities_with_their_units(shell: Shell) -> None:
    Path("gate.yaml").write_text(
        "robot: courier-1\npeers: {70001: [planner]}\nplanner_silence: 2 min\n"
        "reserve: 32 MiB\nrefusals: 5\n"
    )
    code, signed = shell.json(*signing())
    assert code == 0
    assert signed["config"]["planner_silence_ms"] == 120_000
    assert signed["config"]["reserve_bytes"] == 32 << 20
    assert signed["config"]["refusals"] == 5


def test_what_is_doubtful_is_shown_before_it_is_signed(shell: Shell) -> None:
    doubtful = ["--peer", "70001:planner,controller,operator", "--mode", "shadow"]
    code, text = shell(*MAKE, *doubtful)
    assert code == 0
    for words in ("planner and controller", "planner and operator", "shadow:", "`estimator` here"):
        assert words in text
    code, made = shell.json(*MAKE, *doubtful)
    assert {item["code"] for item in made["advice"]} == {
        "SHARED_USER",
        "USER",
        "VACANT_ROLE",
        "SHADOW",
    }


@pytest.mark.parametrize(
    ("peers", "code"),
    [
        ([], 2),
        (["--peer", "planner"], 2),
        (["--peer", ":planner"], 2),
        (["--peer", "1:planner", "--peer", "1:operator"], 2),
        (["--peer", "1:planner", "--demo"], 2),
        (["--peer", "1:planer"], 2),
        (["--peer", "1:"], 2),
        (["--peer", "no-such-user-here:planner"], 2),
        (["--peer", "0:planner", "--peer", "root:operator"], 4),
    ],
)
def test_a_user_or_role_that_is_none_is_refused(shell: Shell, peers: list[str], code: int) -> None:
    assert shell(*MAKE, *peers)[0] == code
    assert not Path("gate.yaml").exists()


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("planner_silence: '60'", 3),
        ("planner_silence: 60 kg", 4),
        ("renew_within: 1 ms", 4),
        ("connections: 0", 4),
        ("peer: {}", 4),
        ("mode: off", 4),
    ],
)
def test_a_bound_that_cannot_be_is_refused(shell: Shell, line: str, code: int) -> None:
    Path("gate.yaml").write_text(f"robot: courier-1\npeers: {{70001: [planner]}}\n{line}\n")
    assert shell(*signing())[0] == code
    assert not Path("gate.token").exists()


def test_nobody_but_the_site_authority_signs(shell: Shell) -> None:
    shell(*MAKE, *PEERS)
    assert shell(*signing("operator-1"))[0] == 1
    assert shell(*signing("operator-1"), "--trust", "trust")[0] == 1
    assert not Path("gate.token").exists()
    assert shell(*signing(), "--trust", "trust")[0] == 0


def test_a_trial_is_one_user_and_says_so(shell: Shell) -> None:
    words = ["gate-config", "make", "--robot", "courier-1", "--demo", "--out", "gate.token"]
    assert shell(*words)[0] == 2
    code, text = shell(*words, "--trust", "trust")
    assert code == 0
    assert text.startswith("DEMONSTRATION")
    assert "UNSAFE" not in text
    code, shown = shell.json("gate-config", "show", "gate.token", "--trust", "trust")
    assert (code, shown["valid"]) == (0, True)
    (peer,) = shown["config"]["peers"]
    assert peer["uid"] == os.geteuid()
    assert peer["roles"] == ["auditor", "controller", "estimator", "operator", "planner"]


def test_a_token_of_another_kind_is_none(shell: Shell) -> None:
    Path("m.token").write_bytes(scenarios.token())
    assert shell("gate-config", "show", "m.token")[0] == 4
    Path("gate.yaml").write_text("x")
    assert shell(*signing())[0] == 4
    shell(*MAKE, *PEERS)
    shell(*signing())
    code, text = shell("gate-config", "show", "gate.token")
    assert code == 0
    assert "not verified" in text
    data = Path("gate.token").read_bytes()
    Path("gate.token").write_bytes(data.replace(b'"signature":"', b'"signature":"AA', 1))
    assert shell("gate-config", "show", "gate.token", "--trust", "trust")[0] == 4


def test_witnesses_are_written_shown_and_signed(shell: Shell) -> None:
    key = SmallWitness("stranger", ()).named.text()
    shell(*MAKE, *PEERS)
    plain = Path("gate.yaml").read_text()
    assert "checkpoint: 60000 ms" in plain
    said = f"witnesses:\n  - url: https://witness.example\n    key: {key}\n"
    changed = plain.replace("witnesses: []\n", said).replace("quorum: 0", "quorum: 1")
    Path("gate.yaml").write_text(
        changed.replace("witness_silence: 600000 ms", "witness_silence: 1 h")
    )
    code, out = shell(*signing())
    assert code == 0
    assert f"witness {key} at https://witness.example" in out
    config = open_gate_config(
        Path("gate.token").read_bytes(),
        verifier=read_trust(Path("trust")),
        now=scenarios.NOW,
        robot=scenarios.RID,
    )
    assert (config.quorum, config.witness_ms, config.witnesses[0].key) == (1, 3_600_000, key)
    Path("gate.yaml").write_text(changed.replace("quorum: 1", "quorum: 2"))
    code, out = shell(*signing())
    assert (code, "gate.yaml.quorum" in out) == (4, True)


def test_a_node_or_gateway_is_named_as_what_it_is(shell: Shell) -> None:
    """Its user is planner and controller, and no planner runs as it: nothing is unsafe."""
    code, made = shell.json(*MAKE, "--mediator", "70001")
    assert code == 0
    assert "SHARED_USER" not in {item["code"] for item in made["advice"]}
    code, signed = shell.json(*signing())
    assert code == 0
    assert signed["config"]["peers"] == [
        {"uid": 70001, "roles": ["auditor", "controller", "planner"], "mediates": True}
    ]
    code, text = shell("gate-config", "show", "gate.token", "--trust", "trust")
    assert "mediates: no planner runs as this user" in text


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--mediator", "70001", "--peer", "70001:planner"), 2),
        (("--mediator", "70001", "--mediator", "70001"), 2),
        (("--mediator", "nobody-of-that-name"), 2),
    ],
)
def test_a_mediator_that_is_none_is_refused(
    shell: Shell, words: tuple[str, ...], code: int
) -> None:
    assert shell(*MAKE, *words)[0] == code


def test_a_mediator_has_to_be_among_the_users(shell: Shell) -> None:
    Path("gate.yaml").write_text("robot: courier-1\npeers: {1: [planner]}\nmediators: [2]\n")
    assert shell(*signing())[0] == 4
