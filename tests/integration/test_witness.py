# SPDX-License-Identifier: Apache-2.0
"""A witness as a process: crowds, half requests, kills, full disks; it never contradicts itself."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import random
import signal
import socket
import subprocess
import threading
from pathlib import Path

import pytest

from authguard_r.audit.note import read_key
from authguard_r.keys.algorithms import Algorithm
from authguard_r.witness.state import read_folder, read_log
from fixtures.witness_process import (
    ORIGIN,
    SOON_S,
    Log,
    Served,
    attested,
    command,
    journal,
    make,
    post,
    request,
    served,
)

#: No file of the process grows beyond this many bytes: a disk that is full for all but small files.
FULL = (
    "import os, resource; os.dup2(os.open('/dev/null', os.O_WRONLY), 2)\n"
    "resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))"
)
ROUNDS = int(os.environ.get("AUTHGUARD_WITNESS_KILLS", "4"))


@pytest.fixture
def log() -> Log:
    return Log().grow(64)


@pytest.fixture
def folder(tmp_path: Path, log: Log) -> Path:
    return make(tmp_path / "w", log)


def known(folder: Path) -> int:
    return read_log(read_folder(folder).logs[ORIGIN]).size


@pytest.mark.smoke
@pytest.mark.parametrize("algorithm", [Algorithm.ED25519, Algorithm.ML_DSA_44])
@pytest.mark.parametrize("hybrid", [False, True])
def test_a_log_and_its_witness_over_http(
    tmp_path: Path, algorithm: Algorithm, hybrid: bool
) -> None:
    log = Log(Algorithm.ED25519, *([Algorithm.ML_DSA_65] if hybrid else [])).grow(64)
    folder = make(tmp_path / "w", log, algorithm=algorithm)
    with served(folder) as found:
        key = read_key(str(found.ready["key"]), where="key")
        link = found.link()
        for old, size in ((0, 3), (3, 64)):
            status, body, kind = post(link, log.ask(old, size))
            assert (status, kind) == (200, "text/plain; charset=utf-8")
            assert attested(log, body, key, size).key == key
        assert post(link, log.ask(3)) == (409, b"64\n", "text/x.tlog.size")
        assert post(link, log.fork(9).grow(55).ask(64))[::2] == (409, "text/plain; charset=utf-8")
        assert post(link, request(64, (), log.fork(9).grow(56).note()))[0] == 422
        assert post(link, Log().grow(70).ask(64))[0] == 403
        assert post(link, Log(origin="x").grow(1).ask(0))[0] == 404
        assert post(link, b"old 1\n")[0] == 400
        link.close()
        found.child.send_signal(signal.SIGTERM)
        assert found.child.wait(SOON_S) == 0
    events = [line["event"] for line in journal(folder)]
    assert events[:2] == ["cosigned", "cosigned"]
    assert set(events) >= {"stale", "forked", "unproven", "unsigned", "unknown", "malformed"}


def test_a_crowd_of_silent_and_half_requests_keeps_nobody_waiting(folder: Path, log: Log) -> None:
    with served(folder) as found:
        lines = []
        for number in range(200):
            line = socket.create_connection((found.host, found.port), timeout=SOON_S)
            sent = (b"", b"P", b"POST /add-checkpoint HTTP/1.1\r\nContent-Length: 30\r\n\r\nold")
            line.sendall(sent[number % 3])
            lines.append(line)
        assert found.post(log.ask(0))[0] == 200
        for line in lines:
            line.close()
        assert found.post(log.ask(64, 64))[0] == 200
        assert found.child.poll() is None


def test_200_at_once_are_all_answered_and_one_of_those_that_contradict_wins(
    folder: Path, log: Log
) -> None:
    forks = [log.fork(9, bytes([n + 1])).grow(55) for n in range(5)]
    bodies = [fork.ask(0) for fork in forks]
    with served(folder) as found:
        links = [found.link() for _ in range(200)]
        for number, link in enumerate(links):
            link.request("POST", "/add-checkpoint", bodies[number % 5])
        statuses = []
        for link in links:
            got = link.getresponse()
            statuses.append((got.status, got.read()))
            link.close()
    assert [status for status, _ in statuses].count(200) == 1
    assert {body for status, body in statuses if status == 409} == {b"64\n"}
    assert len(statuses) == 200


@pytest.mark.parametrize("seed", range(3))
def test_garbage_is_answered_or_ended_and_never_a_traceback(
    folder: Path, log: Log, seed: int
) -> None:
    dice = random.Random(seed)
    body = log.ask(0)
    good = b"POST /add-checkpoint HTTP/1.1\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body)
    with served(folder) as found:
        for _ in range(60):
            sent = bytearray(good)
            for _ in range(dice.randrange(1, 8)):
                place = dice.randrange(len(sent))
                sent[place : place + dice.randrange(3)] = dice.randbytes(dice.randrange(3))
            with socket.create_connection((found.host, found.port), timeout=SOON_S) as line:
                line.sendall(bytes(sent))
                line.shutdown(socket.SHUT_WR)
                told = b""
                while part := line.recv(1 << 16):
                    told += part
            assert not told or told.startswith(b"HTTP/1.1 "), told
        for huge in (b"x" * (1 << 22), b"old 0\n\n" + b"y" * (1 << 22)):
            # or it is ended while it still sends
            with contextlib.suppress(ConnectionError, http.client.HTTPException):
                assert found.post(huge)[0] == 413
        assert found.post(log.ask(known(folder)))[0] == 200
    assert {line["event"] for line in journal(folder)} >= {"cosigned", "refused"}


def test_wrong_methods_and_paths_are_told(folder: Path) -> None:
    with served(folder) as found:
        link = found.link()
        for method, path, status in (
            ("GET", "/", 404),
            ("GET", "/add-checkpoint", 405),
            ("DELETE", "/add-checkpoint", 405),
            ("POST", "/sign-subtree", 404),
            ("POST", "/../add-checkpoint", 404),
        ):
            link.request(method, path)
            got = link.getresponse()
            assert (got.status, bool(got.read())) == (status, True)
        link.close()


# kills


def ask_on(found: Served, logs: list[Log], signed: list[tuple[int, bytes]]) -> None:
    """Ask for ever longer checkpoints until the witness is gone; note what was cosigned."""
    link = found.link()
    try:
        old = int(post(link, logs[0].ask(0, 1))[1] or 0) if signed else 0
        while True:
            for log in logs:
                size = min(old + 1, log.size)
                status, body, _ = post(link, log.ask(old, size))
                if status == 200:
                    signed.append((size, log.root(size)))
                    old = size
                elif status == 409:
                    old = int(body) if body.strip().isdigit() else old
    except (OSError, http.client.HTTPException):
        pass
    finally:
        link.close()


def test_what_was_cosigned_is_known_after_every_kill(tmp_path: Path) -> None:
    log = Log().grow(2_000)
    folder = make(tmp_path / "w", log)
    dice = random.Random(11)
    signed: list[tuple[int, bytes]] = []
    for _ in range(ROUNDS):
        with served(folder) as found:
            before = len(signed)
            asking = threading.Thread(target=ask_on, args=(found, [log], signed))
            asking.start()
            wanted = before + dice.randrange(1, 40)
            while len(signed) < wanted and asking.is_alive():
                threading.Event().wait(0.001)
            found.child.kill()  # between two requests, or in one
            asking.join(SOON_S)
            assert not asking.is_alive()
            assert len(signed) >= wanted
        # at least what was answered, and at most the one that was not
        assert signed[-1][0] <= known(folder) <= signed[-1][0] + 1
        sizes = [size for size, _ in signed]
        assert sizes == sorted(sizes)
    with served(folder) as found:
        fork = log.fork(0).grow(2_000)
        for size in (1, known(folder), 2_000):
            assert found.post(fork.ask(known(folder) if size == 2_000 else 0, size))[0] in {
                409,
                422,
            }


def test_a_kill_before_the_rename_leaves_what_was_there(folder: Path, log: Log) -> None:
    """The machine's own words: the process dies at a call that it would have made next."""
    for call in ("os.fsync", "pathlib.Path.replace"):
        first = (
            "import os, pathlib, threading\n"
            f"real = {call}\n"
            "def die(*words):\n"
            "    if pathlib.Path(os.environ['DIE']).exists(): os.kill(os.getpid(), 9)\n"
            "    return real(*words)\n"
            f"{call} = die\n"
        )
        os.environ["DIE"] = str(folder.parent / "die")
        try:
            before = known(folder)
            with served(folder, first=first) as found:
                (folder.parent / "die").touch()
                with pytest.raises((OSError, http.client.HTTPException)):
                    found.post(log.ask(before, before + 1))
            (folder.parent / "die").unlink()
        finally:
            del os.environ["DIE"]
        assert known(folder) == before
        with served(folder) as found:  # what lies beside is in nobody's way
            assert found.post(log.ask(before, before + 1))[0] == 200


