# SPDX-License-Identifier: Apache-2.0
"""The outside counter: one signed note, whole or not there, whatever dies while it is written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from authguard_r.anchoring.counter import MAX_BYTES, CounterNote, FileCounter, open_note, seal
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from fixtures import scenarios

GATE = "gate-courier-1"


def counted(**changes: Any) -> CounterNote:
    plain: dict[str, Any] = {
        "robot": scenarios.RID,
        "store": b64(bytes(32)),
        "number": 1,
        "size": 1,
        "head": b64(bytes(32)),
        "time_ms": scenarios.START_MS,
    }
    return CounterNote(**plain | changes)


def note(by: str = GATE, **changes: Any) -> bytes:
    return seal(counted(**changes), folder_signer(scenarios.trust_folder(), by))


def opened(data: bytes) -> CounterNote:
    return open_note(data, verifier=read_trust(scenarios.trust_folder()))


def test_a_note_says_what_was_signed() -> None:
    assert opened(note(number=7)) == counted(number=7)


@pytest.mark.parametrize("by", ["operator-1", "estimator-courier-1", "witness-1"])
def test_nobody_but_a_gate_writes_a_note(by: str) -> None:
    with pytest.raises(AuthenticityError) as refused:
        opened(note(by))
    assert refused.value.reason is Reason.ROLE_DENIED


def test_another_robots_gate_writes_no_note_of_this_one() -> None:
    with pytest.raises(AuthenticityError) as refused:
        opened(note("gate-lifter-1"))
    assert refused.value.reason is Reason.ROBOT_MISMATCH
    assert opened(note("gate-lifter-1", robot=scenarios.OTHER)).robot == scenarios.OTHER


def test_a_note_that_is_changed_torn_or_something_else_is_none() -> None:
    good = note()
    signer = folder_signer(scenarios.trust_folder(), GATE)
    for bad in (
        b"",
        b"{}",
        good[: len(good) // 2],
        good + b"x",
        good.replace(b'"kind":"authguard-r/checkpoint', b'"kind":"authguard-r/gate'),
        sign_object({"log": scenarios.RID, "size": 1}, Tag.CHECKPOINT, signer),
        sign_object(counted(), Tag.GATE, signer),
    ):
        with pytest.raises((MalformedError, AuthenticityError)):
            opened(bad)


def test_a_note_of_long_ago_counts_though_its_certificate_has_ended() -> None:
    """It is judged at its own time; what is before the certificate's begin was never signed so."""
    with pytest.raises(AuthenticityError) as refused:
        opened(note(time_ms=scenarios.START_MS - 10 * 365 * 86_400_000))
    assert refused.value.reason is Reason.CERTIFICATE_EXPIRED


def test_a_counter_gives_back_the_last_note_and_is_the_gates_alone_to_read(tmp_path: Path) -> None:
    counter = FileCounter(tmp_path / "counter")
    assert counter.read() is None
    for said in (b"one", b"two"):
        counter.write(said)
        assert counter.read() == said
    assert counter.path.stat().st_mode & 0o777 == 0o600
    assert [path.name for path in tmp_path.iterdir()] == ["counter"]


@pytest.mark.parametrize("dies_at", ["open", "write", "fsync", "replace"])
def test_a_write_that_dies_before_it_is_in_place_leaves_the_last_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dies_at: str
) -> None:
    counter = FileCounter(tmp_path / "counter")
    counter.write(b"one")
    (tmp_path / "counter.new").write_bytes(b"tw")  # of one that died earlier

    class Died(BaseException):
        pass

    def dies(*_: object, **__: object) -> None:
        raise Died

    with monkeypatch.context() as patch:
        if dies_at == "replace":
            patch.setattr(Path, "replace", dies)
        else:
            patch.setattr(f"authguard_r.anchoring.counter.os.{dies_at}", dies)
        with pytest.raises(Died):
            counter.write(b"two")
    assert counter.read() == b"one"
    counter.write(b"three")
    assert counter.read() == b"three"


def test_bytes_are_on_disk_before_the_name_is_and_the_name_before_it_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    did: list[str] = []
    sync, replace = os.fsync, Path.replace

    def synced(file: int) -> None:
        did.append("folder" if Path(f"/proc/self/fd/{file}").resolve().is_dir() else "file")
        sync(file)

    def replaced(path: Path, to: Path) -> Path:
        did.append("replace")
        return replace(path, to)

    monkeypatch.setattr("authguard_r.anchoring.counter.os.fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    FileCounter(tmp_path / "counter").write(b"one")
    assert did == ["file", "replace", "folder"]


def test_short_writes_are_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(
        "authguard_r.anchoring.counter.os.write", lambda file, data: write(file, data[:3])
    )
    counter = FileCounter(tmp_path / "counter")
    counter.write(b"a longer note")
    assert counter.read() == b"a longer note"


def test_a_folder_that_is_not_there_is_no_new_counter(tmp_path: Path) -> None:
    counter = FileCounter(tmp_path / "mount" / "counter")
    for act in (counter.read, lambda: counter.write(b"one")):
        with pytest.raises(EnvironmentFault) as fault:
            act()
        assert fault.value.reason is Reason.STORE_UNAVAILABLE
        assert fault.value.where == str(counter.path)


def test_what_is_no_file_is_not_read_and_nobody_waits_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    for name in ("pipe", "folder", "loop"):
        with pytest.raises(EnvironmentFault):
            FileCounter(tmp_path / name).read()


def test_a_file_that_cannot_be_read_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counter = FileCounter(tmp_path / "counter")
    counter.write(b"one")

    def fails(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("authguard_r.anchoring.counter.os.pread", fails)
    with pytest.raises(EnvironmentFault, match="Input/output error"):
        counter.read()


def test_a_link_that_was_put_beside_makes_it_write_nowhere_else(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    (tmp_path / "counter.new").symlink_to(victim)
    FileCounter(tmp_path / "counter").write(b"one")
    assert victim.read_bytes() == b"mine"
    assert (tmp_path / "counter").read_bytes() == b"one"


def test_a_huge_file_costs_no_memory(tmp_path: Path) -> None:
    with (tmp_path / "counter").open("wb") as file:
        file.truncate(1 << 40)
    data = FileCounter(tmp_path / "counter").read()
    assert data is not None
    assert len(data) == MAX_BYTES
