# SPDX-License-Identifier: Apache-2.0
"""A model behind a server of the chat completions protocol: OpenAI, Ollama, vLLM, LM Studio.

Options: `model`, `base_url`, `key_env` (the variable that holds the key), `mode` (`tools`, `json`),
`temperature`, `max_tokens`, `timeout`, `retries`, `per_minute`, `max_cost` with `price_in` and
`price_out`, `ledger`. How-to: docs/howto/missionpair-models.md
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
)
