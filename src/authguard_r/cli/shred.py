# SPDX-License-Identifier: Apache-2.0
"""`authguard audit shred`: destroy classes of sealed fields, signed, at a gate or on its store."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import to_builtins

from authguard_r.audit.record import NONE
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.gateway import GateOption, ReadingRole, connected
from authguard_r.cli.inputs import JsonFlag, TrustOption, gate_robot, wall_now
from authguard_r.cli.offline import CounterOption, OfflineStore, offline
from authguard_r.cli.orders import ORDER_MS, RobotOption
from authguard_r.cli.signing_key import (
    CertOption,
    OrderKeyOption,
    PassphraseFile,
    require_role,
    signer_of,
)
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.mission import DataClass
from authguard_r.core.token import sign_object
from authguard_r.enforcement.management.shredding import ROLES
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import FileSigner
from authguard_r.site.source import convert
from authguard_r.wire.output import emit

#: Who gives the order in a one-folder set-up.
_DEMO = "site-authority-1"


def shred_command(
    mission: Annotated[str, typer.Argument(help="The mission; `-`: records of no mission.")],
    data: Annotated[
        list[DataClass], typer.Option("--class", help="Class of data to destroy; repeatable.")
    ],
    trust: TrustOption,
    gate: GateOption = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="The robot's store, if no gate runs.")
    ] = None,
    site: Annotated[
        Path | None, typer.Option("--site", help="The site model; required with --store.")
    ] = None,
    robot: RobotOption = None,
    counter: CounterOption = None,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Destroy sealed fields of a log: their keys and their contents, for every reader.

    The chain stays complete, and a record names who ordered it. Copies that were made before, such
    as backups and exports, stay readable: destroy them too.
    """
    classes = tuple(sorted(set(data)))
    signer = signer_of(_DEMO, trust, key, cert, passphrase_file)
    require_role(signer, ROLES, trust)
    if not yes:
        confirm_shown(_lines(mission, classes), "Destroy them?", as_json=as_json)
    if store is None:
        with connected(gate, ReadingRole.OPERATOR, trust) as client:
            status = client.status()
            said = (status.get("robot"), (status.get("anchor") or {}).get("store"))
            done = client.shred(_signed(mission, classes, *map(str, said), signer=signer))
    elif site is None:
        raise typer.BadParameter("needs --site", param_hint="--store")
    else:
        place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
        done = _offline(place, mission, classes, signer)
    count, order = len(done["keys"]), done["order"]
    lines = [f"destroyed: {count} key(s) of {', '.join(classes)}, record {order}"]
    if store is None:
        lines.append("the boxes go in the background: the log says `shredded` at the end")
    emit({"shredding": done}, lines, as_json=as_json)
    return 0


def _offline(
    place: OfflineStore, mission: str, classes: tuple[DataClass, ...], signer: FileSigner
) -> dict[str, Any]:
    """Carry the order out to its end, on a store that no process holds."""
    with offline(place) as gate:
        first = gate.ledger.peek(lambda turn: turn.rows(0, 1))[0][3]
        robot = gate_robot(place.trust, place.robot)
        done = gate.management.shred(_signed(mission, classes, robot, b64(first), signer=signer))
        while gate.management.shred_on():
            pass
    plain: dict[str, Any] = to_builtins(done)
    return plain


def _signed(
    mission: str, classes: tuple[DataClass, ...], robot: str, store: str, *, signer: FileSigner
) -> bytes:
    """Return the order, worth two minutes, about this very log.

    Raises:
        MalformedError: no mission's name, or the gate's status does not say which log it is.
    """
    name = robot if mission == NONE else mission
    command = Command(
        verb=Verb.SHRED,
        mid=convert(name, MissionId, where="MISSION"),
        version=1,
        mission=convert(store, Digest, where="status.anchor.store"),
        nonce=b64(os.urandom(16)),
        expires_ms=wall_now(None).utc_ms + ORDER_MS,
        shreds=classes,
    )
    return sign_object(command, Tag.COMMAND, signer)


def _lines(mission: str, classes: tuple[DataClass, ...]) -> list[str]:
    of = "of no mission" if mission == NONE else f"of mission {mission}"
    return [
        f"sealed fields of {', '.join(classes)}, of the records {of}:",
        "  they become unreadable, and decisions that need them cannot be replayed",
        "  the log stays whole; a record says who ordered this",
    ]
