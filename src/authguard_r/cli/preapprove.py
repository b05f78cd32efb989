# SPDX-License-Identifier: Apache-2.0
"""`authguard approvals preapprove`: a class of low-risk actions, before the robot asks.

How-to: docs/howto/approvals.md#pre-approve-low-risk-actions
"""

from __future__ import annotations

from typing import Annotated

import typer

from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.inputs import (
    JsonFlag,
    SiteOption,
    TokenArgument,
    TrustOption,
    load_site,
    wall_now,
)
from authguard_r.cli.offline import CounterOption, OfflineStore
from authguard_r.cli.orders import (
    RobotOption,
    StoreOption,
    TemplateOption,
    manage,
    opened_mission,
    row_lines,
)
from authguard_r.cli.signing_key import CertOption, KeyOption, PassphraseFile, open_signer
from authguard_r.core.approval import PreApproval
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import GrantId
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.token import VerifiedMission, sign_object

_UsesOption = Annotated[
    int, typer.Option("--uses", help="Number of actions; 0 withdraws the pre-approval.", min=0)
]
_RowOption = Annotated[
    list[int] | None, typer.Option("--row", help="Number of a row, from 0; repeatable.", min=0)
]
_MostRiskOption = Annotated[
    int | None, typer.Option("--most-risk", help="The highest risk that is covered.", min=0)
]
_ValidOption = Annotated[
    str | None, typer.Option("--valid", help="How long it is valid: `30 min`.")
]
_YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")]


def preapprove_command(
    token: TokenArgument,
    trust: TrustOption,
    site: SiteOption,
    store: StoreOption,
    grant: Annotated[str, typer.Option("--grant", help="The grant.")],
    uses: _UsesOption,
    row: _RowOption = None,
    most_risk: _MostRiskOption = None,
    valid: _ValidOption = (None),
    *,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    robot: RobotOption = None,
    template: TemplateOption = None,
    yes: _YesOption = False,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Approve low-risk actions before the robot asks: show them, ask, sign and send.

    A pre-approval covers rows of one grant of one mission version, up to a highest risk, a number
    of uses and an end. An action with a risk of tau_2 or more always needs its own approvals.
    """
    verified = opened_mission(token, trust, template)
    at, rows = wall_now(None), tuple(sorted(set(row or ())))
    if uses and (not rows or most_risk is None or valid is None):
        raise typer.BadParameter("name --row, --most-risk and --valid", param_hint="--uses")
    said = PreApproval(
        mid=verified.mission.mid,
        version=verified.mission.version,
        mission=verified.digest,
        rid=verified.mission.rid,
        grant=GrantId(grant),
        rows=rows or (0,),
        most_risk=most_risk or 0,
        uses=uses,
        expires_ms=_end(at.utc_ms, valid or "1 min", verified),
        issued_ms=at.utc_ms,
    )
    model = load_site(site, trust)
    lines = [line for number in rows for line in row_lines(verified.mission, grant, number, model)]
    lines += [
        f"  up to risk {said.most_risk}, {uses} use(s), until {to_timestamp(said.expires_ms)}"
        if uses
        else f"  what you pre-approved of `{grant}` is withdrawn"
    ]
    if not yes:
        confirm_shown(lines, "Pre-approve exactly this?", as_json=as_json)
    signed = sign_object(said, Tag.PREAPPROVAL, open_signer(key, cert, passphrase_file))
    place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
    lines.append("the gate took it in" if uses else "the gate took the withdrawal in")
    return manage(place, lambda m: m.select(signed), lines, as_json=as_json)


def _end(now_ms: int, valid: str, verified: VerifiedMission) -> int:
    """Return when a pre-approval ends.

    Raises:
        MalformedError: no length of time, or longer than the mission.
    """
    asked = CompileQuestions()
    length = asked.integer(valid, "ms", field="--valid")
    asked.require_none()
    end_ms = now_ms + (length or 0)
    if end_ms > verified.expiry_ms:
        text = f"expected an end before the mission's, {verified.mission.expiry}"
        raise MalformedError(text, where="--valid", reason=Reason.VALUE_OUT_OF_RANGE)
    return end_ms
