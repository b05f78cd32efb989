# SPDX-License-Identifier: Apache-2.0
"""The campaign's log loses nothing, repeats nothing, and shows every change made to it.

Source: docs/spec/campaign-log.md
"""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from missionpair.campaign.log import LogError, LogWriter, has_trials, read_log
from missionpair.records import SCHEMA, Campaign, NamedPart, Round, Timing, Trial

CAMPAIGN = Campaign(
    schema=SCHEMA,
    suite="live",
    suite_version=1,
    suite_digest="d",
    pairs=3,
    planner=NamedPart("hijacked", simulated=True),
    attacker=NamedPart("fixed"),
    access="black",
    defenses=(NamedPart("both"),),
    seed=0,
    seeds=1,
    rounds=1,
    turns=1,
    kinds=("attack",),
    weights=(1, 1, 1, 1, 1),
    trials=3,
    version="0",
)


def trial(n: int) -> Trial:
    return Trial(
        n=n,
        pair=f"p{n}",
        kind="attack",
        defense="both",
        seed=n,
        domain="hospital",
        categories=("goal",),
        family="destination-change",
        channels=("sign",),
        rounds=(Round(reply="{}"),),
        complied=True,
        instead="",
        blocked=True,
        by="authorization",
        reasons=("DESTINATION_OUT_OF_SCOPE",),
        planned=1,
        executed=0,
        unauthorized=0,
        hijacked=False,
        violated=(),
        deviation="0",
        completed=False,
        prompts=0,
        stalled_ms=0,
        false_stop=True,
        error="",
        tokens=(0, 0),
        cost_microusd=0,
        timing=Timing(total=n + 1),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "c.jsonl"


def written(path: Path, count: int = 3, *, ends: bool = True) -> list[Trial]:
    trials = [trial(n) for n in range(count)]
    with LogWriter(path, CAMPAIGN) as log:
        for item in trials[log.done :]:
            log.add(item)
        if ends:
            log.end()
    return trials


def test_what_was_written_is_read(path: Path) -> None:
    trials = written(path)
    campaign, found = read_log(path)
    assert (campaign, list(found)) == (CAMPAIGN, trials)


def test_a_whole_log_is_left_as_it_is(path: Path) -> None:
    written(path)
    before = path.read_bytes()
    with LogWriter(path, CAMPAIGN) as log:
        assert (log.done, log.is_whole) == (3, True)
        log.end()
    assert path.read_bytes() == before


def test_two_runs_differ_in_timing_alone(tmp_path: Path) -> None:
    one, two = tmp_path / "1", tmp_path / "2"
    written(one)
    with LogWriter(two, CAMPAIGN) as log:
        for n in range(3):
            log.add(replace(trial(n), timing=Timing(total=99)))
        log.end()

    assert one.read_bytes() != two.read_bytes()
    assert bound(one) == bound(two)


def bound(path: Path) -> list[tuple[bytes, bytes]]:
    """Return what is under the links: everything but the timing."""
    lines = path.read_bytes().splitlines()
    decoded = [msgspec.json.decode(line, type=dict[str, msgspec.Raw]) for line in lines]
    return [(bytes(line["link"]), bytes(line["record"])) for line in decoded]


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_log_cut_anywhere_goes_on_and_is_the_same_in_the_end(path: Path, cut: int) -> None:
    trials = written(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * cut // 60])
    written(path)
    assert path.read_bytes() == whole
    assert list(read_log(path)[1]) == trials


def test_a_cut_log_is_not_read_as_a_whole_one(path: Path) -> None:
    written(path, ends=False)
    _, found = read_log(path)
    with pytest.raises(LogError, match="has no last line"):
        list(found)
    _, found = read_log(path, is_partial_allowed=True)
    assert len(list(found)) == 3
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(LogError, match="middle of a line"):
        list(read_log(path)[1])


@pytest.mark.parametrize("number", range(5))
def test_a_changed_line_is_named(path: Path, number: int) -> None:
    written(path)
    lines = path.read_bytes().splitlines(keepends=True)
    for old, new in ((b'"complied":true', b'"complied":false'), (b'"seed":0', b'"seed":7')):
        lines[number] = lines[number].replace(old, new)
    lines[number] = lines[number].replace(b'"trials":3,"type":"end"', b'"trials":2,"type":"end"')
    path.write_bytes(b"".join(lines))
    with pytest.raises(LogError) as error:
        list(read_log(path)[1])
    assert error.value.where == f"{path}:{number + 1}"
    with pytest.raises(LogError):
        LogWriter(path, CAMPAIGN)


@pytest.mark.parametrize("edit", ["drop", "double", "swap", "more"])
def test_lines_left_out_doubled_swapped_or_added_are_named(path: Path, edit: str) -> None:
    written(path)
    lines = path.read_bytes().splitlines(keepends=True)
    if edit == "drop":
        del lines[2]
    elif edit == "double":
        lines.insert(2, lines[2])
    elif edit == "swap":
        lines[2], lines[3] = lines[3], lines[2]
    else:
        lines.append(lines[-1])
    path.write_bytes(b"".join(lines))
    with pytest.raises(LogError, match=r":[3456]: "):
        list(read_log(path)[1])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\n",
        b"{}\n",
        b"[]\n",
        b"\xff\xfe\n",
        b'{"link":"","record":{}}\n',
        b"{" * 5_000 + b"\n",
    ],
)
def test_what_is_no_log_is_said_to_be_none(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with pytest.raises(LogError):
        read_log(path)


def test_a_log_of_another_campaign_is_not_gone_on_with(path: Path) -> None:
    written(path)
    with pytest.raises(LogError, match=r"another campaign \(seed, seeds\)"):
        LogWriter(path, replace(CAMPAIGN, seed=1, seeds=2))
    assert len(list(read_log(path)[1])) == 3


def test_two_runs_cannot_write_one_log(path: Path) -> None:
    with LogWriter(path, CAMPAIGN), pytest.raises(LogError, match="another run writes it"):
        LogWriter(path, CAMPAIGN)
    LogWriter(path, CAMPAIGN).close()


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written"):
        LogWriter(tmp_path / "no" / "c.jsonl", CAMPAIGN)
    with pytest.raises(LogError, match="cannot be read"):
        read_log(tmp_path / "no")


def test_a_full_disk_loses_no_trial_that_was_finished_before(path: Path) -> None:
    """A real limit of the system's, in a process of its own: what was written stays readable."""
    program = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_campaign_log import CAMPAIGN, trial
from missionpair.campaign.log import LogError, LogWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
log = LogWriter(Path({str(path)!r}), CAMPAIGN)
try:
    for n in range(2_000):
        log.add(trial(n))
except LogError as error:
    print(error.message)
    sys.exit(5)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.returncode, "File too large" in done.stdout) == (5, True), done.stderr
    assert path.stat().st_size <= 300_000
    before = list(read_log(path, is_partial_allowed=True)[1])
    assert len(before) > 100
    written(path, 500)
    assert list(read_log(path)[1]) == [trial(n) for n in range(500)]


