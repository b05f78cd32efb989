# SPDX-License-Identifier: Apache-2.0
"""Both clients against whatever may listen at a socket: a gate, a liar, a wall, a storm."""

from __future__ import annotations

import asyncio
import inspect
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import AsyncGateClient, GateClient
from authguard_r.client.handshake import Handshake
from authguard_r.client.start import begin
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    ClarificationError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.keys.trust import read_trust
from authguard_r.wire.faults import from_fault, to_fault
from authguard_r.wire.frames import HEADER_BYTES, frame, read_body
from authguard_r.wire.messages import (
    MAX_ANSWER,
    ClientRole,
    Ended,
    Fault,
    Halt,
    Hello,
    Kind,
    Mode,
    Nothing,
    OrderKind,
    Renew,
    Stood,
)
from fixtures import scenarios
from fixtures.scripted_peer import Peer, Talk, listening, welcome_of

OPERATOR, PLANNER = ClientRole.OPERATOR, ClientRole.PLANNER
CONTROLLER, ESTIMATOR = ClientRole.CONTROLLER, ClientRole.ESTIMATOR
#: Far longer than any answer takes here; only a test of waiting waits for its own.
PATIENT_MS, SHORT_MS = 30_000, 50
Face = Callable[..., Any]


def blocking(path: Path, role: ClientRole, act: Callable[[Any], Any], **how: Any) -> Any:
    """Connect, do one thing, hang up: with the client that waits."""
    with GateClient.connect(path, role=role, **({"timeout_ms": PATIENT_MS} | how)) as client:
        return act(client)


def looping(path: Path, role: ClientRole, act: Callable[[Any], Any], **how: Any) -> Any:
    """The same with the client for an event loop."""

    async def main() -> Any:
        made = await AsyncGateClient.connect(path, role=role, **({"timeout_ms": PATIENT_MS} | how))
        async with made as client:
            done = act(client)
            return await done if inspect.isawaitable(done) else done

    return asyncio.run(main())


@pytest.fixture(params=[blocking, looping], ids=["blocking", "looping"])
def face(request: pytest.FixtureRequest) -> Face:
    return request.param  # type: ignore[no-any-return]


def answering(*replies: dict[str, Any], asked: list[Any] | None = None) -> Talk:
    """Return the script of a gate that gives these answers in turn."""

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        for said in replies:
            number, message = await peer.request()
            if asked is not None:
                asked.append(message)
            peer.reply(number, **said)
        await peer.gone()

    return talk


def silent() -> Talk:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        await peer.gone()

    return talk


def caught(face: Face, path: Path, role: ClientRole, act: Any, **how: Any) -> AuthGuardError:
    with pytest.raises(AuthGuardError) as raised:
        face(path, role, act, **how)
    return raised.value


# --- what a client asks, and what it gets


@pytest.mark.parametrize(
    ("role", "act", "message"),
    [
        (OPERATOR, lambda c: c.status(), {}),
        (OPERATOR, lambda c: c.metrics(), {}),
        (OPERATOR, lambda c: c.records(3, 7), {"first": 3, "count": 7}),
        (OPERATOR, lambda c: c.explain(4), {"seq": 4}),
        (OPERATOR, lambda c: c.explain(), {"seq": None}),
        (OPERATOR, lambda c: c.evaluate(b"[]"), {"plan": b"[]", "dialect": "auto"}),
        (OPERATOR, lambda c: c.approve(b"t"), {"act": OrderKind.APPROVE, "token": b"t"}),
        (PLANNER, lambda c: c.propose(b"[]", key="k"), {"key": "k", "plan": b"[]"}),
    ],
)
def test_a_request_says_what_was_asked_and_returns_the_gate_s_answer(
    face: Face, role: ClientRole, act: Any, message: dict[str, Any]
) -> None:
    asked: list[Any] = []
    with listening(answering({"said": [1, "x"]}, asked=asked)) as path:
        assert face(path, role, act) == {"said": [1, "x"]}
    assert {name: getattr(asked[0], name) for name in message} == message


