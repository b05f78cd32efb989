# SPDX-License-Identifier: Apache-2.0
"""The one scene that everything is measured in, built by the tests' own builder.

The courier stands in the pharmacy with package P1 in its gripper; its planner says where to go.
In the accepted reply that is station 101, in the hijacked one station 103.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import msgspec

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "tests"))

from authguard_r.core.action import Action, ActionMeta  # noqa: E402
from authguard_r.core.decide import decide  # noqa: E402
from authguard_r.core.decision import Decision  # noqa: E402
from authguard_r.core.encoding import Tag, b64, digest_of  # noqa: E402
from authguard_r.core.facts import SiteFacts  # noqa: E402
from authguard_r.core.identifiers import Digest, MissionId  # noqa: E402
from authguard_r.core.lease import Lease  # noqa: E402
from authguard_r.core.ports import Store  # noqa: E402
from authguard_r.core.provenance import Label  # noqa: E402
from authguard_r.core.quantities import Now, to_timestamp  # noqa: E402
from authguard_r.core.standing import Outcome, Spend, Standing, Use  # noqa: E402
from authguard_r.core.state import AttestedState  # noqa: E402
from authguard_r.core.token import VerifiedMission, sign_object  # noqa: E402
from authguard_r.keys.signer import folder_signer, gate_name  # noqa: E402
from authguard_r.keys.trust import read_trust  # noqa: E402
from authguard_r.normalize import Binder, Step, read_plan  # noqa: E402
from authguard_r.provenance.context import ContextLedger  # noqa: E402
from authguard_r.provenance.labels import label_fields  # noqa: E402
from authguard_r.safety import EnvelopeGate, default_config, safety_digest  # noqa: E402
from authguard_r.server.wiring import Gate, LogSettings, assemble  # noqa: E402
from authguard_r.sim.robot import snapshot_of  # noqa: E402
from fixtures import gate_process, scenarios  # noqa: E402, F401 - the tests' fixtures

PLANNER = "planner"
GRANT = "go-to-101"
#: Far more than any run needs; the shipped mission allows one delivery.
PLENTY = 1_000_000
#: Between two actions: long enough for the shipped rate of ten in ten seconds.
PAUSE_MS = 1_100
GOAL, HIJACKED = "Station 101", "Station 103"
_BARE = ROOT / "examples" / "hospital" / "replies" / "deliver.bare.json"


def reply(goal: str = GOAL, *, length: int = 1) -> bytes:
    """Return planner bytes: the shipped bare reply's first call, so many times."""
    call = json.loads(_BARE.read_text("utf-8"))["plan"][0]
    call["arguments"]["destination"] = goal
    return json.dumps({"plan": [call] * length}).encode()


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """Every input of a decision, held in memory."""

    verified: VerifiedMission
    standing: Standing
    state: AttestedState
    facts: SiteFacts
    now: Now
    binder: Binder

    def judge(self, data: bytes) -> tuple[Action, Decision, Digest]:
        """Normalize one call, decide it, and hash its canonical bytes: what the enforcer does."""
        plan = read_plan(data, binder=self.binder)
        action = self.completed(plan.steps[0].action, plan.evidence)
        return action, self.decide(action), digest_of(Tag.ACTION, action)

    def completed(self, action: Action, evidence: Digest) -> Action:
        """Return the action with source, labels and meta, as `Enforcer` completes it."""
        source = next(iter(self.state.place))
        action = msgspec.structs.replace(action, source=source)
        labels = label_fields(action, self.verified, self.standing, base=Label.MODEL)
        labels["source"] = Label.TRUSTED_SENSOR
        mission = self.verified.mission
        meta = ActionMeta(
            planner=PLANNER,
            timestamp=to_timestamp(self.now.utc_ms),
            evidence=evidence,
            mission=mission.mid,
            mission_version=mission.version,
        )
        return msgspec.structs.replace(action, provenance=labels, meta=meta)

    def decide(self, action: Action) -> Decision:
        """Return the gate's answer."""
        return decide(
            self.verified,
            action,
            state=self.state,
            facts=self.facts,
            now=self.now,
            standing=self.standing,
        )


def scene() -> Scene:
    """Return the shipped mission after its package was picked up."""
    verified = scenarios.verified()
    standing = msgspec.structs.replace(
        scenarios.active(verified),
        uses={
            "go-to-pharmacy": Use(starts=1, successes=1, last_success=1),
            "pick-p1": Use(starts=1, successes=1, last_success=2),
        },
        order=2,
        actions=2,
        spent=Spend(motion_ms=40_000),
        releases=(scenarios.NOW.mono_ms - 8_000, scenarios.NOW.mono_ms - 4_000),
    )
    return Scene(
        verified=verified,
        standing=standing,
        state=scenarios.state("pharmacy", "package-p1"),
        facts=scenarios.facts(),
        now=scenarios.NOW,
        binder=Binder(scenarios.site(), scenarios.binding()),
    )


