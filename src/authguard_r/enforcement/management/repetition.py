# SPDX-License-Identifier: Apache-2.0
"""Templates at the gate: taken in once, used up mission by mission, withdrawn by a signature.

Spec page: docs/spec/template.md#at-the-gate
"""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.checks.mission import binding_findings
from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.identifiers import Digest
from authguard_r.core.lifecycle import TERMINAL, Event, Status
from authguard_r.core.quantities import to_ms
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import advance
from authguard_r.core.token import open_token
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.management.parts import (
    ManagementParts,
    entry,
    refuse,
    require_signed_since,
    require_timely,
)
from authguard_r.enforcement.signed_orders import NARROWING, Command, Verb
from authguard_r.enforcement.templates import (
    InstancePair,
    Instantiated,
    KeptTemplate,
    Template,
    TemplateStanding,
    claimed,
    claimed_template,
    combinations,
    filled,
    is_pair,
)
from authguard_r.enforcement.templates.confirmation import template_inputs
from authguard_r.store.issued_missions import registered
from authguard_r.store.transactions import Transaction, read_held


class Used(Struct, frozen=True, kw_only=True):
    """One instance that counts, before anything is held.

    Args:
        made: the mission, and who made it.
        kept: its template, with this instance counted.
        is_counted: this act counts it; False: handing it in did.
    """

    made: Instantiated
    kept: KeptTemplate
    is_counted: bool = True

    def pair(self, token: bytes) -> bytes:
        """Return what is held under the mission's digest: both tokens, to be verified again."""
        text = token.decode("ascii").strip()
        return encode_fast(InstancePair(instance=text, template=self.kept.token))

    def hold(self, act: Transaction) -> None:
        """Count the instance, in the commit that makes its mission the active one."""
        act.put("template", self.made.template.digest, encode_fast(self.kept))

    def sealed(self, token: bytes) -> dict[str, object]:
        """Return both tokens, from which the mission is made again without this store."""
        return {"token": token.decode("ascii").strip(), "template": self.kept.token}

    def opened(self) -> dict[str, object]:
        """Return what the mission's record says of who made it; its issuer did nothing now."""
        opened: dict[str, object] = {
            "by": self.made.scheduler.id,
            "scheduler": self.made.scheduler.id,
            "issuer": self.made.mission.mission.issuer,
            "template": self.made.template.digest,
        }
        return {**opened, "instance": self.kept.used} if self.is_counted else opened


def use_instance(act: Transaction, token: bytes, parts: ManagementParts) -> Used:
    """Return the mission of an instance, counted once against what its template allows."""
    made, kept = parts.inputs.verify_instance(token, act)
    here = registered(act, made.mission.mission.mid, made.mission.digest)
    if here is not None and here.status is Status.ISSUED:
        return Used(made=made, kept=kept, is_counted=False)
    template = made.template.template
    if kept.used >= template.instances:
        text = f"all {template.instances} missions of `{template.template}` were made"
        raise refuse(Reason.STARTS_EXHAUSTED, text, "template.instances")
    recent = kept.in_window(template.rate, act.now)
    if len(recent) >= template.rate.count:
        text = f"{template.rate.count} missions in {template.rate.per_ms} ms are all there may be"
        raise refuse(Reason.RATE_EXCEEDED, text, "template.rate")
    counted = replace(kept, used=kept.used + 1, recent=(*recent, act.now.mono_ms))
    return Used(made=made, kept=counted)


