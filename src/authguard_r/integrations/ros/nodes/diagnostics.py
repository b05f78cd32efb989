# SPDX-License-Identifier: Apache-2.0
"""How gate, node and robot stand, once a second: for monitors and displays.

It says what is known now. What is not known any more is STALE, and nothing is called OK that was
not seen to be so. Spec page: docs/spec/ros.md#diagnostics
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from msgspec import Struct
from rclpy.qos import DurabilityPolicy, QoSProfile

from authguard_r.client.controller import ControllerSession, MessageSource
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.body import RosBody
from authguard_r.integrations.ros.nodes.decisions import Decisions
from authguard_r.integrations.ros.nodes.values import message_of
from authguard_r.integrations.ros.rights import DIAGNOSTICS

PERIOD_S = 1.0
_NS = 1_000_000_000


class ReportedStatus(Struct, frozen=True, kw_only=True):
    """How everything stands, by the names of `GateStatus`.

    Args:
        connected: the gate proved itself, and its connection is there.
        lane: the same of the stop process.
        answers: the gate answered just now.
        why: why it did not.
        mission_active: as the gate said last, as the counts are.
        refusals: since the gate started.
        stops: by the stop process, since then.
        last_stop: what stopped the robot last, as far as it was heard.
        stands: nothing runs, and nothing is being stopped.
        braking: something is being stopped, and no message confirms that it stands.
        running: what runs.
        missing: what of the robot is not there.
        missed: decisions that were never published.
        is_watched: a subscriber hears the heartbeat, as the graph says; not in `GateStatus`.
    """

    connected: bool
    lane: bool
    answers: bool
    why: str
    mission_active: bool
    refusals: int
    stops: int
    last_stop: str
    stands: bool
    braking: bool
    running: str
    missing: tuple[str, ...]
    missed: int
    is_watched: bool


class Diagnostics:
    """Says how everything stands.

    Args:
        public: the node.
        ros: whose.
        body: the robot.
        session: the gate's connections.
        decisions: what is heard of the gate.
        kind: `authguard_interfaces/msg/GateStatus`.
    """

    def __init__(
        self,
        public: Public,
        ros: RosMap,
        *,
        body: RosBody,
        session: ControllerSession,
        decisions: Decisions,
        kind: Any,
    ) -> None:
        self._robot, self._kind = str(ros.robot), kind
        self._body, self._session, self._decisions = body, session, decisions
        self._node, self._heartbeat = public.spinner.node, ros.heartbeat
        node, group = public.spinner.node, public.group
        last = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._diagnostics = node.create_publisher(
            DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=10), callback_group=group
        )
        self._status = node.create_publisher(kind, ros.status, last, callback_group=group)

    async def stay(self) -> None:
        """Look once a second until this is canceled."""
        while True:
            pause = asyncio.create_task(asyncio.sleep(PERIOD_S))
            self._say(await self._look())
            await pause

    async def _look(self) -> ReportedStatus:
        """Return how everything stands; what the gate does not say is as it said it last."""
        why = await self._decisions.ask()
        body, session, counts = self._body, self._session, self._decisions.counts
        return ReportedStatus(
            connected=session.hears(MessageSource.GATE),
            lane=session.hears(MessageSource.STOP),
            answers=not why,
            why=why,
            mission_active=bool(counts.get("mission_active")),
            refusals=counts.get("decisions_total", {}).get("reject", 0),
            stops=counts.get("stops_total", 0),
            last_stop=self._decisions.last_stop,
            stands=session.stands and body.stands,
            braking=not body.stands,
            running=body.running,
            missing=body.missing,
            missed=self._decisions.missed,
            is_watched=self._node.count_subscribers(self._heartbeat) > 0,
        )

    def _say(self, seen: ReportedStatus) -> None:
        now_ns = time.time_ns()
        stamp = {"sec": now_ns // _NS, "nanosec": now_ns % _NS}
        named = {name: getattr(seen, name) for name in seen.__struct_fields__}
        del named["braking"], named["is_watched"]
        plain = {**named, "missing": list(seen.missing), "robot": self._robot, "stamp": stamp}
        self._status.publish(message_of(self._kind, plain, where="status"))
        array = DiagnosticArray(status=statuses(seen, self._robot))
        array.header.stamp.sec, array.header.stamp.nanosec = stamp["sec"], stamp["nanosec"]
        self._diagnostics.publish(array)


def statuses(seen: ReportedStatus, robot: str) -> list[DiagnosticStatus]:
    """Return what monitors see: of the gate, of the robot, and of the gate's decisions."""
    told: list[tuple[str, tuple[bytes, str], dict[str, object]]] = [
        ("gate", _of_gate(seen), {"mission_active": seen.mission_active, "lane": seen.lane}),
        (
            "robot",
            _of_robot(seen),
            {"stands": seen.stands, "runs": seen.running, "missing": ", ".join(seen.missing)},
        ),
        (
            "decisions",
            _of_decisions(seen),
            {
                "refusals": seen.refusals,
                "stops": seen.stops,
                "last_stop": seen.last_stop,
                "missed": seen.missed,
            },
        ),
    ]
    return [
        DiagnosticStatus(
            level=level,
            name=f"authguard: {name}",
            message=message,
            hardware_id=robot,
            values=[KeyValue(key=key, value=_said(value)) for key, value in values.items()],
        )
        for name, (level, message), values in told
    ]


def _of_gate(seen: ReportedStatus) -> tuple[bytes, str]:
    if not seen.connected:
        return DiagnosticStatus.ERROR, "not connected: nothing is released"
    if not seen.answers:
        return DiagnosticStatus.ERROR, f"does not say how it stands: {seen.why}"
    if not seen.lane:
        return DiagnosticStatus.WARN, "the stop process is not connected"
    return DiagnosticStatus.OK, "connected"


def _of_robot(seen: ReportedStatus) -> tuple[bytes, str]:
    if seen.braking:
        return DiagnosticStatus.ERROR, "is being stopped: its standstill is not confirmed"
    if seen.missing:
        return DiagnosticStatus.WARN, f"not there: {', '.join(seen.missing)}"
    if not seen.is_watched:
        return (
            DiagnosticStatus.WARN,
            "no process receives the heartbeat: no dead-man would cancel a goal",
        )
    if seen.running:
        return DiagnosticStatus.OK, f"runs: {seen.running}"
    return DiagnosticStatus.OK, "stands"


def _of_decisions(seen: ReportedStatus) -> tuple[bytes, str]:
    if not seen.answers:
        return DiagnosticStatus.STALE, "not heard: the counts are old"
    if seen.missed:
        return DiagnosticStatus.WARN, f"{seen.missed} were never published"
    return DiagnosticStatus.OK, "heard"


def _said(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
