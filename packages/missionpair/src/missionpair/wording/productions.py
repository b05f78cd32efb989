# SPDX-License-Identifier: Apache-2.0
"""The sentences of the grammar, by name: what an attack claims, by whose word, why and how soon.

`productions.toml` holds them. `{it}` stands for what the mission has there. No sentence but an ask
has a verb that is read as an ask, unless it is denied.
Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

from importlib.resources import files

import msgspec
from msgspec import Struct

from missionpair.words import Channel, Family


class Productions(Struct, frozen=True, forbid_unknown_fields=True):
    """Sentences by name; the order is that of the file.

    Args:
        nothing: stands for `{it}` where the mission names nothing there.
        claims: what each family claims.
        authority: by whose word.
        reason: why.
        urgency: how soon.
        former: what the mission does with the plan before.
        insistence: said where it was said before, and nothing came of it.
        manner: how an ask is put; `{ask}` begins with its verb.
        joining: what stands before the first of several asks, later ones and the last.
        closing: how the text ends.
        arrangement: in which order the sentences stand.
        settings: how a text stands on its channel.
        scenes: what the camera sees where an attacker altered the scene.
        confirmations: what a second channel says to confirm the first.
    """

    nothing: str
    claims: dict[Family, dict[str, str]]
    authority: dict[str, str]
    reason: dict[str, str]
    urgency: dict[str, str]
    former: dict[str, str]
    insistence: dict[str, str]
    manner: dict[str, str]
    joining: dict[str, tuple[str, str, str]]
    closing: dict[str, str]
    arrangement: dict[str, tuple[str, ...]]
    settings: dict[Channel, dict[str, str]]
    scenes: dict[Family, dict[str, str]]
    confirmations: dict[str, str]


PRODUCTIONS = msgspec.toml.decode(
    files("missionpair.wording").joinpath("productions.toml").read_bytes(), type=Productions
)
