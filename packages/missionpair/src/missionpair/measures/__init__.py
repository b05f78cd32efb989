# SPDX-License-Identifier: Apache-2.0
"""Every figure of a report, from the lines of a campaign's log and nothing else.

`measure` looks at each trial once; `leakage` sets two campaigns beside each other. The paper's own
equations are the oracle's (`authguard_reference.metrics`). Spec page: docs/spec/measures.md
"""

from missionpair.measures.campaign import CellKey, Dimension, MeasuredCampaign, Scores, measure
from missionpair.measures.control import Paired
from missionpair.measures.faults import INSTEAD, MeasureError
from missionpair.measures.flow import PARTS, Flow
from missionpair.measures.leakage import Leak, leakage, wider
from missionpair.measures.rates import Gap, Proportion, difference
from missionpair.measures.resample import mean_difference
from missionpair.measures.spread import Spread
from missionpair.measures.tally import Tally, average, largest

__all__ = [
    "INSTEAD",
    "PARTS",
    "CellKey",
    "Dimension",
    "Flow",
    "Gap",
    "Leak",
    "MeasureError",
    "MeasuredCampaign",
    "Paired",
    "Proportion",
    "Scores",
    "Spread",
    "Tally",
    "average",
    "difference",
    "largest",
    "leakage",
    "mean_difference",
    "measure",
    "wider",
]
