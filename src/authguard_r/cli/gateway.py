# SPDX-License-Identifier: Apache-2.0
"""The way to a running gate: where its sockets are, and orders that go there instead of a store."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar

import msgspec
import typer
from msgspec import Struct

from authguard_r.core.errors import (
    AuthenticityError,
    EnvironmentFault,
    MalformedError,
    StoreError,
)
from authguard_r.core.identifiers import Count, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.wire.messages import ClientRole

if TYPE_CHECKING:  # loaded when a gate is asked
    from authguard_r.client import GateClient
    from authguard_r.enforcement.templates import TemplateStanding

T = TypeVar("T")

GateOption = Annotated[
    Path | None,
    typer.Option(
        "--gate",
        envvar="AUTHGUARD_GATE",
        help="A gate's run folder, or its socket (default: the only one below /run/authguard-r).",
    ),
]


class ReadingRole(StrEnum):
    """Roles that may read at a gate; in another role a command would take a client's place."""

    OPERATOR = "operator"
    AUDITOR = "auditor"


RoleOption = Annotated[
    ReadingRole,
    typer.Option(
        "--role", help="Role to connect as; the gate configuration lists who may use which role."
    ),
]
ProofOption = Annotated[
    Path | None,
    typer.Option(
        "--trust",
        envvar="AUTHGUARD_TRUST",
        help="A trust folder: the gate must prove its identity.",
    ),
]
#: How the command line is called in a gate's log.
CLIENT = "cli"
GATE_SOCKET, STOP_SOCKET = "gate.sock", "stop.sock"
#: Holds the run folder of each robot of this machine, as the units of `deploy/` make them.
RUNS = Path("/run/authguard-r")


class GateAddress(Struct, frozen=True, kw_only=True):
    """What a running gate writes beside its store, in `STORE.gate`.

    Args:
        socket: where it listens.
        pid: its process.
        robot: whose gate it is.
    """

    socket: str
    pid: Count
    robot: RobotId