@pytest.mark.parametrize(
    ("act", "kind"),
    [
        (lambda c: c.activate(b"t", confirmation=b"c"), OrderKind.ACTIVATE),
        (lambda c: c.issue(b"t", confirmation=b"c"), OrderKind.ISSUE),
        (lambda c: c.command(b"t"), OrderKind.COMMAND),
        (lambda c: c.select(b"t"), OrderKind.SELECT),
        (lambda c: c.template(b"t", confirmation=b"c"), OrderKind.TEMPLATE),
    ],
)
def test_an_order_returns_the_standing_and_nothing_else_passes_for_one(
    face: Face, act: Any, kind: OrderKind
) -> None:
    asked: list[Any] = []
    with listening(answering({"standing": {"mid": "m"}}, asked=asked)) as path:
        assert face(path, OPERATOR, act) == {"mid": "m"}
    confirmed = kind in {OrderKind.ACTIVATE, OrderKind.ISSUE, OrderKind.TEMPLATE}
    told = (asked[0].act, asked[0].token, asked[0].confirmation)
    assert told == (kind, b"t", b"c" if confirmed else None)
    with listening(answering({"standing": None})) as path:
        assert isinstance(caught(face, path, OPERATOR, act), MalformedError)


@pytest.mark.parametrize(
    ("act", "kind", "called"),
    [
        (lambda c: c.revocations(b"l"), OrderKind.REVOCATIONS, "revocations"),
        (lambda c: c.accept_store(b"l"), OrderKind.ACCEPT_STORE, "accepted"),
        (lambda c: c.shred(b"l"), OrderKind.SHRED, "shredding"),
    ],
)
def test_what_is_no_mission_s_is_handed_in_as_it_is_and_what_became_of_it_is_told(
    face: Face, act: Any, kind: OrderKind, called: str
) -> None:
    asked: list[Any] = []
    with listening(answering({called: {"number": 2}}, asked=asked)) as path:
        assert face(path, OPERATOR, act) == {"number": 2}
    assert (asked[0].act, asked[0].token) == (kind, b"l")
    for said in ({"standing": {"mid": "m"}}, {called: None}, {}):
        with listening(answering(said)) as path:
            assert isinstance(caught(face, path, OPERATOR, act), MalformedError)


@pytest.mark.parametrize(
    ("role", "act", "message"),
    [
        (PLANNER, lambda c: c.observe("camera", "go"), {"channel": "camera", "text": "go"}),
        (ESTIMATOR, lambda c: c.attest(b"t"), {"token": b"t"}),
    ],
)
def test_what_needs_no_answer_waits_until_it_was_taken(
    face: Face, role: ClientRole, act: Any, message: dict[str, Any]
) -> None:
    asked: list[Any] = []
    with listening(answering({}, asked=asked)) as path:
        assert face(path, role, act) is None
    assert {name: getattr(asked[0], name) for name in message} == message


def test_a_plan_s_steps_are_told_as_they_are_decided_then_the_whole(face: Face) -> None:
    steps: list[dict[str, Any]] = []
    keys: list[str] = []

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        for _ in range(2):
            number, message = await peer.request()
            keys.append(message.key)
            peer.event(number, step=0)
            peer.event(number, step=1)
            peer.reply(number, planned=2)
        await peer.gone()

    with listening(talk) as path:
        told = {"planned": 2}
        assert face(path, PLANNER, lambda c: c.propose(b"[]", on_step=steps.append)) == told
        assert face(path, PLANNER, lambda c: c.propose(b"[]")) == told  # who does not listen
    assert steps == [{"step": 0}, {"step": 1}]
    assert len(keys) == 2
    assert len(set(keys)) == 2
    assert all(len(key) == 22 for key in keys)


def test_the_welcome_says_whose_gate_it_is_and_how_it_works(face: Face) -> None:
    with listening(silent()) as path:
        said = face(path, OPERATOR, lambda c: c.welcome, client="desk-1")
    assert (said.robot, said.mode, said.client) == (scenarios.RID, Mode.ENFORCE, "desk-1")


def test_answers_find_their_requests_in_any_order_and_in_pieces() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        asked = [await peer.request() for _ in range(3)]
        for number, message in reversed(asked):
            for byte in frame(Kind.REPLY, number, {"seq": message.seq}):
                peer.raw(bytes([byte]))
        await peer.gone()

    async def main(path: Path) -> list[dict[str, Any]]:
        async with await AsyncGateClient.connect(path, role=OPERATOR) as client:
            return await asyncio.gather(*(client.explain(n) for n in range(3)))

    with listening(talk) as path:
        assert asyncio.run(main(path)) == [{"seq": 0}, {"seq": 1}, {"seq": 2}]


# --- watching


