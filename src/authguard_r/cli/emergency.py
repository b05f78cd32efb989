# SPDX-License-Identifier: Apache-2.0
"""`authguard emergency`: a policy of narrow capabilities, written, checked, signed; and a call.

How-to: docs/howto/emergency.md
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import Struct, to_builtins

from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.gateway import GateOption, ProofOption, ReadingRole, connected
from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    SiteOption,
    TrustOption,
    load_site,
    require_robot,
    wall_now,
)
from authguard_r.cli.signed_kinds import OutOption, SignedKind, YesOption, sign_kind
from authguard_r.cli.signing_key import CertOption, OrderKeyOption, PassphraseFile, signer_of
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import (
    ActionType,
    Count,
    Identifier,
    ParameterId,
    Positive,
    RegionId,
    RobotId,
    ToolId,
    VariableId,
)
from authguard_r.core.mission import Comparison, Guard
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.emergency.lint import lint_policy
from authguard_r.enforcement.emergency.opened import POLICY_ROLES, open_emergency
from authguard_r.enforcement.emergency.policy import (
    Aim,
    Caller,
    Capability,
    EmergencyPolicy,
    Missing,
)
from authguard_r.enforcement.templates import claimed
from authguard_r.keys.files import write_whole
from authguard_r.keys.trust import read_file, read_trust
from authguard_r.site.model import Site, profile_digest, site_digest
from authguard_r.site.source import convert, read_text, read_yaml
from authguard_r.wire.output import emit

_SIGNER = "safety-officer-1"
_DAY_MS = int(timedelta(days=1).total_seconds()) * 1_000
FileArgument = Annotated[Path, typer.Argument(help="A policy (YAML).")]


class GuardForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A guard as people write it; `max_age` as `500 ms`."""

    variable: VariableId
    comparison: Comparison
    value: int | bool | str
    max_age: Quantity


