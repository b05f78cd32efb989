# SPDX-License-Identifier: Apache-2.0
"""The columns by which a row says which campaign and which defense it is of."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from missionpair.measures import MeasuredCampaign
from missionpair.report.names import attack, defense, planner, simulated_parts, standing
from missionpair.report.table import Head, Row

RUN = (
    Head("log", "Log"),
    Head("planner", "Planner"),
    Head("attacker", "Attack"),
    Head("access", "Access"),
    Head("defense", "Defense"),
    Head("simulated", "Simulated, recorded or live"),
)


class DefenseRun(Struct, frozen=True):
    """One defense in one campaign.

    Args:
        number: of the log in this report, from 1.
        measured: the campaign's measures.
        defense: its name.
    """

    number: int
    measured: MeasuredCampaign
    defense: str

    @property
    def cells(self) -> Row:
        """What stands in the columns `RUN`."""
        campaign = self.measured.campaign
        return (
            self.number,
            planner(campaign.planner),
            attack(campaign.attacker),
            campaign.access,
            defense(campaign, self.defense),
            simulated_parts(campaign, self.defense) or standing(campaign.planner),
        )


def runs(logs: tuple[MeasuredCampaign, ...]) -> Iterator[DefenseRun]:
    """Yield every defense of every campaign, in order."""
    for number, measured in enumerate(logs, 1):
        for name in measured.defenses:
            yield DefenseRun(number, measured, name)