def events_of(first: int, then: int) -> Talk:
    """Return a gate that answers a watch, says `first` events, then answers one more request."""

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number)
        for n in range(first):
            peer.event(number, event="state", n=n)
        other, _ = await peer.request()
        for n in range(first, first + then):
            peer.event(number, event="state", n=n)
        peer.reply(other, fine=True)
        peer.event(number, event="state", n=first + then)
        await peer.gone()

    return talk


def test_events_come_by_their_subscription_while_other_requests_are_answered() -> None:
    def act(client: GateClient) -> list[Any]:
        events = client.watch(idle_ms=PATIENT_MS)
        seen: list[Any] = [next(events), client.status()]
        return seen + [next(events) for _ in range(3)]

    with listening(events_of(2, 1)) as path:
        seen = blocking(path, OPERATOR, act)
    assert seen[1] == {"fine": True}
    assert [item["n"] for item in (seen[0], *seen[2:])] == [0, 1, 2, 3]


def test_events_come_by_their_subscription_in_a_loop_too() -> None:
    async def act(client: AsyncGateClient) -> list[Any]:
        seen: list[Any] = []
        async for event in await client.watch(idle_ms=PATIENT_MS):
            seen.append(event["n"])
            if len(seen) == 1:
                seen.append(await client.status())
            if len(seen) == 5:
                break
        return seen

    with listening(events_of(2, 1)) as path:
        assert looping(path, OPERATOR, act) == [0, {"fine": True}, 1, 2, 3]


def test_events_that_nobody_watches_any_more_are_dropped() -> None:
    def act(client: GateClient) -> Any:
        events = client.watch()
        next(events)
        events.close()  # type: ignore[attr-defined]
        return client.status()

    with listening(events_of(1, 50)) as path:
        assert blocking(path, OPERATOR, act) == {"fine": True}


def test_a_watch_that_hears_nothing_ends_when_it_was_told_to() -> None:
    async def asynchronously(client: AsyncGateClient) -> Any:
        return [event async for event in await client.watch(idle_ms=SHORT_MS)]

    for face, act in (
        (blocking, lambda c: list(c.watch(idle_ms=SHORT_MS))),
        (looping, asynchronously),
    ):
        with listening(answering({})) as path:
            error = caught(face, path, OPERATOR, act)
        assert isinstance(error, EnvironmentFault)
        assert "within 50 ms" in error.message


def test_a_refused_watch_is_the_refusal(face: Face) -> None:
    with listening(refusing("ROLE_DENIED")) as path:
        error = caught(face, path, OPERATOR, lambda c: c.watch())
    assert isinstance(error, AuthenticityError)


def test_a_watch_ends_with_the_gate_s_reason() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number)
        peer.fault(number, "BUSY")
        await peer.gone()

    with listening(talk) as path:
        error = caught(blocking, path, OPERATOR, lambda c: list(c.watch()))
    assert (type(error), error.reason) == (EnvironmentFault, Reason.BUSY)


# --- refusals keep their type


def refusing(code: str, **more: Any) -> Talk:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.fault(number, code, **more)
        await peer.gone()

    return talk


@pytest.mark.parametrize(
    ("code", "family", "kind"),
    [
        ("MALFORMED", None, MalformedError),
        ("SCHEMA_INVALID", None, MalformedError),
        ("INPUT_TOO_LARGE", None, MalformedError),
        ("ROLE_DENIED", None, AuthenticityError),
        ("SIGNATURE_INVALID", None, AuthenticityError),
        ("KEY_REUSED", None, RefusedError),
        ("REVOKED", None, RefusedError),
        ("TRANSITION_REFUSED", None, RefusedError),
        ("BUSY", None, EnvironmentFault),
        ("STORE_FULL", None, EnvironmentFault),
        ("CLARIFICATION_NEEDED", None, ClarificationError),
        ("ROLE_DENIED", "refused", RefusedError),
        ("SCHEMA_INVALID", "malformed", MalformedError),
        ("REVOCATION_STALE", "authenticity", AuthenticityError),
        ("STATE_STALE", "environment", EnvironmentFault),
        ("CLARIFICATION_NEEDED", "clarification", ClarificationError),
    ],
)
def test_a_refusal_is_the_exception_that_the_gate_raised(
    face: Face, code: str, family: str | None, kind: type[AuthGuardError]
) -> None:
    with listening(refusing(code, family=family)) as path:
        error = caught(face, path, OPERATOR, lambda c: c.status())
    assert (type(error), error.reason) == (kind, Reason(code))
    assert (error.message, error.where) == ("expected less", "here")


