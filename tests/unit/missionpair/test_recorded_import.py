# SPDX-License-Identifier: Apache-2.0
"""Recorded runs are read from a source that nobody trusts: all of it, or none, and nowhere else.

How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

import gzip
import io
import json
import os
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fixtures.missionpair_program import told
from missionpair.faults import fault_of
from missionpair.recorded import archive
from missionpair.recorded.agentdojo import RecordedRun, runs_of
from missionpair.recorded.archive import MEMBER_BYTES, SourceError
from missionpair.recorded.folder import import_agentdojo, read_runs, read_source
from missionpair.recorded.office import OfficeCall

NAME = "agentdojo-0.1.24/runs/model-1/slack/user_task_0/none/none.json"


def transcript(**more: Any) -> bytes:
    """Return a run as AgentDojo writes it: one call that worked, and one that failed."""
    called = {"function": "get_webpage", "args": {"url": "www.informations.com"}, "id": "1"}
    failed = {"function": "get_webpage", "args": {"url": 7}, "id": "2"}
    run = {
        "suite_name": "slack",
        "pipeline_name": "model-1",
        "user_task_id": "user_task_0",
        "injection_task_id": None,
        "attack_type": None,
        "injections": {},
        "messages": [
            {"role": "user", "content": "Read it."},
            {"role": "assistant", "content": "", "tool_calls": [called, failed]},
            {"role": "tool", "content": "text", "tool_call": called, "error": None},
            {"role": "tool", "content": "", "tool_call": failed, "error": "no such page"},
        ],
        "error": None,
        "utility": True,
        "security": True,
        "duration": 1.0,
    }
    return json.dumps({**run, **more}).encode()


def archived(path: Path, *files: tuple[str, bytes], change: Any = None) -> Path:
    """Write an archive of these files; `change` takes each member before it is written."""
    with tarfile.open(path, "w:gz") as out:
        for name, data in files:
            member = tarfile.TarInfo(name)
            member.size = len(data)
            out.addfile(member, io.BytesIO(data))
        if change is not None:
            change(out)
    return path


def test_a_run_is_its_calls_without_those_that_failed(tmp_path: Path) -> None:
    source = archived(
        tmp_path / "a.tar.gz", ("agentdojo-0.1.24/README.md", b"x"), (NAME, transcript())
    )
    (run,) = runs_of(source)
    assert run == RecordedRun(
        pipeline="model-1",
        suite="slack",
        task="user_task_0",
        attack="",
        kind="",
        calls=(OfficeCall("get_webpage", {"url": "www.informations.com"}),),
        failed=1,
        landed=False,  # `security` says nothing of a run without an attack
        useful=True,
    )


def test_an_archive_and_a_folder_of_its_contents_hold_the_same_runs(tmp_path: Path) -> None:
    attacked = NAME.replace("none/none", "direct/injection_task_1")
    files = (
        (NAME, transcript()),
        (attacked, transcript(injection_task_id="injection_task_1", attack_type="direct")),
    )
    source = archived(tmp_path / "a.tar.gz", *files)
    for name, data in files:
        path = tmp_path / "there" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    runs = list(runs_of(source))
    assert [(run.kind, run.attack, run.landed) for run in runs] == [
        ("", "", False),
        ("direct", "injection_task_1", True),
    ]
    for folder in (tmp_path / "there", tmp_path / "there" / "agentdojo-0.1.24"):
        found = sorted(runs_of(folder), key=lambda run: run.kind)
        assert found == runs


def link(name: str, kind: bytes, target: str) -> Callable[[tarfile.TarFile], None]:
    def change(out: tarfile.TarFile) -> None:
        member = tarfile.TarInfo(name)
        member.type, member.linkname = kind, target
        out.addfile(member)

    return change


def large(out: tarfile.TarFile) -> None:
    """Add a member whose header says gigabytes, as a bomb's does."""
    member = tarfile.TarInfo(NAME.replace("none.json", "more.json"))
    member.size = 3 << 30
    assert out.fileobj is not None
    out.fileobj.write(member.tobuf())


def long_header(kind: bytes) -> Callable[[tarfile.TarFile], None]:
    """Add a header that says that a name of gigabytes follows, and a part of that name."""

    def add(out: tarfile.TarFile) -> None:
        member = tarfile.TarInfo("a" * 8)
        member.type, member.size = kind, 3 << 30
        assert out.fileobj is not None
        out.fileobj.write(member.tobuf(format=tarfile.GNU_FORMAT) + b"a" * (64 << 20))

    return add


