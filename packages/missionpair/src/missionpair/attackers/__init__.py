# SPDX-License-Identifier: Apache-2.0
"""Who writes the inputs that reach a planner: one file each, found by the file's name.

An attacker is given bytes that `missionpair.access` made for its access level, and nothing else: it
holds no gate, no pair and no key. Spec page: docs/spec/missionpair-access.md.
How-to: docs/howto/missionpair-attackers.md
"""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol, cast

from missionpair import registry
from missionpair.pair import Input


class AttackerError(Exception):
    """An attacker that cannot go on: its model is away, or what it was given is no case.

    Args:
        code: `unreachable`, `refused`, `protocol`, `limit` or `cost`, as a planner's.
        message: what happened, and what to do.
        where: the server or the option.
    """

    def __init__(self, message: str, *, code: str, where: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.where = where

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(AttackerError, code=self.code, where=self.where), (self.message,)


class Attacker(Protocol):
    """Who writes the inputs.

    One attacker is asked about one trial after the other: `open` begins a trial and forgets the
    one before, but for what it may have learned about wording.
    """

    #: What tables and logs call it.
    name: str
    #: A stand-in for something that was not run: marked wherever its results appear.
    simulated: bool
    #: Everything that shapes it, published in the log.
    parameters: dict[str, Any]

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:
        """Return the first inputs of a trial.

        Args:
            case: what it may know of the pair, as `access.case_bytes` has it.
            seed: of this trial's dice.

        Raises:
            AttackerError: it cannot.
        """
        ...

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:
        """Return the next inputs after a round that did not succeed; None gives up.

        Args:
            seen: what it may see of the round, as `access.seen_bytes` has it.
            seed: of this trial's dice.

        Raises:
            AttackerError: it cannot.
        """
        ...


def names() -> tuple[str, ...]:
    """Return what there is, by name."""
    from missionpair import attackers

    return registry.names(attackers)


def make(spec: str) -> Attacker:
    """Return the attacker that a specification names: `search:population=12`.

    Raises:
        UnknownNameError: no such attacker, or no such option of it; says which there are.
        ValueError: an option has a value that it cannot have.
    """
    from missionpair import attackers

    return cast("Attacker", registry.make(attackers, spec))
