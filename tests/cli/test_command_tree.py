# SPDX-License-Identifier: Apache-2.0
"""The command line shows itself: lists, help, version, completion, and names of before."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from authguard_r.cli.app import AUTHGUARD, COMMANDS, GROUPS
from authguard_r.operations.command_tree import LINE, with_new_names
from fixtures.commands import ended
from fixtures.gate_process import AUTHGUARD as PROGRAM

#: A command line that has a hint, and what it is now.
RENAMED = {**AUTHGUARD.renamed}


@pytest.mark.parametrize("words", ["", *GROUPS])
def test_a_group_without_arguments_prints_its_help(words: str) -> None:
    alone, helped, short = (ended(*words.split(), *more) for more in ((), ("--help",), ("-h",)))
    assert alone == helped == short
    assert (alone.code, alone.err) == (0, "")
    assert alone.out.startswith(f"Usage: {' '.join(['authguard', *words.split()])} ")
    listed = {line.split()[0] for line in alone.out.splitlines() if line.startswith("  ")}
    below = len(words.split())
    names = {c.split()[below] for c in COMMANDS if c.split()[:below] == words.split()}
    assert names <= listed


def test_every_line_of_a_list_fits_a_terminal_of_80_columns() -> None:
    lines = {**GROUPS, **{words: entry.help for words, entry in COMMANDS.items()}}
    assert [words for words, line in lines.items() if not 0 < len(line) <= LINE] == []
    for words in ("", *GROUPS):
        usage, *shown = ended(*words.split()).out.splitlines()
        assert [line for line in (usage, *shown) if len(line) > 80] == []
        assert [line for line in shown if line.endswith("...")] == []
        known = set(lines.values())
        found = (re.fullmatch(r"  \S+ {2,}(.+)", line) for line in shown)
        rows = [row for row in found if row is not None and row[1] in known]
        size = len(words.split())
        names = {c.split()[size] for c in COMMANDS if c.split()[:size] == words.split()}
        assert len(rows) == len(names)  # none is wrapped


def test_the_version_is_the_installed_one() -> None:
    from importlib.metadata import version

    assert ended("--version") == (0, f"authguard {version('authguard-r')}\n", "")


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_name_works_and_names_the_new_one(old: str) -> None:
    before, now = ended(*old.split(), "-h"), ended(*RENAMED[old].split(), "-h")
    assert (before.code, before.out) == (0, now.out)
    assert before.err.startswith(f"`authguard {old}` is now `authguard {RENAMED[old]}`")
    assert now.err == ""


def test_an_old_option_is_read_as_the_new_one_in_its_own_command_alone() -> None:
    program = AUTHGUARD._replace(renamed_options={"stop": {"--why": "--reason"}})
    read, hints = with_new_names(program, ["stop", "--why", "x", "--why=y"])
    assert read == ["stop", "--reason", "x", "--reason=y"]
    assert len(hints) == 2
    other = ["mission", "stop", "--why", "x"]
    assert with_new_names(program, other) == (other, [])


def test_old_words_inside_a_command_line_stay() -> None:
    line = ["mission", "draft", "frost", "--site", "revocations"]
    assert with_new_names(AUTHGUARD, line) == (line, [])


def test_a_shell_completes_commands_from_the_table() -> None:
    line = ["bash", "-c", f"{PROGRAM} --show-completion; true"]
    assert "_AUTHGUARD_COMPLETE=complete_bash" in subprocess.check_output(line, text=True)
    told = {"COMP_WORDS": "authguard mission ver", "COMP_CWORD": "2"}
    done = subprocess.run(
        [PROGRAM],
        env={**os.environ, **told, "_AUTHGUARD_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout.split(), done.stderr) == (["verify"], "")


def shown_at_terminal(*words: str, **more: str) -> str:
    """Return what `authguard` prints at a terminal, `mission` where no words are given."""
    outer, inner = pty.openpty()
    kept = {k: v for k, v in os.environ.items() if k not in {"NO_COLOR", "TERM", *more}}
    child = subprocess.Popen(
        [PROGRAM, *(words or ("mission",))],
        stdout=inner,
        stderr=inner,
        env={**kept, "TERM": "xterm", **more},
    )
    os.close(inner)
    child.wait(timeout=60)
    shown = b""
    try:
        while part := os.read(outer, 4096):
            shown += part
    except OSError:  # the other end of the terminal is closed
        pass
    os.close(outer)
    return shown.decode().replace("\r\n", "\n")


def test_help_has_colors_on_a_terminal_unless_they_are_unwanted() -> None:
    plain = ended("mission").out
    colors = shown_at_terminal()
    assert "\x1b[" in colors
    assert "\x1b[" not in plain
    assert shown_at_terminal(NO_COLOR="1") == shown_at_terminal(TERM="dumb") == plain


def test_the_code_of_an_error_has_a_color_on_a_terminal_unless_it_is_unwanted() -> None:
    wrong = ("site", "check", "gone.yaml")
    assert shown_at_terminal(*wrong).startswith("\x1b[1;31mFILE_UNAVAILABLE\x1b[0m: cannot read ")
    assert shown_at_terminal(*wrong, NO_COLOR="1").startswith("FILE_UNAVAILABLE: cannot read ")


def test_a_command_line_imports_its_own_command_alone() -> None:
    text = (
        "import sys; from authguard_r.cli import call; call(sys.argv[1:]); "
        "print(*(m for m in sys.modules if m.startswith('authguard_r.cli.')), "
        "'pydantic' in sys.modules)"
    )
    for words, own in (("", set()), ("mission", set()), ("mission choose -h", {"orders"})):
        done = subprocess.run(
            [sys.executable, "-c", text, *words.split()], capture_output=True, text=True, check=True
        )
        *found, has_parser = done.stdout.splitlines()[-1].split()
        commands = {Path(entry.place.partition(":")[0]).name for entry in COMMANDS.values()}
        loaded = {name.rpartition(".")[2] for name in found} & commands
        assert own <= loaded <= own | {"mission", "sign", "operate"}
        assert has_parser == "False"


def test_a_missing_option_names_every_other_that_is_missing() -> None:
    line = ("run", "--token", "x", "--site=s")
    assert ended(*line).err.startswith("USAGE: Missing option '--trust'")
    assert "Also missing: --binding, --plan" in ended(*line).err
    assert "Also" not in ended(*line, "--trust", "t", "--binding", "b").err
