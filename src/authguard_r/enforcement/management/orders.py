# SPDX-License-Identifier: Apache-2.0
"""Signed commands and choices about a mission that is here.

Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from authguard_r.approvals import open_selection
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import Digest, PrincipalId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.mission import Grant, Mission
from authguard_r.core.principals import Principal
from authguard_r.core.provenance import Chooser
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Spend, Standing, advance, finish, select, settle
from authguard_r.core.token import open_token
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.management.parts import (
    ManagementParts,
    entry,
    go_on,
    halted_ms,
    hold_suspended,
    refuse,
    replayed,
    require_newest,
    require_signed_since,
    require_timely,
)
from authguard_r.enforcement.management.repetition import require_fresh
from authguard_r.enforcement.signed_orders import ENDING, EVENTS, NARROWING, Command, Verb
from authguard_r.safety.stored_memory import settle_memory
from authguard_r.store.issued_missions import hold_issued, registered
from authguard_r.store.transactions import Transaction

#: Open releases that a message names; a mission has one for each lease that was lost.
_NAMED = 4


def carry_out(act: Transaction, token: bytes, *, parts: ManagementParts) -> Standing:
    """Carry out a signed command about a mission once."""
    command, _, signer = open_token(
        token, Command, tag=Tag.COMMAND, roles=ISSUER_ROLES, verifier=parts.verifier, now=act.now
    )
    standing, mission = _require_current(act, command, signer, parts)
    _require_newest(act, command)
    after = _carried_out(act, command, standing, mission)
    if after is None:
        raise refuse(Reason.TRANSITION_REFUSED, _refusal(command.verb, standing))
    is_issued = standing.status is Status.ISSUED
    if is_issued:
        hold_issued(act, after)
    else:
        act.hold(after)
    if command.verb is Verb.SUSPEND:  # by the signer's clock, as the resume that ends it
        again = standing.status is Status.SUSPENDED
        hold_suspended(act, command.mid, command.issued_ms, again=again)
    act.put("command", command.nonce, b"1")
    if command.verb is Verb.RESUME:
        go_on(act)
    if after.status in TERMINAL and not is_issued:
        act.make_active(None)
        parts.inputs.forget()
    opened: dict[str, object] = {
        "verb": command.verb,
        "by": signer.id,
        "role": signer.role,
        "version": command.version,
        "mission": command.mission,
        "status": after.status,
    }
    act.record(entry(act, command.mid, opened, {"command": command}))
    return after


def _require_newest(act: Transaction, command: Command) -> None:
    """Refuse what would undo an order that was signed later; a release is resolved once only."""
    known = act.standing(command.mid)
    is_own = known is not None and known.digest == command.mission
    # an order about a version that waits makes none about the version in force too old
    key = f"{command.mid if is_own else command.mission}/command"
    if command.verb is Verb.RESUME:
        over_ms = halted_ms(act, command.mid)
        require_newest(act, key, command.issued_ms, over_ms=over_ms)
    elif command.verb in EVENTS and command.issued_ms:  # without a time it narrows, too
        require_newest(act, key, command.issued_ms)


def _require_current(
    act: Transaction, command: Command, signer: Principal, parts: ManagementParts
) -> tuple[Standing, Mission]:
    require_fresh(act, command)
    standing = registered(act, command.mid, command.mission)
    if standing is None:
        raise refuse(Reason.MISSION_UNKNOWN, "the gate does not have this mission version")
    if command.version != standing.version:
        text = f"expected {standing.version}, the version of `{command.mission}`, got "
        text += f"{command.version}: sign the order again"
        raise refuse(Reason.MISSION_UNKNOWN, text, "command.version")
    if not signer.scope.covers(standing.rid):
        raise refuse(Reason.SIGNER_OUT_OF_SCOPE, f"`{signer.id}` has no say about this robot")
    if command.verb in ENDING:
        mission = parts.inputs.held(act, standing.digest).mission
    else:  # what lets it go on: only while its signature holds
        mission = parts.inputs.mission(act, standing.digest).mission
    mine = signer.id == mission.issuer
    if not mine and not (command.verb in NARROWING and signer.role == "safety_officer"):
        raise refuse(Reason.ROLE_DENIED, f"`{signer.id}` may not {command.verb} this mission")
    return standing, mission


def _carried_out(
    act: Transaction, command: Command, standing: Standing, mission: Mission
) -> Standing | None:
    if command.verb is Verb.RESUME and standing.open:
        return None  # unknown outcomes are resolved first
    if command.verb is not Verb.RESOLVE:
        if command.verb is Verb.SUSPEND and standing.status is Status.SUSPENDED:
            return standing  # a newer word: no resume that was signed before it ends it
        event = EVENTS.get(command.verb)
        after = None if event is None else advance(standing, event)
        return None if after is None else finish(after, mission, act.now)
    if command.ticket is None or command.outcome in {None, Outcome.UNKNOWN}:
        return None
    if all(release.ticket != command.ticket for release in standing.open):
        return None
    ended = Outcome(command.outcome)
    settle_memory(act, standing, mission, ticket=command.ticket, outcome=ended)
    after = settle(
        standing,
        mission,
        ticket=command.ticket,
        outcome=ended,
        used=_reserved(standing, command.ticket),
    )
    return finish(after, mission, act.now)


def _refusal(verb: Verb, standing: Standing) -> str:
    """Return why an order has no effect, and what would have: open releases are resolved first."""
    told = f"the mission is {standing.status}, so `{verb}` has no effect"
    if verb is not Verb.RESUME or not standing.open:
        return told
    tickets = ", ".join(f"`{release.ticket}`" for release in standing.open[:_NAMED])
    more = f" and {len(standing.open) - _NAMED} more" if len(standing.open) > _NAMED else ""
    return (
        f"{told} while the end of {tickets}{more} is unknown: "
        "`authguard mission resolve TOKEN --ticket T --outcome ...` for each"
    )


def choose(act: Transaction, token: bytes, *, parts: ManagementParts) -> Standing:
    """Take in a signed choice of one row once."""
    selection, signer = open_selection(token, verifier=parts.verifier, now=act.now)
    standing = act.standing(selection.mid)
    named = (selection.mission, selection.version)
    if standing is None or (standing.digest, standing.version) != named:
        raise refuse(Reason.MISSION_UNKNOWN, "the gate does not have this mission version")
    if standing.status in {*TERMINAL, Status.ISSUED}:
        raise replayed(standing)
    require_timely(act, selection, "selection")
    require_newest(act, f"{selection.mid}/{selection.grant}/selection", selection.issued_ms)
    require_signed_since(act, selection.issued_ms)
    verified = parts.inputs.mission(act, standing.digest)
    grant = next((g for g in verified.mission.actions if g.id == selection.grant), None)
    if grant is None or selection.row >= len(grant.alternatives):
        raise refuse(Reason.SCHEMA_INVALID, "the mission has no such row", "selection.row")
    row = grant.alternatives[selection.row]
    places = (place for place in (row.source, row.destination, *row.regions) if place is not None)
    if not signer.scope.covers(standing.rid, places):
        raise refuse(Reason.SIGNER_OUT_OF_SCOPE, f"`{signer.id}` has no say there")
    if not _may_choose(grant, signer, verified.mission.issuer):
        raise refuse(Reason.ROLE_DENIED, f"the choice is the {grant.chooser}'s")
    chosen = select(standing, grant.id, selection.row)
    act.hold(chosen)
    act.put("command", selection.nonce, b"1")
    opened: dict[str, object] = {
        "verb": "select",
        "by": signer.id,
        "grant": grant.id,
        "row": selection.row,
    }
    sealed: dict[str, object] = {"token": token.decode("ascii").strip()}
    act.record(entry(act, selection.mid, opened, sealed))
    return chosen


def _may_choose(grant: Grant, signer: Principal, issuer: PrincipalId) -> bool:
    if grant.chooser is Chooser.OPERATOR:
        return signer.id == issuer
    return grant.chooser is Chooser.SUPERVISOR and signer.role == "supervisor"


def _reserved(standing: Standing, ticket: Digest) -> Spend:
    """What it used is unknown, so all of it counts as used."""
    return next((r.reserved for r in standing.open if r.ticket == ticket), Spend())
