# SPDX-License-Identifier: Apache-2.0
"""One file says what a planner sees of a robot's ROS graph, and which process may do what.

The node, the keystore and its check read the same file: what the gate offers and what DDS lets
through cannot differ. It holds no authority: what a goal means, the binding says, and whether it is
granted, the mission. Spec page: docs/spec/ros-map.md#map
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path

from msgspec import Struct, field

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.integrations.ros.names import TypePart, is_below, is_enclave, is_name, part_of
from authguard_r.site.strict import convert, read_text, read_yaml

SCHEMA = "authguard-r/ros-map/1"
#: Everything that a planner may publish, call or read is below this.
PLANNERS = "/llm"
#: Where transforms are said.
TRANSFORMS = ("/tf", "/tf_static")
#: Domains whose ports every platform leaves free.
MAX_DOMAIN = 101


class MediationKind(StrEnum):
    """How something is mediated."""

    ACTION = "action"
    SERVICE = "service"
    #: one message, one decision
    MESSAGE = "message"
    #: velocities: one decision is a lease, and each message a sample of it
    STREAM = "stream"


#: What each is a type of.
PARTS = {
    MediationKind.ACTION: TypePart.ACTION,
    MediationKind.SERVICE: TypePart.SERVICE,
    MediationKind.MESSAGE: TypePart.MESSAGE,
    MediationKind.STREAM: TypePart.MESSAGE,
}


class Mediated(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something that moves the robot, or changes what it does.

    Args:
        kind: how a planner asks for it.
        type: of the messages, as `package/part/Name`.
        public: the name under which the gate's node offers it.
        private: the name that moves the robot; the planner's process has no right to it.
        by: the enclave of the process that serves or hears it.
    """

    kind: MediationKind
    type: str
    public: str
    private: str
    by: str