def test_a_code_that_is_unknown_here_keeps_its_name(face: Face) -> None:
    with listening(refusing("MOON_TOO_HIGH")) as path:
        error = caught(face, path, OPERATOR, lambda c: c.status())
    assert isinstance(error, EnvironmentFault)
    assert "MOON_TOO_HIGH" in error.message


def test_after_a_refusal_the_connection_goes_on(face: Face) -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.fault(number, "BUSY")
        number, _ = await peer.request()
        peer.reply(number, fine=True)
        await peer.gone()

    def act(client: GateClient) -> Any:
        with pytest.raises(EnvironmentFault):
            client.status()
        return client.status()

    async def asynchronously(client: AsyncGateClient) -> Any:
        with pytest.raises(EnvironmentFault):
            await client.status()
        return await client.status()

    with listening(talk) as path:
        done = face(path, OPERATOR, act if face is blocking else asynchronously)
    assert done == {"fine": True}


# --- whose gate it is


def proving(**changes: Any) -> Talk:
    async def talk(peer: Peer) -> None:
        await peer.welcome(**changes)
        await peer.gone()

    return talk


def held_to(robot: str | None = scenarios.RID) -> dict[str, Any]:
    return {"verifier": read_trust(scenarios.trust_folder()), "robot": robot}


@pytest.mark.parametrize("robot", [scenarios.RID, None])
def test_a_gate_that_holds_its_key_is_believed(face: Face, robot: str | None) -> None:
    with listening(proving()) as path:
        assert face(path, PLANNER, lambda c: c.welcome, **held_to(robot)).robot == scenarios.RID


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"proof": None}, Reason.SIGNATURE_INVALID),
        ({"proof_nonce": "A" * 22}, Reason.SIGNATURE_INVALID),
        ({"proof_role": OPERATOR}, Reason.SIGNATURE_INVALID),
        ({"proof_robot": scenarios.OTHER}, Reason.ROBOT_MISMATCH),
        ({"signer": "operator-1"}, Reason.ROLE_DENIED),
        ({"signer": f"gate-{scenarios.OTHER}"}, Reason.ROBOT_MISMATCH),
        ({"robot": scenarios.OTHER}, Reason.ROBOT_MISMATCH),
        (
            {
                "robot": scenarios.OTHER,
                "proof_robot": scenarios.OTHER,
                "signer": f"gate-{scenarios.OTHER}",
            },
            Reason.ROBOT_MISMATCH,
        ),
    ],
)
def test_a_gate_that_is_not_the_one_that_was_meant_is_not_believed(
    face: Face, changes: dict[str, Any], reason: Reason
) -> None:
    with listening(proving(**changes)) as path:
        error = caught(face, path, PLANNER, lambda c: c.welcome, **held_to())
    assert (type(error), error.reason) == (AuthenticityError, reason)


def test_another_robot_s_gate_is_refused_without_a_proof_too(face: Face) -> None:
    with listening(silent()) as path:
        error = caught(face, path, OPERATOR, lambda c: c.welcome, robot=scenarios.OTHER)
    assert (type(error), error.reason) == (AuthenticityError, Reason.ROBOT_MISMATCH)


@pytest.mark.parametrize(
    "changes",
    [
        {"protocol": "authguard-r/gate/2"},
        {"role": ClientRole.AUDITOR},
        {"client": "somebody"},
        {"proof": "x"},
    ],
)
def test_a_welcome_that_was_not_asked_for_is_malformed(face: Face, changes: dict[str, Any]) -> None:
    with listening(proving(**changes)) as path:
        error = caught(face, path, OPERATOR, lambda c: c.welcome, **held_to())
    assert isinstance(error, MalformedError)


@pytest.mark.parametrize("role", [PLANNER, CONTROLLER])
def test_a_gate_in_shadow_mode_is_refused_by_who_acts_on_it(face: Face, role: ClientRole) -> None:
    with listening(proving(mode=Mode.SHADOW)) as path:
        error = caught(face, path, role, lambda c: c.welcome)
        assert (type(error), error.reason) == (RefusedError, Reason.TRANSITION_REFUSED)
        assert "shadow" in error.message
        said = face(path, role, lambda c: c.welcome, allow_shadow=True)
    assert said.mode is Mode.SHADOW


@pytest.mark.parametrize("role", [OPERATOR, ESTIMATOR, ClientRole.AUDITOR])
def test_who_only_looks_is_welcome_at_a_gate_in_shadow_mode(face: Face, role: ClientRole) -> None:
    with listening(proving(mode=Mode.SHADOW)) as path:
        assert face(path, role, lambda c: c.welcome).mode is Mode.SHADOW