def nested_headers(out: tarfile.TarFile) -> None:
    """Add thousands of headers, each of which says that another one follows."""
    member = tarfile.TarInfo("a")
    member.type, member.size = tarfile.GNUTYPE_LONGNAME, 4
    assert out.fileobj is not None
    block = member.tobuf(format=tarfile.GNU_FORMAT) + b"name".ljust(tarfile.BLOCKSIZE, b"\0")
    out.fileobj.write(block * 5_000)


@pytest.mark.parametrize(
    ("name", "data", "change", "where", "message"),
    [
        ("../outside.json", b"{}", None, "../outside.json", "leads out"),
        ("/etc/outside.json", b"{}", None, "/etc/outside.json", "leads out"),
        ("a/../../b.json", b"{}", None, "a/../../b.json", "leads out"),
        ("a\\..\\b.json", b"{}", None, "b.json", "leads out"),
        ("x", b"", link("runs/link", tarfile.SYMTYPE, "/etc/passwd"), "runs/link", "is a link"),
        ("x", b"", link("runs/link", tarfile.LNKTYPE, NAME), "runs/link", "is a link"),
        ("x", b"", link("runs/pipe", tarfile.FIFOTYPE, ""), "runs/pipe", "is a link or a device"),
        ("x", b"", link("runs/disk", tarfile.BLKTYPE, ""), "runs/disk", "is a link or a device"),
        ("x", b"", large, "more.json", "are allowed"),
        ("x", b"", long_header(tarfile.GNUTYPE_LONGNAME), "a.tar.gz", "at once"),
        ("x", b"", long_header(tarfile.XHDTYPE), "a.tar.gz", "at once"),
        ("x", b"", nested_headers, "a.tar.gz", "ends or breaks here"),
        (NAME, b"{", None, NAME, "is no run of this layout"),
        (NAME, b"\xff\xfe", None, NAME, "is no run of this layout"),
        (NAME, b"[" * 200_000, None, NAME, "is no run of this layout"),
        (NAME, b'{"suite_name": "slack"}', None, NAME, "missing required field"),
        (NAME, transcript(messages="none"), None, NAME, "is no run of this layout"),
        (NAME, transcript(user_task_id="user_task_9"), None, NAME, "its name says `model-1`"),
        (NAME, transcript(attack_type="direct"), None, NAME, "its name says `model-1`"),
        (NAME, transcript(pipeline_name="gpt-4"), None, NAME, "its name says `model-1`"),
        (
            *(NAME.replace("task_0", "task_99"), transcript(user_task_id="user_task_99"), None),
            *("user_task_99", "no mission was written for the task `user_task_99`"),
        ),
        (NAME, transcript(injection_task_id="injection_task_1"), None, NAME, "its name says"),
        ("a/runs/model/slack/more.json", transcript(), None, "more.json", "is no run"),
        ("a/README.md", b"x", None, "a.tar.gz", "holds no `runs` folder"),
    ],
)
def test_a_source_that_is_not_as_it_must_be_is_refused_by_place(
    tmp_path: Path, name: str, data: bytes, change: Any, where: str, message: str
) -> None:
    source = archived(tmp_path / "a.tar.gz", (name, data), change=change)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SourceError) as caught:
        import_agentdojo(source, tmp_path / "out")
    assert where in caught.value.where
    assert message in caught.value.message
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_is_read_once_also_where_two_versions_lie_side_by_side(tmp_path: Path) -> None:
    twice = archived(tmp_path / "a.tar.gz", (NAME, transcript()), (NAME, transcript()))
    other = NAME.replace("0.1.24", "0.1.29")
    beside = archived(tmp_path / "b.tar.gz", (NAME, transcript()), (other, transcript()))
    for source in (twice, beside):
        with pytest.raises(SourceError, match="read before"):
            import_agentdojo(source, tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_a_name_that_is_no_unicode_is_refused(tmp_path: Path) -> None:
    name = NAME.replace("model-1", "model-\udcff")
    packed = archived(tmp_path / "a.tar.gz", (name, transcript()))
    folder = tmp_path / "folder"
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_bytes(transcript())
    for source in (packed, folder):
        with pytest.raises(SourceError, match="no UTF-8") as caught:
            import_agentdojo(source, tmp_path / "out")
        caught.value.where.encode()


def test_an_archive_that_is_packed_twice_is_refused(tmp_path: Path) -> None:
    """The bounds are of one layer: a second one would be unpacked without them."""
    source = archived(tmp_path / "a.tar.gz", (NAME, transcript()))
    source.write_bytes(gzip.compress(source.read_bytes()))
    with pytest.raises(SourceError, match="ends or breaks here"):
        list(runs_of(source))


@pytest.mark.parametrize("cut", [0.0, 0.3, 0.6, 0.95])
def test_an_archive_that_ends_early_is_refused(tmp_path: Path, cut: float) -> None:
    whole = archived(tmp_path / "a.tar.gz", *((f"{NAME}.{n}", os.urandom(2_000)) for n in range(9)))
    data = whole.read_bytes()
    whole.write_bytes(data[: int(len(data) * cut)])
    with pytest.raises(SourceError) as caught:
        import_agentdojo(whole, tmp_path / "out")
    assert str(whole) in caught.value.where
    assert not (tmp_path / "out").exists()


def test_what_is_no_archive_or_is_not_there_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "text.tar.gz"
    text.write_text("not an archive")
    packed = tmp_path / "packed.tar.gz"
    packed.write_bytes(gzip.compress(b"not an archive inside"))
    for source in (text, packed, tmp_path / "nothing"):
        with pytest.raises(SourceError, match=str(source)):
            list(runs_of(source))


def test_a_folder_s_links_are_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret.json"
    secret.write_bytes(transcript())
    path = tmp_path / "source" / NAME
    path.parent.mkdir(parents=True)
    path.symlink_to(secret)
    with pytest.raises(SourceError, match="is a link"):
        list(runs_of(tmp_path / "source"))
    path.unlink()
    outside = tmp_path / "elsewhere"
    outside.mkdir()
    (tmp_path / "source" / "runs").symlink_to(outside)
    with pytest.raises(SourceError, match="is a link"):
        list(runs_of(tmp_path / "source"))


def test_a_file_that_is_too_large_and_files_that_are_too_many_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = archived(tmp_path / "a.tar.gz", (NAME, b" " * (MEMBER_BYTES + 1)))
    with pytest.raises(SourceError, match="are allowed"):
        list(runs_of(source))
    monkeypatch.setattr(archive, "SOURCE_FILES", 2)
    many = archived(tmp_path / "b.tar.gz", *((f"a/{n}", b"") for n in range(3)))
    with pytest.raises(SourceError, match="holds more than 2 files"):
        list(runs_of(many))


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    source = archived(tmp_path / "a.tar.gz", (NAME, transcript()))
    made = import_agentdojo(source, tmp_path / "out")
    assert (made.runs, made.attacked, made.landed, made.pipelines) == (1, 0, 0, ("model-1",))
    assert read_source(tmp_path / "out") == made
    assert list(read_runs(tmp_path / "out")) == list(runs_of(source))


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("source.json", b"{}", "no description of imported runs"),
        ("source.json", None, "make it with `missionpair import agentdojo`"),
        ("runs.jsonl", b"{}\n", "is no recorded run"),
        ("runs.jsonl", b"{}", "ends in the middle of a line"),
        ("runs.jsonl", b"", "has other runs than `source.json` says"),
        ("runs.jsonl", None, "cannot be read"),
    ],
)
def test_a_folder_that_was_changed_is_refused(
    tmp_path: Path, name: str, data: bytes | None, message: str
) -> None:
    source = archived(tmp_path / "a.tar.gz", (NAME, transcript()))
    import_agentdojo(source, tmp_path / "out")
    path = tmp_path / "out" / name
    path.unlink() if data is None else path.write_bytes(data)
    read: Any = read_source if name == "source.json" else lambda folder: list(read_runs(folder))
    with pytest.raises(SourceError, match=message) as caught:
        read(tmp_path / "out")
    assert name in caught.value.where


def test_on_the_command_line_a_broken_source_is_an_error_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = archived(tmp_path / "a.tar.gz", (NAME, b"{"))
    words = ("import", "agentdojo", source, "--out", tmp_path / "out")
    code, said = told(capsys, monkeypatch, *words)
    assert code == 4
    assert said["error"]["code"] == "SOURCE_BROKEN"
    assert said["error"]["where"].endswith(NAME)


def test_a_name_that_writes_on_a_terminal_is_shown_escaped(tmp_path: Path) -> None:
    source = archived(tmp_path / "a.tar.gz", ("a/runs/\x1b[31mX/y", b"{}"))
    with pytest.raises(SourceError) as caught:
        import_agentdojo(source, tmp_path / "out")
    assert "\\x1b[31mX" in fault_of(caught.value).as_text()
    assert "\x1b" not in fault_of(caught.value).as_text()
