# SPDX-License-Identifier: Apache-2.0
"""Claude Haiku 4.5, the first of the paper's two models; needs `ANTHROPIC_API_KEY`.

Options as `anthropic` has them; the model may only give way to a scripted stand-in.
Source: `tab:pilot-live-llm`, `tab:pilot-adaptive-haiku`. How-to: docs/howto/missionpair-models.md
"""

from __future__ import annotations

from missionpair.planners._client import held
from missionpair.planners._live import PlannerMaker
from missionpair.planners._protocol import AnthropicClient

make = PlannerMaker(
    speaks=held(AnthropicClient),
    protocol="anthropic",
    vendor_url="https://api.anthropic.com",
    vendor_key="ANTHROPIC_API_KEY",
    preset="haiku",
    preset_model="claude-haiku-4-5-20251001",
    temperature="none",
)
