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
from authguard_r.core.errors import AuthGuardError, ClockError, StoreError
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Turn
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing, use_of
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.report import Report
from authguard_r.server.explanation import explanation, is_refused_proposal, no_record
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.liveness import Liveness, MissionPhase
from authguard_r.server.wiring import Gate
from authguard_r.store.issued_missions import damaged, issued
from authguard_r.store.transactions import Transaction, stop_stands
from authguard_r.wire.messages import ClientRole

#: Longest page of the log, in bytes of records.
_PAGE_BYTES = 1 << 21
#: Records that are looked through for the last refusal.
_LOOKED = 1_000


class GateQueries:
    """What may be read.

    Args:
        gate: ledger and facts.
        config: mode and bounds.
        motions: open leases.
        liveness: who was heard of, and the alerts; it asks this view which mission is active.
        clients: who is connected.
    """

    def __init__(
        self,
        gate: Gate,
        config: GateConfig,
        *,
        motions: LeaseRegistry,
        liveness: Liveness,
        clients: Callable[[], Iterable[ServedClient]],
    ) -> None:
        self._gate = gate
        self._config = config
        self._motions = motions
        self._liveness = liveness
        liveness.mission = self.phase
        self._clients = clients
        self._since_ms = gate.ledger.mono_ms()
        self._known: dict[str, Any] | None = None
        self._issued: list[dict[str, Any]] = []
        self._damaged: tuple[str, ...] = ()
        self._changed = True
        self.counted: Counter[str] = Counter()
        self.stops = 0
        #: What the store's disk has left; None where there is no disk.
        self.free_bytes: Callable[[], int] | None = None
        #: Whether the stop lane serves and answers; None where there is none.
        self.lane_alive: Callable[[], bool] | None = None
        #: What is told of emergencies; None where no policy was signed.
        self.emergency: Callable[[], dict[str, Any]] | None = None

    @property
    def uptime_ms(self) -> int:
        """How long the gate has served."""
        return self._gate.ledger.mono_ms() - self._since_ms

    @property
    def has_mission(self) -> bool:
        """True while a mission is active."""
        phase = self.phase()
        return phase is not None and phase.runs

    def phase(self) -> MissionPhase | None:
        """Return how the active mission stands; None once it has ended."""
        try:
            mission = self._active()
        except StoreError:  # a disk that is gone silences nobody's alerts
            mission = self._known
        if mission is None or mission["status"] in TERMINAL:
            return None
        return MissionPhase(mission["mid"], mission["version"], Status(mission["status"]))

    @property
    def mission_status(self) -> str | None:
        """How the active mission stands, None without one."""
        mission = self._active()
        return None if mission is None else str(mission["status"])

    def ledger_state(self) -> dict[str, bool]:
        """Return what is the matter with clock and store (`Liveness.check`)."""
        ledger = self._gate.ledger
        return {
            "in_time": quietly(ledger.now) is not None,
            "only_counts": ledger.refusals.only_counts,
            "has_store": ledger.store.is_here(),
        }

    def mission_changed(self) -> None:
        """Say that what is known of the active mission is old."""
        self._changed = True

    def count_decision(self, report: Report) -> None:
        """Count a decision, or a plan that could not be read."""
        verdict = "reject" if report.judged is None else str(report.judged.decision.verdict)
        self.counted[f"decision.{verdict}"] += 1
        self.mission_changed()

    def count_outcome(self, report: Report) -> None:
        """Count how something that was released ended."""
        self.counted[f"outcome.{report.outcome}"] += 1
        self.mission_changed()

    def status(self) -> dict[str, Any]:
        """Return what `authguard status` shows."""
        ledger, now_ms = self._gate.ledger, self._gate.ledger.mono_ms()
        size, head = ledger.peek(lambda turn: turn.head())
        return {
            "robot": self._config.robot,
            "mode": str(self._config.mode),
            "uptime_ms": self.uptime_ms,
            "mission": self._active(),
            "issued": self._issued,
            "damaged": self._damaged,
            "leases": [
                {
                    "ticket": lease.ticket,
                    "action": lease.action,
                    "for_ms": now_ms - lease.since_ms,
                    "left_ms": lease.until_ms - now_ms,
                }
                for lease in self._motions.leases()
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
            "emergency": None if self.emergency is None else self.emergency(),
            "alerts": list(self._liveness.alerts),
            "log": {"size": size, "head": b64(head), "mission": ledger.peek(_written)},
            "refusals": {"shed": self.counted["shed"], "requests": self.counted["refused"]},
            "disk": self._disk(),
            "lane": None if self.lane_alive is None else {"alive": self.lane_alive()},
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
            "open_leases": len(self._motions),
            "clients": dict(roles),
            "controller_connected": int(roles[str(ClientRole.CONTROLLER)] > 0),
            "heard_age_seconds": {
                name.removesuffix("_ms"): age_ms / 1_000
                for name, age_ms in self._liveness.ages().items()
                if age_ms is not None
            },
            "mission_active": int(self.has_mission),
            "log_records": self._gate.ledger.peek(lambda turn: turn.head())[0],
            "uptime_seconds": self.uptime_ms // 1_000,
            **({} if disk is None else {f"disk_{name}": n for name, n in disk.items()}),
            **({} if self.lane_alive is None else {"lane_alive": int(self.lane_alive())}),
        }

    def records(self, first: int, count: int) -> list[dict[str, Any]]:
        """Return a page of the log: each record with the values beside it, as they lie there."""
        told: list[dict[str, Any]] = []
        size = 0
        for seq, record, sealed, link in self._gate.ledger.peek(
            lambda turn: turn.rows(first, count)
        ):
            size += len(record) + len(sealed)
            if told and size > _PAGE_BYTES:
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

        Sealed fields stay closed: whoever asks may have no key to them.

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
        rows = self._gate.ledger.peek(lambda turn: turn.rows(max(0, size - _LOOKED), _LOOKED))
        for seq, record, _, _ in reversed(rows):
            if is_refused_proposal(read_record(record, where=f"record {seq}")):
                return seq
        return None

    def _active(self) -> dict[str, Any] | None:
        if self._changed:
            try:
                self._known = self._gate.ledger.run(self._mission)
            except (ClockError, StoreError) as error:  # behind, or moved away
                void = error.reason
                return self._gate.ledger.peek(lambda turn: self._as_held(turn, void))
            self._changed = False
        return self._known

    def _as_held(self, turn: Turn, void: Reason) -> dict[str, Any] | None:
        """Return the active mission as it is held: showing it needs no clock, verifying it does."""
        mid = turn.get("active", "mission")
        if not mid:
            return None
        standing = self._gate.ledger.standing(MissionId(mid.decode("ascii")))
        kept = None if standing is None else self._gate.enforcer.intake.kept(standing.digest)
        if standing is None or kept is None:  # of a gate before this one
            return self._known
        return _shown(standing, kept.mission, void=void)

    def _mission_of(self, digest: Digest) -> Mission | None:
        try:
            return self._gate.ledger.run(
                lambda act: self._gate.enforcer.intake.mission(act, digest).mission
            )
        except AuthGuardError:
            return None  # revoked since, or gone: the record is explained without a change

    def _mission(self, act: Transaction) -> dict[str, Any] | None:
        intake = self._gate.enforcer.intake
        self._issued = [_shown_issued(act, intake, one) for one in issued(act)]
        self._damaged = damaged(act)
        mid = act.active()
        standing = None if mid is None else act.standing(mid)
        if standing is None:
            return None
        held = intake.held(act, standing.digest)
        return _shown(standing, held.mission, void=intake.lost(act, standing.digest))

    def _disk(self) -> dict[str, int] | None:
        """Return what the store's disk has left, and what is kept back of it; None: unknown."""
        if self.free_bytes is None:
            return None
        try:
            free = self.free_bytes()
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


def _shown_issued(act: Transaction, intake: InputVerifier, standing: Standing) -> dict[str, Any]:
    """Return what `status` says of an issued mission; a damaged token says nothing of itself."""
    try:
        mission = intake.held(act, standing.digest).mission
    except StoreError:
        mission = None
    return {
        "mid": standing.mid,
        "version": standing.version,
        "issuer": None if mission is None else mission.issuer,
        "not_before": None if mission is None else mission.not_before,
        "expiry": None if mission is None else mission.expiry,
    }


def _shown(standing: Standing, mission: Mission, *, void: Reason | None) -> dict[str, Any]:
    """Return what `status` says of a mission, and why it authorizes nothing whatever its status."""
    return {
        "mid": standing.mid,
        "version": standing.version,
        "status": str(standing.status),
        "void": None if void is None else str(void),
        "issuer": mission.issuer,
        "expiry": mission.expiry,
        "closes": to_timestamp(standing.closes_ms) if standing.closes_ms else None,
        "open": [release.ticket for release in standing.open],
        "requests": msgspec.to_builtins(standing.requests),
        "prompts": standing.prompts,
        "grants": [
            {
                "id": grant.id,
                "type": grant.type,
                "starts": use_of(standing, grant.id).starts,
                "of": grant.starts,
            }
            for grant in mission.actions
        ],
    }
