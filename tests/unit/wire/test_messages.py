# SPDX-License-Identifier: Apache-2.0
"""Messages: each comes back as it went, and every request has a body, a bound and a sender."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER, Digest
from authguard_r.core.standing import Outcome, Spend
from authguard_r.wire import messages
from authguard_r.wire.frames import FrameReader, frame, read_body
from authguard_r.wire.messages import (
    BODY,
    BOUND,
    MAX_HELLO,
    MAY,
    ClientRole,
    Ended,
    Kind,
    Sample,
    opening_bound,
    request_bound,
)
from fixtures.cases import case

TICKET = Digest("A" * 43)
#: What a gate or a lane sends and nobody may send to it.
ANSWERS = {Kind.WELCOME, Kind.ERROR, Kind.REPLY, Kind.EVENT}
PUSHED = {Kind.DISPATCH, Kind.RENEW, Kind.HALT, Kind.FORWARD}
#: Words that anything may be filled with; what a struct holds them to, its constraints say.
WORDS = {"role": "planner", "robot": "courier-1", "mode": "enforce", "by": "x", "client": "x"}
STRUCTS = [
    item
    for item in vars(messages).values()
    if isinstance(item, type) and issubclass(item, messages._Message) and item.__name__[0] != "_"
]


def sample_of(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the shortest valid body of a message, from what its fields say of themselves."""
    fields = msgspec.inspect.type_info(kind).fields  # type: ignore[attr-defined]
    return {field.encode_name: value_of(field.type) for field in fields if field.required}


def value_of(kind: Any) -> Any:
    """Return a value of a type that `msgspec.inspect` describes."""
    inspect = msgspec.inspect
    if isinstance(kind, inspect.IntType):
        return max(kind.ge or 0, 0)
    if isinstance(kind, inspect.StrType):
        return {None: "x"}.get(kind.pattern, str(TICKET))[:64]
    if isinstance(kind, inspect.BytesType):
        return "AAAA"
    if isinstance(kind, inspect.EnumType):
        return next(iter(kind.cls)).value
    if isinstance(kind, inspect.DictType):
        return {}
    if isinstance(kind, inspect.UnionType):
        return None
    if isinstance(kind, inspect.BoolType):
        return False
    if isinstance(kind, inspect.StructType) and kind.cls is Action:
        return msgspec.to_builtins(Action(type="wait", tool="base"))
    raise AssertionError(kind)


def plain(kind: type[msgspec.Struct]) -> dict[str, Any]:
    said = sample_of(kind)
    lowered = {name: v.lower() if v == str(TICKET) else v for name, v in said.items()}
    tickets = {name: said[name] for name in said if name in {"ticket", "nonce", "key"}}
    return {**lowered, **{n: w for n, w in WORDS.items() if n in said}, **tickets}


def test_every_request_has_a_body_a_bound_and_somebody_who_may_send_it() -> None:
    requests = set(Kind) - ANSWERS - PUSHED
    assert set(BODY) == set(BOUND) == requests
    sent = set().union(*MAY.values())
    assert requests - sent == {Kind.HELLO}  # the first message
    movers = {ClientRole.CONTROLLER, ClientRole.GATE}
    assert all((Kind.STOP in may) is (role not in movers) for role, may in MAY.items())
    assert sent <= requests
    assert set(MAY) == set(ClientRole)


def test_nobody_may_send_what_only_a_gate_sends() -> None:
    for role, may in MAY.items():
        bounds = request_bound(role)
        assert set(bounds) == {int(kind) for kind in may}
        assert all(bounds[int(kind)] == BOUND[kind] > 0 for kind in may)
        assert not may & (ANSWERS | PUSHED | {Kind.HELLO})


@given(kind=st.integers(0, 255))
def test_before_a_hello_nothing_else_may_come(kind: int) -> None:
    assert opening_bound(kind) == (MAX_HELLO if kind == Kind.HELLO else 0)


def test_every_message_comes_back_as_it_went_and_takes_no_further_field() -> None:
    for kind in STRUCTS:
        with case(kind):
            said = plain(kind)
            message = read_body(msgspec.json.encode(said), kind)
            assert read_body(msgspec.json.encode(message), kind) == message
            with pytest.raises(MalformedError):
                read_body(msgspec.json.encode({**said, "authority": 1}), kind)
            for name in said:
                less = {other: value for other, value in said.items() if other != name}
                with pytest.raises(MalformedError):
                    read_body(msgspec.json.encode(less), kind)


@given(number=st.integers(0, 0xFFFF_FFFF), text=st.text(max_size=40))
def test_a_request_comes_through_a_stream_as_it_went(number: int, text: str) -> None:
    seen = messages.Observe(channel="camera", text=text)
    (item,) = FrameReader(lambda _: 1 << 17).feed(frame(Kind.OBSERVE, number, seen))
    assert (item.kind, item.id) == (Kind.OBSERVE, number)
    assert read_body(item.body, BODY[item.kind]) == seen


@pytest.mark.parametrize("value", [MAX_INTEGER + 1, -MAX_INTEGER - 1, 10**300])
def test_a_sample_holds_no_number_that_signed_data_could_not_hold(value: int) -> None:
    with pytest.raises(MalformedError):
        read_body(
            msgspec.json.encode({"ticket": TICKET, "params": {"x": 0}})[:-3]
            + str(value).encode()
            + b"}}",
            Sample,
        )


@pytest.mark.parametrize("field", ["motion_ms", "wait_ms", "recorded_bytes"])
@pytest.mark.parametrize("value", [-1, MAX_INTEGER + 1])
def test_a_controller_cannot_have_used_less_than_nothing_or_more_than_there_is(
    field: str, value: int
) -> None:
    body = b'{"ticket":"%s","outcome":"succeeded","used":{"%s":%d}}'
    with pytest.raises(MalformedError):
        read_body(body % (TICKET.encode(), field.encode(), value), Ended)
    with pytest.raises(ValueError, match="counts"):
        Ended(ticket=TICKET, outcome=Outcome.SUCCEEDED, used=Spend(**{field: value}))
