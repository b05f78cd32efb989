# SPDX-License-Identifier: Apache-2.0
"""What needs no disk: one action normalized, decided and hashed; tokens; the parts of the sum.

Beside Cedar, Biscuit and bare signatures in the same blocks.
"""

from __future__ import annotations

import json
from collections.abc import Callable

from authguard_r.approvals import answer, open_approval
from authguard_r.core.action import Action
from authguard_r.core.approval import ApprovalVerdict as Answer
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.decision import Verdict
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.identifiers import GrantId
from authguard_r.core.standing import ApprovalRequest
from authguard_r.core.token import VerifiedMission, sign_object, verify_mission
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.normalize import read_plan
from authguard_r.normalize.dialects import Dialect, read_reply
from authguard_r.provenance.context import ContextLedger
from authguard_r.provenance.labels import label_fields
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.store.memory import MemoryStore
from fixtures.reply_formats import READ, Reply
from measure import Effort, Subject, Timing, interleave, timed
from scene import GRANT, HIJACKED, Scene, bench, long_mission, reply, scenarios, scene
from yardsticks import BiscuitGate, Cedar, Signatures, cedar_five, values


def decisions(effort: Effort) -> dict[str, Timing]:
    """Time one decision of the gate, accepted and refused, beside the yardsticks."""
    here = scene()
    good, bad = reply(), reply(HIJACKED)
    wanted, hijacked = here.judge(good)[0], here.judge(bad)[0]
    askers = _askers(here, wanted)
    _require_agreement(here, wanted, hijacked, askers)
    subjects = [
        Subject("gate.accept", timed(lambda: here.judge(good))),
        Subject("gate.refuse", timed(lambda: here.judge(bad))),
    ]
    for name, ask in askers.items():
        subjects.append(Subject(f"{name}.accept", _asking(ask, wanted)))
        if name in {"cedar.rule", "biscuit"}:
            subjects.append(Subject(f"{name}.refuse", _asking(ask, hijacked)))
    return interleave(subjects, effort)


#: Bytes of text that reached the planner before it proposed.
LEDGERS = {"1kB": 1_000, "100kB": 100_000}
_SEEN = "The porter says that Station 103 is busy and the lift is slow; nobody knows why today. "


def normalizing(effort: Effort) -> dict[str, Timing]:
    """Time one action from the planner's bytes to labels and evidence, beside `json.loads`.

    Then every format of a reply that is JSON, recognized and read.

    Reading, binding, labels, and which inputs mentioned what it carries, as the enforcer does it
    for each proposal; the ledger took its inputs in before, as a client does when they arrive.
    """
    here, good = scene(), reply()
    text = good.decode()
    subjects = [Subject("json.loads", timed(lambda: json.loads(text)))]
    for name, size in LEDGERS.items():
        ledger = here.binder.context()
        for start in range(0, size, 2_000):
            seen = (_SEEN * 30)[: min(2_000, size - start)]
            ledger.add("camera" if start % 4_000 else "document", seen)
        subjects.append(Subject(f"normalize.{name}", timed(_normalizing(here, good, ledger))))
    replies = [one for one in READ if one.text.lstrip()[:1] in {"{", "["} and _is_json(one.text)]
    texts = [one.text for one in replies]
    formats = [
        Subject("json.loads.formats", timed(lambda: [json.loads(text) for text in texts])),
        Subject("read.formats", timed(lambda: [_recognized(one) for one in replies])),
    ]
    return interleave(subjects, effort) | interleave(formats, effort)  # each with its own cache


def _is_json(text: str) -> bool:
    """Return whether a reply is JSON and nothing else."""
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def _recognized(one: Reply) -> object:
    return read_reply(one.text, Dialect.AUTO, one.form)


def _normalizing(here: Scene, data: bytes, ledger: ContextLedger) -> Callable[[], object]:
    def act() -> object:
        plan = read_plan(data, binder=here.binder)
        action = plan.steps[0].action
        label_fields(action, here.verified, here.standing, base=ledger.base())
        return ledger.influences(action)

    return act


def tokens(effort: Effort) -> dict[str, Timing]:
    """Time a cold token beside the signature checks in it, and the kept mission.

    Cold: a trust root that was read just now and has seen no certificate. `token.known_signer`
    is a token of somebody whose certificates were walked before; `token.kept` is the mission that
    the gate holds already.
    """
    token = scenarios.token()
    known, fresh = read_trust(scenarios.trust_folder()), _Fresh()
    bare = Signatures(token, known)
    biscuit = BiscuitGate(scene())
    held = bench(MemoryStore(), trust=known)
    kept = held.gate.management.activate(long_mission("kept")).digest
    inputs = held.gate.enforcer.inputs

    def keep() -> int:
        """Ask inside a turn, as the enforcer does; only the asking counts."""
        return held.gate.ledger.run(lambda act: timed(lambda: inputs.mission(act, kept))())

    subjects = [
        Subject("token.cold", timed(lambda: _verify(token, fresh.trust), before=fresh.renew)),
        Subject("token.signatures", timed(bare.all)),
        Subject("token.known_signer", timed(lambda: _verify(token, known))),
        Subject("ed25519.verify", timed(bare.one)),
        Subject("biscuit.verify", timed(biscuit.verify)),
        Subject("token.kept", keep),
    ]
    return interleave(subjects, effort)


