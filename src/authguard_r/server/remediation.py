# SPDX-License-Identifier: Apache-2.0
"""What a person can do about a refusal, for every reason there is.

`remediation.toml` holds the texts. They are for readers of the log, never for the planner, and
decide nothing. "The refusal was right" is an answer too. Spec page: docs/reference/cli.md
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files

import msgspec
from msgspec import Struct

from authguard_r.core.reasons import Reason


class Remedy(Struct, frozen=True, forbid_unknown_fields=True):
    """What to do, and the reasons that it answers."""

    do: str
    reasons: tuple[Reason, ...]


class Remedies(Struct, frozen=True, forbid_unknown_fields=True):
    """Every remedy; of a refused emergency some others hold."""

    answers: tuple[Remedy, ...]
    emergency: tuple[Remedy, ...]


@cache
def remedies() -> Remedies:
    """Return every remedy, as the file says."""
    data = files("authguard_r.server").joinpath("remediation.toml").read_bytes()
    return msgspec.toml.decode(data, type=Remedies)


@cache
def remedy_of(*, emergency: bool = False) -> dict[Reason, str]:
    """Return what to do about each reason; of a refused emergency some others hold."""
    found = remedies()
    every = (*found.answers, *(found.emergency if emergency else ()))
    return {reason: remedy.do for remedy in every for reason in remedy.reasons}


def remedies_of(codes: Iterable[object], *, emergency: bool = False) -> list[str]:
    """Return what can be done about these reasons, each once; an unknown code is skipped.

    Args:
        codes: as a record holds them.
        emergency: it was an emergency that was refused.
    """
    known = {str(reason): do for reason, do in remedy_of(emergency=emergency).items()}
    return list(dict.fromkeys(known[str(code)] for code in codes if str(code) in known))
