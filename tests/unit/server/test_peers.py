# SPDX-License-Identifier: Apache-2.0
"""The kernel says who is there; what a peer sends changes nothing."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from authguard_r.access.gate_config import GateConfig, Peer, default_config
from authguard_r.access.peers import OVERFLOW_UID, client_role, peer_of
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole, Mode

#: Becomes another user, connects, and waits to be hung up on.
OTHER = """
import os, socket, sys
os.setgid(int(sys.argv[2])); os.setuid(int(sys.argv[2]))
link = socket.socket(socket.AF_UNIX)
link.connect(sys.argv[1])
link.recv(1)
"""


def config(*peers: Peer) -> GateConfig:
    return default_config(RobotId("courier-1"), peers, Mode.ENFORCE)


def test_a_pair_of_sockets_names_this_process() -> None:
    one, two = socket.socketpair()
    with one, two:
        for end in (one, two):
            found = peer_of(end)
            assert (found.pid, found.uid, found.gid) == (os.getpid(), os.geteuid(), os.getegid())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_users_process_is_named_by_its_own_number(tmp_path: Path) -> None:
    address = Path("/tmp") / f"authguard-peers-{os.getpid()}-{os.urandom(4).hex()}.sock"
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(address))
        address.chmod(0o666)
        door.listen(1)
        door.settimeout(60)
        process = subprocess.Popen(
            [sys.executable, "-IS", "-c", OTHER, str(address), "54321"], cwd="/"
        )
        try:
            link, _ = door.accept()
            with link:
                found = peer_of(link)
            assert process.wait(60) == 0
        finally:
            process.kill()
            process.wait()
            address.unlink()
    assert (found.pid, found.uid, found.gid) == (process.pid, 54321, 54321)
    with pytest.raises(AuthenticityError):
        client_role(config(Peer(uid=0, roles=(ClientRole.PLANNER,))), 54321, ClientRole.PLANNER)


def test_the_sockets_of_asyncio_are_asked_too(tmp_path: Path) -> None:
    async def ask() -> int:
        found: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def served(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            found.set_result(peer_of(writer.get_extra_info("socket")).uid)
            writer.close()

        server = await asyncio.start_unix_server(served, tmp_path / "s")
        async with server:
            _, writer = await asyncio.open_unix_connection(tmp_path / "s")
            uid = await found
            writer.close()
            await writer.wait_closed()
        return uid

    assert asyncio.run(ask()) == os.geteuid()


@pytest.mark.parametrize("family", [socket.AF_UNIX, socket.AF_INET])
def test_a_socket_that_nobody_is_behind_is_nobodys(family: int) -> None:
    with socket.socket(family) as alone, pytest.raises(AuthenticityError) as refused:
        peer_of(alone)
    assert refused.value.reason is Reason.ROLE_DENIED


def test_what_no_kernel_says_is_nobodys() -> None:
    link = socket.socket(socket.AF_UNIX)
    link.close()
    with pytest.raises(AuthenticityError):
        peer_of(link)


def test_a_user_has_the_roles_of_the_configuration_and_no_other() -> None:
    held = config(
        Peer(uid=7, roles=(ClientRole.PLANNER,)),
        Peer(uid=8, roles=(ClientRole.AUDITOR, ClientRole.OPERATOR)),
    )
    assert client_role(held, 8, ClientRole.OPERATOR) is ClientRole.OPERATOR
    for uid, wanted in ((7, ClientRole.OPERATOR), (9, ClientRole.PLANNER), (0, ClientRole.PLANNER)):
        with pytest.raises(AuthenticityError) as refused:
            client_role(held, uid, wanted)
        assert (refused.value.reason, refused.value.where) == (Reason.ROLE_DENIED, "peer")


def test_everybody_whom_the_machine_does_not_know_is_nobody() -> None:
    held = config(Peer(uid=OVERFLOW_UID, roles=(ClientRole.PLANNER,)))
    with pytest.raises(AuthenticityError):
        client_role(held, OVERFLOW_UID, ClientRole.PLANNER)


def test_no_configuration_makes_a_gate() -> None:
    held = config(Peer(uid=7, roles=(ClientRole.GATE,)))
    with pytest.raises(AuthenticityError):
        client_role(held, 7, ClientRole.GATE)
