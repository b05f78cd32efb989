# SPDX-License-Identifier: Apache-2.0
"""Which topic of DDS each process may write and read: worked out from the map alone.

ROS 2 names become topics of DDS: a topic one, a service two, an action eight.
Spec page: docs/spec/ros-map.md#rights
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum

from msgspec import Struct

from authguard_r.integrations.ros.map import PLANNERS, MediationKind, Process, RosMap, writers_of

#: The names of our own nodes.
GATE_NODE = "/authguard/gate"
DEADMAN_NODE = "/authguard_deadman"
ESTIMATOR_NODE = "/authguard_estimator"
#: Who is in the graph: every participant writes it, so nothing is ever decided by it.
DISCOVERY = "ros_discovery_info"
DIAGNOSTICS = "/diagnostics"
#: Every node says here what became of its parameters, and some obey what is said there of their
#: own: who must move nothing says it elsewhere, remapped to below `PLANNERS`.
EVENTS = "/parameter_events"
_PARAMETERS = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
    "get_type_description",
)
_LIFECYCLE = (
    "change_state",
    "get_state",
    "get_available_states",
    "get_available_transitions",
    "get_transition_graph",
)
#: Services of a node that change what it does.
_SETTING = ("set_parameters", "set_parameters_atomically", "change_state")
_ACTION_TOPICS = ("feedback", "status")
_ACTION_SERVICES = ("send_goal", "cancel_goal", "get_result")


class RightKind(StrEnum):
    """What a right is to."""

    WRITE = "publish"
    READ = "subscribe"


class Rights(Struct, frozen=True, kw_only=True):
    """What one process may do, as topics of DDS.

    Args:
        publish: written.
        subscribe: read.
    """

    publish: frozenset[str]
    subscribe: frozenset[str]

    def of(self, way: RightKind) -> frozenset[str]:
        """Return the topics of one way."""
        return self.publish if way is RightKind.WRITE else self.subscribe


#: A right of one process.
_Right = tuple[RightKind, str]


def rights_of(ros: RosMap) -> dict[str, Rights]:
    """Return what each enclave of a map may do."""
    ours = ros.enclaves
    found: dict[str, set[_Right]] = {
        ours.gate: {*_node(GATE_NODE), *_gate(ros)},
        ours.deadman: {*_node(DEADMAN_NODE, served=False), *_deadman(ros)},
        ours.planner: {*_node("", served=False, events=f"{PLANNERS}{EVENTS}"), *_planner(ros)},
        ours.estimator: {*_node(ESTIMATOR_NODE, served=False), *_estimator(ros)},
        ours.display: {
            *_node("", served=False, events=f"{PLANNERS}{EVENTS}"),
            *_displays(ros),
        },
    }
    for enclave, process in ros.processes.items():
        found[enclave] = {*_process(process), *_served(ros, enclave)}
    return {
        enclave: Rights(
            publish=frozenset(topic for way, topic in rights if way is RightKind.WRITE),
            subscribe=frozenset(topic for way, topic in rights if way is RightKind.READ),
        )
        for enclave, rights in found.items()
    }


def actuating(ros: RosMap) -> dict[str, frozenset[str]]:
    """Return every topic of DDS that moves the robot when it is written, with who may write it.

    What the robot obeys; the answers of the one that obeys, for a false server would say that it
    did what it was told; parameters and states of the robot's own nodes, which move it too; and
    what says that the gate lives, and what nodes obey that was said of their parameters.
    """
    found: dict[str, set[str]] = {}
    for item in ros.mediated.values():
        asks, serves = _sides(item.kind, item.private)
        _allow(found, asks, ros.enclaves.gate)
        _allow(found, serves, item.by)
        if item.kind is MediationKind.ACTION:
            _allow(found, _cancels(item.private), ros.enclaves.deadman)
    for enclave, process in ros.processes.items():
        for node in process.nodes:
            for service in _SETTING:
                asks, serves = _service(f"{node}/{service}")
                _allow(found, asks)
                _allow(found, serves, enclave)
    for enclave, process in ros.processes.items():
        for name in process.calls:  # the author of the map vouches for it
            _allow(found, _service(name)[0], enclave, new=False)
    _allow(found, _writes(ros.heartbeat, ros.decisions, ros.status), ros.enclaves.gate)
    trusted = {ros.enclaves.gate, ros.enclaves.deadman, ros.enclaves.estimator, *ros.processes}
    _allow(found, _writes(EVENTS), *trusted)
    return {topic: frozenset(enclaves) for topic, enclaves in found.items()}


def telling(ros: RosMap) -> dict[str, frozenset[str]]:
    """Return every topic of DDS that says how the robot stands, with who may write it."""
    found: dict[str, frozenset[str]] = {}
    position = ros.position
    for topic in () if position is None else position.topics:
        found[f"rt{topic}"] = writers_of(ros, (topic,))
    for shown in ros.shown.values():
        found[f"rt{shown.private}"] = writers_of(ros, (shown.private,))
    return found


def _allow(
    found: dict[str, set[str]], rights: Iterable[_Right], *enclaves: str, new: bool = True
) -> None:
    for way, topic in rights:
        if way is RightKind.WRITE and (new or topic in found):
            found.setdefault(topic, set()).update(enclaves)


def _gate(ros: RosMap) -> Iterator[_Right]:
    for item in ros.mediated.values():
        yield from _sides(item.kind, item.public)[1]
        yield from _sides(item.kind, item.private)[0]
    for shown in ros.shown.values():
        yield from _reads(shown.private)
        yield from _writes(shown.public)
    if ros.proposals is not None:
        yield from _reads(ros.proposals.ask)
        yield from _writes(ros.proposals.told)
    yield from _writes(ros.decisions, ros.status, ros.heartbeat, DIAGNOSTICS)
    yield from _writes(f"{GATE_NODE}/transition_event")
    for service in _LIFECYCLE:
        yield from _service(f"{GATE_NODE}/{service}")[1]


def _displays(ros: RosMap) -> Iterator[_Right]:
    yield from _reads(ros.decisions, ros.status, DIAGNOSTICS)


def _deadman(ros: RosMap) -> Iterator[_Right]:
    yield from _reads(ros.heartbeat)
    for item in ros.mediated.values():
        if item.kind is MediationKind.ACTION:
            yield from _cancels(item.private)


def _planner(ros: RosMap) -> Iterator[_Right]:
    for item in ros.mediated.values():
        yield from _sides(item.kind, item.public)[0]
    yield from _reads(*(shown.public for shown in ros.shown.values()))
    if ros.proposals is not None:
        yield from _writes(ros.proposals.ask)
        yield from _reads(ros.proposals.told)


def _estimator(ros: RosMap) -> Iterator[_Right]:
    if ros.position is not None:
        yield from _reads(*ros.position.topics)


def _process(process: Process) -> Iterator[_Right]:
    for node in process.nodes:
        yield from _node(node)
    yield from _writes(*process.publishes)
    yield from _reads(*process.subscribes)
    for names, of, side in (
        (process.serves, _service, 1),
        (process.calls, _service, 0),
        (process.acts, _action, 1),
        (process.asks, _action, 0),
    ):
        for name in names:
            yield from of(name)[side]


def _served(ros: RosMap, enclave: str) -> Iterator[_Right]:
    """Yield what a process of the robot does for the gate's node."""
    for item in ros.mediated.values():
        if item.by == enclave:
            yield from _sides(item.kind, item.private)[1]
    for shown in ros.shown.values():
        if shown.by == enclave:
            yield from _writes(shown.private)


