# SPDX-License-Identifier: Apache-2.0
"""The robot's place out of its own localization, signed for its gate.

`python -m authguard_r.integrations.ros.nodes.estimator --map ... --gate ... --site ... --trust ...
--key ... --cert ...`. It publishes nothing and serves nothing.
While anything is doubtful it attests nothing: the state grows old, and the gate stops the robot by
itself.
Spec page: docs/spec/ros-position.md
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct
from rclpy.node import Node

from authguard_r.access.files import trusted_site
from authguard_r.client.attesting import Attester, AttestingEnd, Measurement, aged
from authguard_r.client.handshake import GateVerifier
from authguard_r.client.link import ProcessLog, require_folder, run_all, until_signal, wall_now
from authguard_r.client.sensing import listen, read_raw
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import Identifier, RobotId, VariableId
from authguard_r.core.principals import Signer
from authguard_r.core.provenance import Label
from authguard_r.core.reasons import Reason
from authguard_r.core.state import Pose, Reading, Snapshot
from authguard_r.integrations.ros.map import Position, RosMap, read_map
from authguard_r.integrations.ros.nodes.localization import Localization
from authguard_r.integrations.ros.nodes.loop import raised, spun
from authguard_r.integrations.ros.nodes.process import DEMO, plain_node, require_bench, ros_context
from authguard_r.integrations.ros.position import MS, Fix, PositionTrack
from authguard_r.integrations.ros.rights import ESTIMATOR_NODE
from authguard_r.integrations.ros.security import require_security
from authguard_r.keys.key_access import open_named, read_passphrase, require_estimator
from authguard_r.keys.signer import certified
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import Site
from authguard_r.wire.frames import Frame

#: Default for the most snapshots in a second.
RATE_HZ = 20
MAX_RATE_HZ = 200
SPEED = VariableId("speed_mm_s")
#: The fastest message of a localization may have taken so long on its way, in milliseconds.
PATH_MS = 250
#: What rounding to whole millimeters adds to the margin.
_ROUNDED_MM = 1


class EstimatorTarget(Struct, frozen=True, kw_only=True):
    """Which robot, which gate, and by which key.

    Args:
        ros: the robot's map.
        position: of it, where the place comes from.
        run: the gate's run folder.
        max_speed_mm_s: of the robot's profile.
        signer: the estimator's key.
        trust: reads the trust root.
        rate_hz: most snapshots in a second.
    """

    ros: RosMap
    position: Position
    run: Path
    max_speed_mm_s: int
    signer: Signer
    trust: Callable[[], GateVerifier]
    rate_hz: int


class Estimate:
    """What is attested: place and speed by the localization, and the rest by the sensors.

    Args:
        robot: whose.
        position: what the map says of its place.
        fix: returns what the localization says, None while anything is doubtful.
    """

    def __init__(self, robot: RobotId, position: Position, fix: Callable[[], Fix | None]) -> None:
        self._robot = robot
        self._position = position
        self._fix = fix
        self._others: Measurement | None = None

    def heard(self, item: Frame, now_ms: int) -> None:
        """Take raw values from the sensors.

        Raises:
            MalformedError: it is no snapshot of this robot.
        """
        self._others = read_raw(item, now_ms, self._robot)

    def look(self, now_ms: int) -> Measurement | None:
        """Return what may be signed now, each value as old as it is; None: nothing."""
        fix, others = self._fix(), self._others
        if fix is None:
            return None
        readings = {}
        if others is not None:
            readings = aged(others.snapshot, now_ms - others.measured_ms).readings
        position, label = self._position, Label.TRUSTED_SENSOR
        age_ms = max(0, now_ms - fix.measured_ns // MS)
        pose = Pose(
            map=Identifier(position.map),
            floor=position.floor,
            x_mm=fix.x_mm,
            y_mm=fix.y_mm,
            margin_mm=position.margin_mm + _ROUNDED_MM,
            label=label,
            age_ms=age_ms,
        )
        # even if the sensors say more: the pose and the speed come from one source
        speed = Reading(value=fix.speed_mm_s, label=label, age_ms=age_ms)
        snapshot = Snapshot(
            robot=self._robot, epoch=0, seq=0, pose=pose, readings={**readings, SPEED: speed}
        )
        return Measurement(snapshot, now_ms, PATH_MS)


def located(ros: RosMap, site: Site) -> Position:
    """Return where a robot's place comes from.

    Raises:
        MalformedError: the map does not say it, or says it of no floor of the site.
    """
    position = ros.position
    if position is None:
        raise MalformedError("expected `position`: where the place comes from", where="position")
    if ros.robot not in site.robots:
        raise MalformedError("expected a robot of the site", where="map.robot")
    if position.margin_mm < 0:
        raise MalformedError("expected a margin", where="position.margin_mm")
    floors = {(region.map, region.floor) for region in site.regions.values()}
    if (position.map, position.floor) not in floors:
        raise MalformedError("expected a map and a floor of the site's regions", where="position")
    return position


async def attest(place: EstimatorTarget, log: ProcessLog, until: asyncio.Event) -> None:
    """Attest the robot's place until the event is set.

    Raises:
        EnvironmentFault: a type is not installed, or the node has stopped spinning.
    """
    robot, position = place.ros.robot, place.position
    name = ESTIMATOR_NODE.removeprefix("/")
    enclave = place.ros.enclaves.estimator
    with ros_context(place.ros, enclave) as context:
        node = plain_node(name, context, enclave)
        async with spun(node, reason=Reason.STATE_MISSING) as (spinner, failed):
            heard = await spinner.do(_localization, node, place, log)
            estimate = Estimate(robot, position, lambda: heard.fix)
            end = AttestingEnd(
                robot,
                Attester(place.signer, epoch=wall_now().utc_ms, rate_hz=place.rate_hz),
                place.run,
                trust=place.trust,
                look=estimate.look,
                ready=lambda: _ready(robot),
                log=log,
            )
            listening = listen(place.run, estimate.heard, log)
            await run_all((end.stay(), end.sign(), listening, raised(failed)), until=until)


def _localization(node: Node, place: EstimatorTarget, log: ProcessLog) -> Localization:
    track = PositionTrack(max_speed_mm_s=place.max_speed_mm_s, margin_mm=place.position.margin_mm)
    return Localization(node, place.position, track, log)


def _ready(robot: RobotId) -> None:
    told = {"ready": True, "robot": robot, "role": "estimator"}
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Attest until SIGTERM or SIGINT; a line of JSON says that the gate took the first snapshot."""
    asks = argparse.ArgumentParser(prog="python -m authguard_r.integrations.ros.nodes.estimator")
    asks.add_argument("--gate", "--run", dest="run", type=Path, required=True)
    for name in ("map", "site", "trust", "key", "cert"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--passphrase-file", type=Path)
    rates = range(1, MAX_RATE_HZ + 1)
    asks.add_argument("--rate", type=int, default=RATE_HZ, choices=rates, metavar="HZ")
    asks.add_argument(DEMO, action="store_true", help="a bench: no DDS security is needed")
    given = asks.parse_args()
    try:
        place = _place(given)
        asyncio.run(until_signal(lambda until: attest(place, ProcessLog(), until)))
    except AuthGuardError as error:
        sys.exit(str(error))


def _place(given: argparse.Namespace) -> EstimatorTarget:
    """Return what the words name, each of it held to what it has to be."""
    ros = read_map(given.map)
    if not given.demo:
        require_security(ros, ros.enclaves.estimator, os.environ)
    require_folder(given.run)
    trust = read_trust(given.trust)
    require_bench(trust, demo=given.demo)
    site = trusted_site(given.site, trust)
    position = located(ros, site)
    asked = given.passphrase_file
    passphrase = None if asked is None else lambda _: read_passphrase(asked)
    signer = certified(open_named(given.key, passphrase), given.cert)
    require_estimator(signer, trust, ros.robot, wall_now(), where=given.cert)
    return EstimatorTarget(
        ros=ros,
        position=position,
        run=given.run,
        max_speed_mm_s=site.robots[ros.robot].profile.max_speed_mm_s,
        signer=signer,
        trust=lambda: read_trust(given.trust),
        rate_hz=given.rate,
    )


if __name__ == "__main__":
    main()
