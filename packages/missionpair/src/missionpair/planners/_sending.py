# SPDX-License-Identifier: Apache-2.0
"""One question to a model's server, under caps: what an attempt can cost is set aside before it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from authguard_r.authoring.model_client.exchange import (
    FaultKind,
    ModelServerError,
    exchange,
    retried,
)
from missionpair.briefing import PlannerError

if TYPE_CHECKING:
    import httpx2

    from missionpair.planners._meter import Meter
    from missionpair.planners._reach import ModelEndpoint

#: A planner's error code for each fault of a server, and what to do about it.
_FAULTS = {
    FaultKind.LIMIT: ("limit", "cap `per_minute`, or try later"),
    FaultKind.REFUSED: ("refused", "check `model` and the key in `{key}`"),
    FaultKind.PROTOCOL: ("protocol", "check that it speaks the protocol"),
    FaultKind.TOO_LARGE: ("protocol", "check that it speaks the protocol"),
}
#: Of each fault of the set-up: a planner's error code, what to do, and where it lies.
_SET_UP = {
    FaultKind.MISSING_PACKAGE: ("unreachable", ": install `missionpair[llm]`", ""),
    FaultKind.ADDRESS: ("unreachable", "", "base_url"),
    FaultKind.CLEARTEXT: ("refused", "", "base_url"),
    FaultKind.KEY: ("refused", ": set it, or name another one with `key_env`", "key_env"),
}


class ReceivedReply(Struct, frozen=True):
    """What came back: the exact body, the time of the attempt, and the number of attempts."""

    body: bytes
    took_us: int
    attempts: int


def send(
    reach: ModelEndpoint,
    meter: Meter,
    part: Any,
    post: Callable[[httpx2.Client], bytes],
    *,
    headers: Mapping[str, str],
    most_microusd: int,
    pause: Callable[[float], None] = time.sleep,
) -> ReceivedReply:
    """Return what a server answers, after as many attempts as it takes and may.

    Args:
        reach: where.
        meter: the caps; the most that an attempt can cost stays set aside with it.
        part: the client library, for its errors.
        post: sends the request and returns the body.
        headers: the protocol's own, with the key.
        most_microusd: the most that one attempt can cost.
        pause: waits so many seconds.

    Raises:
        PlannerError: a cap is reached (`cost`), or the ledger cannot be used.
        ModelServerError: the last attempt's.
    """

    def once() -> tuple[bytes, int]:
        meter.set_aside(most_microusd)
        try:
            meter.take_turn()
        except BaseException:
            meter.give_back(most_microusd)
            raise
        began = time.perf_counter_ns()
        ends = time.monotonic() + reach.timeout_s
        try:
            body = exchange(reach, part, post, headers=headers, ends=ends)
        except ModelServerError as error:
            if not error.billed:
                meter.give_back(most_microusd)
            raise
        return body, (time.perf_counter_ns() - began) // 1_000

    (body, took_us), attempts = retried(
        once,
        retries=reach.retries,
        backoff_s=reach.backoff_s,
        patience_s=reach.patience_s,
        pause=pause,
    )
    return ReceivedReply(body, took_us, attempts)


def planner_error(reach: ModelEndpoint, error: ModelServerError) -> PlannerError:
    """Return a fault of the set-up or of a server as a planner's error.

    Its code: no answer (`unreachable`), too many requests (`limit`), a key or a request that is
    refused (`refused`), or no reply of the protocol (`protocol`).
    """
    if error.kind in _SET_UP:
        code, mend, where = _SET_UP[error.kind]
        return PlannerError(f"{error.message}{mend}", code=code, where=where or reach.protocol)
    code, mend = _FAULTS.get(error.kind, ("unreachable", "check `base_url`, and that it runs"))
    late = error.kind is FaultKind.LATE
    did = f"did not answer within {reach.timeout_s:g} s" if late else error.message
    tries = "" if error.attempts == 1 else f" ({error.attempts} attempts)"
    if error.passing and error.next_s > reach.patience_s:
        tries = f" and asks to wait {error.next_s:g} s"
    mend = mend.format(key=reach.key_env or "key_env")
    message = f"the model server at `{reach.base_url}` {did}{tries}: {mend}"
    return PlannerError(message, code=code, where="base_url")
