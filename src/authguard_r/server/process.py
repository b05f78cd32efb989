# SPDX-License-Identifier: Apache-2.0
"""The gate's process from start to end: which resources it opens, in which order, and closes.

Order matters: the robot's name first, then the store, then recovery, then the stop process, and
only then clients. A gate that cannot have all of them serves no client. Spec page:
docs/spec/gate-protocol.md#start-and-end
"""

from __future__ import annotations

import asyncio
import gc
import os
import resource
import shutil
import signal
import socket
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.rotation import Rotation
from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import hold_policy
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.ports import Clock, Controller, SafetyGate
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.emergency_enforcer import EmergencyEnforcer
from authguard_r.estop.supervisor import EStopSupervisor
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import binding_digest
from authguard_r.safety import gate_of, safety_digest
from authguard_r.server.configurations import hold_configured
from authguard_r.server.emergency_wiring import open_emergency_enforcer, open_journal
from authguard_r.server.event_log import EventLog
from authguard_r.server.log_maintenance import checkpoint_policy, rotation_policy
from authguard_r.server.parts import GateParts, SimulatedRobot
from authguard_r.server.periodic import every
from authguard_r.server.plan_reader import PlanReader
from authguard_r.server.recovery import Recovery
from authguard_r.server.remote_controller import RemoteController, ShadowController
from authguard_r.server.robot_lock import Lock, hold_robot, root_fingerprint
from authguard_r.server.service import Service
from authguard_r.server.service_parts import ServiceParts
from authguard_r.server.state_inbox import StateInbox
from authguard_r.server.streams import StreamBounds, Streams
from authguard_r.server.wiring import Gate, GateStore, LogSettings, join, open_gate_store
from authguard_r.site.model import stopping_mm
from authguard_r.store.clocks import SIMULATED, SystemClock
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.store.sqlite import SqliteStore, open_store
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Mode

#: The clients' socket, in the run folder.
SOCKET = "gate.sock"


class Rendezvous(Struct, frozen=True, kw_only=True):
    """Lies beside a store that a gate holds, and says where its clients go."""

    socket: str
    pid: int
    robot: RobotId