def long_mission(mid: str) -> bytes:
    """Return a token of the shipped mission that lets its delivery be repeated for two days."""
    plain: dict[str, Any] = scenarios.draft(
        mission=mid,
        window={"for": "2 days"},
        budgets={
            "actions": PLENTY,
            "rate": {"count": 10, "per": "10 s"},
            "motion": "40000 h",
            "waiting": "0 s",
            "recorded_bytes": 0,
            "prompts": 5,
            "planner_stops": 3,
        },
    )
    for grant in plain["grants"]:
        if grant["id"] == GRANT:
            grant.update(repeat=PLENTY, starts=PLENTY, after=[])
    return scenarios.token(scenarios.mission(**plain))


class Machine:
    """Clock, estimator and controller of the durable runs; the world stands still.

    The clock is the real one, moved to the scene's day, with jumps between two actions. Every
    dispatch is noted and succeeds at once.
    """

    def __init__(self) -> None:
        self._utc_base = scenarios.START_MS - time.time_ns() // 1_000_000
        self._mono_base = time.monotonic_ns() // 1_000_000
        self._jumped_ms = 0
        self._seq = self._fence = 0
        self._world = scenarios.world("pharmacy", "package-p1")
        self._estimator = folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
        self._token: bytes | None = None
        self.dispatched_ns = 0
        self.dispatches = 0

    def wall_ms(self) -> int:
        return time.time_ns() // 1_000_000 + self._utc_base + self._jumped_ms

    def mono_ms(self) -> int:
        return time.monotonic_ns() // 1_000_000 - self._mono_base + self._jumped_ms

    def pause(self, duration_ms: int) -> None:
        self._jumped_ms += duration_ms

    def look(self, pause_ms: int = PAUSE_MS) -> None:
        """Let time pass and sign a new snapshot."""
        self._jumped_ms += pause_ms
        self._seq += 1
        fenced = {"fence": self._fence, "pose_fence": self._fence}
        snapshot = snapshot_of(self._world, robot=scenarios.RID, epoch=1, seq=self._seq, **fenced)
        self._token = sign_object(snapshot, Tag.STATE, self._estimator)

    def latest(self) -> bytes | None:
        return self._token

    def fence(self, number: int) -> None:
        self._fence = number

    def dispatch(self, action: Action, lease: Lease) -> Machine:
        self.dispatched_ns = perf_counter_ns()
        self.dispatches += 1
        return self

    def stop(self) -> None:
        raise RuntimeError("nothing in a benchmark should stop the robot")

    def outcome(self) -> Outcome:
        return Outcome.SUCCEEDED

    def used(self) -> Spend:
        return Spend(motion_ms=1_000)


class Bench(msgspec.Struct, frozen=True):
    """A whole gate over a store, with the machine around it."""

    gate: Gate
    machine: Machine
    binder: Binder
    context: ContextLedger

    def steps(self, goal: str = GOAL, *, length: int = 1) -> tuple[tuple[Step, ...], Digest]:
        """Return the bound steps of a plan and the digest of its bytes."""
        plan = read_plan(reply(goal, length=length), binder=self.binder)
        return plan.steps, plan.evidence

    def propose(self, step: Step, evidence: Digest) -> Any:
        """Send one step down the whole road."""
        return self.gate.enforcer.propose(
            step, planner=PLANNER, evidence=evidence, context=self.context
        )

    def take_in(self) -> None:
        """Let time pass and have a new snapshot verified, before anything is timed."""
        self.machine.look()
        self.gate.enforcer.inputs.refresh()


def bench(store: Store, *, trust: Any = None) -> Bench:
    """Return a gate over the store, its machine and a binder; no mission is active yet."""
    machine, safety = Machine(), default_config(scenarios.site(), scenarios.RID)
    signer = folder_signer(scenarios.trust_folder(), gate_name(scenarios.RID))
    gate = assemble(
        trust=trust or read_trust(scenarios.trust_folder()),
        chain=signer.chain,
        site=scenarios.site(),
        safety=EnvelopeGate(safety),
        controller=machine,
        source=machine,
        clock=machine,
        store=store,
        # a replay makes the second gate's verdict again
        log=LogSettings(genesis={"safety": safety_digest(safety)}, sealed={"safety": safety}),
        demo=True,
    )
    binder = Binder(scenarios.site(), scenarios.binding())
    return Bench(gate, machine, binder, binder.context())


def command(bench_: Bench, mid: str, digest: Digest, verb: str) -> bytes:
    """Return an operator's signed command about a mission's first version."""
    from authguard_r.enforcement.signed_orders import Command, Verb

    order = Command(
        verb=Verb(verb),
        mid=MissionId(mid),
        version=1,
        mission=digest,
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=bench_.gate.ledger.now().utc_ms + 60_000,
        issued_ms=bench_.gate.ledger.now().utc_ms,
    )
    return sign_object(order, Tag.COMMAND, folder_signer(scenarios.trust_folder(), "operator-1"))
