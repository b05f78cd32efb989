# SPDX-License-Identifier: Apache-2.0
"""Sessions and turns against a model: who is answered what, whatever clients send in which order.

The sessions, their sockets and the ring are the gate's own; when a proposal is answered, the test
says. The model knows of each client what waits for its turn and whether a proposal is open.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, rule

from authguard_r.server.fair_queue import FairQueue, ServedClient
from authguard_r.wire.frames import Frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import BOUND, ClientRole, Kind
from fixtures.gate_fixtures import Door, Noted, enter, settle

#: What a planner may send beside proposals, and what an auditor may.
_OTHERS = {"planner": Kind.OBSERVE, "auditor": Kind.STATUS}


class Hall(Noted):
    """A hall with a ring, whose desk answers when it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.shed: list[str] = []
        self.ring = FairQueue(lambda client: self.shed.append(client.name))
        self.open: dict[ServedClient, int] = {}

    def came(self, client: ServedClient, item: Frame, *, alone: bool) -> None:
        self.ring.came(client, item)

    def reads(self, client: ServedClient) -> None:
        self.ring.reads(client)

    def turn(self) -> list[tuple[str, Kind, int]]:
        """Serve one turn: a proposal stays open, everything else is answered at once."""
        served = []
        for client, item in self.ring.take():
            assert isinstance(item, Frame)
            served.append((str(client.name), item.kind, item.id))
            if item.kind is Kind.PROPOSE:
                assert client not in self.open, "two proposals of one client at once"
                self.open[client] = item.id
            else:
                client.reply(item.id, {})
        return served

    def finish(self, client: ServedClient) -> None:
        """Answer the client's proposal."""
        client.reply(self.open.pop(client), {})
        self.ring.done(client)


class Guest:
    """A client as the model knows it."""

    def __init__(self, door: Door, client: ServedClient, role: str) -> None:
        self.door, self.client, self.role = door, client, role
        self.number = 0
        self.waiting: list[tuple[Kind, int]] = []
        self.proposed = False
        self.shed = 0
        self.unread: list[tuple[Kind, int]] = []
        self.expected: list[tuple[Kind, int]] = []

    @property
    def paused(self) -> bool:
        """True for a client that is not read: enough of it waits, or enough was shed."""
        much = self.proposed and self.shed >= LIMITS.shed_proposals
        return much or len(self.waiting) >= LIMITS.waiting_requests

    def ask(self, kind: Kind) -> bytes:
        """Return a request's bytes; what has to become of it is noted when it is read."""
        self.number += 1
        self.unread.append((kind, self.number))
        return raw_frame(kind, self.number, b"{}")

    def read(self) -> None:
        """Note what has to become of everything that is read by now."""
        while self.unread and not self.paused:
            kind, number = self.unread.pop(0)
            if kind is Kind.PROPOSE and self.proposed:
                self.shed += 1
                self.expected.append((Kind.ERROR, number))
                continue
            if kind is Kind.PROPOSE:
                self.proposed, self.shed = True, 0
            self.waiting.append((kind, number))