# --- nobody, walls, liars and storms


def test_where_nobody_listens_it_says_where(face: Face, tmp_path: Path) -> None:
    error = caught(face, tmp_path / "gate.sock", OPERATOR, lambda c: c.status())
    assert isinstance(error, EnvironmentFault)
    assert error.where.endswith("gate.sock")


def test_a_path_too_long_for_a_socket_is_nobody(face: Face, tmp_path: Path) -> None:
    error = caught(face, tmp_path / ("x" * 200), OPERATOR, lambda c: c.status())
    assert isinstance(error, EnvironmentFault)


@contextmanager
def full(path: Path) -> Iterator[tuple[socket.socket, socket.socket]]:
    """A listener whose queue one connection fills."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen(0)
    waiting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    waiting.connect(str(path))
    try:
        yield listener, waiting
    finally:
        waiting.close()
        listener.close()


def test_a_gate_whose_queue_stays_full_is_not_waited_for(face: Face, tmp_path: Path) -> None:
    with full(tmp_path / "gate.sock"):
        error = caught(
            face, tmp_path / "gate.sock", OPERATOR, lambda c: c.status(), timeout_ms=SHORT_MS
        )
    assert isinstance(error, EnvironmentFault)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nobody.sock", "No such file or directory; start one"),
        ("ended.sock", "Connection refused; the one that served there has ended"),
        ("x" * 120, "AF_UNIX path too long; look at the path"),
    ],
)
def test_where_no_gate_answers_the_error_says_so_in_words_and_what_to_do(
    face: Face, tmp_path: Path, name: str, told: str
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as ended:
        ended.bind(str(tmp_path / "ended.sock"))  # nobody listens
        error = caught(face, tmp_path / name, OPERATOR, lambda c: c.status())
    assert isinstance(error, EnvironmentFault)
    assert told in error.message
    assert "Errno" not in error.message
    assert error.where == str(tmp_path / name)


def test_a_gate_whose_queue_was_full_is_reached_once_there_is_room(
    face: Face, tmp_path: Path
) -> None:
    def take(listener: socket.socket) -> None:
        for _ in range(2):
            listener.accept()[0].close()

    with full(tmp_path / "gate.sock") as (listener, _):
        taker = threading.Timer(0.1, take, (listener,))  # however late: the client waits for it
        taker.start()
        error = caught(face, tmp_path / "gate.sock", OPERATOR, lambda c: c.status())
        taker.join(30)
    assert "no gate answers" not in error.message  # it was there, and hung up


def test_a_listener_that_says_nothing_is_not_waited_for(face: Face) -> None:
    async def talk(peer: Peer) -> None:
        await peer.gone()

    with listening(talk) as path:
        error = caught(face, path, OPERATOR, lambda c: c.status(), timeout_ms=SHORT_MS)
    assert isinstance(error, EnvironmentFault)
    assert "within 50 ms" in error.message


def hurried(face: Face, act: Any) -> Any:
    """Return the act, done with hardly any patience: the welcome itself was waited for."""

    def sooner(client: Any) -> Any:
        client._timeout_ms = SHORT_MS
        return act(client)

    return sooner


@pytest.mark.parametrize(
    ("role", "act"),
    [
        (OPERATOR, lambda c: c.status()),
        (PLANNER, lambda c: c.propose(b"[]", timeout_ms=SHORT_MS)),
        (OPERATOR, lambda c: c.watch()),
    ],
)
def test_an_answer_that_does_not_come_is_not_waited_for(
    face: Face, role: ClientRole, act: Any
) -> None:
    with listening(silent()) as path:
        error = caught(face, path, role, hurried(face, act))
    assert isinstance(error, EnvironmentFault)
    assert "within 50 ms" in error.message


def test_a_gate_that_does_not_read_is_not_waited_for(face: Face) -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        peer.reader._transport.pause_reading()  # type: ignore[attr-defined]
        await asyncio.Event().wait()

    def act(client: GateClient) -> None:
        for _ in range(64):
            client.evaluate(b"x" * 300_000)

    async def asynchronously(client: AsyncGateClient) -> None:
        while True:
            await client.evaluate(b"x" * 300_000)

    chosen = act if face is blocking else asynchronously
    with listening(talk) as path:
        error = caught(face, path, OPERATOR, hurried(face, chosen))
    assert isinstance(error, EnvironmentFault)
    assert "within 50 ms" in error.message


def test_a_late_answer_is_not_taken_for_the_next_one(face: Face) -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        late, _ = await peer.request()
        number, _ = await peer.request()
        peer.event(late, step=0)
        peer.reply(late, stale=True)
        peer.reply(number, fresh=True)
        await peer.gone()

    def act(client: GateClient) -> Any:
        with pytest.raises(EnvironmentFault):
            client.propose(b"[]", timeout_ms=SHORT_MS)
        return client.propose(b"[]")

    async def asynchronously(client: AsyncGateClient) -> Any:
        with pytest.raises(EnvironmentFault):
            await client.propose(b"[]", timeout_ms=SHORT_MS)
        return await client.propose(b"[]")

    with listening(talk) as path:
        done = face(path, PLANNER, act if face is blocking else asynchronously)
    assert done == {"fresh": True}


def then(*moves: Callable[[Peer, int], None], hang_up: bool = False) -> Talk:
    """Return a gate that welcomes, takes a request, and then misbehaves."""

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        for move in moves:
            move(peer, number)
        await peer.writer.drain()
        if not hang_up:
            await peer.gone()

    return talk


@pytest.mark.parametrize(
    ("talk", "kind", "said"),
    [
        (then(hang_up=True), EnvironmentFault, "closed the connection"),
        (then(lambda p, n: p.raw(b"\0\0"), hang_up=True), EnvironmentFault, "in the middle"),
        (then(lambda p, n: p.raw(b"\0\0\0\1\xee\0\0\0\1x")), MalformedError, "kind 238"),
        (then(lambda p, n: p.raw(b"\xff\xff\xff\xff\4\0\0\0\1")), MalformedError, "at most"),
        (then(lambda p, n: p.reply(n + 7)), MalformedError, "not open"),
        (then(lambda p, n: p.event(0, n=1)), MalformedError, "not open"),
        (then(lambda p, n: p.reply(0)), MalformedError, "not open"),
        (then(lambda p, n: p.raw(frame(Kind.REPLY, n, [1]))), MalformedError, "object"),
        (then(lambda p, n: p.raw(b"\0\0\0\1\4\0\0\0\1{")), MalformedError, ""),
        (then(lambda p, n: p.send(Kind.ERROR, n, {})), MalformedError, "code"),
        (then(lambda p, n: p.send(Kind.WELCOME, 0, {})), MalformedError, "second welcome"),
        (then(lambda p, n: p.send(Kind.HALT, 0, {})), MalformedError, "may not come"),
        (then(lambda p, n: p.fault(0, "BUSY")), EnvironmentFault, "expected less"),
        (then(lambda p, n: p.send(Kind.ERROR, 0, {"code": 7})), MalformedError, ""),
    ],
)
def test_a_gate_that_breaks_off_or_talks_nonsense_is_a_clear_error(
    face: Face, talk: Talk, kind: type[AuthGuardError], said: str
) -> None:
    with listening(talk) as path:
        error = caught(face, path, OPERATOR, lambda c: c.status())
    assert type(error) is kind
    assert said in error.message


def test_nothing_more_is_asked_over_a_broken_connection(face: Face) -> None:
    def act(client: GateClient) -> None:
        with pytest.raises(MalformedError):
            client.status()
        client.status()

    async def asynchronously(client: AsyncGateClient) -> None:
        with pytest.raises(MalformedError):
            await client.status()
        await client.status()

    with listening(then(lambda p, n: p.reply(n + 1))) as path:
        error = caught(face, path, OPERATOR, act if face is blocking else asynchronously)
    assert isinstance(error, MalformedError)


def test_a_second_answer_to_one_request_breaks_the_connection() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.raw(frame(Kind.REPLY, number, {}) + frame(Kind.REPLY, number, {}))
        await peer.gone()

    def act(client: GateClient) -> None:
        client.status()
        client.status()

    with listening(talk) as path:
        assert "not open" in caught(blocking, path, OPERATOR, act).message


def test_a_second_answer_to_a_subscription_breaks_the_connection() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.raw(frame(Kind.REPLY, number, {}) + frame(Kind.REPLY, number, {}))
        await peer.gone()

    with listening(talk) as path:
        error = caught(blocking, path, OPERATOR, lambda c: list(c.watch()))
    assert isinstance(error, MalformedError)


@pytest.mark.parametrize(
    ("first", "kind", "said"),
    [
        (lambda p: p.fault(0, "ROLE_DENIED"), AuthenticityError, "expected less"),
        (lambda p: p.fault(0, "BUSY"), EnvironmentFault, "expected less"),
        (lambda p: p.reply(0), MalformedError, "expected a welcome"),
        (lambda p: p.send(Kind.WELCOME, 0, {"robot": 1}), MalformedError, ""),
        (lambda p: p.raw(b"HTTP/1.1 400 Bad Request\r\n\r\n"), MalformedError, "may not come"),
    ],
)
def test_what_is_no_welcome_is_refused_for_what_it_is(
    face: Face, first: Callable[[Peer], None], kind: type[AuthGuardError], said: str
) -> None:
    async def talk(peer: Peer) -> None:
        await peer.frame()
        first(peer)
        await peer.gone()

    with listening(talk) as path:
        error = caught(face, path, OPERATOR, lambda c: c.status())
    assert type(error) is kind
    assert said in error.message


def test_what_a_gate_says_before_it_hangs_up_is_heard(face: Face) -> None:
    """A gate without room answers before it has read the hello, and lets go."""

    async def talk(peer: Peer) -> None:
        peer.fault(0, "BUSY")
        await peer.writer.drain()
        peer.writer.close()

    with listening(talk) as path:
        for _ in range(50):  # whichever side is quicker
            error = caught(face, path, OPERATOR, lambda c: c.status())
            assert (type(error), error.reason) == (EnvironmentFault, Reason.BUSY)


def test_what_a_gate_said_before_it_hung_up_is_heard_by_who_sends_too_late(face: Face) -> None:
    connected = threading.Event()

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        await asyncio.to_thread(connected.wait, 30)
        peer.fault(0, "BUSY")

    def hung_up(client: Any) -> Any:
        """Wait, the loop's own eyes closed, until the gate has gone; then ask."""
        wire = client._line if face is blocking else client._line._wire
        connected.set()
        poll = select.poll()
        poll.register(wire, 0)
        assert poll.poll(30_000)[0][1] & select.POLLHUP
        return client.status()

    with listening(talk) as path:
        error = caught(face, path, OPERATOR, hung_up)
    assert (type(error), error.reason) == (EnvironmentFault, Reason.BUSY)


