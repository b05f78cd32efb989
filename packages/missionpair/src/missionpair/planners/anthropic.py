# SPDX-License-Identifier: Apache-2.0
"""A model behind a server of Anthropic's Messages protocol.

Options as `openai` has them, but for `temperature`: without it, the server's own dice are thrown.
How-to: docs/howto/missionpair-models.md
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
    temperature="none",
)