def parts(effort: Effort) -> dict[str, Timing]:
    """Time the terms of `eq:latency` apart; the ledger's are in `durable`."""
    here = scene()
    good = reply()
    action, _, _ = here.judge(good)
    refused, _, _ = here.judge(reply(HIJACKED))
    evidence = read_plan(good, binder=here.binder).evidence
    bound = read_plan(good, binder=here.binder).steps[0].action
    safety = EnvelopeGate(default_config(scenarios.site(), scenarios.RID))
    trust, fresh = read_trust(scenarios.trust_folder()), _Fresh()
    approval = _approval(here)
    subjects = [
        Subject("T_N.normalize", timed(lambda: read_plan(good, binder=here.binder))),
        Subject("T_N.complete", timed(lambda: here.completed(bound, evidence))),
        Subject("T_P.decide", timed(lambda: here.decide(action))),
        Subject("T_P.decide_refused", timed(lambda: here.decide(refused))),
        Subject("T_P.digest", timed(lambda: digest_of(Tag.ACTION, action))),
        Subject("T_A.approval", timed(lambda: _open(approval, trust, here))),
        Subject(
            "T_A.approval_cold",
            timed(lambda: _open(approval, fresh.trust, here), before=fresh.renew),
        ),
        Subject(
            "T_S.assess", timed(lambda: safety.assess(action, here.state, here.facts, here.now))
        ),
    ]
    return interleave(subjects, effort)


def counted() -> dict[str, int]:
    """Return how many conditions each yardstick checks."""
    here = scene()
    return {
        "cedar.rule": Cedar(here).conditions,
        "cedar.mission": Cedar(here, whole=True).conditions,
        "biscuit": BiscuitGate(here).conditions,
    }


class _Fresh:
    """A trust root that has seen no certificate; read long before it is asked, as in a process."""

    AHEAD = 64

    def __init__(self) -> None:
        self._ready: list[Trust] = []
        self.renew()

    def renew(self) -> None:
        """Take the next one, so that reading files just before does not empty the caches."""
        if not self._ready:
            self._ready = [read_trust(scenarios.trust_folder()) for _ in range(self.AHEAD)]
        self.trust = self._ready.pop()


def _verify(token: bytes, trust: Trust) -> VerifiedMission:
    return verify_mission(token, verifier=trust, now=scenarios.NOW, roles=ISSUER_ROLES)


def _open(approval: bytes, trust: Trust, here: Scene) -> VerifiedApproval:
    return open_approval(approval, verifier=trust, now=here.now)


def _askers(here: Scene, action: Action) -> dict[str, Callable[[Action], bool]]:
    context = values(here, action)
    return {
        "cedar.rule": Cedar(here).asker(context),
        "cedar.rule_dict": Cedar(here, text=False).asker(context),
        "cedar.mission": Cedar(here, whole=True).asker(context),
        "cedar.five": cedar_five(here),
        "biscuit": BiscuitGate(here).asker(context),
    }


def _asking(ask: Callable[[Action], bool], action: Action) -> Callable[[], int]:
    return timed(lambda: ask(action))


def _require_agreement(
    here: Scene, wanted: Action, hijacked: Action, askers: dict[str, Callable[[Action], bool]]
) -> None:
    """Hold every yardstick to the gate's two answers before it is timed."""
    accepted = here.decide(wanted).verdict is Verdict.ACCEPT
    refused = here.decide(hijacked).verdict is Verdict.REJECT
    if not accepted or not refused:
        raise RuntimeError("the scene is broken: one action passes, the hijacked one does not")
    for name, ask in askers.items():
        if not ask(wanted) or ask(hijacked):
            raise RuntimeError(f"`{name}` does not answer as the gate does")


def _approval(here: Scene) -> bytes:
    request = ApprovalRequest(
        counter=1,
        scope=here.verified.digest,
        situation=here.verified.digest,
        required=2,
        expires_ms=here.now.utc_ms + 60_000,
    )
    said = answer(here.verified, GrantId(GRANT), request, rid=scenarios.RID, verdict=Answer.APPROVE)
    signer = scenarios.folder_signer(scenarios.trust_folder(), "supervisor-1")
    return sign_object(said, Tag.APPROVAL, signer)
