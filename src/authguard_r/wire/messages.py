# SPDX-License-Identifier: Apache-2.0
"""Every message between a gate and its clients, who may send it, and how long it may be.

Nothing here carries authority: a mission, an order, an approval and a snapshot are signed tokens
inside a message, and a role is what the kernel says of the peer, held to the signed configuration.
Spec page: docs/spec/gate-protocol.md
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from authguard_r.core.action import Action
from authguard_r.core.identifiers import (
    MAX_INTEGER,
    Base64Url,
    Count,
    Digest,
    Identifier,
    Integer,
    Positive,
    RobotId,
)
from authguard_r.core.standing import Outcome, Spend

#: Name and version of the protocol; another one is refused at the first message.
PROTOCOL = "authguard-r/gate/1"
#: Longest first message, in bytes: the client is not known yet.
MAX_HELLO = 4_096
#: Longest answer or event, in bytes.
MAX_ANSWER = 1 << 23
_SMALL = 4_096
#: Longest words of the person who stops, in characters.
MAX_WHY = 200

#: A client's own name for a proposal: the same key is the same proposal.
Key = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_-]{1,64}\Z")]


class ClientRole(StrEnum):
    """What a client may do; the peer's user decides which roles it may take."""

    PLANNER = "planner"
    OPERATOR = "operator"
    ESTIMATOR = "estimator"
    CONTROLLER = "controller"
    AUDITOR = "auditor"
    #: the gate itself, at the stop process; only the stop process's own user may take it
    GATE = "gate"


#: Roles whose stop suspends the mission.
SUSPENDING = frozenset({ClientRole.OPERATOR})


class Mode(StrEnum):
    """Whether the gate holds the controller, or only says what it would have done."""

    ENFORCE = "enforce"
    SHADOW = "shadow"


class Kind(IntEnum):
    """What a frame's body is."""

    HELLO = 1
    WELCOME = 2
    ERROR = 3
    REPLY = 4
    EVENT = 5
    # a planner's
    PROPOSE = 16
    OBSERVE = 17
    SAMPLE = 18
    CLOSE = 19
    #: a planner's or an operator's
    EMERGENCY = 20
    # an estimator's
    SNAPSHOT = 32
    # to a controller
    DISPATCH = 48
    RENEW = 49
    HALT = 50
    FORWARD = 51
    # from a controller
    BEGUN = 56
    ENDED = 57
    STOOD = 58
    RESULT = 59
    # an operator's
    ORDER = 64
    EVALUATE = 65
    # an operator's or an auditor's
    STATUS = 80
    RECORDS = 81
    WATCH = 82
    METRICS = 83
    EXPLAIN = 84
    APPROVALS = 85
    # the stop process's
    STOP = 96
    #: the gate's, to the stop process: a stop is recorded
    HEARD = 97
    #: the gate's, to the stop process: which stops were there before this
    SYNC = 98


