# SPDX-License-Identifier: Apache-2.0
"""The wiring: which part stands behind which port. Nothing is decided here.

Everything else receives its parts; this module alone knows them all.
Spec page: docs/explanation/architecture.md
"""

from __future__ import annotations

import os
from collections.abc import Callable
from hashlib import sha256

from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.anchoring.anchor import CounterReading, StoreAnchor, read_counter
from authguard_r.anchoring.checkpoint_scheduler import CheckpointPolicy, CheckpointScheduler
from authguard_r.anchoring.counter import Counter
from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.sealer import Sealer, sealer_of
from authguard_r.audit.record import Terminal, read_record
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import EnvironmentFault, MalformedError, StoreError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier, RobotId
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.ports import Clock, Controller, SafetyGate, StateSource, Store
from authguard_r.core.principals import Signer
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import LeaseMonitor, quietly
from authguard_r.enforcement.management import Management
from authguard_r.enforcement.management.lists import Lists
from authguard_r.keys.clock_floor import boot_ms, chain_ms
from authguard_r.keys.trust import Trust
from authguard_r.site.model import Site, facts_of
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.store.transactions import Ledger, last_commit_ms
from authguard_r.wire.gate_limits import LIMITS


class Gate(Struct, frozen=True, kw_only=True):
    """One robot's gate, whole: what a process or a test holds.

    Args:
        enforcer: the path to the controller.
        management: the operator's side.
        ledger: store and trusted time.
        facts: the site and who this gate is.
        safety: the second gate, for what-ifs too.
        watch: holds the controller; for the emergency path.
        trust: who may say what.
        lists: the revocation lists in force.
        anchor: whether the store is the one that was counted outside of it.
    """

    enforcer: Enforcer
    management: Management
    lists: Lists
    anchor: StoreAnchor
    ledger: Ledger
    facts: SiteFacts
    safety: SafetyGate
    watch: LeaseMonitor
    trust: Trust

    def ended(self) -> bool:
        """Write every refusal that waits or was only counted; False: some are lost."""
        return quietly(lambda: self.ledger.flush(everything=True)) is not None

    def close(self) -> None:
        """Write the log's size to the outside counter a last time, and close the store."""
        self.ended()
        self.anchor.end()
        self.ledger.close()


class LogSettings(Struct, frozen=True, kw_only=True):
    """How a gate writes its log, and what its first record says.

    Args:
        genesis: fields that the first record has beside the gate's own.
        sealed: values that lie beside the first record for a replay, by name.
        marks: fields that every record has: that it is of a shadow run.
        refusals: which refusals wait and which are only counted.
        checkpoints: when checkpoints are made, and who witnesses them.
        sealing: what of the log is sealed; None: as the store's last gate sealed it.
        counter: the counter outside of the store; without one, a store that was put back cannot
            be detected.
        signer: the gate's own key, for counter and checkpoints; None: neither is signed.
        salts: returns random bytes for commitments.
    """

    genesis: dict[str, object] = {}
    sealed: dict[str, object] = {}
    marks: dict[str, str] = {}
    refusals: RefusalPolicy = RefusalPolicy()
    checkpoints: CheckpointPolicy = CheckpointPolicy()
    sealing: SealingPolicy | None = None
    counter: Counter | None = None
    signer: Signer | None = None
    salts: Callable[[int], bytes] = os.urandom


class GateStore(Struct, frozen=True, kw_only=True):
    """A gate's open store: whose it is, and what may enter it.

    Args:
        ledger: store and trusted time.
        anchor: whether the store is the one that was counted outside of it.
        inputs: verifies what enters.
        facts: the site and who this gate is.
        trust: the trust root.
        chain: the gate's own certificate chain.
        sealing: what of the log is sealed.
    """

    ledger: Ledger
    anchor: StoreAnchor
    inputs: InputVerifier
    facts: SiteFacts
    trust: Trust
    chain: tuple[bytes, ...]
    sealing: SealingPolicy


