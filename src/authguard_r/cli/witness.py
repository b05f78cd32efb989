# SPDX-License-Identifier: Apache-2.0
"""`authguard witness`: a program of its own that signs what a log may not take back."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.cli.inputs import JsonFlag, wall_now
from authguard_r.wire.output import emit

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The witness's folder.")]


class WitnessAlgorithm(StrEnum):
    """What a witness can sign with."""

    ED25519 = "ed25519"
    ML_DSA_44 = "ml-dsa-44"


def init_command(
    folder: Folder,
    name: Annotated[
        str, typer.Option("--name", help="Name of the witness, such as a URL without `https://`.")
    ],
    algorithm: Annotated[
        WitnessAlgorithm, typer.Option("--algorithm", help="Signature algorithm.")
    ] = WitnessAlgorithm.ED25519,
    mark: Annotated[
        Path | None,
        typer.Option(
            "--mark", help="File of the change counter, on another medium (default: in DIR)."
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Create a witness with a new key in a new folder; print its verifier key.

    Run this as the user that will serve it. No gate may run as that user.
    """
    from authguard_r.keys.algorithms import Algorithm
    from authguard_r.witness.service import make_witness

    made = make_witness(folder, name=name, algorithm=Algorithm(algorithm), mark=mark)
    payload = {"folder": str(folder), "name": made.name, "key": made.key}
    emit(payload, [made.key], as_json=as_json)
    return 0


def add_command(
    folder: Folder,
    log: Annotated[
        list[str],
        typer.Option("--log", metavar="VKEY", help="A verifier key of the log; repeatable."),
    ],
    replace: Annotated[
        bool,
        typer.Option("--replace", help="Replace the keys of a known log; its history continues."),
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Register a log by its verifier keys (`authguard audit key`). All of them must sign.

    Get the keys from a trusted source, not over the network. Stop the witness first.
    """
    from authguard_r.witness.service import register

    keys, now_s = tuple(log), wall_now(None).utc_ms // 1_000
    done = register(folder, keys, now_s, again=replace)
    line = f"{done.origin}: {'registered' if done.changed else 'known already'}"
    keys_line = f"  {len(done.keys)} keys, which all have to sign" if len(done.keys) > 1 else ""
    emit(msgspec.to_builtins(done), filter(None, (line, keys_line)), as_json=as_json)
    return 0


def forget_command(
    folder: Folder,
    origin: Annotated[str, typer.Argument(metavar="ORIGIN", help="The log's name.")],
    as_json: JsonFlag = False,
) -> int:
    """Remove a log. Once it is registered again, the witness may cosign another history of it.

    Use it only after the robot's operator accepted a restored store. The list of acts keeps it.
    """
    from authguard_r.witness.service import forget

    known = forget(folder, origin, wall_now(None).utc_ms // 1_000)
    lines = [f"{origin}: forgotten; unknown until `authguard witness add`"]
    emit({"origin": origin, "note": known.note}, lines, as_json=as_json)
    return 0


def show_command(folder: Folder, as_json: JsonFlag = False) -> int:
    """Show the logs of a witness, refused requests and acts of operators, also while it serves."""
    from authguard_r.witness.state import read_acts, read_evidence, read_folder

    sight = read_folder(folder)
    evidence, acts = read_evidence(folder), read_acts(folder)
    logs = [_log(known) for known in sight.logs.values() if known.keys]
    payload = {
        "name": sight.identity.name,
        "key": sight.identity.key,
        "logs": logs,
        "evidence": msgspec.to_builtins(evidence),
        "acts": msgspec.to_builtins(acts),
    }
    lines = [sight.identity.key]
    for log in logs:
        lines.append(f"{log['origin']}: {log['size']} records, root {log['root'] or 'none yet'}")
        found = [one.finding for one in evidence if one.origin == log["origin"]]
        lines += [f"  {found.count(kind)} {kind}" for kind in sorted(set(found))]
    lines += [f"{act.act} {act.origin}" for act in acts]
    emit(payload, lines, as_json=as_json)
    return 0


def serve_command(
    folder: Folder,
    listen: Annotated[
        str,
        typer.Option(
            "--listen", metavar="ADDRESS:PORT", help="ADDRESS:PORT; port 0: any free port."
        ),
    ] = "127.0.0.1:0",
    behind_tls: Annotated[
        bool,
        typer.Option(
            "--behind-tls", help="Allow an address that is not loopback, behind a TLS proxy."
        ),
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Answer `POST /add-checkpoint` until SIGTERM; the journal goes to standard error.

    It does not start when other users can read or write the folder, when another process serves
    it, or when its files are missing or older than they were.
    """
    from authguard_r.integrations.http_listener.access import listening
    from authguard_r.wire.json_log import Lines
    from authguard_r.witness.server import LIMITS, WitnessReady, run_witness
    from authguard_r.witness.service import open_witness

    def say(told: WitnessReady) -> None:
        line = f"{told.name}: witnesses {told.logs} logs at {told.url} (pid {told.pid})"
        emit(msgspec.to_builtins(told), [line], as_json=as_json)

    otherwise = "others come through a proxy that ends TLS: --behind-tls"
    with listening(listen, wide=behind_tls, otherwise=otherwise) as made:
        witness = open_witness(folder)
        try:
            run_witness(witness, made, say, journal=Lines(most=LIMITS.lines))
        finally:
            witness.close()
    return 0


def _log(known: Any) -> dict[str, Any]:
    """Return what is known of a log, as it is shown."""
    from authguard_r.audit.note import encode64
    from authguard_r.witness.state import read_log

    log = read_log(known)
    root = encode64(log.root) if known.note else None
    return {
        "origin": known.origin,
        "keys": list(known.keys),
        "size": log.size,
        "root": root,
        "time_s": known.time_s if known.note else None,
        "note": known.note,
    }
