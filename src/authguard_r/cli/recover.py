# SPDX-License-Identifier: Apache-2.0
"""`authguard recover`: a person accepts the store that a gate found to be put back."""

from __future__ import annotations

import os
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.anchoring.evidence import BY_COUNTER, BY_STORE
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.gateway import GateOption, ReadingRole, connected
from authguard_r.cli.inputs import JsonFlag, TrustOption, wall_now
from authguard_r.cli.orders import ORDER_MS
from authguard_r.cli.signing_key import CertOption, OrderKeyOption, PassphraseFile, signer_of
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, StoreClaim, Verb
from authguard_r.keys.signer import FileSigner
from authguard_r.wire.output import emit

#: What else than a witness knows how far the log had come.
_PLACES = {BY_COUNTER: "the counter", BY_STORE: "its own checkpoint"}
#: Who gives the order in a one-folder set-up.
_DEMO = "operator-1"


class _Log(msgspec.Struct):
    size: int
    head: str


class _Anchor(msgspec.Struct):
    state: str
    store: str
    number: int
    why: str = ""
    message: str = ""
    by: str = BY_COUNTER
    counted: int | None = None
    opened: int | None = None


class _Status(msgspec.Struct):
    """What of a gate's status is signed, or shown to the signer."""

    robot: str
    log: _Log
    anchor: _Anchor
    mission: dict[str, Any] | None = None


def recover_command(
    trust: TrustOption,
    gate: GateOption = None,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Accept a store that was restored: show what is missing, ask, and sign the order.

    What the missing part consumed is unknown. The mission stays suspended until `resume`, and
    every other mission must be signed again.
    """
    signer = signer_of(_DEMO, trust, key, cert, passphrase_file)
    with connected(gate, ReadingRole.OPERATOR, trust) as client:
        status = _read(client.status())
        if status.anchor.state != "put_back":
            text = f"the store is {status.anchor.state}: there is nothing to accept"
            raise RefusedError(text, reason=Reason.TRANSITION_REFUSED, where="store")
        if not yes:
            confirm_shown(_lines(status), "Continue with exactly this store?", as_json=as_json)
        accepted = client.accept_store(_signed(status, signer))
    emit({"accepted": accepted}, _told(status, accepted), as_json=as_json)
    return 0


def _read(said: dict[str, Any]) -> _Status:
    try:
        return msgspec.convert(said, _Status)
    except msgspec.ValidationError as error:
        raise MalformedError(f"the gate's status does not say: {error}", where="status") from error


def _signed(status: _Status, signer: FileSigner) -> bytes:
    """Return the order, worth two minutes, about the store as it was shown."""
    log, anchor = status.log, status.anchor
    plain = {"store": anchor.store, "size": log.size, "head": log.head, "number": anchor.number}
    try:
        claim = msgspec.convert(plain, StoreClaim)
    except msgspec.ValidationError as error:
        raise MalformedError(f"the gate's status does not say: {error}", where="status") from error
    command = Command(
        verb=Verb.ACCEPT_STORE,
        mid=MissionId(msgspec.convert(status.robot, MissionId)),
        version=1,
        mission=claim.store,
        nonce=b64(os.urandom(16)),
        expires_ms=wall_now(None).utc_ms + ORDER_MS,
        accepts=claim,
    )
    return sign_object(command, Tag.COMMAND, signer)


def _lines(status: _Status) -> list[str]:
    anchor, log, mission = status.anchor, status.log, status.mission
    seen = "nothing that can be read" if anchor.counted is None else f"{anchor.counted} records"
    place = _PLACES.get(anchor.by, f"the witness `{anchor.by}`")
    opened = "" if anchor.opened is None else f"had {anchor.opened} when this gate started, "
    now = f"{opened}has {log.size} now" if opened else f"has {log.size}"
    held = "no mission is active in it"
    if mission is not None:
        held = f"mission {mission.get('mid')} version {mission.get('version')} is active in it"
    return [
        f"{status.robot}: {anchor.message} ({anchor.why})",
        f"  {place} saw {seen}; this store {now}",
        f"  this store: {anchor.store}",
        f"  ends with:  {log.head}",
        f"  {held}: it stays suspended until it is resumed",
        "  uses, approvals and choices in the lost part are unknown",
    ]


def _told(status: _Status, accepted: dict[str, Any]) -> list[str]:
    lines = [f"{status.robot}: continues with this store, {accepted.get('size')} records"]
    if accepted.get("mission"):
        lines.append(f"{accepted['mission']}: {accepted.get('status')}")
    return lines
