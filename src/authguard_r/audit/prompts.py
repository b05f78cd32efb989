# SPDX-License-Identifier: Apache-2.0
"""How often a person was asked for each mission: the figure that says whether consent still means.

A person who is asked fifty times in five minutes clicks "allow all". A person is asked by a mission
or a template that wants a signature, by an approval request, and by a row that is theirs to choose.
Spec page: docs/spec/template.md#prompts
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

from msgspec import Struct

from authguard_r.audit.record import Record
from authguard_r.core.identifiers import MissionId
from authguard_r.core.standing import Standing


class Prompts(Struct, frozen=True, kw_only=True):
    """What one robot's log and registry say of its people's work.

    Args:
        missions: missions that were made active, every version of one counted once.
        signatures: mission versions and templates that people signed for them.
        requests: approval requests that were opened.
        choices: rows that were chosen by a signature.
    """

    missions: int
    signatures: int
    requests: int
    choices: int

    @property
    def asked(self) -> int:
        """How often a person was asked, for any reason."""
        return self.signatures + self.requests + self.choices

    @property
    def per_mission(self) -> Fraction:
        """How often for each mission; without any mission, for one that never was."""
        return Fraction(self.asked, max(1, self.missions))


def activated(records: Iterable[Record]) -> tuple[MissionId, ...]:
    """Return the names of the missions that a log says were made active, each once."""
    named = (r.link.mid for r in records if r.link.decision == "activate")
    return tuple(MissionId(mid) for mid in dict.fromkeys(named))


def count_prompts(
    records: Iterable[Record], standings: Mapping[MissionId, Standing | None]
) -> Prompts:
    """Return the figure of a log.

    Args:
        records: the whole log, verified or not.
        standings: the registry's entries of the missions in it (`activated`).
    """
    acts = [record for record in records if record.kind == "management"]
    verbs = [record.link.decision for record in acts]
    of_templates = sum(1 for r in acts if r.link.decision == "activate" and "template" in r.open)
    held = [standing for standing in standings.values() if standing is not None]
    return Prompts(
        missions=len(activated(acts)),
        signatures=verbs.count("activate") - of_templates + verbs.count("template"),
        requests=sum(standing.prompts for standing in held),
        choices=verbs.count("select"),
    )
