#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Everything a newcomer runs, with Python 3.11 and pip alone.

    python3 dev.py demo      set up, then the hospital story
    python3 dev.py test      set up, then the default run of the tests: at most ten minutes
    python3 dev.py test --all          the complete run: every group, coverage, mutants, benchmarks
    python3 dev.py test --group NAME   the complete run of one group
    python3 dev.py groups    the groups of tests
    python3 dev.py mutants   test the tests: each small fault in trusted code has to be found
    python3 dev.py lint      set up, then format, lint, types, import contracts, budget of the core
    python3 dev.py bench     set up, then the benchmarks
    python3 dev.py setup     only the environment, in .venv
    python3 dev.py fuzz      fuzz normalizer and protocol with atheris, each for a minute or SECONDS
    python3 dev.py lock      compute the lock files from pyproject.toml

Other words are passed on: `python3 dev.py test -k replay`.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import sys
import venv
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENV = ROOT / ".venv"
BIN = ENV / ("Scripts" if os.name == "nt" else "bin")
LOCK = ROOT / "requirements.lock"
FUZZ_LOCK = ROOT / "requirements-fuzz.lock"
#: What a gate alone needs, for its container.
GATE_LOCK = ROOT / "deploy" / "container" / "requirements.lock"


def main(arguments: list[str]) -> int:
    """Run one task and return its exit code."""
    if not arguments or arguments[0] not in TASKS:
        print(__doc__)
        if arguments and arguments[0] not in {"help", "-h", "--help"}:
            print(f"unknown task `{arguments[0]}`; the tasks: {', '.join(TASKS)}", file=sys.stderr)
        return 2
    if sys.version_info < (3, 11):
        print("Python 3.11 or newer is needed; this is", sys.version.split()[0])
        return 2
    # tests start hundreds of processes: what they import is compiled once
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    setup()
    return TASKS[arguments[0]](arguments[1:])


def setup() -> None:
    """Make .venv hold exactly what the lock file says, unless it does already."""
    stamp = ENV / "locked"
    projects = [ROOT, ROOT / "packages" / "missionpair"]
    parts = [LOCK, *(project / "pyproject.toml" for project in projects)]
    wanted = hashlib.sha256(b"".join(path.read_bytes() for path in parts)).hexdigest()
    if stamp.is_file() and stamp.read_text() == wanted:
        return
    print("setting up .venv ...", file=sys.stderr)
    if not (BIN / "python").exists() and not (BIN / "python.exe").exists():
        venv.create(ENV, with_pip=True)
    quiet = ["--quiet", "--disable-pip-version-check"]
    first = ENV / "uv.lock"
    first.write_text(locked("uv"))
    pip = [str(BIN / "python"), "-m", "pip", "install", *quiet]
    check([*pip, "--require-hashes", "--only-binary=:all:", "--requirement", str(first)])
    uv = [str(BIN / "uv"), "pip"]
    python = ["--quiet", "--python", str(BIN / "python")]
    check([*uv, "sync", *python, "--require-hashes", str(LOCK)])
    # the build backend is a locked one, too
    ours = [word for project in projects for word in ("--editable", str(project))]
    check([*uv, "install", *python, "--no-build-isolation", "--no-deps", *ours])
    stamp.write_text(wanted)


def locked(name: str) -> str:
    """Return what the lock file says of one package: its version, and the hash of every file."""
    lines = LOCK.read_text().splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith(f"{name}=="))
    hashes = itertools.takewhile(lambda line: line.startswith("    --hash="), lines[at + 1 :])
    return "\n".join([lines[at], *hashes]) + "\n"


def demo(arguments: list[str]) -> int:
    """Play the hospital story."""
    return run(["authguard", "demo", *arguments])


def of_tests(task: str) -> Callable[[list[str]], int]:
    """Return a task of the test runner, `tests/run.py`."""
    return lambda arguments: run(["python", "tests/run.py", task, *arguments])


def lint(arguments: list[str]) -> int:
    """Run every check that needs no test, and say which failed."""
    checks = [
        ["ruff", "format", "--check", "."],
        ["ruff", "check", "."],
        ["mypy"],
        ["pyright"],
        ["lint-imports", "--no-cache"],
        ["python", "tests/budget.py"],
        *([] if not arguments else [arguments]),
    ]
    failed = [" ".join(command) for command in checks if run(command) != 0]
    print("failed: " + ", ".join(failed) if failed else "lint: all checks passed")
    return 1 if failed else 0


def bench(arguments: list[str]) -> int:
    """Measure against the yardsticks of the same run."""
    return run(["python", "benchmarks/run.py", *arguments])


def fuzz(arguments: list[str]) -> int:
    """Fuzz normalizer and protocol for a while; the tool is large, so it is installed here."""
    uv = [str(BIN / "uv"), "pip", "install", "--quiet", "--python", str(BIN / "python")]
    check([*uv, "--require-hashes", "--requirements", str(FUZZ_LOCK)])
    first = run(["python", "tests/fuzz/dialects.py", *arguments])
    return run(["python", "tests/fuzz/protocol.py", *arguments]) or first


def lock(arguments: list[str]) -> int:
    """Work out the lock files: every version, every hash, no host."""
    command = ["uv", "pip", "compile", "pyproject.toml"]
    how = ["--generate-hashes", "--universal", "--no-emit-index-url", "--no-header", "--quiet"]
    names = ("drafting", "frost", "http", "langchain", "mcp", "openai-agents", "pkcs11")
    extras = [f"--extra={name}" for name in (*names, "pydantic-ai", "ros")]
    everything = [*extras, "--group", "dev", "--group", "bench"]
    first = run([*command, *everything, *how, "-o", LOCK.name, *arguments])
    first = first or run([*command, *how, "-c", LOCK.name, "-o", str(GATE_LOCK), *arguments])
    only = ["uv", "pip", "compile", "--group", "fuzz"]
    return run([*only, *how, "-o", FUZZ_LOCK.name, *arguments]) or first


def run(command: list[str]) -> int:
    """Run a program of .venv in the checkout and return its exit code."""
    path = f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}"
    program = str(BIN / command[0])
    return subprocess.call([program, *command[1:]], cwd=ROOT, env={**os.environ, "PATH": path})


def check(command: list[str]) -> None:
    """Run a command and stop here when it fails."""
    if subprocess.call(command, cwd=ROOT) != 0:
        sys.exit(f"failed: {' '.join(command)}")


TASKS = {
    "demo": demo,
    "test": of_tests("test"),
    "groups": of_tests("groups"),
    "mutants": of_tests("mutants"),
    "lint": lint,
    "bench": bench,
    "fuzz": fuzz,
    "lock": lock,
    "setup": lambda _: 0,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
