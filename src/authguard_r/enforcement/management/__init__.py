# SPDX-License-Identifier: Apache-2.0
"""The acts that give, narrow, settle or end authority; each is one record.

Handing in and activation need the signed mission itself, or an instance of a signed template.
Everything else is a command signed by a person who may give it: narrowing (suspend, revoke,
withdraw) by the issuer or any safety officer, widening and settling (resume, resolve, complete) by
the issuer. Source: section "Mission Compilation and Clarification" (updates), `alg:authguard` (the
registry R). Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import due_missions
from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.principals import Verifier
from authguard_r.core.standing import Standing
from authguard_r.core.token import read_token
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.management.activation import activate, end_issued, hand_in
from authguard_r.enforcement.management.answers import take_answer
from authguard_r.enforcement.management.configurations import (
    Configuration,
    ConfiguredPart,
    hold_configurations,
    require_configurations,
)
from authguard_r.enforcement.management.orders import carry_out, choose
from authguard_r.enforcement.management.parts import ManagementParts, attempt
from authguard_r.enforcement.management.policy import hold_policy
from authguard_r.enforcement.management.preapproval import preapprove
from authguard_r.enforcement.management.recovery import mark_started, mark_stopped, recover
from authguard_r.enforcement.management.repetition import admit, withdraw
from authguard_r.enforcement.management.rollback import AcceptedStore, accept_store
from authguard_r.enforcement.management.shredding import (
    Retired,
    Shredding,
    is_shredding,
    retire,
    shred,
    shred_on,
)
from authguard_r.enforcement.report import behind_of
from authguard_r.enforcement.templates import TemplateStanding
from authguard_r.store.transactions import Ledger, Transaction

T = TypeVar("T")


class Management:
    """The operator's side of one robot's gate.

    Args:
        ledger: store and trusted time.
        inputs: verifies missions, templates and approvals.
        verifier: verifies commands and selections.
        facts: the signed site and the gate's identity.
        sealing: what of the log is sealed, and how long it is kept.
    """

    def __init__(
        self,
        ledger: Ledger,
        inputs: InputVerifier,
        *,
        verifier: Verifier,
        facts: SiteFacts,
        sealing: SealingPolicy = SealingPolicy(),  # noqa: B008 - frozen
    ) -> None:
        self._ledger = ledger
        self._inputs = inputs
        self._parts = ManagementParts(
            inputs=inputs, verifier=verifier, facts=facts, sealing=sealing
        )

    def issue(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission, or the next version of one, and activate nothing.

        It has the status `issued` and authorizes nothing until `activate` is given the same token.
        The active mission goes on as it is.

        Args:
            token: as in `activate`.
            confirmation: as in `activate`.

        Raises:
            AuthGuardError: as in `activate`; or too many are issued (`BUSY`).
        """
        return self._order(lambda act: hand_in(act, token, confirmation, parts=self._parts))

    def activate(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Make a mission active, or the next version of the active one; take it in if need be.

        Args:
            token: the signed mission, or a scheduler's signed instance of a template that was
                taken in before.
            confirmation: the record of its signing; goes into the log, sealed, when it is of
                this mission. It grants nothing.

        Raises:
            MalformedError: neither a mission nor an instance token, or not schema-valid.
            AuthenticityError: certificate or signature does not hold.
            AuthGuardError: with the reason that speaks against it; nothing was changed.
        """
        return self._order(lambda act: activate(act, token, confirmation, parts=self._parts))

    def template(self, token: bytes, *, confirmation: bytes | None = None) -> TemplateStanding:
        """Take in a signed template, or carry out the signed command that withdraws one.

        Taking one in activates nothing and takes nothing from the active mission. Withdrawing
        one revokes the active and the issued missions that were made of it.

        Args:
            token: the signed template, or the signed `withdraw`.
            confirmation: the record of the template's signing; goes into the log, sealed, when
                it is of this template. It grants nothing.

        Raises:
            AuthGuardError: malformed, not authentic, not allowed, here already or gone.
        """

        def job(act: Transaction) -> TemplateStanding:
            if read_token(token).kind is not Tag.COMMAND:
                return admit(act, token, confirmation, parts=self._parts)
            return withdraw(act, token, parts=self._parts)

        return self._narrow(job)  # it ends the issued missions that were made of it

    def command(self, token: bytes) -> Standing:
        """Carry out a signed command about a mission once.

        Raises:
            AuthGuardError: malformed, not authentic, not allowed, or not possible now.
        """
        return self._narrow(lambda act: carry_out(act, token, parts=self._parts))

    def accept_store(self, token: bytes) -> AcceptedStore:
        """Go on with a store that was put back, as a signed order says; the counter is written.

        Raises:
            AuthGuardError: malformed, not authentic, not allowed, or of another store; nothing was
                changed.
            EnvironmentFault: the counter cannot be written: the order is used up, and nothing goes
                on.
        """

        def job(act: Transaction) -> AcceptedStore:
            return accept_store(act, token, parts=self._parts)

        done = attempt(self._ledger, job)
        self._inputs.anchor.accepted()
        return done

    def shred(self, token: bytes) -> Shredding:
        """Destroy the keys of sealed fields, as a signed order says; `shred_on` does the rest.

        Raises:
            AuthGuardError: malformed, not authentic, not allowed, or too early; nothing was
                changed.
        """
        return attempt(self._ledger, lambda act: shred(act, token, parts=self._parts))

    def retire(self) -> Retired:
        """Destroy the keys of sealed fields that were kept as long as they may be.

        Raises:
            EnvironmentFault: nothing was destroyed.
        """
        if not self._parts.sealing.retention and not self._ledger.peek(due_missions):
            return Retired()
        return self._ledger.run(lambda act: retire(act, parts=self._parts), essential=True)

    def shred_on(self) -> bool:
        """Destroy some more of what is sealed under keys that are gone; False: nothing is left.

        Raises:
            EnvironmentFault: not now.
        """
        if not self._ledger.peek(is_shredding):
            return False
        return self._ledger.run(shred_on, essential=True)

    def select(self, token: bytes) -> Standing:
        """Take in a signed choice of one row, or a signed pre-approval of some.

        Raises:
            AuthGuardError: malformed, not authentic, or not the signer's to make.
        """

        def job(act: Transaction) -> Standing:
            is_preapproval = read_token(token).kind is Tag.PREAPPROVAL
            taken = preapprove if is_preapproval else choose
            return taken(act, token, parts=self._parts)

        return self._do(job)

    def approve(self, token: bytes, *, why: str = "") -> VerifiedApproval:
        """Keep a signed answer to an approval request, and close the request by a denial.

        Whether an approval counts is decided at use. The same answer again leaves no record.

        Args:
            token: the signed answer.
            why: the approver's words; they go into the log, sealed, and to no planner (L5).

        Raises:
            AuthGuardError: malformed or not authentic.
        """
        return self._do(lambda act: take_answer(act, token, why, self._ledger, parts=self._parts))

    def hold_policy(self, policy: VerifiedPolicy | None) -> None:
        """Compare the organization's risk policy, or its absence, with what was seen.

        Asked once, before anything is decided; what is in force is the wiring's (`SiteFacts.risk`).

        Args:
            policy: the one in force; None: none is.

        Raises:
            RefusedError: it is older than one that was seen, another of the same version or of
                another organization; or it is missing, and there was one.
        """
        attempt(self._ledger, lambda act: hold_policy(act, policy))

    def hold_configurations(
        self,
        parts: dict[ConfiguredPart, Configuration],
        *,
        sealed: dict[ConfiguredPart, dict[str, object]],
    ) -> None:
        """Hold what the gate is configured with against what was seen, and record a change.

        Asked once, before anything is decided.

        Args:
            parts: what is in force, signed or not.
            sealed: values that go beside the record of a part's change.

        Raises:
            RefusedError: a signed part is older than one that was seen.
        """
        self.require_configurations(parts)
        attempt(self._ledger, lambda act: hold_configurations(act, parts, sealed=sealed))

    def require_configurations(self, parts: dict[ConfiguredPart, Configuration]) -> None:
        """Refuse to go back, even when the clock went back.

        Raises:
            RefusedError: a signed part is older than one that was seen.
        """
        self._ledger.peek(lambda turn: require_configurations(turn, parts))

    def standing(self, mid: MissionId) -> Standing | None:
        """Return a mission's standing as it is held."""
        return self._ledger.run(lambda act: act.standing(mid))

    def started(self) -> bool:
        """Mark this gate as running, on disk; True when the one before never stopped cleanly.

        Asked once, before anything is served; `recover` gets the answer.

        Raises:
            EnvironmentFault: nothing was marked.
        """
        return self._ledger.run(mark_started, essential=True)

    def stopped(self) -> None:
        """Mark that the gate stopped cleanly: nothing is released after this.

        Raises:
            EnvironmentFault: nothing was marked; the next start will call this stop unclean.
        """
        self._ledger.run(mark_stopped, essential=True)

    @property
    def is_behind(self) -> bool:
        """True while a value of the newest state is from before the gate's start."""
        return bool(behind_of(self._inputs.state))

    def recover(self, *, unclean: bool = False) -> tuple[Digest, ...]:
        """After a stop: settle what attested state settles, suspend for the rest.

        A release without an outcome may have happened or not. `done_when`, attested, says that it
        succeeded; else the mission waits, suspended, for a signed `resolve`. A mission that is
        closing goes on closing: what is in flight counts as used.

        Args:
            unclean: the gate before did not record that it stopped (`started`): the active mission
                is suspended even when nothing is open, for it is unknown what the robot did since.

        Returns:
            Tickets that only a person can settle.

        Raises:
            RefusedError: the store has seen an organization's policy, and this gate has none.
        """
        self._inputs.refresh()

        def job(act: Transaction) -> tuple[Digest, ...]:
            if not self._parts.facts.risk:
                hold_policy(act, None)  # a gate that has had one decides nothing without it
            return recover(act, unclean=unclean, parts=self._parts)

        return self._ledger.run(job, essential=True)

    def _order(self, job: Callable[[Transaction], T]) -> T:
        """End the issued missions that ended by themselves, for good; then carry an order out."""
        self._do(lambda act: end_issued(act, self._parts))
        return self._do(job)

    def _narrow(self, job: Callable[[Transaction], T]) -> T:
        """Carry an order out; end issued missions behind it, so that they do not stop or delay it.

        A mission that cannot be ended now authorizes nothing, and the next order ends it.
        """
        done = self._do(job)
        with suppress(AuthGuardError):  # the order is on disk already
            self._ledger.run(lambda act: end_issued(act, self._parts), essential=True)
        return done

    def _do(self, job: Callable[[Transaction], T]) -> T:
        """Carry an order out, unless the store was rolled back and not accepted yet."""

        def held(act: Transaction) -> T:
            self._inputs.anchor.require()
            return job(act)

        return attempt(self._ledger, held)


__all__ = ["Management"]