def open_gate_store(
    store: Store,
    *,
    trust: Trust,
    chain: tuple[bytes, ...],
    site: Site,
    source: StateSource,
    clock: Clock,
    log: LogSettings,
    demo: bool = False,
    risk: tuple[RiskPolicy, ...] = (),
) -> GateStore:
    """Return a gate's store, open for this gate alone; it is closed if anything is wrong.

    Args:
        store: registry and log.
        trust: the trust root.
        chain: the gate's own certificate chain: its robot id and profile come from here alone.
        site: the site model; missions bind its digest.
        source: the estimator's channel.
        clock: the only source of time.
        log: how the log is written.
        demo: accept a root that says `demo`; a gate of a real robot does not.
        risk: the organization's policies, to be held against the store (`hold_policy`).

    Raises:
        AuthenticityError: the gate's certificate does not hold.
        EnvironmentFault: the site does not know this robot.
        StoreError: the store cannot be used.
    """
    try:
        _require_real(trust, demo=demo)
        reading = read_counter(log.counter, verifier=trust)
        since_ms = max(chain_ms(chain), reading.time_ms)
        at = boot_ms(clock.wall_ms(), trust, since_ms, store.run(last_commit_ms))
        rid, profile = trust.gate_identity(chain, Now(at, 0))
        facts = replace(facts_of(site, rid=rid, profile=profile), risk=risk)
        sealer, sealing = sealer_of(store, rid, log.sealing)
        first = {**_first(facts, trust), **log.genesis}
        written = replace(log, genesis=first, sealed={"site": site, **log.sealed})
        ledger = _ledger(store, clock, rid, written, since_ms=since_ms, sealer=sealer)
        _require_same_log(ledger, trust, log.marks)
        anchor = _anchor(ledger, log, reading)
    except BaseException:
        store.close()  # it was handed over; a gate that is not made holds nothing
        raise
    inputs = InputVerifier(ledger, trust, source=source, facts=facts, anchor=anchor)
    return GateStore(
        ledger=ledger,
        anchor=anchor,
        inputs=inputs,
        facts=facts,
        trust=trust,
        chain=chain,
        sealing=sealing,
    )


def join(
    opened: GateStore,
    *,
    safety: SafetyGate,
    controller: Controller,
    clock: Clock,
    stand_within_ms: int = LIMITS.stand_within_ms,
    recovers: bool = True,
) -> Gate:
    """Return the gate of a store and a robot.

    Args:
        opened: the gate's store.
        safety: the second gate.
        controller: the actuators.
        clock: the only source of time.
        stand_within_ms: how long a stopped robot may take to stand.
        recovers: settle what the last run left open before the first proposal; False: the caller
            settles it.

    Raises:
        AuthenticityError: a revocation list that the store holds revokes the gate itself.
        StoreError: what the store holds cannot be used.
    """
    ledger, inputs, facts = opened.ledger, opened.inputs, opened.facts
    watch = LeaseMonitor(
        ledger, inputs, facts=facts, controller=controller, stand_within_ms=stand_within_ms
    )
    management = Management(
        ledger, inputs, verifier=opened.trust, facts=facts, sealing=opened.sealing
    )
    enforcer = Enforcer(
        ledger,
        inputs,
        facts=facts,
        safety=safety,
        watch=watch,
        clock=clock,
        first=management.recover if recovers else None,
    )
    opened.anchor.begin()
    return Gate(
        enforcer=enforcer,
        management=management,
        lists=_lists(ledger, enforcer, opened.trust, chain=opened.chain),
        anchor=opened.anchor,
        ledger=ledger,
        facts=facts,
        safety=safety,
        watch=watch,
        trust=opened.trust,
    )


def assemble(
    *,
    trust: Trust,
    chain: tuple[bytes, ...],
    site: Site,
    safety: SafetyGate,
    controller: Controller,
    source: StateSource,
    clock: Clock,
    store: Store,
    log: LogSettings = LogSettings(),  # noqa: B008 - frozen
    demo: bool = False,
    risk: tuple[RiskPolicy, ...] = (),
    stand_within_ms: int = LIMITS.stand_within_ms,
) -> Gate:
    """Return the gate made of these parts, for a program that is the gate's only client.

    Args: as in `open_gate_store` and `join`.
    """
    opened = open_gate_store(
        store,
        trust=trust,
        chain=chain,
        site=site,
        source=source,
        clock=clock,
        log=log,
        demo=demo,
        risk=risk,
    )
    return join(
        opened, safety=safety, controller=controller, clock=clock, stand_within_ms=stand_within_ms
    )


