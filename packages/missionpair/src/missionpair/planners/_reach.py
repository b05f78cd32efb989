# SPDX-License-Identifier: Apache-2.0
"""Where a model is, how it is paid, and how long it may take. A key stays in the environment."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from msgspec import Struct

from authguard_r.authoring.model_client.exchange import ModelAddress

#: The names of our own local server's programs begin so; a table never calls one a model.
SCRIPTED = "scripted-"


class Price(Struct, frozen=True):
    """What a token costs, in millionths of a dollar: dollars for a million of them.

    Args:
        read: one that the model is shown.
        written: one that it writes.
    """

    read: Fraction
    written: Fraction

    def of(self, read: int, written: int) -> int:
        """Return what so many tokens cost, in millionths of a dollar, rounded up."""
        return -int(-(self.read * read + self.written * written) // 1)


class ModelEndpoint(ModelAddress, frozen=True, kw_only=True):
    """One model at one server, which may cost money.

    Args:
        protocol: `openai` or `anthropic`.
        temperature: of the model's random choices; None sends none, for models that take none.
        timeout_s: seconds that one attempt may take.
        backoff_s: seconds before the second attempt; doubled before each further one.
        patience_s: longest wait between two attempts; a server that asks for more is an error.
        price: what tokens cost; None when it is not known.
    """

    protocol: str
    temperature: float | None = 1.0
    retries: int = 3
    backoff_s: float = 0.5
    patience_s: float = 60.0
    price: Price | None = None

    @property
    def simulated(self) -> bool:
        """True when a scripted stand-in is asked for."""
        return self.model.startswith(SCRIPTED)

    @property
    def name(self) -> str:
        """Who answers, as tables call it."""
        return f"{self.protocol}:{self.model}"

    def published(self) -> dict[str, Any]:
        """Return what shapes the answers; neither an address of one's own nor a key."""
        return {
            "protocol": self.protocol,
            "server": "own" if self.own else self.base_url,
            "model": self.model,
            "temperature": self.temperature,
            "timeout_s": self.timeout_s,
            "retries": self.retries,
        }
