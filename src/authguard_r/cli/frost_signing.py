# SPDX-License-Identifier: Apache-2.0
"""The steps of `authguard advanced frost` that make a signature, and the look at a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import typer
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.frost_files import (
    ballot_lines,
    group_lines,
    load,
    load_all,
    load_share,
    opened,
    owner,
    plain,
    require_absent,
    store,
)
from authguard_r.cli.gateway import ReadingRole, connected
from authguard_r.cli.inputs import wall_now
from authguard_r.cli.offline import OfflineStore, offline
from authguard_r.cli.sign import trust_folder_of
from authguard_r.client.approvals import shown, the_one
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, decode
from authguard_r.core.errors import AuthenticityError, RefusedError
from authguard_r.core.principals import Endorsed
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.frost import signing
from authguard_r.frost.keys import public_key, require_share
from authguard_r.frost.messages import (
    Ballot,
    Contribution,
    File,
    Group,
    KeyGenerationPlan,
    NonceCommitment,
    Nonces,
    Offer,
    Secret,
    Share,
    SignatureShare,
    digest,
    message_of,
)
from authguard_r.frost.nonces import NonceStore
from authguard_r.keys.loading import key_of, load_pem
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.server.wiring import Gate
from authguard_r.wire.approval_request import Question
from authguard_r.wire.output import emit, printed


class GroupSigner(Struct, frozen=True):
    """A group's finished signature as a signer of its one message (`core.ports.Signer`)."""

    chain: tuple[bytes, ...]
    signature: bytes

    def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
        """Return chain and signature; the message is the one that it was made for."""
        del message
        return ((self.chain, self.signature),)


class RequestPlace(Struct, frozen=True, kw_only=True):
    """Where requests are: at a running gate, or in a store that no process has open.

    Args:
        gate: the gate's run folder or socket.
        trust: the trust folder.
        site: the site, with a store.
        store: the store; None: a gate runs.
        robot: which gate's, with a store.
    """

    gate: Path | None
    trust: Path | None
    site: Path | None
    store: Path | None
    robot: str | None

    @contextmanager
    def opened(self) -> Iterator[Gate]:
        """Yield the gate of a store.

        Raises:
            typer.BadParameter: a store needs trust and site.
            EnvironmentFault: there is no such store; none is made.
        """
        if self.store is None or self.trust is None or self.site is None:
            raise typer.BadParameter("a store needs --trust and --site", param_hint="--store")
        kept = OfflineStore(store=self.store, trust=self.trust, site=self.site, robot=self.robot)
        with offline(kept) as gate:
            yield gate


def ballot(counter: int, place: RequestPlace, out: Path, *, deny: bool, as_json: bool) -> int:
    """Write the answer to an open request, with what it is bound to."""
    asked = _question(counter, place)
    seen = shown(asked)
    approval = Approval(
        mid=asked.mid,
        version=asked.version,
        mission=asked.mission,
        rid=asked.rid,
        grant=asked.grant,
        scope=asked.scope,
        situation=asked.situation,
        counter=asked.counter,
        expires_ms=asked.expires_ms,
        verdict=ApprovalVerdict.DENY if deny else ApprovalVerdict.APPROVE,
    )
    made = Ballot(approval=approval, scope=seen.scope, situation=seen.situation)
    store(out, made)
    payload = {"file": str(out), "ballot": plain(made), "required": asked.required}
    lines = [*ballot_lines(made), f"{asked.required} people are needed, the issuer included"]
    emit(payload, [*lines, f"{out}"], as_json=as_json)
    return 0


def submit(token: Path, place: RequestPlace, *, why: str, as_json: bool) -> int:
    """Hand an approval token in, and say whether it counts."""
    data = read_file(token)
    if place.store is None:
        with connected(place.gate, ReadingRole.OPERATOR, place.trust) as client:
            told = client.approve(data, why=why)
    else:
        with place.opened() as gate:
            item = gate.management.approve(data, why=why)
            told = OpenQuestions(gate, _nobody).answered(item)
    worth = told.get("why_not")
    said = f"request {told['counter']}: {told['approver']} answers {told['verdict']}"
    emit(
        {**told, "counts": not worth},
        [f"{said}, but it does not count: {worth}" if worth else said],
        as_json=as_json,
    )
    return 1 if worth else 0


def _question(counter: int, place: RequestPlace) -> Question:
    if place.store is None:
        with connected(place.gate, ReadingRole.OPERATOR, place.trust) as client:
            return client.approval(counter)
    with place.opened() as gate:
        return the_one(OpenQuestions(gate, _nobody).told(counter), counter)


def _nobody(event: dict[str, Any]) -> None:
    """Notify no client: no process watches a store."""


def commit(
    share_file: Path, nonces: Path, out: Path, *, passphrase_file: Path | None, as_json: bool
) -> int:
    """Keep two fresh nonces and write what they commit to."""
    share = load_share(share_file, passphrase_file)
    require_share(share)
    require_absent(out)
    store(out, NonceStore(nonces).put(signing.new_nonces(share)))
    emit({"file": str(out), "member": owner(share)}, [f"{out}"], as_json=as_json)
    return 0


