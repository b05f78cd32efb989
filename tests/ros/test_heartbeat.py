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

pytest.importorskip("rclpy", reason="an environment with ROS runs these (tests/ros/make.sh)")

import rclpy
import yaml
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import UInt64

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import EnvironmentFault
from authguard_r.integrations.ros.latch import MS
from authguard_r.integrations.ros.map import parse_map
from authguard_r.integrations.ros.nodes.actuator import Actuator
from authguard_r.integrations.ros.nodes.deadman import FORGET_MS, REST_MS, Canceler, Deadman
from authguard_r.integrations.ros.nodes.heartbeat import (
    DEADLINE_MS,
    TURN_MS,
    Heartbeat,
    PublisherEvent,
    gate_heartbeat,
    listen,
)
from fixtures.ros_processes import PATIENCE_S, map_of
from programs.loop_watch import LoopWatch

# what rclpy imports to read its types imports a module that Python has renamed
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

TOPIC = "/authguard/heartbeat"
MAP = parse_map(yaml.safe_dump(map_of(1)), where="map")
_DOMAINS = itertools.count(1 + os.getpid() % 90)


@pytest.fixture
def context() -> Iterator[Context]:
    made = Context()
    rclpy.init(context=made, domain_id=next(_DOMAINS) % 100 + 1)
    yield made
    made.try_shutdown()


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


@pytest.mark.smoke
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


@pytest.mark.smoke
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


@pytest.mark.smoke
def test_another_number_is_another_life_though_nobody_was_silent(
    node: Node, spin: Callable[[Callable[[], bool]], None], capfd: pytest.CaptureFixture[str]
) -> None:
    life = UInt64(data=1)
    Heartbeat(node, TOPIC, UInt64, lambda: life, still_alive=lambda: True, lapsed=unused)
    Deadman(node, MAP, told=PublisherEvent(events=False))
    said: list[str] = []

    def says(words: str) -> bool:
        said.append(capfd.readouterr().err)
        return words in "".join(said)

    spin(lambda: says('"armed"'))
    life.data = 2
    spin(lambda: says('"why": "another_publisher"'))


def test_what_a_server_never_answers_is_forgotten(
    node: Node, spin: Callable[[Callable[[], bool]], None]
) -> None:
    asked = Canceler(node, "/stuck", ProcessLog())
    stuck = node.create_client(CancelGoal, "/stuck/_action/cancel_goal")
    other = bare_node(node.context)  # nobody spins it
    other.create_service(CancelGoal, "/stuck/_action/cancel_goal", lambda _, answer: answer)
    spin(stuck.service_is_ready)
    asked.lose(0)
    for now_ms in range(0, 60_000, 20):
        asked.look(now_ms * MS, is_lost=True)
        assert len(asked._asked) <= 2 + FORGET_MS // REST_MS
    assert asked._asked
    other.destroy_node()


def test_a_server_that_the_graph_hides_is_asked_all_the_same(
    node: Node, spin: Callable[[Callable[[], bool]], None]
) -> None:
    heard: list[CancelGoal.Request] = []

    def answer(request: CancelGoal.Request, empty: CancelGoal.Response) -> CancelGoal.Response:
        heard.append(request)
        return empty

    asked = Canceler(node, "/count", ProcessLog())
    node.create_service(CancelGoal, "/count/_action/cancel_goal", answer)
    spin(asked._client.service_is_ready)
    asked._client.service_is_ready = lambda: False  # type: ignore[method-assign]
    asked.lose(0)
    asked.look(1, is_lost=True)
    spin(lambda: bool(heard))
    assert bytes(heard[0].goal_info.goal_id.uuid) == bytes(16)


def test_an_answer_to_a_question_from_before_the_loss_settles_nothing(
    node: Node, spin: Callable[[Callable[[], bool]], None]
) -> None:
    heard: list[CancelGoal.Request] = []

    def answer(request: CancelGoal.Request, empty: CancelGoal.Response) -> CancelGoal.Response:
        heard.append(request)
        return empty

    asked = Canceler(node, "/count", ProcessLog())
    node.create_service(CancelGoal, "/count/_action/cancel_goal", answer)
    spin(asked._is_there)
    asked.lose(0)
    asked.look(1, is_lost=True)
    asked.lose(2)  # a gate that died anew before it was answered
    spin(lambda: not asked._asked)
    assert len(heard) == 1
    asked.look(3, is_lost=False)
    spin(lambda: not asked._asked)
    assert len(heard) == 2
    asked.look(10**12, is_lost=False)  # that one settled it
    assert not asked._asked
    assert {bytes(request.goal_info.goal_id.uuid) for request in heard} == {bytes(16)}


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
