# SPDX-License-Identifier: Apache-2.0
"""A whole gate in this process: its own service and sessions, a real controller's desk, one clock.

    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        answer = house.propose(planner, SCAN)

Clients are real sockets. Time passes only when a test says so: `advance` moves the robot, lets its
estimator speak and looks at the leases, in steps of `STEP_MS`. Nothing here is a mock.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryFile, mkdtemp
from types import TracebackType
from typing import Any, Self

import msgspec

from authguard_r.access.gate_config import GateConfig, Peer, default_config
from authguard_r.audit.record import Record, read_record, read_sealed
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.client.controller import ControllerSession, MessageSource, OutgoingMessage
from authguard_r.client.handshake import Handshake
from authguard_r.client.proof import prove
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.identifiers import ActionType, Digest
from authguard_r.core.lease import Lease
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Store
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import FileSigner, folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.safety import EnvelopeGate
from authguard_r.safety import default_config as default_safety
from authguard_r.server.event_log import EventLog
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.plan_reader import PlanReader
from authguard_r.server.recovery import Recovery
from authguard_r.server.remote_controller import RemoteController, ShadowController
from authguard_r.server.service import Service
from authguard_r.server.service_parts import ServiceParts
from authguard_r.server.state_inbox import StateInbox
from authguard_r.server.streams import StreamBounds, Streams
from authguard_r.server.wiring import LogSettings, join, open_gate_store
from authguard_r.sim.body import SymbolicBody
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.site.model import Site, stopping_mm
from authguard_r.site.source import read_text, read_yaml
from authguard_r.site.words import standard_words
from authguard_r.store.memory import MemoryStore
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.wire.frames import Frame, FrameReader, frame
from authguard_r.wire.messages import (
    PROTOCOL,
    Attest,
    ClientRole,
    Hello,
    Kind,
    Mode,
    Nothing,
    Order,
    OrderKind,
    Propose,
    Records,
    StopHeard,
)
from fixtures import scenarios
from unit.sim.controller_bench import NONCE, braking_site, handshake

#: The gate looks this often, and the estimator too.
STEP_MS = 50
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 30.0
EVERY = tuple(sorted(role for role in ClientRole if role is not ClientRole.GATE))
GO = b'navigate_to(destination="Pharmacy", speed=0.8)'
SCAN = b"scan()"
FORBIDDEN = b'navigate_to(destination="Office 1", speed=0.5)'
UNREADABLE = b"fly_to(the_moon)"


class HandClock:
    """A clock that a test winds (`core.ports.Clock`); one for the gate and its robot."""

    def __init__(self) -> None:
        self.ms = 0
        self.wrong_ms = 0  # of the wall clock
        self.starts = 0  # of estimators, which count them

    def wall_ms(self) -> int:
        return scenarios.START_MS + self.ms + self.wrong_ms

    def mono_ms(self) -> int:
        return self.ms

    def pause(self, duration_ms: int) -> None:
        self.ms += duration_ms


class Refused(Exception):  # noqa: N818 - a word of the protocol
    """The gate answered with an `ERROR`."""

    def __init__(self, fault: dict[str, Any]) -> None:
        super().__init__(f"{fault['code']}: {fault['message']} at {fault['where']}")
        self.code, self.where, self.family = fault["code"], fault["where"], fault["family"]


class Guest:
    """One client's end of a real connection."""

    def __init__(self, house: DemoGate, role: ClientRole, line: socket.socket) -> None:
        self.role = role
        self.line = line
        self.got: list[Frame] = []
        self._house = house
        self._cut = FrameReader(lambda _: 1 << 23)
        self._number = 0

    def say(self, kind: Kind, body: object) -> int:
        """Send a request and let the gate do what it can now; return its number."""
        self._number += 1
        self._house.send(self, frame(kind, self._number, body))
        return self._number

    def ask(self, kind: Kind, body: object = Nothing()) -> dict[str, Any]:
        """Return the answer to a request that takes no time."""
        number = self.say(kind, body)
        for _ in range(1_000):  # a long answer takes more than one reading
            answer = self.answer(number)
            if answer is not None:
                return answer
            self._house.settle()
        raise AssertionError(f"no answer to {kind.name}")

    def answer(self, number: int) -> dict[str, Any] | None:
        """Return the answer to a request, None while there is none.

        Raises:
            Refused: it was refused.
        """
        self.pull()
        for item in self.got:
            if item.id == number and item.kind is Kind.ERROR:
                raise Refused(msgspec.json.decode(item.body))
            if item.id == number and item.kind is Kind.REPLY:
                told: dict[str, Any] = msgspec.json.decode(item.body)
                return told
        return None

    def bodies(self, kind: Kind, number: int | None = None) -> list[dict[str, Any]]:
        """Return every message of a kind that came."""
        self.pull()
        return [
            msgspec.json.decode(item.body)
            for item in self.got
            if item.kind is kind and number in {None, item.id}
        ]

    def pull(self) -> None:
        """Take in what the gate has sent."""
        with suppress(BlockingIOError, ConnectionError):
            while data := self.line.recv(1 << 20):
                self.got += self._cut.feed(data)

    def leave(self) -> None:
        """Hang up, and let the gate notice."""
        self.line.close()
        self._house.settle()