def admit(
    act: Transaction, token: bytes, confirmation: bytes | None, *, parts: ManagementParts
) -> TemplateStanding:
    """Keep an authentic template that this robot could carry out, once."""
    verified = parts.inputs.verify_template(token, act)
    template = verified.template
    for finding in binding_findings(filled(template, next(combinations(template))), parts.facts):
        text = f"expected `{finding.got}`, got `{finding.expected}`"
        raise refuse(finding.reason, text, f"template.{finding.field}")
    if act.now.utc_ms > to_ms(template.not_after, where="template.not_after"):
        raise refuse(Reason.EXPIRED, f"it ended at {template.not_after}", "template.not_after")
    known = parts.inputs.kept_template(act, verified.digest)
    if known is not None:
        reason = Reason.REVOKED if known.withdrawn else Reason.TRANSITION_REFUSED
        said = "was withdrawn" if known.withdrawn else "is here already"
        raise refuse(reason, f"`{template.template}` {said}", "template")
    kept = KeptTemplate(token=token.decode("ascii").strip())
    act.put("template", verified.digest, encode_fast(kept))
    opened: dict[str, object] = {
        "verb": "template",
        "by": verified.issuer.id,
        "role": verified.issuer.role,
        "template": verified.digest,
        "instances": template.instances,
    }
    sealed = template_inputs(token, confirmation, template)
    act.record(entry(act, template.template, opened, sealed))
    return _standing(template, verified.digest, kept)


def withdraw(act: Transaction, token: bytes, *, parts: ManagementParts) -> TemplateStanding:
    """Make nothing of a template any more, and revoke the active mission that it made."""
    command, _, signer = open_token(
        token, Command, tag=Tag.COMMAND, roles=ISSUER_ROLES, verifier=parts.verifier, now=act.now
    )
    if command.verb is not Verb.WITHDRAW:
        raise refuse(Reason.TRANSITION_REFUSED, f"no {command.verb} of a template", "command.verb")
    require_fresh(act, command)
    kept = parts.inputs.kept_template(act, command.mission)
    if kept is None:
        raise refuse(Reason.MISSION_UNKNOWN, "no such template is here", "template")
    if not signer.scope.covers(parts.facts.robot.rid):
        raise refuse(Reason.SIGNER_OUT_OF_SCOPE, f"`{signer.id}` has no say about this robot")
    template = _template_of(kept)
    if signer.id != template.mission["issuer"] and signer.role != "safety_officer":
        raise refuse(Reason.ROLE_DENIED, f"`{signer.id}` may not withdraw this", "template")
    if kept.withdrawn:
        raise refuse(Reason.REVOKED, "it was withdrawn before", "template")
    gone = replace(kept, withdrawn=True)
    act.put("template", command.mission, encode_fast(gone))
    act.put("command", command.nonce, b"1")
    opened: dict[str, object] = {
        "verb": command.verb,
        "by": signer.id,
        "role": signer.role,
        "template": command.mission,
        "used": kept.used,
    }
    act.record(entry(act, template.template, opened, {"command": command}))
    _revoke_active(act, command.mission)
    parts.inputs.forget()
    return _standing(template, command.mission, gone)


def require_fresh(act: Transaction, command: Command) -> None:
    """Refuse an order that ran out, was carried out before, or may be one of a lost log."""
    require_timely(act, command, "command", is_narrowing=command.verb in NARROWING)
    if command.verb not in NARROWING and command.verb not in {Verb.ACCEPT_STORE, Verb.SHRED}:
        require_signed_since(act, command.issued_ms)


def _revoke_active(act: Transaction, template: Digest) -> None:
    """Revoke the active mission when this template made it; it leaves a record of its own."""
    mid = act.active()
    standing = act.standing(mid) if mid is not None else None
    if standing is None or standing.status in TERMINAL:
        return
    held = act.token(standing.digest)
    if held is None or not is_pair(held):
        return
    pair = read_held(held, InstancePair, "token")
    revoked = advance(standing, Event.REVOKE)
    if claimed_template(pair.instance.encode("utf-8")) != template or revoked is None:
        return
    act.hold(revoked)
    act.make_active(None)
    opened: dict[str, object] = {"verb": "revoke", "by": "withdraw", "status": revoked.status}
    act.record(entry(act, revoked.mid, opened))


def _template_of(kept: KeptTemplate) -> Template:
    """Return a template that was verified when it was taken in.

    Its issuer's certificate may have ended since; that must not prevent a withdrawal.
    """
    return claimed(kept.token.encode("utf-8"), Template, tag=Tag.TEMPLATE)


def _standing(template: Template, hashed: Digest, kept: KeptTemplate) -> TemplateStanding:
    return TemplateStanding(
        template=template.template,
        digest=hashed,
        instances=template.instances,
        used=kept.used,
        withdrawn=kept.withdrawn,
    )
