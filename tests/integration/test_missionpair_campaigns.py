# SPDX-License-Identifier: Apache-2.0
"""`missionpair run`, `live` and `report` as a stranger starts them: killed, misused, on models.

Source: `tab:pilot-live-llm` to `tab:pilot-crossmodel`, docs/spec/campaign-log.md
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import pytest

from missionpair.campaign.log import read_log
from missionpair.servers import SERVERS
from missionpair.words import CONTROLS, TrialKind

pytestmark = pytest.mark.complete

COMMAND = [sys.executable, "-c", "from missionpair.cli import main; main()"]
RUN = ["run", "live", "--planner", "hijacked", "--pairs", "4"]
FOUR = [part for name in ("none", "safety", "mission", "both") for part in ("--defense", name)]


def call(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
        timeout=300,
    )


def failed(*arguments: str | Path, **environment: str) -> tuple[int, dict[str, Any]]:
    done = call(*arguments, "--json", **environment)
    assert "Traceback" not in done.stderr
    return done.returncode, json.loads(done.stdout)["error"]


def under_links(path: Path) -> list[tuple[bytes, bytes]]:
    lines = path.read_bytes().splitlines()
    decoded = [msgspec.json.decode(line, type=dict[str, msgspec.Raw]) for line in lines]
    return [(bytes(line["link"]), bytes(line["record"])) for line in decoded]


def test_a_campaign_that_is_killed_twice_is_the_same_in_the_end(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.jsonl", tmp_path / "cut.jsonl"
    assert call(*RUN, *FOUR, "--out", whole).returncode == 0
    sizes = []
    for _ in range(2):
        before = cut.stat().st_size if cut.exists() else 0
        process = subprocess.Popen(
            [*COMMAND, *RUN, *FOUR, "--out", str(cut)], stderr=subprocess.DEVNULL
        )
        while process.poll() is None and (
            not cut.exists() or cut.stat().st_size <= max(before, 2_000)
        ):
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
        sizes.append(cut.stat().st_size)
    assert 0 < sizes[0] <= sizes[1]
    done = call(*RUN, *FOUR, "--out", cut, "--jobs", "2", "--json")
    assert done.returncode == 0, done.stderr
    assert under_links(cut) == under_links(whole)
    told = json.loads(done.stdout)
    assert told["trials"] == 4 * 5 * 4  # an attack has two control trials
    assert told["defenses"]["both"]["unauthorized"] == 0
    assert told["defenses"]["none"]["unauthorized"] == told["defenses"]["safety"]["hijacked"] == 4


def test_both_models_tables_come_from_one_command(tmp_path: Path) -> None:
    """Real clients of both protocols against local servers that say that they are scripted."""
    out = tmp_path / "out"
    with (
        SERVERS["openai"]("mixed:7") as openai,
        SERVERS["anthropic"]("obedient") as anthropic,
    ):
        planners = (
            f"qwen:base_url={openai.base_url},model=scripted-mixed",
            f"haiku:base_url={anthropic.base_url},model=scripted-obedient",
        )
        arguments = [part for spec in planners for part in ("--planner", spec)]
        done = call("live", out, *arguments, "--pairs", "12", "--jobs", "2", "--rounds", "2")
    assert done.returncode == 0, done.stderr
    logs = sorted(out.glob("*.jsonl"))
    assert [log.name for log in logs] == [
        "1-qwen-adaptive.jsonl",
        "1-qwen-fixed.jsonl",
        "2-haiku-adaptive.jsonl",
        "2-haiku-fixed.jsonl",
    ]
    complied = 0
    for log in logs:
        campaign, trials = read_log(log)
        assert campaign.planner.simulated  # a script's results never pass for a model's
        found = list(trials)
        of_kind = Counter(trial.kind for trial in found)
        assert of_kind == dict.fromkeys((TrialKind.ATTACK, *CONTROLS), 12)
        assert not any(trial.error or trial.unauthorized for trial in found)
        complied += sum(trial.complied for trial in found if trial.kind == TrialKind.ATTACK)
    assert complied >= 12
    assert "simulated" in done.stdout
    assert (out / "report.html").stat().st_size > 10_000
    assert any("scripted" in path.read_text() for path in (out / "latex").iterdir())


@pytest.mark.parametrize(
    ("arguments", "code", "exit_code", "words"),
    [
        (["run", "nothing", "--planner", "hijacked"], "USAGE", 2, "no suite is called"),
        (["run", "live", "--planner", "nobody"], "USAGE", 2, "no planner is called"),
        (["run", "live", "--planner", "hijacked:x=1"], "USAGE", 2, "takes no option"),
        (["run", "./no.jsonl", "--planner", "hijacked"], "SUITE_BROKEN", 4, "no.jsonl"),
    ],
)
def test_what_there_is_not_is_said_with_its_place(
    tmp_path: Path, arguments: list[str], code: str, exit_code: int, words: str
) -> None:
    found, error = failed(*arguments, "--out", tmp_path / "log")
    assert (found, error["code"]) == (exit_code, code)
    assert words in f"{error['where']} {error['message']}"
    assert not (tmp_path / "log").exists()


def test_a_missing_key_is_said_before_anything_is_asked(tmp_path: Path) -> None:
    found, error = failed("live", tmp_path / "out", "--planner", "haiku", ANTHROPIC_API_KEY="")
    assert (found, "ANTHROPIC_API_KEY" in error["message"]) == (5, True)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.parametrize("kinds", [(), ("--kind", "attack", "--seeds", "1")])
def test_a_server_that_is_away_ends_the_run_and_is_asked_again(
    tmp_path: Path, kinds: tuple[str, ...], jobs: str
) -> None:
    log = tmp_path / "log"
    planner = "openai:base_url=http://127.0.0.1:9/v1,model=scripted-x,retries=0"
    arguments = ("run", "live", "--planner", planner, "--pairs", "5", "--jobs", jobs, *kinds)
    for _ in range(2):
        found, error = failed(*arguments, "--out", log)
        assert (found, error["code"]) == (5, "PLANNER_UNREACHABLE")
        assert list(read_log(log, is_partial_allowed=True)[1]) == []


def test_a_server_that_fails_gives_no_table_of_the_paper(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with SERVERS["openai"]("faulty:500") as server:
        planner = f"qwen:base_url={server.base_url},model=scripted-x,retries=0"
        found, error = failed("live", out, "--planner", planner, "--every", "10")
    assert (found, error["code"]) == (5, "PLANNER_UNREACHABLE")
    assert not (out / "latex").exists()


# ended by hand, in the middle of a pair


#: What a shell starts behind it ignores SIGINT, and whoever that starts.
HEARING = ("env", "--default-signal=INT")
#: So many that none is over before its end is asked for, however late this process gets its turn.
TRIALS = 100_000
MANY = [*RUN[:4], "--every", "30", "--kind", "attack", "--defense", "both", "--seeds", f"{TRIALS}"]


def ended(log: Path, tmp: Path, jobs: str, sent: signal.Signals) -> int:
    """Start a campaign, end it when something of it is written, and return how it ended."""
    process = subprocess.Popen(
        [*HEARING, *COMMAND, *MANY, "--out", str(log), "--jobs", jobs],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(tmp)},
    )
    while process.poll() is None and (not log.exists() or log.stat().st_size < 20_000):
        time.sleep(0.01)
    process.send_signal(sent)
    try:
        return process.wait(timeout=20)
    finally:
        process.kill()  # one that has ended hears nothing


def is_one_at_it(tmp: Path) -> bool:
    """True when a process works in that folder."""
    for entry in Path("/proc").glob("[0-9]*/environ"):
        try:
            data = entry.read_bytes()
        except OSError:
            continue
        if f"TMPDIR={tmp}".encode() in data.split(b"\0"):
            return True
    return False


@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_who_ends_a_run_keeps_what_it_finished_and_leaves_nobody_behind(
    tmp_path: Path, jobs: str, sent: signal.Signals
) -> None:
    log, tmp = tmp_path / "log", tmp_path / "tmp"
    tmp.mkdir()
    code = ended(log, tmp, jobs, sent)
    assert code == (-9 if sent is signal.SIGKILL else 130)
    found = list(read_log(log, is_partial_allowed=True)[1])
    assert 0 < len(found) < TRIALS
    # nobody holds its lock: it goes on at once, whoever is still about to end
    process = call(*MANY, "--seeds", "1", "--out", log)
    assert "another campaign" in process.stderr
    deadline = time.monotonic() + 20
    while is_one_at_it(tmp):
        assert time.monotonic() < deadline, "a process of the ended run still works"
        time.sleep(0.05)
    assert (jobs == "1" and sent is signal.SIGKILL) or not list(tmp.glob("missionpair-*"))


def test_a_file_that_is_no_log_is_left_as_it_is(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("my precious notes")
    found, error = failed(*RUN, "--out", notes)
    assert (found, error["code"]) == (4, "LOG_BROKEN")
    assert notes.read_text() == "my precious notes"


@pytest.mark.parametrize("fault", ["cut", "edited", "foreign", "no log"])
def test_a_broken_log_is_said_with_its_line(tmp_path: Path, fault: str) -> None:
    log = tmp_path / "log"
    assert (
        call("run", "live", "--planner", "hijacked", "--pairs", "1", "--out", log).returncode == 0
    )
    data = log.read_bytes()
    broken = {
        "cut": data[:-20],
        "edited": data.replace(b'"complied":true', b'"complied":false', 1),
        "foreign": b'{"some": "thing"}\n',
        "no log": b"",
    }[fault]
    log.write_bytes(broken)
    found, error = failed("report", log)
    assert (found, str(log) in error["where"]) == (4, True)


def test_everything_that_can_be_run_is_listed() -> None:
    done = call("list", "--json")
    listed = json.loads(done.stdout)
    assert {"suites", "planners", "attackers", "defenses"} <= set(listed)
    assert {"hand", "live", "full", "availability", "updates", "long", "stress"} <= set(
        listed["suites"]
    )
    assert {
        "hijacked",
        "graded",
        "adversary",
        "replay",
        "openai",
        "anthropic",
        "haiku",
        "qwen",
    } <= (set(listed["planners"]))
    assert {"fixed", "adaptive", "robopair", "search"} <= set(listed["attackers"])
    wanted = {"none", "prompt", "allowlist", "human", "cedar", "temporal", "safety", "mission"}
    assert wanted | {"both", "external"} <= set(listed["defenses"])
    assert all(text for room in listed.values() for text in room.values())
