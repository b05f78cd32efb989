# SPDX-License-Identifier: Apache-2.0
"""The published repairs: the gate offers exactly these, and the oracle calls each of them safe.

Source: docs/spec/safety.md#repair
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

import authguard_reference.safety as oracle_safety
from authguard_r.core.action import Action
from authguard_r.core.quantities import Now
from authguard_r.safety import SafetyConfig, gate_of
from authguard_r.safety.repair import is_narrower
from fixtures.cases import case
from fixtures.vectors import attested, facts_from, load, named

Json = dict[str, Any]
REPAIR = load("repair.json")


def test_the_safety_gate_finds_the_published_hazards_and_offers_the_published_repair() -> None:
    facts = facts_from(REPAIR["facts"])
    for vector in REPAIR["vectors"]:
        with case(named(vector)):
            configuration = REPAIR["configurations"][vector["configuration"]]
            decision = (
                gate_of(msgspec.convert(configuration, SafetyConfig))
                .recall(b"")
                .assess(
                    msgspec.convert(vector["action"], Action),
                    attested(REPAIR["states"][vector["state"]], facts),
                    facts,
                    msgspec.convert(REPAIR["now"], Now),
                )
            )
            repair = decision.repair
            found = {
                "hazards": [str(finding.hazard) for finding in decision.findings],
                "repair": None if repair is None else json.loads(msgspec.json.encode(repair)),
            }
            assert found == vector["expect"]
            assert decision.safe is not bool(found["hazards"])


def test_the_enforcer_takes_every_published_repair_for_a_narrower_action() -> None:
    for vector in REPAIR["vectors"]:
        if vector["expect"]["repair"] is not None:
            with case(named(vector)):
                repair = msgspec.convert(vector["expect"]["repair"], Action)
                assert is_narrower(repair, msgspec.convert(vector["action"], Action))


def test_the_oracle_finds_the_published_hazards_and_none_in_a_repair() -> None:
    for vector in REPAIR["vectors"]:
        with case(named(vector)):
            configuration = REPAIR["configurations"][vector["configuration"]]
            where = REPAIR["states"][vector["state"]], REPAIR["facts"], REPAIR["now"]
            found = oracle_safety.hazards(configuration, vector["action"], *where)
            envelope = [one for one in vector["expect"]["hazards"] if one != "RULE"]
            assert sorted(found) == sorted(envelope)
            repair = vector["expect"]["repair"]
            assert repair is None or oracle_safety.hazards(configuration, repair, *where) == []
