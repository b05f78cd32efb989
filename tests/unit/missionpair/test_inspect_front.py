# SPDX-License-Identifier: Apache-2.0
"""Inspect as a front: it reaches the model, and our own checkers judge what came of it.

`AUTHGUARD_INSPECT` names the environment that has Inspect. Each run is a process of its own,
because Inspect closes its connections only when a process ends.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from missionpair.servers import SERVERS

ENVIRONMENT = os.environ.get("AUTHGUARD_INSPECT", "")
pytestmark = [
    pytest.mark.complete,  # a bare machine, which has the default run, has no such environment
    pytest.mark.skipif(
        not ENVIRONMENT, reason="AUTHGUARD_INSPECT names no environment with Inspect"
    ),
]

TESTS = Path(__file__).resolve().parents[2]
RUN = """
import json, sys
import inspect_ai
from inspect_ai.model import get_model
from fixtures import mission_pairs
from missionpair import inspect_front

url, folder, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
checks = mission_pairs.one_for_each_check()
chosen = [checks[name] for name in ("check_destination", "check_object")]
inspect_front.load = lambda _: (mission_pairs.suite(*chosen), "digest")
model = get_model("openai-api/local/scripted-x", base_url=url, api_key="none")
(log,) = inspect_ai.eval(
    inspect_front.live(rounds=1, **options), model=model, log_dir=folder, display="none"
)
print(json.dumps({"status": log.status, "error": str(log.error), "samples": [
    {"id": s.id, "error": str(s.error), "trial": s.metadata.get("trial"),
     "value": s.scores["judgment"].value, "why": s.scores["judgment"].explanation}
    for s in log.samples or () if s.scores
]}))
"""


@pytest.fixture
def programs() -> Path:
    """The programs of the environment with Inspect."""
    return Path(ENVIRONMENT) / "bin"


def called(*words: object, folder: Path, **settings: str) -> str:
    """Run a program in a folder and return what it printed."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": "", **settings},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def evaluate(programs: Path, behavior: str, folder: Path, **options: Any) -> list[dict[str, Any]]:
    (folder / "run.py").write_text(RUN)
    with SERVERS["openai"](behavior) as server:
        words = (programs / "python", "run.py", server.base_url, folder, json.dumps(options))
        told = called(*words, folder=folder, PYTHONPATH=str(TESTS))
    log = json.loads(told.splitlines()[-1])
    assert log["status"] == "success", log
    samples: list[dict[str, Any]] = log["samples"]
    return samples


@pytest.mark.parametrize(("defense", "unauthorized"), [("none", 1), ("both", 0)])
def test_an_obedient_model_complies_and_the_gate_lets_nothing_happen(
    programs: Path, tmp_path: Path, defense: str, unauthorized: int
) -> None:
    first = evaluate(programs, "obedient", tmp_path, defense=defense)[0]
    assert first["id"] == "destination"
    expected = {"complied": 1, "unauthorized": unauthorized, "hijacked": unauthorized}
    assert first["value"] == expected
    assert first["trial"]["rounds"][0]["reply"].startswith('{"plan"')


def test_a_refusal_is_told_as_one_and_the_first_pairs_can_be_chosen(
    programs: Path, tmp_path: Path
) -> None:
    (sample,) = evaluate(programs, "odd:refusal", tmp_path, pairs=1)
    assert sample["why"] == "declined"
    assert sample["value"]["complied"] == 0


def test_inspect_finds_the_task_by_its_name_and_keeps_our_verdicts(
    programs: Path, tmp_path: Path
) -> None:
    """The how-to's own command: `inspect eval missionpair/live`, with options of the task.

    Inspect finds tasks of packages that are installed, not of ours, which the environment has only
    as a link to this folder: for this test it is installed.
    """
    installed = tmp_path / "site-packages"
    uv = Path(sys.executable).with_name("uv")
    words = ("pip", "install", "--quiet", "--no-deps", "--python", programs / "python")
    called(uv, *words, "--target", installed, TESTS.parent, folder=tmp_path)
    with SERVERS["openai"]("obedient") as server:
        called(
            *(programs / "inspect", "eval", "missionpair/live", "-T", "pairs=2", "-T", "rounds=1"),
            *("--model", "openai-api/local/scripted-x", "--model-base-url", server.base_url),
            *("--log-dir", "logs", "--log-format", "json", "--display", "plain"),
            folder=tmp_path,
            LOCAL_API_KEY="none",
            PYTHONPATH=str(installed),
        )
    (written,) = (tmp_path / "logs").glob("*.json")
    log = json.loads(written.read_text())
    assert (log["status"], log["eval"]["task"]) == ("success", "missionpair/live")
    assert len(log["samples"]) == 2
    for sample in log["samples"]:
        expected = {"complied": 1, "unauthorized": 0, "hijacked": 0}
        assert sample["scores"]["judgment"]["value"] == expected
        trial = sample["metadata"]["trial"]
        assert (trial["pair"], trial["by"]) == (sample["id"], "authorization")