class Orders(Protocol):
    """Who carries out a signed order: a store's own management, or a gate that runs."""

    def issue(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission and activate nothing."""
        ...

    def activate(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission and make it active."""
        ...

    def command(self, token: bytes) -> Standing:
        """Carry out a signed command."""
        ...

    def select(self, token: bytes) -> Standing:
        """Take in a signed choice of one row."""
        ...

    def template(self, token: bytes, *, confirmation: bytes | None = None) -> TemplateStanding:
        """Take in a signed template, or withdraw one."""
        ...


class Remote:
    """The orders of a gate that runs (`Orders`).

    Args:
        client: connected as an operator.
    """

    def __init__(self, client: GateClient) -> None:
        self._client = client

    def issue(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission and activate nothing."""
        return _as(Standing, self._client.issue(token, confirmation=confirmation))

    def activate(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission and make it active."""
        return _as(Standing, self._client.activate(token, confirmation=confirmation))

    def command(self, token: bytes) -> Standing:
        """Carry out a signed command."""
        return _as(Standing, self._client.command(token))

    def simulated_ms(self) -> int:
        """Return the gate's simulated wall clock; 0 for a gate with a real one."""
        return int(self._client.status().get("simulated_ms") or 0)

    def select(self, token: bytes) -> Standing:
        """Take in a signed choice of one row."""
        return _as(Standing, self._client.select(token))

    def template(self, token: bytes, *, confirmation: bytes | None = None) -> TemplateStanding:
        """Take in a signed template, or withdraw one."""
        from authguard_r.enforcement.templates import TemplateStanding

        said = self._client.template(token, confirmation=confirmation)
        return _as(TemplateStanding, said)


def socket_in(run: Path | None, name: str) -> Path:
    """Return the socket of a run folder; a socket that is named itself stands for its folder.

    Args:
        run: as the user named it; None takes the machine's only one.
        name: `GATE_SOCKET` or `STOP_SOCKET`.

    Raises:
        EnvironmentFault: nothing was named, and the machine has no gate.
        typer.BadParameter: nothing was named, and the machine has several.
    """
    if run is None and (named := os.environ.get("AUTHGUARD_RUN")):
        typer.echo(
            "AUTHGUARD_RUN is now AUTHGUARD_GATE; the old name ends with the next version", err=True
        )
        run = Path(named)
    place = run or only_run(RUNS, name)
    if not place.is_socket():
        return place / name
    return place.with_name(name) if place.name in {GATE_SOCKET, STOP_SOCKET} else place


def only_run(folder: Path, name: str) -> Path:
    """Return the only run folder below a folder that has this socket.

    Raises:
        EnvironmentFault: none has, or none that this user may look into.
        typer.BadParameter: several have: which robot is meant, only the user knows.
    """
    below: list[Path] = []
    with suppress(OSError):
        below = sorted(path for path in folder.iterdir() if path.is_dir())
    closed = [path for path in below if not os.access(path, os.X_OK)]
    found = [path for path in below if path not in closed and (path / name).is_socket()]
    if len(found) == 1:
        return found[0]
    if found:
        told = ", ".join(f"`{path}`" for path in found)
        raise typer.BadParameter(
            f"several gates are here, say which: --gate with one of {told}", param_hint="--gate"
        )
    shut = f", and this user may not look into `{closed[0]}`" if closed else ""
    raise EnvironmentFault(
        f"no gate answers: no folder below `{folder}` has a `{name}`{shut}; "
        "name a run folder with --gate, in AUTHGUARD_GATE, or in `authguard.toml`",
        reason=Reason.SERVICE_UNAVAILABLE,
        where="--gate",
    )


def connect_as(path: Path, roles: Iterable[ClientRole]) -> GateClient:
    """Return a client in the first of the roles that is this user's; `welcome` says which.

    Only `ROLE_DENIED` goes on to the next role.

    Raises:
        AuthGuardError: no gate answers, or this user has none of the roles.
    """
    from authguard_r.client import GateClient

    tried: list[str] = []
    for role in roles:
        try:
            return GateClient.connect(path, role=role, client=CLIENT, allow_shadow=True)
        except AuthenticityError as error:
            if error.reason is not Reason.ROLE_DENIED:
                raise
            tried.append(f"`{role}`")
    raise AuthenticityError(
        f"this user has no role of {', '.join(tried)} here",
        reason=Reason.ROLE_DENIED,
        where=str(path),
    )


@contextmanager
def connected(
    run: Path | None, role: ReadingRole, trust: Path | None, *, name: str = GATE_SOCKET
) -> Iterator[GateClient]:
    """Connect to a gate for a while.

    Args:
        run: where it is.
        role: what to be there.
        trust: with it, the gate has to prove that it is one of this root's.
        name: which socket.
    """
    from authguard_r.client import GateClient
    from authguard_r.keys.trust import read_trust

    with GateClient.connect(
        socket_in(run, name),
        role=ClientRole(role),
        client=CLIENT,
        verifier=None if trust is None else read_trust(trust),
        allow_shadow=True,
    ) as client:
        yield client


@contextmanager
def running_gate(store: Path, trust: Path, rid: RobotId) -> Iterator[Remote | None]:
    """Yield the gate that holds a store, or None when none is there.

    It has to prove that it is this robot's: any writer of the folder can replace the file beside
    the store. An order that the gate refuses is refused; it is not tried on the store.
    """
    beside = beside_store(store)
    client = None if beside is None else _connect(Path(beside.socket), trust, rid)
    if client is None:
        with told_of(beside, store, tried=True):
            yield None
        return
    with client:
        yield Remote(client)


def _connect(path: Path, trust: Path, rid: RobotId) -> GateClient | None:
    """Return the client, or None when no process listens there."""
    from authguard_r.client import GateClient
    from authguard_r.keys.trust import read_trust

    try:
        return GateClient.connect(
            path, role=ClientRole.OPERATOR, client=CLIENT, verifier=read_trust(trust), robot=rid
        )
    except EnvironmentFault as error:
        if error.where == str(path):
            return None
        raise


@contextmanager
def told_of(beside: GateAddress | None, store: Path, *, tried: bool = False) -> Iterator[None]:
    """Say where the gate is when its store is held.

    Args:
        beside: what lies beside the store.
        store: the store.
        tried: no gate answered at that socket.
    """
    try:
        yield
    except StoreError as error:
        if beside is None or error.reason is not Reason.STORE_UNAVAILABLE:
            raise
        away = ": no process answers there now" if tried else ""
        raise StoreError(
            f"the gate is running (process {beside.pid}) and has this store open: use a command "
            f"with --gate {beside.socket}, or end the gate{away}",
            where=str(store),
        ) from error


def beside_store(store: Path) -> GateAddress | None:
    """Return what a gate wrote beside its store."""
    from authguard_r.keys.trust import read_file

    path = store.with_name(f"{store.name}.gate")
    if not path.is_file():
        return None
    try:
        return msgspec.json.decode(read_file(path), type=GateAddress)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MalformedError(str(error), where=str(path)) from error


def _as(kind: type[T], said: dict[str, Any]) -> T:
    try:
        return msgspec.convert(said, kind)
    except msgspec.ValidationError as error:
        raise MalformedError(str(error), where="standing") from error
