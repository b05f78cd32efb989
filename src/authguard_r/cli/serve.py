# SPDX-License-Identifier: Apache-2.0
"""`authguard serve`: a robot's gate as a decision point over HTTP."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from authguard_r.client.link import wall_now
from authguard_r.core.identifiers import RobotId
from authguard_r.keys.certificate import Role
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.operations.exposition import exposition
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import Mode

if TYPE_CHECKING:
    from OpenSSL.SSL import Context

    from authguard_r.integrations.http.clients import Authenticator


_RobotOption = Annotated[str | None, typer.Option("--robot", help="The robot.")]
_RunOption = Annotated[Path | None, typer.Option("--gate", help="The gate's run folder.")]
_TrustOption = Annotated[
    Path | None, typer.Option("--trust", help="The trust folder: the gate must prove its identity.")
]
_ListenOption = Annotated[
    str, typer.Option("--listen", help="HOST:PORT; other than loopback only with TLS.")
]
_BearerOption = Annotated[
    Path | None, typer.Option("--token-file", help="File with the bearer token of the clients.")
]
_TlsCertOption = Annotated[
    Path | None, typer.Option("--tls-cert", help="The server's certificate, PEM.")
]
_TlsKeyOption = Annotated[
    Path | None, typer.Option("--tls-key", help="Its private key, PEM, mode 600.")
]
_ClientCertificatesOption = Annotated[
    bool,
    typer.Option("--client-certificates", help="Require a client certificate of the trust folder."),
]
_ClientRoleOption = Annotated[
    list[Role] | None,
    typer.Option("--client-role", help="Role that may ask; repeatable."),
]
_UrlOption = Annotated[
    str | None, typer.Option("--url", help="URL for clients, if it is not HOST:PORT.")
]
_DisclosureOption = Annotated[
    Disclosure, typer.Option("--disclosure", help="How much of a refusal the answer says.")
]
_ProposeOption = Annotated[
    bool, typer.Option("--propose", help="Also carry out calls, at /v1/proposals.")
]
_ShadowOption = Annotated[
    bool,
    typer.Option("--shadow", help="Shadow mode: always permit; the gate records its decision."),
]
_ClientOption = Annotated[
    str, typer.Option("--client", help="Name of this service in the gate's log.")
]
_OpenapiOption = Annotated[
    bool, typer.Option("--openapi", help="Print the OpenAPI document and end.")
]


def serve_command(
    robot: _RobotOption = None,
    run: _RunOption = None,
    trust: _TrustOption = None,
    listen: _ListenOption = "127.0.0.1:0",
    bearer: _BearerOption = None,
    tls_cert: _TlsCertOption = None,
    tls_key: _TlsKeyOption = None,
    client_certificates: _ClientCertificatesOption = False,
    client_role: _ClientRoleOption = None,
    url: _UrlOption = None,
    disclosure: _DisclosureOption = Disclosure.CODES,
    propose: _ProposeOption = False,
    shadow: _ShadowOption = False,
    client: _ClientOption = "http",
    openapi: _OpenapiOption = False,
) -> int:
    """Answer over HTTP what the gate would decide (OpenID AuthZEN).

    A permit is advice: it consumes nothing and it expires immediately. With `--propose` the gate
    also carries out what it permits.
    """
    from authguard_r.client.reconnecting import GatePlace
    from authguard_r.integrations.http import process
    from authguard_r.integrations.http_listener.access import listening

    if openapi:
        sys.stdout.write(process.openapi(propose=propose).decode() + "\n")
        return 0
    if robot is None or run is None or trust is None:
        raise typer.BadParameter("expected --robot, --gate and --trust", param_hint="--robot")
    if shadow and propose:
        text = "a gate in shadow mode carries nothing out"
        raise typer.BadParameter(text, param_hint="--propose")
    _require_tls(tls_cert, tls_key, certificates=client_certificates, roles=client_role)
    roles = frozenset(client_role or ()) if client_certificates else None
    authenticator = _authenticator(bearer, trust, RobotId(robot), roles)
    read_trust(trust)  # what is missing is said now; each connection reads it anew
    context = _tls(tls_cert, tls_key, client_certificates=client_certificates)
    otherwise = "for a wider one give --tls-cert and --tls-key"
    with listening(listen, wide=context is not None, otherwise=otherwise) as made:
        setup = process.HttpSetup(
            where=GatePlace(
                robot=RobotId(robot),
                run=run,
                trust=lambda: read_trust(trust),
                client=client,
                mode=Mode.SHADOW if shadow else Mode.ENFORCE,
            ),
            authenticator=authenticator,
            url=_where(made, listen, url, has_tls=context is not None),
            hosts=_hosts(made) if context is None else None,
            tls=context,
            disclosure=disclosure,
            propose=propose,
            metrics=exposition,
        )
        asyncio.run(process.serve(setup, made))
    return 0


def _require_tls(
    cert: Path | None, key: Path | None, *, certificates: bool, roles: list[Role] | None
) -> None:
    """Require that the options about TLS go together."""
    if (cert is None) != (key is None):
        raise typer.BadParameter("expected both or neither", param_hint="--tls-cert")
    if certificates and cert is None:
        text = "they come by TLS: --tls-cert, --tls-key"
        raise typer.BadParameter(text, param_hint="--client-certificates")
    if roles and not certificates:
        raise typer.BadParameter("only with --client-certificates", param_hint="--client-role")


def _authenticator(
    bearer: Path | None, trust: Path, robot: RobotId, roles: frozenset[Role] | None
) -> Authenticator:
    """Return who says who may ask: by a token, by certificates, or by both."""
    from authguard_r.integrations.http.clients import ROLES, Authenticator, Certificates
    from authguard_r.integrations.http_listener.access import read_bearer

    if bearer is None and roles is None:
        text = "a port does not identify the caller: give --token-file or --client-certificates"
        raise typer.BadParameter(text, param_hint="--token-file")

    def read() -> Trust:
        return read_trust(trust)

    held = None
    if roles is not None:
        held = Certificates(read, robot, roles or ROLES, wall_now)
        held.require_usable()
    return Authenticator(None if bearer is None else read_bearer(bearer), held)


def _tls(cert: Path | None, key: Path | None, *, client_certificates: bool) -> Context | None:
    from authguard_r.integrations.http.tls import read_context

    if cert is None or key is None:
        return None
    return read_context(cert, key, client_certificates=client_certificates)


def _where(made: socket.socket, listen: str, url: str | None, *, has_tls: bool) -> str:
    """Return where clients reach the server."""
    host, port, *_ = made.getsockname()
    address = ipaddress.ip_address(host)
    if url is None and address.is_unspecified:
        raise typer.BadParameter(f"`{listen}` is no address that clients reach: --url")
    shown = f"[{host}]" if address.version == 6 else host
    return (url or f"{'https' if has_tls else 'http'}://{shown}:{port}").rstrip("/")


def _hosts(made: socket.socket) -> frozenset[bytes]:
    """Return the names that a request on loopback may call this server by."""
    host, port, *_ = made.getsockname()
    names = {f"[{host}]" if ":" in host else host, "localhost", "127.0.0.1", "[::1]"}
    return frozenset(f"{name}:{port}".encode() for name in names)
