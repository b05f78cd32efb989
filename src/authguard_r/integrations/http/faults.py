# SPDX-License-Identifier: Apache-2.0
"""Requests that have no answer: a status, a code and a place, in one shape for all of them.

Spec page: docs/spec/http.md#errors
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.http.messages import Problem

#: After how long a client that met a gate in trouble asks again, in seconds.
RETRY_S = 1
#: Codes of a status without a code of its own.
_CODES = {
    404: "NOT_FOUND",
    405: "METHOD_NOT_ALLOWED",
}
_WORDS = {404: "there is no such thing", 405: "not this way"}


class RequestError(Exception):
    """A request that is answered with a problem.

    Args:
        status: of HTTP.
        code: a reason code, or a word for what HTTP alone knows.
        message: what was expected.
        where: the place in the request.
        headers: further headers of the answer.
    """

    def __init__(
        self,
        status: int,
        code: str,
        message: str,
        *,
        where: str = "",
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(message)
        self.status, self.code = status, code
        self.headers = dict(headers or {})
        self.body = msgspec.json.encode(Problem(code=code, message=message, where=where))


def of_http(status: int, headers: Mapping[str, str] | None = None) -> RequestError:
    """Return the error of a status that says everything: no such path, no such method."""
    return RequestError(status, _CODES[status], _WORDS[status], headers=headers)


def of_malformed(error: MalformedError) -> RequestError:
    """Return the error of a request that is not what it has to be."""
    status = 413 if error.reason is Reason.INPUT_TOO_LARGE else 400
    return RequestError(status, str(error.reason), error.message, where=error.where)


def of_away(fault: AuthGuardError) -> RequestError:
    """Return the error of a gate that gave no answer."""
    return RequestError(
        503, str(fault.reason), fault.message, headers={"retry-after": str(RETRY_S)}
    )


def of_fault(error: BaseException) -> RequestError:
    """Return the error of a fault of ours: its name, and nothing that it holds."""
    name = f"{type(error).__name__}: please report this"
    return RequestError(500, str(Reason.INTERNAL_FAULT), name)
