# SPDX-License-Identifier: Apache-2.0
"""The documents are true: commands run, links lead somewhere, tables are the code.

A page's `bash` and `python` blocks run in order in one folder that holds a copy of `examples/`. A
command fails only where its line ends with `# exit N`. A `text` block right after a block is what
it prints: each line in order, `...` for anything.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from authguard_r.cli.app import program
from authguard_r.core.reasons import RETRYABLE, STEP, Reason

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = (
    *sorted((DOCS / "tutorial").glob("*.md")),
    *sorted((DOCS / "howto").glob("*.md")),
    DOCS / "reference" / "python.md",
    ROOT / "examples" / "hospital" / "README.md",
)
WRITTEN = (*sorted(DOCS.rglob("*.md")), *sorted(ROOT.glob("*.md")), PAGES[-1])
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXIT = re.compile(r"^(?P<command>.*\S)\s+# exit (?P<code>\d+)$")
LINK = re.compile(r"(?<!!)\[[^\]\n]*\]\(([^)\s]+)\)")
NAMED = re.compile(r"docs/[A-Za-z0-9_./-]+\.md(?:#[a-z0-9-]+)?")
MARK = "@@ block"
#: Hands a command's words, folder and files to a process that has everything imported already.
CLIENT = """#!{python} -IS
import os, socket, sys
link = socket.socket(socket.AF_UNIX)
link.connect({address!r})
said = ["=".join(item) for item in os.environ.items() if item[0].startswith("ROS_")]
words = [os.getcwd(), "\\1".join(said), *sys.argv[1:]]
socket.send_fds(link, ["\\0".join(words).encode()], [0, 1, 2])
sys.exit(int(link.recv(16) or 99))
"""


@dataclass(frozen=True)
class Block:
    """One fenced block that runs, with the lines that it must print."""

    language: str
    body: str
    printed: tuple[str, ...]


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(page: str) -> tuple[Block, ...]:
    found = list(FENCE.finditer(page))
    made = []
    for number, fence in enumerate(found):
        if fence[1] not in {"bash", "python"}:
            continue
        after = found[number + 1] if number + 1 < len(found) else None
        follows = after is not None and page[fence.end() : after.start()].strip() == ""
        told = after[2] if after is not None and follows and after[1] == "text" else ""
        made.append(Block(fence[1], fence[2], tuple(told.splitlines())))
    return tuple(made)


def command(line: str) -> str:
    """Return a line that stops the script unless it ends as the page says."""
    told = EXIT.match(line)
    if told is None:
        return line
    return (
        f"{told['command']} && code=0 || code=$?; "
        f'[ "$code" = {told["code"]} ] || {{ echo "exit $code, not {told["code"]}"; exit 99; }}'
    )


def script(page: tuple[Block, ...]) -> str:
    # what a page leaves running ends with it
    ended = "trap 'jobs -p | xargs -r kill 2>/dev/null || true' EXIT"
    lines = ["set -euo pipefail", "exec 2>&1", ended]
    for number, block in enumerate(page):
        lines.append(f"echo '{MARK} {number}'")
        if block.language == "bash":
            lines += [command(line) for line in block.body.splitlines()]
        else:
            lines.append(f"python - <<'PYTHON'\n{block.body}PYTHON")
    return "\n".join(lines) + "\n"


def run(text: str, folder: Path, *first: Path) -> tuple[int, str]:
    """Run a script beside a copy of the examples, with our own commands first on the path."""
    shutil.copytree(ROOT / "examples", folder / "examples")
    places = (*map(str, first), str(Path(sys.executable).parent), os.environ["PATH"])
    path = os.pathsep.join(places)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("COV")}
    done = subprocess.run(
        ["bash", "-c", text],
        cwd=folder,
        env={**kept, "PATH": path, "TMPDIR": str(folder), "COLUMNS": "100"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.fixture(scope="module")
def commands() -> Iterator[Path]:
    """A folder with an `authguard` that starts at once: a fork of one process with its imports.

    Starting Python for each of a hundred commands would take a minute of imports.
    """
    with TemporaryDirectory(prefix="docs-") as folder:
        address, client = f"{folder}/door", Path(folder) / "authguard"
        client.write_text(CLIENT.format(python=sys.executable, address=address))
        client.chmod(0o755)
        path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        environment = {**os.environ, "PATH": path, "TMPDIR": folder, "COLUMNS": "100"}
        server = subprocess.Popen([sys.executable, __file__, address], env=environment)
        while not Path(address).exists():
            assert server.poll() is None
            time.sleep(0.02)
        yield Path(folder)
        server.terminate()
        server.wait()


def serve(address: str) -> None:
    """Run each command that comes in through the door, in a fork, with the caller's files."""
    from authguard_r.cli import call as authguard

    options_of(program(), "authguard")  # imports every command
    import_module("authguard_r.authoring.compile.units").to_integer("1 m/s", "mm/s", where="warm")
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    door = socket.socket(socket.AF_UNIX)
    door.bind(f"{address}.new")
    door.listen(64)
    Path(f"{address}.new").rename(address)
    while True:
        link, _ = door.accept()
        data, files, _, _ = socket.recv_fds(link, 1 << 16, 3)
        if os.fork() == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            folder, said, *words = data.decode().split("\0")
            os.environ.update(item.split("=", 1) for item in said.split("\1") if item)
            os.chdir(folder)
            for number, file in enumerate(files):
                os.dup2(file, number)
            command = os.fork()  # which may become another program, as `authguard gate` does
            if command == 0:
                link.close()
                code = authguard(words)
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
            threading.Thread(target=end_with, args=(link, command), daemon=True).start()
            _, status = os.waitpid(command, 0)
            link.send(str(os.waitstatus_to_exitcode(status) % 256).encode())
            os._exit(0)
        for file in (*files, link.detach()):
            os.close(file)


