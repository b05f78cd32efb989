# SPDX-License-Identifier: Apache-2.0
"""Who may read a gate's log, from what people write to what is signed, and what is said of it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import GateConfig, open_gate_config
from authguard_r.anchoring.sealing.policy import Reader, Retention
from authguard_r.cli import call
from authguard_r.core.mission import DataClass
from authguard_r.keys.readers import new_reader
from authguard_r.keys.trust import read_trust
from fixtures import scenarios

DAY_MS = 86_400_000
EVERY = tuple(sorted(DataClass))
MAKE = ["gate-config", "make", "--robot", "courier-1", "--out", "gate.yaml"]
PEERS = ["--peer", "70001:planner", "--peer", "70002:operator,auditor"]
SIGNER = "trust/keys/site-authority-1"
SIGN = ["gate-config", "sign", "gate.yaml", "--key", f"{SIGNER}.key.pem"]
SIGN += ["--cert", f"{SIGNER}.cert.pem", "--yes"]


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> tuple[int, str]:
        code = call([str(word) for word in words])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *words: object) -> tuple[int, Any]:
        code, out = self(*words, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    return Shell(capsys)


def signed() -> GateConfig:
    return open_gate_config(
        Path("gate.token").read_bytes(),
        verifier=read_trust(Path("trust")),
        now=scenarios.NOW,
        robot=scenarios.RID,
    )


def wrote(readers: str, retention: str = "[]") -> None:
    """Write a configuration as people do."""
    Path("gate.yaml").write_text(
        "robot: courier-1\npeers:\n  70001: [planner]\n"
        f"readers: {readers}\nretention: {retention}\n"
    )


def test_readers_and_how_long_are_written_signed_and_read_by_a_gate(shell: Shell) -> None:
    auditor, porter = new_reader().public, new_reader(hybrid=True).public
    wrote(
        f"\n  - {{role: porter, classes: [region], key: {porter.text()}}}"
        f"\n  - {{role: auditor, classes: [person, {', '.join(EVERY)}], key: {auditor.text()}}}",
        "\n  - {class: region, least: 1 d, most: 90 d}\n  - {class: person, most: 36 h}"
        "\n  - {class: object, least: 1 d}",
    )
    code, text = shell(*SIGN)
    assert code == 0, text
    config = signed()
    assert config.readers == (
        Reader(role="porter", classes=(DataClass.REGION,), key=porter.text()),
        Reader(role="auditor", classes=EVERY, key=auditor.text()),
    )
    assert config.retention == (
        Retention(data=DataClass.OBJECT, least_ms=DAY_MS),
        Retention(data=DataClass.PERSON, most_ms=36 * 3_600_000),
        Retention(data=DataClass.REGION, least_ms=DAY_MS, most_ms=90 * DAY_MS),
    )
    code, card = shell("gate-config", "show", "gate.token", "--trust", "trust")
    assert code == 0
    for line in (
        f"  reader porter: region, with the key {porter.name}\n",
        f"  reader auditor: {', '.join(EVERY)}, with the key {auditor.name}\n",
        "  object: stored for at least 1 d, destroyed by order alone\n",
        "  person: stored for at least 0 d, destroyed after 36 h\n",
        "  region: stored for at least 1 d, destroyed after 90 d\n",
    ):
        assert line in card
    code, told = shell.json("gate-config", "show", "gate.token", "--trust", "trust")
    assert told["config"]["retention"][2] == {
        "data": "region",
        "least_ms": DAY_MS,
        "most_ms": 90 * DAY_MS,
    }


def test_readers_are_named_on_the_command_line_by_key_or_file(shell: Shell) -> None:
    assert shell("audit", "reader", "a.key.pem")[0] == 0
    _, public = shell("audit", "reader", "a.key.pem", "--show")
    Path("a.pub").write_text(public)
    other = new_reader().public.text()
    named = ["--reader", f"auditor:{','.join(EVERY)}:a.pub", "--reader", f"porter:region:{other}"]
    code, text = shell(*MAKE, *PEERS, *named)
    assert code == 0, text
    assert shell(*SIGN)[0] == 0
    found = [(one.role, one.classes, one.key) for one in signed().readers]
    assert found == [("auditor", EVERY, public.strip()), ("porter", (DataClass.REGION,), other)]


def test_without_readers_everything_is_as_it_was(shell: Shell) -> None:
    assert shell(*MAKE, *PEERS)[0] == 0
    assert "readers: []\nretention: []\n" in Path("gate.yaml").read_text()
    code, text = shell(*SIGN)
    assert (code, "reader" in text) == (0, False)
    assert b"readers" not in Path("gate.token").read_bytes()


def test_the_line_that_a_new_key_prints_goes_into_a_configuration(shell: Shell) -> None:
    _, text = shell("audit", "reader", "a.key.pem")
    line = next(line for line in text.splitlines() if line.startswith("  - {role: ROLE"))
    wrote("\n" + line.replace("ROLE", "auditor"))
    code, text = shell(*SIGN)
    assert code == 0, text
    assert signed().readers[0].classes == EVERY


KEY = new_reader().public.text()
#: What stands for a key in a name of a test.
KEYS = {"KEY": KEY, "SHORT": KEY[:-1], "ZERO": "A" * 43}


def filled(text: str) -> str:
    """Return a text with the keys that it names."""
    for word, key in KEYS.items():
        text = text.replace(word, key)
    return text


@pytest.mark.parametrize(
    "named",
    [
        "auditor",
        "auditor:region",
        ":region:KEY",
        "auditor::KEY",
        "auditor:regions:KEY",
        "auditor:region,:KEY",
        "auditor:region:",
        "auditor:region:nowhere.pub",
        "auditor:region:SHORT",
        "au ditor:region:KEY",
        "auditor:region:ZERO",
    ],
)
def test_a_reader_that_is_none_is_wrong_usage(shell: Shell, named: str) -> None:
    code, text = shell(*MAKE, *PEERS, "--reader", filled(named))
    assert (code, "--reader" in text) == (2, True), text
    assert not Path("gate.yaml").exists()


def test_a_private_key_in_the_place_of_the_public_one_is_refused(shell: Shell) -> None:
    shell("audit", "reader", "a.key.pem")
    code, _ = shell(*MAKE, *PEERS, "--reader", "auditor:region:a.key.pem")
    assert code == 2


@pytest.mark.parametrize(
    ("readers", "retention", "where"),
    [
        ("[{role: a, classes: [region], key: ZERO}]", "[]", ":readers[0].key"),
        ("[{role: a, classes: [], key: KEY}]", "[]", "readers[0].classes"),
        ("[{role: a, classes: [sea], key: KEY}]", "[]", "readers[0].classes"),
        (
            "[{role: a, classes: [region], key: KEY}, {role: b, classes: [object], key: KEY}]",
            "[]",
            ":readers",
        ),
        ("[]", "[{class: region, least: 1 d}]", ":retention[0]"),
        (
            "[{role: a, classes: [region], key: KEY}]",
            "[{class: region, least: 2 d, most: 1 d}]",
            ":retention[0]",
        ),
        (
            "[{role: a, classes: [region], key: KEY}]",
            "[{class: region, most: 1 d}, {class: region, most: 2 d}]",
            ":retention",
        ),
        (
            "[{role: a, classes: [region], key: KEY}]",
            "[{class: region, most: 1 m}]",
            ":retention[0].most",
        ),
        ("[{role: a, classes: [region], key: KEY}]", "[{data: region}]", "retention[0]"),
        # its boxes tell of the other class too, which is to be kept
        (
            "[{role: a, classes: [object, region], key: KEY}]",
            "[{class: object, least: 2 d}, {class: region, most: 1 d}]",
            ":retention[1]",
        ),
    ],
)
def test_what_no_gate_would_take_is_refused_with_its_place(
    shell: Shell, readers: str, retention: str, where: str
) -> None:
    wrote(filled(readers), retention)
    code, told = shell.json(*SIGN)
    assert (code, where in told["error"]["where"]) == (4, True), told
    assert not Path("gate.token").exists()


def test_a_time_without_its_unit_is_asked_about(shell: Shell) -> None:
    wrote(f"[{{role: a, classes: [region], key: {KEY}}}]", '[{class: region, most: "30"}]')
    code, text = shell(*SIGN)
    assert (code, "has no unit" in text) == (3, True)


def test_a_log_that_nobody_could_replay_is_warned_of(shell: Shell) -> None:
    wrote(
        f"[{{role: a, classes: [region, object], key: {KEY}}}, "
        f"{{role: b, classes: [person], key: {new_reader().public.text()}}}]"
    )
    code, told = shell.json(*SIGN)
    (found,) = [item for item in told["advice"] if item["code"] == "READERS"]
    assert (code, found["level"]) == (0, "warning")
    assert (
        found["message"]
        == "no one may read all of object, person, region: no one can replay this log"
    )
    for classes in ("[region]", "[region, object, person]"):  # what is not sealed, anybody reads
        wrote(f"[{{role: a, classes: {classes}, key: {KEY}}}]")
        _, told = shell.json(*SIGN)
        assert [item for item in told["advice"] if item["code"] == "READERS"] == []