class _Message(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A message; what its kind does not have is refused."""


class Hello(_Message, frozen=True, kw_only=True):
    """The first message of a client.

    Args:
        protocol: `PROTOCOL`.
        role: what the client wants to be here.
        client: its name in the log, under its user.
        nonce: fresh random bytes; the gate proves with them that it holds its key.
    """

    protocol: str
    role: ClientRole
    client: Identifier
    nonce: Annotated[Base64Url, Meta(min_length=22, max_length=86)] | None = None


class Welcome(_Message, frozen=True, kw_only=True):
    """The gate's answer to a hello that it takes.

    Args:
        protocol: `PROTOCOL`.
        robot: whose gate this is.
        mode: `shadow` releases nothing.
        role: as asked for.
        client: as asked for.
        site: digest of the site model; the stop process knows none.
        binding: digest of the binding by which it reads planners; the stop process knows none.
        proof: token of a `Proof`, when there was a nonce.
    """

    protocol: str
    robot: RobotId
    mode: Mode
    role: ClientRole
    client: Identifier
    site: Digest | None = None
    binding: Digest | UnsetType = UNSET
    proof: str | None = None


class Proof(_Message, frozen=True, kw_only=True):
    """What the gate signs so that a client trusts it (`Tag.HANDSHAKE`)."""

    robot: RobotId
    role: ClientRole
    nonce: Base64Url


class FaultFamily(StrEnum):
    """Which of the errors a fault is (`core.errors`): what an exit code follows."""

    MALFORMED = "malformed"
    AUTHENTICITY = "authenticity"
    REFUSED = "refused"
    CLARIFICATION = "clarification"
    ENVIRONMENT = "environment"


class Fault(_Message, frozen=True, kw_only=True):
    """Why a request, or a connection with id 0, was refused.

    Args:
        code: a reason.
        message: what was expected and found; holds no secrets.
        where: the place in the input, empty when there is none.
        family: which error it is; without one it is the code's usual.
    """

    code: str
    message: str
    where: str
    family: FaultFamily | None = None


class Propose(_Message, frozen=True, kw_only=True):
    """A plan as the planner wrote it.

    Args:
        key: idempotency key; a repeat gets the recorded decision and outcome.
        plan: the exact bytes.
        dialect: how they are written.
        repair: decide the repair that the safety gate offers of a step, too.
    """

    key: Key
    plan: bytes
    dialect: str = "auto"
    repair: bool = False


class Observe(_Message, frozen=True, kw_only=True):
    """Something that the planner was shown, with the channel that it came by."""

    channel: str
    text: str


class Sample(_Message, frozen=True, kw_only=True):
    """One command of an open stream: parameter values in the action type's units."""

    ticket: Digest
    params: dict[str, Integer]


class Close(_Message, frozen=True, kw_only=True):
    """The end of a stream."""

    ticket: Digest


class Emergency(_Message, frozen=True, kw_only=True):
    """A call for a capability of the emergency policy; everything else about it is signed.

    Args:
        key: names the call; a repeat gets the same answer.
        capability: which.
    """

    key: Key
    capability: Identifier


class Attest(_Message, frozen=True, kw_only=True):
    """A signed snapshot."""

    token: bytes


class Fence(_Message, frozen=True, kw_only=True):
    """An event for an estimator, which answers no request: measure anew.

    Args:
        fence: what is measured after this came carries the number.
    """

    fence: Count


class OrderKind(StrEnum):
    """What an order is about; the token says the rest."""

    ACTIVATE = "activate"
    #: a mission that is handed in and not activated
    ISSUE = "issue"
    COMMAND = "command"
    SELECT = "select"
    APPROVE = "approve"
    TEMPLATE = "template"
    #: a signed revocation list; anyone may bring it
    REVOCATIONS = "revocations"
    #: a signed order to go on with a store that was put back
    ACCEPT_STORE = "accept_store"
    #: a signed order to destroy sealed fields of the log
    SHRED = "shred"


class Order(_Message, frozen=True, kw_only=True):
    """A signed act of management.

    Args:
        act: which kind of token follows.
        token: the signed bytes.
        confirmation: for `activate` and `issue`, the record of the signing.
        why: for `approve`, the approver's words; they go into the log and to no planner.
    """

    act: OrderKind
    token: bytes
    confirmation: bytes | None = None
    why: Annotated[str, Meta(max_length=2_000)] = ""


class Evaluate(_Message, frozen=True, kw_only=True):
    """A what-if: a plan that is judged and not carried out."""

    plan: bytes
    dialect: str = "auto"


class Nothing(_Message, frozen=True, kw_only=True):
    """A request that needs no words."""


class Records(_Message, frozen=True, kw_only=True):
    """A page of the log."""

    first: Count
    count: Annotated[int, Meta(ge=1, le=1_000)] = 100


class Explain(_Message, frozen=True, kw_only=True):
    """A question about one record; without a number, about the last refusal."""

    seq: Count | None = None


class Approvals(_Message, frozen=True, kw_only=True):
    """A question about open approval requests; without a number, about all of them."""

    counter: Positive | None = None


class Dispatch(_Message, frozen=True, kw_only=True):
    """A released action for the controller.

    Args:
        ticket: the release; everything about it carries it.
        action: what both gates accepted.
        max_ms: longest time that the lease lasts.
        renew_within_ms: without a renewal for this long the controller stops by itself.
        life: the start of the controller that `stops` counts from, as it said with `Stood`; 0
            when it has not. A controller that was started another time refuses the action.
        stops: the last stop that the gate has heard of; a controller that knows a later one
            refuses the action.
    """

    ticket: Digest
    action: Action
    max_ms: Count
    renew_within_ms: Count
    life: Count
    stops: Count


class Renew(_Message, frozen=True, kw_only=True):
    """The lease still holds."""

    ticket: Digest


class Halt(_Message, frozen=True, kw_only=True):
    """Brake and hold."""


class Forward(_Message, frozen=True, kw_only=True):
    """A checked sample of a stream, rebuilt, or zero."""

    ticket: Digest
    params: dict[str, Integer]


class Begun(_Message, frozen=True, kw_only=True):
    """The controller has begun an action."""

    ticket: Digest


class Ended(_Message, frozen=True, kw_only=True):
    """How an action ended, as the controller says.

    Args:
        ticket: the release.
        outcome: `not_started` only before any motion.
        used: what it used.
        why: a code when it did not go as it should.
    """

    ticket: Digest
    outcome: Outcome
    used: Spend = Spend()
    why: str = ""

    def __post_init__(self) -> None:
        """Require counts: a controller that used less than nothing would give budget back.

        Raises:
            ValueError: a value below 0, or none that signed data can hold.
        """
        used = (self.used.motion_ms, self.used.wait_ms, self.used.recorded_bytes)
        if not all(0 <= value <= MAX_INTEGER for value in used):
            raise ValueError(f"expected counts up to {MAX_INTEGER} in `used`")


class Result(_Message, frozen=True, kw_only=True):
    """What an action brought to light while it ran, for the planner that proposed it.

    It passes through the gate, which notes what the planner is about to see before it is sent.

    Args:
        ticket: the release.
        content: what the planner sees, as its front writes it; the gate does not look in.
        texts: every word of it that a model could read.
    """

    ticket: Digest
    content: bytes
    texts: tuple[str, ...] = ()


class Stood(_Message, frozen=True, kw_only=True):
    """The robot stands after a stop.

    Args:
        stops: how many stops the controller has carried out since it started, this one included.
        life: a number of this start of the controller, and of no other: a count of another start
            says nothing. 0 when it does not tell its starts apart; no gate goes by such a count.
    """

    stops: Count
    life: Count = 0


class Stop(_Message, frozen=True, kw_only=True):
    """Brake and hold, for every client of the stop process or the gate.

    Args:
        why: for the log; explains, decides nothing.
        key: names the stop. A client sends one stop to both, and the log has it once.
    """

    why: Annotated[str, Meta(max_length=MAX_WHY)] = ""
    key: Annotated[str, Meta(max_length=64)] = ""


class Stopped(_Message, frozen=True, kw_only=True):
    """The state of a stop (the `REPLY` to `STOP`).

    Args:
        stopped: every controller that received it has confirmed that the robot stands; false says
            that it was not confirmed, not that the robot moves.
        controller: at least one controller was connected, and received it.
        after_ms: from the request to this answer.
    """

    stopped: bool
    controller: bool
    after_ms: Count


class StopHeard(_Message, frozen=True, kw_only=True):
    """A stop that was carried out, for the gate's log (the stop process's `EVENT`).

    Args:
        epoch: when the stop process that heard it started, milliseconds since 1970, and in any
            case more than an earlier stop process's; with `n` it is the stop's name, and the same
            name twice is the same stop.
        n: grows from stop to stop, in the order in which they came.
        by: the client's own name.
        uid: its user, as the kernel says.
        role: what it was there.
        time_ms: the stop process's wall clock when it came.
        why: the client's words; explain, decide nothing.
        stood_ms: after how long the robot stood, the longest of all; null when one of them was not
            confirmed in time.
        stops: the controller's count of stops with this one, or with the last of all that was
            confirmed; null when none was.
        life: the start of the controller that `stops` counts from, 0 when it is not known.
        more: later stops of the same user and role that were folded into this one.
        key: the client's own name for the stop; empty: it gave none.
    """

    epoch: Count
    n: Positive
    by: Identifier
    uid: Count
    role: ClientRole
    time_ms: Count
    why: str
    stood_ms: Count | None
    stops: Count | None = None
    life: Count = 0
    more: Count = 0
    key: str = ""


class Heard(_Message, frozen=True, kw_only=True):
    """The stop of this number, and no other, is recorded; the stop process may forget it."""

    n: Positive


#: Which message a kind's body is, for requests.
BODY: dict[Kind, type[Any]] = {
    Kind.HELLO: Hello,
    Kind.PROPOSE: Propose,
    Kind.OBSERVE: Observe,
    Kind.SAMPLE: Sample,
    Kind.CLOSE: Close,
    Kind.EMERGENCY: Emergency,
    Kind.SNAPSHOT: Attest,
    Kind.BEGUN: Begun,
    Kind.ENDED: Ended,
    Kind.STOOD: Stood,
    Kind.RESULT: Result,
    Kind.ORDER: Order,
    Kind.EVALUATE: Evaluate,
    Kind.STATUS: Nothing,
    Kind.RECORDS: Records,
    Kind.WATCH: Nothing,
    Kind.METRICS: Nothing,
    Kind.EXPLAIN: Explain,
    Kind.APPROVALS: Approvals,
    Kind.STOP: Stop,
    Kind.HEARD: Heard,
    Kind.SYNC: Nothing,
}

#: Longest body of a request, in bytes.
BOUND: dict[Kind, int] = {
    Kind.HELLO: MAX_HELLO,
    Kind.PROPOSE: 1 << 19,  # a plan of 256 KiB, base64
    Kind.OBSERVE: 1 << 17,
    Kind.SAMPLE: _SMALL,
    Kind.CLOSE: _SMALL,
    Kind.EMERGENCY: _SMALL,
    Kind.SNAPSHOT: 1 << 17,
    Kind.BEGUN: _SMALL,
    Kind.ENDED: _SMALL,
    Kind.STOOD: _SMALL,
    Kind.RESULT: 1 << 20,
    Kind.ORDER: 1 << 22,
    Kind.EVALUATE: 1 << 19,
    Kind.STATUS: _SMALL,
    Kind.RECORDS: _SMALL,
    Kind.WATCH: _SMALL,
    Kind.METRICS: _SMALL,
    Kind.EXPLAIN: _SMALL,
    Kind.APPROVALS: _SMALL,
    Kind.STOP: _SMALL,
    Kind.HEARD: _SMALL,
    Kind.SYNC: _SMALL,
}

#: What each role may ask of the gate.
MAY: dict[ClientRole, frozenset[Kind]] = {
    ClientRole.PLANNER: frozenset(
        {Kind.PROPOSE, Kind.OBSERVE, Kind.SAMPLE, Kind.CLOSE, Kind.EMERGENCY, Kind.STOP}
    ),
    ClientRole.OPERATOR: frozenset(
        {Kind.ORDER, Kind.EVALUATE, Kind.STATUS, Kind.RECORDS, Kind.WATCH, Kind.METRICS}
        | {Kind.EXPLAIN, Kind.APPROVALS, Kind.EMERGENCY, Kind.STOP}
    ),
    ClientRole.ESTIMATOR: frozenset({Kind.SNAPSHOT, Kind.STOP}),
    ClientRole.CONTROLLER: frozenset({Kind.BEGUN, Kind.ENDED, Kind.STOOD, Kind.RESULT}),
    ClientRole.AUDITOR: frozenset(
        {Kind.STATUS, Kind.RECORDS, Kind.WATCH, Kind.METRICS, Kind.EXPLAIN, Kind.APPROVALS}
        | {Kind.STOP}
    ),
    ClientRole.GATE: frozenset({Kind.HEARD, Kind.SYNC}),
}


def opening_bound(kind: int) -> int:
    """Return the longest body before the client is known: a hello's, and nothing else's."""
    return MAX_HELLO if kind == Kind.HELLO else 0


def request_bound(role: ClientRole) -> dict[int, int]:
    """Return the longest body of each kind that the role may send; what is absent may not come."""
    return {int(kind): BOUND[kind] for kind in MAY[role]}
