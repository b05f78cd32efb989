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

import uvicorn
from msgspec import Struct
from OpenSSL import SSL

from authguard_r.client.keeping import GatePlace
from authguard_r.client.link import Log, require_folder
from authguard_r.core.errors import EnvironmentFault
from authguard_r.http.app import Endpoints, application
from authguard_r.http.clients import Doorkeeper
from authguard_r.http.connection import Patient
from authguard_r.http.deciding import Decider
from authguard_r.http.edge import MAX_HEAD, Edge, say
from authguard_r.http.link import AwayError, GateLink
from authguard_r.http.openapi import document
from authguard_r.http.operations import operations_of
from authguard_r.http.tls import Secured
from authguard_r.listening import END_S, serve_until_told
from authguard_r.shapes import Disclosure
from authguard_r.wire.messages import ClientRole, Mode

#: Most connections at a time, idle ones too.
MOST_CONNECTIONS = 2_048
#: A connection that asks nothing more is kept so long, in seconds.
IDLE_S = 5


class Setup(Struct, frozen=True, kw_only=True):
    """What a decision point is told.

    Args:
        where: which gate.
        doorkeeper: who may ask.
        url: where clients reach it.
        hosts: names that a request may call it by; None: any, behind TLS.
        tls: the server's certificate; None: plain HTTP, on loopback.
        disclosure: how much of a what-if is told.
        propose: calls are carried out too.
        metrics: makes text of counts.
    """

    where: GatePlace
    doorkeeper: Doorkeeper
    url: str
    hosts: frozenset[bytes] | None
    tls: SSL.Context | None
    disclosure: Disclosure
    propose: bool
    metrics: Callable[[dict[str, Any]], bytes]


def openapi(*, propose: bool) -> bytes:
    """Return the OpenAPI document of a decision point."""
    return document(operations_of(propose=propose), version=version("authguard-r"))


async def serve(setup: Setup, made: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT.

    A gate that is away at the start is waited for: requests are 503 until it is there.

    Raises:
        AuthGuardError: there is a gate, and it is not the one that was meant.
    """
    require_folder(setup.where.run)
    log = Log()
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
        say({"event": "serving", "url": setup.url})
        await serve_until_told(_config(setup, decider, operator), made)
        say({"event": "end"})
    finally:
        await asyncio.gather(*(link.close() for link in links))


async def _try(link: GateLink) -> None:
    """Connect once, so that a wrong gate is said at the start."""
    try:
        await link.connected()
    except AwayError as error:
        if not isinstance(error.fault, EnvironmentFault):
            raise error.fault from None


def _config(setup: Setup, decider: Decider, operator: GateLink) -> uvicorn.Config:
    endpoints = Endpoints(
        decider,
        operator,
        url=setup.url,
        document=openapi(propose=setup.propose),
        metrics=setup.metrics,
    )
    app = application(operations_of(propose=setup.propose), endpoints)
    return uvicorn.Config(
        Edge(app, setup.doorkeeper, setup.hosts),
        http=Patient if setup.tls is None else partial(_secured, setup.tls),  # type: ignore[arg-type]
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="critical",  # one line of ours for each request is the log
        access_log=False,
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        h11_max_incomplete_event_size=MAX_HEAD,
        timeout_keep_alive=IDLE_S,
        timeout_graceful_shutdown=END_S,
        proxy_headers=False,  # nobody in between is believed
    )


def _secured(context: SSL.Context, **given: Any) -> Secured:
    """Return the protocol of a new connection: HTTP inside TLS."""
    return Secured(context, partial(Patient, **given))
