# SPDX-License-Identifier: Apache-2.0
"""A language model behind a server: what is asked of it, and what comes back.

Targets, attackers and judges that are models all speak through a `ModelClient`. Everything that a
model says is an answer. Only a server that cannot be reached, or breaks its protocol, is an error.
How-to: docs/howto/missionpair-models.md
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from authguard_r.authoring.model_client.protocols import ModelReply
from missionpair.briefing import OfferedTool, PlannerError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from missionpair.planners._meter import Meter
    from missionpair.planners._reach import ModelEndpoint

#: Options that a client checks before it sends a request.
_OPTIONS = frozenset({"base_url", "model"})


class Completion(ModelReply, frozen=True, kw_only=True):
    """One whole answer of a model, with what it took.

    Args:
        took_us: from sending the attempt that was answered to its last byte; waiting for a cap, or
            between attempts, is not the model's time.
        cost_microusd: millionths of a dollar, rounded up; 0 where the price is not known.
        attempts: requests that this answer took.
    """

    took_us: int = 0
    cost_microusd: int = 0
    attempts: int = 1


class ModelClient(Protocol):
    """A model that answers."""

    @property
    def name(self) -> str:
        """Who answers, as tables call it: `openai:MODEL`."""
        ...

    @property
    def simulated(self) -> bool:
        """It asks for a scripted stand-in, which is no model."""
        ...

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that shapes its answers; no address of one's own, no key."""
        ...

    def complete(
        self, system: str, messages: Sequence[tuple[str, str]], *, seed: int, max_tokens: int
    ) -> Completion:
        """Return the model's answer in words.

        Args:
            system: its instructions.
            messages: who (`user` or `assistant`) said what, oldest first.
            seed: of its dice, where the protocol has one.
            max_tokens: most that it may write.

        Raises:
            PlannerError: no answer, none of the protocol, or a cap is reached.
        """
        ...

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
        """Return the model's answer where it may call tools; see `complete`.

        Args:
            system: its instructions.
            messages: who said what.
            tools: what it may call.
            seed: of its dice.
            max_tokens: most that it may write.
            schema: JSON schema that its server holds the answer to; None: it writes as it likes.
        """
        ...


def held(
    speaks: Callable[[ModelEndpoint, Meter], ModelClient],
) -> Callable[[ModelEndpoint, Meter], ModelClient]:
    """Return what makes the same client, and separates a wrong option from a server that fails.

    What it makes raises `PlannerError`: with the code `usage` where an option is wrong, and as the
    client says it otherwise.

    Args:
        speaks: the protocol's client.
    """

    def made(reach: ModelEndpoint, meter: Meter) -> ModelClient:
        try:
            return speaks(reach, meter)
        except PlannerError as error:
            if error.where not in _OPTIONS:
                raise
            raise PlannerError(error.message, code="usage", where=error.where) from error

    return made


def make_client(spec: str) -> ModelClient:
    """Return the client of a live planner, for every other use of a model.

    Args:
        spec: as `--planner` takes it (`haiku`, `openai:model=...,base_url=...`); `;` may stand for
            `,` where the specification is itself an option's value.

    Raises:
        UnknownNameError: no planner is called so, or it has no such option.
        ValueError: the planner is no live model, or an option has a value that it cannot have.
        PlannerError: a key or a package is missing.
    """
    from missionpair import planners, registry

    made = registry.make(planners, spec.replace(";", ","))
    client: ModelClient | None = getattr(made, "client", None)
    if client is None:
        raise ValueError(f"`{spec.partition(':')[0]}` is no live model and answers no questions")
    return client