def end_with(link: socket.socket, command: int) -> None:
    """End a command when its caller was ended: its end of the link is closed then."""
    link.recv(1)
    with suppress(ProcessLookupError):  # it has ended
        os.kill(command, signal.SIGTERM)


def missing(printed: tuple[str, ...], output: list[str]) -> str | None:
    """Return the first promised line that does not come, in order; None when all do."""
    left = iter(output)
    for line in printed:
        pattern = re.compile(".*".join(re.escape(part) for part in line.rstrip().split("...")))
        if not any(pattern.fullmatch(found.rstrip()) for found in left):
            return line
    return None


def slugs(page: str) -> set[str]:
    """Return the anchors of a page's headings, as hosts of Markdown make them."""
    outside = FENCE.sub("", page)
    heads = re.findall(r"^#{1,6} +(.+?) *$", outside, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def dangling(target: str, base: Path) -> str | None:
    """Return what is wrong with a relative link, None when it leads somewhere."""
    path, _, anchor = target.partition("#")
    place = (base.parent / path).resolve() if path else base
    if not place.exists():
        return f"{relative(base)}: {target}: no such file"
    if anchor and anchor not in slugs(place.read_text(encoding="utf-8")):
        return f"{relative(base)}: {target}: no such heading"
    return None


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_every_command_of_a_page_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path, commands: Path
) -> None:
    found = blocks(page.read_text(encoding="utf-8"))
    assert found, "a page to follow without anything to run"
    code, output = run(script(found), tmp_path, commands)
    assert code == 0, output[-4000:]
    parts = re.split(rf"^{MARK} \d+\n", output, flags=re.MULTILINE)[1:]
    for block, part in zip(found, parts, strict=True):
        assert missing(block.printed, part.splitlines()) is None, part