class Protocol(RuleBasedStateMachine):
    """Clients come, ask, are served in turns, misbehave and go."""

    guests = Bundle("guests")

    def __init__(self) -> None:
        super().__init__()
        self.runner = asyncio.Runner()
        self.runner.get_loop()
        self.hall = Hall()
        self.here: list[Guest] = []
        self.ended: list[str] = []
        self.count = 0

    def teardown(self) -> None:
        async def leave() -> None:
            for guest in self.here:
                guest.door.session.drop("the model is over")  # who is not read hears of no end
                guest.door.close()
            await settle()

        self.runner.run(leave())
        self.runner.close()

    @rule(target=guests, role=st.sampled_from(sorted(_OTHERS)))
    def come(self, role: str) -> Guest:
        """A client connects and says hello."""
        self.count += 1
        name = f"guest-{self.count}"

        async def work() -> Guest:
            door = await (await enter(self.hall)).hello(role=role, client=name)
            return Guest(door, self.hall.here[-1], role)

        guest = self.runner.run(work())
        self.here.append(guest)
        return guest

    @rule(guest=guests, kinds=st.lists(st.booleans(), min_size=1, max_size=4), cut=st.integers(0))
    def ask(self, guest: Guest, kinds: list[bool], cut: int) -> None:
        """A client sends requests in two chunks, however they are cut."""
        if guest not in self.here or guest.paused:
            return  # it is not read then: what it sends lies in the kernel
        planner = guest.role == "planner"
        data = b"".join(
            guest.ask(Kind.PROPOSE if planner and proposes else _OTHERS[guest.role])
            for proposes in kinds
        )
        guest.read()
        at = cut % (len(data) + 1)
        self.runner.run(guest.door.send(data[:at], data[at:]))

    @rule()
    def turn(self) -> None:
        """One turn: one request, of whoever's it is."""
        by_name = {str(guest.client.name): guest for guest in self.here}

        async def work() -> list[tuple[str, Kind, int]]:
            return self.hall.turn()

        # in the loop: a client that is read again may have half a frame, and that starts a timer
        for name, kind, number in self.runner.run(work()):
            guest = by_name[name]
            assert guest.waiting.pop(0) == (kind, number), "out of order"
            guest.read()  # room is made before the answer: what is shed then is refused first
            if kind is not Kind.PROPOSE:
                guest.expected.append((Kind.REPLY, number))

    @rule(guest=guests)
    def finish(self, guest: Guest) -> None:
        """A proposal is answered."""
        if guest.client in self.hall.open and guest in self.here:
            guest.expected.append((Kind.REPLY, self.hall.open[guest.client]))

            async def work() -> None:
                self.hall.finish(guest.client)

            self.runner.run(work())
            guest.proposed = False
            guest.read()

    @rule(
        guest=consumes(guests),
        how=st.sampled_from(["hangs up", "another's kind", "too long", "in the middle"]),
    )
    def go(self, guest: Guest, how: str) -> None:
        """A client goes, or has to; nobody else is any the worse for it."""
        if guest not in self.here or guest.client.paused:
            return
        other = Kind.ORDER
        said = {
            "hangs up": b"",
            "another's kind": raw_frame(other, 1, b"{}"),
            "too long": raw_frame(_OTHERS[guest.role], 1, bytes(BOUND[_OTHERS[guest.role]] + 1)),
            "in the middle": raw_frame(_OTHERS[guest.role], 1, b"{}")[:-1],
        }[how]

        async def work() -> None:
            await self.check(guest)
            await guest.door.send(said[: 1 << 13])
            if how in {"another's kind", "too long"}:
                fault = await guest.door.fault()
                assert fault["code"] == ("MALFORMED" if how[0] == "a" else "INPUT_TOO_LARGE")
            guest.door.close()
            await settle()

        wrong = len(self.hall.wrong)
        self.runner.run(work())
        self.here.remove(guest)
        self.hall.open.pop(guest.client, None)
        assert self.hall.gone[-1] is guest.client
        assert len(self.hall.wrong) - wrong == int(how != "hangs up")
        assert all(name == guest.client.name for name, _ in self.hall.wrong[wrong:])

    @rule(junk=st.binary(min_size=1, max_size=40))
    def knock(self, junk: bytes) -> None:
        """Somebody who says no hello is never a client."""

        async def work() -> None:
            door = await enter(self.hall)
            await door.send(junk)
            door.close()
            await settle()

        here = len(self.hall.here)
        self.runner.run(work())
        assert len(self.hall.here) == here
        assert self.hall.gone[-1] is None

    @invariant()
    def everybody_was_answered_what_the_model_says(self) -> None:
        async def work() -> None:
            for guest in self.here:
                await self.check(guest)

        self.runner.run(work())

    @invariant()
    def nobody_is_read_further_who_has_enough_waiting(self) -> None:
        for guest in self.here:
            waiting = len(guest.client.waiting)
            assert waiting == len(guest.waiting)
            assert guest.client.paused is guest.paused
            assert guest.client.proposing is guest.proposed

    async def check(self, guest: Guest) -> None:
        """Require exactly the answers that are due, in order, each with its request's number."""
        got: list[Any] = await guest.door.answers()
        assert [(item.kind, item.id) for item in got] == guest.expected
        for item in got:
            if item.kind is Kind.ERROR:
                assert json.loads(item.body)["code"] == "BUSY"
        guest.expected.clear()
        assert not guest.door.is_closed


TestProtocol = Protocol.TestCase
TestProtocol.settings = settings(max_examples=60, stateful_step_count=30)


def test_every_role_of_the_model_is_a_role() -> None:
    assert set(_OTHERS) <= set(ClientRole)
