# SPDX-License-Identifier: Apache-2.0
"""`audit verify` of a long log, as it is typed: with others that help, and interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from authguard_r.audit.parallel import ALONE
from authguard_r.auditor.export_format import row_line
from fixtures.small_logs import edited, log_of

#: Records of a log that is long enough for others to help.
SIZE = ALONE + 6_000
_PATIENCE_S = 60
#: What a shell starts behind it ignores SIGINT, and whoever that starts.
HEARING = ("env", "--default-signal=INT")


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a long log that is whole, and the same with its last record changed."""
    folder = tmp_path_factory.mktemp("long")
    rows = log_of(SIZE)
    (folder / "log.jsonl").write_bytes(b"".join(map(row_line, rows)))
    rows[-1] = edited(rows[-1], time_ms=1)
    (folder / "bad.jsonl").write_bytes(b"".join(map(row_line, rows)))
    return folder / "log.jsonl", folder / "bad.jsonl"


def started(log: Path, jobs: int) -> subprocess.Popen[str]:
    words = ["audit", "verify", str(log), "--jobs", str(jobs), "--json"]
    main = "import sys; from authguard_r.cli import main; main(sys.argv[1:])"
    command = [*HEARING, sys.executable, "-c", main, *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def told(process: subprocess.Popen[str]) -> tuple[int, object]:
    text, _ = process.communicate(timeout=_PATIENCE_S)
    return process.returncode, json.loads(text)


def children(process: subprocess.Popen[str]) -> list[int]:
    """Return who was started by it and has not ended."""
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    return [int(word) for word in listed.read_text("ascii").split()] if listed.exists() else []


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.001)


def is_gone(pid: int) -> bool:
    """True once a process has ended, whoever reaps it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_a_long_log_is_told_alike_by_one_process_and_by_several(
    exports: tuple[Path, Path],
) -> None:
    for log, code in zip(exports, (0, 1), strict=True):
        answers = [told(started(log, jobs)) for jobs in (1, 3)]
        assert answers[0] == answers[1]
        assert answers[0][0] == code
    assert isinstance(answers[0][1], dict)
    assert answers[0][1]["where"] == f"record {SIZE - 1}"


@pytest.mark.smoke
@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_whoever_helps_ends_with_the_command(
    exports: tuple[Path, Path], stop: signal.Signals, code: int
) -> None:
    process = started(exports[0], 3)
    until(lambda: children(process))
    helping = children(process)
    assert helping
    for pid in helping:  # what they look at is never done, however late this process gets its turn
        os.kill(pid, signal.SIGSTOP)
    os.kill(process.pid, stop)
    for pid in helping:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    process.communicate(timeout=_PATIENCE_S)
    assert process.returncode == code
    until(lambda: all(map(is_gone, helping)))
