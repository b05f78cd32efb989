#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Everything a newcomer runs, with Python 3.11 and pip alone.

    python3 dev.py demo     set up, then the hospital story
    python3 dev.py test     set up, then the tests
    python3 dev.py lint     set up, then format, lint, types, import contracts, budget of the core
    python3 dev.py bench    set up, then the benchmarks
    python3 dev.py setup    only the environment, in .venv
    python3 dev.py fuzz     fuzz normalizer and protocol with atheris, each for a minute or SECONDS
    python3 dev.py lock     work the lock file out anew from pyproject.toml

What follows the name is passed on: `python3 dev.py test -k replay`.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent
ENV = ROOT / ".venv"
BIN = ENV / ("Scripts" if os.name == "nt" else "bin")
LOCK = ROOT / "requirements.lock"
FUZZ_LOCK = ROOT / "requirements-fuzz.lock"
#: What a gate alone needs, for its container.
GATE_LOCK = ROOT / "deploy" / "container" / "requirements.lock"
UV = "uv==0.13.8"
#: What reaches no line that the other tests do not: tracing it would only make it twice as long.
UNTRACED = [
    "properties",
    "games/test_audit_game.py",
    "games/test_audit_pieces.py",
    "cli/test_missionpair.py",
    "unit/missionpair",
    "unit/test_docs.py",
    "unit/onboarding",
    "unit/drafting",
    "integration/test_crash.py",
    "integration/test_power_cut.py",
    "integration/test_missionpair_campaigns.py",
    "integration/test_missionpair_full.py",
    "integration/test_benign_mentions.py",
    "integration/test_separate_users.py",
    "integration/test_adapters_rosa.py",
    "integration/test_adapters_rai.py",
    "integration/test_mcp_ros.py",
    "integration/test_first_hour.py",
    "integration/test_household.py",
    "integration/test_ros_denial.py",
    "integration/test_witnesses.py",
    "integration/test_adapters_examples.py",
    "integration/test_mcp_configurations.py",
    "integration/test_replay_from_log.py",
    "integration/test_draft_models.py",
    "integration/test_draft_to_motion.py",
]
#: A failure is told where it happens: of a run that is cut short one knows what it found.
PARALLEL = ["-n", "2", "--dist", "worksteal", "-q", "--instafail"]
#: Many processes and their deadlines are in these: so few may fail beside others and hold alone.
PROCESSES, MOST_AGAIN = ("tests/cli/", "tests/integration/", "tests/lessons/"), 2
#: Real deadlines of a tenth of a second: nothing runs beside them.
ALONE = "integration/test_ros_nodes.py"
#: What runs on ROS 2 alone, and how much of it is reached at least, in percent.
NODES, REACHED = "*/authguard_r/ros/nodes/*", 96


def main(arguments: list[str]) -> int:
    """Run one task and return its exit code."""
    if not arguments or arguments[0] not in TASKS:
        print(__doc__)
        return 2
    if sys.version_info < (3, 11):
        print("Python 3.11 or newer is needed; this is", sys.version.split()[0])
        return 2
    setup()
    return TASKS[arguments[0]](arguments[1:])


def setup() -> None:
    """Make .venv hold exactly what the lock file says, unless it does already."""
    stamp = ENV / "locked"
    wanted = hashlib.sha256(LOCK.read_bytes() + (ROOT / "pyproject.toml").read_bytes()).hexdigest()
    if stamp.is_file() and stamp.read_text() == wanted:
        return
    print("setting up .venv ...", file=sys.stderr)
    if not (BIN / "python").exists() and not (BIN / "python.exe").exists():
        venv.create(ENV, with_pip=True)
    quiet = ["--quiet", "--disable-pip-version-check"]
    check([str(BIN / "python"), "-m", "pip", "install", *quiet, UV])
    uv = [str(BIN / "uv"), "pip"]
    python = ["--quiet", "--python", str(BIN / "python")]
    check([*uv, "sync", *python, "--require-hashes", str(LOCK)])
    check([*uv, "install", *python, "--no-deps", "--editable", str(ROOT)])
    stamp.write_text(wanted)


def demo(arguments: list[str]) -> int:
    """Play the hospital story."""
    return run(["authguard", "demo", *arguments])


def test(arguments: list[str]) -> int:
    """Run the tests; the whole suite with coverage, or what was asked for."""
    if arguments:
        return run(["pytest", *arguments])
    first = run_beside([f"tests/{name}" for name in UNTRACED])
    others = [f"--ignore=tests/{name}" for name in (*UNTRACED, ALONE)]
    covered = ["--cov", "--cov-append", "--cov-report=term", "--cov-fail-under=100"]
    if shutil.which("softhsm2-util") is None and "AUTHGUARD_CI" not in os.environ:
        print("no software token here (softhsm2): keys in hardware are not tested", flush=True)
        os.environ["AUTHGUARD_UNMEASURED"] = "*/authguard_r/keys/pkcs11.py"
    if "AUTHGUARD_INSPECT" not in os.environ and "AUTHGUARD_CI" not in os.environ:
        print("no environment with Inspect (AUTHGUARD_INSPECT): not tested", flush=True)
        os.environ["AUTHGUARD_UNMEASURED_INSPECT"] = "*/authguard_r/adapters/inspect.py"
    alone = on_ros()
    return run_beside([*others, *covered, "tests"]) or first or alone


def run_beside(words: list[str]) -> int:
    """Run tests beside each other; a failure is one, whatever comes after it.

    But for tests of whole processes: a machine that is full makes one of thousands miss its
    deadline now and then. When nothing else failed, the few that did have to hold once more, alone,
    and are named.
    """
    with TemporaryDirectory() as folder:
        cache = ["-o", f"cache_dir={folder}"]
        code = run(["pytest", *PARALLEL, *cache, *words])
        kept = Path(folder) / "v" / "cache" / "lastfailed"
        failed = sorted(json.loads(kept.read_text())) if kept.is_file() else []
        others = [name for name in failed if not name.startswith(PROCESSES)]
        if code != 1 or others or not 0 < len(failed) <= MOST_AGAIN:
            return code
        print("once more, alone:", *failed, sep="\n  ", flush=True)
        return run(["pytest", "-q", "-p", "no:xdist", *cache, "--last-failed", *words])


def on_ros() -> int:
    """Run the tests that need ROS 2, alone, and hold its nodes to what they reach."""
    if "AUTHGUARD_ROS" not in os.environ:
        print("no environment with ROS 2 (AUTHGUARD_ROS): not tested", flush=True)
    failed = run(["pytest", "-q", "-p", "no:xdist", "--cov", "--cov-report=", f"tests/{ALONE}"])
    if "AUTHGUARD_ROS" in os.environ:
        reached = ["coverage", "report", f"--include={NODES}", f"--fail-under={REACHED}"]
        failed = run(reached) or failed
    # a line that only a race reaches is not there every time: they are no part of the whole
    os.environ["AUTHGUARD_UNMEASURED_ROS"] = NODES
    return failed


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
    names = ("drafting", "frost", "http", "langchain", "llm", "mcp", "openai-agents", "pkcs11")
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
    "test": test,
    "lint": lint,
    "bench": bench,
    "fuzz": fuzz,
    "lock": lock,
    "setup": lambda _: 0,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
