# SPDX-License-Identifier: Apache-2.0
"""A folder of imported runs: what was read, from where, and the missions that judge it.

    runs.jsonl           one run a line (`RecordedRun`)
    source.json          the source, its digest, and how many runs it holds
    SUITE/site.json      what the suite's tools can name
    SUITE/binding.json   what each argument means
    SUITE/TASK.token     the task's mission, signed with a key of a demonstration

The missions are there to be read: a replay makes and signs its own, the same ones.

How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from hashlib import file_digest, sha256
from pathlib import Path

import msgspec
from msgspec import Struct

from authguard_r.core.encoding import b64
from missionpair.recorded.agentdojo import RecordedRun, runs_of
from missionpair.recorded.archive import SourceError
from missionpair.recorded.office import Office, read_suite, suite_names
from missionpair.stage import Yard

RUNS_FILE, SOURCE_FILE, FORMAT = "runs.jsonl", "source.json", "missionpair/recorded/1"
#: Longest line of a file of runs, in bytes.
_MAX_LINE = 8 << 20


class ImportedRuns(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What was imported.

    Args:
        format: of this folder.
        name: of the file or folder that was read.
        digest: SHA-256 of the archive, or of every run with its name; base64url.
        lines: SHA-256 of `runs.jsonl`, base64url.
        runs: how many it holds, those whose task is an attack's among them.
        attacked: how many had an attack.
        landed: in how many the attack reached its goal.
        pipelines: every one, sorted.
    """

    format: str
    name: str
    digest: str
    lines: str
    runs: int
    attacked: int
    landed: int
    pipelines: tuple[str, ...]


def import_agentdojo(
    source: Path, out: Path, *, show: Callable[[int], None] = lambda _: None
) -> ImportedRuns:
    """Read a source distribution of AgentDojo, and write its runs and missions to a new folder.

    Args:
        source: the archive, or a folder with its contents.
        out: the new folder; nothing is written anywhere else.
        show: called with the number of runs so far.

    Raises:
        SourceError: the source is broken or of another layout; the folder is taken away again.
        FileExistsError: there is such a folder.
    """
    out.mkdir()
    try:
        found = _write_runs(source, out, show)
        _write_missions(out)
    except BaseException:
        _remove(out)
        raise
    (out / SOURCE_FILE).write_bytes(msgspec.json.encode(found) + b"\n")
    return found


def _write_runs(source: Path, out: Path, show: Callable[[int], None]) -> ImportedRuns:
    count, attacked, landed, pipelines = 0, 0, 0, set[str]()
    written = sha256()
    with (out / RUNS_FILE).open("wb") as file:
        for count, run in enumerate(runs_of(source), 1):
            line = msgspec.json.encode(run) + b"\n"
            file.write(line)
            written.update(line)
            attacked += bool(run.kind)
            landed += run.landed
            pipelines.add(run.pipeline)
            show(count)
    digest = written
    if not source.is_dir():
        with source.open("rb") as archive:
            digest = file_digest(archive, "sha256")
    return ImportedRuns(
        format=FORMAT,
        name=source.name,
        digest=b64(digest.digest()),
        lines=b64(written.digest()),
        runs=count,
        attacked=attacked,
        landed=landed,
        pipelines=tuple(sorted(pipelines)),
    )


def _write_missions(out: Path) -> None:
    with Yard() as yard:
        for name in suite_names():
            office = Office(read_suite(name))
            folder = out / name
            folder.mkdir()
            (folder / "site.json").write_bytes(msgspec.json.encode(office.layout.site) + b"\n")
            (folder / "binding.json").write_bytes(
                msgspec.json.encode(office.layout.binding) + b"\n"
            )
            bench = yard.bench(office.layout)
            for task in office.suite.tasks:
                mission = bench.mission(office.pair(task).missions["v1"])
                (folder / f"{task}.token").write_bytes(bench.sign(mission))


def _remove(folder: Path) -> None:
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()


def read_source(folder: Path) -> ImportedRuns:
    """Return what was imported into a folder.

    Raises:
        SourceError: it is no such folder, or one of another format.
    """
    path = folder / SOURCE_FILE
    try:
        found = msgspec.json.decode(path.read_bytes(), type=ImportedRuns)
    except OSError as error:
        text = f"cannot be read: {error.strerror}; make it with `missionpair import agentdojo`"
        raise SourceError(text, where=str(path)) from error
    except msgspec.DecodeError as error:
        raise SourceError(
            f"is no description of imported runs: {error}", where=str(path)
        ) from error
    if found.format != FORMAT:
        raise SourceError(f"is of the format `{found.format}`, not `{FORMAT}`", where=str(path))
    return found


def read_runs(folder: Path) -> Iterator[RecordedRun]:
    """Yield the runs of a folder.

    Raises:
        SourceError: it cannot be read, a line is no run, or they are not those that were imported.
    """
    path, number, found = folder / RUNS_FILE, 0, sha256()
    expected = read_source(folder).lines
    decoder = msgspec.json.Decoder(RecordedRun)
    try:
        with path.open("rb") as file:
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                if not line.endswith(b"\n"):
                    raise SourceError("ends in the middle of a line", where=f"{path}:{number}")
                found.update(line)
                yield decoder.decode(line)
    except OSError as error:
        raise SourceError(f"cannot be read: {error.strerror}", where=str(path)) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SourceError(f"is no recorded run: {error}", where=f"{path}:{number}") from error
    if b64(found.digest()) != expected:
        text = f"has other runs than `{SOURCE_FILE}` says: import the source again"
        raise SourceError(text, where=str(path))
