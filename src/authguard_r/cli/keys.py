# SPDX-License-Identifier: Apache-2.0
"""`authguard keys`: a working trust set-up, and a look at it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from cryptography import x509

from authguard_r.assembly import demo_members
from authguard_r.cli.inputs import JsonFlag, load_site, wall_now
from authguard_r.cli.out import emit
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.keys.setup import init_folder
from authguard_r.keys.trust import read_trust
from authguard_r.sim.example import bundled_hospital

app = typer.Typer(help="Keys, certificates and trust roots.", no_args_is_help=True)


@app.command("init")
def init(
    folder: Annotated[Path, typer.Argument(help="A new or empty folder.")],
    demo: Annotated[
        bool, typer.Option("--demo/--no-demo", help="Everything in one folder; its root says so.")
    ] = True,
    site: Annotated[
        Path | None, typer.Option("--site", help="The site whose robots get a gate certificate.")
    ] = None,
    robot: Annotated[
        list[str] | None, typer.Option("--robot", help="A robot of the site; may be repeated.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Write a root, role authorities, and keys for people, robot gate, estimator and witness.

    One folder that holds every private key protects nothing: use it to try things out.
    """
    if not demo:
        raise EnvironmentFault(
            "a set-up over several machines is not built yet; `--demo` makes one folder",
            reason=Reason.STORE_UNAVAILABLE,
            where="--no-demo",
        )
    model = load_site(site or bundled_hospital() / "site.yaml")
    rids = tuple(RobotId(name) for name in robot or [next(iter(model.robots))])
    unknown = [rid for rid in rids if rid not in model.robots]
    if unknown:
        raise typer.BadParameter(f"the site has no robot `{unknown[0]}`", param_hint="--robot")
    init_folder(folder, demo_members(model, rids), now=datetime.now(UTC))
    names = sorted(path.name.removesuffix(".cert.pem") for path in folder.glob("keys/*.cert.pem"))
    lines = [
        f"{folder}: a demo trust set-up (its root says so; a real gate refuses it)",
        *(f"  keys/{name}.key.pem  keys/{name}.cert.pem" for name in names),
    ]
    payload = {"folder": str(folder), "demo": True, "principals": names}
    emit(payload, lines, as_json=as_json)
    return 0


@app.command("show")
def show(
    folder: Annotated[Path, typer.Argument(help="A trust folder.")],
    as_json: JsonFlag = False,
) -> int:
    """List who may sign what, until when, and whether each certificate holds now."""
    trust, now = read_trust(folder), wall_now(None)
    found: list[dict[str, Any]] = []
    for path in sorted(folder.glob("keys/*.cert.pem")):
        chain = x509.load_pem_x509_certificates(path.read_bytes())
        leaf = trust.identify(tuple(c.public_bytes(_der()) for c in chain), now)
        found.append(
            {
                "principal": leaf.principal,
                "role": str(leaf.role),
                "robot": leaf.robot,
                "serial": str(leaf.serial),
                "until": f"{chain[0].not_valid_after_utc:%Y-%m-%dT%H:%M:%SZ}",
            }
        )
    lines = [f"{f['principal']:24} {f['role']:16} until {f['until']}" for f in found]
    emit({"demo": trust.demo, "principals": found}, lines, as_json=as_json)
    return 0


def _der() -> Any:
    from cryptography.hazmat.primitives.serialization import Encoding

    return Encoding.DER
