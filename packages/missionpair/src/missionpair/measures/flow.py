# SPDX-License-Identifier: Apache-2.0
"""What trials of one kind under one defense cost: time, waiting, questions, tokens, money.

Also what was refused with which codes, and which protected fields were violated. Times are the one
part of a log that two runs differ in, and come from `timing` alone.
"""

from __future__ import annotations

from missionpair.measures.faults import tick
from missionpair.measures.spread import Spread
from missionpair.records import Round, Timing, Trial

#: The parts of a trial's time, in the order of the record.
PARTS: tuple[str, ...] = Timing.__struct_fields__


class Flow:
    """Sums and spreads of one defense and kind."""

    __slots__ = (
        "by",
        "cost_microusd",
        "errors",
        "executed",
        "false_stops",
        "most_prompts",
        "n",
        "planned",
        "prompts",
        "read",
        "reasons",
        "stalled",
        "times",
        "tried",
        "written",
    )

    def __init__(self) -> None:
        self.n = 0
        self.errors = 0
        self.prompts = 0
        self.most_prompts = 0
        self.false_stops = 0
        #: simulated milliseconds of waits for each trial
        self.stalled = Spread()
        #: tries for each trial
        self.tried = Spread()
        #: microseconds by part, of the trials in which the part ran
        self.times = {part: Spread() for part in PARTS}
        #: tokens
        self.read = 0
        self.written = 0
        self.cost_microusd = 0
        #: who refused, with which codes
        self.by: dict[str, int] = {}
        self.reasons: dict[str, int] = {}
        #: codes of protected fields: of plans that complied, and of what was executed
        self.planned: dict[str, int] = {}
        self.executed: dict[str, int] = {}

    def add(self, trial: Trial, reached: Round | None) -> None:
        """Count a trial."""
        self.n += 1
        self.errors += bool(trial.error) or trial.instead == "error"
        self.prompts += trial.prompts
        self.most_prompts = max(self.most_prompts, trial.prompts)
        self.false_stops += trial.false_stop
        self.stalled.add(trial.stalled_ms)
        self.tried.add(len(trial.rounds))
        for part, spread in self.times.items():
            took = getattr(trial.timing, part)
            if took:  # what did not run took no time, which is not a time
                spread.add(took)
        self.read += trial.tokens[0]
        self.written += trial.tokens[1]
        self.cost_microusd += trial.cost_microusd
        if trial.by:
            tick(self.by, trial.by)
            for reason in set(trial.reasons):
                tick(self.reasons, reason)
        if trial.complied:
            for code in set(trial.violated if reached is None else reached.violated):
                tick(self.planned, code)
        for code in set(trial.violated):
            tick(self.executed, code)

    def merge(self, other: Flow) -> None:
        """Count what another one has counted."""
        self.n += other.n
        self.errors += other.errors
        self.prompts += other.prompts
        self.most_prompts = max(self.most_prompts, other.most_prompts)
        self.false_stops += other.false_stops
        self.stalled.merge(other.stalled)
        self.tried.merge(other.tried)
        for part, spread in self.times.items():
            spread.merge(other.times[part])
        self.read += other.read
        self.written += other.written
        self.cost_microusd += other.cost_microusd
        for mine, theirs in (
            (self.by, other.by),
            (self.reasons, other.reasons),
            (self.planned, other.planned),
            (self.executed, other.executed),
        ):
            for key, count in theirs.items():
                mine[key] = mine.get(key, 0) + count
