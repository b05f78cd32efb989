# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`: compile, review, lint, sign, verify; `orders` holds the other acts."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.authoring.compile.answers import compile_answered, read_answers
from authguard_r.authoring.compile.card import OrganizationDemand, card_digest, review
from authguard_r.authoring.compile.difference import compare, is_next
from authguard_r.authoring.compile.lint import Severity, finding_lines, lint
from authguard_r.cli.ask import AnswerOption, NoInputFlag, ask_until, may_ask
from authguard_r.cli.file_kinds import DRAFT, expecting
from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    RiskPolicyOption,
    SiteOption,
    TokenArgument,
    TrustOption,
    load_site,
    read_mission,
    read_risk_policy,
    wall_now,
)
from authguard_r.cli.mission_files import lint_json, mission_digest, read_unverified
from authguard_r.cli.out import risk_policy_json
from authguard_r.core.encoding import Tag, b64, decode, digest, encode, unb64
from authguard_r.core.mission import Mission
from authguard_r.core.token import read_token
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site.formatting import row_words
from authguard_r.site.source import read_text, read_yaml
from authguard_r.wire.output import emit

MissionArgument = Annotated[Path, typer.Argument(help="A mission as `compile` wrote it.")]


def compile_command(
    draft: Annotated[Path, typer.Argument(help="A mission draft (YAML).")],
    site: SiteOption,
    answer: AnswerOption = None,
    no_input: NoInputFlag = False,
    supersedes: Annotated[
        Path | None, typer.Option("--supersedes", help="Token of the previous version.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="File to write.")] = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Compile a draft to a mission, or print the questions that are open (exit 3)."""
    text = read_text(draft)
    plain = _supersede(read_yaml(text, where=str(draft)), supersedes)
    model, at, nonce = load_site(site), wall_now(now), b64(os.urandom(16))

    def compiled(answers: dict[str, object]) -> Mission:
        with expecting(draft, text.encode(), DRAFT):
            return compile_answered(plain, answers, model, now=at, nonce=nonce)

    answers = read_answers(answer or ())
    asks = may_ask(as_json=as_json, no_input=no_input)
    mission = ask_until(compiled, answers) if asks else compiled(answers)
    target = out or draft.with_suffix(".mission.json")
    write_whole(target, encode(mission) + b"\n", mode=PRIVATE)
    hashed, findings, card = mission_digest(mission), lint(mission, model), review(mission, model)
    payload = {
        "file": str(target),
        "digest": hashed,
        "mission": msgspec.to_builtins(mission),
        "card": list(card),
        "card_digest": card_digest(card),
        "lint": lint_json(findings),
    }
    emit(payload, [f"{target}", f"digest {hashed}", *finding_lines(findings)], as_json=as_json)
    return 0


def _supersede(plain: object, token: Path | None) -> object:
    """Return the draft as the version after the one in a token."""
    if token is None or not isinstance(plain, dict):
        return plain
    payload = unb64(read_token(read_file(token)).payload, where="token.payload")
    old = decode(payload, Mission, where="mission")
    return {**plain, "version": old.version + 1, "supersedes": digest(Tag.MISSION, payload)}


def review_command(
    mission: MissionArgument,
    site: SiteOption,
    against: Annotated[
        Path | None, typer.Option("--against", help="The previous version: show what is added.")
    ] = None,
    risk_policy: RiskPolicyOption = None,
    trust: Annotated[
        Path | None, typer.Option("--trust", help="The trust folder, for --risk-policy.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Show the operator's card: what the mission grants, row by row, and what it does not grant."""
    risk = _risk(risk_policy, trust)
    model, new = load_site(site), read_unverified(mission)
    card, findings = review(new, model, demand=_demand(risk)), lint(new, model)
    lines = [*card, *finding_lines(findings)]
    changes: list[str] = []
    supersedes: bool | None = None
    if against is not None:
        old = read_unverified(against)
        supersedes, changes = is_next(old, new), list(compare(old, new, model))
        head = ["Against the version before:"] if supersedes else _not_next(old, new)
        lines = [*head, *(f"  {c}" for c in changes), *lines]
    payload: dict[str, Any] = {
        "card": list(card),
        "card_digest": card_digest(card),
        "changes": changes,
        "supersedes": supersedes,
        "digest": mission_digest(new),
        "lint": lint_json(findings),
        "risk_policy": risk_policy_json(risk),
    }
    emit(payload, lines, as_json=as_json)
    return 0


def _risk(policy: Path | None, trust: Path | None) -> VerifiedPolicy | None:
    """Return the organization's policy, once its signature holds; None: none was named."""
    if trust is None:
        if policy is not None:
            raise typer.BadParameter("needs --trust", param_hint="--risk-policy")
        return None
    if policy is None:
        raise typer.BadParameter("needs --risk-policy", param_hint="--trust")
    return read_risk_policy(policy, read_trust(trust), wall_now(None))


def _demand(risk: VerifiedPolicy | None) -> OrganizationDemand | None:
    """Return what the card shows of an organization's policy."""
    if risk is None:
        return None
    own = risk.policy
    return OrganizationDemand(organization=own.organization, version=own.version, policy=own.policy)


def check_command(
    mission: MissionArgument,
    site: SiteOption,
    strict: Annotated[bool, typer.Option("--strict", help="Fail on warnings too.")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Check a mission for mistakes and risks; exit 1 when there is an error."""
    opened = read_unverified(mission)
    findings = lint(opened, load_site(site))
    failed = [f for f in findings if strict or f.severity is Severity.ERROR]
    payload = {"lint": lint_json(findings), "digest": mission_digest(opened)}
    lines = finding_lines(findings) or ["no findings; next: authguard mission sign"]
    emit(payload, lines, as_json=as_json)
    return 1 if failed else 0


def verify_command(
    token: TokenArgument, trust: TrustOption, now: NowOption = None, as_json: JsonFlag = False
) -> int:
    """Verify certificate, signature and schema of a mission; print who signed it."""
    at = wall_now(now)
    verified = read_mission(token, read_trust(trust), at)
    in_time = verified.not_before_ms <= at.utc_ms <= verified.expiry_ms
    payload = {
        "valid": True,
        "in_time": in_time,
        "mid": verified.mission.mid,
        "version": verified.mission.version,
        "digest": verified.digest,
        "issuer": verified.issuer.id,
        "role": verified.issuer.role,
    }
    lines = [
        f"authentic: {verified.mission.mid} version {verified.mission.version}",
        f"signed by {verified.issuer.id} ({verified.issuer.role})",
        f"digest {verified.digest}",
        "valid now" if in_time else "NOT VALID NOW: it authorizes nothing",
    ]
    emit(payload, lines, as_json=as_json)
    return 0 if in_time else 1


def show_command(token: TokenArgument, as_json: JsonFlag = False) -> int:
    """Print the mission in a token. The signature is not verified."""
    opened = read_token(read_file(token))
    mission = decode(unb64(opened.payload, where="token.payload"), Mission, where="mission")
    payload = {"mission": msgspec.to_builtins(mission), "digest": mission_digest(mission)}
    lines = [json.dumps(payload["mission"], indent=2), *_numbered(mission), "(not verified)"]
    emit(payload, lines, as_json=as_json)
    return 0


def diff_command(
    old: TokenArgument,
    new: Annotated[Path, typer.Argument(help="The next version.")],
    site: SiteOption,
    as_json: JsonFlag = False,
) -> int:
    """Show what a new version changes; wider permissions first."""
    before, after = read_unverified(old), read_unverified(new)
    supersedes, changes = is_next(before, after), list(compare(before, after, load_site(site)))
    head = [] if supersedes else _not_next(before, after)
    emit({"supersedes": supersedes, "changes": changes}, [*head, *changes], as_json=as_json)
    return 0


def _not_next(old: Mission, new: Mission) -> list[str]:
    """Say that no gate takes the one as the other's next version."""
    was, now = f"`{old.mid}` version {old.version}", f"`{new.mid}` version {new.version}"
    return [f"not the next version of {was}: {now} does not supersede its digest"]


def _numbered(mission: Mission) -> Iterator[str]:
    """Say the rows by the numbers that `choose --row` takes."""
    for grant in mission.actions:
        yield f"{grant.id}: {grant.type}, chosen by {grant.chooser}"
        yield from (f"  row {n}: {row_words(row)}" for n, row in enumerate(grant.alternatives))
