# SPDX-License-Identifier: Apache-2.0
"""What operators and auditors may read of a running gate; nothing here changes anything.

Spec page: docs/spec/gate-protocol.md#reading
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from authguard_r.access.gate_config import GateConfig
from authguard_r.anchoring.growth import counted
from authguard_r.audit.record import read_record, read_sealed
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest, VariableId
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Turn
from authguard_r.enforcement.json_views import report_json
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import Report
from authguard_r.server.active_mission import ActiveMission
from authguard_r.server.explanation import explanation, is_refused_proposal, no_record
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.liveness import Liveness
from authguard_r.server.wiring import Gate
from authguard_r.store.transactions import stop_stands
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole

#: What an estimator says that the robot holds.
_HOLDING = VariableId("holding")


class GateQueries:
    """What may be read.

    Args:
        gate: ledger and facts.
        config: mode and bounds.
        leases: open leases.
        mission: the active mission.
        liveness: who was heard of, and the alerts.
        clients: who is connected.
        free_bytes: returns what the store's disk has left; None where there is no disk.
        stop_process_alive: returns whether the stop process answers; None where there is none.
        emergency: returns what `status` shows of emergencies; None without a signed policy.
        simulated: the gate's clock is that of a simulated robot, which runs ahead while it moves.
    """

    def __init__(
        self,
        gate: Gate,
        config: GateConfig,
        *,
        leases: LeaseRegistry,
        mission: ActiveMission,
        liveness: Liveness,
        clients: Callable[[], Iterable[ServedClient]],
        free_bytes: Callable[[], int] | None,
        stop_process_alive: Callable[[], bool] | None,
        emergency: Callable[[], dict[str, Any]] | None,
        simulated: bool,
    ) -> None:
        self._gate = gate
        self._config = config
        self._leases = leases
        self.mission = mission
        self._liveness = liveness
        self._clients = clients
        self._since_ms = gate.ledger.mono_ms()
        self.counted: Counter[str] = Counter()
        self.stops = 0
        self._refused: tuple[int, Report] | None = None
        self._free_bytes = free_bytes
        self._estop_alive = stop_process_alive
        self._emergency = emergency
        self._simulated = simulated

    @property
    def uptime_ms(self) -> int:
        """How long the gate has served."""
        return self._gate.ledger.mono_ms() - self._since_ms

    def ledger_state(self) -> dict[str, bool]:
        """Return what is the matter with clock and store (`Liveness.check`)."""
        ledger = self._gate.ledger
        return {
            "in_time": quietly(ledger.now) is not None,
            "only_counts": ledger.refusals.only_counts,
            "has_store": ledger.store.is_here(),
        }

    def count_decision(self, report: Report) -> None:
        """Count a decision, or a plan that could not be read, and remember the last refusal."""
        judged = report.judged
        verdict = "reject" if judged is None else str(judged.decision.verdict)
        unsafe = judged is not None and judged.safety is not None and not judged.safety.safe
        if unsafe or verdict == "reject":
            self._refused = (self._gate.ledger.mono_ms(), report)
        self.counted[f"decision.{verdict}"] += 1
        self.mission.changed()

    def count_outcome(self, report: Report) -> None:
        """Count how something that was released ended."""
        self.counted[f"outcome.{report.outcome}"] += 1
        self.mission.changed()

    def status(self) -> dict[str, Any]:
        """Return what `authguard status` shows."""
        ledger, now_ms = self._gate.ledger, self._gate.ledger.mono_ms()
        size, head = ledger.peek(lambda turn: turn.head())
        simulated = quietly(ledger.now) if self._simulated else None
        return {
            "robot": self._config.robot,
            "mode": str(self._config.mode),
            "uptime_ms": self.uptime_ms,
            "simulated_ms": None if simulated is None else simulated.utc_ms,
            "mission": self.mission.shown(),
            **self._robot(now_ms),
            "last_refusal": self._refusal(now_ms),
            "issued": self.mission.issued,
            "damaged": self.mission.damaged,
            "leases": [
                {
                    "ticket": lease.ticket,
                    "action": lease.action,
                    "for_ms": now_ms - lease.since_ms,
                    "left_ms": lease.until_ms - now_ms,
                }
                for lease in self._leases.leases()
            ],
            "clients": [
                {
                    "role": str(client.role),
                    "client": client.name,
                    "uid": client.uid,
                    "idle_ms": now_ms - client.heard_ms,
                }
                for client in self._clients()
            ],
            "heard": self._liveness.ages(),
            "stops": self.stops,
            "stop_stands": ledger.peek(stop_stands),
            "emergency": None if self._emergency is None else self._emergency(),
            "alerts": list(self._liveness.alerts),
            "log": {"size": size, "head": b64(head), "mission": ledger.peek(_written)},
            "refusals": {"shed": self.counted["shed"], "requests": self.counted["refused"]},
            "disk": self._disk(),
            "lane": None if self._estop_alive is None else {"alive": self._estop_alive()},
            "anchor": self._gate.anchor.shown(),
        }

    def metrics(self) -> dict[str, Any]:
        """Return counters and gauges; none of them holds the contents of a mission."""
        decisions, outcomes = self._with("decision."), self._with("outcome.")
        disk = self._disk()
        roles = Counter(str(client.role) for client in self._clients())
        return {
            "decisions_total": decisions,
            "outcomes_total": outcomes,
            "shed_total": self.counted["shed"],
            "refused_requests_total": self.counted["refused"],
            "stops_total": self.stops,
            "open_leases": len(self._leases),
            "clients": dict(roles),
            "controller_connected": int(roles[str(ClientRole.CONTROLLER)] > 0),
            "heard_age_seconds": {
                name.removesuffix("_ms"): age_ms / 1_000
                for name, age_ms in self._liveness.ages().items()
                if age_ms is not None
            },
            "mission_active": int(self.mission.runs),
            "log_records": self._gate.ledger.peek(lambda turn: turn.head())[0],
            "uptime_seconds": self.uptime_ms // 1_000,
            **({} if disk is None else {f"disk_{name}": n for name, n in disk.items()}),
            **({} if self._estop_alive is None else {"lane_alive": int(self._estop_alive())}),
        }

    def records(self, first: int, count: int) -> list[dict[str, Any]]:
        """Return a page of the log: each record with the values beside it, as they lie there."""
        told: list[dict[str, Any]] = []
        size = 0
        for seq, record, sealed, link in self._gate.ledger.peek(
            lambda turn: turn.rows(first, count)
        ):
            size += len(record) + len(sealed)
            if told and size > LIMITS.page_bytes:
                break
            told.append(
                {
                    "seq": seq,
                    "record": msgspec.Raw(record),
                    "sealed": msgspec.Raw(sealed),
                    "link": b64(link),
                }
            )
        return told

    def explain(self, seq: int | None) -> dict[str, Any]:
        """Return one record in words; without a number, the planner's last refused proposal.

        Sealed fields stay closed: the client may have no key to them.

        Raises:
            RefusedError: there is no such record.
            MalformedError: the record is damaged.
        """
        wanted = self._last_refusal() if seq is None else seq
        rows = () if wanted is None else self._gate.ledger.peek(lambda turn: turn.rows(wanted, 1))
        if not rows:
            raise no_record(seq)
        number, written, beside, _ = rows[0]
        where = f"record {number}"
        record = read_record(written, where=where)
        values = read_sealed(beside, where=where)
        digest = record.open.get("mission")
        # where a log is sealed, a change would tell what the mission's token holds
        closed = digest is None or self._gate.ledger.sealer is not None
        mission = None if closed else self._mission_of(Digest(str(digest)))
        return explanation(number, record, values, mission=mission)

    def _last_refusal(self) -> int | None:
        """Return the number of the last refused proposal in the log, with those that waited."""
        self._gate.ledger.flush()
        size = self._gate.ledger.peek(lambda turn: turn.head())[0]
        rows = self._gate.ledger.peek(
            lambda turn: turn.rows(max(0, size - LIMITS.searched_records), LIMITS.searched_records)
        )
        for seq, record, _, _ in reversed(rows):
            if is_refused_proposal(read_record(record, where=f"record {seq}")):
                return seq
        return None

    def _mission_of(self, digest: Digest) -> Mission | None:
        try:
            return self._gate.ledger.run(
                lambda act: self._gate.enforcer.inputs.mission(act, digest).mission
            )
        except AuthGuardError:
            return None  # revoked since, or gone: the record is explained without a change

    def _robot(self, now_ms: int) -> dict[str, Any]:
        """Return where the robot is, what it holds, and how long ago the estimator said so."""
        state = self._gate.enforcer.inputs.newest
        if state is None:
            return {"place": None, "holding": None, "state_age_ms": None}
        held = state.snapshot.readings.get(_HOLDING)
        return {
            "place": sorted(state.place),
            "holding": None if held is None else held.value,
            "state_age_ms": now_ms - state.arrived_mono_ms,
        }

    def _refusal(self, now_ms: int) -> dict[str, Any] | None:
        """Return the last refused proposal since the start, and the number of its record."""
        if self._refused is None:
            return None
        at_ms, report = self._refused
        return {"record": report.seq, "ago_ms": now_ms - at_ms, **report_json(report)}

    def _disk(self) -> dict[str, int] | None:
        """Return what the store's disk has left, and what is kept back of it; None: unknown."""
        if self._free_bytes is None:
            return None
        try:
            free = self._free_bytes()
        except OSError:
            return None
        return {"free_bytes": free, "reserve_bytes": self._config.reserve_bytes}

    def _with(self, prefix: str) -> dict[str, int]:
        return {
            name.removeprefix(prefix): count
            for name, count in self.counted.items()
            if name.startswith(prefix)
        }


def _written(turn: Turn) -> dict[str, int] | None:
    """Return what the active mission has written to the log, None without one."""
    mid = turn.get("active", "mission")
    if not mid:
        return None
    found = counted(turn, mid.decode("ascii", "replace"))
    return {**msgspec.to_builtins(found.growth), "counted": found.upto}
