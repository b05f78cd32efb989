# SPDX-License-Identifier: Apache-2.0
"""A safety gate in a process of its own, asked about every action over its socket.

To compare another safety system, write a small server of that protocol. No answer, a late one or
one that is not in order is no: it fails closed. Spec page: docs/spec/safety.md
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.safety import ExternalGate
from authguard_r.safety.config import ExternalChecker
from authguard_r.site.source import convert
from missionpair.defenses import Claim, Defense, DefenseError
from missionpair.defenses._unsafe import stops_unsafe
from missionpair.defenses._watched import Watched
from missionpair.execution import Denied, Permits
from missionpair.judging import Walk
from missionpair.stage import Stage

NAME = "external"
#: No checker said that it is safe, as opposed to a checker that said that it is not.
NO_ANSWER = "NO_ANSWER"


def make(socket: str = "", timeout_ms: str = "200") -> Defense:
    """Return a gate that listens at a Unix socket.

    Raises:
        DefenseError: no absolute path of a socket, or no time from 1 to 1000 milliseconds.
    """
    plain = {"id": NAME, "socket": socket, "timeout_ms": _whole(timeout_ms)}
    try:
        checker = convert(plain, ExternalChecker, where=NAME)
    except MalformedError as error:
        raise DefenseError(
            f"`{NAME}` needs `socket=/path/of/its/socket`, a whole path of 107 characters at most, "
            f"and may have `timeout_ms=1` to 1000; got `{socket[:80]}` and `{timeout_ms[:20]}`"
        ) from error
    gate = ExternalGate(checker)

    def permits_for(stage: Stage) -> Permits:  # noqa: ARG001 - the other process knows
        return lambda action, walk: _denied(gate, action, walk)

    claim = Claim(text="stops what the other process calls unsafe", proof=stops_unsafe)
    parameters = {"timeout_ms": checker.timeout_ms}
    return Watched(name=NAME, claim=claim, permits_for=permits_for, parameters=parameters)


def _denied(gate: ExternalGate, action: Action, walk: Walk) -> Denied | None:
    assessed = gate.assess(action, walk.attested(), walk.facts, walk.now)
    if assessed.safe:
        return None
    codes = dict.fromkeys(
        NO_ANSWER if str(finding.hazard) == "STATE_UNKNOWN" else str(finding.hazard)
        for finding in assessed.findings
    )
    return Denied(by=NAME, reasons=tuple(codes))


def _whole(text: str) -> int | str:
    return int(text) if text.isascii() and text.isdigit() else text
