# SPDX-License-Identifier: Apache-2.0
"""A safety gate in another process: real processes, each wrong in a way of its own."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, decode, digest_of
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.state import AttestedState
from authguard_r.safety import (
    EnvelopeGate,
    ExternalChecker,
    ExternalGate,
    SafetyConfig,
    Together,
    default_config,
    gate_of,
)
from fixtures import scenarios
from fixtures.cases import case
from unit.safety.faulty_checker import ANSWERS, BYTES

HERE = Path(__file__).parent
EXAMPLE = scenarios.ROOT / "examples" / "safety" / "checker.py"
SLOW, FAST = (scenarios.navigate("dock", "pharmacy", speed=speed) for speed in (300, 301))
#: Nobody waits that long but for one who never answers, milliseconds.
PATIENT, SHORT = 1_000, 100


@contextmanager
def process(script: Path, *words: str) -> Iterator[str]:
    """Run a checker; give the path of its socket once it listens."""
    with TemporaryDirectory(prefix="checker-") as folder:
        path = f"{folder}/checker.sock"
        server = subprocess.Popen(
            [sys.executable, str(script), path, *words], stdout=subprocess.PIPE, text=True
        )
        assert server.stdout is not None
        try:
            assert server.stdout.readline() == "ready\n"
            yield path
        finally:
            server.kill()
            server.wait()
            server.stdout.close()


def checker(path: str, *, timeout_ms: int = PATIENT, **more: Any) -> ExternalChecker:
    return ExternalChecker(id="roboguard", socket=path, timeout_ms=timeout_ms, **more)


def ask(gate: Any, action: Any = SLOW, state: AttestedState | None = None) -> SafetyDecision:
    told: SafetyDecision = gate.assess(
        action, state or scenarios.state(), scenarios.facts(), scenarios.NOW
    )
    assert told.safe == (not told.findings)
    return told


def refused(told: SafetyDecision) -> str:
    """Return why nobody said that it is safe."""
    (finding,) = told.findings
    assert (str(finding.hazard), finding.field) == ("STATE_UNKNOWN", "checker.roboguard")
    return finding.got


FAULTS = {
    "wrong version": "no answer: invalid enum value",
    "no version": "no answer: object missing required field `protocol`",
    "another question": "an answer to another question",
    "another action": "an answer about another action",
    "a field of its own": "no answer: object contains unknown field `override`",
    "no verdict": "no answer: object missing required field `safe`",
    "a word for a verdict": "no answer: expected `bool`",
    "a number for a verdict": "no answer: expected `bool`",
    "nothing for a verdict": "no answer: expected `bool`",
    "safe with findings": "safe with findings",
    "unsafe without findings": "or unsafe without",
    "a finding of no shape": "no answer: object missing required field",
    "a terminal's escape": "no answer: expected `str` matching regex",
    "too many findings": "no answer: expected `array` of length <= 32",
    "a list": "no answer: expected `object`",
    "another spelling": "no answer: the bytes are not the canonical encoding",
    "a second verdict": "no answer: the bytes are not the canonical encoding",
    "no JSON": "no answer: JSON is malformed",
    "no text": "no answer: JSON is malformed",
    "an empty line": "more than one line",
    "closed in the middle": "the connection ended in the middle",
    "closed before the end of the line": "the connection ended in the middle",
    "nothing": "the connection ended in the middle",
    "two answers": "more than one line",
    "too long": "more than 16384 bytes",
    "too long for a line": "more than 16384 bytes",
    "echoed": "no answer: object",
    "closed at once": "",  # it depends on who is sooner
    "died": "the connection ended in the middle",
}


def test_whatever_is_wrong_with_an_answer_the_action_is_unsafe() -> None:
    for fault, value in FAULTS.items():
        with case(fault), process(HERE / "faulty_checker.py", fault) as path:
            told = ask(ExternalGate(checker(path)))
            assert not told.safe
            assert value in refused(told)


def test_every_fault_that_can_be_made_is_tried() -> None:
    assert {*ANSWERS, *BYTES} - {"right", "unsafe"} <= set(FAULTS)


@pytest.mark.parametrize("fault", ["slow", "deaf", "trickling"])
def test_one_that_takes_too_long_did_not_agree(fault: str) -> None:
    with process(HERE / "faulty_checker.py", fault) as path:
        begun = time.monotonic()
        assert refused(ask(ExternalGate(checker(path, timeout_ms=SHORT)))) == "none after 100 ms"
        assert time.monotonic() - begun < 30  # it does not wait for the other to be done


def test_one_that_is_not_there_did_not_agree(tmp_path: Path) -> None:
    gate = ExternalGate(checker(str(tmp_path / "nobody.sock")))
    assert refused(ask(gate)) == "No such file or directory"
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(tmp_path / "gone.sock"))
    assert refused(ask(ExternalGate(checker(str(tmp_path / "gone.sock"))))) == "Connection refused"
    (tmp_path / "file").touch()
    assert not ask(ExternalGate(checker(str(tmp_path / "file")))).safe


def test_a_path_that_the_kernel_does_not_take_is_nobody(tmp_path: Path) -> None:
    long = msgspec.structs.replace(checker("/x"), socket="/" + "x" * 200)
    assert refused(ask(ExternalGate(long))) == "no connection"


def test_there_may_be_no_time_left_at_all() -> None:
    with process(HERE / "faulty_checker.py", "right") as path:
        hurried = msgspec.structs.replace(checker(path), timeout_ms=0)
        assert refused(ask(ExternalGate(hurried))) == "none after 0 ms"


def test_another_users_process_is_not_believed() -> None:
    with process(HERE / "faulty_checker.py", "right") as path:
        assert ask(ExternalGate(checker(path, uid=os.geteuid()))).safe
        told = ask(ExternalGate(checker(path, uid=os.geteuid() + 1)))
        assert "a process of user" in refused(told)


def test_the_answer_to_the_question_before_is_none_to_this_one() -> None:
    with process(HERE / "faulty_checker.py", "the answer of before") as path:
        gate = ExternalGate(checker(path))
        assert ask(gate).safe
        assert refused(ask(gate)) == "an answer to another question"


def test_what_it_finds_is_told_as_its_own_rule() -> None:
    with process(HERE / "faulty_checker.py", "unsafe") as path:
        found = ask(ExternalGate(checker(path))).findings
    assert [(str(f.hazard), f.field, f.expected, f.got) for f in found] == [
        ("RULE", "checker.roboguard.near-people destination", "elsewhere", "there"),
        ("RULE", "checker.roboguard.near-people", "elsewhere", "there"),
    ]


def test_the_example_answers_and_is_asked_without_a_state_too() -> None:
    with process(EXAMPLE) as path:
        gate = ExternalGate(checker(path))
        assert gate.recall(b"anything") is gate
        for _ in range(3):
            assert ask(gate, SLOW).safe
        (finding,) = ask(gate, FAST).findings
        assert (finding.expected, finding.got) == ("at most 300", "301")
        assert gate.assess(SLOW, None, scenarios.facts(), scenarios.NOW).safe


def test_the_question_is_what_the_page_says(tmp_path: Path) -> None:
    """One connection is caught; nobody answers it."""
    path = str(tmp_path / "here.sock")
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(path)
        door.listen()
        refused(ask(ExternalGate(checker(path, timeout_ms=SHORT))))
        link, _ = door.accept()
        with link:
            line = link.makefile("rb").readline()
    asked = decode(line[:-1], dict[str, Any])  # it is canonical, too
    assert sorted(asked) == ["action", "effect", "id", "protocol", "robot", "site", "state", "time"]
    assert asked["action"] == digest_of(Tag.ACTION, SLOW)
    assert asked["effect"]["destination"] == "pharmacy"
    assert asked["robot"] == scenarios.RID
    (state,) = asked["state"]
    assert (sorted(state), state["place"], state["age_ms"], state["fence"]) == (
        ["age_ms", "fence", "place", "snapshot"],
        ["dock"],
        0,
        0,
    )


# together


def configured(**changes: Any) -> SafetyConfig:
    return msgspec.structs.replace(default_config(scenarios.site(), scenarios.RID), **changes)


def test_a_checker_cannot_widen_the_envelope() -> None:
    with process(HERE / "faulty_checker.py", "right") as path:
        gate = gate_of(configured(checker=checker(path)))
        assert ask(gate).safe
        told = ask(gate, scenarios.navigate("dock", "plant-room", speed=300))
        assert [str(f.hazard) for f in told.findings] == ["KEEP_OUT"]


def test_the_envelope_cannot_widen_a_checker() -> None:
    with process(EXAMPLE) as path:
        gate = gate_of(configured(checker=checker(path)))
        assert [str(f.hazard) for f in ask(gate, FAST).findings] == ["RULE"]
        both = ask(gate, scenarios.navigate("dock", "plant-room", speed=1_501))
        assert [str(f.hazard) for f in both.findings] == ["SPEED", "KEEP_OUT", "RULE"]


def test_a_repair_is_offered_only_when_all_would_call_it_safe() -> None:
    fast = scenarios.navigate("dock", "pharmacy", speed=1_501)
    assert ask(EnvelopeGate(configured()), fast).repair is not None
    with process(EXAMPLE) as path:
        here = checker(path)
        assert ask(gate_of(configured(checker=here)), fast).repair is None
        slow = ask(gate_of(configured(checker=here, max_speed_mm_s=300)), fast)
        assert slow.repair == msgspec.structs.replace(SLOW, params={"speed_mm_s": 300})


def test_a_dead_checker_stops_everything(tmp_path: Path) -> None:
    gate = gate_of(configured(checker=checker(str(tmp_path / "nobody.sock"))))
    assert not ask(gate).safe


def test_where_there_is_less_time_a_slow_checker_is_refused_at_the_start() -> None:
    config = configured(checker=checker("/run/checker.sock", timeout_ms=51))
    with pytest.raises(EnvironmentFault, match="within 50 ms"):
        gate_of(config, asked_ms=50)
    assert isinstance(gate_of(config, asked_ms=51), Together)


def test_somebody_has_to_agree() -> None:
    with pytest.raises(ValueError, match="expected a gate"):
        Together()


def test_a_checker_of_another_shape_is_no_configuration() -> None:
    for change in [
        {"socket": "relative.sock"},
        {"socket": "/" + "x" * 107},
        {"socket": "/a b"},
        {"socket": "/\u00e9"},
        {"timeout_ms": 0},
        {"timeout_ms": 1_001},
        {"uid": -1},
        {"id": "Robo Guard"},
        {"port": 80},
    ]:
        with case(change):
            plain = {**msgspec.to_builtins(checker("/run/checker.sock")), **change}
            with pytest.raises(MalformedError):
                decode(msgspec.json.encode(plain, order="sorted"), ExternalChecker)
