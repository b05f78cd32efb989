# SPDX-License-Identifier: Apache-2.0
"""`authguard keys`: a working trust set-up, and a look at it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.authoring.keys.setup import AUTHORITIES, demo_members, init_folder
from authguard_r.cli.inputs import JsonFlag, load_site, require_robot
from authguard_r.cli.key_answers import init_authorities
from authguard_r.keys.algorithms import Algorithm
from authguard_r.sim.example import bundled_hospital
from authguard_r.wire.output import emit

#: What `--algorithm` takes; the algorithms that then have to sign, each under a root of its own.
_CHOICES: dict[str, tuple[Algorithm, ...]] = {
    **{str(algorithm): (algorithm,) for algorithm in Algorithm},
    "hybrid": (Algorithm.ED25519, Algorithm.ML_DSA_65),
}

#: How long a set-up is valid. A root cannot be renewed, and every machine has to install the next
#: one.
DEMO_DAYS, ROOT_DAYS = 365, 3_650


_FolderArgument = Annotated[Path, typer.Argument(help="A new or empty folder.")]
_DemoOption = Annotated[
    bool,
    typer.Option("--demo/--no-demo", help="Everything in one folder; the root is marked `demo`."),
]
_SiteOption = Annotated[
    Path | None, typer.Option("--site", help="The site model, with the robots.")
]
_RobotOption = Annotated[
    list[str] | None, typer.Option("--robot", help="A robot of the site; repeatable.")
]
_AlgorithmOption = Annotated[
    str,
    typer.Option(
        "--algorithm", help=f"What signs: {', '.join(_CHOICES)} (both ed25519 and ml-dsa-65)."
    ),
]
_AuthoritiesOption = Annotated[
    str | None,
    typer.Option("--authorities", help="With --no-demo: authorities to make (default: all)."),
]
_DaysOption = Annotated[
    int | None,
    typer.Option(
        "--days",
        min=2,
        max=7_300,
        help=f"How long it is all valid (default: {DEMO_DAYS}; with --no-demo: {ROOT_DAYS}).",
    ),
]


def init_command(
    folder: _FolderArgument,
    demo: _DemoOption = True,
    site: _SiteOption = None,
    robot: _RobotOption = None,
    algorithm: _AlgorithmOption = str(Algorithm.ED25519),
    authorities: _AuthoritiesOption = None,
    days: _DaysOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Create root, role authorities, and keys for people, gate, estimator and witness.

    A folder with every private key is not safe: use it only to try things out. With `--no-demo`,
    only the root and the authorities are made, for the authority's own machine.
    """
    if algorithm not in _CHOICES:
        text = f"expected one of {', '.join(_CHOICES)}, got `{algorithm}`"
        raise typer.BadParameter(text, param_hint="--algorithm")
    if not demo:
        if robot:
            text = "an authority's machine has no robot: a gate asks for its certificate itself"
            raise typer.BadParameter(text, param_hint="--robot")
        named = ",".join(AUTHORITIES) if authorities is None else authorities
        return init_authorities(
            folder,
            site=site,
            authorities=named,
            algorithms=_CHOICES[algorithm],
            days=days or ROOT_DAYS,
            as_json=as_json,
        )
    if authorities is not None:
        text = "everything lies in one folder here: with --no-demo"
        raise typer.BadParameter(text, param_hint="--authorities")
    model = load_site(site or bundled_hospital() / "site.yaml")
    rids = tuple(require_robot(model, name) for name in robot or [next(iter(model.robots))])
    members, now = demo_members(model, rids), datetime.now(UTC)
    kinds = _CHOICES[algorithm]
    init_folder(folder, members, now=now, days=days or DEMO_DAYS, algorithms=kinds)
    names = sorted(path.name.removesuffix(".cert.pem") for path in folder.glob("keys/*.cert.pem"))
    lines = [
        f"{folder}: a demo trust set-up (its root says so; a real gate refuses it)",
        *(f"  keys/{name}.key.pem  keys/{name}.cert.pem" for name in names),
    ]
    payload = {"folder": str(folder), "demo": True, "algorithm": algorithm, "principals": names}
    emit(payload, lines, as_json=as_json)
    return 0
