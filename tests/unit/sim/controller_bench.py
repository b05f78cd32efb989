# SPDX-License-Identifier: Apache-2.0
"""One controller's desk with a robot that can brake, and gates that prove themselves with keys."""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.client.controller import ControllerSession, MessageSource, OutgoingMessage
from authguard_r.client.handshake import Handshake
from authguard_r.client.proof import Proven, prove
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import ActionType, Digest, RobotId
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.sim.body import SymbolicBody
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.site.model import Site
from authguard_r.wire.frames import Frame, FrameReader, frame
from authguard_r.wire.messages import (
    PROTOCOL,
    ClientRole,
    Close,
    Dispatch,
    Forward,
    Halt,
    Kind,
    Mode,
    Proof,
    Renew,
    Welcome,
)
from fixtures import scenarios

BRAKE_MM_S2 = 500
NONCE = b64(bytes(range(32)))


def handshake(role: ClientRole = ClientRole.CONTROLLER) -> Handshake:
    return Handshake(
        role=role,
        client="controller-courier-1",
        verifier=read_trust(scenarios.trust_folder()),
        robot=scenarios.RID,
        allow_shadow=True,
    )


def welcome(by: str | None = f"gate-{scenarios.RID}", **changes: Any) -> Frame:
    """Return what a server answers whose key is the one of `by`, with one thing changed."""
    said: dict[str, Any] = {"robot": scenarios.RID, "role": ClientRole.CONTROLLER, "nonce": NONCE}
    proof = Proof(**{**said, **{k: v for k, v in changes.items() if k in said}})
    token = None
    if by is not None:
        tag = changes.get("tag", Tag.HANDSHAKE)
        token = sign_object(proof, tag, folder_signer(scenarios.trust_folder(), by)).decode()
    message = Welcome(
        protocol=changes.get("protocol", PROTOCOL),
        robot=changes.get("claims", scenarios.RID),
        mode=Mode.ENFORCE,
        role=ClientRole.CONTROLLER,
        client="controller-courier-1",
        site=changes.get("site"),
        binding=changes.get("binding", msgspec.UNSET),
        proof=token,
    )
    return framed(Kind.WELCOME, message)


def proven() -> Proven:
    return prove(welcome(), handshake(), nonce=NONCE, now=scenarios.NOW)


#: The start of the controller on a bench.
LIFE = 42


def framed(kind: Kind, message: object, number: int = 0) -> Frame:
    """Return a message as it comes out of a socket."""
    (item,) = FrameReader(lambda _: 1 << 20).feed(frame(kind, number, message))
    return item


def ticket(number: int) -> Digest:
    return Digest(f"{number:043}")


def braking_site(brake_mm_s2: int | None = BRAKE_MM_S2) -> Site:
    """Return the hospital with a robot whose profile says how it brakes."""
    site = scenarios.site()
    robot = site.robots[scenarios.RID]
    profile = msgspec.structs.replace(robot.profile, brake_mm_s2=brake_mm_s2, reaction_ms=100)
    robots = {**site.robots, scenarios.RID: msgspec.structs.replace(robot, profile=profile)}
    return msgspec.structs.replace(site, robots=robots)


def drive(linear: int = 0, *, duration: int = 60_000, **params: int) -> Action:
    asked = {"linear_mm_s": linear, "duration_ms": duration, **params}
    return Action(type=ActionType("drive"), tool="base", params=asked)


class Bench:
    """A desk with its clock; what it sends is kept."""

    def __init__(
        self,
        *,
        faults: Faults | None = None,
        brake_mm_s2: int | None = BRAKE_MM_S2,
        at: str = "dock",
        opened: tuple[MessageSource, ...] = (MessageSource.GATE, MessageSource.STOP),
        rid: RobotId = scenarios.RID,
    ) -> None:
        self.robot = SymbolicRobot(
            braking_site(brake_mm_s2),
            rid,
            scenarios.world(at),
            estimator=None,
            start_ms=scenarios.START_MS,
            faults=faults or Faults(),
        )
        self.now_ms = 5_000
        self.session = ControllerSession(SymbolicBody(self.robot), life=LIFE, now_ms=self.now_ms)
        self.sent: list[OutgoingMessage] = []
        for channel in opened:
            self.open(channel)

    def open(self, channel: MessageSource = MessageSource.GATE) -> None:
        self.sent += self.session.opened(channel, proven(), self.now_ms)

    def close(self, channel: MessageSource = MessageSource.GATE) -> None:
        self.sent += self.session.closed(channel, self.now_ms)

    def say(
        self,
        kind: Kind,
        message: object,
        channel: MessageSource = MessageSource.GATE,
        number: int = 0,
    ) -> list[OutgoingMessage]:
        got = self.session.handle(channel, framed(kind, message, number), self.now_ms)
        self.sent += got
        return list(got)

    def dispatch(
        self, action: Action | None = None, number: int = 1, **changes: Any
    ) -> list[OutgoingMessage]:
        order: dict[str, Any] = {
            "ticket": ticket(number),
            "action": action or scenarios.navigate("dock", "pharmacy", speed=800),
            "max_ms": 600_000,
            "renew_within_ms": 300,
            "life": LIFE,
            "stops": self.session.stops,
        }
        channel = changes.pop("channel", MessageSource.GATE)
        return self.say(Kind.DISPATCH, Dispatch(**{**order, **changes}), channel, 77)

    def renew(self, number: int = 1) -> None:
        self.say(Kind.RENEW, Renew(ticket=ticket(number)))

    def halt(
        self, channel: MessageSource = MessageSource.GATE, number: int = 9
    ) -> list[OutgoingMessage]:
        return self.say(Kind.HALT, Halt(), channel, number)

    def sample(self, number: int = 1, **params: int) -> None:
        self.say(Kind.FORWARD, Forward(ticket=ticket(number), params=params))

    def finish(self, number: int = 1) -> None:
        self.say(Kind.CLOSE, Close(ticket=ticket(number)))

    def wait(self, duration_ms: int, *, renewing: int | None = 1, every_ms: int = 20) -> None:
        """Let time pass in ticks, with a renewal in each unless nobody renews."""
        until = self.now_ms + duration_ms
        while self.now_ms < until:
            self.now_ms = min(until, self.now_ms + every_ms)
            if renewing is not None:
                self.renew(renewing)
            self.sent += self.session.tick(self.now_ms)

    @property
    def place(self) -> tuple[int, int]:
        return (self.robot.state.x_mm, self.robot.state.y_mm)

    @property
    def speed(self) -> int:
        return self.robot.state.speed_mm_s

    def said(self, channel: MessageSource | None = None) -> list[tuple[str, str, str]]:
        """Return kind, outcome or number of stops, and why, of everything that was sent."""
        return [
            (
                sent.kind.name,
                str(getattr(sent.body, "outcome", getattr(sent.body, "stops", ""))),
                getattr(sent.body, "why", ""),
            )
            for sent in self.sent
            if channel in {None, sent.channel}
        ]
