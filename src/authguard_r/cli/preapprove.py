# SPDX-License-Identifier: Apache-2.0
"""`authguard approvals preapprove`: consent to a class of low-risk actions before anybody asks.

How-to: docs/howto/approvals.md#before-anybody-asks
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.inputs import JsonFlag, SiteOption, TrustOption, load_site, wall_now
from authguard_r.cli.mission import TokenArgument
from authguard_r.cli.offline import CounterOption, Kept
from authguard_r.cli.orders import (
    RobotOption,
    StoreOption,
    TemplateOption,
    manage,
    opened_mission,
    row_lines,
)
from authguard_r.cli.signing_key import PassphraseFile, open_signer
from authguard_r.compile.questions import Questions
from authguard_r.core.approval import PreApproval
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import GrantId
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import sign_object


def preapprove_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    grant: Annotated[str, typer.Option("--grant", help="The grant.")],
    row: Annotated[
        list[int], typer.Option("--row", help="A row's number, from 0; may be repeated.", min=0)
    ],
    most_risk: Annotated[
        int, typer.Option("--most-risk", help="The largest risk that is covered.", min=0)
    ],
    uses: Annotated[
        int, typer.Option("--uses", help="Releases that are covered; 0 withdraws.", min=0)
    ],
    valid: Annotated[str, typer.Option("--valid", help="How long it counts: `30 min`.")],
    key: Annotated[Path, typer.Option("--key", help="The approver's key.")],
    cert: Annotated[Path, typer.Option("--cert", help="The key's certificate chain.")],
    passphrase_file: PassphraseFile = None,
    robot: RobotOption = None,
    template: TemplateOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for scripts.")] = False,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Approve, signed, a class of low-risk actions before the robot asks; shows it and asks.

    It covers some rows of one grant of one mission version, so often, for so long, and only
    actions that need one approval: where the risk is tau_2 or more, each needs its own.
    """
    verified = opened_mission(token, trust, template)
    lasts = Questions()
    lasting = lasts.integer(valid, "ms", field="--valid")
    lasts.require_none()
    at, rows = wall_now(None), tuple(sorted(set(row)))
    consent = PreApproval(
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        rid=verified.mission.rid,
        grant=GrantId(grant),
        rows=rows,
        most_risk=most_risk,
        uses=uses,
        expires_ms=at.utc_ms + (lasting or 0),
        issued_ms=at.utc_ms,
    )
    model = load_site(site, trust)
    lines = [line for number in rows for line in row_lines(verified.mission, grant, number, model)]
    lines += [
        f"  up to risk {most_risk}, {uses} time(s), until {to_timestamp(consent.expires_ms)}"
        if uses
        else "  what you approved of this grant before is withdrawn"
    ]
    asks = not yes and sys.stdin.isatty()  # where nobody is, the command is the order
    if asks:
        confirm_shown(lines, "Approve exactly this beforehand?", as_json=as_json)
    signed = sign_object(consent, Tag.PREAPPROVAL, open_signer(key, cert, passphrase_file))
    place = Kept(store=store, trust=trust, site=site, robot=robot, counter=counter)
    return manage(place, lambda m: m.select(signed), [] if asks else lines, as_json=as_json)