def test_more_than_is_taken_ends_the_connection_not_the_memory(face: Face) -> None:
    pad = "x" * (MAX_ANSWER - 64)

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number)
        await peer.request()
        for _ in range(4):
            peer.event(number, pad=pad)
        await peer.gone()

    def act(client: GateClient) -> None:
        client.watch()
        client.status()

    async def asynchronously(client: AsyncGateClient) -> None:
        await client.watch()
        await client.status()

    with listening(talk) as path:
        error = caught(face, path, OPERATOR, act if face is blocking else asynchronously)
    assert isinstance(error, EnvironmentFault)
    assert "reads too slowly" in error.message


def test_a_gate_that_dies_with_the_request_unread_is_gone(face: Face, tmp_path: Path) -> None:
    path = tmp_path / "s"

    def die(listener: socket.socket) -> None:
        link, _ = listener.accept()
        select.select([link], [], [], 30)
        link.close()

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        thread = threading.Thread(target=die, args=(listener,))
        thread.start()
        error = caught(face, path, OPERATOR, lambda c: c.status())
        thread.join(30)
    assert isinstance(error, EnvironmentFault)
    assert "the connection failed" in error.message


def test_a_gate_that_reads_slowly_gets_it_all() -> None:
    got: list[int] = []

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        for _ in range(4):
            number, message = await peer.request()
            got.append(len(message.plan))
            peer.reply(number)
        await peer.gone()

    async def act(client: AsyncGateClient) -> None:
        await asyncio.gather(*(client.evaluate(b"x" * 300_000) for _ in range(4)))

    with listening(talk) as path:
        looping(path, OPERATOR, act)
    assert got == [300_000] * 4


