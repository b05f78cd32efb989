# SPDX-License-Identifier: Apache-2.0
"""What the reference oracle is told of a situation: plain JSON data, made once for many questions.

The oracle (`authguard_reference`) imports nothing of the gate, and knows no type of it.
"""

from __future__ import annotations

import json
from functools import cached_property
from typing import Any

import msgspec

import authguard_reference as oracle
from authguard_r.core.action import Action
from authguard_r.core.facts import SiteFacts
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.state import Snapshot
from authguard_r.safety import default_config
from missionpair.bench import Bench

Json = dict[str, Any]


class Reference:
    """The oracle with a mission, its site and its robot.

    Args:
        bench: whose plain data are kept, so that the next situation there has them.
        facts: the site, and whose gate it is.
        mission: the one in force.
        digest: of its signed bytes.
        usable_until_ms: when its issuer's certificate ends.
    """

    def __init__(
        self, bench: Bench, facts: SiteFacts, mission: Mission, digest: str, usable_until_ms: int
    ) -> None:
        self._bench, self._facts = bench, facts
        self.digest = digest
        self._until_ms = usable_until_ms
        self.mission: Json = plain(mission)
        self._grants: dict[str, Json] = {one["id"]: one for one in self.mission["actions"]}

    @cached_property
    def facts(self) -> Json:
        """The site and the robot, in the shape of the specification."""
        key = ("facts", self._facts.robot.rid)
        return self._bench.kept(key, lambda: plain_facts(self._facts))

    @cached_property
    def envelope(self) -> Json:
        """The safety configuration that the robot's profile gives."""
        rid = self._facts.robot.rid
        return self._bench.kept(
            ("envelope", rid), lambda: plain(default_config(self._bench.site, rid))
        )

    def decide(
        self,
        action: Json,
        *,
        state: Json,
        now: Now,
        standing: Json | None,
        approvals: list[Json],
    ) -> Json:
        """Return the oracle's decision on one action."""
        return oracle.decide(
            self.mission,
            digest=self.digest,
            usable_until_ms=self._until_ms,
            action=action,
            state=state,
            facts=self.facts,
            now=_clocks(now),
            standing=standing,
            approvals=approvals,
        )

    def hazards(self, action: Json, *, state: Json, now: Now) -> tuple[str, ...]:
        """Return the hazards of one action, each once; none when it is safe."""
        found = oracle.hazards(self.envelope, action, state, self.facts, _clocks(now))
        return tuple(dict.fromkeys(found))

    def done(
        self, standing: Json, grant: str, action: Json, *, now: Now, took_ms: int, recorded: int
    ) -> Json:
        """Return the registry's entry after an action of a grant was released and succeeded.

        Args:
            standing: the entry before.
            grant: the grant that the action was released under.
            action: what was done.
            now: when it began.
            took_ms: how long it took.
            recorded: bytes that it recorded.
        """
        kind, mission = self.facts["vocabulary"][action["type"]], self.mission
        most = self._grants[grant]["max_ms"]
        ticket = f"step-{standing.get('order', 0)}-{standing.get('actions', 0)}"
        released = oracle.release(
            standing,
            grant,
            ticket=ticket,
            spend=_spent(kind, most, action.get("params", {}).get("max_bytes", 0)),
            now=_clocks(now),
            per_ms=mission["budgets"].get("rate", {}).get("per_ms", 0),
        )
        used = _spent(kind, took_ms, recorded)
        settled = oracle.settle(released, mission, ticket=ticket, outcome="succeeded", used=used)
        return self._finished(settled, now.utc_ms + took_ms)

    def _finished(self, standing: Json, utc_ms: int) -> Json:
        """Return the entry with the mission over, or closing, when all of it is done."""
        events = oracle.TRANSITIONS[standing["status"]]
        closing = self.mission.get("closing")
        event = "complete" if closing is None else "begin_closing"
        if standing["status"] != "active" or not oracle.is_complete(standing, self.mission):
            return standing
        over = {**standing, "status": events[event]}
        return over if closing is None else {**over, "closes_ms": utc_ms + closing["for_ms"]}


def state_of(snapshot: Snapshot, now: Now) -> Json:
    """Return a snapshot that arrives just now."""
    return {"snapshot": plain(snapshot), "arrived_mono_ms": now.mono_ms}


def action_of(action: Action) -> Json:
    """Return an action without labels and meta: they are the gate's own notes, no authority."""
    shown: Json = plain(msgspec.structs.replace(action, provenance={}, meta=None))
    return shown


def plain(value: Any) -> Any:
    """Return a struct as plain JSON data, which is all that the oracle knows."""
    return json.loads(msgspec.json.encode(value))


def plain_facts(facts: SiteFacts) -> Json:
    """Return the site's facts in the shape of the specification."""
    shown: Json = plain(facts)
    shown["regions"] = {
        name: {**region["area"], "tags": region["tags"]}
        for name, region in shown["regions"].items()
    }
    return shown


def _clocks(now: Now) -> Json:
    return {"utc_ms": now.utc_ms, "mono_ms": now.mono_ms}


def _spent(kind: Json, took_ms: int, recorded: int) -> Json:
    return {
        "motion_ms": took_ms if kind.get("moves", False) else 0,
        "wait_ms": took_ms if kind.get("waits", False) else 0,
        "recorded_bytes": recorded if kind.get("records", False) else 0,
    }
