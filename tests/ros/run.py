# SPDX-License-Identifier: Apache-2.0
"""Run the tests on ROS 2, each file in a network and with shared memory of its own.

    python3 tests/ros/run.py ENVIRONMENT [FILE...] [--run default]

Two files run at a time; those whose deadlines are real run alone, after the others. Run it with a
Python that has no ROS; `ENVIRONMENT` is what `tests/ros/make.sh` made.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FILES = tuple(sorted(HERE.glob("test_*.py")))
#: A test there has to happen within a tenth of a second or within one: nothing runs beside it.
ALONE = frozenset({"dead_node", "heartbeat", "mediation", "stopping", "story", "velocity"})
#: Files that run at a time, of the others.
BESIDE = 2
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 900.0
#: `pytest` found no test that was asked for.
NO_TESTS = 5


class Run(NamedTuple):
    """How the run of a file ended.

    Args:
        code: of `pytest`.
        said: what it wrote.
        took_s: in seconds.
    """

    code: int
    said: str
    took_s: float

    @property
    def last(self) -> str:
        """Its last line: how many tests passed."""
        lines = self.said.rstrip().splitlines()
        return lines[-1] if lines else ""

    @property
    def is_shown(self) -> bool:
        """True when every test passed; what was skipped has not been shown."""
        return self.code == 0 and "skipped" not in self.last


class Runs:
    """Runs of files, which begin at once; a context manager, which ends what still runs.

    Args:
        environment: the folder of Python with ROS.
        files: which, with more words of `pytest` for each.
        folder: for what the tests write.
        variables: of the processes.
    """

    def __init__(
        self,
        environment: Path,
        files: Mapping[Path, tuple[str, ...]],
        folder: Path,
        *,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        self._python = environment / "bin" / "python"
        self._folder, self._words = folder, files
        self._variables = dict(os.environ if variables is None else variables)
        self._running: set[subprocess.Popen[str]] = set()
        self._is_over = False
        self._beside = ThreadPoolExecutor(BESIDE)
        self._alone = ThreadPoolExecutor(1)
        others = [file for file in files if _name(file) not in ALONE]
        self._runs = {file: self._beside.submit(self._run, file) for file in others}
        first = tuple(self._runs.values())
        for file in files:
            if file not in self._runs:
                self._runs[file] = self._alone.submit(self._run, file, first)

    def of(self, file: Path) -> Run:
        """Return how the run of a file ended, waiting for it."""
        return self._runs[file].result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._is_over = True
        for process in tuple(self._running):
            process.terminate()
        for pool in (self._beside, self._alone):
            pool.shutdown(cancel_futures=True)

    def _run(self, file: Path, first: tuple[Future[Run], ...] = ()) -> Run:
        """Run a file, once others have ended."""
        for other in first:
            other.exception()
        begun = time.monotonic()
        if self._is_over:
            return Run(2, "it was not begun", 0.0)
        folder = self._folder / _name(file)
        words = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", f"--basetemp={folder}"]
        with subprocess.Popen(
            [
                "sh",
                HERE / "alone.sh",
                self._python,
                "-m",
                "pytest",
                *words,
                *self._words[file],
                file,
            ],
            cwd=ROOT,
            env=self._variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process:
            self._running.add(process)
            try:
                said, _ = process.communicate(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                said = f"{process.communicate()[0]}\n{file.name} did not end"
            finally:
                self._running.discard(process)
        return Run(process.returncode, said, time.monotonic() - begun)


def _name(file: Path) -> str:
    return file.stem.removeprefix("test_")


def main() -> int:
    """Run what was asked for; say how long each file took, and what failed."""
    asks = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asks.add_argument("environment", type=Path)
    asks.add_argument("files", nargs="*", type=Path, default=FILES)
    asks.add_argument("--run", help="which tests, as tests/conftest.py reads it")
    given = asks.parse_args()
    words = () if given.run is None else ("--run", given.run)
    files = {Path(file).resolve(): words for file in given.files}
    failed, begun = [], time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="ag-ros-") as folder,
        Runs(given.environment.resolve(), files, Path(folder)) as runs,
    ):
        for file in files:
            run = runs.of(file)
            print(f"{_name(file):12} {run.took_s:6.1f} s  {run.last}", flush=True)
            if not run.is_shown and not (words and run.code == NO_TESTS):
                failed.append(file.name)
                print(run.said, flush=True)
    print(f"{'all':12} {time.monotonic() - begun:6.1f} s  failed: {', '.join(failed) or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
