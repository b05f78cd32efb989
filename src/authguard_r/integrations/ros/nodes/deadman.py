# SPDX-License-Identifier: Apache-2.0
"""Cancels what runs on a robot when the gate's node is gone: its only right, and its only work.

A server continues a goal when its sender is dead. So a process of its own hears the gate's
heartbeat, and where that is lost it asks every mediated action's server to cancel all goals, again
and again, until the heartbeat lives anew: a goal that was accepted in between is canceled too.
`python -m authguard_r.integrations.ros.nodes.deadman MAP`. Spec page:
docs/spec/ros-stopping.md#dead-man
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from action_msgs.srv import CancelGoal
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import UInt64

from authguard_r.client.link import ProcessLog
from authguard_r.integrations.ros.latch import MS, LatchCause
from authguard_r.integrations.ros.map import MediationKind, RosMap, read_map
from authguard_r.integrations.ros.nodes.heartbeat import (
    ALL,
    PERIOD_MS,
    PublisherEvent,
    listen,
    new_latch,
    steady,
)
from authguard_r.integrations.ros.nodes.process import run_node
from authguard_r.integrations.ros.rights import DEADMAN_NODE

#: A heartbeat that was never heard counts as lost after so long: nodes find one another slowly.
START_MS = 3_000
#: A server that has not answered is asked again after so long, in milliseconds, then after twice
#: as long each time up to `REST_MS`: what waits in a slow server cancels a new gate's goals too.
AGAIN_MS = 100
#: One that has nothing left to cancel is asked again after so long, while there is no heartbeat.
REST_MS = 500
#: An answer is not waited for any longer, in milliseconds.
FORGET_MS = 5_000


class Canceler:
    """Asks one action's server to cancel everything that it does.

    Args:
        node: its owner.
        action: the action's whole name.
        log: says once what came of it.
    """

    def __init__(self, node: Node, action: str, log: ProcessLog) -> None:
        self._action = action
        self._log = log
        self._client: Client[CancelGoal.Request, CancelGoal.Response] = node.create_client(
            CancelGoal, f"{action}/_action/cancel_goal"
        )
        self._asked: dict[Future[CancelGoal.Response], int] = {}
        self._lost_ns = 0
        self._due_ns = 0
        self._pause_ms = AGAIN_MS
        self._is_owed = self._is_found = False

    def lose(self, now_ns: int) -> None:
        """Take note that the heartbeat is lost: an answer is owed."""
        self._lost_ns, self._due_ns, self._is_owed = now_ns, 0, True
        self._pause_ms = AGAIN_MS

    def look(self, now_ns: int, *, is_lost: bool) -> None:
        """Ask, if it is time to.

        Args:
            now_ns: the monotonic clock.
            is_lost: there is no heartbeat; else only what is owed is asked for.
        """
        for asked in [a for a, ns in self._asked.items() if now_ns - ns >= FORGET_MS * MS]:
            self._client.remove_pending_request(asked)
            del self._asked[asked]
        if not self._is_there() and not is_lost:
            self._is_owed = False  # its goals went with it, and a node that is back asks it too
        # the graph is not trusted: an attacker who can hide a server there would have its goals go
        # on
        if (is_lost or self._is_owed) and now_ns >= self._due_ns:
            # an id and a time of zero mean every goal
            asked = self._client.call_async(CancelGoal.Request())
            self._asked[asked], self._due_ns = now_ns, now_ns + self._pause_ms * MS
            self._pause_ms = min(2 * self._pause_ms, REST_MS)
            asked.add_done_callback(self._answered)

    def _is_there(self) -> bool:
        """Return whether the server can be asked, and say it when that changes."""
        was_found, self._is_found = self._is_found, self._client.service_is_ready()
        if was_found is not self._is_found:
            self._due_ns, self._pause_ms = 0, AGAIN_MS
            self._log.say("found" if self._is_found else "gone", self._action)
        return self._is_found

    def _answered(self, asked: Future[CancelGoal.Response]) -> None:
        """Take an answer, however late; one to a question from before the loss settles nothing."""
        asked_ns = self._asked.pop(asked, None)
        answer = asked.result()
        if asked_ns is None or asked_ns < self._lost_ns or answer is None:
            return
        if answer.return_code == CancelGoal.Response.ERROR_REJECTED:
            self._log.say("not canceled", self._action)
            self._pause_ms = AGAIN_MS
        elif answer.goals_canceling:
            # rclpy passes over a goal behind one that it takes out of its answer
            self._log.say("canceled", self._action, goals=str(len(answer.goals_canceling)))
            self._pause_ms = AGAIN_MS
        else:
            self._is_owed = False
            self._due_ns = asked_ns + REST_MS * MS


class Deadman:
    """Hears the gate's heartbeat, and cancels every goal of the robot while there is none.

    Args:
        node: its owner, whose executor does nothing else.
        ros: the robot's map.
        told: what is asked of the middleware.
        log: says once what happened.

    Raises:
        EnvironmentFault: the name is remapped, or this DDS says nothing of its publishers.
    """

    def __init__(
        self, node: Node, ros: RosMap, *, told: PublisherEvent = ALL, log: ProcessLog | None = None
    ) -> None:
        self._node = node
        self._log = log or ProcessLog()
        self._latch = new_latch()
        self._start_ns = time.monotonic_ns()
        self._is_lost = False  # since the start: perhaps it is not found yet
        actions = sorted(m.private for m in ros.mediated.values() if m.kind is MediationKind.ACTION)
        self._cancelers = tuple(Canceler(node, action, self._log) for action in actions)
        listen(node, ros.heartbeat, UInt64, heard=self._heard, lost=self._stop, told=told)
        node.create_timer(PERIOD_MS / 1_000, self._look, None, steady())

    def close(self) -> None:
        """End it: what runs goes on; its node is destroyed with it."""

    def _heard(self, life: UInt64, who: bytes) -> None:
        was_open = self._latch.is_open
        # a gate that came back is another process: what ran before has no owner
        named = who + life.data.to_bytes(8, "big")
        why = self._latch.hear(named, time.monotonic_ns(), is_neutral=True)
        if was_open and why is not None:
            self._lose(why)
        elif why is None and not was_open:
            self._is_lost = False
            self._log.say("armed", "heartbeat")

    def _stop(self, why: LatchCause) -> None:
        if self._latch.stop(why):
            self._lose(why)

    def _look(self) -> None:
        now_ns = time.monotonic_ns()
        if self._latch.look(now_ns):
            self._lose(LatchCause.SILENCE)
            return
        is_late = now_ns - self._start_ns >= START_MS * MS
        if self._latch.why is LatchCause.START and is_late and not self._is_lost:
            self._lose(LatchCause.START)
            return
        self._ask(now_ns)

    def _lose(self, why: LatchCause) -> None:
        """Ask every server at once."""
        self._is_lost = True
        now_ns = time.monotonic_ns()
        for canceler in self._cancelers:
            canceler.lose(now_ns)
        self._ask(now_ns)
        self._log.say("lost", "heartbeat", why=why)

    def _ask(self, now_ns: int) -> None:
        for canceler in self._cancelers:
            canceler.look(now_ns, is_lost=self._is_lost)


def main(words: list[str] | None = None) -> int:
    """Watch until SIGTERM: `MAP`."""

    def ready(path: str) -> tuple[RosMap, str, Callable[[Node], Deadman]]:
        ros = read_map(Path(path))
        return ros, ros.enclaves.deadman, partial(_built, ros)

    given = sys.argv[1:] if words is None else words
    return run_node(DEADMAN_NODE.removeprefix("/"), given, ("MAP",), ready)


def _built(ros: RosMap, node: Node) -> Deadman:
    return Deadman(node, ros)


if __name__ == "__main__":
    sys.exit(main())
