# SPDX-License-Identifier: Apache-2.0
"""The figures that the benchmarks promise are there, from made-up timings; nothing is measured."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import pytest

import worlds

_FOLDER = str(worlds.ROOT / "benchmarks")
_TARGETS = {
    "socket_accept_net": 0.15,
    "socket_refuse_net": 0.15,
    "overload_accept_p99": 5.0,
    "overload_stop_p99": 10.0,
    "overload_stop_flood_p99": 10.0,
    "overload_benign_done": True,
    "soak_memory": 50.0,
    "soak_log_error": 5.0,
    "soak_whole": True,
}


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Import the benchmarks' own modules, which are scripts beside the package."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(_FOLDER)
    import gate_figures

    yield gate_figures
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        if file is not None and file.startswith(_FOLDER):
            del sys.modules[name]


def _timings(bench: Any, **medians_us: float) -> dict[str, Any]:
    from measure import timing_of

    names = ("socket.accept", "library.accept", "socket.settle", "library.settle")
    names += ("socket.refuse", "library.refuse", "client.accept", "library.accept_held")
    names += ("socket.echo", "stop, idle", "stop, 4 floods")
    return {
        name: timing_of([[int(medians_us.get(name.replace(".", "_"), 100) * 1_000)] * 3] * 5)
        for name in names
    }


def _loaded(bench: Any, *, flooded_ms: float = 4.0, failed: dict[str, int] | None = None) -> Any:
    from overload import Overloaded

    log = {"records": 40, "written_bytes": 4_096}
    flood = {"offered": 30_000, "shed": 29_000}
    return Overloaded(
        timings={},
        p99_ms={
            "benign.alone": [1.0, 2.0],
            "benign.flooded": [flooded_ms, flooded_ms],
            "stop.flooded": [3.0, 3.0],
        },
        told={
            "capacity_per_s": 3_000,
            "overload": 10,
            "alone": {"log_per_s": log},
            "flooded": {"log_per_s": log, "flood_per_s": flood, "benign_failed": failed or {}},
        },
    )


def _soaked(**changes: Any) -> dict[str, Any]:
    plain = {
        "actions": 86_400,
        "rss_growth_bytes_an_action": 10.0,
        "foretold_from": 1_000,
        "log_error_percent": 0.2,
        "whole": True,
        "carried_out": 86_400,
    }
    return {**plain, **changes}


def _figures(bench: Any, **parts: Any) -> dict[str, Any]:
    made = bench.gate_figures(
        parts.get("timings") or _timings(bench),
        parts.get("loaded") or _loaded(bench),
        parts.get("soaked") or _soaked(),
    )
    return {figure.id: figure for figure in made}


def test_every_target_of_the_process_is_a_figure(bench: Any) -> None:
    figures = _figures(bench)
    assert {key: one.target for key, one in figures.items() if one.target is not None} == _TARGETS
    assert all(figures[key].meets for key in _TARGETS)


@pytest.mark.parametrize(
    ("key", "parts"),
    [
        ("socket_accept_net", {"timings": {"socket_accept": 251}}),
        ("socket_refuse_net", {"timings": {"socket_refuse": 251}}),
        ("overload_accept_p99", {"loaded": {"flooded_ms": 7.0}}),
        ("overload_benign_done", {"loaded": {"failed": {"STOPPED": 1}}}),
        ("soak_memory", {"soaked": {"rss_growth_bytes_an_action": 700.0}}),
        ("soak_log_error", {"soaked": {"log_error_percent": 5.1}}),
        ("soak_whole", {"soaked": {"whole": False}}),
        ("soak_whole", {"soaked": {"carried_out": 86_399}}),
    ],
)
def test_what_falls_short_is_told_apart(bench: Any, key: str, parts: dict[str, Any]) -> None:
    makers = {
        "timings": lambda **changes: _timings(bench, **changes),
        "loaded": lambda **changes: _loaded(bench, **changes),
        "soaked": _soaked,
    }
    figures = _figures(bench, **{name: makers[name](**changes) for name, changes in parts.items()})
    assert [name for name in _TARGETS if not figures[name].meets] == [key]


def test_every_figure_is_a_row_of_the_page(bench: Any) -> None:
    import table

    figures = _figures(bench).values()
    page = table.targets({"figures": [one.plain() for one in figures]})
    assert all(one.what in page for one in figures if one.target is not None)
