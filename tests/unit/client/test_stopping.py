# SPDX-License-Identifier: Apache-2.0
"""One stop on two ways: whatever listens there, the best word counts and the person is told."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import AsyncGateClient, GateClient, StopEverywhere, stop_robot, stopping
from authguard_r.client.stopping import Answers, StopPath, StopReply
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import read_body
from authguard_r.wire.messages import MAX_WHY, ClientRole, Stop
from fixtures import scenarios
from fixtures.scripted_peer import Peer, Talk, listening


def says(*, stopped: bool, controller: bool = True, after_ms: int = 7) -> Talk:
    """Return a part that answers every stop."""

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number, stopped=stopped, controller=controller, after_ms=after_ms)

    return talk


async def silent(peer: Peer) -> None:
    """Take everything, and say nothing."""
    await peer.gone()


async def hangs_up(peer: Peer) -> None:
    """End every connection, as a process does that is killed again and again."""
    await peer.request()


@contextmanager
def serving(lane: Talk | None, gate: Talk | None) -> Iterator[Path]:
    """Serve the two parts in one folder."""
    with ExitStack() as stack:
        first = stack.enter_context(listening(lane or silent, StopPath.LANE))
        run = first.parent
        if gate is not None:
            second = stack.enter_context(listening(gate, StopPath.GATE))
            (run / StopPath.GATE).symlink_to(second)
        if lane is None:
            first.unlink()
        yield run


def stop(run: Path, **more: object) -> tuple[StopEverywhere, list[list[str]]]:
    """Stop; return what was said, and who was named meanwhile as not answering."""
    made = StopEverywhere(run, **more)  # type: ignore[arg-type]
    told: list[list[str]] = []

    def tell(answers: Answers) -> None:
        told.append([part.words for part, one in answers.items() if one.answer is None])

    asyncio.run(made.confirmed(tell))
    return made, told


STANDS, NOT = says(stopped=True), says(stopped=False)
ALONE = says(stopped=False, controller=False)


@pytest.mark.parametrize(
    ("lane", "gate"),
    [
        (STANDS, STANDS),
        (STANDS, silent),
        (silent, STANDS),
        (hangs_up, STANDS),
        (STANDS, None),
        (None, STANDS),
        (NOT, STANDS),
        (STANDS, NOT),
    ],
)
def test_one_part_that_says_that_the_robot_stands_is_enough(
    lane: Talk | None, gate: Talk | None
) -> None:
    with serving(lane, gate) as run:
        said = asyncio.run(stop_robot(run, why="a child"))
    assert (said.stopped, said.after_ms) == (True, 7)


@pytest.mark.parametrize("other", [ALONE, None])
def test_a_gate_without_a_controller_for_a_while_has_no_robot_to_stop(
    other: Talk | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "GONE_S", 0.3)
    begun = time.monotonic()
    with serving(ALONE, other) as run:
        said = asyncio.run(stop_robot(run))
    assert (said.stopped, said.controller) == (False, False)
    assert time.monotonic() - begun > stopping.GONE_S


@pytest.mark.parametrize("first", [NOT, ALONE])
def test_a_stop_that_nobody_confirms_is_asked_for_again_under_its_name_until_somebody_does(
    first: Talk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "REPEAT_S", 0.05)
    names: list[str] = []

    async def talk(peer: Peer) -> None:
        hello, asked = await peer.frame(), await peer.frame()
        names.append(read_body(asked.body, Stop).key)
        peer._frames += [hello, asked]
        await (first if len(names) < 4 else STANDS)(peer)

    with serving(talk, first) as run:
        assert asyncio.run(stop_robot(run)).stopped is True
    assert len(names) == 4
    assert len(set(names)) == 1


@pytest.mark.parametrize("other", [NOT, silent])
def test_a_controller_that_does_not_say_that_the_robot_stands_is_waited_for_and_named(
    other: Talk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "TELL_S", 0.1)
    monkeypatch.setattr(stopping, "GONE_S", 0.1)
    monkeypatch.setattr(stopping, "TOLD_S", 0.5)
    told: list[list[str]] = []

    def tell(answers: Answers) -> None:
        told.append([part.words for part, one in answers.items() if not one.has_stopped])

    with serving(NOT, other) as run:
        made = StopEverywhere(run)
        begun = time.monotonic()
        reached = asyncio.run(made.confirmed(tell))
        assert time.monotonic() - begun > stopping.TOLD_S
    assert reached.answer is not None
    assert (reached.answer.stopped, reached.answer.controller) == (False, True)
    assert len(told) > 2
    assert told[0] == ["the stop process", "the gate"]


def test_a_part_that_told_a_controller_and_is_gone_since_is_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stopping, "GONE_S", 0.3)

    async def main(run: Path) -> StopReply:
        made = StopEverywhere(run)

        def leave(answers: Answers) -> None:
            (run / StopPath.LANE).unlink(missing_ok=True)

        monkeypatch.setattr(stopping, "TELL_S", 0.2)
        return await made.confirmed(leave)

    with serving(NOT, None) as run:
        answer = asyncio.run(main(run)).answer
    assert answer is not None
    assert (answer.stopped, answer.controller) == (False, True)


def test_where_nobody_answers_in_time_it_is_said() -> None:
    with serving(silent, silent) as run:
        made = StopEverywhere(run)
        with pytest.raises(EnvironmentFault, match="within 200 ms"):
            asyncio.run(made.confirmed(within_ms=200))


def test_a_part_that_comes_back_is_told_again() -> None:
    tries: list[str] = []

    async def talk(peer: Peer) -> None:
        hello = await peer.frame()
        asked = await peer.frame()
        tries.append(asked.body.decode())
        if len(tries) == 3:
            peer._frames += [hello, asked]
            await says(stopped=True)(peer)

    with serving(talk, None) as run:
        assert asyncio.run(stop_robot(run)).stopped is True
    assert len(set(tries)) == 1  # each time under the same name


def test_who_gives_up_learns_how_far_it_came() -> None:
    async def given_up(run: Path) -> StopEverywhere:
        made = StopEverywhere(run)
        waits = asyncio.ensure_future(made.confirmed())
        await asyncio.sleep(0.3)
        waits.cancel()
        await asyncio.gather(waits, return_exceptions=True)
        return made

    with serving(silent, hangs_up) as run:
        made = asyncio.run(given_up(run))
    lane, gate = made.answers[StopPath.LANE], made.answers[StopPath.GATE]
    assert (lane.why, lane.is_over, lane.answer) == ("", False, None)
    assert "closed the connection" in gate.why


def test_where_nobody_serves_it_is_said_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "GONE_S", 0.2)
    monkeypatch.setattr(stopping, "DEAD_S", 1.0)
    begun = time.monotonic()
    with pytest.raises(EnvironmentFault, match="no gate answers") as gone:
        asyncio.run(stop_robot(tmp_path))
    assert gone.value.where == str(tmp_path)
    assert time.monotonic() - begun < stopping.DEAD_S
    with socket.socket(socket.AF_UNIX) as died:
        died.bind(str(tmp_path / StopPath.GATE))
    begun = time.monotonic()
    with pytest.raises(EnvironmentFault, match="no gate answers"):
        asyncio.run(stop_robot(tmp_path))
    assert time.monotonic() - begun > stopping.DEAD_S  # it may be starting anew


def only(*mine: ClientRole) -> Talk:
    """Return a part at which this user may be nothing but these."""

    async def talk(peer: Peer) -> None:
        hello = await peer.frame()
        asked = await peer.frame()
        role = next(r for r in ClientRole if f'"{r}"'.encode() in hello.body)
        if role not in mine:
            peer.fault(0, Reason.ROLE_DENIED, family="authenticity")
            return
        peer._frames += [hello, asked]
        await says(stopped=True)(peer)

    return talk


def test_a_role_that_is_denied_is_followed_by_the_next_one() -> None:
    roles = (ClientRole.OPERATOR, ClientRole.AUDITOR, ClientRole.PLANNER)
    with serving(only(ClientRole.PLANNER), None) as run:
        made, _ = stop(run, roles=roles)
    assert made.answers[StopPath.LANE].role is ClientRole.PLANNER
    with (
        serving(only(), only()) as run,
        pytest.raises(AuthenticityError, match="`operator`, `auditor`, `planner`") as denied,
    ):
        stop(run, roles=roles)
    assert denied.value.reason is Reason.ROLE_DENIED


def test_an_impostor_s_word_does_not_count_where_a_proof_is_asked_for() -> None:
    async def impostor(peer: Peer) -> None:
        hello = await peer.welcome(signer="operator-1")
        assert hello.nonce is not None
        number, _ = await peer.request()
        peer.reply(number, stopped=True, controller=True, after_ms=1)

    trust = read_trust(scenarios.trust_folder())
    with serving(impostor, STANDS) as run:
        made, _ = stop(run, verifier=trust, robot=scenarios.RID)
        assert made.answers[StopPath.GATE].answer is not None
        assert made.answers[StopPath.LANE].answer is None
    with serving(impostor, None) as run, pytest.raises(AuthenticityError):
        stop(run, verifier=trust, robot=scenarios.RID)


# a client that is connected


def blocking(path: Path, **how: Any) -> Any:
    """Connect and stop, with the client that waits."""
    with GateClient.connect(path, role=ClientRole.PLANNER, **how) as client:
        return client.stop("a child")


def in_a_loop(path: Path, **how: Any) -> Any:
    """The same client, in the thread of an event loop."""

    async def main() -> Any:
        return blocking(path, **how)

    return asyncio.run(main())


def looping(path: Path, **how: Any) -> Any:
    """The client for an event loop."""

    async def main() -> Any:
        made = await AsyncGateClient.connect(path, role=ClientRole.PLANNER, **how)
        async with made as client:
            return await client.stop("a child")

    return asyncio.run(main())


Face = Callable[..., Any]
each_face = pytest.mark.parametrize("face", [blocking, in_a_loop, looping])
each_part = pytest.mark.parametrize("part", list(StopPath))


async def stands_and_stays(peer: Peer) -> None:
    """Confirm a stop, and keep the connection."""
    await peer.welcome()
    number, _ = await peer.request()
    peer.reply(number, stopped=True, controller=True, after_ms=7)
    await peer.gone()


async def welcomes_only(peer: Peer) -> None:
    """Welcome a client, and answer nothing."""
    await peer.welcome()
    await peer.gone()


@each_face
@each_part
def test_a_client_stops_over_its_connection_and_by_the_other_part_under_one_name(
    face: Face, part: StopPath
) -> None:
    asked: list[tuple[str, str]] = []
    both = threading.Event()

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, stop = await peer.request()
        asked.append((stop.why, stop.key))
        if len(asked) == 2:
            both.set()
        await asyncio.to_thread(both.wait, 5)
        peer.reply(number, stopped=True, controller=True, after_ms=7)
        await peer.gone()

    with serving(talk, talk) as run:
        said = face(run / part)
    assert said == {"stopped": True, "controller": True, "after_ms": 7}
    assert len(asked) == 2
    assert asked[0] == asked[1]
    assert asked[0][0] == "a child"


@each_face
@pytest.mark.parametrize("other", [STANDS, None])
def test_a_client_whose_connection_ends_stops_by_a_new_one(face: Face, other: Talk | None) -> None:
    connections = 0

    async def talk(peer: Peer) -> None:
        nonlocal connections
        connections += 1
        if connections == 1:
            await peer.welcome()
            await peer.request()
            return  # it hangs up
        await (silent if other is not None else STANDS)(peer)

    with serving(other, talk) as run:
        assert face(run / StopPath.GATE)["stopped"] is True


@each_face
def test_a_client_whose_part_hangs_stops_by_the_other_one(face: Face) -> None:
    with serving(STANDS, welcomes_only) as run:
        assert face(run / StopPath.GATE)["stopped"] is True


@each_face
def test_a_client_that_nobody_answers_gives_up_after_its_time(face: Face) -> None:
    with (
        serving(silent, welcomes_only) as run,
        pytest.raises(EnvironmentFault, match="within 300 ms"),
    ):
        face(run / StopPath.GATE, timeout_ms=300)


def test_a_client_goes_on_with_its_connection_after_a_stop_that_the_other_part_confirmed() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        late, _ = await peer.request()
        number, _ = await peer.request()
        peer.reply(late, stopped=False, controller=True, after_ms=1_000)
        peer.reply(number, robot="r")
        await peer.gone()

    with (
        serving(STANDS, talk) as run,
        GateClient.connect(run / StopPath.GATE, role=ClientRole.OPERATOR) as client,
    ):
        assert client.stop()["stopped"] is True
        assert client.status() == {"robot": "r"}


def test_a_client_that_is_given_no_such_answer_says_so() -> None:
    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, _ = await peer.request()
        peer.reply(number, said=1)
        await peer.gone()

    with serving(None, talk) as run, pytest.raises(MalformedError, match="said"):
        blocking(run / StopPath.GATE)


def test_a_client_without_a_file_left_stops_over_its_connection() -> None:
    """A program that leaks files can still stop its robot."""
    script = """