# the disk


def test_on_a_full_disk_nothing_is_signed_and_the_rest_is_answered(folder: Path, log: Log) -> None:
    with served(folder) as found:
        assert found.post(log.ask(0, 10))[0] == 200
    with served(folder, first=FULL.format(400)) as found:
        for _ in range(2):
            status, body, _ = found.post(log.ask(10))
            assert (status, b"cannot be written down" in body) == (503, True)
        assert found.post(log.ask(9))[:2] == (409, b"10\n")
        assert found.post(b"")[0] == 400
    assert known(folder) == 10
    with served(folder) as found:
        assert found.post(log.ask(10))[0] == 200


def start(folder: Path, *words: str, first: str = "") -> tuple[int, dict[str, str]]:
    """Return how a start ends that is refused."""
    done = subprocess.run(
        command(folder, *words, first=first),
        capture_output=True,
        text=True,
        timeout=SOON_S,
        check=False,
    )
    assert "Traceback" not in done.stderr
    return done.returncode, json.loads(done.stdout)["error"]


def test_it_does_not_start_where_it_cannot_write(folder: Path) -> None:
    code, error = start(folder, first=FULL.format(0))
    assert (code, error["code"]) == (5, "FILE_UNAVAILABLE")
    assert known(folder) == 0


def test_a_disk_that_becomes_read_only_signs_nothing(tmp_path: Path, log: Log) -> None:
    disk = tmp_path / "disk"
    disk.mkdir(mode=0o700)
    if os.system(f"mount -t tmpfs -o size=8m,mode=0700 tmpfs {disk} 2>/dev/null") != 0:
        pytest.skip("needs the right to mount")
    try:
        folder = make(disk, log)
        with served(folder) as found:
            assert found.post(log.ask(0, 10))[0] == 200
            assert os.system(f"mount -o remount,ro {disk}") == 0
            assert found.post(log.ask(10))[0] == 503
            assert found.post(log.ask(9))[0] == 409
        assert start(folder)[0] == 5
        assert known(folder) == 10
    finally:
        os.system(f"umount {disk}")


def test_one_folder_has_one_witness(folder: Path, log: Log) -> None:
    with served(folder) as found:
        code, error = start(folder)
        assert (code, "another process" in error["message"]) == (5, True)
        assert found.post(log.ask(0))[0] == 200


def test_it_does_not_listen_in_the_clear(folder: Path) -> None:
    code, error = start(folder, "--listen", "0.0.0.0:0")
    assert (code, "TLS" in error["message"]) == (4, True)
    with served(folder, "--listen", "0.0.0.0:0", "--behind-tls") as found:
        assert found.host == "0.0.0.0"


def test_an_operator_looks_and_forgets_while_files_say_the_same(folder: Path, log: Log) -> None:
    with served(folder) as found:
        assert found.post(log.ask(0, 10))[0] == 200
        words = ["show", str(folder), "--json"]
        shown = command(folder)[:3]
        done = subprocess.run([*shown, "witness", *words], capture_output=True, check=True)
        told = json.loads(done.stdout)
        assert [(one["origin"], one["size"]) for one in told["logs"]] == [(ORIGIN, 10)]
