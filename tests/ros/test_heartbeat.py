# SPDX-License-Identifier: Apache-2.0
"""A heartbeat is silent when its owner does not live, and its names mean themselves.

Source: docs/spec/ros-stopping.md#heartbeats; lesson L2
"""

from __future__ import annotations

import asyncio
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="an environment with ROS runs these (.ci/run makes one)")

import rclpy
from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import UInt64

from authguard_r.core.errors import EnvironmentFault
from authguard_r.ros.nodes.actuator import Actuator
from authguard_r.ros.nodes.heartbeat import (
    DEADLINE_MS,
    TURN_MS,
    Heartbeat,
    LoopWatch,
    gate_heartbeat,
    listen,
)
from ros_stopping import PATIENCE_S, clean_shared

# what rclpy imports to read its types imports a module that Python has renamed
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

TOPIC = "/authguard/heartbeat"
_DOMAINS = itertools.count(1 + os.getpid() % 90)


@pytest.fixture
def context() -> Iterator[Context]:
    made = Context()
    rclpy.init(context=made, domain_id=next(_DOMAINS) % 100 + 1)
    yield made
    made.try_shutdown()
    clean_shared()


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    made = bare_node(context)
    yield made
    made.destroy_node()


def bare_node(context: Context, *words: str) -> Node:
    return Node(
        "gate",
        context=context,
        cli_args=["--ros-args", *words] if words else None,
        enable_rosout=False,
        start_parameter_services=False,
    )


@pytest.fixture
def spin(context: Context, node: Node) -> Iterator[Callable[[Callable[[], bool]], None]]:
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def until(holds: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not holds():
            assert time.monotonic() < end
            executor.spin_once(timeout_sec=0.01)

    yield until
    executor.shutdown()


def unused() -> None:
    raise AssertionError("nothing lapsed")


def test_who_does_not_live_says_nothing_and_drops_its_leases_before_the_next_word(
    node: Node, spin: Callable[[Callable[[], bool]], None]
) -> None:
    lives = True
    said: list[int | str] = []
    gate_heartbeat(node, TOPIC, still_alive=lambda: lives, lapsed=lambda: said.append("lapsed"))
    listen(node, TOPIC, UInt64, heard=lambda life, _: said.append(life.data), lost=lambda _: None)
    spin(lambda: len(said) >= 3)
    (first,) = set(said)
    lives = False
    silent = time.monotonic() + 2 * DEADLINE_MS / 1_000
    spin(lambda: time.monotonic() > silent)
    said.clear()
    silent = time.monotonic() + 2 * DEADLINE_MS / 1_000
    spin(lambda: time.monotonic() > silent)
    assert said == []
    lives = True
    spin(lambda: len(said) >= 3)
    assert said[0] == "lapsed"
    assert first not in said  # another life: what ran before is nobody's


def test_a_closed_heartbeat_is_gone(node: Node, spin: Callable[[Callable[[], bool]], None]) -> None:
    heard: list[Twist] = []
    lost: list[str] = []
    beats = Heartbeat(node, TOPIC, Twist, Twist, still_alive=lambda: True, lapsed=unused)
    listen(node, TOPIC, Twist, heard=lambda said, _: heard.append(said), lost=lost.append)
    spin(lambda: bool(heard))
    beats.close()
    spin(lambda: "publisher_gone" in lost)


def test_a_loop_that_is_stuck_or_closed_does_not_turn() -> None:
    loop = asyncio.new_event_loop()
    watch = LoopWatch(loop)
    assert not watch()  # it does not run yet
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    wait_for(watch)
    stuck = threading.Event()
    loop.call_soon_threadsafe(stuck.wait)
    begun = time.monotonic()
    wait_for(lambda: not watch())
    assert time.monotonic() - begun < 1.0
    stuck.set()
    wait_for(watch)
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()
    wait_for(lambda: not watch())
    assert not watch()
    assert TURN_MS < DEADLINE_MS


def test_a_loop_that_was_closed_before_it_was_asked_does_not_turn() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    watch = LoopWatch(loop)
    assert not watch()
    assert not watch()


@pytest.mark.parametrize("name", ["authguard/heartbeat", "~/heartbeat", TOPIC])
def test_l2_a_name_that_means_another_is_refused(context: Context, name: str) -> None:
    """A relative name, a private one, and one that somebody remaps."""
    node = bare_node(context, "-r", f"{TOPIC}:=/elsewhere", "-r", "__ns:=/robot2")
    with pytest.raises(EnvironmentFault, match="expected"):
        gate_heartbeat(node, name, still_alive=lambda: True, lapsed=unused)
    with pytest.raises(EnvironmentFault, match="expected"):
        Actuator(node, name, lambda _: None)
    node.destroy_node()


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.001)
