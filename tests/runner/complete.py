# SPDX-License-Identifier: Apache-2.0
"""The default run, the complete run by group, and what CI adds to the default run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from tempfile import TemporaryDirectory

from runner import bare, mutants, records
from runner.environments import BIN, is_made, ready, require_programs
from runner.groups import ROOT, Group, GroupError, Groups, Run, read_groups

#: Two workers; one that has nothing left takes tests from the other. A failure is printed at once.
PARALLEL = ("-n", "2", "--dist", "worksteal", "--instafail")
SERIAL = ("-p", "no:xdist", "--instafail")
#: Some lines of the ROS 2 nodes run only in a race: the nodes have a bound of their own.
NODES, NODES_PERCENT = "*/authguard_r/integrations/ros/nodes/*", 96
COUNTS = re.compile(r"(\d+) (passed|failed|skipped|errors?)\b")


@dataclass
class Table:
    """The steps that ran, with their seconds, and what failed."""

    rows: list[tuple[str, float, str]] = field(default_factory=list)

    @contextmanager
    def step(self, name: str) -> Iterator[Callable[[str], None]]:
        """Time one step; the step says how it ended by calling what it is given."""
        said = ["failed"]
        started = time.monotonic()
        print(f"\n-- {name}", flush=True)
        try:
            yield lambda words: said.__setitem__(0, words)
        except GroupError as error:
            print(error, file=sys.stderr, flush=True)
        self.rows.append((name, time.monotonic() - started, said[0]))

    @property
    def failed(self) -> list[str]:
        """The names of the steps that failed."""
        return [name for name, _, said in self.rows if said.startswith("failed")]

    def show(self) -> None:
        """Print the table."""
        width = max((len(name) for name, _, _ in self.rows), default=0)
        print(f"\n{'step':{width}}  seconds  result")
        for name, seconds, said in self.rows:
            print(f"{name:{width}}  {seconds:7.0f}  {said}")
        print(f"{'total':{width}}  {sum(row[1] for row in self.rows):7.0f}", flush=True)


def main(words: list[str]) -> int:
    """Run tests; return the exit code."""
    asked, more = _parser().parse_known_args(words)
    try:
        groups = read_groups()
        chosen = [groups.named(name) for name in asked.group]
        if asked.record:
            records.require_clean()
    except GroupError as error:
        print(error, file=sys.stderr)
        return 2
    if asked.changed:
        return _changed(groups)
    if asked.all or chosen:
        return _complete(groups, chosen or list(groups.every), asked, more)
    return _default(groups, more)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="dev.py test",
        description="Without options: the default run. Other arguments go to pytest.",
        allow_abbrev=False,
        usage="dev.py test [--all] [--group NAME ...] [--record] [--changed] [pytest arguments]",
    )
    add = parser.add_argument
    add("--all", action="store_true", help="the complete run: every group, coverage, mutants")
    add("--group", action="append", default=[], metavar="NAME", help="the complete run of a group")
    add("--record", action="store_true", help="write which groups passed to .ci/complete.json")
    add("--changed", action="store_true", help="what CI adds to the default run")
    add("--traced", action="store_true", help=SUPPRESS)
    return parser


def _default(groups: Groups, more: list[str]) -> int:
    """Run the default run, or pytest with the words that were given."""
    if more:
        return subprocess.call([str(BIN / "pytest"), *more], cwd=ROOT)
    together = [f"--group={group.name}" for group in groups.every if not group.serial]
    code = _call(_pytest(*PARALLEL, f"--run={Run.DEFAULT}", *together, "tests"))
    for group in (group for group in groups.every if group.serial):
        if all(map(is_made, group.environments)):
            code = 0 if _tests(group, Run.DEFAULT, []) == "passed" and code == 0 else 1
        else:
            print(f"not tested here: `{group.name}` (python3 dev.py test --group {group.name})")
    return code


def _changed(groups: Groups) -> int:
    """Run what the default run leaves out of every group that changed since its complete run."""
    reasons, table = records.changed_groups(groups), Table()
    for name, reason in reasons.items():
        print(f"{name}: {reason}")
    for name in reasons:
        with table.step(name) as ended:
            ended(_tests(groups.named(name), Run.REST, []))
    table.show()
    return 1 if table.failed else 0


def _complete(groups: Groups, chosen: list[Group], asked: Namespace, more: list[str]) -> int:
    """Run these groups whole; with `--all` and no group also coverage and the bare machine."""
    whole, table = asked.all and not asked.group, Table()
    if whole:
        _erase_coverage()
    for group in chosen:
        with table.step(group.name) as ended:
            said = _tests(group, Run.COMPLETE, more, traced=whole or asked.traced)
            ended(_commands(group) if said == "passed" and not more else said)
    if more:
        table.show()
        return 1 if table.failed else 0
    with table.step("mutants") as ended:
        ended(mutants.run([], groups=[] if whole else [group.name for group in chosen]))
    if whole:
        with table.step("coverage") as ended:
            ended(_coverage())
        with table.step("bare machine: demo and default run") as ended:
            ended(bare.run())
    table.show()
    green = [group.name for group in chosen if group.name not in table.failed]
    if asked.record and not {"mutants", "coverage"} & set(table.failed):
        records.record(green)
        print(f"recorded: {', '.join(green)}")
    if table.failed:
        print(f"failed: {', '.join(table.failed)}")
        return 1
    return 0


def _tests(group: Group, run: Run, more: list[str], *, traced: bool = False) -> str:
    """Run a group's tests; return how they ended."""
    require_programs(dict(group.programs))
    for name in group.environments:
        ready(name)
    how = [*(SERIAL if group.serial else PARALLEL), f"--run={run}", f"--group={group.name}", *more]
    codes = []
    untraced = group.untraced if traced else ()
    if not set(group.tests) <= set(untraced):
        ignored = [f"--ignore={place}" for place in untraced]
        cov = ["--cov", "--cov-append", "--cov-report="] if traced else []
        codes.append(_call(_pytest(*how, *ignored, *cov, "tests")))
    if untraced:
        codes.append(_call(_pytest(*how, *untraced)))
    # 5: no test; a group's rest may be empty
    allowed = {0} if run is Run.COMPLETE and not more else {0, 5}
    return "passed" if set(codes) <= allowed else "failed: tests"


def _commands(group: Group) -> str:
    """Do what a group's complete run does after its tests."""
    with TemporaryDirectory() as work:
        env = {**os.environ, "WORK": work, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
        for command in group.commands:
            print(f"$ {command}", flush=True)
            if subprocess.call(["bash", "-euo", "pipefail", "-c", command], cwd=ROOT, env=env) != 0:
                return f"failed: {command}"
    return "passed"


def _coverage() -> str:
    """Hold the trusted packages to every branch, and the ROS 2 nodes to their bound."""
    nodes = ["--omit=nothing", f"--include={NODES}", f"--fail-under={NODES_PERCENT}"]
    codes = [
        _call([str(BIN / "coverage"), "report", *words]) for words in (["--fail-under=100"], nodes)
    ]
    return "passed" if codes == [0, 0] else "failed: coverage"


def _erase_coverage() -> None:
    _call([str(BIN / "coverage"), "erase"])


def _pytest(*words: str) -> list[str]:
    return [str(BIN / "pytest"), "-q", *words]


def _call(command: list[str]) -> int:
    env = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.call(command, cwd=ROOT, env=env)
