# SPDX-License-Identifier: Apache-2.0
"""Who is at the other end of a Unix socket, and what they may be here.

The kernel says it, as of the moment in which the peer connected (`SO_PEERCRED`); nothing that the
peer sends changes it. A role lets a client ask; what is granted, a mission says.
Spec page: docs/spec/gate-protocol.md#configuration
"""

from __future__ import annotations

import socket
import struct
from typing import Protocol

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig, roles_of
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole

#: `struct ucred`: process, user, group.
_UCRED = struct.Struct("iII")
#: Peer credentials that the kernel reports for an unconnected socket.
_NO_USER = 0xFFFF_FFFF
#: What the kernel says for every user of another user namespace that has no number here.
OVERFLOW_UID = 65_534


class Socket(Protocol):
    """A socket as far as it is asked who is at its other end; asyncio's own kind too."""

    def getsockopt(self, level: int, optname: int, buflen: int, /) -> bytes:
        """Return an option's bytes."""
        ...


class PeerCredentials(Struct, frozen=True, kw_only=True):
    """Whose process connected.

    Args:
        pid: its number when it connected; 0 for one in another process namespace. It may have
            ended since and the number be another's, so it is for the log and decides nothing.
        uid: its effective user.
        gid: its effective group.
    """

    pid: int
    uid: int
    gid: int


def peer_of(sock: Socket) -> PeerCredentials:
    """Return the credentials of a connected Unix socket's other end.

    Raises:
        AuthenticityError: the kernel says none: not a Unix socket, or not connected.
    """
    try:
        data = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    except OSError as error:
        raise _denied(f"the kernel does not name the peer: {error.strerror}") from error
    pid, uid, gid = _UCRED.unpack(data)
    if uid == _NO_USER:
        raise _denied("the kernel names no peer process")
    return PeerCredentials(pid=pid, uid=uid, gid=gid)


def client_role(config: GateConfig, uid: int, wanted: ClientRole) -> ClientRole:
    """Return the role if the user may take it; no configuration grants the gate's role.

    Args:
        config: the signed configuration.
        uid: from `peer_of`.
        wanted: from the client's hello, so untrusted.

    Raises:
        AuthenticityError: the configuration does not give the user this role.
    """
    if uid == OVERFLOW_UID:
        raise _denied(f"user {uid} is the overflow user: it stands for every unknown user")
    if wanted is ClientRole.GATE or wanted not in roles_of(config, uid):
        raise _denied(f"user {uid} may not be `{wanted}` here")
    return wanted


def _denied(message: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.ROLE_DENIED, where="peer")