def give(
    share_file: Path,
    nonces: Path,
    ballot_file: Path,
    commitments: tuple[Path, ...],
    out: Path,
    *,
    passphrase_file: Path | None,
    yes: bool,
    as_json: bool,
) -> int:
    """Show the ballot, ask, and write the member's part; the nonces are gone before it is made."""
    share, asked = load_share(share_file, passphrase_file), load(ballot_file, Ballot)
    require_share(share)
    require_absent(out)
    if asked.approval.expires_ms < wall_now(None).utc_ms:
        raise RefusedError(
            "the request ran out", reason=Reason.APPROVAL_TIMEOUT, where=ballot_file.name
        )
    session = signing.begin(share.group, load_all(commitments, NonceCommitment), message_of(asked))
    mine = next((c for c in session.commitments if c.identifier == share.identifier), None)
    if mine is None:
        raise RefusedError(
            f"expected a commitment of `{owner(share)}`",
            reason=Reason.SIGNATURE_MISSING,
            where="commitments",
        )
    lines = ballot_lines(asked)
    if not yes:
        question = f"Sign exactly this, as {owner(share)} of {share.group.id}?"
        confirm_shown(lines, question, as_json=as_json)
    # from here on these nonces are spent, also after a crash
    part = signing.sign(session, share, NonceStore(nonces).take(mine))
    store(out, part)
    payload = {"file": str(out), "member": owner(share), "ballot": plain(asked)}
    emit(payload, [*(lines if yes else []), f"{out}"], as_json=as_json)
    return 0


def aggregate(
    group_file: Path,
    cert: Path,
    ballot_file: Path,
    commitments: tuple[Path, ...],
    parts: tuple[Path, ...],
    *,
    out: Path,
    trust: Path | None,
    as_json: bool,
) -> int:
    """Write the approval token, or say whose part does not hold."""
    group, asked = load(group_file, Group), load(ballot_file, Ballot)
    require_absent(out)
    chain = _chain(group, cert, trust_folder_of(trust, cert))
    session = signing.begin(group, load_all(commitments, NonceCommitment), message_of(asked))
    signature = signing.aggregate(session, load_all(parts, SignatureShare))
    token = sign_object(asked.approval, Tag.APPROVAL, GroupSigner(chain, signature))
    out.write_bytes(token)
    signers = [group.members[place - 1] for place in session.signers]
    payload = {"file": str(out), "group": group.id, "signers": signers}
    emit(payload, [f"{out}", f"signed by {group.id}: {', '.join(signers)}"], as_json=as_json)
    return 0


def inspect(file: Path, *, passphrase_file: Path | None, as_json: bool) -> int:
    """Say what a file is, and whether it holds as far as it can be seen alone."""
    data = opened(file, passphrase_file)
    # a union tells the kinds apart by their names
    value: Any = decode(data.removesuffix(b"\n"), File, where=file.name)  # type: ignore[arg-type]
    kind = str(msgspec.to_builtins(value)["kind"])
    shown: dict[str, object] = {"kind": kind}
    lines = [kind]
    if isinstance(value, Share):
        require_share(value)
        lines += [f"secret share of {owner(value)}: it fits", *group_lines(value.group)]
        shown |= {"member": owner(value), "group": plain(value.group)}
    elif isinstance(value, Secret | Nonces):
        lines.append("secret: not shown; keep it to yourself")
    else:
        lines += _public_lines(value)
        shown |= {"value": plain(value), "digest": digest(value)}
    emit(shown, lines, as_json=as_json)
    return 0


def _public_lines(
    value: Group
    | KeyGenerationPlan
    | Offer
    | Contribution
    | Ballot
    | NonceCommitment
    | SignatureShare,
) -> list[str]:
    """Return a public file for people."""
    if isinstance(value, Group):
        return group_lines(value)
    if isinstance(value, Ballot):
        return ballot_lines(value)
    plainly = msgspec.to_builtins(value)
    fields = [f"  {name} {told}" for name, told in plainly.items() if name != "kind"]
    return [*map(printed, fields), f"digest {digest(value)}"]


def _chain(group: Group, cert: Path, trust: Path | None) -> tuple[bytes, ...]:
    """Return the group's certificate chain, held to the group.

    Raises:
        AuthenticityError: it is another key's, says another group, or does not hold.
    """
    found = load_pem(read_file(cert), where=cert.name)
    raw = key_of(found[0], where=cert.name).public_bytes_raw()
    chain = tuple(item.public_bytes(Encoding.DER) for item in found)
    if raw != public_key(group):
        raise _bad("expected the certificate of the group's key", cert)
    if trust is not None:
        leaf = read_trust(trust).identify(chain, wall_now(None))
        says = (leaf.principal, leaf.threshold, leaf.members)
        if says != (group.id, group.threshold, frozenset(group.members)):
            raise _bad("expected a certificate that says the same of the group", cert)
    return chain


def _bad(message: str, cert: Path) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.CERTIFICATE_INVALID, where=cert.name)
