# SPDX-License-Identifier: Apache-2.0
"""The figures of the gate's process, each from one run, beside its target."""

from __future__ import annotations

from statistics import median
from typing import Any

from figures import Figure, net
from measure import Timing
from overload import Overloaded

#: Actions of a day at one a second.
DAY = 86_400


def gate_figures(
    timings: dict[str, Timing], loaded: Overloaded, soaked: dict[str, Any]
) -> list[Figure]:
    """Return every figure of the process, those with a target first.

    Args:
        timings: those of `gate.latency` and of `stop.stops`.
        loaded: of `overload.overload`.
        soaked: of `soak.soak`.
    """
    return [
        *_socket(timings),
        *_overload(timings, loaded),
        *_soak(soaked),
        *_shown(timings, loaded),
    ]


def _socket(timings: dict[str, Timing]) -> list[Figure]:
    return [
        net(
            timings,
            "socket_accept_net",
            "an acceptance over the socket, on disk - the same in process",
            ("socket.accept", "library.accept"),
            target=0.15,
        ),
        net(
            timings,
            "socket_refuse_net",
            "a refusal over the socket - the same in process",
            ("socket.refuse", "library.refuse"),
            target=0.15,
        ),
    ]


def _overload(timings: dict[str, Timing], loaded: Overloaded) -> list[Figure]:
    p99 = loaded.p99_ms
    pairs = zip(p99["benign.flooded"], p99["benign.alone"], strict=True)
    flooded = loaded.told["flooded"]
    times = loaded.told["overload"]
    lane = next(name for name in timings if name.startswith("stop, ") and "idle" not in name)
    return [
        Figure(
            "overload_accept_p99",
            f"p99 of accepted work under {times} x the gate's capacity - p99 without",
            median(with_flood - alone for with_flood, alone in pairs),
            "ms",
            ("benign.flooded", "benign.alone"),
            target=5.0,
        ),
        Figure(
            "overload_stop_p99",
            "p99 of a stop under the same flood, until the robot's process says that it stands",
            median(p99["stop.flooded"]),
            "ms",
            ("stop.flooded",),
            target=10.0,
        ),
        Figure(
            "overload_stop_flood_p99",
            "p99 of a stop while four others stop as fast as they are answered",
            timings[lane].p99 / 1e6,
            "ms",
            (lane,),
            target=10.0,
        ),
        Figure(
            "overload_benign_done",
            "no accepted work failed under the flood",
            not flooded["benign_failed"],
            "",
            (),
            target=True,
        ),
    ]


def _soak(soaked: dict[str, Any]) -> list[Figure]:
    count = soaked["actions"]
    return [
        Figure(
            "soak_memory",
            f"memory that the gate grows by in a day of an action a second, from {count} of them",
            soaked["rss_growth_bytes_an_action"] * DAY / 2**20,
            "MiB",
            (),
            target=50.0,
        ),
        Figure(
            "soak_log_error",
            f"the log of {count} actions, off what its first {soaked['foretold_from']} foretell",
            soaked["log_error_percent"],
            "%",
            (),
            target=5.0,
        ),
        Figure(
            "soak_whole",
            f"all {count} actions carried out and the log verified",
            soaked["whole"] and soaked["carried_out"] == count,
            "",
            (),
            target=True,
        ),
    ]


def _shown(timings: dict[str, Timing], loaded: Overloaded) -> list[Figure]:
    beside = (
        ("socket_echo", "a process that only answers, over a socket", "socket.echo", None),
        ("client_accept_net", "with the shipped client", "client.accept", "library.accept"),
        ("held_net", "holding the answer for a repeat", "library.accept_held", "library.accept"),
        ("socket_settle_net", "until the outcome is on disk", "socket.settle", "library.settle"),
    )
    shown = [
        net(timings, key, f"{what} - the same in process", (one, other))
        if other is not None
        else Figure(key, what, timings[one].p50 / 1e6, "ms", (one,))
        for key, what, one, other in beside
    ]
    alone, flooded = loaded.told["alone"], loaded.told["flooded"]
    rates = (
        ("overload_capacity", "refusals a second, four clients", loaded.told["capacity_per_s"]),
        ("overload_offered", "offered a second by the flood", flooded["flood_per_s"]["offered"]),
        ("overload_shed", "shed a second", flooded["flood_per_s"].get("shed", 0)),
        ("log_records_alone", "records a second without the flood", alone["log_per_s"]["records"]),
        ("log_records_flooded", "records a second under it", flooded["log_per_s"]["records"]),
        (
            "log_written_alone",
            "bytes to disk a second without",
            alone["log_per_s"]["written_bytes"],
        ),
        (
            "log_written_flooded",
            "bytes to disk a second under it",
            flooded["log_per_s"]["written_bytes"],
        ),
    )
    return shown + [Figure(key, what, float(value), "", ()) for key, what, value in rates]
