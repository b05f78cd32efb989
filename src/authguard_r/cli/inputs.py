# SPDX-License-Identifier: Apache-2.0
"""What the commands read: files and options, each to its type or a clear error."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from authguard_r.cli.file_kinds import TOKEN, expecting
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import RobotId, Timestamp
from authguard_r.core.quantities import Now, to_ms
from authguard_r.core.reasons import Reason

if TYPE_CHECKING:  # loaded by the functions that read such a file
    from authguard_r.approvals.organization import VerifiedPolicy
    from authguard_r.core.state import AttestedState
    from authguard_r.core.token import VerifiedMission
    from authguard_r.keys.trust import Trust
    from authguard_r.provenance.context import ContextLedger
    from authguard_r.site.model import Site

#: Most bytes of a context file: a day of captions, and no more than memory easily holds.
MAX_CONTEXT = 1 << 24

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
SiteOption = Annotated[
    Path,
    typer.Option(
        "--site", envvar="AUTHGUARD_SITE", help="The site model (YAML, or a signed token)."
    ),
]
TrustOption = Annotated[
    Path,
    typer.Option("--trust", envvar="AUTHGUARD_TRUST", help="The trust folder (`keys init`)."),
]
TokenArgument = Annotated[Path, typer.Argument(help="A signed mission.")]
TokenOption = Annotated[Path, typer.Option("--token", help="A signed mission.")]
BindingOption = Annotated[
    Path,
    typer.Option("--binding", help="The binding: a YAML file, or a name from `binding list`."),
]
RiskPolicyOption = Annotated[
    Path | None,
    typer.Option("--risk-policy", help="The organization's signed risk policy."),
]
WeightOption = Annotated[
    list[str] | None,
    typer.Option("--weight", help="FIELD=N: weight in D_M (default 1); repeatable."),
]
RepairOption = Annotated[
    bool,
    typer.Option("--repair", help="Decide a repair by the safety gate, once for each step."),
]
NowOption = Annotated[
    str | None, typer.Option("--now", help="Use this instant as now: 2026-01-31T14:30:00Z.")
]


def wall_now(text: str | None) -> Now:
    """Return the instant that was asked for, or the machine's."""
    if text is None:
        return Now(time.time_ns() // 1_000_000, 0)
    try:
        timestamp = msgspec.convert(text, Timestamp)
    except msgspec.ValidationError as error:
        raise typer.BadParameter("expected an instant such as 2026-01-31T14:30:00Z") from error
    return Now(to_ms(timestamp, where="--now"), 0)


def read_mission(path: Path, trust: Trust, now: Now) -> VerifiedMission:
    """Return the mission in a token file after steps 1 to 3."""
    from authguard_r.core.token import verify_mission
    from authguard_r.enforcement.inputs import ISSUER_ROLES
    from authguard_r.keys.trust import read_file

    data = read_file(path)
    with expecting(path, data, TOKEN):
        return verify_mission(data, verifier=trust, now=now, roles=ISSUER_ROLES)


def read_risk_policy(path: Path | None, trust: Trust, now: Now) -> VerifiedPolicy | None:
    """Return the organization's policy in a token file; None: none was named.

    Raises:
        MalformedError: no canonical policy, or one that is not sound.
        AuthenticityError: certificate, signature or role does not hold.
    """
    from authguard_r.approvals.organization import open_policy
    from authguard_r.keys.trust import read_file

    return None if path is None else open_policy(read_file(path), verifier=trust, now=now)


def gate_facts(folder: Path, trust: Trust, site: Site, *, now: Now, robot: str | None) -> SiteFacts:
    """Return the site's facts for the gate of this folder, named by its certificate.

    Raises:
        EnvironmentFault: the folder has no gate, or several and none was named.
    """
    from authguard_r.keys.signer import folder_signer
    from authguard_r.site.model import facts_of

    names = sorted(
        path.name.removesuffix(".cert.pem") for path in folder.glob("keys/gate-*.cert.pem")
    )
    wanted = [f"gate-{robot}"] if robot is not None else names
    if len(wanted) != 1:
        raise EnvironmentFault(
            f"expected one gate in `{folder}`, found {len(names)}; name one with --robot",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(folder),
        )
    signer = folder_signer(folder, wanted[0])
    rid, profile = trust.gate_identity(signer.chain, now)
    return facts_of(site, rid=rid, profile=profile)


def require_robot(site: Site, robot: str, *, where: str = "--robot") -> RobotId:
    """Return the id of a robot of the site.

    Args:
        site: the site model.
        robot: the name.
        where: the option that the name comes from.

    Raises:
        typer.BadParameter: the site has no such robot; its robots are named.
    """
    if robot in site.robots:
        return RobotId(robot)
    known = ", ".join(f"`{name}`" for name in sorted(site.robots)) or "none"
    raise typer.BadParameter(
        f"site `{site.id}` has no robot `{robot}`; its robots: {known}", param_hint=where
    )


def gate_robot(folder: Path, robot: str | None) -> RobotId:
    """Return the robot of the folder's one gate, or the one that was named."""
    names = sorted(folder.glob("keys/gate-*.cert.pem"))
    if robot is not None:
        return RobotId(robot)
    if len(names) != 1:
        if not folder.is_dir():
            raise _no_folder(folder)
        raise EnvironmentFault(
            f"expected one gate in `{folder}`, found {len(names)}; name one with --robot",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(folder),
        )
    return RobotId(names[0].name.removeprefix("gate-").removesuffix(".cert.pem"))


def _no_folder(folder: Path) -> EnvironmentFault:
    message = f"the trust folder `{folder}` does not exist; --trust names another"
    return EnvironmentFault(message, reason=Reason.FILE_UNAVAILABLE, where=str(folder))


def read_state(data: bytes, *, facts: SiteFacts, trust: Trust, now: Now) -> AttestedState:
    """Return a state for a what-if: a signed snapshot, or a plain one that claims nothing.

    Raises:
        MalformedError: neither.
        AuthenticityError: a snapshot token whose signature does not hold.
    """
    from authguard_r.core.state import Snapshot, attest
    from authguard_r.core.token import open_token, read_token
    from authguard_r.enforcement.inputs import ESTIMATOR_ROLES
    from authguard_r.normalize.parse import read_json
    from authguard_r.site.source import convert

    if b'"endorsements"' in data:
        read_token(data)
        snapshot, _, _ = open_token(
            data, Snapshot, tag=Tag.STATE, roles=ESTIMATOR_ROLES, verifier=trust, now=now
        )
    else:
        plain = read_json(text_of(data, "state"), where="state")
        snapshot = convert(_without_nulls(plain), Snapshot, where="state")
    return attest(snapshot, facts, arrived_mono_ms=now.mono_ms)


def read_action(plain: Any) -> Action:
    """Return an action from the contract's shape; its labels and meta are not read.

    Raises:
        MalformedError: with the place.
    """
    from authguard_r.site.source import convert

    if not isinstance(plain, dict):
        raise MalformedError("expected an object", where="action")
    claims = {"provenance", "meta"}
    kept = {key: value for key, value in plain.items() if key not in claims and value is not None}
    return convert(kept, Action, where="action")


def read_context(
    path: Path | None, spellings: dict[str, str], *, channels: Mapping[str, str] | None = None
) -> ContextLedger:
    """Return the ledger of everything in a JSON Lines file of `{"channel", "text"}`.

    Args:
        path: the file; None: nothing was seen.
        spellings: external spelling of each place and thing, with its id.
        channels: the site's own channels.

    Raises:
        MalformedError: with the line; the file or a text is too long (`INPUT_TOO_LARGE`).
    """
    from authguard_r.provenance.context import ContextLedger

    ledger = ContextLedger(spellings, channels=channels)
    for number, line in enumerate(_lines(path), 1):
        if line.strip():
            _add_line(ledger, line, where=f"context line {number}")
    return ledger


def _lines(path: Path | None) -> list[str]:
    """Return the lines of a context file."""
    from authguard_r.keys.trust import read_file

    if path is None:
        return []
    data = read_file(path)
    if len(data) > MAX_CONTEXT:
        raise MalformedError(
            f"expected at most {MAX_CONTEXT} bytes, got {len(data)}",
            where=str(path),
            reason=Reason.INPUT_TOO_LARGE,
        )
    return text_of(data, str(path)).splitlines()


def _add_line(ledger: ContextLedger, line: str, *, where: str) -> None:
    from authguard_r.normalize.parse import read_json

    item = read_json(line, where=where)
    if (
        not isinstance(item, dict)
        or set(item) != {"channel", "text"}
        or not all(isinstance(value, str) for value in item.values())
    ):
        raise MalformedError('expected {"channel": ..., "text": ...}', where=where)
    try:
        ledger.add(item["channel"], item["text"])
    except MalformedError as error:
        part = error.where.removeprefix("context.")
        raise MalformedError(
            error.message, where=f"{where}: {part}", reason=error.reason
        ) from error


def text_of(data: bytes, where: str) -> str:
    """Return bytes as text.

    Raises:
        MalformedError: not UTF-8.
    """
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=where) from error


