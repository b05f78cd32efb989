# SPDX-License-Identifier: Apache-2.0
"""Streams of frames, right and wrong, and what becomes of each: one list for vectors and tests.

Bodies are made from the messages' own definitions, so that a new field of a message is in the
vectors as soon as they are generated again. Schema: vectors/README.md
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.wire.frames import FrameReader, frame, raw_frame, read_body
from authguard_r.wire.messages import (
    BODY,
    BOUND,
    MAY,
    PROTOCOL,
    ClientRole,
    Dispatch,
    Fault,
    Forward,
    Halt,
    Hello,
    Kind,
    Nothing,
    Renew,
    StopHeard,
    Stopped,
    Welcome,
    opening_bound,
    request_bound,
)

#: What a gate and a lane send, beside what they are sent.
SENT: dict[str, tuple[Kind, type[msgspec.Struct]]] = {
    "WELCOME": (Kind.WELCOME, Welcome),
    "ERROR": (Kind.ERROR, Fault),
    "DISPATCH": (Kind.DISPATCH, Dispatch),
    "RENEW": (Kind.RENEW, Renew),
    "HALT": (Kind.HALT, Halt),
    "FORWARD": (Kind.FORWARD, Forward),
    "REPLY to STOP": (Kind.REPLY, Stopped),
    "REPLY to SYNC": (Kind.REPLY, Nothing),
    "EVENT of a stop": (Kind.EVENT, StopHeard),
}
KINDS: dict[str, tuple[Kind, type[msgspec.Struct]]] = {
    **{kind.name: (kind, body) for kind, body in BODY.items()},
    **SENT,
}
_TICKET = "A" * 43
#: What fields of these names hold; every other is the least that its type allows.
_NAMED: dict[str, Any] = {
    "protocol": PROTOCOL,
    "role": "planner",
    "client": "vector",
    "robot": "courier-1",
    "nonce": "A" * 22,
    "proof": "a token",
    "site": _TICKET,
    "binding": _TICKET,
    "key": "vector-1",
    "plan": "c2NhbigpCg==",
    "token": "e30=",
    "confirmation": "e30=",
    "ticket": _TICKET,
    "params": {"speed_mm_s": 500},
    "channel": "camera",
    "code": "BUSY",
    "by": "vector",
    "used": {"motion_ms": 1_000},
    "action": msgspec.to_builtins(Action(type="wait", tool="base", params={"wait_ms": 1_000})),
}


def message(kind: type[msgspec.Struct], *, is_full: bool) -> dict[str, Any]:
    """Return a valid body of a message: with what it must have, or with everything it may."""
    fields = msgspec.inspect.type_info(kind).fields  # type: ignore[attr-defined]
    return {
        field.encode_name: _NAMED[field.encode_name]
        if field.encode_name in _NAMED
        else least(field.type)
        for field in fields
        if field.required or is_full
    }


def least(kind: Any) -> Any:
    """Return the least value of a type, as `msgspec.inspect` describes it.

    Raises:
        TypeError: a kind of type that no message had so far.
    """
    inspect = msgspec.inspect
    if isinstance(kind, inspect.UnionType):
        return least(next(t for t in kind.types if not isinstance(t, inspect.NoneType)))
    plain = {inspect.StrType: "x", inspect.BytesType: "", inspect.BoolType: False}
    if isinstance(kind, inspect.IntType):
        return kind.ge or 0
    if isinstance(kind, inspect.EnumType):
        return next(iter(kind.cls)).value
    if isinstance(kind, inspect.VarTupleType):
        return [least(kind.item_type)]
    if type(kind) not in plain:
        raise TypeError(kind)
    return plain[type(kind)]


def accepted() -> Iterator[dict[str, Any]]:
    """Yield each message, as short and as long as it may be, with the exact bytes of its frame."""
    for name, (kind, body) in KINDS.items():
        for is_full in (False, True):
            said = message(body, is_full=is_full)
            text = msgspec.json.encode(said)
            yield {
                "name": f"{name}, {'every field' if is_full else 'no field that may be absent'}",
                "kind": int(kind),
                "message": body.__name__,
                "id": 1,
                "body": said,
                "read": msgspec.to_builtins(read_body(text, body)),
                "hex": raw_frame(kind, 1, text).hex(),
            }


def bodies() -> Iterator[dict[str, Any]]:
    """Yield bodies that are not quite a message, with what becomes of each."""
    for name, (_, body) in KINDS.items():
        said = message(body, is_full=True)
        yield bad(f"{name}: an unknown field", body, json.dumps({**said, "authority": 1}))
        yield bad(f"{name}: a list", body, json.dumps([said]))
        for field in message(body, is_full=False):
            less = {other: value for other, value in said.items() if other != field}
            yield bad(f"{name}: without `{field}`", body, json.dumps(less))
        for field in said:
            for wrong in ([], 1.5):
                text = json.dumps({**said, field: wrong})
                yield bad(f"{name}: `{field}` is {wrong}", body, text)
    yield from texts()


def texts() -> Iterator[dict[str, Any]]:
    """Yield texts that are no JSON, no object, or one in more than one way."""
    records, sample = BODY[Kind.RECORDS], BODY[Kind.SAMPLE]
    first = '{"first":%s}'
    params = '{"ticket":"' + _TICKET + '","params":{"x":%s}}'
    numbers = ("NaN", "Infinity", "-Infinity", "1.0", "1e2", "1e400", "01", "+1", "true", '"1"')
    for number in (*numbers, "-1", "9007199254740992", "9" * 400):
        yield bad(f"the number {number[:20]}", records, first % number)
    for number in ("9007199254740992", "-9007199254740992", "9" * 400, "1.0"):
        yield bad(f"a parameter of {number[:20]}", sample, params % number)
    yield bad("nothing", Nothing, "")
    yield bad("half an object", records, '{"first":')
    yield bad("two objects", records, '{"first":1}{}')
    yield bad("a byte order mark", records, "\ufeff" + first % 1)
    yield bad("a comment", records, '{"first":1/**/}')
    yield bad("deep lists", records, first % ("[" * 500 + "]" * 500))
    yield bad("deep objects", records, first % ('{"a":' * 500 + "1" + "}" * 500))
    yield bad("a key twice, the first of a wrong type", records, '{"first":"x","first":2}')
    observe = BODY[Kind.OBSERVE]
    yield bad("not UTF-8", observe, b'{"channel":"\xff","text":""}')
    yield bad("half a surrogate", observe, '{"channel":"\\ud800","text":""}')
    yield bad("not base64", BODY[Kind.SNAPSHOT], '{"token":"_-8="}')
    yield bad("a role that there is not", Hello, json.dumps({**hello(), "role": "king"}))
    twice = '{"first":1,"first":2}'
    read = msgspec.to_builtins(read_body(twice.encode(), records))
    yield {
        "name": "a key twice: the last counts, for nothing in a message carries authority",
        "message": records.__name__,
        "hex": twice.encode().hex(),
        "expect": {"read": read},
    }


def bad(name: str, body: type[msgspec.Struct], text: str | bytes) -> dict[str, Any]:
    """Return one body that is refused."""
    data = text.encode() if isinstance(text, str) else text
    expect: dict[str, Any]
    try:
        expect = {"read": msgspec.to_builtins(read_body(data, body))}
    except MalformedError as error:
        expect = {"error": str(error.reason), "where": error.where}
    return {"name": name, "message": body.__name__, "hex": data.hex(), "expect": expect}


def hello(**changes: Any) -> dict[str, Any]:
    """Return a hello as plain data, with something changed."""
    return {"protocol": PROTOCOL, "role": "planner", "client": "vector", **changes}


def streams() -> Iterator[dict[str, Any]]:
    """Yield streams with who sends them, in which chunks, and what is cut from them."""
    for number in sorted({*map(int, Kind), 0, 6, 255} - {int(Kind.HELLO)}):
        yield stream(f"kind {number} before hello", None, [header(0, number)])
    for role in ClientRole:
        bounds = request_bound(role)
        for kind in Kind:
            if int(kind) not in bounds:
                yield stream(f"{kind.name} of a {role}", role, [header(0, kind)])
        yield stream(f"an unknown kind of a {role}", role, [header(0, 255)])
        for kind in sorted(MAY[role]):
            over = header(BOUND[kind] + 1, kind)
            yield stream(f"{kind.name} of a {role}, one byte too long", role, [over])
    yield stream("a hello, one byte too long", None, [header(BOUND[Kind.HELLO] + 1, Kind.HELLO)])
    yield stream("the longest length that a header can say", None, [header(0xFFFF_FFFF, 1)])
    yield from splits()


def splits() -> Iterator[dict[str, Any]]:
    """Yield streams that are whole, or not yet, and come in pieces."""
    auditor = ClientRole.AUDITOR
    one, two = frame(Kind.STATUS, 1, Nothing()), frame(Kind.RECORDS, 2, {"first": 3})
    longest = raw_frame(Kind.STATUS, 3, b"{}".ljust(BOUND[Kind.STATUS]))
    yield stream("exactly at the bound", auditor, [longest])
    yield stream("half a header", auditor, [one[:5]])
    yield stream("a header alone", auditor, [one[:9]])
    yield stream("half a body", auditor, [one[:-1]])
    yield stream("an empty body", auditor, [raw_frame(Kind.STATUS, 4, b"")])
    yield stream("two frames in one chunk", auditor, [one + two])
    yield stream("a frame and a half", auditor, [one + two[:-3]])
    yield stream("a frame byte by byte", auditor, [one[n : n + 1] for n in range(len(one))])
    yield stream("a border inside the second header", auditor, [one + two[:4], two[4:]])
    yield stream("a good frame, then one that may not come", auditor, [one, header(0, 64)])
    yield stream("the largest id", auditor, [frame(Kind.STATUS, 0xFFFF_FFFF, Nothing())])


def header(length: int, kind: int) -> bytes:
    """Return a header alone."""
    return struct.pack(">IBI", length, kind, 1)


def stream(name: str, role: ClientRole | None, chunks: list[bytes]) -> dict[str, Any]:
    """Return one stream of a role, None before the hello, and what a reader makes of it."""
    bounds = {} if role is None else request_bound(role)
    reader = FrameReader(opening_bound if role is None else lambda kind: bounds.get(kind, 0))
    given = {
        "name": name,
        "role": None if role is None else str(role),
        "chunks": [chunk.hex() for chunk in chunks],
    }
    return {**given, "expect": cut(reader, chunks)}


def cut(reader: FrameReader, chunks: list[bytes]) -> dict[str, Any]:
    """Return what a reader makes of chunks, in the shape of a vector."""
    frames: list[dict[str, Any]] = []
    error: dict[str, str] | None = None
    try:
        for chunk in chunks:
            reader.put(chunk)
            while (item := reader.next()) is not None:
                told = {"kind": int(item.kind), "id": item.id, "length": len(item.body)}
                frames.append(told)
    except MalformedError as fault:
        error = {"error": str(fault.reason), "where": fault.where}
    unfinished = {"unfinished": reader.unfinished} if error is None else {}
    return {"frames": frames, **(error or {}), **unfinished}


def hellos() -> Iterator[dict[str, Any]]:
    """Yield first messages, with how a gate answers each."""
    changes: dict[str, dict[str, Any]] = {
        "another version": {"protocol": "authguard-r/gate/2"},
        "an empty version": {"protocol": ""},
        "another case": {"protocol": PROTOCOL.upper()},
        "a role that the configuration does not give": {"role": "controller"},
        "the role of the gate itself": {"role": "gate"},
        "a role that there is not": {"role": "king"},
        "a name that is none": {"client": "A b"},
        "a name that is too long behind the user's": {"client": "x" * 64},
        "a short nonce": {"nonce": "AAAA"},
        "a nonce that is no base64url": {"nonce": "+" * 22},
    }
    places = {
        "protocol": ("MALFORMED", "hello.protocol"),
        "nonce": ("MALFORMED", "body"),
    }
    for name, change in changes.items():
        (field,) = change
        code, where = places.get(field, ("MALFORMED", "body"))
        if change.get("role") in {"controller", "gate"}:
            code, where = "ROLE_DENIED", "peer"
        if name.startswith("a name that is too long"):
            where = "hello.client"
        yield {
            "name": name,
            "hex": frame(Kind.HELLO, 0, hello(**change)).hex(),
            "expect": {"error": code, "where": where},
        }
    good = frame(Kind.HELLO, 0, hello()).hex()
    yield {"name": "a hello that is taken", "hex": good, "expect": {"kind": int(Kind.WELCOME)}}


def every() -> dict[str, Any]:
    """Return the content of `vectors/frames.json`."""
    return {
        "protocol": PROTOCOL,
        "bounds": {kind.name: BOUND[kind] for kind in sorted(BOUND)},
        "may": {str(role): sorted(kind.name for kind in may) for role, may in MAY.items()},
        "accepted": list(accepted()),
        "bodies": list(bodies()),
        "streams": list(streams()),
        "hellos": list(hellos()),
    }
