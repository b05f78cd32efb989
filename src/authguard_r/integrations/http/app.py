# SPDX-License-Identifier: Apache-2.0
"""The endpoints: what each takes, asks the gate and gives. One table, for serving and for OpenAPI.

No endpoint takes an order, an approval or a mission: those are signed, and come to the gate by
themselves. Spec page: docs/spec/http.md#endpoints
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
from msgspec import Struct
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route, Router

from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.core.errors import AuthGuardError, MalformedError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.http.deciding import Decider
from authguard_r.integrations.http.edge import LIMITS, ROUTE
from authguard_r.integrations.http.faults import RequestError, of_away, of_http, of_malformed
from authguard_r.integrations.http.gate_connection import AwayError, GateLink
from authguard_r.integrations.http.messages import (
    Counted,
    Explanation,
    Metadata,
    Numbered,
    Page,
    ProposalMessage,
    RecordMessage,
    RecordsMessage,
    StandingMessage,
    StatusMessage,
)
from authguard_r.integrations.http.operations import EVALUATION, EVALUATIONS, Operation
from authguard_r.integrations.http.reading import read_body, read_words
from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send

#: What a proposal's key looks like (`wire.messages.Key`).
KEY = re.compile(r"\A[A-Za-z0-9_-]{1,64}\Z")
_JSON = re.compile(r"\Aapplication/json(?:\s*;\s*charset=\"?utf-8\"?)?\Z", re.IGNORECASE)
_JSON_ANSWER = "application/json"
_METRICS = "text/plain; version=0.0.4; charset=utf-8"

#: Answers one request: the parameters, the body and the request itself.
Handler = Callable[[Any, Any, Request], Awaitable[Any]]


class Endpoints:
    """The handlers by the name of their operation.

    Args:
        decider: asks the gate about calls.
        operator: the gate as it is read.
        url: where this server is reached.
        document: the OpenAPI document.
        metrics: makes text of counts.
    """

    def __init__(
        self,
        decider: Decider,
        operator: GateLink,
        *,
        url: str,
        document: bytes,
        metrics: Callable[[dict[str, Any]], bytes],
    ) -> None:
        self._decider, self._operator = decider, operator
        self._url, self._document, self._metrics = url, document, metrics

    def of(self, operation: Operation) -> Handler:
        """Return what answers an operation."""
        handler: Handler = getattr(self, f"_{operation.name}")
        return handler

    async def _evaluation(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return await self._decider.evaluation(asked)

    async def _evaluations(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return await self._decider.evaluations(asked)

    async def _metadata(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return Metadata(
            policy_decision_point=self._url,
            access_evaluation_endpoint=self._url + EVALUATION,
            access_evaluations_endpoint=self._url + EVALUATIONS,
        )

    async def _proposal(self, words: Any, asked: ProposalMessage, request: Request) -> Any:  # noqa: ARG002
        keys = request.headers.getlist("idempotency-key")
        if len(keys) != 1 or not KEY.match(keys[0]):
            raise MalformedError(
                "expected one of 1 to 64 letters, digits, `-` and `_`", where="idempotency-key"
            )
        try:
            return await self._decider.proposal(asked, keys[0])
        except RefusedError as error:
            raise RequestError(409, str(error.reason), error.message, where=error.where) from error

    async def _mission(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return _as(await self._operator.ask(AsyncGateClient.status), StandingMessage)

    async def _status(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return _as(await self._operator.ask(AsyncGateClient.status), StatusMessage)

    async def _approvals(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return list(await self._operator.ask(AsyncGateClient.approvals))

    async def _approval(self, words: Counted, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return await self._one(lambda gate: gate.approval(words.counter))

    async def _records(self, words: Page, asked: Any, request: Request) -> Any:  # noqa: ARG002
        page = await self._operator.ask(lambda gate: gate.records(words.first, words.count))
        found = _as(page["records"], tuple[RecordMessage, ...])
        return RecordsMessage(records=found, next=found[-1].seq + 1 if found else None)

    async def _explanation(self, words: Numbered, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return _as(await self._one(lambda gate: gate.explain(words.seq)), Explanation)

    async def _metrics_text(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return self._metrics(await self._operator.ask(AsyncGateClient.metrics))

    async def _openapi(self, words: Any, asked: Any, request: Request) -> Any:  # noqa: ARG002
        return self._document

    async def _one(self, question: Callable[[AsyncGateClient], Awaitable[Any]]) -> Any:
        """Return the one thing that was asked for; what is not there is 404."""
        try:
            return await self._operator.ask(question, refusal=RefusedError)
        except RefusedError as error:
            raise RequestError(404, str(error.reason), error.message, where=error.where) from error


def application(operations: tuple[Operation, ...], endpoints: Endpoints) -> App:
    """Return the application that answers these operations, and 404 for everything else."""
    routes = [_route(operation, endpoints.of(operation)) for operation in operations]
    router = Router(routes=routes, redirect_slashes=False)  # a path has one spelling

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if b"%" in scope["raw_path"]:  # another spelling of what is there
            raise of_http(404)
        scope["app"] = answer  # so that the router says what it misses instead of answering
        try:
            await router(scope, receive, send)
        except HTTPException as error:
            raise of_http(error.status_code, error.headers) from error

    return answer


def _route(operation: Operation, handler: Handler) -> Route:
    async def answer(request: Request) -> Response:
        request.scope[ROUTE] = operation.path
        try:
            words = [*request.path_params.items(), *request.query_params.multi_items()]
            given = read_words(words, operation.words)
            asked = None if operation.takes is None else await _body(request, operation.takes)
            made = await handler(given, asked, request)
        except MalformedError as error:
            raise of_malformed(error) from error
        except AwayError as error:
            raise of_away(error.fault) from error
        if isinstance(made, bytes):
            kind = _METRICS if operation.text else _JSON_ANSWER
            return Response(made, media_type=None, headers={"content-type": kind})
        return Response(msgspec.json.encode(made), media_type=_JSON_ANSWER)

    return Route(operation.path, answer, methods=[operation.method])


async def _body(request: Request, kind: type[Struct]) -> Any:
    """Return what a body spells.

    Raises:
        RequestError: of another kind (415), too long (413) or too slow (408).
        MalformedError: it does not spell what is taken here.
    """
    kinds = request.headers.getlist("content-type")
    packed = request.headers.getlist("content-encoding")
    if len(kinds) != 1 or not _JSON.match(kinds[0]) or packed:
        text = "expected `application/json`, in UTF-8 and as it is"
        raise RequestError(415, "MEDIA_TYPE_UNSUPPORTED", text, where="content-type")
    data = bytearray()
    try:
        async with asyncio.timeout(LIMITS.body_s):
            async for chunk in request.stream():
                data += chunk
                if len(data) > LIMITS.body:
                    text = f"expected at most {LIMITS.body} bytes"
                    raise RequestError(413, str(Reason.INPUT_TOO_LARGE), text, where="body")
    except TimeoutError:
        text = f"expected it within {LIMITS.body_s:.0f} s"
        raise RequestError(
            408, "TOO_SLOW", text, where="body", headers={"connection": "close"}
        ) from None
    except ClientDisconnect:
        raise RequestError(400, str(Reason.MALFORMED), "it is not whole", where="body") from None
    return read_body(bytes(data), kind)


def _as(said: Any, kind: Any) -> Any:
    """Return what the gate said in the shape that is promised.

    Raises:
        AwayError: it says something else.
    """
    try:
        return msgspec.convert(said, kind)
    except msgspec.ValidationError as error:
        fault = AuthGuardError(str(error), reason=Reason.INTERNAL_FAULT, where="gate")
        raise AwayError(fault) from error