class Ability(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A capability as people write it; see `emergency.policy.Capability`."""

    id: Identifier
    aim: Aim
    type: ActionType
    tool: ToolId
    guards: tuple[GuardForm, ...]
    callers: tuple[Caller, ...]
    max: Quantity
    per_hour: Positive
    destination: RegionId | None = None
    params: dict[ParameterId, Quantity] = {}
    regions: tuple[RegionId, ...] = ()
    place_max_age: Quantity = "0 ms"
    without: tuple[Missing, ...] = ()
    after_stop: bool = False
    past_safety: bool = False


class EmergencyForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A policy as people write it.

    Args:
        id: its name.
        version: grows with each change.
        robot: the robot.
        days: how long it counts from its signing.
        capabilities: what it allows.
    """

    id: Identifier
    version: Count
    robot: RobotId
    days: Positive
    capabilities: tuple[Ability, ...]


def make_command(
    site: SiteOption,
    robot: Annotated[str, typer.Option("--robot", help="The robot.")],
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    as_json: JsonFlag = False,
) -> int:
    """Create a policy to edit and sign: a route to each emergency place, and a call for help."""
    model = load_site(site)
    text = "".join(_written(model, require_robot(model, robot)))
    write_whole(out, text.encode("utf-8"))
    note = "decide on every guard, and on who may call, before you sign"
    emit({"file": str(out)}, [note, str(out)], as_json=as_json)
    return 0


def check_command(file: FileArgument, site: SiteOption, as_json: JsonFlag = False) -> int:
    """Check a policy and print everything that a gate would refuse."""
    model = load_site(site)
    found = lint_policy(_read(file, model, now_ms=wall_now(None).utc_ms), model)
    lines = [f"{unsound.where}: {unsound.message}" for unsound in found]
    emit({"findings": to_builtins(found)}, lines or ["nothing is open"], as_json=as_json)
    return 1 if found else 0


def sign_command(
    file: FileArgument,
    site: SiteOption,
    trust: TrustOption,
    key: OrderKeyOption = None,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    out: OutOption = None,
    yes: YesOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Show what a robot may do without a mission, ask, and sign. An invalid policy is refused."""
    model = load_site(site, trust)
    signer = signer_of(_SIGNER, trust, key, cert, passphrase_file)
    policy = _read(file, model, now_ms=wall_now(None).utc_ms)
    for unsound in lint_policy(policy, model):
        raise MalformedError(unsound.message, where=unsound.where, reason=Reason.SCHEMA_INVALID)
    return sign_kind(_KIND, policy, file, signer, trust=trust, out=out, yes=yes, as_json=as_json)


def show_command(
    token: Annotated[Path, typer.Argument(help="A signed policy.")],
    trust: Annotated[Path | None, typer.Option("--trust", help="The trust folder.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="The site model.")] = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show a policy. With --trust and --site, a gate must accept it."""
    if (trust is None) is not (site is None):
        raise typer.BadParameter("--trust and --site go together", param_hint="--trust")
    policy = claimed_policy(read_file(token))
    note = ["not verified: name --trust and --site"]
    if trust is not None and site is not None:
        at, model = wall_now(now), load_site(site, trust)
        anchor, data = read_trust(trust), read_file(token)
        open_emergency(data, verifier=anchor, now=at, site=model, robot=policy.robot)
        note = []
    payload = {"policy": to_builtins(policy), "valid": None if note else True}
    emit(payload, [*note, *_card(policy)], as_json=as_json)
    return 0


def call_command(
    capability: Annotated[str, typer.Argument(help="The capability's id.")],
    gate: GateOption = None,
    trust: ProofOption = None,
    key: Annotated[
        str | None,
        typer.Option("--call", help="Name of the call; a repeated name is the same call."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Call a capability of the gate's emergency policy as an operator; wait until it ends."""
    name = convert(capability, Identifier, where="CAPABILITY")
    with connected(gate, ReadingRole.OPERATOR, trust) as client:
        told = client.emergency(name, key=key)
    emit(told, list(_told_lines(told)), as_json=as_json)
    succeeded = told["execution"]["outcome"] == "succeeded"
    return 0 if succeeded else 1


def _told_lines(told: dict[str, Any]) -> Iterator[str]:
    execution = told["execution"]
    if told["outcome"] != "accept":
        yield f"{told['capability']}: refused: {', '.join(told['reasons'] + told['hazards'])}"
        for found in told["findings"]:
            yield f"  {found['field']}: expected {found['expected']}, got {found['got']}"
        return
    why = f" ({', '.join(execution['reasons'])})" if execution["reasons"] else ""
    yield f"{told['capability']}: {execution['outcome']}{why}"
    if not execution["recorded"]:
        yield "  WARNING: its end could not be recorded"


def claimed_policy(data: bytes) -> EmergencyPolicy:
    """Return what a token says, without any claim that it is authentic.

    Raises:
        MalformedError: no canonical token of an emergency policy.
    """
    return claimed(data, EmergencyPolicy, tag=Tag.EMERGENCY_POLICY)


def _read(file: Path, site: Site, *, now_ms: int) -> EmergencyPolicy:
    """Return what people wrote as it is signed: quantities in units, digests filled in.

    Raises:
        MalformedError: not a policy as people write it.
        ClarificationError: a quantity without its unit.
    """
    where = str(file)
    form = convert(read_yaml(read_text(file), where=where), EmergencyForm, where=where)
    if form.robot not in site.robots:
        raise MalformedError(f"the site has no robot `{form.robot}`", where=f"{where}:robot")
    capabilities = [
        _capability(ability, site, where=f"{where}:capabilities[{number}]")
        for number, ability in enumerate(form.capabilities)
    ]
    return convert(
        {
            "schema": "authguard-r/emergency-policy/1",
            "id": form.id,
            "version": form.version,
            "robot": form.robot,
            "profile": profile_digest(site.robots[form.robot].profile),
            "site": site_digest(site),
            "not_before": to_timestamp(now_ms),
            "expiry": to_timestamp(now_ms + form.days * _DAY_MS),
            "capabilities": capabilities,
        },
        EmergencyPolicy,
        where=where,
    )


def _capability(ability: Ability, site: Site, *, where: str) -> Any:
    model = site.vocabulary.get(ability.type)
    units = {} if model is None else {name: kind.unit for name, kind in model.params.items()}
    params = {
        name: to_integer(value, units[name], where=f"{where}.params.{name}")
        if name in units
        else value
        for name, value in ability.params.items()
    }
    guards = tuple(
        Guard(
            variable=condition.variable,
            comparison=condition.comparison,
            value=condition.value,
            max_age_ms=to_integer(condition.max_age, "ms", where=f"{where}.guards.max_age"),
        )
        for condition in ability.guards
    )
    return to_builtins(
        {
            **{name: getattr(ability, name) for name in _SAME},
            "params": params,
            "guards": guards,
            "callers": sorted(ability.callers),
            "without": sorted(ability.without),
            "max_ms": to_integer(ability.max, "ms", where=f"{where}.max"),
            "place_max_age_ms": to_integer(
                ability.place_max_age, "ms", where=f"{where}.place_max_age"
            ),
            **({} if ability.destination is None else {"destination": ability.destination}),
        }
    )


_SAME = ("id", "aim", "type", "tool", "regions", "per_hour", "after_stop", "past_safety")


def _card(policy: EmergencyPolicy) -> Iterator[str]:
    """Say what a policy allows, capability by capability."""
    yield f"{policy.id} version {policy.version}: {policy.robot}, until {policy.expiry}"
    for capability in policy.capabilities:
        yield from _ability_lines(capability)


def _ability_lines(capability: Capability) -> Iterator[str]:
    goal = f" to {capability.destination}" if capability.destination else ""
    params = "".join(f", {name} {value}" for name, value in sorted(capability.params.items()))
    yield f"  {capability.id}: {capability.type} with {capability.tool}{goal}{params}"
    each = "each " if len(capability.callers) > 1 else ""
    often = f"{each}{capability.per_hour} times an hour"
    yield f"    called by {', '.join(capability.callers)}, {often}"
    for guard in capability.guards:
        yield (
            f"    while {guard.variable} {guard.comparison} {guard.value}, "
            f"at most {guard.max_age_ms} ms old"
        )
    if capability.regions:
        yield f"    within {', '.join(capability.regions)}"
    yield f"    without {', '.join(capability.without) or 'nothing missing'}"
    if capability.after_stop:
        yield "    ALSO AFTER AN OPERATOR'S STOP"
    if capability.past_safety:
        yield "    ALSO WHEN THE SAFETY GATE CALLS IT UNSAFE"


def _written(site: Site, robot: RobotId) -> Iterator[str]:
    """Return a policy to look through, in YAML."""
    yield f"id: {robot}-emergency\nversion: 1\nrobot: {robot}\ndays: 90\ncapabilities:\n"
    tools = site.robots[robot].profile.tools
    ways = [
        (kind, model)
        for kind, model in site.vocabulary.items()
        if model.moves and "destination" in model.fields and tools.get(kind)
    ]
    places = sorted(site.emergency.places) if site.emergency is not None else []
    for place in places if ways else ():
        kind, model = ways[0]
        params = ", ".join(
            f"{name}: {min(300, p.high)} {p.unit}" for name, p in model.params.items()
        )
        yield (
            f"  - id: go-{place}\n    aim: safe_place\n    type: {kind}\n"
            f"    tool: {tools[kind][0]}\n    destination: {place}\n    params: {{{params}}}\n"
            f"    regions: [{', '.join(sorted(site.regions))}]\n    place_max_age: 500 ms\n"
            f"{_GUARDED}    max: 5 min\n    per_hour: 2\n"
        )
    if tools.get(ActionType("announce")):
        yield (
            f"  - id: call-help\n    aim: call_help\n    type: announce\n"
            f"    tool: {tools[ActionType('announce')][0]}\n{_GUARDED}"
            "    max: 10 s\n    per_hour: 10\n"
        )


#: A person who knows the robot decides what an emergency is: this is an example.
_GUARDED = (
    "    guards:\n"
    "      - {variable: battery_permille, comparison: le, value: 150, max_age: 500 ms}\n"
    "    callers: [operator, planner]\n    without: [mission]\n"
)


_KIND = SignedKind(
    tag=Tag.EMERGENCY_POLICY,
    type=EmergencyPolicy,
    roles=POLICY_ROLES,
    card=lambda policy: list(_card(policy)),
    payload=lambda policy, file: {"policy": to_builtins(policy), "file": str(file)},
)
