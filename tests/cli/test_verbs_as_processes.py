# SPDX-License-Identifier: Apache-2.0
"""Every verb of the installed programs starts, and answers a wrong option with exit code 2.

The verbs are read from the programs, so that a new one is covered by itself. One process starts for
each top-level verb of `authguard`, which imports nothing but what that verb needs; the commands
below it are called in this process.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from authguard_r.cli import call
from authguard_r.cli.app import AUTHGUARD as LISTED
from authguard_r.cli.app import COMMANDS, program
from fixtures.cases import case
from fixtures.gate_process import AUTHGUARD
from missionpair import cli as missionpair

NOTHING = "--no-such-option"


def paths(command: Any, *above: str) -> Iterator[tuple[str, ...]]:
    """Yield the words of every command at and below one."""
    yield above
    for name, below in getattr(command, "commands", {}).items():
        yield from paths(below, *above, name)


def started(*words: object) -> tuple[int, str]:
    """Run a program as a process; return its exit code and all that it says."""
    done = subprocess.run(
        [str(word) for word in words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout


FIRST = [*dict.fromkeys(words.split()[0] for words in COMMANDS)]


def test_the_list_of_commands_says_who_uses_each_of_them() -> None:
    listed = [name for names in LISTED.sections.values() for name in names]
    assert sorted(listed) == sorted(FIRST)
    assert len(list(paths(program()))) > 100


@pytest.mark.parametrize("verb", FIRST)
def test_the_help_of_a_verb_is_told_by_the_installed_program(verb: str) -> None:
    code, said = started(AUTHGUARD, verb, "--help")
    assert (code, "Traceback" in said) == (0, False)
    assert f"Usage: authguard {verb}" in said


def test_every_command_tells_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    for path in paths(program()):
        with case(*path):
            code = call([*path, "--help"])
            said = capsys.readouterr()
            assert (code, said.err) == (0, "")
            assert said.out.strip().startswith(" ".join(["Usage: authguard", *path]))


def test_every_command_refuses_an_option_that_it_does_not_have(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for path in paths(program()):
        with case(*path):
            code = call([*path, NOTHING])
            said = capsys.readouterr()
            assert (code, said.out) == (2, "")
            assert NOTHING in said.err
            assert "Traceback" not in said.err


@pytest.mark.parametrize("words", [(AUTHGUARD,), (AUTHGUARD.with_name("missionpair"),)])
def test_an_option_that_a_program_does_not_have_ends_its_process_with_2(
    words: tuple[object, ...],
) -> None:
    code, said = started(*words, NOTHING)
    assert (code, "Traceback" in said) == (2, False)
    assert NOTHING in said


def test_the_installed_missionpair_tells_its_help() -> None:
    code, said = started(AUTHGUARD.with_name("missionpair"), "--help")
    assert code == 0
    verbs = {words.split()[0] for words in missionpair.COMMANDS}
    assert {verb for verb in verbs if f"  {verb} " not in said} == set()


def test_every_verb_of_missionpair_tells_its_help_and_refuses_an_option_that_it_does_not_have(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in paths(missionpair.program()):
        for option, expected in (("--help", 0), (NOTHING, 2)):
            with case(*path, option):
                monkeypatch.setattr(sys, "argv", ["missionpair", *path, option])
                with pytest.raises(SystemExit) as ended:
                    missionpair.main()
                said = capsys.readouterr()
                assert (ended.value.code or 0) == expected
                assert "Traceback" not in said.out + said.err
                assert " ".join(["missionpair", *path]) in said.out or option in said.err