def run_gate(parts: GateParts, ready: Callable[[Rendezvous], None]) -> None:
    """Serve clients until SIGTERM or SIGINT; return when everything is written and closed.

    Args:
        parts: what it is started with.
        ready: called once, when clients can connect.

    Raises:
        EnvironmentFault: another gate serves this robot, or a part cannot be used.
        StoreError: the store cannot be used.
        AuthenticityError: the gate's own certificate does not hold.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a connection is a file
    with suppress(OSError):
        os.nice(
            LIMITS.priority
        )  # a flood of the machine waits for the robot, not the robot for the flood
    with ExitStack() as held:
        lock = _hold(parts)
        held.callback(lock.release)
        inbox, safety = StateInbox(), gate_of(parts.safety, asked_ms=LIMITS.safety_ms)
        store = open_store(parts.store, reserve_bytes=parts.config.reserve_bytes)
        opened = _open_store(parts, store, inbox)
        recorder = None if parts.estop is None else EStopSupervisor(parts.estop)
        bounds = _stream_bounds(parts, opened)
        remote = _remote(parts, opened, recorder, bounds)
        gate = _join(parts, opened, safety, _controller(parts, remote))
        held.callback(gate.close)
        recovery = Recovery(gate.management, first=partial(hold_configured, parts, gate.management))
        recovery.begin()
        service = Service(
            ServiceParts(
                gate=gate,
                config=parts.config,
                binder=Binder(parts.site, parts.binding),
                reader=PlanReader(parts.site, parts.binding),
                channels=dict(parts.site.channels),
                signer=parts.signer,
                inbox=inbox,
                controller=remote,
                streams=None if remote is None else Streams(gate.ledger, remote, bounds),
                recovery=recovery,
                journal=EventLog(parts.journal),
                advance=_advance(parts),
                rotation=_rotation(parts, gate, store),
                emergency=_emergency(parts, gate, held),
                free_bytes=partial(_free_bytes, parts.store.absolute().parent),
                stop_process_alive=None if recorder is None else partial(_is_alive, recorder),
            )
        )
        service.begin()
        if recorder is not None:
            held.callback(recorder.end)
            recorder.start()
        asyncio.run(_serve(parts, service, recorder, lock=lock, ready=ready))
        if gate.ended():
            recovery.end()
        else:  # it starts as after a crash, and an alert says why
            service.events.publish({"event": "alert", "what": "refusals could not be recorded"})


def _emergency(parts: GateParts, gate: Gate, held: ExitStack) -> EmergencyEnforcer | None:
    """Return what carries out emergencies, if a policy was signed."""
    if parts.emergency is None:
        return None
    beside = parts.store.with_name(f"{parts.store.name}.emergency")
    journal = open_journal(parts.emergency.journal or beside, gate.ledger, parts.signer)
    held.callback(journal.close)
    enforcer = open_emergency_enforcer(gate, parts.emergency.policy, journal)
    held.callback(enforcer.log.flush)
    return enforcer


def _hold(parts: GateParts) -> Lock:
    root = root_fingerprint(parts.trust.root)
    return hold_robot(parts.config.robot, root, run=parts.run, key=parts.key, store=parts.store)


def _open_store(parts: GateParts, store: SqliteStore, inbox: StateInbox) -> GateStore:
    """Return the store, open, with a connected estimator or a simulated one."""
    named = {"binding": binding_digest(parts.binding), "safety": safety_digest(parts.safety)}
    clock = {} if parts.simulated is None else {"clock": SIMULATED}
    sealing = SealingPolicy(readers=parts.config.readers, retention=parts.config.retention)
    log = LogSettings(
        genesis={**named, **clock},
        sealed={"safety": parts.safety},
        marks={"mode": str(Mode.SHADOW)} if parts.config.mode is Mode.SHADOW else {},
        refusals=_policy(parts.config),
        checkpoints=checkpoint_policy(parts.config),
        sealing=sealing,
        counter=parts.counter,
        signer=parts.signer,
    )
    return open_gate_store(
        store,
        trust=parts.trust,
        chain=parts.signer.chain,
        site=parts.site,
        source=parts.simulated or inbox,
        clock=_clock(parts),
        log=log,
        demo=parts.demo,
        risk=() if parts.risk is None else (parts.risk.policy.policy,),
    )


def _join(parts: GateParts, opened: GateStore, safety: SafetyGate, controller: Controller) -> Gate:
    gate = join(
        opened,
        safety=safety,
        controller=controller,
        clock=_clock(parts),
        stand_within_ms=parts.config.stand_within_ms,
        recovers=False,
    )
    hold_policy(gate.ledger.store, opened.sealing)  # once it is known that the store is this gate's
    return gate


def _controller(parts: GateParts, remote: RemoteController | None) -> Controller:
    """Return the controller: connected, in this process, or none in shadow mode."""
    if parts.config.mode is Mode.SHADOW:
        return ShadowController()
    made = remote if parts.simulated is None else parts.simulated
    if made is None:  # pragma: no cover - `_remote` makes one unless a robot is simulated
        raise RuntimeError("a gate that enforces has no controller")
    return made


def _clock(parts: GateParts) -> Clock:
    return parts.simulated or SystemClock()


def _remote(
    parts: GateParts, opened: GateStore, recorder: EStopSupervisor | None, bounds: StreamBounds
) -> RemoteController | None:
    """Return the controller's end; None in shadow mode, and for a robot in this process."""
    if parts.config.mode is Mode.SHADOW or parts.simulated is not None:
        return None
    stops: dict[str, Any] = {}
    if recorder is not None:
        stops = {"ask": recorder.sync, "can_stop": partial(_is_alive, recorder)}
    return RemoteController(
        opened.ledger.mono_ms,
        renew_within_ms=parts.config.renew_within_ms,
        admit=bounds.admit,
        **stops,
    )


def _rotation(parts: GateParts, gate: Gate, store: SqliteStore) -> Rotation:
    return Rotation(
        gate.ledger,
        store,
        robot=parts.config.robot,
        signer=parts.signer,
        policy=rotation_policy(parts.config),
    )