class DemoGate:
    """A gate, its robot and whoever comes in.

    Args:
        mode: `shadow` releases nothing.
        store: registry and log; in memory when absent.
        site: whose robot it is; `trust` has to certify its profile.
        trust: the trust folder.
        binding: the planner's tools.
        mission: the draft that `activate` signs, compiled; the shipped one when absent.
        faults: what goes wrong in the world.
        at: where the robot is at first.
        robot: connect a controller.
        estimator: let an estimator speak in each step.
        speed_up: how much faster than the clock the robot's world runs.
        bounds: fields of the configuration that are not as in a fresh set-up.
    """

    def __init__(
        self,
        *,
        mode: Mode = Mode.ENFORCE,
        store: Store | None = None,
        site: Site | None = None,
        trust: Path | None = None,
        binding: Binding | None = None,
        mission: Mission | None = None,
        faults: Faults | None = None,
        at: str = "dock",
        robot: bool = True,
        estimator: bool = True,
        speed_up: int = 10,
        clock: HandClock | None = None,
        parts: dict[str, Any] | None = None,
        **bounds: Any,
    ) -> None:
        self.clock = clock or HandClock()
        self.clock.starts += 1
        self.folder = trust or scenarios.trust_folder()
        self.site = site or scenarios.site()
        self.binding = binding or scenarios.binding()
        self.mission = mission or scenarios.mission()
        here = (Peer(uid=os.geteuid(), roles=EVERY),)
        self.config: GateConfig = msgspec.structs.replace(
            default_config(scenarios.RID, here, mode), **bounds
        )
        self.robot = SymbolicRobot(
            self.site,
            scenarios.RID,
            scenarios.world(at),
            estimator=self.signer(f"estimator-{scenarios.RID}"),
            start_ms=scenarios.START_MS,
            faults=faults or Faults(),
            epoch=self.clock.starts,
        )
        self.crashes = False
        self._orders = itertools.count(1)
        self._moved_ms = self.clock.ms
        self.session: ControllerSession | None = None
        self._lives = 0
        self._store = store or MemoryStore()
        self._speed_up = speed_up
        self._parts = parts or {}
        self._assemble(mode)
        self._runner = asyncio.Runner()
        self._guests: list[Guest] = []
        self._wants = (robot and mode is Mode.ENFORCE, estimator)
        self.controller: Guest | None = None
        self.estimator: Guest | None = None
        self._said: bytes | None = None

    def _assemble(self, mode: Mode) -> None:
        shadow = mode is Mode.SHADOW
        self.inbox = StateInbox()
        signer = self.signer(gate_name(scenarios.RID))
        opened = open_gate_store(
            self._store,
            trust=read_trust(self.folder),
            chain=signer.chain,
            site=self.site,
            source=self.inbox,
            clock=self.clock,
            log=LogSettings(
                marks={"mode": "shadow"} if shadow else {},
                refusals=RefusalPolicy(delay_ms=100, fold_ms=0 if shadow else self.config.fold_ms),
            ),
            demo=True,
        )
        bounds = StreamBounds(
            opened.facts,
            opened.ledger.mono_ms,
            stopping_mm=partial(stopping_mm, self.site.robots[scenarios.RID].profile),
            state=lambda: opened.inputs.newest,
        )
        #: refuses a dispatch, where a test wants one refused
        self.admit: Callable[[Action, Lease], None] = bounds.admit
        self.remote = (
            None
            if shadow
            else RemoteController(
                opened.ledger.mono_ms,
                renew_within_ms=self.config.renew_within_ms,
                admit=self._admitted,
            )
        )
        self.gate = join(
            opened,
            safety=EnvelopeGate(default_safety(self.site, scenarios.RID)),
            controller=ShadowController() if self.remote is None else self.remote,
            clock=self.clock,
            stand_within_ms=self.config.stand_within_ms,
            recovers=False,
        )
        self.streams = None if self.remote is None else Streams(opened.ledger, self.remote, bounds)
        self.reader = PlanReader(self.site, self.binding, within_s=PATIENCE_S)
        self.recovery = Recovery(self.gate.management)
        self.recovery.begin()
        self._journal = TemporaryFile()  # noqa: SIM115 - closed with the house
        self.service = Service(self._service_parts(signer))
        self.service.begin()

    def _admitted(self, action: Action, lease: Lease) -> None:
        self.admit(action, lease)

    def _service_parts(self, signer: FileSigner) -> ServiceParts:
        return ServiceParts(
            gate=self.gate,
            config=self.config,
            binder=Binder(self.site, self.binding),
            reader=self.reader,
            channels=dict(self.site.channels),
            signer=signer,
            inbox=self.inbox,
            controller=self.remote,
            streams=self.streams,
            recovery=self.recovery,
            journal=EventLog(self._journal.fileno()),
            **self._parts,
        )

    @property
    def journal(self) -> list[dict[str, Any]]:
        """What the journal holds."""
        self._journal.seek(0)
        return [msgspec.json.decode(line) for line in self._journal.read().splitlines()]

    def __enter__(self) -> Self:
        self._runner.get_loop()
        if self._wants[1]:
            self.estimator = self.enter(ClientRole.ESTIMATOR)
        if self._wants[0]:
            self.connect_robot()
        if self._wants[1]:
            self.look()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for guest in self._guests:
            guest.line.close()
        self.settle()
        self.do(self.reader.close)
        self._runner.close()
        self._journal.close()
        if kind is None and not self.crashes:
            self.recovery.end()
        self.gate.close()

    # the loop

    def do(self, act: Callable[[], Any]) -> Any:
        """Do something inside the gate's loop, and let the loop go on until it rests."""

        async def work() -> Any:
            made = act()
            if isinstance(made, Awaitable):
                made = await made
            for _ in range(8):
                await asyncio.sleep(0)
            async with asyncio.timeout(PATIENCE_S):
                while self.service._turning:
                    await asyncio.sleep(0)
            return made

        return self._runner.run(work())

    def settle(self) -> None:
        """Let the gate do what it can do without time."""
        self.do(lambda: None)

    def send(self, guest: Guest, data: bytes) -> None:
        """Send bytes of a client, and let the gate take them."""
        loop = self._runner.get_loop()
        self.do(lambda: loop.sock_sendall(guest.line, data))
        if guest is not self.estimator and self.robot.newest_fence != self.gate.ledger.fence:
            self.attest()  # who was told a fence measures at once

    def until(self, holds: Callable[[], Any]) -> Any:
        """Let real time pass until something is true: a process of its own has answered."""

        async def wait() -> Any:
            async with asyncio.timeout(PATIENCE_S):
                while not (found := holds()):
                    await asyncio.sleep(0.005)
            return found

        return self._runner.run(wait())

    # who comes in

    def enter(
        self, role: ClientRole, name: str | None = None, *, nonce: str | None = None
    ) -> Guest:
        """Return a connected client that was welcomed."""
        guest = self.knock(role)
        hello = Hello(protocol=PROTOCOL, role=role, client=name or str(role), nonce=nonce)
        guest.say(Kind.HELLO, hello)
        guest.pull()
        assert [item.kind for item in guest.got[:1]] == [Kind.WELCOME], guest.got
        return guest

    def knock(self, role: ClientRole) -> Guest:
        """Return a client that is connected and has not said who it is."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        theirs.setblocking(False)
        loop = self._runner.get_loop()
        guest = Guest(self, role, ours)
        self._guests.append(guest)
        self.do(lambda: loop.connect_accepted_socket(self.service.connect, theirs))
        return guest

    def connect_robot(self) -> None:
        """Let the robot's controller connect; a new desk counts from its own start."""
        self.controller = self.enter(ClientRole.CONTROLLER, "controller-courier-1", nonce=NONCE)
        self._lives += 1
        self.session = ControllerSession(
            SymbolicBody(self.robot, speed_up=self._speed_up),
            life=self._lives,
            now_ms=self.clock.ms,
        )
        welcome = self.controller.got.pop(0)
        proven = prove(welcome, greeting_of(self.folder), nonce=NONCE, now=scenarios.NOW)
        self._deliver(self.session.opened(MessageSource.GATE, proven, self.clock.ms))

    def client(self, guest: Guest) -> ServedClient:
        """Return a guest as the gate sees it."""
        return next(c for c in self.service._clients if c.role is guest.role)

    # time

    def advance(self, duration_ms: int) -> None:
        """Let time pass: the robot moves, its estimator speaks, leases are looked at."""
        until = self.clock.ms + duration_ms
        while self.clock.ms < until:
            self.clock.ms = min(until, self.clock.ms + STEP_MS)
            self.look()

    def look(self) -> None:
        """Do what happens every 50 ms."""
        if self.session is not None and self.controller is not None:
            self._deliver(self.session.tick(self.clock.ms))
        else:
            self.robot.pause(self.clock.ms - self._moved_ms)  # its world goes on without it
        self._moved_ms = self.clock.ms
        if self.estimator is not None:
            self.attest()
        self.do(self.service._look)
        self.pump()

    def attest(self) -> None:
        """Let the estimator say what it sees, when it sees something new."""
        if self.robot.newest_fence != self.gate.ledger.fence:  # the gate has told it
            self.robot.fence(self.gate.ledger.fence)
        token = self.robot.latest()
        if token is not None and token != self._said and self.estimator is not None:
            self._said = token
            self.estimator.say(Kind.SNAPSHOT, Attest(token=token))
            self.pump()

    def pump(self) -> None:
        """Bring what the gate said to the controller's desk, and its answers back, until quiet."""
        while self.session is not None and self.controller is not None:
            self.controller.pull()
            came, self.controller.got = self.controller.got, []
            if not came:
                return
            for item in came:
                self._deliver(self.session.handle(MessageSource.GATE, item, self.clock.ms))

    def _deliver(self, sent: tuple[OutgoingMessage, ...]) -> None:
        for one in sent:
            assert self.controller is not None
            self.send(self.controller, frame(one.kind, one.id, one.body))

    def rest(self, planner: Guest, number: int, *, most_ms: int = 120_000) -> dict[str, Any]:
        """Let time pass until a proposal is answered."""
        until = self.clock.ms + most_ms
        while (answer := planner.answer(number)) is None:
            assert self.clock.ms < until, "the plan did not end"
            self.advance(STEP_MS)
        return answer

    # what a test says

    def signer(self, name: str) -> Any:
        return folder_signer(self.folder, name)

    def activate(self, mission: Mission | None = None) -> Mission:
        """Activate a mission as an operator would; return it."""
        self.mission = mission or self.mission
        token = sign_object(self.mission, Tag.MISSION, self.signer(self.mission.issuer))
        operator = self.enter(ClientRole.OPERATOR, "activates")
        operator.ask(Kind.ORDER, Order(act=OrderKind.ACTIVATE, token=token))
        operator.leave()
        return self.mission

    def order(self, verb: Verb, **more: Any) -> bytes:
        """Return a signed command about the mission."""
        fields = {
            "verb": verb,
            "mid": self.mission.mid,
            "version": self.mission.version,
            "mission": digest_of(Tag.MISSION, self.mission),
            "nonce": b64(scenarios.random_bytes(16)),
            "expires_ms": self.clock.wall_ms() + 60_000,
            "issued_ms": self.clock.wall_ms() + next(self._orders),  # one after the other
        }
        return sign_object(
            Command(**{**fields, **more}), Tag.COMMAND, self.signer(self.mission.issuer)
        )

    def propose(
        self, planner: Guest, plan: bytes, key: str | None = None, *, dialect: str = "auto"
    ) -> dict[str, Any]:
        """Return the answer to a plan, however long it takes."""
        number = self.begin(planner, plan, key, dialect=dialect)
        return self.rest(planner, number)

    def begin(
        self, planner: Guest, plan: bytes, key: str | None = None, *, dialect: str = "auto"
    ) -> int:
        """Propose a plan and return the request's number; its first step is under way."""
        asked = Propose(key=key or b64(scenarios.random_bytes(9)), plan=plan, dialect=dialect)
        number = planner.say(Kind.PROPOSE, asked)
        self.pump()
        return number

    def stop(self, role: ClientRole, n: int, **more: Any) -> None:
        """Let the lane tell of a stop that it carried out."""
        fields: dict[str, Any] = {
            "epoch": 1,
            "n": n,
            "by": str(role),
            "uid": 5,
            "role": role,
            "time_ms": self.clock.wall_ms(),
            "why": "",
            "stood_ms": 40,
            "life": 0 if self.session is None else self.session.life,
        }
        heard = StopHeard(**{**fields, **more})
        self.do(lambda: self.service.stops.stopped(heard))
        self.pump()
        self.attest()

    # what is so afterwards

    def log(self, kind: str | None = None) -> list[Record]:
        """Return the records of a kind."""
        self.gate.ledger.flush()
        rows = self.gate.ledger.run(lambda act: act.rows(0, 1 << 30))
        found = [read_record(row[1], where="log") for row in rows]
        return [record for record in found if kind in {None, record.kind}]

    def sealed(self, seq: int) -> dict[str, Any]:
        """Return the values beside a record, without their salts."""
        (row,) = self.gate.ledger.run(lambda act: act.rows(seq, 1))
        return {name: item.value for name, item in read_sealed(row[2], where="log").items()}

    @property
    def standing(self) -> Any:
        return self.gate.management.standing(self.mission.mid)

    @property
    def place(self) -> tuple[int, int]:
        return (self.robot.state.x_mm, self.robot.state.y_mm)