@pytest.mark.smoke
def test_a_failing_command_and_a_wrong_exit_code_are_seen(tmp_path: Path) -> None:
    wanted = {"true": 0, "false": 1, "false # exit 1": 0, "true # exit 1": 99, "exit 3 # exit 3": 3}
    for number, (line, code) in enumerate(wanted.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        got, _ = run(script((Block("bash", f"{line}\necho end\n", ()),)), folder)
        assert got == code, line
    assert missing(("a...c", "d"), ["x", "abc", "y", "d"]) is None
    assert missing(("d", "a...c"), ["x", "abc", "y", "d"]) == "a...c"


def test_the_installed_command_is_the_one_that_the_pages_run(tmp_path: Path) -> None:
    code, output = run("authguard site check examples/hospital/site.yaml", tmp_path)
    assert (code, output) == (0, "hospital-floor-1: sound, 11 regions, 3 objects\n")


@pytest.mark.smoke
def test_the_page_of_reason_codes_is_the_enumeration() -> None:
    page = (DOCS / "spec" / "reason-codes.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in page.splitlines()
        if line.startswith("| `")
    ]
    told = [(row[0].strip("`"), int(row[1]), row[4]) for row in rows]
    assert told == [(str(r), STEP[r], "yes" if r in RETRYABLE else "no") for r in Reason]
    assert all(row[2] and row[3] for row in rows)


@pytest.mark.smoke
def test_every_relative_link_leads_to_a_file_and_a_heading() -> None:
    found = [
        fault
        for page in WRITTEN
        for target in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8")))
        if not re.match(r"[a-z]+:", target)
        for fault in [dangling(target, page)]
        if fault is not None
    ]
    assert found == []


@pytest.mark.smoke
def test_every_page_that_the_code_names_is_there() -> None:
    found = [
        fault
        for source in sorted([*(ROOT / "src").rglob("*.py"), *(ROOT / "packages").rglob("*.py")])
        for target in NAMED.findall(source.read_text(encoding="utf-8"))
        for fault in [dangling(target, ROOT / "README.md")]
        if fault is not None
    ]
    assert found == []


def options_of(command: Any, name: str) -> dict[str, set[str]]:
    """Return every command of a program with its options, as its help tells them."""
    below = getattr(command, "commands", None)
    if below is None:
        shown = (param.opts for param in command.params if not getattr(param, "hidden", False))
        options = {opt for opts in shown for opt in opts if opt.startswith("--")}
        return {name: options - {"--help", "--json"}}
    return {
        k: v for word, one in below.items() for k, v in options_of(one, f"{name} {word}").items()
    }


@pytest.mark.smoke
def test_the_page_of_commands_names_every_command_with_its_options() -> None:
    page = (DOCS / "reference" / "cli.md").read_text(encoding="utf-8")
    told, _, _ = page.partition("## Not built yet")
    found = options_of(program(), "authguard")
    assert len(found) > 20
    in_one_row = {f"authguard mission {verb}" for verb in ("resume", "revoke", "complete")}
    assert [name for name in sorted(set(found) - in_one_row) if f"`{name}" not in told] == []
    assert [o for options in found.values() for o in options if o not in told] == []
    assert "`missionpair validate`" in told


@pytest.mark.smoke
def test_the_page_of_listeners_is_the_one_struct() -> None:
    import tables  # not above: this file is a program, too

    page = (DOCS / "spec" / "listeners.md").read_text(encoding="utf-8")
    shown = page.split("<!-- listeners -->\n")[1].split("\n<!-- end -->")[0]
    assert shown == tables.listeners()


@pytest.mark.smoke
def test_every_dependency_has_its_line() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = [*project["project"]["dependencies"]]
    for group in project["dependency-groups"].values():
        wanted += group
    names = {re.split(r"[<>=!~\[; ]", line)[0] for line in wanted}
    page = (DOCS / "explanation" / "dependencies.md").read_text(encoding="utf-8")
    told = set(re.findall(r"`([a-z0-9-]+)`", page.split("## ", 1)[1]))
    assert names <= told, names - told


@pytest.mark.smoke
def test_every_decision_page_is_numbered_in_order_and_complete() -> None:
    pages = sorted((DOCS / "adr").glob("*.md"))
    assert [page.name[:4] for page in pages] == [f"{n:04}" for n in range(1, len(pages) + 1)]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text.startswith(f"# {page.name[:4]} ")
        parts = ("**Context.**", "**Decision.**", "**Consequences.**")
        assert [part for part in parts if part not in text] == []


if __name__ == "__main__":
    serve(sys.argv[1])
