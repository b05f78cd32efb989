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
from authguard_r.anchoring.sealing.sealer import sealer_of
from authguard_r.audit.record import Terminal, read_record
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import (
    EnvironmentFault,
    MalformedError,
    StoreError,
)
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.ports import Clock, Controller, SafetyGate, StateSource, Store
from authguard_r.core.principals import Signer
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.leases import STAND_WITHIN_MS, LeaseMonitor, quietly
from authguard_r.enforcement.management import Management
from authguard_r.enforcement.management.lists import Lists
from authguard_r.keys.clock_floor import boot_ms, chain_ms
from authguard_r.keys.trust import Trust
from authguard_r.site.model import Site, facts_of
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.store.transactions import Ledger, last_commit_ms


class Gate(Struct, frozen=True, kw_only=True):
    """One robot's gate, whole: what a process or a test holds.

    Args:
        enforcer: the road to the controller.
        management: the operator's side.
        ledger: store and trusted time.
        facts: the site and who this gate is.
        safety: the second gate, for what-ifs too.
        watch: holds the controller; for the emergency road.
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
        """Say a last time, outside, how far the log has come, and let go of the store."""
        self.ended()
        self.anchor.end()
        self.ledger.close()


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
    genesis: dict[str, object],
    demo: bool = False,
    salts: Callable[[int], bytes] = os.urandom,
    refusals: RefusalPolicy = RefusalPolicy(),  # noqa: B008 - frozen
    stand_within_ms: int = STAND_WITHIN_MS,
    marks: dict[str, str] | None = None,
    risk: tuple[RiskPolicy, ...] = (),
    counter: Counter | None = None,
    signer: Signer | None = None,
    notary: CheckpointPolicy = CheckpointPolicy(),  # noqa: B008 - frozen
    sealing: SealingPolicy | None = None,
    sealed: dict[str, object] | None = None,
) -> Gate:
    """Return the gate made of these parts.

    Args:
        trust: the trust root.
        chain: the gate's own certificate chain: its robot id and profile come from here alone.
        site: the site model; missions bind its digest.
        safety: the second gate.
        controller: the actuators.
        source: the estimator's channel.
        clock: the only source of time.
        store: registry and log.
        genesis: what else the log's first record says.
        demo: take a root that says `demo`; nothing that guards a real robot does.
        salts: randomness for commitments.
        refusals: what of refusals waits and what is counted.
        stand_within_ms: how long a stopped robot may take to stand.
        marks: what every record of the log says: that it is of a shadow run.
        risk: the organization's policies, to be held against the store (`hold_policy`).
        counter: kept outside of the store; without one, a store that was put back is not known.
        signer: the gate's own key, for counter and checkpoints; without one there are none.
        notary: when checkpoints are made, and who witnesses them.
        sealing: what of the log is sealed; None: as the store holds it of the last gate.
        sealed: what else the log's first record keeps for a replay, by name; None: nothing.

    Raises:
        AuthenticityError: the gate's certificate does not hold.
        EnvironmentFault: the site does not know this robot.
        StoreError: the store cannot be used.
    """
    try:
        _require_real(trust, demo=demo)
        reading = read_counter(counter, verifier=trust)
        since_ms = max(chain_ms(chain), reading.time_ms)
        at = boot_ms(clock.wall_ms(), trust, since_ms, store.run(last_commit_ms))
        rid, profile = trust.gate_identity(chain, Now(at, 0))
        facts = replace(facts_of(site, rid=rid, profile=profile), risk=risk)
        sealer, policy = sealer_of(store, rid, sealing)
        ledger = Ledger(
            store,
            clock,
            robot=rid,
            salts=salts,
            genesis={**_first(facts, trust), **genesis},
            inputs={"site": site, **(sealed or {})},
            refusals=refusals,
            marks=marks,
            since_ms=since_ms,
            sealer=sealer,
        )
        _require_same_log(ledger, trust, marks or {})
        keeps = CheckpointScheduler(ledger, robot=rid, signer=signer, policy=notary)
        anchor = _anchor(ledger, counter, signer=signer, reading=reading, keeps=keeps)
    except BaseException:
        store.close()  # it was handed over; a gate that is not made holds nothing
        raise
    intake = InputVerifier(ledger, trust, source=source, facts=facts, anchor=anchor)
    watch = LeaseMonitor(
        ledger, intake, facts=facts, controller=controller, stand_within_ms=stand_within_ms
    )
    enforcer = Enforcer(ledger, intake, facts=facts, safety=safety, watch=watch, clock=clock)
    management = Management(ledger, intake, verifier=trust, facts=facts, sealing=policy)
    anchor.begin()
    enforcer.before_first(management.recover)
    return Gate(
        enforcer=enforcer,
        management=management,
        lists=_lists(ledger, enforcer, trust, chain=chain),
        anchor=anchor,
        ledger=ledger,
        facts=facts,
        safety=safety,
        watch=watch,
        trust=trust,
    )


def _anchor(
    ledger: Ledger,
    counter: Counter | None,
    *,
    signer: Signer | None,
    reading: CounterReading,
    keeps: CheckpointScheduler,
) -> StoreAnchor:
    """Return the store's anchor; the key signs its counter's notes where there is one."""
    key, rid = None if counter is None else signer, ledger.robot
    return StoreAnchor(
        ledger, robot=rid, counter=counter, signer=key, reading=reading, notary=keeps
    )


def _lists(ledger: Ledger, enforcer: Enforcer, trust: Trust, *, chain: tuple[bytes, ...]) -> Lists:
    """Return the lists, the newest of folder and store in force; the gate has to hold under them.

    Raises:
        AuthenticityError: a list that the store holds revokes the gate itself.
        StoreError: what the store holds is no list.
    """

    def dismissed() -> None:
        """Release nothing more: a list revoked the gate itself."""
        enforcer.before_first(lambda: trust.gate_identity(chain, ledger.now()))
        enforcer.stop(by=Identifier("gate"), is_planner=False)

    lists = Lists(ledger, enforcer.intake, trust, chain=chain, dismissed=dismissed)
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