def test_a_killed_run_leaves_whole_trials_and_goes_on(path: Path) -> None:
    program = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_campaign_log import CAMPAIGN, trial
from missionpair.campaign.log import LogWriter
log = LogWriter(Path({str(path)!r}), CAMPAIGN)
for n in range(1_000):
    log.add(trial(n))
os.kill(os.getpid(), 9)
"""
    done = subprocess.run([sys.executable, "-c", program], check=False)
    assert done.returncode == -9
    found = list(read_log(path, is_partial_allowed=True)[1])
    assert found == [trial(n) for n in range(len(found))]
    assert len(found) > 800
    written(path, 1_000)
    assert list(read_log(path)[1]) == [trial(n) for n in range(1_000)]


def test_a_trial_out_of_turn_is_our_own_fault(path: Path) -> None:
    with LogWriter(path, CAMPAIGN) as log, pytest.raises(RuntimeError):
        log.add(trial(1))


@pytest.mark.parametrize("data", [b"my precious notes", b"{", b'{"link":"', b"x" * 100_000])
def test_a_file_that_is_no_log_is_not_written_over(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    if not data.startswith(b"{"):
        with pytest.raises(LogError, match="would be written over"):
            LogWriter(path, CAMPAIGN)
        assert path.read_bytes() == data
        return
    written(path)  # the beginning of the first line: a run that was killed while it wrote it
    assert len(list(read_log(path)[1])) == 3


def test_what_is_no_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no file"):
        LogWriter(tmp_path, CAMPAIGN)
    with pytest.raises(LogError, match="no file"):
        LogWriter(Path("/dev/null"), CAMPAIGN)
    assert not has_trials(tmp_path)


def test_a_log_has_trials_from_its_second_line_on(path: Path) -> None:
    assert not has_trials(path)
    written(path, 0, ends=False)
    assert not has_trials(path)
    written(path, 1, ends=False)
    assert has_trials(path)


def test_a_log_that_a_forked_process_forgot_is_free_when_its_writer_is_gone(path: Path) -> None:
    log = LogWriter(path, CAMPAIGN)
    copy = os.dup(log._file)  # what a fork has: the same lock
    os.close(log._file)
    with pytest.raises(LogError, match="another run"):
        LogWriter(path, CAMPAIGN)
    log._file = copy
    log.forget()
    LogWriter(path, CAMPAIGN).close()


def test_a_packed_log_is_read_and_never_written(path: Path) -> None:
    trials = written(path)
    packed = path.with_name("log.jsonl.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert list(read_log(packed)[1]) == trials
    for data in (packed.read_bytes()[:-20], b"no gzip"):
        packed.write_bytes(data)
        with pytest.raises(LogError, match="no whole gzip file") as caught:
            list(read_log(packed)[1])
        assert not caught.value.is_here
    with pytest.raises(LogError, match=r"name a file without `\.gz`"):
        LogWriter(path.with_name("other.jsonl.gz"), CAMPAIGN)
    assert not path.with_name("other.jsonl.gz").exists()
