# SPDX-License-Identifier: Apache-2.0
"""Missions are handed in at a gate that runs, before they are needed; a crash loses none of them.

Source: section "Stateful Action Verification" (the registry R), docs/spec/standing.md#handing-in
"""

from __future__ import annotations

import json
import os
from typing import Any

import pytest

from authguard_r.access.gate_config import Peer
from authguard_r.cli import call
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthenticityError, AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, order, until

GO = b'navigate_to(destination="Pharmacy", speed=0.8)'


def second(gate: RunningGate, first: Mission) -> Mission:
    """Return the next version of a mission."""
    return gate.mission(version=2, supersedes=digest_of(Tag.MISSION, first))


def step(gate: RunningGate) -> dict[str, Any]:
    with gate.client(ClientRole.PLANNER, "planner") as planner:
        return planner.propose(GO, dialect="auto")["steps"][0]  # type: ignore[no-any-return]


def issued(gate: RunningGate) -> list[dict[str, Any]]:
    with gate.client(ClientRole.AUDITOR, "reads") as auditor:
        return auditor.status()["issued"]  # type: ignore[no-any-return]


def verbs(gate: RunningGate) -> list[tuple[str, Any]]:
    return [(r.decision, r.open.get("status")) for r in gate.records() if r.kind == "management"]


@pytest.mark.smoke
def test_a_mission_is_handed_in_survives_a_crash_and_is_activated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with RunningGate(simulate=True) as gate:
        first = gate.mission()
        token = gate.folder / "v1.token"
        token.write_bytes(gate.token(first))
        at = ("--trust", gate.trust, "--site", gate.site, "--store", gate.store)
        words = [str(word) for word in ("mission", "issue", token, *at, "--robot", gate.rid)]
        assert call([*words, "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert (said["status"], said["by_gate"]) == ("issued", True)
        refused = step(gate)
        assert (refused["outcome"], refused["reasons"]) == ("reject", ["MISSION_NOT_ACTIVE"])
        found = until(lambda: [r for r in gate.records() if r.kind == "refusal"], "the record")
        assert [r.reasons for r in found] == [["MISSION_NOT_ACTIVE"]]
        gate.kill9()
        gate.start_gate()
        assert issued(gate) == [
            {
                "mid": first.mid,
                "version": 1,
                "issuer": "operator-1",
                "not_before": first.not_before,
                "expiry": first.expiry,
            }
        ]
        assert call(["status", "--gate", str(gate.run)]) == 0
        assert f"issued: {first.mid} version 1, by operator-1" in capsys.readouterr().out
        assert gate.activate(token.read_bytes())["status"] == "active"
        assert issued(gate) == []
        assert step(gate)["outcome"] == "accept"
        assert verbs(gate) == [("issue", "issued"), ("activate", "active")]
        assert call(["audit", "replay", str(gate.store), "--trust", str(gate.trust)]) == 0
        assert call(["audit", "verify", str(gate.store)]) == 0


def test_an_update_is_handed_in_while_the_version_before_is_active() -> None:
    with RunningGate(simulate=True) as gate:
        first = gate.mission()
        gate.activate(gate.token(first))
        update = second(gate, first)
        with gate.client(ClientRole.OPERATOR, "handing") as operator:
            assert operator.issue(gate.token(update))["status"] == "issued"
            status = operator.status()
            assert (status["mission"]["version"], status["mission"]["status"]) == (1, "active")
            assert [(m["mid"], m["version"]) for m in status["issued"]] == [(first.mid, 2)]
        assert step(gate)["outcome"] == "accept"  # by the version that is active
        made = gate.activate(gate.token(update))
        assert (made["version"], made["status"], made["actions"]) == (2, "active", 1)


def test_what_is_issued_ends_by_an_order_at_the_gate_and_is_not_taken_in_again() -> None:
    with RunningGate(simulate=True) as gate:
        first = gate.mission()
        token = gate.token(first)
        with gate.client(ClientRole.OPERATOR, "handing") as operator:
            made = operator.issue(token)
            operator.command(order(gate, first, made["digest"], Verb.REVOKE))
            assert operator.status()["issued"] == []
            for act in (operator.issue, operator.activate):
                with pytest.raises(AuthGuardError, match="REVOKED"):
                    act(token)


def test_only_who_may_activate_may_hand_in() -> None:
    peers = (Peer(uid=os.geteuid(), roles=(ClientRole.AUDITOR, ClientRole.PLANNER)),)
    with RunningGate(simulate=True, peers=peers) as gate:
        for role in (ClientRole.AUDITOR, ClientRole.PLANNER):
            with gate.client(role, "handing") as client:
                for act in (client.issue, client.activate):
                    with pytest.raises(AuthenticityError, match="ROLE_DENIED"):
                        act(gate.token())
        assert verbs(gate) == []
