# SPDX-License-Identifier: Apache-2.0
"""`authguard risk-policy`: what the organization demands beside every mission's own policy.

How-to: docs/howto/approvals.md
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import Struct, to_builtins

from authguard_r.approvals.organization import (
    POLICY_ROLES,
    OrganizationPolicy,
    open_policy,
    policy_digest,
    require_sound_policy,
)
from authguard_r.authoring.compile.draft import DraftRisk
from authguard_r.authoring.compile.grants import GrantWords
from authguard_r.authoring.compile.names import names_of
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.authoring.compile.totals import build_risk
from authguard_r.cli.inputs import JsonFlag, NowOption, SiteOption, load_site, wall_now
from authguard_r.cli.signed_kinds import (
    OutOption,
    SignedKind,
    TrustChoice,
    YesOption,
    show_kind,
    sign_kind,
)
from authguard_r.cli.signing_key import CertOption, KeyOption, PassphraseFile, open_signer
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import Identifier, Positive
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.keys.files import write_whole
from authguard_r.keys.trust import Trust
from authguard_r.site import formatting
from authguard_r.site.durations import duration
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_text, read_yaml
from authguard_r.wire.output import emit

_DEFAULTS = """\
  region_tags: {hazardous: 60, private: 40, public: 0, restricted: 30, staff: 5}
  object_classes: {hazardous: 50, medicine: 5}
  privacy: 15
  otherwise: 60
  tau_1: 30
  tau_2: 60
  t: 3
  roles: [safety_officer, supervisor]
  valid: 2 min
"""


class RiskPolicyForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A policy as people write it; `policy` is written like a draft's `risk_policy`."""

    organization: Identifier
    version: Positive
    policy: DraftRisk


def make_command(
    organization: Annotated[str, typer.Option("--organization", help="The organization.")],
    site: SiteOption,
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    version: Annotated[
        int, typer.Option("--version", help="Version; higher with every change.", min=1)
    ] = 1,
    as_json: JsonFlag = False,
) -> int:
    """Create a policy with every action type of the site, to edit and sign."""
    types = ", ".join(f"{name}: 5" for name in sorted(load_site(site).vocabulary))
    text = f"organization: {organization}\nversion: {version}\npolicy:\n  types: {{{types}}}\n"
    write_whole(out, (text + _DEFAULTS).encode("utf-8"))
    policy = _read(out, load_site(site))
    emit(_payload(policy, out), [*card(policy), str(out)], as_json=as_json)
    return 0


def sign_command(
    file: Annotated[Path, typer.Argument(help="A policy as `make` wrote it (YAML).")],
    site: SiteOption,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    out: OutOption = None,
    trust: TrustChoice = None,
    yes: YesOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Show the policy, ask, and sign."""
    policy, signer = _read(file, load_site(site)), open_signer(key, cert, passphrase_file)
    return sign_kind(_KIND, policy, file, signer, trust=trust, out=out, yes=yes, as_json=as_json)


def show_command(
    token: Annotated[Path, typer.Argument(help="A signed policy.")],
    trust: TrustChoice = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show the policy. With --trust, the signature must be valid."""
    return show_kind(_KIND, token, trust=trust, now=now, as_json=as_json)


def card(policy: OrganizationPolicy) -> list[str]:
    """Return a policy for the person who signs it."""
    own = policy.policy
    weights: dict[str, dict[Any, int]] = {
        "type": own.types,
        "region tag": own.region_tags,
        "class": own.object_classes,
    }
    lines = [
        f"risk policy of {policy.organization}, version {policy.version}, issued {policy.issued}",
        "  applies together with every mission's own: the one that asks for more people counts",
        f"  from risk {own.tau_1}: 2 people; from {own.tau_2}: {own.t} people; issuer included",
        f"  may answer, where the mission names them too: {', '.join(own.roles)}",
        f"  a request lives {duration(own.valid_ms)} at most",
        f"  other actions: {own.otherwise}; each step of privacy: {own.privacy}",
    ]
    for what, listed in weights.items():
        told = ", ".join(f"{name} {weight}" for name, weight in sorted(listed.items()))
        lines += [f"  {what}: {told}"] if told else []
    lines += [f"  {p.parameter}: {p.weight} at {p.full_scale}" for p in own.parameters]
    lines += [f"  {s.weight} unless not {formatting.condition(s.guard)}" for s in own.states]
    return [*lines, f"  digest {policy_digest(policy)}"]


def _read(file: Path, site: Site) -> OrganizationPolicy:
    """Return what people wrote as it is signed.

    Raises:
        MalformedError: a word that the site does not know, thresholds out of order.
        ClarificationError: a number is missing.
    """
    where = str(file)
    form = convert(read_yaml(read_text(file), where=where), RiskPolicyForm, where=where)
    asked = CompileQuestions()
    words = GrantWords(site=site, names=names_of(site), rid=None, ceilings={}, asked=asked)
    plain = build_risk(form.policy, words)
    asked.require_none()
    made = {
        "schema": "authguard-r/risk-policy/1",
        "organization": form.organization,
        "version": form.version,
        "issued": to_timestamp(wall_now(None).utc_ms),
        "policy": plain,
    }
    return require_sound_policy(convert(made, OrganizationPolicy, where=where))


def _payload(policy: OrganizationPolicy, file: Path) -> dict[str, Any]:
    return {"file": str(file), "digest": policy_digest(policy), "policy": to_builtins(policy)}


def _open(data: bytes, trust: Trust, now: Now) -> tuple[OrganizationPolicy, dict[str, Any]]:
    opened = open_policy(data, verifier=trust, now=now)
    return opened.policy, {"signer": opened.signer}


_KIND = SignedKind(
    tag=Tag.RISK_POLICY,
    type=OrganizationPolicy,
    roles=POLICY_ROLES,
    card=card,
    payload=_payload,
    open=_open,
)
