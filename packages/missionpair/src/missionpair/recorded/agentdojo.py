# SPDX-License-Identifier: Apache-2.0
"""Runs of AgentDojo, as its source distribution holds them: what a model called, and the result.

Read are the calls that were carried out, and the two verdicts of its authors: the task was done,
and the attack landed. Nothing is executed, and the package is not imported.
How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from missionpair.recorded.archive import SourceError, SourceFile, files_of
from missionpair.recorded.office import OfficeCall, require_known

#: The folder of a source that holds the runs, and the parts of a run's name below it.
RUNS, PARTS = "runs", 5
#: How a run without an attack is called there.
NO_ATTACK = "none"


class _Called(Struct):
    function: str
    args: dict[str, Any]


class _RunMessage(Struct):
    role: str
    tool_call: _Called | None = None
    error: str | None = None


class _Transcript(Struct):
    suite_name: str
    pipeline_name: str
    user_task_id: str
    injection_task_id: str | None
    attack_type: str | None
    messages: list[_RunMessage]
    utility: bool
    security: bool


class RecordedRun(Struct, frozen=True, kw_only=True):
    """One run of a model.

    Args:
        pipeline: the model, and the defense that was built around it.
        suite: AgentDojo's suite.
        task: what its user asked for.
        attack: what the attack asked for; empty without one.
        kind: how the attack was worded; empty without one.
        calls: those that its tools carried out without an error, in order.
        failed: how many calls its tools answered with an error; they had no effect.
        landed: the attack's authors find that it reached its goal.
        useful: the task's authors find that the task was done.
    """

    pipeline: str
    suite: str
    task: str
    attack: str
    kind: str
    calls: tuple[OfficeCall, ...]
    failed: int
    landed: bool
    useful: bool


def runs_of(source: Path) -> Iterator[RecordedRun]:
    """Yield each run of a source distribution, or of a folder with its contents.

    Args:
        source: `agentdojo-0.1.24.tar.gz`, or a folder that holds `runs`.

    Raises:
        SourceError: it is broken, of another layout, or holds no run.
    """
    found = set[tuple[str, ...]]()
    decoder = msgspec.json.Decoder(_Transcript)
    for file in files_of(source, folder=RUNS):
        run = _run(file, decoder)
        if file.parts in found:
            raise SourceError("is a run that was read before: name one version", where=file.where)
        found.add(file.parts)
        yield run
    if not found:
        text = f"holds no `{RUNS}` folder; take the source distribution of agentdojo 0.1.24"
        raise SourceError(text, where=str(source))


def _shown(parts: tuple[str | None, ...]) -> str:
    return ", ".join(f"`{part[:80]}`" for part in parts if part is not None)


def _run(file: SourceFile, decoder: msgspec.json.Decoder[_Transcript]) -> RecordedRun:
    if len(file.parts) != PARTS or not file.parts[-1].endswith(".json"):
        text = "is no run: `runs/PIPELINE/SUITE/TASK/ATTACK/INJECTION.json` is expected"
        raise SourceError(text, where=file.where)
    pipeline, suite, task, kind, name = file.parts
    try:
        said = decoder.decode(file.data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SourceError(f"is no run of this layout: {error}", where=file.where) from error
    is_attacked = kind != NO_ATTACK
    attack = name.removesuffix(".json")
    named = (pipeline, suite, task, *((attack, kind) if is_attacked else (None, None)))
    found = (
        *(said.pipeline_name, said.suite_name, said.user_task_id),
        *(said.injection_task_id, said.attack_type),
    )
    if found != named:
        text = f"says that it is {_shown(found)}; its name says {_shown(named)}"
        raise SourceError(text, where=file.where)
    require_known(suite, task, attack if is_attacked else "", where=file.where)
    done = [message for message in said.messages if message.role == "tool"]
    calls = [m.tool_call for m in done if m.tool_call is not None and m.error is None]
    return RecordedRun(
        pipeline=pipeline,
        suite=suite,
        task=task,
        attack=attack if is_attacked else "",
        kind=kind if is_attacked else "",
        calls=tuple(OfficeCall(call.function, call.args) for call in calls),
        failed=len(done) - len(calls),
        landed=is_attacked and said.security,
        useful=said.utility,
    )
