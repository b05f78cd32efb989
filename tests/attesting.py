# SPDX-License-Identifier: Apache-2.0
"""An estimator for a robot that is no simulation: it signs where a test says that the robot is."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RegionId
from authguard_r.core.token import sign_object
from authguard_r.sim.sight import snapshot_of
from authguard_r.sim.world import initial_state
from authguard_r.wire.messages import ClientRole
from gates import RunningGate

#: Between two snapshots, in seconds.
PAUSE_S = 0.05


class Attested:
    """Where the robot is said to be.

    Args:
        region: at first.
    """

    def __init__(self, region: str) -> None:
        self.state = initial_state(worlds.site(), RegionId(region))

    def move(self, region: str) -> None:
        """Be somewhere else from now on."""
        self.state = initial_state(worlds.site(), RegionId(region))


@contextmanager
def attesting(gate: RunningGate, region: str = "dock") -> Iterator[Attested]:
    """Send signed snapshots while the gate runs; the first is taken in when this begins."""
    signer = folder_signer(gate.trust, f"estimator-{gate.rid}")
    client, over = gate.client(ClientRole.ESTIMATOR), threading.Event()
    said, first = Attested(region), threading.Event()

    def send() -> None:
        epoch, seq = int(time.time()), 0
        while not over.is_set():
            seq += 1
            seen = snapshot_of(said.state, robot=gate.rid, epoch=epoch, seq=seq)
            try:
                client.attest(sign_object(seen, Tag.STATE, signer))
            except EnvironmentFault:  # the test ended its gate
                return
            first.set()
            over.wait(PAUSE_S)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        assert first.wait(20)
        yield said
    finally:
        over.set()
        thread.join()
