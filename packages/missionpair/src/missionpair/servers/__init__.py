# SPDX-License-Identifier: Apache-2.0
"""Local servers that speak as model servers do, with a scripted stand-in behind them.

For tests and for showing how a campaign runs, without a model and without a network. What answers
is a script with published behavior: it says so in every reply, and no result of it is a model's.
How-to: docs/howto/missionpair-models.md#without-a-model
"""

from __future__ import annotations

from missionpair.servers._http import StandInServer
from missionpair.servers.anthropic_server import AnthropicServer
from missionpair.servers.openai_server import OpenAIServer

#: The server of each protocol.
SERVERS: dict[str, type[StandInServer]] = {
    "openai": OpenAIServer,
    "anthropic": AnthropicServer,
}

__all__ = ["SERVERS", "AnthropicServer", "OpenAIServer", "StandInServer"]
