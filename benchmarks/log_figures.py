# SPDX-License-Identifier: Apache-2.0
"""The figures of the log, each from one run, beside its target."""

from __future__ import annotations

from statistics import median
from typing import Any

from figures import Figure, net
from measure import MOST_SPREAD, Timing, ratio, steady

#: Records after which a checkpoint is made, in the order of the page; a gate's own is 256.
TRIGGERS = (1, 16, 256, 1_024)


def log_figures(timings: dict[str, Timing], told: dict[str, Any]) -> list[Figure]:
    """Return every figure of the log, those with a target first.

    Args:
        timings: those of `log.log`.
        told: what else it measured.
    """
    return [*_grown(timings, told), *_verified(timings, told), *_shown(timings, told)]


def _grown(timings: dict[str, Timing], told: dict[str, Any]) -> list[Figure]:
    records, short = told["records"], told["short"]
    return [
        _ratio(
            timings,
            "log_append_growth",
            f"a record appended to a log of {records} / to one of {short}",
            ("log.append.long", "log.append.short"),
            target=1.2,
        ),
        Figure(
            "log_memory",
            f"memory that a process grows by while its log grows from {short} to {records} records "
            "and is verified",
            told["rss_growth_bytes"] / 2**20,
            "MiB",
            (),
            target=50.0,
        ),
    ]


def _verified(timings: dict[str, Timing], told: dict[str, Any]) -> list[Figure]:
    few, many = told["sizes"]
    parts = told["verify_ns_a_record"]
    rates = [
        _ratio(
            timings,
            f"log_verify_{name}",
            f"{size} records verified against a checkpoint by one process / hashed and parsed, by "
            "`msgspec`",
            (f"log.verify.{name}", f"log.bare.{name}"),
            target=2.0,
        )
        for name, size in (("short", few), ("long", many))
    ]
    return [
        *rates,
        _ratio(
            timings,
            "log_verify_together",
            f"{told['together']} records verified from the disk as `audit verify` does it, by "
            f"{told['jobs']} process{'es' if told['jobs'] > 1 else ''} / hashed and parsed by one",
            ("log.verify.together", "log.bare.disk"),
            target=2.0,
        ),
        _ratio(
            timings,
            "log_verify_linear",
            f"one of {many} records verified / one of {few}",
            ("log.verify.long", "log.verify.short"),
            target=1.2,
        ),
        Figure(
            "log_whole_linear",
            f"a record in the later half of {told['verified']}, verified from the disk / in the "
            "earlier half",
            told["later_over_earlier"],
            "x",
            (),
            target=1.2,
            steady=max(parts) <= MOST_SPREAD * min(parts),
        ),
        Figure(
            "log_whole",
            f"all {told['verified']} records verified, up to a checkpoint of the last",
            told["whole"] and told["verified"] >= told["records"],
            "",
            (),
            target=True,
        ),
    ]


def _shown(timings: dict[str, Timing], told: dict[str, Any]) -> list[Figure]:
    records = told["records"]
    shown = [
        _ratio(
            timings,
            "log_verify_over_json",
            f"{told['sizes'][1]} records verified / hashed and parsed, by `json.loads`",
            ("log.verify.long", "log.bare_json.long"),
        ),
        net(
            timings,
            "log_append_net",
            "T_L of a record alone: committed - a bare durable insert",
            ("log.append.short", "insert.bare.log"),
        ),
        net(
            timings,
            "log_append_long_net",
            f"the same in a log of {records}",
            ("log.append.long", "insert.bare.log"),
        ),
    ]
    shown += [
        net(
            timings,
            f"log_checkpoint_{count}_net",
            f"a checkpoint after {count} record{'s' if count > 1 else ''} - a bare durable insert",
            (f"log.checkpoint.{count}", "insert.bare.checkpoint"),
        )
        for count in TRIGGERS
    ]
    return [
        *shown,
        net(
            timings,
            "log_witness_net",
            "a witness on this machine, asked until its cosignature holds - a bare durable insert",
            ("log.witness", "insert.bare.witness"),
        ),
        _ratio(
            timings,
            "log_sealed_append",
            "a decision's record committed with all of its fields sealed / as it is",
            ("log.sealed", "log.plain"),
        ),
        _ratio(
            timings,
            "log_replay_over_verify",
            "a decision made again by the oracle / its records verified",
            ("log.replay", "log.replay.verify"),
        ),
        *_rates(timings, told),
    ]


def _rates(timings: dict[str, Timing], told: dict[str, Any]) -> list[Figure]:
    rates = (
        (
            "log_verify_rate",
            f"records a second verified from the disk, {told['verified']} of them",
            1e9 / median(told["verify_ns_a_record"]),
        ),
        ("log_replay_rate", "decisions a second replayed", 1e9 / timings["log.replay"].p50),
        (
            "log_file_bytes",
            f"bytes of the store's file for one of {told['verified']} records",
            told["file_bytes"] / told["verified"],
        ),
    )
    return [Figure(key, what, float(value), "", ()) for key, what, value in rates]


def _ratio(
    timings: dict[str, Timing],
    key: str,
    what: str,
    of: tuple[str, str],
    *,
    target: float | None = None,
) -> Figure:
    one, other = (timings[name] for name in of)
    return Figure(key, what, ratio(one, other), "x", of, target, steady=steady(one, other))
