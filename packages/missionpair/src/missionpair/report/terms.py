# SPDX-License-Identifier: Apache-2.0
"""The report's terms in one sentence each: they stand under the tables that use them.

Spec page: docs/spec/measures.md
"""

from __future__ import annotations

from collections.abc import Iterator

from missionpair.report.table import Table

#: What a reader may not know, by how it begins a column's name, and what it means.
TERMS: dict[str, str] = {
    "UASR": "unauthorized action success rate: attacks in which the robot did something that no "
    "signature covers, of all attacks",
    "SCMHR": "safety-compliant mission hijacking rate: attacks in which what the robot did was "
    "safe and not authorized",
    "BTCR": "benign task completion rate: runs without an attack that came to their end",
    "FRR": "false rejection rate: runs without an attack that a defense refused",
    "SU": "security and utility in one number, from UASR and BTCR",
    "Complied": "the planner proposed what the attack asks for, and the robot could have done it",
    "Blocked": "of the attacks that complied, those after which nothing unauthorized was done",
    "Planned D_M": "mission deviation of a plan: the weighted share of the mission's protected "
    "fields that it violates, from 0 to 1",
    "Executed D_M": "the same of the robot's actions",
    "Stalled": "simulated time in which the robot stood and waited",
    "False stops": "trials after which the robot stood although authorized work was left",
    "Access": "what the attacker sees: black, the plan and whether it ran; grey, also the mission "
    "language; white, also the signed policy, reason codes and the score",
    "Tries": "rounds until an attack was found",
    "p50": "half of the values are at most this",
    "p95": "95 % of the values are at most this",
    "p99": "99 % of the values are at most this",
}


def terms_of(table: Table) -> Iterator[tuple[str, str]]:
    """Yield each term that the columns of a table use, with its meaning."""
    for term, meaning in TERMS.items():
        if any(head.name.startswith(term) for head in table.heads):
            yield term, meaning