import os, resource, sys
from pathlib import Path
from authguard_r.client import GateClient
from authguard_r.wire.messages import ClientRole
with GateClient.connect(Path(sys.argv[1]), role=ClientRole.PLANNER) as client:
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    try:
        while True:
            os.dup(0)
    except OSError:
        pass
    print(client.stop("a child"))
"""
    with serving(silent, stands_and_stays) as run:
        done = subprocess.run(
            [sys.executable, "-c", script, str(run / StopPath.GATE)],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
    assert "'stopped': True" in done.stdout, done.stderr


def test_a_client_without_a_thread_left_stops_over_its_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    async def main(path: Path) -> Any:
        with (
            GateClient.connect(path, role=ClientRole.PLANNER) as client,
            monkeypatch.context() as m,
        ):
            m.setattr(threading.Thread, "start", full)
            return client.stop("a child")

    with serving(silent, stands_and_stays) as run:
        assert asyncio.run(main(run / StopPath.GATE))["stopped"] is True


def test_a_stop_leaves_the_thread_s_own_event_loop_as_it_is() -> None:
    with serving(None, stands_and_stays) as run:
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        try:
            assert blocking(run / StopPath.GATE)["stopped"] is True
            assert asyncio.get_event_loop_policy().get_event_loop() is loop
        finally:
            asyncio.set_event_loop(None)
            loop.close()


def in_a_bare_loop(path: Path, **how: Any) -> Any:
    """The client that waits, in an event loop that leaves Ctrl-C to Python."""

    async def main() -> Any:
        return blocking(path, **how)

    loop = asyncio.new_event_loop()
    try:
        return loop.run_until_complete(main())
    finally:
        loop.close()


@pytest.mark.parametrize("face", [blocking, in_a_bare_loop])
def test_who_interrupts_a_stop_gives_up_at_once(face: Face) -> None:
    with serving(silent, welcomes_only) as run:
        begun = time.monotonic()
        main = threading.get_ident()
        timer = threading.Timer(0.5, lambda: signal.pthread_kill(main, signal.SIGINT))
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        timer.start()
        try:
            with pytest.raises(KeyboardInterrupt):
                face(run / StopPath.GATE, timeout_ms=20_000)
        finally:
            signal.signal(signal.SIGINT, before)
        assert time.monotonic() - begun < 10


@each_face
def test_a_connected_client_believes_no_impostor_at_the_other_part(face: Face) -> None:
    trust = read_trust(scenarios.trust_folder())

    async def impostor(peer: Peer) -> None:
        await peer.welcome(signer="operator-1")
        number, _ = await peer.request()
        peer.reply(number, stopped=True, controller=True, after_ms=1)

    with (
        serving(impostor, welcomes_only) as run,
        pytest.raises(AuthGuardError),
    ):
        face(run / StopPath.GATE, verifier=trust, robot=scenarios.RID, timeout_ms=400)


@pytest.mark.parametrize("why", ["\udcff broken", "x" * 5_000])
def test_no_words_keep_a_stop_from_being_sent(why: str) -> None:
    told: list[str] = []

    async def talk(peer: Peer) -> None:
        await peer.welcome()
        number, stop = await peer.request()
        told.append(stop.why)
        peer.reply(number, stopped=True, controller=True, after_ms=7)

    with serving(None, talk) as run:
        assert asyncio.run(stop_robot(run, why=why)).stopped is True
    assert len(told[0]) <= MAX_WHY
    assert told[0].startswith(("? broken", "xxx"))


def test_a_part_that_has_answered_once_and_hangs_then_is_waited_for_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stopping, "REPEAT_S", 0.05)
    monkeypatch.setattr(stopping, "SILENT_S", 0.3)
    monkeypatch.setattr(stopping, "GONE_S", 0.5)
    tries = 0

    async def talk(peer: Peer) -> None:
        nonlocal tries
        tries += 1
        if tries == 1:
            await ALONE(peer)
        else:
            await asyncio.sleep(1.2 if tries == 2 else 0)
            await STANDS(peer)

    hung: list[bool] = []
    monkeypatch.setattr(stopping, "TELL_S", 0.5)
    with serving(talk, None) as run:
        made = StopEverywhere(run)
        reached = asyncio.run(made.confirmed(lambda said: hung.append(said[StopPath.LANE].hangs)))
    assert True in hung
    assert reached.answer is not None
    assert reached.answer.stopped is True
    assert reached.answer.after_ms >= 1_200  # since the person asked, not since the last try
