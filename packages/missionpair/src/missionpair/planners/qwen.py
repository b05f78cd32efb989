# SPDX-License-Identifier: Apache-2.0
"""Qwen2.5 7B through Ollama on this machine, the second of the paper's two models; no key.

Options as `openai` has them; the model may only give way to a scripted stand-in.
Source: `tab:pilot-qwen-fixed`, `tab:pilot-qwen-adaptive`. How-to: docs/howto/missionpair-models.md
"""

from __future__ import annotations

from missionpair.planners._client import held
from missionpair.planners._live import PlannerMaker
from missionpair.planners._protocol import OpenAIClient

make = PlannerMaker(
    speaks=held(OpenAIClient),
    protocol="openai",
    vendor_url="https://api.openai.com/v1",
    vendor_key="OPENAI_API_KEY",
    preset="qwen",
    preset_model="qwen2.5:7b",
    url="http://127.0.0.1:11434/v1",
)