def read_input(path: Path) -> bytes:
    """Return a file's bytes, or standard input's for `-`."""
    from authguard_r.keys.trust import read_file

    return sys.stdin.buffer.read() if str(path) == "-" else read_file(path)


def load_site(path: Path, trust: Path | Trust | None = None, now: Now | None = None) -> Site:
    """Return a sound site model: signed, or plain where a plain one is good enough.

    Args:
        path: a YAML file or a signed token.
        trust: the trust folder, or the root read from it. With it a token's signature must hold,
            and plain YAML is taken only beside a root that says `demo`. Without it nothing is
            enforced, and a token is read like the YAML that it was made of.
        now: the instant at which certificates must be valid; the machine's when absent.

    Raises:
        MalformedError: no site model, or one with faults.
        AuthenticityError: the signature is not valid, or a required signature is missing.
    """
    from authguard_r.access.files import trusted_site
    from authguard_r.keys.trust import read_trust
    from authguard_r.site.source import require_sound

    if trust is None:
        return require_sound(claimed_site(path), where=str(path))
    anchor = read_trust(trust) if isinstance(trust, Path) else trust
    return trusted_site(path, anchor, now)


def claimed_site(path: Path) -> Site:
    """Return the site model in a YAML file or a token, sound or not, and authentic or not."""
    from authguard_r.keys.trust import read_file
    from authguard_r.site.signed import is_token, read_claimed_site
    from authguard_r.site.source import as_text, parse_site

    data = read_file(path)
    if is_token(data):
        return read_claimed_site(data)
    return parse_site(as_text(data, where=str(path)), where=str(path))


def _without_nulls(plain: Any) -> Any:
    if isinstance(plain, dict):
        return {key: _without_nulls(value) for key, value in plain.items() if value is not None}
    return plain
