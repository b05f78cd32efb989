# SPDX-License-Identifier: Apache-2.0
"""Nonces are used once: by one process, by two, across a crash, and after a restored file."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.frost import signing
from authguard_r.frost.messages import NonceCommitment, digest, written
from authguard_r.frost.nonces import NonceStore
from fixtures.threshold_groups import dealt

SHARE = dealt(2, 3).shares[0]
#: Takes the nonces and dies before anything is signed with them.
CRASH = """
import os, sys
from pathlib import Path
from authguard_r.frost.messages import NonceCommitment, read
from authguard_r.frost.nonces import NonceStore
folder, data = Path(sys.argv[1]), Path(sys.argv[2]).read_bytes()
NonceStore(folder).take(read(data, NonceCommitment, where="c"))
os.kill(os.getpid(), 9)
"""


def kept(folder: Path) -> NonceCommitment:
    return NonceStore(folder).put(signing.new_nonces(SHARE))


def test_nonces_are_given_once_and_are_gone_from_the_disk(tmp_path: Path) -> None:
    folder = tmp_path / "nonces"
    made = signing.new_nonces(SHARE)
    commitment = NonceStore(folder).put(made)
    held = folder / f"{digest(commitment)}.nonces"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE(held.stat().st_mode) == 0o600
    assert NonceStore(folder).take(commitment) == made
    assert not held.exists()
    assert all(made.hiding.encode() not in p.read_bytes() for p in folder.iterdir())


def test_used_nonces_are_refused_after_a_restart(tmp_path: Path) -> None:
    commitment = kept(tmp_path / "n")
    NonceStore(tmp_path / "n").take(commitment)
    for _ in range(2):
        with pytest.raises(RefusedError, match="never signed with") as caught:
            NonceStore(tmp_path / "n").take(commitment)
        assert caught.value.reason is Reason.KEY_REUSED


def test_unknown_nonces_are_refused(tmp_path: Path) -> None:
    elsewhere = signing.new_nonces(SHARE).commitment
    with pytest.raises(RefusedError, match="made here") as caught:
        NonceStore(tmp_path / "n").take(elsewhere)
    assert caught.value.reason is Reason.KEY_INVALID
    assert list((tmp_path / "n").iterdir()) == []


def test_nonces_that_a_killed_process_took_are_never_given_again(tmp_path: Path) -> None:
    folder, file = tmp_path / "n", tmp_path / "commitment.json"
    commitment = kept(folder)
    file.write_bytes(written(commitment))
    done = subprocess.run([sys.executable, "-c", CRASH, str(folder), str(file)], check=False)
    assert done.returncode == -9
    with pytest.raises(RefusedError, match="never signed with"):
        NonceStore(folder).take(commitment)


def test_a_crash_between_the_mark_and_the_reading_spends_the_nonces(tmp_path: Path) -> None:
    """Also what a restored file meets: the mark of its use is still there."""
    folder = tmp_path / "n"
    commitment = kept(folder)
    held = folder / f"{digest(commitment)}.nonces"
    copy = held.read_bytes()
    NonceStore(folder).take(commitment)
    held.write_bytes(copy)
    with pytest.raises(RefusedError, match="never signed with"):
        NonceStore(folder).take(commitment)


def test_of_many_processes_one_gets_the_nonces(tmp_path: Path) -> None:
    folder, file = tmp_path / "n", tmp_path / "commitment.json"
    file.write_bytes(written(kept(folder)))
    racing = CRASH.replace("os.kill(os.getpid(), 9)", "print('mine')")
    command = [sys.executable, "-c", racing, str(folder), str(file)]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for _ in range(4)
    ]
    said = [process.communicate()[0] for process in started]
    assert sorted(said) == ["", "", "", "mine\n"]


def test_who_comes_second_between_look_and_mark_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "n"
    commitment = kept(folder)
    opened = os.open

    def late(path: object, flags: int, *mode: int) -> int:
        if str(path).endswith(".used"):
            os.close(opened(path, flags, *mode))  # type: ignore[arg-type]
        return opened(path, flags, *mode)  # type: ignore[arg-type]

    monkeypatch.setattr("authguard_r.frost.nonces.os.open", late)
    with pytest.raises(RefusedError, match="never signed with"):
        NonceStore(folder).take(commitment)


def test_nothing_is_read_when_the_use_cannot_be_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "n"
    commitment = kept(folder)
    opened = os.open

    def full(path: object, flags: int, *mode: int) -> int:
        if str(path).endswith(".used"):
            raise OSError(28, "No space left on device")
        return opened(path, flags, *mode)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr("authguard_r.frost.nonces.os.open", full)
        with pytest.raises(StoreError, match="No space"):
            NonceStore(folder).take(commitment)
    assert NonceStore(folder).take(commitment).commitment == commitment


def test_nonces_that_vanish_under_the_hand_are_a_fault_and_spent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "n"
    commitment = kept(folder)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda _: (_ for _ in ()).throw(OSError(5, "I/O error")))
        with pytest.raises(StoreError, match="I/O error"):
            NonceStore(folder).take(commitment)
    with pytest.raises(RefusedError, match="never signed with"):
        NonceStore(folder).take(commitment)


def test_a_folder_that_others_can_reach_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "n"
    folder.mkdir()
    folder.chmod(0o755)
    with pytest.raises(StoreError, match="its owner's alone"):
        NonceStore(folder)
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot use"):
        NonceStore(tmp_path / "file")


def test_two_commitments_of_one_member_are_two(tmp_path: Path) -> None:
    folder = tmp_path / "n"
    first, second = kept(folder), kept(folder)
    assert first != second
    taken = NonceStore(folder).take(first)
    assert taken.commitment == first
    assert NonceStore(folder).take(second).commitment == second
    store, again = NonceStore(folder), signing.new_nonces(SHARE)
    store.put(again)
    with pytest.raises(StoreError, match="cannot use"):
        store.put(again)
