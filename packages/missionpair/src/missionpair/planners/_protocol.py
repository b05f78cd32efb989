# SPDX-License-Identifier: Apache-2.0
"""A model behind a server of one of the two protocols: asked under caps, held to its protocol."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from msgspec.structs import asdict, replace

from authguard_r.authoring.model_client.exchange import ModelServerError, library
from authguard_r.authoring.model_client.protocols import (
    AnthropicProtocol,
    Body,
    ModelProtocol,
    ModelRequest,
    OpenAIProtocol,
)
from missionpair.briefing import OfferedTool, PlannerError
from missionpair.planners._client import Completion
from missionpair.planners._meter import Meter
from missionpair.planners._reach import SCRIPTED, ModelEndpoint
from missionpair.planners._sending import planner_error, send

#: Tokens that a server may add itself, such as its instructions for calling tools.
_ADDED = 1_000


class MeteredClient:
    """A model behind a server of one protocol.

    Args:
        reach: where it is.
        meter: what may be used.
        pause: waits so many seconds between two attempts.

    Raises:
        PlannerError: the package, the key or the address is missing or cannot be used.
    """

    protocol: ClassVar[ModelProtocol]

    def __init__(
        self, reach: ModelEndpoint, meter: Meter, *, pause: Callable[[float], None] = time.sleep
    ) -> None:
        try:
            library(self.protocol.package)
            reach.require()
        except ModelServerError as error:
            raise planner_error(reach, error) from error
        if not reach.model:
            message = "no model is named: say `model=NAME` as its server calls it"
            raise PlannerError(message, code="refused", where="model")
        self.reach, self.meter, self._pause = reach, meter, pause

    @property
    def name(self) -> str:
        """Who answers, as tables call it."""
        return self.reach.name

    @property
    def simulated(self) -> bool:
        """It asks for a scripted stand-in, which is no model."""
        return self.reach.simulated

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that shapes its answers."""
        reach = self.reach
        spoken = self.protocol.published(reach.temperature)
        return {**reach.published(), **self.meter.published(), **spoken}

    def complete(
        self, system: str, messages: Sequence[tuple[str, str]], *, seed: int, max_tokens: int
    ) -> Completion:
        """Return the model's answer in words; see `Client.complete`."""
        return self.call_tools(system, messages, (), seed=seed, max_tokens=max_tokens)

    def call_tools(
        self,
        system: str,
        messages: Sequence[tuple[str, str]],
        tools: Sequence[OfferedTool],
        *,
        seed: int,
        max_tokens: int,
        schema: dict[str, Any] | None = None,
    ) -> Completion:
        """Return the model's answer where it may call tools; see `ModelClient.call_tools`."""
        reach, protocol = self.reach, self.protocol
        asked = ModelRequest(
            system=_clean(system),
            messages=[(role, _clean(text)) for role, text in messages],
            tools=[(tool.name, tool.description, tool.parameters) for tool in tools],
            seed=seed,
            max_tokens=max_tokens,
            temperature=reach.temperature,
            schema=schema,
        )
        body = protocol.body(reach, asked)
        most = self._most(body, max_tokens)
        try:
            part = library(protocol.package)
            sent = send(
                reach,
                self.meter,
                part,
                lambda web: protocol.post(part, web, reach, body),
                headers=protocol.headers(reach, asked),
                most_microusd=most,
                pause=self._pause,
            )
            reply = protocol.read(sent.body)
        except ModelServerError as error:
            raise planner_error(reach, error) from None
        done = Completion(**asdict(reply), took_us=sent.took_us, attempts=sent.attempts)
        self._require_told_apart(done.model)
        return self._settled(done, set_aside=most)

    def _most(self, body: Body, max_tokens: int) -> int:
        """Return the most that one attempt can cost: no token is shorter than a byte."""
        price = self.reach.price
        if price is None:
            return 0
        return price.of(len(json.dumps(body)) + _ADDED, max_tokens)

    def _settled(self, done: Completion, *, set_aside: int) -> Completion:
        """Return the answer with its cost, and give back what it did not cost."""
        price = self.reach.price
        if price is None or done.tokens == (0, 0):  # uncounted: all of it may have been spent
            return done
        cost = price.of(*done.tokens)
        self.meter.give_back(set_aside - cost)
        return replace(done, cost_microusd=cost)

    def _require_told_apart(self, model: str) -> None:
        """A scripted stand-in passes for no model, and no model for a stand-in."""
        if model.startswith(SCRIPTED) == self.simulated:
            return
        raise PlannerError(
            f"`{model[:80]}` answered in place of `{self.reach.model}`: name it as the model, so "
            "that its results are marked",
            code="protocol",
            where="model",
        )


class OpenAIClient(MeteredClient):
    """A model behind a server of the chat completions protocol."""

    protocol = OpenAIProtocol()


class AnthropicClient(MeteredClient):
    """A model behind a server of the Messages protocol."""

    protocol = AnthropicProtocol()


def _clean(text: str) -> str:
    """Return a text without halves of characters, which no server could be sent."""
    return text.encode(errors="replace").decode()
