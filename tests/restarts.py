# SPDX-License-Identifier: Apache-2.0
"""One robot whose gate comes and goes: a store in memory that gates end, are killed and begin on.

here = Station()
here.gate.management.activate(here.token(mission))
running = here.submit(GO["pharmacy"])      # a Report when it was refused, else an action that runs
here.finish(running), here.abort(running)  # or neither, and `here.kill()`

A gate begins as its process does: it says that it runs, recovers, and says when it stopped.
Simulated time jumps; nothing waits.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec

import worlds
from authguard_r.anchoring.counter import Counter
from authguard_r.assembly import Gate, assemble, folder_signer
from authguard_r.commands import Command, Verb
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Standing
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.normalize import Binder, Step
from authguard_r.normalize.context import ContextLedger
from authguard_r.report import Report
from authguard_r.running import Running
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.sim.robot import ESTIMATE_MS, SymbolicRobot
from authguard_r.sim.state import WorldState
from authguard_r.store.memory import MemoryStore

SAFETY = EnvelopeGate(default_config(worlds.site(), worlds.RID))
#: How long a gate is away between two lives.
AWAY_MS = 500


@cache
def signer(name: str) -> FileSigner:
    """Return a principal's key out of the test set-up, read once."""
    return folder_signer(worlds.trust_folder(), name)


@cache
def trust() -> Trust:
    return read_trust(worlds.trust_folder())


@cache
def spellings() -> Any:
    return Binder(worlds.site(), worlds.binding()).spellings()


def copied(store: MemoryStore) -> MemoryStore:
    """Return a copy of everything that is on disk."""
    made = MemoryStore()
    made._held, made._rows = dict(store._held), list(store._rows)
    return made


def way(to: str) -> dict[str, Any]:
    """Return the row of a way from the dock."""
    return {"source": "dock", "destination": to, "regions": sorted({"dock", "public-corridor", to})}


def go(to: str, *, speed: int = 500) -> Action:
    return worlds.navigate("dock", to, speed=speed)


class Station:
    """A robot at its dock, a store, and the gate of the moment.

    Args:
        counter: kept outside of the store.
        verifier: who is trusted; one of its own for a test that changes lists.
    """

    def __init__(self, *, counter: Counter | None = None, verifier: Trust | None = None) -> None:
        self.store = MemoryStore()
        self.at_ms = worlds.START_MS
        self._counter = counter
        self._trust = verifier or trust()
        self._epoch = 0
        self._nonces = 0
        self.world: WorldState = worlds.world("dock")
        self.begin()

    gate: Gate
    robot: SymbolicRobot

    def begin(self) -> None:
        """Start a gate on whatever the store holds, as its process does."""
        self._epoch = max(self._epoch + 1, self.at_ms)
        self.robot = SymbolicRobot(
            worlds.site(),
            worlds.RID,
            self.world,
            estimator=signer(f"estimator-{worlds.RID}"),
            start_ms=self.at_ms,
            epoch=self._epoch,
        )
        own = signer(f"gate-{worlds.RID}")
        self.gate = assemble(
            trust=self._trust,
            chain=own.chain,
            site=worlds.site(),
            safety=SAFETY,
            controller=self.robot,
            source=self.robot,
            clock=self.robot,
            store=self.store,
            genesis={},
            demo=True,
            counter=self._counter,
            signer=None if self._counter is None else own,
        )
        management = self.gate.management
        self.unclean = management.started()
        self.unresolved = management.recover(unclean=self.unclean)

    def _leave(self) -> None:
        self.at_ms = self.robot.wall_ms() + AWAY_MS
        self.robot.stop()
        self.world = worlds.world("dock")

    def restart(self) -> None:
        """End the gate cleanly and begin the next."""
        self._leave()
        self.gate.management.stopped()
        held = copied(self.store)
        self.gate.close()
        self.store = held
        self.begin()

    def kill(self) -> None:
        """Begin the next gate on what is on disk; the one before never said a word."""
        self._leave()
        self.store = copied(self.store)
        self.begin()

    def jump(self, duration_ms: int) -> None:
        """Let time pass at once; nothing may be in motion."""
        self.robot.elapsed_ms += -(-duration_ms // ESTIMATE_MS) * ESTIMATE_MS
        self.robot._observe()

    def somebody(self, *, near: bool) -> None:
        """Let a person come near the robot, or go away again."""
        distance = 3_000 if near else 5_000
        self.robot.state = msgspec.structs.replace(self.robot.state, human_distance_mm=distance)
        self.jump(ESTIMATE_MS)

    # proposals

    def submit(self, action: Action, **more: Any) -> Report | Running:
        return self.gate.enforcer.submit(
            Step(action=action, attested=()),
            planner="planner",
            evidence=b64(bytes(32)),
            context=ContextLedger(spellings()),
            **more,
        )

    def finish(self, running: Running) -> Report:
        """Let an action run to its end, and put the robot back at its dock."""
        for _ in range(60):
            self.robot.pause(2_000)
            report = running.poll()
            if report is not None:
                break
        else:
            raise AssertionError("the action never ended")
        self._home()
        return report

    def abort(self, running: Running) -> Report:
        """Stop an action, and put the robot back at its dock."""
        self.robot.stop()
        report = running.poll()
        assert report is not None
        self._home()
        return report

    def _home(self) -> None:
        distance = self.robot.state.human_distance_mm
        home = worlds.world("dock")
        self.robot.state = msgspec.structs.replace(home, human_distance_mm=distance)
        self.jump(ESTIMATE_MS)

    # what is signed

    def standing(self, mid: str) -> Standing | None:
        return self.gate.management.standing(mid)  # type: ignore[arg-type]

    def order(self, mission: Mission, verb: Verb, by: str = "operator-1", **more: Any) -> bytes:
        """Return a signed order about a mission, fresh each time."""
        self._nonces += 1
        fields: dict[str, Any] = {
            "verb": verb,
            "mid": mission.mid,
            "version": mission.version,
            "mission": digest_of(Tag.MISSION, mission),
            "nonce": b64(b"order" + self._nonces.to_bytes(4, "big")),
            "expires_ms": self.robot.wall_ms() + 600_000,
        }
        return sign_object(Command(**{**fields, **more}), Tag.COMMAND, signer(by))

    def token(self, mission: Mission, by: str = "operator-1") -> bytes:
        return sign_object(mission, Tag.MISSION, signer(by))
