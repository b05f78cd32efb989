# SPDX-License-Identifier: Apache-2.0
"""One connection from its hello to its end: what is wrong with it ends it, and it alone."""

from __future__ import annotations

import asyncio
import resource
import socket
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

from authguard_r.core.errors import ControllerError, MalformedError
from authguard_r.server.sessions import ServerSession
from authguard_r.wire.frames import frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Nothing, Observe
from fixtures import frame_streams
from fixtures.cases import case
from fixtures.gate_fixtures import Door, Noted, Timers, enter, hello, settle

SEEN = frame(Kind.OBSERVE, 1, Observe(channel="camera", text="a notice"))


def in_loop(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run a test in an event loop of its own."""

    @wraps(test)
    def run(*args: Any, **named: Any) -> None:
        asyncio.run(test(*args, **named))

    return run


def wrong(hall: Noted) -> list[tuple[str, str, str]]:
    """Return what the log would say: who, why and where."""
    return [(name, str(error.reason), error.where) for name, error in hall.wrong]


@in_loop
async def test_who_says_hello_is_welcomed_and_its_requests_are_handed_on() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    (client,) = hall.here
    assert (client.role, client.name) == (ClientRole.PLANNER, f"u{client.uid}.one")
    await door.send(SEEN)
    assert [(who, item.kind, item.id) for who, item in hall.requests] == [(client, Kind.OBSERVE, 1)]
    assert door.timers.waiting() == []
    door.close()
    await settle()
    assert hall.gone == [client]
    assert client.gone
    assert hall.wrong == []


@in_loop
async def test_a_hello_and_a_request_in_the_same_bytes_are_as_good_as_apart() -> None:
    hall = Noted()
    door = await enter(hall)
    await door.send(hello() + SEEN + SEEN[:5])
    assert [item.kind for item in await door.answers()] == [Kind.WELCOME]
    assert len(hall.requests) == 1
    assert door.timers.waiting() == [LIMITS.frame_s]
    door.close()
    await settle()


def test_every_first_message_is_answered_as_published() -> None:
    for vector in frame_streams.hellos():
        with case(vector["name"]):

            async def run(vector: dict[str, Any]) -> None:
                hall = Noted()
                door = await enter(hall)
                await door.send(bytes.fromhex(vector["hex"]))
                if "kind" in vector["expect"]:
                    (answer,) = await door.answers()
                    assert answer.kind == vector["expect"]["kind"]
                else:
                    fault = await door.fault()
                    assert {"error": fault["code"], "where": fault["where"]} == vector["expect"]
                    assert (hall.here, hall.gone) == ([], [None])
                    (name, _, _), *more = wrong(hall)
                    assert (name, more) == (f"u{door.session.uid}", [])
                door.close()
                await settle()

            asyncio.run(run(vector))


def test_every_stream_is_handed_on_or_ended_as_published() -> None:
    for vector in [
        v for v in frame_streams.streams() if v["role"] in {None, "planner", "auditor", "operator"}
    ]:
        with case(vector["name"]):

            async def run(vector: dict[str, Any]) -> None:
                hall, expect = Noted(), vector["expect"]
                door = await enter(hall)
                if vector["role"] is not None:
                    await door.hello(role=vector["role"])
                await door.send(*(bytes.fromhex(chunk) for chunk in vector["chunks"]))
                got = [
                    {"kind": i.kind, "id": i.id, "length": len(i.body)} for _, i in hall.requests
                ]
                assert got == expect["frames"]
                if "error" in expect:
                    fault = await door.fault()
                    assert (fault["code"], fault["where"]) == (expect["error"], expect["where"])
                else:
                    assert await door.answers() == []
                    assert bool(door.timers.waiting()) is expect["unfinished"]
                door.close()
                await settle()
                assert len(hall.wrong) == int("error" in expect or expect["unfinished"])
                assert len(hall.gone) == 1

            asyncio.run(run(vector))


@in_loop
async def test_who_has_no_place_is_told_and_let_go() -> None:
    hall = Noted(full=ControllerError("a controller is connected already"))
    door = await enter(hall)
    await door.send(hello())
    assert (await door.fault())["code"] == "CONTROLLER_FAILED"
    assert (hall.here, hall.gone) == ([], [None])
    door.close()


@in_loop
async def test_one_connection_too_many_of_a_user_is_refused_before_it_says_anything() -> None:
    hall = Noted(connections=64)
    door = await enter(hall)
    assert (await door.fault())["code"] == "BUSY"
    assert wrong(hall) == [(f"u{door.session.uid}", "BUSY", "connection")]
    door.close()


@in_loop
async def test_a_connection_for_which_the_process_has_no_files_is_refused() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    hall = Noted()
    pair = socket.socketpair(socket.AF_UNIX)
    resource.setrlimit(resource.RLIMIT_NOFILE, (pair[0].fileno() + 20, hard))
    try:
        door = await Door(hall, pair).open()
        assert (await door.fault())["message"] == "too many connections"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    door.close()


@in_loop
async def test_who_is_there_is_asked_of_the_kernel_or_nobody_is() -> None:
    hall = Noted()
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    door = await Door(hall, (theirs, ours)).open()
    assert (await door.fault())["code"] == "ROLE_DENIED"
    assert wrong(hall) == [("unknown", "ROLE_DENIED", "peer")]
    door.close()


# time


@in_loop
async def test_no_hello_in_time_ends_it_however_many_bytes_came() -> None:
    hall = Noted()
    door = await enter(hall)
    await door.send(*(hello()[at : at + 1] for at in range(20)))
    assert door.timers.waiting() == [LIMITS.hello_s]
    door.timers.fire()
    assert (await door.fault())["where"] == "hello"
    assert wrong(hall) == [(f"u{door.session.uid}", "MALFORMED", "hello")]
    door.close()


@in_loop
async def test_a_frame_that_does_not_end_in_time_ends_it_however_it_trickles() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    await door.send(*(SEEN[at : at + 1] for at in range(12)))
    assert door.timers.waiting() == [LIMITS.frame_s]
    door.timers.fire()
    assert (await door.fault())["message"] == "a message did not end in time"
    door.close()


@in_loop
async def test_each_frame_has_its_own_time() -> None:
    door = await (await enter(Noted())).hello()
    await door.send(SEEN[:5])
    first = door.session._frame_timer
    await door.send(SEEN[5:] + SEEN[:3])
    assert door.session._frame_timer is not first
    assert door.timers.waiting() == [LIMITS.frame_s]
    await door.send(SEEN[3:])
    assert door.timers.waiting() == []
    door.close()
    await settle()


@in_loop
async def test_while_nothing_is_read_the_rest_of_a_frame_is_not_waited_for() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    await door.send(SEEN[:5])
    door.session.pause()
    assert door.timers.waiting() == []
    await door.send(SEEN[5:])
    assert hall.requests == []
    door.session.resume()
    assert door.timers.waiting() == [LIMITS.frame_s]
    await settle()
    assert len(hall.requests) == 1
    assert door.timers.waiting() == []
    door.close()
    await settle()


@in_loop
async def test_a_frame_that_makes_reading_pause_starts_no_time_for_the_next() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    door.session.pause()
    door.session._buffer[:5] = SEEN[:5]
    door.session.buffer_updated(5)  # it was read already
    assert door.timers.waiting() == []
    door.close()
    door.session.resume()
    await settle()
    assert wrong(hall)[-1][2] == "frame"


# reading


@in_loop
async def test_who_does_not_read_is_put_aside_and_dropped_and_nobody_waits_for_it() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    (client,) = hall.here
    client.reply(1, {"text": "x" * (3 << 20)})
    assert client.clogged
    assert door.timers.waiting() == [LIMITS.read_s]
    door.timers.fire()
    await settle()
    assert wrong(hall) == [(client.name, "BUSY", "connection")]
    assert (client.gone, client.clogged, hall.gone) == (True, False, [client])
    assert hall.read_again == [client]
    door.close()


@in_loop
async def test_who_reads_in_time_goes_on() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    (client,) = hall.here
    client.reply(1, {"text": "x" * (3 << 20)})
    (answer,) = await door.answers()
    assert len(answer.body) > 3 << 20
    assert not client.clogged
    assert door.timers.waiting() == []
    assert hall.read_again == [client]
    door.close()
    await settle()
    assert hall.wrong == []


@in_loop
async def test_who_breaks_off_and_does_not_take_what_waits_is_not_waited_for_either() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    (client,) = hall.here
    client.reply(1, {"text": "x" * (3 << 20)})
    await door.send(raw_frame(Kind.ORDER, 1, b""))
    assert hall.gone == []  # what waits for it could still be taken
    assert door.timers.waiting() == [LIMITS.read_s]
    door.timers.fire()
    await settle()
    assert hall.gone == [client]
    assert wrong(hall) == [(client.name, "MALFORMED", "frame.kind")]
    door.close()


@in_loop
async def test_what_waits_may_be_taken_after_the_end() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    (client,) = hall.here
    client.reply(1, {"text": "x" * (3 << 20)})
    door.session.end()
    got = await door.answers()
    assert [item.kind for item in got] == [Kind.REPLY]
    assert door.is_closed
    assert hall.gone == [client]
    assert hall.wrong == []
    door.close()


# ends


def test_half_a_message_at_the_end_is_in_the_log() -> None:
    for length in range(1, len(SEEN)):
        with case(length):

            async def run(length: int) -> None:
                hall = Noted()
                door = await (await enter(hall)).hello()
                await door.send(SEEN[:length])
                door.close()
                await settle()
                assert wrong(hall) == [(hall.here[0].name, "MALFORMED", "frame")]
                assert hall.gone == hall.here

            asyncio.run(run(length))


@in_loop
async def test_nothing_that_comes_behind_the_fault_is_taken() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    await door.send(SEEN + frame(Kind.STATUS, 2, Nothing()) + SEEN)
    assert len(hall.requests) == 1
    assert (await door.fault())["where"] == "frame.kind"
    assert hall.here[0].gone
    door.close()


@in_loop
async def test_a_session_that_is_over_takes_nothing_more() -> None:
    hall = Noted()
    door = await (await enter(hall)).hello()
    door.session.end()
    sent = len(hall.requests)
    door.session._buffer[: len(SEEN)] = SEEN
    door.session.buffer_updated(len(SEEN))
    door.session.write(SEEN)
    door.session.pause()
    door.session.resume()
    door.session.pause_writing()
    door.session.resume_writing()
    assert len(hall.requests) == sent
    assert not hall.here[0].clogged
    assert await door.answers() == []
    door.close()


@in_loop
async def test_a_session_without_a_connection_does_nothing() -> None:
    hall, timers = Noted(), Timers()
    session = ServerSession(hall, timers.later)
    session.write(SEEN)
    session.pause()
    session.resume()
    session.pause_writing()
    session.resume_writing()
    session.end()
    session.drop("it is nowhere")
    session._refuse(MalformedError("nothing"))
    assert timers.waiting() == []
    assert len(hall.wrong) == 2