def _policy(config: GateConfig) -> RefusalPolicy:
    """Return what waits and what is counted; a shadow run is there to be read, so nothing is."""
    shadow = config.mode is Mode.SHADOW
    return RefusalPolicy(
        delay_ms=LIMITS.refusal_delay_ms,
        fold_ms=0 if shadow else config.fold_ms,
        users=len({peer.uid for peer in config.peers}) + 1,  # and the one without a name
    )


def _stream_bounds(parts: GateParts, opened: GateStore) -> StreamBounds:
    profile = parts.site.robots[parts.config.robot].profile
    return StreamBounds(
        opened.facts,
        opened.ledger.mono_ms,
        stopping_mm=partial(stopping_mm, profile),
        state=lambda: opened.inputs.newest,
    )


def _advance(parts: GateParts) -> Callable[[bool], None] | None:
    robot = parts.simulated
    if robot is None:
        return None
    pace = _Pace(robot)
    pace(moving=False)  # what the start has taken
    return pace


class _Pace:
    """How simulated time passes: a look at a time while something moves, else as all clocks go.

    A mission that begins now by its author's clock is not to wait for a simulation that lost time;
    one that is ahead, for it has moved, goes on as fast as time does, however often it is asked.
    """

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot, self._clock = robot, SystemClock()
        self._asked_ms = self._clock.mono_ms()

    def __call__(self, moving: bool) -> None:  # noqa: FBT001 - one of two paces
        robot, now_ms = self._robot, self._clock.mono_ms()
        passed_ms, self._asked_ms = now_ms - self._asked_ms, now_ms
        behind_ms = min(self._clock.wall_ms() - robot.wall_ms(), LIMITS.catch_up_ms)
        robot.pause(LIMITS.watch_ms if moving else max(behind_ms, passed_ms))
        del robot.trace[:-1]  # a process lives long


def _free_bytes(folder: Path) -> int:
    return shutil.disk_usage(folder).free


def _is_alive(recorder: EStopSupervisor) -> bool:
    return recorder.alive


async def _serve(
    parts: GateParts,
    service: Service,
    recorder: EStopSupervisor | None,
    *,
    lock: Lock,
    ready: Callable[[Rendezvous], None],
) -> None:
    """Listen, call `ready`, and serve until the service ends."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, service.ended.set)
    answering = asyncio.ensure_future(every(LIMITS.lock_answer_s, lock.answer))
    keeping = await _keep(recorder, service)
    path = parts.run / SOCKET
    server = await _listen(path, service)
    told = Rendezvous(socket=str(path.absolute()), pid=os.getpid(), robot=parts.config.robot)
    beside = parts.store.with_name(f"{parts.store.name}.gate")
    beside.write_bytes(msgspec.json.encode(told))
    gc.collect()
    gc.freeze()  # what was loaded stays: the collector need not go through it in mid-motion
    try:
        ready(told)
        await service.run()
    finally:
        answering.cancel()
        keeping.cancel()
        server.close()
        beside.unlink(missing_ok=True)
        path.unlink(missing_ok=True)


async def _keep(recorder: EStopSupervisor | None, service: Service) -> asyncio.Future[None]:
    """Hear of stops from now on, those before the start included; then clients may come."""
    if recorder is None:
        return asyncio.get_running_loop().create_future()
    connected = asyncio.Event()
    keeping = asyncio.ensure_future(recorder.keep(service.stops, connected.set))
    await connected.wait()
    return keeping


async def _listen(path: Path, service: Service) -> asyncio.Server:
    """Listen at the path; the robot's lock is ours, so a socket that lies there is a dead one's."""
    path.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        server = await asyncio.get_running_loop().create_unix_server(
            service.connect, sock=listener, backlog=LIMITS.accepted_at_once
        )
        listener.listen(LIMITS.backlog)
        path.chmod(0o660)  # the folder and its group say who may reach it
    except OSError as error:
        listener.close()
        raise EnvironmentFault(
            f"cannot listen: {error.strerror or error}",
            reason=Reason.SERVICE_UNAVAILABLE,
            where=str(path),
        ) from error
    return server
