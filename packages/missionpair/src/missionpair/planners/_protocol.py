# SPDX-License-Identifier: Apache-2.0
"""What both protocols share: a request is sent under caps, a reply is held to its shape.

Only the frame of a reply is read here, never a call: what a model says is for the normalizer.
"""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from msgspec import Struct
from msgspec.structs import replace

from missionpair.briefing import OfferedTool, PlannerError
from missionpair.planners._client import Completion
from missionpair.planners._meter import Meter
from missionpair.planners._reach import SCRIPTED, ModelEndpoint
from missionpair.planners._sending import library, send

Body = dict[str, Any]
#: Tokens that a server may add itself, such as its instructions for calling tools.
_ADDED = 1_000


class ServerReply(Struct, frozen=True):
    """A reply as it came: its exact bytes, and the object that they are."""

    raw: bytes
    value: dict[str, Any]


class _ShapeError(Exception):
    """A reply is not one of its protocol."""


class SpokenClient(ABC):
    """A model behind a server of one protocol.

    Args:
        reach: where it is.
        meter: what may be used.
        pause: waits so many seconds between two attempts.

    Raises:
        PlannerError: the package, the key or the address is missing or cannot be used.
    """

    #: The client library's package.
    library: ClassVar[str]

    def __init__(
        self, reach: ModelEndpoint, meter: Meter, *, pause: Callable[[float], None] = time.sleep
    ) -> None:
        library(self.library)
        reach.require()
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
        return {**self.reach.published(), **self.meter.published()}

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
    ) -> Completion:
        """Return the model's answer where it may call tools; see `Client.call_tools`."""
        said = [(role, _clean(text)) for role, text in messages]
        body = self.body(_clean(system), said, tools, seed=seed, max_tokens=max_tokens)
        most = self._most(body, max_tokens)
        part = library(self.library)
        sent = send(
            self.reach,
            self.meter,
            part,
            lambda web: self.post(part, web, body),
            most_microusd=most,
            pause=self._pause,
        )
        try:
            done = self.read(ServerReply(sent.body, _object(sent.body)))
        except _ShapeError as error:
            raise self.odd(str(error)) from None
        self._require_told_apart(done.model)
        return self._settled(
            replace(done, took_us=sent.took_us, attempts=sent.attempts), set_aside=most
        )

    @abstractmethod
    def post(self, part: Any, web: Any, body: Body) -> bytes:
        """Send a request and return the reply's exact body."""

    @abstractmethod
    def body(
        self,
        system: str,
        messages: Sequence[tuple[str, str]],
        tools: Sequence[OfferedTool],
        *,
        seed: int,
        max_tokens: int,
    ) -> Body:
        """Return what is sent."""

    @abstractmethod
    def read(self, reply: ServerReply) -> Completion:
        """Return what a reply says; its calls are left to the normalizer."""

    def odd(self, message: str) -> PlannerError:
        """Return the fault of a reply that is none."""
        return PlannerError(
            f"the model server at `{self.reach.base_url}` sent no reply of its protocol: {message}",
            code="protocol",
            where="base_url",
        )

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


def _clean(text: str) -> str:
    """Return a text without halves of characters, which no server could be sent."""
    return text.encode(errors="replace").decode()


def _object(raw: bytes) -> dict[str, Any]:
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        raise _ShapeError("expected JSON") from None
    return object_of(value, "reply")


def object_of(value: Any, where: str) -> dict[str, Any]:
    """Return the value when it is an object; else the reply is none of its protocol."""
    found: dict[str, Any] = expect(value, dict, where)
    return found


def expect(value: Any, kind: type[Any], where: str) -> Any:
    """Return the value when it is of the kind; else the reply is none of its protocol."""
    if isinstance(value, kind):
        return value
    raise _ShapeError(f"expected {'an object' if kind is dict else 'a list'} at `{where}`")


def text_of(value: Any) -> str:
    """Return a text, and the empty one where there is none."""
    if value is None or isinstance(value, str):
        return value or ""
    raise _ShapeError("expected text")


def count(usage: Any, name: str) -> int:
    """Return a count of tokens, 0 where a server does not say it."""
    found = usage.get(name) if isinstance(usage, dict) else None
    return found if type(found) is int and found >= 0 else 0
