# SPDX-License-Identifier: Apache-2.0
"""What an approval of r people costs: r signatures of their own, or one of a group.

Machine time alone. How long people think is another matter, and the larger one by far:
`missionpair approvers` answers with a stated delay and tells the two apart.
Source: section "Threshold Approval Cost".
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from authguard_r.approvals import open_approval
from authguard_r.authoring.keys.setup import Member, demo_members, init_folder
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of, unb64
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.quantities import Now
from authguard_r.core.token import sign_object
from authguard_r.frost import signing
from authguard_r.frost.keys import Dealt, deal, public_key
from authguard_r.frost.messages import Nonces, SignatureShare
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import read_signer
from authguard_r.keys.trust import read_trust
from measure import Effort, Subject, Timing, interleave, timed
from scene import scenarios

#: How many people approve.
PEOPLE = (1, 2, 3, 5, 7)


def approvals(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time what the gate does, and what the signers of a group do, for each number of people.

    `approve.R.individual` opens R tokens whose signers' certificates were walked before, as those
    of people who approve every day are; `approve.R.group` verifies the group's one signature;
    `frost.R.*` is what each signer and whoever gathers the shares computes.
    """
    tokens, trust, message = _tokens(folder)
    now = Now(int(datetime.now(UTC).timestamp()) * 1_000, 0)
    subjects: list[Subject] = []
    for count in PEOPLE:
        subjects.append(
            Subject(
                f"approve.{count}.individual",
                timed(
                    lambda n=count: [open_approval(t, verifier=trust, now=now) for t in tokens[:n]]
                ),
            )
        )
        if count > 1:
            subjects += _group(count, message)
    return interleave(subjects, effort)


def _tokens(folder: Path) -> tuple[list[bytes], object, bytes]:
    """Return one approval of each of seven supervisors, who they are trusted by, and its digest."""
    at = folder / "approvers"
    people = tuple(
        Member(id=f"approver-{n}", role=Role.SUPERVISOR, robots=None, regions=None)
        for n in range(max(PEOPLE))
    )
    init_folder(at, (*demo_members(scenarios.site(), ()), *people), now=datetime.now(UTC))
    digest = b64(bytes(32))
    approval = Approval(
        mid="deliver-p1",
        version=1,
        mission=digest,
        rid=scenarios.RID,
        grant="go-to-101",
        scope=digest,
        situation=digest,
        counter=1,
        expires_ms=1 << 50,
        verdict=ApprovalVerdict.APPROVE,
    )
    signers = [
        read_signer(at / "keys" / f"{who.id}.key.pem", at / "keys" / f"{who.id}.cert.pem")
        for who in people
    ]
    made = [sign_object(approval, Tag.APPROVAL, signer) for signer in signers]
    return made, read_trust(at), unb64(digest_of(Tag.APPROVAL, approval))


def _group(count: int, message: bytes) -> list[Subject]:
    """Return the subjects of a group of which so many sign together."""
    names = tuple(PrincipalId(f"approver-{n}") for n in range(count + 2))
    dealt = deal(PrincipalId("board-1"), names, threshold=count)
    session, held, shares = _session(dealt, count, message)
    signature = signing.aggregate(session, shares)
    key = Ed25519PublicKey.from_public_bytes(public_key(dealt.group))
    return [
        Subject(f"approve.{count}.group", timed(lambda: key.verify(signature, message))),
        Subject(f"frost.{count}.nonces", timed(lambda: signing.new_nonces(dealt.shares[0]))),
        Subject(
            f"frost.{count}.share", timed(lambda: signing.sign(session, dealt.shares[0], held[0]))
        ),
        Subject(
            f"frost.{count}.verify_share", timed(lambda: signing.verify_share(session, shares[0]))
        ),
        Subject(f"frost.{count}.aggregate", timed(lambda: signing.aggregate(session, shares))),
    ]


def _session(
    dealt: Dealt, count: int, message: bytes
) -> tuple[signing.SigningSession, list[Nonces], tuple[SignatureShare, ...]]:
    held = [signing.new_nonces(share) for share in dealt.shares[:count]]
    session = signing.begin(dealt.group, tuple(nonces.commitment for nonces in held), message)
    shares = tuple(
        signing.sign(session, share, nonces)
        for share, nonces in zip(dealt.shares, held, strict=False)
    )
    return session, held, shares
