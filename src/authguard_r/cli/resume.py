# SPDX-License-Identifier: Apache-2.0
"""`authguard resume`: a signed order to a running gate, which ends a stop or a suspension."""

from __future__ import annotations

from authguard_r.cli.gateway import (
    GateOption,
    ReadingRole,
    Remote,
    connected,
)
from authguard_r.cli.inputs import JsonFlag, TokenArgument, TrustOption
from authguard_r.cli.orders import (
    TemplateOption,
    opened_mission,
    signed_order,
    simulated_ms,
)
from authguard_r.cli.signing_key import CertOption, OrderKeyOption, PassphraseFile, signer_of
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.output import emit


def resume_command(
    token: TokenArgument,
    trust: TrustOption,
    gate: GateOption = None,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    template: TemplateOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Resume a stopped or suspended mission: sign the order and send it to the running gate."""
    verified = opened_mission(token, trust, template)
    signer = signer_of(verified.mission.issuer, trust, key, cert, passphrase_file)
    with connected(gate, ReadingRole.OPERATOR, trust) as client:
        at_ms = simulated_ms(Remote(client), trust)
        standing = client.command(signed_order(verified, signer, Verb.RESUME, at_ms))
    payload = {"standing": standing, "status": standing.get("status")}
    line = f"{standing.get('mid')} version {standing.get('version')}: {standing.get('status')}"
    emit(payload, [line], as_json=as_json)
    return 0