def reasons(step: dict[str, Any]) -> list[str]:
    """Return why a released step did not succeed."""
    return [r if isinstance(r, str) else r["reason"] for r in step["execution"]["reasons"]]


def greeting_of(folder: Path) -> Handshake:
    return msgspec.structs.replace(handshake(), verifier=read_trust(folder))


def page(guest: Guest, first: int = 0, count: int = 1_000) -> list[dict[str, Any]]:
    """Return a page of the log as a client gets it."""
    found: list[dict[str, Any]] = guest.ask(Kind.RECORDS, Records(first=first, count=count))[
        "records"
    ]
    return found


# a robot that can be driven


@cache
def driving_site() -> Site:
    """Return the hospital with a robot that takes velocities and says how it brakes."""
    site = braking_site()
    robot = site.robots[scenarios.RID]
    tools = {**robot.profile.tools, ActionType("drive"): ("base",)}
    profile = msgspec.structs.replace(robot.profile, tools=tools)
    robots = {**site.robots, scenarios.RID: msgspec.structs.replace(robot, profile=profile)}
    words = {**site.vocabulary, ActionType("drive"): standard_words()[ActionType("drive")]}
    return msgspec.structs.replace(site, robots=robots, vocabulary=words)


@cache
def driving_trust() -> Path:
    """Return a set-up whose gate is certified for that profile."""
    folder = Path(mkdtemp(prefix="authguard-test-")) / "trust"
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    init_folder(folder, demo_members(driving_site(), (scenarios.RID,)), now=begin)
    return folder


