# SPDX-License-Identifier: Apache-2.0
"""`authguard run` asks its approvers at the terminal; an answer counts as it does at a gate."""

from __future__ import annotations

import io
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fixtures import scenarios
from fixtures.commands import Ended, ended

SITE = ("--site", "h/site.yaml")
KEYS = Path("trust/keys")
Run = Callable[..., Ended]


def approver(name: str) -> tuple[str, str]:
    return "--approver", str(KEYS / f"{name}.key.pem")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A signed mission that asks a second person for each step, and what runs its first plan."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, "h")
    shutil.copytree(scenarios.trust_folder(), "trust")
    for path in KEYS.glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    text = Path("h/mission.yaml").read_text()
    assert text.count("tau_1: 30") == 1
    Path("m.yaml").write_text(text.replace("tau_1: 30", "tau_1: 5"))
    assert ended("mission", "compile", "m.yaml", *SITE, "--out", "m.json").code == 0
    key = KEYS / "operator-1.key.pem"
    signing = ("mission", "sign", "m.json", "--key", key, *SITE, "--out", "m.token", "--yes")
    assert ended(*signing).code == 0

    def started(*more: str, typed: str = "") -> Ended:
        monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
        base = ("--token", "m.token", "--trust", "trust", *SITE, "--store", "r.db")
        plan = ("--binding", "h/binding.yaml", "--plan", "h/replies/01-collect.json")
        return ended("run", *base, *plan, *more)

    return started


def test_a_run_without_approvers_says_how_to_name_them(run: Run) -> None:
    done = run()
    assert done.code == 3
    assert "APPROVAL_REQUIRED" in done.out
    assert "add --approver NAME.key.pem" in done.out


def test_an_approver_sees_each_request_and_the_step_goes_on(run: Run) -> None:
    done = run(*approver("supervisor-1"), typed="y\ny\n")
    assert done.code == 0
    for shown in ("Request 1: mission deliver-p1", "Request 2: mission deliver-p1"):
        assert shown in done.out
    assert done.out.count("WHAT  ") == 2
    assert done.out.count("Approve exactly this as supervisor-1?") == 2
    assert done.out.count("-> succeeded") == 2


def test_a_no_signs_nothing_and_the_request_stays_open(run: Run) -> None:
    done = run(*approver("supervisor-1"), typed="n\n")
    assert done.code == 3
    assert "request 1: supervisor-1 does not answer" in done.out
    assert "succeeded" not in done.out
    later = run(*approver("supervisor-1"), "--yes")
    assert (later.code, "Request 1: mission deliver-p1" in later.out) == (0, True)


def test_an_answer_that_does_not_count_says_why_and_moves_nothing(run: Run) -> None:
    done = run(*approver("operator-1"), "--yes")
    assert done.code == 3
    assert "operator-1 approves, but it does not count: ROLE_DENIED" in done.out
    assert "succeeded" not in done.out


def test_json_stays_alone_on_standard_output(run: Run) -> None:
    done = run(*approver("supervisor-1"), "--yes", "--json")
    assert [step["outcome"] for step in json.loads(done.out)["steps"]] == ["accept", "accept"]
    assert "Request 1: mission deliver-p1" in done.err


def test_a_key_that_is_missing_refuses_before_anything_moves(run: Run) -> None:
    done = run(*approver("nobody"), "--yes")
    assert (done.code, "FILE_UNAVAILABLE" in done.err) == (5, True)
    assert not Path("r.db").exists()
