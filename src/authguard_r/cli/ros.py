# SPDX-License-Identifier: Apache-2.0
"""`authguard ros`: what a robot on ROS 2 needs beside its gate; needs no ROS.

How-to: docs/howto/ros.md
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec import to_builtins

from authguard_r.access.files import read_binding
from authguard_r.cli.inputs import JsonFlag, load_site
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.calls import fitted
from authguard_r.integrations.ros.map import RosMap, read_map
from authguard_r.wire.output import emit

if TYPE_CHECKING:
    from authguard_r.integrations.ros.keycheck import KeystoreFault

MapArgument = Annotated[Path, typer.Argument(metavar="MAP", help="The robot's ROS map.")]


def keystore_command(
    ros_map: MapArgument,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new or empty folder.")],
    as_json: JsonFlag = False,
) -> int:
    """Write a keystore: for each process of the map a key and its permissions.

    The folder of an enclave is for one process and its Unix user. The folder `private` has the
    keys of both authorities: do not copy it to the robot.
    """
    ros = read_map(ros_map)
    require_extra()
    from authguard_r.integrations.ros.keycheck import check_keystore
    from authguard_r.integrations.ros.keystore import ENCLAVES, PRIVATE, make_keystore

    enclaves = make_keystore(ros, folder)
    left = check_keystore(ros, folder)
    if left:  # what was written is read again, by other code than wrote it
        raise MalformedError(f"the keystore is not sound: {left[0].message}", where=left[0].where)
    payload = {
        "keystore": str(folder),
        "domain": ros.domain,
        "enclaves": list(enclaves),
        "authorities": str(folder / PRIVATE),
    }
    lines = [
        f"keystore for {ros.robot}, domain {ros.domain}: {folder}",
        *(f"  {folder / ENCLAVES}{enclave}" for enclave in enclaves),
        f"both authorities' keys are in {folder / PRIVATE}: keep them off the robot",
    ]
    emit(payload, lines, as_json=as_json)
    return 0


def check_command(
    ros_map: MapArgument,
    keystore: Annotated[
        Path | None, typer.Option("--keystore", help="The keystore of the processes.")
    ] = None,
    enclave: Annotated[
        str | None,
        typer.Option("--enclave", help="Check the environment of this shell for this enclave."),
    ] = None,
    binding: Annotated[
        Path | None,
        typer.Option(
            "--binding", help="The gate's binding: a file, or a name from `binding list`."
        ),
    ] = None,
    site: Annotated[Path | None, typer.Option("--site", help="The site model.")] = None,
    as_json: JsonFlag = False,
) -> int:
    """Check that only the gate's process can move the robot; print every fault.

    With --binding and --site, each mediated name must be in the binding; exit 4 with the first
    that is not. With --enclave, the environment of this shell is checked as that enclave's process
    would find it. With --keystore, every enclave in it is checked; exit 1 when one of them could
    move the robot, or when its documents are not signed, not readable or too wide.
    """
    if (binding is None) is not (site is None):
        raise typer.BadParameter("expected both or neither", param_hint="--binding, --site")
    ros = read_map(ros_map)
    if binding is not None and site is not None:
        model = load_site(site)
        fitted(read_binding(binding, model), ros, model)
    faults: list[KeystoreFault] = []
    if keystore is not None or enclave is not None:
        require_extra()
        from authguard_r.integrations.ros.keycheck import check_keystore
        from authguard_r.integrations.ros.security import security_faults

        faults += check_keystore(ros, keystore) if keystore is not None else ()
        faults += security_faults(ros, enclave, os.environ) if enclave is not None else ()
    payload = {
        "robot": str(ros.robot),
        "domain": ros.domain,
        "mediated": {key: item.private for key, item in ros.mediated.items()},
        "binding": None if binding is None else str(binding),
        "keystore": None if keystore is None else str(keystore),
        "faults": [to_builtins(fault) for fault in faults],
    }
    lines = [*_lines(ros, faults, looked=keystore is not None, enclave=enclave)]
    if binding is not None:
        lines.append(f"every mediated name is a way of `{binding}`")
    emit(payload, lines, as_json=as_json)
    return 1 if faults else 0


def _lines(
    ros: RosMap, faults: Iterable[KeystoreFault], *, looked: bool, enclave: str | None
) -> Iterator[str]:
    yield f"{ros.robot}, domain {ros.domain}"
    for key, item in ros.mediated.items():
        yield f"  {key}: {item.kind} {item.public} -> {item.private} ({item.by})"
    found = list(faults)
    for fault in found:
        yield f"{fault.code}: {fault.message} (at {fault.where})"
    if looked and not found:
        yield f"of every enclave there, {ros.enclaves.gate} alone can move the robot"
    elif not looked and enclave is not None and not found:
        yield f"a process with these variables is in {enclave}, its security enforced"
    elif not looked:
        yield "no keystore given: nothing shows who can move the robot"


def require_extra() -> None:
    """Require what reads and writes keystores.

    Raises:
        EnvironmentFault: it is not installed.
    """
    if find_spec("asn1crypto") is None or find_spec("defusedxml") is None:
        raise EnvironmentFault(
            "keystores need the extra: pip install 'authguard-r[ros]'",
            reason=Reason.SETUP_INVALID,
            where="defusedxml",
        )