@cache
def driving_binding() -> Binding:
    plain: Any = read_yaml(read_text(scenarios.HOSPITAL / "binding.yaml"), where="binding")
    speeds = {"ahead": "linear_mm_s", "aside": "lateral_mm_s", "turn": "turn_urad_s"}
    arguments = {
        name: {"use": "mapped", "to": f"params.{to}", "per_unit": "1"}
        for name, to in {**speeds, "ms": "duration_ms"}.items()
    }
    tool = {"type": "drive", "tool": "base", "attested": ["source"], "arguments": arguments}
    plain["tools"] = {**plain["tools"], "drive": tool}
    return load_binding(plain, site=driving_site(), where="binding")


def driving_mission(**grant: Any) -> Mission:
    """Return a mission that lets the robot be driven around its dock."""
    drive = {
        "id": "roam",
        "type": "drive",
        "tool": "base",
        "rows": [{"source": "dock", "regions": ["dock"]}],
        "limits": {
            "linear_mm_s": ["-500 mm/s", "500 mm/s"],
            "lateral_mm_s": ["-500 mm/s", "500 mm/s"],
            "turn_urad_s": ["-500000 microradian/s", "500000 microradian/s"],
            "duration_ms": ["0.001 s", "60 s"],
        },
        "chooser": "operator",
        "repeat": 5,
        "starts": 5,
        "max": "1 min",
        "irreversible": False,
        **grant,
    }
    plain = scenarios.draft(grants=[drive], closing=None, limits={})
    plain["risk_policy"] = {
        **plain["risk_policy"],
        "types": {**plain["risk_policy"]["types"], "drive": 5},
    }
    return scenarios.compiled(plain, at=driving_site())


def driving(**more: Any) -> DemoGate:
    """Return a house whose robot can be driven, in its own time."""
    return DemoGate(
        **{
            "site": driving_site(),
            "trust": driving_trust(),
            "binding": driving_binding(),
            "mission": driving_mission(),
            "speed_up": 1,
            **more,
        }
    )


def drive(ahead: int = 100, aside: int = 0, turn: int = 0, ms: int = 30_000) -> bytes:
    return f"drive(ahead={ahead}, aside={aside}, turn={turn}, ms={ms})".encode()


def ticket_of(house: DemoGate) -> Digest:
    """Return the one release that is open."""
    (release,) = house.standing.open
    return Digest(release.ticket)
