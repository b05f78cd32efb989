# SPDX-License-Identifier: Apache-2.0
"""Asking a person at the terminal what only a person can say."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated, TypeVar

import typer

from authguard_r.core.errors import ClarificationError, MalformedError, shown
from authguard_r.wire.output import printed

T = TypeVar("T")
AnswerOption = Annotated[
    list[str] | None,
    typer.Option("--answer", help="FIELD=VALUE answers a question; repeatable."),
]
NoInputFlag = Annotated[
    bool, typer.Option("--no-input", help="Never ask at the terminal; exit 3 instead.")
]


def may_ask(*, as_json: bool, no_input: bool) -> bool:
    """True when there is a person at standard input who may be asked."""
    return not as_json and not no_input and sys.stdin.isatty()


def confirm_shown(lines: list[str], question: str, *, as_json: bool) -> bool:
    """Return, once the lines were shown and the answer was yes, whether a person gave it.

    A `y` that comes through a pipe was written by a script, not by a person.

    Raises:
        typer.Abort: no, or standard input ended.
    """
    for line in lines:
        typer.echo(printed(line), err=as_json)
    typer.confirm(question, abort=True, err=as_json)
    return sys.stdin.isatty()


def ask_until(job: Callable[[dict[str, object]], T], answers: dict[str, object]) -> T:
    """Return what the job makes of the answers, asking until no question is open.

    An answer given here that turns out not to be possible is reported and asked for again.

    Args:
        job: takes answers by field; raises `ClarificationError` while questions are open.
        answers: what was answered beforehand.

    Raises:
        typer.Abort: standard input ended.
        MalformedError: the draft itself, or an answer given beforehand, is refused.
    """
    said: dict[str, object] = {}
    while True:
        try:
            return job({**answers, **said})
        except ClarificationError as error:
            for asked in (error, *error.others):
                said[asked.field] = prompt(asked)
        except MalformedError as error:
            place = error.where.removeprefix("draft:")
            wrong = [field for field in said if place.startswith(field)]
            if not wrong:
                raise
            typer.echo(shown(f"{error.message} (at {place})"), err=True)
            for field in wrong:
                del said[field]


def prompt(asked: ClarificationError) -> object:
    """Return a person's answer; a number takes the candidate that it stands before.

    Raises:
        typer.Abort: standard input ended.
    """
    from authguard_r.authoring.compile.answers import read_answer

    typer.echo(shown(f"{asked.question} ({asked.field})"), err=True)
    for number, candidate in enumerate(asked.candidates, 1):
        typer.echo(shown(f"  {number}) {candidate}"), err=True)
    while True:
        typer.echo("> ", nl=False, err=True)
        line = sys.stdin.readline()
        if not line:
            raise typer.Abort
        text = line.strip()
        if not text:
            continue  # silence is no answer
        if text.isascii() and text.isdigit() and 1 <= int(text) <= len(asked.candidates):
            text = asked.candidates[int(text) - 1]
        try:
            return read_answer(text, where=asked.field)
        except MalformedError as error:
            typer.echo(error.message, err=True)