class ShownTopic(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A topic of the robot's that the planner may read, relayed.

    Args:
        type: of the messages.
        private: where the robot publishes it.
        public: where the planner reads it.
        channel: the input channel that its words come by; absent: the least trusted of all.
        by: the enclave of the process that publishes it.
    """

    type: str
    private: str
    public: str
    by: str
    channel: str = ""


class TextTopics(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Topics of text for planners that speak no action of ROS.

    Args:
        ask: plans come here, as `std_msgs/msg/String`.
        told: the result of each.
    """

    ask: str = f"{PLANNERS}/propose"
    told: str = f"{PLANNERS}/told"


class Enclaves(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The security enclave of each of our processes; each is a Unix user's own.

    Args:
        gate: the node that stands between.
        deadman: cancels what runs when that node is gone, and may do nothing else.
        planner: the client that asks.
        estimator: reads where the robot is, and publishes nothing.
        display: reads what was decided, and publishes nothing.
    """

    gate: str
    deadman: str
    planner: str
    estimator: str
    display: str


class Process(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A process of the robot's own: what it does beside what the gate's node asks of it.

    Args:
        nodes: its nodes' whole names.
        publishes: topics.
        subscribes: topics.
        serves: services.
        calls: services.
        acts: actions that it serves.
        asks: actions that it sends goals of.
    """

    nodes: tuple[str, ...]
    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    acts: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


class Position(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the estimator reads the robot's place: odometry, or a transform.

    Args:
        map: the site's map that the coordinates are of.
        floor: its floor.
        margin_mm: radius that holds the true position.
        odometry: a topic of `nav_msgs/msg/Odometry`; absent: the transform.
        frame: the frame that the coordinates have to be in.
        child: the robot's own frame.
        shared: the enclaves of all processes that write transforms, where they are more than one:
            each of them could say that the robot is somewhere else.
    """

    map: str
    floor: int
    margin_mm: int
    odometry: str = ""
    frame: str = "map"
    child: str = "base_link"
    shared: tuple[str, ...] = ()

    @property
    def topics(self) -> tuple[str, ...]:
        """Where the place is said."""
        return (self.odometry,) if self.odometry else TRANSFORMS


class RosMap(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot's map.

    Args:
        schema: `SCHEMA`.
        robot: whose gate it is.
        domain: the ROS domain that all of it is in.
        enclaves: ours.
        mediated: by a name for the log.
        processes: the robot's own, by enclave.
        shown: by a name for the log.
        proposals: topics of text; absent: none.
        position: where the place comes from; absent: another estimator attests it.
        decisions: where displays read what was decided.
        status: where displays read how gate and node stand.
        heartbeat: says all the time that the gate's node lives.
    """

    schema: str
    robot: RobotId
    domain: int
    enclaves: Enclaves
    mediated: dict[str, Mediated]
    processes: dict[str, Process]
    shown: dict[str, ShownTopic] = field(default_factory=dict)
    proposals: TextTopics | None = None
    position: Position | None = None
    decisions: str = "/authguard/decisions"
    status: str = "/authguard/status"
    heartbeat: str = "/authguard/heartbeat"


def read_map(path: Path) -> RosMap:
    """Return the map in a file.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: no map, or one with a fault; the first is named with its place.
    """
    return parse_map(read_text(path), where=str(path))


def parse_map(text: str, *, where: str) -> RosMap:
    """Return the map in a YAML text.

    Raises:
        MalformedError: as `read_map`.
    """
    data = read_yaml(text, where=where)
    found: RosMap = convert(data, RosMap, where=where)
    for place, message in faults(found):
        raise MalformedError(message, where=f"{where}:{place}")
    return found


def faults(ros: RosMap) -> Iterator[tuple[str, str]]:
    """Yield every fault of a map as its place and what was expected there."""
    if ros.schema != SCHEMA:
        yield "schema", f"expected `{SCHEMA}`"
    if not 0 <= ros.domain <= MAX_DOMAIN:
        yield "domain", f"expected 0 to {MAX_DOMAIN}"
    if not ros.mediated:
        yield "mediated", "expected something that is mediated"
    yield from _names(ros)
    yield from _enclaves(ros)
    yield from _types(ros)
    yield from _unmapped(ros)
    yield from _liars(ros)


def _names(ros: RosMap) -> Iterator[tuple[str, str]]:
    """Yield names that are not valid, on the wrong side, or there twice."""
    seen: dict[str, str] = {}
    for place, name, is_public in _own_names(ros):
        if not is_name(name):
            yield place, f"expected an absolute name of ROS, got `{name}`"
        elif is_below(name, PLANNERS) != is_public:
            where = f"below `{PLANNERS}`" if is_public else f"not below `{PLANNERS}`"
            yield place, f"expected a name {where}, got `{name}`"
        elif name in seen:
            yield place, f"expected a name of its own, got that of `{seen[name]}`"
        seen[name] = place
    for enclave, process in ros.processes.items():
        for word, names in _lists(process):
            for name in names:
                if not is_name(name):
                    yield f"processes.{enclave}.{word}", f"expected a name of ROS, got `{name}`"
    position = ros.position
    if position is not None and position.odometry and not is_name(position.odometry):
        yield "position.odometry", "expected an absolute name of ROS"


def _own_names(ros: RosMap) -> Iterator[tuple[str, str, bool]]:
    for key, item in ros.mediated.items():
        yield f"mediated.{key}.public", item.public, True
        yield f"mediated.{key}.private", item.private, False
    for key, shown in ros.shown.items():
        yield f"shown.{key}.public", shown.public, True
        yield f"shown.{key}.private", shown.private, False
    if ros.proposals is not None:
        yield "proposals.ask", ros.proposals.ask, True
        yield "proposals.told", ros.proposals.told, True
    yield "decisions", ros.decisions, False
    yield "status", ros.status, False
    yield "heartbeat", ros.heartbeat, False


def _lists(process: Process) -> Iterator[tuple[str, tuple[str, ...]]]:
    for word in ("nodes", "publishes", "subscribes", "serves", "calls", "acts", "asks"):
        yield word, getattr(process, word)


def _enclaves(ros: RosMap) -> Iterator[tuple[str, str]]:
    """Yield enclaves that are not valid, that two processes share, or that no process has."""
    seen: dict[str, str] = {}
    ours = {word: getattr(ros.enclaves, word) for word in ros.enclaves.__struct_fields__}
    for place, name in (
        *((f"enclaves.{word}", name) for word, name in ours.items()),
        *((f"processes.{name}", name) for name in ros.processes),
    ):
        if not is_enclave(name):
            yield place, f"expected an enclave such as `/robot/base`, got `{name}`"
        elif name in seen:
            yield place, f"expected an enclave of its own, got that of `{seen[name]}`"
        seen[name] = place
    for place, by in (
        *((f"mediated.{key}.by", item.by) for key, item in ros.mediated.items()),
        *((f"shown.{key}.by", item.by) for key, item in ros.shown.items()),
    ):
        if by not in ros.processes:
            yield place, f"expected one of `processes`, got `{by}`"


def _types(ros: RosMap) -> Iterator[tuple[str, str]]:
    for group, key in (
        *(("mediated", key) for key in ros.mediated),
        *(("shown", key) for key in ros.shown),
    ):
        if not is_identifier(key):
            yield f"{group}.{key}", "expected an id of a-z, 0-9 and `_.:-`"
    for key, item in ros.mediated.items():
        wanted = PARTS[item.kind]
        if part_of(item.type) is not wanted:
            yield f"mediated.{key}.type", f"expected `package/{wanted}/Name`, got `{item.type}`"
    for key, shown in ros.shown.items():
        if part_of(shown.type) is not TypePart.MESSAGE:
            yield f"shown.{key}.type", f"expected `package/msg/Name`, got `{shown.type}`"


def _unmapped(ros: RosMap) -> Iterator[tuple[str, str]]:
    """Yield what a process of the robot would do past the gate's node."""
    moves = {item.private: key for key, item in ros.mediated.items()}
    for enclave, process in ros.processes.items():
        for word in ("publishes", "calls", "asks", "serves", "acts"):
            for name in getattr(process, word):
                if name in moves:
                    said = f"`{name}` moves the robot: `mediated.{moves[name]}` says who may"
                    yield f"processes.{enclave}.{word}", said
                elif is_below(name, PLANNERS):
                    yield f"processes.{enclave}.{word}", f"`{name}` is the planner's"


def _liars(ros: RosMap) -> Iterator[tuple[str, str]]:
    """Yield processes that could assert about the robot, or about us, what they do not know."""
    told = {ros.decisions: ros.enclaves.gate, ros.status: ros.enclaves.gate}
    told |= {ros.heartbeat: ros.enclaves.gate}
    told |= {shown.private: shown.by for shown in ros.shown.values()}
    for enclave, process in ros.processes.items():
        for name in process.publishes:
            if told.get(name, enclave) != enclave:
                said = f"`{name}` is said by `{told[name]}` alone"
                yield f"processes.{enclave}.publishes", said
    if ros.position is not None:
        yield from _place(ros, ros.position)


def _place(ros: RosMap, position: Position) -> Iterator[tuple[str, str]]:
    """Yield a place that no localization publishes, or that more publish than are named."""
    writers = sorted(writers_of(ros, position.topics))
    topics = " or ".join(f"`{topic}`" for topic in position.topics)
    if position.odometry and position.shared:
        yield "position.shared", "expected it with transforms alone"
    elif sorted(position.shared) != (writers if len(writers) > 1 and position.shared else []):
        yield "position.shared", f"expected all who write {topics}: {', '.join(writers)}"
    elif len(writers) != 1 and not position.shared:
        who = ", ".join(writers) or "none"
        mend = "" if position.odometry else ", or all of them in `position.shared`"
        text = f"expected one process that writes {topics}{mend}, got {who}"
        yield "position.odometry" if position.odometry else "position", text


def writers_of(ros: RosMap, topics: tuple[str, ...]) -> frozenset[str]:
    """Return the enclaves of the processes that write one of some topics."""
    wrote = {enclave for enclave, it in ros.processes.items() if {*it.publishes} & {*topics}}
    return frozenset(wrote | {it.by for it in ros.shown.values() if it.private in topics})
