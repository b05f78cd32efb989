# SPDX-License-Identifier: Apache-2.0
"""One gate, one robot and one node between them, for every test of a module, one after the other.

A test gets a mission of its own, planners of its own, and a robot that was told nothing yet. What
a test killed is started again before the next one; what cannot be repaired is an error there.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import msgspec
from std_srvs.srv import Trigger

from authguard_r.core.encoding import b64
from authguard_r.core.identifiers import MissionId
from authguard_r.core.mission import Mission
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole
from fixtures.estimator import attesting
from fixtures.gate_process import RunningGate, order, until
from ros.graph import PATIENCE_S, Graph, next_domain


class SharedGate:
    """A gate that every test of a module finds with a mission of the test's own.

    Args:
        gate: it.
        is_attested: the tests attest its state; False: somebody else does.
    """

    def __init__(self, gate: RunningGate, *, is_attested: bool = True) -> None:
        assert gate.live is not None
        self.gate = gate
        self._first: Mission = gate.live[0]
        self._count = 0
        self._is_attested = is_attested
        self._pid = gate.pid
        self._ending = ExitStack()

    def renew(self) -> None:
        """Have a gate that lives, a robot that is in the dock, and a mission that nothing used."""
        gate = self.gate
        if not gate.alive:
            gate.start_gate()
        if gate.pid != self._pid and self._is_attested:
            self._ending.close()
            gate.move = self._ending.enter_context(attesting(gate)).move
        self._pid = gate.pid
        if gate.move is not None:
            gate.move("dock")
        self._revoke()
        self._count += 1
        mission = msgspec.structs.replace(
            self._first,
            mid=MissionId(f"{self._first.mid}-{self._count}"),
            nonce=b64(os.urandom(16)),
        )
        gate.live = (mission, gate.activate(gate.token(mission))["digest"])

    def mark(self) -> None:
        """Wait until nothing runs; what is recorded from now on is news."""
        with self.gate.client(ClientRole.AUDITOR, "looks") as auditor:
            until(lambda: not auditor.status()["leases"], "the end of a lease", seconds=PATIENCE_S)
        self.gate.mark()

    def end(self) -> None:
        """End what was started here."""
        self._ending.close()

    def _revoke(self) -> None:
        """Revoke the mission, unless a test has done so; what runs is stopped with it."""
        with self.gate.client(ClientRole.AUDITOR, "looks") as auditor:
            is_active = auditor.status()["mission"] is not None
        if is_active:
            assert self.gate.live is not None
            with self.gate.client(ClientRole.OPERATOR, "revokes") as operator:
                operator.command(order(self.gate, *self.gate.live, Verb.REVOKE))


class SharedGraph:
    """A graph with a robot in it, whose node every test of a module finds serving.

    Args:
        gate: whose node it is.
        folder: for its files.
        start: starts the node.
        serves: asks the node for something; True once it answers.
    """

    def __init__(
        self,
        gate: SharedGate,
        folder: Path,
        start: Callable[[Graph], None],
        serves: Callable[[Graph], bool],
    ) -> None:
        self._gate, self._folder, self._start, self._serves = gate, folder, start, serves
        self._graph: Graph | None = None

    def renew(self) -> Graph:
        """Return the graph: its node serves, and nothing runs or was said."""
        try:
            return self._renewed()
        except BaseException:
            self.end()  # the next test begins with another one
            raise

    def end(self) -> None:
        """End the node and the robot."""
        if self._graph is not None:
            self._graph.end()
        self._graph = None

    def _renewed(self) -> Graph:
        graph = self._graph
        if graph is None:
            graph = self._graph = Graph(self._folder, self._gate.gate, next_domain())
        assert graph.robot.is_alive, "the test before has ended the robot"
        graph.rest()
        self._gate.renew()
        if not graph.is_alive:
            graph.end_node()
            self._start(graph)
        until(lambda: self._serves(graph), "a node that serves", seconds=PATIENCE_S)
        self._gate.mark()
        graph.forget()
        return graph


def honks(graph: Graph) -> bool:
    """Return whether a planner's call reaches the robot, and its answer the planner."""
    planner = graph.planner("first")
    said = planner.call(Trigger, "/llm/horn", Trigger.Request()).result(PATIENCE_S)
    graph.rest()
    return bool(said.success)
