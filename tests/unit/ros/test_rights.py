# SPDX-License-Identifier: Apache-2.0
"""Who may do what on DDS: of what moves the robot, the gate's process alone may write any.

Source: lesson L1; docs/spec/ros-map.md#rights
"""

from __future__ import annotations

from authguard_r.integrations.ros.rights import RightKind, actuating, rights_of
from fixtures.ros_keystores import example, map_of, plain_map

GOAL, CANCEL = (f"rq/navigate_to_pose/_action/{of}Request" for of in ("send_goal", "cancel_goal"))


def test_l1_nothing_that_moves_the_robot_is_written_by_another_than_the_map_says() -> None:
    """Every enclave, every topic: topics, services, goals, results, parameters, states."""
    rights, moving = rights_of(example()), actuating(example())
    gate = example().enclaves.gate
    assert moving["rt/cmd_vel"] == moving["rq/lightRequest"] == moving[GOAL] == {gate}
    assert moving[CANCEL] == {gate, example().enclaves.deadman}
    assert moving["rr/lightReply"] == {"/robot/base"}
    assert moving["rt/navigate_to_pose/_action/feedback"] == {"/robot/navigation"}
    assert moving["rq/controller_server/set_parametersRequest"] == set()
    assert moving["rq/base/change_stateRequest"] == set()
    for enclave, its in rights.items():
        for topic in its.publish & moving.keys():
            assert enclave in moving[topic], (enclave, topic)


def test_the_planner_writes_below_its_own_root_and_nowhere_else() -> None:
    planner = rights_of(example())[example().enclaves.planner]
    usual = {"ros_discovery_info", "rt/rosout"}
    assert all(topic[2:].startswith("/llm/") for topic in planner.publish - usual)
    assert all(topic[2:].startswith("/llm/") for topic in planner.subscribe - usual)
    assert "rt/llm/cmd_vel" in planner.publish
    assert "rt/llm/sign" in planner.subscribe


def test_the_dead_man_cancels_and_does_nothing_else() -> None:
    deadman = rights_of(example())[example().enclaves.deadman]
    usual = {"ros_discovery_info", "rt/parameter_events", "rt/rosout"}
    assert deadman.publish - usual == {CANCEL}


def test_who_reads_publishes_nothing() -> None:
    rights, ours = rights_of(example()), example().enclaves
    usual = {"ros_discovery_info", "rt/rosout"}
    assert rights[ours.estimator].publish == {*usual, "rt/parameter_events"}
    assert rights[ours.display].publish == {*usual, "rt/llm/parameter_events"}
    assert "rt/odom" in rights[ours.estimator].subscribe
    plain = plain_map()
    plain["position"].pop("odometry")
    assert "rt/tf" in rights_of(map_of(plain))[ours.estimator].subscribe
    plain.pop("position")
    plain.pop("proposals")
    assert "rt/llm/propose" not in rights_of(map_of(plain))[ours.planner].publish
    assert not {"rt/tf", "rt/odom"} & rights_of(map_of(plain))[ours.estimator].subscribe


def test_a_process_does_what_its_map_says_and_stands_behind_it() -> None:
    plain = plain_map()
    plain["processes"]["/robot/base"]["calls"] = ["/controller_server/change_state", "/lamp"]
    plain["processes"]["/robot/base"] |= {"serves": ["/lamp"], "acts": ["/dance"], "asks": ["/see"]}
    ros = map_of(plain)
    base, moving = rights_of(ros)["/robot/base"], actuating(ros)
    assert moving["rq/controller_server/change_stateRequest"] == {"/robot/base"}
    assert "rq/lampRequest" not in moving
    for topic in ("rq/lampRequest", "rr/lampReply", "rr/dance/_action/send_goalReply"):
        assert topic in base.of(RightKind.WRITE)
    for topic in ("rq/lampRequest", "rt/see/_action/status", "rq/base/get_parametersRequest"):
        assert topic in base.of(RightKind.READ)


def test_no_clock_is_anybodys() -> None:
    """Whoever may publish `/clock` could stop every timer that goes by it."""
    assert not any(
        "/clock" in topic for its in rights_of(example()).values() for topic in its.publish
    )


def test_nobody_untrusted_says_what_other_nodes_obey_of_their_parameters() -> None:
    """A node of C++ goes to the time of `/clock` when `/parameter_events` says that it does."""
    rights, ours = rights_of(example()), example().enclaves
    allowed = actuating(example())["rt/parameter_events"]
    assert not {ours.planner, ours.display} & allowed
    writers = {name for name, its in rights.items() if "rt/parameter_events" in its.publish}
    assert writers == allowed