def _ledger(
    store: Store,
    clock: Clock,
    rid: RobotId,
    log: LogSettings,
    *,
    since_ms: int,
    sealer: Sealer | None,
) -> Ledger:
    return Ledger(
        store,
        clock,
        robot=rid,
        salts=log.salts,
        genesis=log.genesis,
        inputs=log.sealed,
        refusals=log.refusals,
        marks=log.marks,
        since_ms=since_ms,
        sealer=sealer,
    )


def _anchor(ledger: Ledger, log: LogSettings, reading: CounterReading) -> StoreAnchor:
    """Return the store's anchor; the key signs the counter's notes where there is a counter."""
    keeps = CheckpointScheduler(
        ledger, robot=ledger.robot, signer=log.signer, policy=log.checkpoints
    )
    return StoreAnchor(
        ledger,
        robot=ledger.robot,
        counter=log.counter,
        signer=None if log.counter is None else log.signer,
        reading=reading,
        scheduler=keeps,
    )


def _lists(ledger: Ledger, enforcer: Enforcer, trust: Trust, *, chain: tuple[bytes, ...]) -> Lists:
    """Return the lists, the newest of folder and store in force; the gate has to hold under them.

    Raises:
        AuthenticityError: a list that the store holds revokes the gate itself.
        StoreError: what the store holds is no list.
    """

    def identified() -> None:
        trust.gate_identity(chain, ledger.now())

    def dismissed() -> None:
        """Release nothing more: a list revoked the gate itself."""
        enforcer.require(identified)
        enforcer.stop(by=Identifier("gate"), is_planner=False)

    lists = Lists(ledger, enforcer.inputs, trust, chain=chain, dismissed=dismissed)
    try:
        if lists.begin():
            trust.gate_identity(chain, Now(ledger.last_ms(), 0))
    except BaseException:
        ledger.store.close()
        raise
    return lists


def _first(facts: SiteFacts, trust: Trust) -> dict[str, object]:
    """Return what the log's first record says of the gate that began it."""
    place = {"site": facts.digest, "profile": facts.robot.profile}
    return {**place, "demo": trust.demo, "root": root_digest(trust)}


def root_digest(trust: Trust) -> str:
    """Return the SHA-256 of the root certificate: whose log this is."""
    return b64(sha256(trust.root.public_bytes(Encoding.DER)).digest())


def _require_same_log(ledger: Ledger, trust: Trust, marks: dict[str, str]) -> None:
    """Refuse a store whose log began under another root, or in another mode.

    A shadow run assumes that what it would have released succeeded: none of that may count when
    something is enforced.
    """
    rows = ledger.peek(lambda turn: turn.rows(0, 1))
    try:
        began = read_record(rows[0][1] if rows else b"", where="record 0").open
    except MalformedError as error:
        raise StoreError(error.message, where="record 0", reason=Reason.STORE_CORRUPT) from error
    if began.get("root", root_digest(trust)) != root_digest(trust):
        raise StoreError(
            "the store's log began under another trust root; this one needs a store of its own",
            where="store",
            reason=Reason.ROBOT_MISMATCH,
        )
    if began.get("mode", "enforce") != marks.get("mode", "enforce"):
        raise StoreError(
            f"the store's log began in mode `{began.get('mode', 'enforce')}`; "
            "each mode needs a store of its own",
            where="store",
            reason=Reason.STORE_UNAVAILABLE,
        )


def _require_real(trust: Trust, *, demo: bool) -> None:
    """Refuse a root that says it is for demonstration, unless this is one."""
    if trust.demo and not demo:
        raise EnvironmentFault(
            "the root is for demonstration only: every private key lies in its folder",
            reason=Reason.CERTIFICATE_INVALID,
            where="root",
        )


def sign_terminal(gate: Gate, signer: Signer) -> bytes:
    """Return the signed terminal digest of the log as it is now: its anchor, if kept elsewhere."""
    size, head = gate.ledger.run(lambda act: act.head())
    log, time_ms = gate.facts.robot.rid, gate.ledger.now().utc_ms
    terminal = Terminal(log=log, size=size, head=Digest(b64(head)), time_ms=time_ms)
    return sign_object(terminal, Tag.CHECKPOINT, signer)
