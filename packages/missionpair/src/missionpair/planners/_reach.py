# SPDX-License-Identifier: Apache-2.0
"""Where a model is, how it is paid, and how long it may take. A key stays in the environment."""

from __future__ import annotations

import os
from fractions import Fraction
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from msgspec import Struct

from missionpair.briefing import PlannerError

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


class ModelEndpoint(Struct, frozen=True, kw_only=True):
    """One model at one server.

    Args:
        protocol: `openai` or `anthropic`.
        base_url: the only address that is spoken to; redirects and proxies are not followed.
        own: the address is not the vendor's.
        model: the model's name there.
        key_env: name of the environment variable with the key; empty for a server that asks none.
        temperature: of the model's dice; None sends none, for models that take none.
        timeout_s: seconds that one attempt may take.
        retries: further attempts after 408, 429, 5xx, silence and broken connections.
        backoff_s: seconds before the second attempt; doubled before each further one.
        patience_s: longest wait between two attempts; a server that asks for more is an error.
        price: what tokens cost; None when nobody said.
    """

    protocol: str
    base_url: str
    own: bool
    model: str
    key_env: str = ""
    temperature: float | None = 1.0
    timeout_s: float = 60.0
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

    def key(self) -> str:
        """Return the key; a word that is none for a server that asks for none.

        Raises:
            PlannerError: the variable holds none.
        """
        if not self.key_env:
            return "none"
        found = os.environ.get(self.key_env, "").strip()
        if not found or not found.isascii() or not found.isprintable():
            raise PlannerError(
                f"the environment variable `{self.key_env}` holds no key: set it, or name another "
                "one with `key_env`",
                code="refused",
                where="key_env",
            )
        return found

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

    def require(self) -> None:
        """Hold the address and the key to what can be spoken to.

        Raises:
            PlannerError: no model, no such address, or a key that would travel in the clear.
        """
        if not self.model:
            raise PlannerError(
                "no model is named: say `model=NAME` as its server calls it",
                code="refused",
                where="model",
            )
        host = _host(self.base_url)
        if self.key_env and self.base_url.startswith("http://") and not _is_loopback(host):
            raise PlannerError(
                f"the key of `{self.key_env}` would travel to `{host}` in the clear: use https",
                code="refused",
                where="base_url",
            )
        self.key()


def _host(base_url: str) -> str:
    """Return the host of an address that holds no credentials.

    Raises:
        PlannerError: it is no such address.
    """
    try:
        parts = urlsplit(base_url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        host, parts = None, urlsplit("")
    plain = not (parts.query or parts.fragment or "@" in parts.netloc)
    if parts.scheme not in {"http", "https"} or not host or not plain:
        # the address itself is not repeated: it may hold a password
        raise PlannerError(
            "expected an address such as http://127.0.0.1:11434/v1, without a name or a key in it",
            code="unreachable",
            where="base_url",
        )
    return host


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
