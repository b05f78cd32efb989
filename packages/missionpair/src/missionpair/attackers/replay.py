# SPDX-License-Identifier: Apache-2.0
"""The texts that another attacker sent before, from a campaign's log: nothing is asked again.

Options: `log=FILE`, with `defense=NAME` where the attacker wrote other texts under other defenses,
as one does that learns from each round.
How-to: docs/howto/missionpair-models.md#replay-a-log-without-a-model
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from missionpair.attackers import AttackerError
from missionpair.campaign.log import LogError, whole_log
from missionpair.pair import Input
from missionpair.records import Campaign
from missionpair.words import Channel, TrialKind

#: The texts of every round of a trial.
_Rounds = tuple[tuple[Input, ...], ...]


class ReplayAttacker:
    """Sends what was sent in the trial with the same dice.

    Args:
        kept: the texts of each round, by the trial's seed; None: they differ by defense.
        simulated: a stand-in wrote them.
        of: who wrote them, for the log.
        replayed: the campaign that they were written in.
        where: the log.
    """

    name = "replay"

    def __init__(
        self,
        kept: dict[int, _Rounds | None],
        *,
        simulated: bool,
        of: dict[str, Any],
        replayed: Campaign,
        where: str,
    ) -> None:
        self.simulated, self.parameters = simulated, of
        self.replayed, self.suite_digest = replayed, replayed.suite_digest
        self._kept, self._where = kept, where
        self._left: list[tuple[Input, ...]] = []

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:  # noqa: ARG002 - dice decide
        """Return the texts of the first round.

        Raises:
            AttackerError: the log has no attack with this seed, or several that differ.
        """
        if seed not in self._kept:
            raise self._missing(f"has no attack with seed {seed}: take the log's suite and seed")
        found = self._kept[seed]
        if found is None:
            raise self._missing("has other texts under other defenses: name one with `defense`")
        self._left = list(found)
        return self._left.pop(0)

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:  # noqa: ARG002
        """Return the texts of the next round; None where the trial had no more."""
        return self._left.pop(0) if self._left else None

    def _missing(self, message: str) -> AttackerError:
        return AttackerError(message, code="protocol", where=self._where)


def make(*, log: str = "", defense: str = "") -> ReplayAttacker:
    """Return the attacker of a log.

    Raises:
        ValueError: no log is named, it cannot be read, or it has no such defense.
    """
    if not log:
        raise ValueError("name the log: `log=FILE`")
    path = Path(log)
    try:
        campaign, trials, digest = whole_log(path)
    except LogError as error:
        raise ValueError(f"{error.where}: {error.message}") from error
    names = [named.name for named in campaign.defenses]
    if defense and defense not in names:
        raise ValueError(f"`{path}` has no defense `{defense}`: {', '.join(names)}")
    kept: dict[int, _Rounds | None] = {}
    for trial in trials:
        if trial.kind == TrialKind.ATTACK and trial.rounds and defense in {"", trial.defense}:
            sent = tuple(_inputs(one.inputs) for one in trial.rounds)
            kept[trial.seed] = sent if kept.setdefault(trial.seed, sent) == sent else None
    return ReplayAttacker(
        kept,
        simulated=campaign.attacker.simulated,
        of={"attacker": msgspec.to_builtins(campaign.attacker), "log": digest},
        replayed=campaign,
        where=str(path),
    )


def _inputs(given: tuple[tuple[str, str], ...]) -> tuple[Input, ...]:
    return tuple(Input(Channel(channel), text) for channel, text in given)