def _node(name: str, *, served: bool = True, events: str = EVENTS) -> Iterator[_Right]:
    """Yield what every node does; one that serves no parameters has fewer rights."""
    yield from ((way, DISCOVERY) for way in RightKind)
    yield from _writes(events, "/rosout")
    if served:
        yield from _reads(EVENTS)
        for service in _PARAMETERS:
            yield from _service(f"{name}/{service}")[1]


def _sides(kind: MediationKind, name: str) -> tuple[list[_Right], list[_Right]]:
    """Return the rights of who asks, and of who is asked."""
    if kind is MediationKind.ACTION:
        return _action(name)
    if kind is MediationKind.SERVICE:
        return _service(name)
    return list(_writes(name)), list(_reads(name))


def _service(name: str) -> tuple[list[_Right], list[_Right]]:
    request, reply = f"rq{name}Request", f"rr{name}Reply"
    asks = [(RightKind.WRITE, request), (RightKind.READ, reply)]
    return asks, [(RightKind.READ, request), (RightKind.WRITE, reply)]


def _action(name: str) -> tuple[list[_Right], list[_Right]]:
    asks, serves = [], []
    for service in _ACTION_SERVICES:
        asked, served = _service(f"{name}/_action/{service}")
        asks += asked
        serves += served
    topics = [f"{name}/_action/{topic}" for topic in _ACTION_TOPICS]
    return [*asks, *_reads(*topics)], [*serves, *_writes(*topics)]


def _cancels(name: str) -> Iterable[_Right]:
    return _service(f"{name}/_action/cancel_goal")[0]


def _writes(*names: str) -> Iterator[_Right]:
    return ((RightKind.WRITE, f"rt{name}") for name in names)


def _reads(*names: str) -> Iterator[_Right]:
    return ((RightKind.READ, f"rt{name}") for name in names)
