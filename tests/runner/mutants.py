# SPDX-License-Identifier: Apache-2.0
"""`python3 dev.py mutants`: small faults in trusted code, each of which a named test has to find.

`tests/mutants.toml` lists them by hand. Each one changes one place in a copy of the project; then
the tests that claim to cover that place run. A mutant is killed when one of them fails. One that
survives, one that no longer fits the code, and one whose tests do not end in time fail the run.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from zlib import crc32

from runner.environments import BIN
from runner.groups import ROOT, GroupError, read_groups

FILE = ROOT / "tests" / "mutants.toml"
#: Copied for each worker: what tests read.
COPIED = (
    *("src", "packages", "tests", "examples", "vectors", "docs", "benchmarks", "deploy", "ros2"),
    ".ci",
)
#: Where the modules of both distributions are.
ROOTS = ("src", "packages/missionpair/src")
WORKERS = 2
#: Tests of these groups drive processes in real time: two side by side can fail without a mutant.
ALONE = frozenset({"processes", "ros", "soak"})
LIMIT_S = 120.0
#: Exit codes of pytest.
PASSED, FAILED = 0, 1


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One fault.

    Args:
        name: what is broken, as a short name.
        file: the source file, from the root.
        find: the text that is replaced; it occurs once.
        replace: what takes its place.
        tests: the tests that claim to find it; each alone has to.
        group: the group of these tests.
    """

    name: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]
    group: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of one mutant under one of its tests."""

    mutant: Mutant
    test: str
    said: str
    seconds: float

    @property
    def killed(self) -> bool:
        """True when the test failed."""
        return self.said == "killed"


def main(words: list[str]) -> int:
    """Run mutants; return the exit code."""
    parser = ArgumentParser(prog="dev.py mutants", description=__doc__)
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="only these mutants")
    add("--group", action="append", default=[], metavar="NAME", help="only those of a group")
    add("--slice", type=int, metavar="N", help="only N of them; another N at each commit")
    add("--list", action="store_true", help="print them and end")
    asked = parser.parse_args(words)
    try:
        for name in asked.group:
            read_groups().named(name)
        chosen = choose(read_mutants(), names=asked.names, groups=asked.group)
    except GroupError as error:
        print(error, file=sys.stderr)
        return 2
    if asked.slice is not None:
        chosen = sliced(chosen, asked.slice, at=_commit())
    if asked.list:
        for mutant in chosen:
            print(f"{mutant.name:44} {mutant.file}")
        return 0
    said = judge(chosen)
    print(said)
    return 0 if said.startswith("passed") else 1


def run(names: Sequence[str], *, groups: Sequence[str]) -> str:
    """Run the mutants of these groups, or all; return how they ended.

    Raises:
        GroupError: the list of mutants is wrong.
    """
    return judge(choose(read_mutants(), names=names, groups=groups))


def read_mutants(file: Path = FILE) -> list[Mutant]:
    """Return the mutants of the list, each checked against the code.

    Raises:
        GroupError: an entry is malformed, or its text is not in its file exactly once.
    """
    try:
        plain = tomllib.loads(file.read_text(encoding="utf-8"))
        found = [
            Mutant(name=name, **{**fields, "tests": tuple(fields["tests"])})
            for name, fields in plain.items()
        ]
    except (tomllib.TOMLDecodeError, TypeError, KeyError) as error:
        raise GroupError(f"{file.name}: {error}") from error
    groups = read_groups()
    for mutant in found:
        _require_sound(mutant)
        groups.named(mutant.group)
    return found


def choose(every: list[Mutant], *, names: Sequence[str], groups: Sequence[str]) -> list[Mutant]:
    """Return the mutants of these names, or of these groups, or all.

    Raises:
        GroupError: there is no mutant of a name.
    """
    unknown = set(names) - {mutant.name for mutant in every}
    if unknown:
        raise GroupError(f"no mutant `{min(unknown)}`; list them: python3 dev.py mutants --list")
    if names:
        return [mutant for mutant in every if mutant.name in names]
    return [mutant for mutant in every if not groups or mutant.group in groups]


def sliced(every: list[Mutant], count: int, *, at: str) -> list[Mutant]:
    """Return `count` of the mutants; which ones depends on the commit alone."""
    ordered = sorted(every, key=lambda mutant: crc32(f"{at} {mutant.name}".encode()))
    return ordered[:count]


def judge(chosen: list[Mutant], *, root: Path = ROOT, limit_s: float = LIMIT_S) -> str:
    """Run the tests of each mutant against it, in copies of a project; return how that ended."""
    if not chosen:
        return "passed: no mutants"
    unbroken = sorted({test for mutant in chosen for test in mutant.tests})
    jobs = [(mutant, test) for mutant in chosen for test in mutant.tests]
    workers = 1 if ALONE & {mutant.group for mutant in chosen} else WORKERS
    with TemporaryDirectory(prefix="mutants-") as folder:
        copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(workers):
            copies.put(_copy(root, Path(folder) / str(number)))

        def unbroken_pass(tests: list[str]) -> tuple[int | None, str]:
            copy = copies.get()
            try:
                return _pytest(copy, tests, limit_s=LIMIT_S * 5)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(workers) as pool:
            halves = [half for half in (unbroken[::2], unbroken[1::2]) if half]
            for code, said in pool.map(unbroken_pass, halves):
                if code != PASSED:
                    return f"failed: the tests fail without any mutant:\n{said[-4_000:]}"

        def one(job: tuple[Mutant, str]) -> Verdict:
            copy = copies.get()
            try:
                return _try(copy, *job, limit_s=limit_s)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(workers) as pool:
            verdicts = []
            for verdict in pool.map(one, jobs):
                name, seconds = verdict.mutant.name, verdict.seconds
                print(f"{verdict.said:10} {seconds:5.1f} s  {name}: {verdict.test}", flush=True)
                verdicts.append(verdict)
    survivors = [verdict for verdict in verdicts if not verdict.killed]
    killed = len(chosen) - len({verdict.mutant.name for verdict in survivors})
    told = f"{killed} of {len(chosen)} mutants killed"
    if survivors:
        names = ", ".join(f"{one.mutant.name} ({one.said}: {one.test})" for one in survivors)
        return f"failed: {told}; not killed: {names}"
    return f"passed: {told}"


def _try(copy: Path, mutant: Mutant, test: str, *, limit_s: float) -> Verdict:
    started = time.monotonic()
    with _broken(copy, mutant):
        code, said = _pytest(copy, [test], limit_s=limit_s)
    named = {PASSED: "survived", FAILED: "killed", None: "no end"}
    verdict = named.get(code, f"exit {code}: {said[-400:]}")
    return Verdict(mutant=mutant, test=test, said=verdict, seconds=time.monotonic() - started)


@contextmanager
def _broken(copy: Path, mutant: Mutant) -> Iterator[None]:
    place = copy / mutant.file
    whole, times = place.read_text(encoding="utf-8"), place.stat()
    place.write_text(whole.replace(mutant.find, mutant.replace), encoding="utf-8")
    try:
        yield
    finally:
        place.write_text(whole, encoding="utf-8")
        # its compiled form counts again
        os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))


def _pytest(copy: Path, tests: list[str], *, limit_s: float) -> tuple[int | None, str]:
    """Run tests in a copy; return the exit code, or None when they do not end in time."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}
    env = {
        **kept,
        "PYTHONPATH": os.pathsep.join(str(copy / root) for root in ROOTS),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    words = ["-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider", "--tb=line", *tests]
    process = subprocess.Popen(
        [str(BIN / "python"), "-m", "pytest", *words],
        cwd=copy,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # the tests, and the processes that they started
        process.communicate()
        return None, ""
    return process.returncode, said.decode(errors="replace")


def _copy(root: Path, folder: Path) -> Path:
    """Return a copy of the project without what git ignores."""
    folder.mkdir(parents=True)
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", ".hypothesis", "*.db*")
    for place in filter(Path.is_dir, (root / name for name in COPIED)):
        shutil.copytree(place, folder / place.name, ignore=ignored, symlinks=True)
    for file in root.iterdir():
        if file.is_file() and not file.name.startswith(".coverage"):
            shutil.copy2(file, folder / file.name)
    subprocess.run([str(BIN / "python"), "-m", "compileall", "-q", *ROOTS], cwd=folder, check=True)
    return folder


def _require_sound(mutant: Mutant) -> None:
    place = ROOT / mutant.file
    if not place.is_file():
        raise GroupError(f"mutant `{mutant.name}`: {mutant.file} does not exist")
    count = place.read_text(encoding="utf-8").count(mutant.find)
    if count != 1:
        raise GroupError(f"mutant `{mutant.name}`: its text occurs {count} times in {mutant.file}")
    for test in mutant.tests:
        if not (ROOT / test.partition("::")[0]).is_file():
            raise GroupError(f"mutant `{mutant.name}`: {test} does not exist")


def _commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()
