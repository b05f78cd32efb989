# SPDX-License-Identifier: Apache-2.0
"""`authguard safety-config`: what is physically safe for a robot, written, shown, signed.

How-to: docs/howto/safety.md
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import to_builtins

from authguard_r.cli.inputs import JsonFlag, NowOption, SiteOption, load_site
from authguard_r.cli.safety_form import SafetyForm, own_envelope, read_form, written
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
from authguard_r.core.quantities import Now
from authguard_r.keys.files import write_whole
from authguard_r.keys.trust import Trust
from authguard_r.operations.checkup.users import user_name
from authguard_r.safety import ExternalChecker, Rule, SafetyConfig, open_config, safety_digest
from authguard_r.safety.config import THE_OBJECT, Executable
from authguard_r.safety.signed import CONFIG_ROLES
from authguard_r.site.formatting import quantity, quoted
from authguard_r.site.source import convert, read_text, read_yaml
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.output import emit

#: What makes no difference to what is safe.
_LABELS = {"id", "version"}


def make_command(
    site: SiteOption,
    robot: Annotated[str, typer.Option("--robot", help="The robot.")],
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    as_json: JsonFlag = False,
) -> int:
    """Create a configuration from the robot's own profile, to edit and sign."""
    own = own_envelope(load_site(site), robot, where="--robot")
    write_whole(out, written(own).encode("utf-8"))
    emit(_payload(own, out), [*card(own), str(out)], as_json=as_json)
    return 0


def sign_command(
    file: Annotated[Path, typer.Argument(help="A configuration as `make` wrote it (YAML).")],
    site: SiteOption,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    out: OutOption = None,
    trust: TrustChoice = None,
    yes: YesOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Show the limits, ask, and sign. The user name of a checker is resolved on this machine."""
    model, where = load_site(site, trust), str(file)
    form = convert(read_yaml(read_text(file), where=where), SafetyForm, where=where)
    config, signer = read_form(form, model, where=where), open_signer(key, cert, passphrase_file)
    changed = _changed(config, own_envelope(model, config.rid, where=where))
    told = f"  unlike the robot's own envelope: {', '.join(changed) or 'nothing'}"
    return sign_kind(
        _KIND,
        config,
        file,
        signer,
        trust=trust,
        out=out,
        yes=yes,
        as_json=as_json,
        card=[*card(config), told],
        more={"changed": changed},
    )


def show_command(
    token: Annotated[Path, typer.Argument(help="A signed configuration.")],
    trust: TrustChoice = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show the limits. With --trust, a gate must accept the configuration."""
    return show_kind(_KIND, token, trust=trust, now=now, as_json=as_json)


def card(config: SafetyConfig) -> list[str]:
    """Return a configuration for the person who signs it, every field of it."""
    near = quantity(config.human_speed_mm_s, "mm/s")
    return [
        f"safety of `{config.rid}`: {config.id}, version {config.version}",
        f"  for the profile {config.profile}",
        f"  speed at most {quantity(config.max_speed_mm_s, 'mm/s')}",
        f"  within {quantity(config.human_distance_mm, 'mm')} of a person at most {near}",
        f"  force at most {quantity(config.max_force_mn, 'mN')}",
        f"  load at most {quantity(config.max_payload_g, 'g')}",
        f"  readings at most {quantity(config.max_age_ms, 'ms')} old",
        f"  keeps out of {', '.join(config.keep_out) or 'no region'}",
        f"  masses: {_table(config.masses_g, 'g') or 'none is known'}",
        f"  lift nothing: {', '.join(config.in_place) or 'no type'}",
        f"  pace of actions without a speed: {_table(config.paced, 'mm/s') or 'no type'}",
        *map(_executable_line, config.executable),
        *([] if config.executable else ["  nothing has to be so before an action"]),
        *map(_rule_line, config.rules),
        *([] if config.rules else ["  no rules over the order of actions"]),
        *_checker_lines(config.checker),
        f"  digest {safety_digest(config)}",
    ]


def _table(values: dict[Any, int], unit: str) -> str:
    return ", ".join(f"{item} {quantity(value, unit)}" for item, value in sorted(values.items()))


def _executable_line(rule: Executable) -> str:
    wanted = "the action's object" if rule.equals == THE_OBJECT else f'"{rule.equals}"'
    return f"  {rule.type} only while {rule.variable} is {wanted}"


def _rule_line(rule: Rule) -> str:
    said = "" if rule.message is None else f", message {quoted(rule.message)}"
    return f"  rule {rule.id}: {quoted(rule.formula)}{said}"


def _checker_lines(checker: ExternalChecker | None) -> Iterator[str]:
    if checker is None:
        yield "  no checker is asked"
        return
    who = "the gate's own user"
    if checker.uid is not None:
        who = f"user {checker.uid} ({user_name(checker.uid) or 'no such user here'})"
    asked = quantity(checker.timeout_ms, "ms")
    yield f"  asks {checker.id} at {checker.socket}, {who}, within {asked}"
    if checker.timeout_ms > LIMITS.safety_ms:
        most = quantity(LIMITS.safety_ms, "ms")
        yield f"    NOT FOR `authguard gate`: it takes a checker that answers within {most}"


def _changed(config: SafetyConfig, own: SafetyConfig) -> list[str]:
    """Return the fields in which a configuration is not the robot's own envelope."""
    fields = (name for name in SafetyConfig.__struct_fields__ if name not in _LABELS)
    return [name for name in fields if getattr(config, name) != getattr(own, name)]


def _payload(config: SafetyConfig, file: Path) -> dict[str, Any]:
    return {"file": str(file), "digest": safety_digest(config), "config": to_builtins(config)}


def _open(data: bytes, trust: Trust, now: Now) -> tuple[SafetyConfig, dict[str, Any]]:
    return open_config(data, verifier=trust, now=now), {}


_KIND = SignedKind(
    tag=Tag.SAFETY,
    type=SafetyConfig,
    roles=CONFIG_ROLES,
    card=card,
    payload=_payload,
    open=_open,
)
