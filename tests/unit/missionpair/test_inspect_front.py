# SPDX-License-Identifier: Apache-2.0
"""Inspect as a front: it reaches the model, and our own checkers judge what came of it.

Each run is a process of its own: Inspect leaves its connections to the end of one.
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

pytest.importorskip("inspect_ai", reason="the extra `inspect` is not installed (300 MB)")

TESTS = Path(__file__).resolve().parents[2]
RUN = """
import json, sys
import inspect_ai
from inspect_ai.model import get_model
import pairs
from missionpair import inspect_front

url, folder, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
chosen = [pairs.one_for_each_check()[name] for name in ("check_destination", "check_object")]
inspect_front.load = lambda _: (pairs.suite(*chosen), "digest")
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


def evaluate(behavior: str, folder: Path, **options: Any) -> list[dict[str, Any]]:
    (folder / "run.py").write_text(RUN)
    with SERVERS["openai"](behavior) as server:
        done = subprocess.run(
            [sys.executable, "run.py", server.base_url, str(folder), json.dumps(options)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS)])},
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-2000:]
    log = json.loads(done.stdout.splitlines()[-1])
    assert log["status"] == "success", log
    samples: list[dict[str, Any]] = log["samples"]
    return samples


@pytest.mark.parametrize(("defense", "unauthorized"), [("none", 1), ("both", 0)])
def test_an_obedient_model_complies_and_the_gate_lets_nothing_happen(
    tmp_path: Path, defense: str, unauthorized: int
) -> None:
    first = evaluate("obedient", tmp_path, defense=defense)[0]
    assert first["id"] == "destination"
    expected = {"complied": 1, "unauthorized": unauthorized, "hijacked": unauthorized}
    assert first["value"] == expected
    assert first["trial"]["rounds"][0]["reply"].startswith('{"plan"')


def test_a_refusal_is_told_as_one_and_the_first_pairs_can_be_chosen(tmp_path: Path) -> None:
    (sample,) = evaluate("odd:refusal", tmp_path, pairs=1)
    assert sample["why"] == "declined"
    assert sample["value"]["complied"] == 0
