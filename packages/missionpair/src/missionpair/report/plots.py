# SPDX-License-Identifier: Apache-2.0
"""Which plots a report has; each repeats a table."""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.measures import PARTS, Dimension, Gap, MeasuredCampaign, Proportion, Tally
from missionpair.report.costs import TIME
from missionpair.report.names import (
    CATEGORIES,
    LIVE_ROWS,
    attack,
    category,
    live,
    planner,
    printable,
    simulated,
)
from missionpair.report.outcomes import RATES
from missionpair.report.paper import SECTION, gate_of
from missionpair.report.svg import Axis, Dot, Plot, PlotRow
from missionpair.report.table import Head, ShareForm, share, text
from missionpair.report.tries import LEAKS, Leaked

_SHARE = Axis("share of trials, with 95 % intervals", 0.0, 1.0)
_NAME = Head("name", "")


def plots(logs: tuple[MeasuredCampaign, ...], leaks: tuple[Leaked, ...]) -> Iterator[Plot]:
    """Yield every plot of a report."""
    for number, measured in enumerate(logs, 1):
        if measured.tally(gate_of(measured)).n:
            yield _compliance(number, measured)
        yield _rates(number, measured)
        yield _times(number, measured)
    if leaks:
        yield _leakage(logs, leaks)


def _compliance(number: int, measured: MeasuredCampaign) -> Plot:
    """Compliance by category, the paper's beside it."""
    campaign, found = measured.campaign, live(measured, gate_of(measured))
    rows = measured.by(Dimension.CATEGORY, gate_of(measured))
    names = dict.fromkeys([*LIVE_ROWS, *(name for name in CATEGORIES if name in rows), *rows])
    lines = []
    for name in names:
        dots = [*_dots(0, rows.get(name, Tally()).compliance)]
        printed = found.compliance(name) if found else None
        dots += [*_dots(1, printed)] if printed else []
        lines.append(PlotRow(category(name), tuple(dots)))
    who = text(planner(campaign.planner), _NAME)
    return Plot(
        name=f"plot-compliance-{number}",
        title=f"Planner compliance: {who}, {attack(campaign.attacker)}",
        axis=_SHARE,
        series=("measured", "published")[: 2 if found else 1],
        lines=tuple(lines),
        simulated=simulated([measured]),
        table="by-category",
        section=SECTION,
    )


def _rates(number: int, measured: MeasuredCampaign) -> Plot:
    """UASR and SCMHR of each defense."""
    lines = []
    for name in measured.defenses:
        tally = measured.tally(name)
        lines.append(PlotRow(printable(name), (*_dots(0, tally.uasr), *_dots(1, tally.scmhr))))
    who = text(planner(measured.campaign.planner), _NAME)
    return Plot(
        name=f"plot-rates-{number}",
        title=f"Unauthorized actions executed, log {number}: {who}",
        axis=_SHARE,
        series=("UASR", "SCMHR"),
        lines=tuple(lines),
        simulated=simulated([measured]),
        table="rates",
        section=RATES,
    )


def _times(number: int, measured: MeasuredCampaign) -> Plot:
    """The parts of a trial's time: 50th, 95th and 99th percentile."""
    flow = measured.flow(gate_of(measured))
    lines = []
    for part in PARTS:
        spread = flow.times[part]
        found = [
            (name, spread.quantile(p)) for name, p in (("p50", 500), ("p95", 950), ("p99", 990))
        ]
        dots = tuple(
            Dot(series=at, value=took, low=took, high=took, tip=f"{name} {took:,} us")
            for at, (name, took) in enumerate(found)
            if took is not None
        )
        lines.append(PlotRow(part, dots))
    most = max((spread.most for spread in flow.times.values()), default=0)
    gate = printable(gate_of(measured))
    return Plot(
        name=f"plot-times-{number}",
        title=f"Time by part of a trial, log {number}, defense {gate}",
        axis=Axis(
            "time, each line ten times the one before",
            1.0,
            float(10 ** max(1, len(str(most)))),
            logarithmic=True,
        ),
        series=("p50", "p95", "p99"),
        lines=tuple(lines),
        simulated=simulated([measured]),
        table="times",
        section=TIME,
    )


def _leakage(logs: tuple[MeasuredCampaign, ...], leaks: tuple[Leaked, ...]) -> Plot:
    """What more access is worth in SCMHR."""
    lines = tuple(
        PlotRow(
            f"{printable(one.leak.defense)}: {one.leak.more} - {one.leak.less}"
            f" (logs {one.more}, {one.less})",
            tuple(_gap_dots(one.leak.gain)),
        )
        for one in leaks
    )
    return Plot(
        name="plot-leakage",
        title="SCMHR with more access, less SCMHR with less",
        axis=Axis("difference, with Newcombe's 95 % interval", -1.0, 1.0),
        series=("difference",),
        lines=lines,
        simulated=simulated(logs[n - 1] for one in leaks for n in (one.more, one.less)),
        table="leakage",
        section=LEAKS,
    )


def _dots(series: int, rate: Proportion) -> Iterator[Dot]:
    if rate.value is not None and rate.interval is not None:
        low, high = rate.interval
        words = share(rate, ShareForm.INTERVAL)
        yield Dot(series=series, value=float(rate.value), low=low, high=high, tip=words)


def _gap_dots(gap: Gap | None) -> Iterator[Dot]:
    if gap is not None:
        words = text(gap, Head("gap", "", digits=4)) or ""
        yield Dot(series=0, value=gap.value, low=gap.low, high=gap.high, tip=words)
