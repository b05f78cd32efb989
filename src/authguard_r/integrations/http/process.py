# SPDX-License-Identifier: Apache-2.0
"""The decision point's process: a port, and one or two clients of the gate.

Spec page: docs/spec/http.md
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Any

from msgspec import Struct
from OpenSSL import SSL

from authguard_r.client.link import ProcessLog, require_folder
from authguard_r.client.reconnecting import GatePlace
from authguard_r.core.errors import EnvironmentFault
from authguard_r.integrations.http.app import Endpoints, application
from authguard_r.integrations.http.clients import Authenticator
from authguard_r.integrations.http.deciding import Decider
from authguard_r.integrations.http.edge import LIMITS, Edge
from authguard_r.integrations.http.gate_connection import AwayError, GateLink
from authguard_r.integrations.http.openapi import document
from authguard_r.integrations.http.operations import operations_of
from authguard_r.integrations.http.tls import Secured
from authguard_r.integrations.http_listener.access import App
from authguard_r.integrations.http_listener.connection import HttpConnection
from authguard_r.integrations.http_listener.server import serve_until_signal
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.json_log import Lines
from authguard_r.wire.messages import ClientRole, Mode


class HttpSetup(Struct, frozen=True, kw_only=True):
    """The options of a decision point.

    Args:
        where: which gate.
        authenticator: who may ask.
        url: where clients reach it.
        hosts: names that a request may call it by; None: any, behind TLS.
        tls: the server's certificate; None: plain HTTP, on loopback.
        disclosure: how much of a what-if is shown.
        propose: calls are carried out too.
        metrics: makes text of counts.
    """

    where: GatePlace
    authenticator: Authenticator
    url: str
    hosts: frozenset[bytes] | None
    tls: SSL.Context | None
    disclosure: Disclosure
    propose: bool
    metrics: Callable[[dict[str, Any]], bytes]


def openapi(*, propose: bool) -> bytes:
    """Return the OpenAPI document of a decision point."""
    return document(operations_of(propose=propose), version=version("authguard-r"))


async def serve(setup: HttpSetup, made: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT.

    A gate that is away at the start is waited for: requests are 503 until it is there.

    Raises:
        AuthGuardError: there is a gate, and it is not the one that was meant.
    """
    require_folder(setup.where.run)
    log, lines = ProcessLog(), Lines(most=LIMITS.lines)
    shadow = setup.where.mode is Mode.SHADOW
    operator = GateLink(setup.where, ClientRole.OPERATOR, log)
    planner = GateLink(setup.where, ClientRole.PLANNER, log) if setup.propose or shadow else None
    links = [operator] if planner is None else [operator, planner]
    try:
        for link in links:
            await _try(link)
        decider = Decider(
            setup.where.robot,
            operator=None if shadow else operator,
            planner=planner,
            disclosure=setup.disclosure,
        )
        app = _application(setup, decider, operator)
        edge = Edge(app, setup.authenticator, setup.hosts, lines)
        lines.write({"event": "serving", "url": setup.url})
        if setup.tls is None:
            await serve_until_signal(edge, made, LIMITS, lines)
        else:
            make = partial(_secured, setup.tls)
            await serve_until_signal(edge, made, LIMITS, lines, make=make)
        lines.write({"event": "end"})
    finally:
        await asyncio.gather(*(link.close() for link in links))


async def _try(link: GateLink) -> None:
    """Connect once, so that a wrong gate is said at the start."""
    try:
        await link.connected()
    except AwayError as error:
        if not isinstance(error.fault, EnvironmentFault):
            raise error.fault from None


def _application(setup: HttpSetup, decider: Decider, operator: GateLink) -> App:
    endpoints = Endpoints(
        decider,
        operator,
        url=setup.url,
        document=openapi(propose=setup.propose),
        metrics=setup.metrics,
    )
    return application(operations_of(propose=setup.propose), endpoints)


def _secured(
    context: SSL.Context, guest: HttpConnection, inner: Callable[[], asyncio.Protocol]
) -> asyncio.Protocol:
    """Return the protocol of a new connection: HTTP inside TLS."""
    return Secured(context, guest, inner)
