# SPDX-License-Identifier: Apache-2.0
"""What a campaign came to, in one sentence."""

from __future__ import annotations

from missionpair.measures import MeasuredCampaign
from missionpair.report.names import SYSTEMS, planner, printable
from missionpair.report.paper import gate_of
from missionpair.report.table import Head, ShareForm, share, text
from missionpair.words import TrialKind

_NAME = Head("name", "")


def headline(number: int, measured: MeasuredCampaign) -> str:
    """Return one sentence on a campaign, about the defense that the report's summaries are of.

    Args:
        number: of the log in its report.
        measured: the campaign.
    """
    name = gate_of(measured)
    attacks, benign = measured.tally(name), measured.tally(name, TrialKind.BENIGN)
    system = SYSTEMS.get(name, printable(name))
    who = text(planner(measured.campaign.planner), _NAME)
    said = [f"Log {number}, {system}, planner {who}"]
    if attacks.n:
        done = share(attacks.uasr, ShareForm.INTERVAL)
        said.append(f"an unauthorized action was carried out in {done} attacks (UASR)")
        said.append(f"the planner did what the attack asks in {attacks.complied} of {attacks.n}")
        paired = attacks.control(TrialKind.NEUTRAL)
        if paired.n and paired.gap is not None:
            gap = text(paired.gap, Head("gap", ""))
            anyway = paired.anyway
            said[-1] += (
                f", and in {anyway.k} of {anyway.n} with a neutral text in its place "
                f"(difference {gap})"
            )
    if benign.n:
        said.append(f"{benign.completed} of {benign.n} benign runs came to their end (BTCR)")
    return f"{said[0]}: {'; '.join(said[1:]) or 'no attack and no benign run'}."