def test_an_answer_that_nobody_takes_is_forgotten() -> None:
    session = begin(Handshake(role=OPERATOR, client="desk"))
    hello = read_body(session.hello()[HEADER_BYTES:], Hello)
    session.receive(frame(Kind.WELCOME, 0, welcome_of(hello)))
    number = session.request(Kind.STATUS, Nothing()).number
    session.receive(frame(Kind.REPLY, number, {}))
    session.abandon(number)
    with pytest.raises(KeyError):
        session.take(number)
    session.receive(frame(Kind.REPLY, number, {}))
    with pytest.raises(MalformedError, match="not open"):
        session.require_open()


@pytest.mark.parametrize(
    "error",
    [
        MalformedError("a", where="b", reason=Reason.SCHEMA_INVALID),
        AuthenticityError("a", where="b", reason=Reason.REVOCATION_STALE),
        RefusedError("a", where="b", reason=Reason.ROLE_DENIED),
        ClarificationError("a", field="b"),
        EnvironmentFault("a", where="b", reason=Reason.BUSY),
    ],
)
def test_an_exception_crosses_the_socket_whole(error: AuthGuardError) -> None:
    again = from_fault(read_body(frame(Kind.ERROR, 1, to_fault(error))[HEADER_BYTES:], Fault))
    assert (type(again), str(again)) == (type(error), str(error))


