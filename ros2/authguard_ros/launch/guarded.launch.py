# SPDX-License-Identifier: Apache-2.0
"""The gate's node, the dead-man beside it, and a relay or an estimator where one is asked for.

ros2 launch authguard_ros guarded.launch.py map:=... gate:=... site:=... binding:=... trust:=...

The gate's process is not started here: it is no process of ROS, and has a user of its own. All that
is started here has the user and the variables of who launches; a robot has the units of
`deploy/systemd` instead. No `launch_ros` node: that would add words of ROS, which ours refuse; each
takes its enclave and its domain from the map.
"""

import time

from authguard_ros.lives import Lives
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

#: The gate's node is started again unless it ends so often within so many seconds.
ENDS, WITHIN_S = 4, 60.0
#: A process that ended is started again after so long, in seconds.
AGAIN_S = 1.0
#: At the end of all, the gate's node is killed after twice as long, in seconds; the dead-man ends
#: later, for it has to cancel what a killed node left.
NODE_S, DEADMAN_S = "3", "10"
REQUIRED = {
    "map": "the robot's map",
    "gate": "the run folder of the gate's process",
    "site": "the signed site",
    "binding": "the gate's own binding: a file, or a shipped name",
    "trust": "the trust folder",
}
#: Of them, what the estimator needs too.
ATTESTS = ("map", "gate", "site", "trust")
OPTIONAL = {
    "demo": ("false", "`true` on a bench where nothing can be hurt: no DDS security"),
    "stream": ("", "a stream of the map that is relayed to the base; nothing: no relay"),
    "base_topic": ("", "where the relay publishes; its enclave's map entry publishes it"),
    "estimator_key": ("", "the estimator's key, for the map's `position`; nothing: no estimator"),
    "estimator_cert": ("", "the certificate of that key"),
}


def generate_launch_description() -> LaunchDescription:
    """Return what is started."""
    needed = [DeclareLaunchArgument(name, description=text) for name, text in REQUIRED.items()]
    given = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in OPTIONAL.items()
    ]
    return LaunchDescription([*needed, *given, OpaqueFunction(function=_processes)])


def _processes(context: LaunchContext) -> list[ExecuteProcess]:
    """Return the processes: the dead-man first, so that no node is without one."""
    said = {name: LaunchConfiguration(name).perform(context) for name in (*REQUIRED, *OPTIONAL)}
    if said["demo"] not in {"true", "false"}:
        raise RuntimeError(f"demo: expected `true` or `false`, got `{said['demo']}`")
    if bool(said["stream"]) != bool(said["base_topic"]):
        raise RuntimeError("stream and base_topic: expected both or neither")
    if bool(said["estimator_key"]) != bool(said["estimator_cert"]):
        raise RuntimeError("estimator_key and estimator_cert: expected both or neither")
    demo = ["--demo"] if said["demo"] == "true" else []
    words = [word for name in REQUIRED for word in (f"--{name}", said[name])]
    attests = [word for name in ATTESTS for word in (f"--{name}", said[name])]
    attests += ["--key", said["estimator_key"], "--cert", said["estimator_cert"]]
    relay = [said["map"], said["stream"], said["base_topic"], *demo]
    return [
        _process("deadman", [said["map"], *demo], sigterm_timeout=DEADMAN_S),
        *([_process("actuator", relay)] if said["stream"] else []),
        *([_process("estimator", [*attests, *demo])] if said["estimator_key"] else []),
        _process("gate_node", [*words, *demo], on_exit=_unless_held_up()),
    ]


def _process(name: str, words: list[str], **more: object) -> ExecuteProcess:
    """Return a process that is started again whenever it ends."""
    times = {"sigterm_timeout": NODE_S, "sigkill_timeout": NODE_S, **more}
    command = [ExecutableInPackage(package="authguard_ros", executable=name), *words]
    return ExecuteProcess(
        cmd=command, name=name, output="both", respawn=True, respawn_delay=AGAIN_S, **times
    )


def _unless_held_up():
    """Return what ends everything once the gate's node cannot be held up."""
    lives = Lives(ENDS, WITHIN_S)

    def ended(_event, _context):
        if lives.end(time.monotonic()):
            return [Shutdown(reason=f"the gate's node ended {ENDS} times in {WITHIN_S:.0f} s")]
        return None

    return ended
