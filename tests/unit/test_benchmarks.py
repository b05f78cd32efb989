# SPDX-License-Identifier: Apache-2.0
"""The benchmarks give each figure that they promise, and each cost of the log can be measured."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fixtures import scenarios

pytestmark = pytest.mark.smoke

_FOLDER = str(scenarios.ROOT / "benchmarks")
_LENGTHS = ("short", "long")
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
_LOG_TARGETS = {
    "log_append_growth": 1.2,
    "log_memory": 50.0,
    "log_verify_short": 2.0,
    "log_verify_long": 2.0,
    "log_verify_together": 2.0,
    "log_verify_linear": 1.2,
    "log_whole_linear": 1.2,
    "log_whole": True,
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


def _log_timings(bench: Any, **medians_us: float) -> dict[str, Any]:
    from log_figures import TRIGGERS
    from measure import timing_of

    names = [f"log.{what}.{name}" for what in ("append", "verify", "bare") for name in _LENGTHS]
    names += [f"log.checkpoint.{count}" for count in TRIGGERS]
    names += [f"insert.bare.{name}" for name in ("log", "checkpoint", "witness")]
    names += ["log.verify.together", "log.bare.disk", "log.bare_json.long"]
    names += ["log.witness", "log.replay", "log.replay.verify", "log.sealed", "log.plain"]
    return {
        name: timing_of([[int(medians_us.get(name.replace(".", "_"), 100) * 1_000)] * 3] * 5)
        for name in names
    }


def _logged(**changes: Any) -> dict[str, Any]:
    plain = {
        "records": 200_000,
        "short": 10_000,
        "sizes": [5_000, 50_000],
        "rss_growth_bytes": 2**20,
        "whole": True,
        "verified": 204_600,
        "verify_ns_a_record": [20_000.0] * 10,
        "later_over_earlier": 1.0,
        "file_bytes": 400_000_000,
        "together": 200_000,
        "jobs": 2,
    }
    return {**plain, **changes}


def _log_figures(
    bench: Any, *, timings: dict[str, float] | None = None, told: dict[str, Any] | None = None
) -> dict[str, Any]:
    from log_figures import log_figures

    made = log_figures(_log_timings(bench, **timings or {}), _logged(**told or {}))
    return {figure.id: figure for figure in made}


#: One of the four is in the default run: they share what a change of the log breaks.
_RARELY = [
    pytest.param(cost, marks=pytest.mark.complete) for cost in ("checkpoints", "witness", "sealed")
]


@pytest.mark.parametrize("cost", ["replay", *_RARELY])
def test_each_cost_of_the_log_can_be_measured(bench: Any, tmp_path: Path, cost: str) -> None:
    """A log or a witness that the code no longer takes shows here, not only in a complete run."""
    import log_cost
    from measure import Effort

    effort, more = Effort(blocks=5, calls=1), (3,) if cost == "replay" else ()
    found = getattr(log_cost, cost)(tmp_path, effort, *more)
    timings = found[0] if cost == "sealed" else found
    assert timings
    assert all(timing.p50 > 0 for timing in timings.values())


def test_every_target_of_the_log_is_a_figure(bench: Any) -> None:
    figures = _log_figures(bench)
    assert {key: one.target for key, one in figures.items() if one.target is not None} == (
        _LOG_TARGETS
    )
    assert all(figures[key].meets for key in _LOG_TARGETS)


@pytest.mark.parametrize(
    ("key", "parts"),
    [
        ("log_append_growth", {"timings": {"log_append_long": 121}}),
        ("log_memory", {"told": {"rss_growth_bytes": 51 * 2**20}}),
        ("log_verify_short", {"timings": {"log_bare_short": 49}}),
        ("log_verify_long", {"timings": {"log_bare_long": 49}}),
        ("log_verify_together", {"timings": {"log_bare_disk": 49}}),
        ("log_verify_linear", {"timings": {"log_verify_short": 83, "log_bare_short": 83}}),
        ("log_whole_linear", {"told": {"later_over_earlier": 1.21}}),
        ("log_whole_linear", {"told": {"verify_ns_a_record": [20_000.0, 41_000.0]}}),
        ("log_whole", {"told": {"whole": False}}),
        ("log_whole", {"told": {"verified": 199_999}}),
    ],
)
def test_a_log_that_falls_short_is_told_apart(bench: Any, key: str, parts: dict[str, Any]) -> None:
    figures = _log_figures(bench, **parts)
    assert [name for name in _LOG_TARGETS if not figures[name].meets] == [key]


@pytest.mark.parametrize(
    ("told", "missed"),
    [
        ({}, []),
        ({"rss_growth_bytes": 51 * 2**20}, ["log_memory"]),
        ({"whole": False}, ["log_whole"]),
        ({"verified": 199_999, "rss_growth_bytes": 2**30}, ["log_memory", "log_whole"]),
        ({"later_over_earlier": 9.0}, []),  # a time: the machine's as much as the code's
    ],
)
def test_a_night_fails_by_what_no_clock_enters_alone_and_its_result_is_kept(
    bench: Any,
    told: dict[str, Any],
    missed: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import log as run

    assert set(_LOG_TARGETS) > run.UNTIMED
    storage = [{"what": "a record", "open": 1, "sealed": 1, "link": 32, "tree": 0.5}]
    found = run.Logged(
        _log_timings(bench, log_append_long=900), {**_logged(**told), "storage": storage}
    )
    monkeypatch.setattr(run, "log", lambda *_: found)
    kept = tmp_path / "log-night.json"
    code = run.main(["--quick", "--json", str(kept), "--disk", str(tmp_path)])
    assert code == (1 if missed else 0)
    assert capsys.readouterr().err == (f"missed: {', '.join(missed)}\n" if missed else "")
    figures = {one["id"]: one for one in json.loads(kept.read_text())["figures"]}
    assert figures["log_append_growth"]["meets"] is False
    assert [key for key in figures if key in run.UNTIMED and not figures[key]["meets"]] == missed


def test_every_figure_and_size_of_the_log_is_a_row_of_the_page(bench: Any) -> None:
    import table

    figures = _log_figures(bench).values()
    page = table.targets({"figures": [one.plain() for one in figures]})
    assert all(one.what in page for one in figures if one.target is not None)
    sizes = {"open": 1_050, "sealed": 1_623, "link": 32, "tree": 0.5}
    assert "| one record | 1050 | 1623 | 32 | 0.5 | 2705.5 |" in table.storage(
        [{"what": "one record", **sizes}]
    )


def _strangers(slow_ms: int) -> dict[str, dict[str, list[Any]]]:
    """Return blocks in which a request takes 2 ms quiet, and so many beside who asks."""
    import listeners as run

    def blocks(took_ms: int) -> list[Any]:
        return [run.Block([took_ms * 1_000_000] * 20, [1_000_000] * 10, 4_096.0, 9_000_000)] * 2

    return {
        kind: {run.QUIET: blocks(2), run.CROWDED: blocks(slow_ms if kind == "asks" else 2)}
        for kind in run.CROWDS
    }


@pytest.mark.parametrize(
    ("slow_ms", "words", "missed"),
    [
        (10, ["--require", "5"], ""),
        (11, ["--require", "5"], "above 5: requests beside asks\n"),
        (11, [], ""),
    ],
)
def test_a_crowd_that_takes_more_than_it_may_is_told_and_the_result_is_kept(
    bench: Any,
    slow_ms: int,
    words: list[str],
    missed: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import listeners as run

    monkeypatch.setattr(run, "measure", lambda *_: _strangers(slow_ms))
    kept, page = tmp_path / "listeners.json", tmp_path / "page.md"
    page.write_text(f"before\n{run.BEGIN}\nold\n{run.END}\nafter\n")
    code = run.main(["--quick", "--json", str(kept), "--markdown", str(page), *words])
    said = capsys.readouterr()
    assert (code, said.err) == (1 if missed else 0, missed)
    assert page.read_text() == f"before\n{run.BEGIN}\n{said.out}{run.END}\nafter\n"
    assert f"| 8 `asks` | 9 | 2.0 / 2.0 | {slow_ms}.0 / {slow_ms}.0 |" in said.out
    crowds = json.loads(kept.read_text())["crowds"]
    assert set(crowds) == set(run.CROWDS)
    assert crowds["asks"]["requests"]["p99_ratio"] == slow_ms / 2
