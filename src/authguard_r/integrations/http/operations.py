# SPDX-License-Identifier: Apache-2.0
"""Every operation: its path, what it takes and gives, and every status that can come of it.

Spec page: docs/spec/http.md#endpoints
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from authguard_r.integrations.http.messages import (
    Carried,
    Counted,
    Decided,
    DecidedAll,
    Evaluation,
    Evaluations,
    Explanation,
    Metadata,
    NoParameters,
    Numbered,
    Page,
    ProposalMessage,
    RecordsMessage,
    StandingMessage,
    StatusMessage,
)
from authguard_r.wire.approval_request import Question

EVALUATION, EVALUATIONS = "/access/v1/evaluation", "/access/v1/evaluations"
METADATA = "/.well-known/authzen-configuration"
OPENAPI = "/openapi.json"

#: Statuses that any request can be answered with.
ALWAYS = (400, 401, 403, 421, 431, 500, 503)
#: Statuses of a request with a body.
_BODY = (408, 413, 415)


class Operation(Struct, frozen=True, kw_only=True):
    """One thing that can be asked.

    Args:
        name: what it is called.
        method: of HTTP.
        path: with the names of its parameters.
        summary: what it answers, in one line.
        gives: what the answer's body can be; the first is the usual one.
        takes: what the request's body is; None: it has none.
        words: its parameters, in path and query.
        keyed: it is named by an `Idempotency-Key`.
        text: its answer is text for Prometheus.
        faults: statuses beside `ALWAYS`.
    """

    name: str
    method: str
    path: str
    summary: str
    gives: tuple[Any, ...] = ()
    takes: type[Struct] | None = None
    words: type[Struct] = NoParameters
    keyed: bool = False
    text: bool = False
    faults: tuple[int, ...] = ()

    @property
    def statuses(self) -> tuple[int, ...]:
        """Every status but 200, in order."""
        body = _BODY if self.takes is not None else ()
        return tuple(sorted({*ALWAYS, *body, *self.faults}))


_EVALUATED = (
    Operation(
        name="evaluation",
        method="POST",
        path=EVALUATION,
        summary="What the gate would decide of one call now: advice, which uses nothing up.",
        takes=Evaluation,
        gives=(Decided,),
    ),
    Operation(
        name="evaluations",
        method="POST",
        path=EVALUATIONS,
        summary="What the gate would decide of several calls, each by itself.",
        takes=Evaluations,
        gives=(DecidedAll, Decided),
    ),
    Operation(
        name="metadata",
        method="GET",
        path=METADATA,
        summary="Where the endpoints of the Authorization API are.",
        gives=(Metadata,),
    ),
)
_PROPOSED = Operation(
    name="proposal",
    method="POST",
    path="/v1/proposals",
    summary="Have one call decided and carried out by the gate's own controller.",
    takes=ProposalMessage,
    gives=(Carried,),
    keyed=True,
    faults=(409,),
)
_READ = (
    Operation(
        name="mission",
        method="GET",
        path="/v1/mission",
        summary="The active mission as it stands.",
        gives=(StandingMessage,),
    ),
    Operation(
        name="approvals",
        method="GET",
        path="/v1/approvals",
        summary="Every open approval request of the active mission.",
        gives=(list[Question],),
    ),
    Operation(
        name="approval",
        method="GET",
        path="/v1/approvals/{counter}",
        summary="One open approval request.",
        words=Counted,
        gives=(Question,),
        faults=(404,),
    ),
    Operation(
        name="records",
        method="GET",
        path="/v1/records",
        summary="A page of the log.",
        words=Page,
        gives=(RecordsMessage,),
    ),
    Operation(
        name="explanation",
        method="GET",
        path="/v1/records/{seq}/explanation",
        summary="One record in words.",
        words=Numbered,
        gives=(Explanation,),
        faults=(404,),
    ),
    Operation(
        name="status",
        method="GET",
        path="/v1/status",
        summary="Description of the gate.",
        gives=(StatusMessage,),
    ),
    Operation(
        name="metrics_text",
        method="GET",
        path="/v1/metrics",
        summary="The gate's counts, for Prometheus.",
        text=True,
    ),
    Operation(
        name="openapi",
        method="GET",
        path=OPENAPI,
        summary="This document.",
        gives=(dict[str, Any],),
    ),
)


def operations_of(*, propose: bool) -> tuple[Operation, ...]:
    """Return every operation that is served.

    Args:
        propose: calls are carried out too.
    """
    return (*_EVALUATED, *((_PROPOSED,) if propose else ()), *_READ)
