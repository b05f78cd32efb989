# SPDX-License-Identifier: Apache-2.0
"""One stop on two ways: whatever listens there, the best word counts and the person is told."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from authguard_r.client import StopEverywhere, stop_robot, stopping
from authguard_r.client.stopping import Answers, Part
from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
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
        first = stack.enter_context(listening(lane or silent, Part.LANE))
        run = first.parent
        if gate is not None:
            second = stack.enter_context(listening(gate, Part.GATE))
            (run / Part.GATE).symlink_to(second)
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
        begun = time.monotonic()
        said = asyncio.run(stop_robot(run, why="a child"))
        assert time.monotonic() - begun < stopping.PATIENCE_S
    assert (said.stopped, said.after_ms) == (True, 7)


@pytest.mark.parametrize("other", [NOT, None])
def test_an_answer_without_a_confirmation_is_the_answer_when_no_other_comes(
    other: Talk | None,
) -> None:
    with serving(NOT, other) as run:
        assert asyncio.run(stop_robot(run)).stopped is False


def test_a_part_that_hangs_is_waited_for_a_while_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stopping, "TELL_S", 0.3)
    with serving(NOT, silent) as run:
        made, told = stop(run)
    assert made.answers[Part.GATE].answer is None
    assert told[0] == ["the gate"]


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
    lane, gate = made.answers[Part.LANE], made.answers[Part.GATE]
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
        died.bind(str(tmp_path / Part.GATE))
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
    assert made.answers[Part.LANE].role is ClientRole.PLANNER
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
        assert made.answers[Part.GATE].answer is not None
        assert made.answers[Part.LANE].answer is None
    with serving(impostor, None) as run, pytest.raises(AuthenticityError):
        stop(run, verifier=trust, robot=scenarios.RID)