# --- what is never sent


def test_what_the_role_may_not_ask_is_not_sent(face: Face) -> None:
    with listening(silent()) as path:
        error = caught(face, path, PLANNER, lambda c: c.activate(b"t"))
    assert (type(error), error.reason) == (AuthenticityError, Reason.ROLE_DENIED)


def test_what_the_gate_would_not_read_is_not_sent(face: Face) -> None:
    with listening(silent()) as path:
        error = caught(face, path, PLANNER, lambda c: c.propose(b"x" * (1 << 20)))
    assert (type(error), error.reason) == (MalformedError, Reason.INPUT_TOO_LARGE)


def test_a_closed_client_asks_nothing(face: Face) -> None:
    def act(client: GateClient) -> None:
        client.close()
        client.status()

    async def asynchronously(client: AsyncGateClient) -> None:
        await client.close()
        await client.status()

    with listening(silent()) as path:
        error = caught(face, path, OPERATOR, act if face is blocking else asynchronously)
    assert "closed here" in error.message


# --- controllers and estimators


def test_a_controller_hears_what_it_is_told_and_says_how_it_ended() -> None:
    ended: list[Any] = []

    async def talk(peer: Peer) -> None:
        hello = await peer.welcome()
        assert hello.role is CONTROLLER
        peer.send(Kind.RENEW, 0, Renew(ticket=scenarios.verified().digest))
        peer.send(Kind.HALT, 77, Halt())
        peer.event(0, stops=1)
        number, message = await peer.request()
        ended.append((number, message))
        assert (await peer.request())[0] == 77
        peer.fault(number, "TRANSITION_REFUSED")
        await peer.gone()

    async def act(client: AsyncGateClient) -> list[Any]:
        frames = client.frames()
        told = [(await anext(frames)).kind for _ in range(3)]
        report = Ended(ticket=scenarios.verified().digest, outcome=Outcome.SUCCEEDED)
        number = await client.send(Kind.ENDED, report)
        await client.send(Kind.STOOD, Stood(stops=1), number=77)
        answer = await anext(frames)
        return [*told, answer.kind, answer.id == number]

    told = [Kind.RENEW, Kind.HALT, Kind.EVENT, Kind.ERROR, True]
    with listening(talk) as path:
        assert looping(path, CONTROLLER, act) == told
    assert ended[0][1].outcome is Outcome.SUCCEEDED


def test_a_controller_learns_that_its_gate_went_away() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()

    async def act(client: AsyncGateClient) -> Any:
        return [item async for item in client.frames()]

    with listening(talk) as path:
        error = caught(looping, path, CONTROLLER, act)
    assert "closed the connection" in error.message


def test_an_answer_to_what_was_never_sent_breaks_the_connection() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number + 1)
        await peer.gone()

    async def act(client: AsyncGateClient) -> Any:
        await client.send(Kind.STOOD, Stood(stops=1))
        return [item async for item in client.frames()]

    with listening(talk) as path:
        assert "not open" in caught(looping, path, CONTROLLER, act).message


def test_a_cancelled_request_leaves_the_others_alone() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        first, _ = await peer.request()
        second, _ = await peer.request()
        peer.reply(first)
        peer.reply(second, fine=True)
        await peer.gone()

    async def act(client: AsyncGateClient) -> Any:
        waiting = asyncio.create_task(client.status())
        await asyncio.sleep(0)  # let it be sent
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        return await client.status()

    with listening(talk) as path:
        assert looping(path, OPERATOR, act) == {"fine": True}


def test_a_header_costs_what_the_protocol_says() -> None:
    assert len(frame(Kind.STATUS, 1, {})) == HEADER_BYTES + 2
