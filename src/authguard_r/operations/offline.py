# SPDX-License-Identifier: Apache-2.0
"""A gate without a robot: management acts on a store that no process holds."""

from __future__ import annotations

from pathlib import Path

from authguard_r.anchoring.counter import Counter
from authguard_r.core.action import Action
from authguard_r.core.errors import (
    ControllerError,
)
from authguard_r.core.identifiers import RobotId
from authguard_r.core.lease import Lease
from authguard_r.core.ports import GoalHandle
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.safety import default_config, gate_of
from authguard_r.server.wiring import Gate, LogSettings, assemble
from authguard_r.site.model import Site
from authguard_r.store.clocks import SIMULATED, store_clock
from authguard_r.store.sqlite import open_store


class _NoRobot:
    """Stands where a gate without a robot has its controller and estimator: nothing moves."""

    def latest(self) -> bytes | None:
        """Return nothing: no state is attested."""
        return None

    def fence(self, number: int) -> None:
        """Do nothing: nothing is measured."""

    def dispatch(self, action: Action, lease: Lease) -> GoalHandle:  # noqa: ARG002
        """Refuse: there is no robot here.

        Raises:
            ControllerError: always.
        """
        raise ControllerError("no robot is connected")

    def stop(self) -> None:
        """Do nothing: nothing moves."""


def offline_gate(
    folder: Path, site: Site, *, rid: RobotId, store: Path, counter: Counter | None = None
) -> Gate:
    """Return a gate without a robot, for management of a store that no process holds.

    Args:
        folder: written by `authguard keys init`.
        site: the site.
        rid: the robot.
        store: the store's file.
        counter: the store's own, kept outside of it.

    Raises:
        AuthGuardError: a part is missing, not authentic, or the store is in use.
    """
    nothing, signer = _NoRobot(), folder_signer(folder, gate_name(rid))
    return assemble(
        trust=read_trust(folder),
        chain=signer.chain,
        site=site,
        safety=gate_of(default_config(site, rid)),
        controller=nothing,
        source=nothing,
        clock=store_clock(store),
        store=open_store(store),
        # only a demo folder gets here, and its robot is symbolic
        log=LogSettings(genesis={"clock": SIMULATED}, counter=counter, signer=signer),
        demo=True,
    )
