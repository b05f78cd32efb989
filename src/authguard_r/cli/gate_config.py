# SPDX-License-Identifier: Apache-2.0
"""`authguard gate-config`: who may be what at a gate, written, shown, signed.

People name users, a gate knows numbers: names are looked up here, on the machine that the gate runs
on, and shown before a person signs. How-to: docs/howto/gate-config.md
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from authguard_r.access.gate_config import (
    CONFIG_ROLES,
    GateConfig,
    Peer,
    default_config,
    open_gate_config,
    require_mediator,
    require_segments,
    require_witnesses,
)
from authguard_r.anchoring.places import WitnessPlace
from authguard_r.anchoring.sealing.policy import Reader, require_readers, require_retention
from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.gate_peers import every_user, mediators_of, peers_of, user_number
from authguard_r.cli.inputs import JsonFlag, NowOption, wall_now
from authguard_r.cli.readers_form import (
    RetentionForm,
    reader_named,
    readers_of,
    retention_of,
    sealing_card,
    written_readers,
)
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
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Positive, RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.templates import claimed
from authguard_r.keys.files import write_whole
from authguard_r.keys.signer import FileSigner, folder_signer
from authguard_r.keys.trust import Trust, read_file, read_trust
from authguard_r.operations.checkup.advice import Advice, in_demonstration
from authguard_r.operations.checkup.users import config_advice, user_advice, user_name
from authguard_r.site.source import convert, read_text, read_yaml
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import ClientRole, Mode
from authguard_r.wire.output import emit

_SIGNER = "site-authority-1"
_PLAIN = (
    "version",
    "connections",
    "refusals",
    "disclosure",
    "checkpoint_records",
    "quorum",
    "segment_records",
)
#: The bounds as people write them: name, the signed field, its unit.
_BOUNDS = (
    ("planner_silence", "planner_silence_ms", "ms"),
    ("estimator_silence", "estimator_silence_ms", "ms"),
    ("renew_within", "renew_within_ms", "ms"),
    ("stand_within", "stand_within_ms", "ms"),
    ("state_wait", "state_wait_ms", "ms"),
    ("fold", "fold_ms", "ms"),
    ("reserve", "reserve_bytes", "byte"),
    ("checkpoint", "checkpoint_ms", "ms"),
    ("witness_silence", "witness_ms", "ms"),
)
RobotOption = Annotated[str, typer.Option("--robot", help="The robot of the gate.")]


class GateConfigForm(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A configuration as people write it; a bound that is left out has its default, which is shown.

    Args:
        robot: the robot.
        version: grows with each change; the seconds since 1970 at which it is signed when absent.
        peers: roles by user, each a name or a number on the gate's machine.
        mediators: of them, users of an enforcement point alone; no planner runs as one.
        mode: `enforce` or `shadow`.
        connections: most connections of one user.
        refusals: refusals in a row that raise an alert.
        disclosure: how much of a refusal a planner sees.
        planner_silence: as `60 s`; so are the others but `reserve`, which is as `16 MiB`.
        estimator_silence: as above.
        renew_within: as above.
        stand_within: as above.
        state_wait: as above.
        fold: as above.
        reserve: disk kept free.
        checkpoint_records: records after which a checkpoint is made.
        checkpoint: time after which one is made of anything new.
        witnesses: who cosign the checkpoints.
        quorum: how many of them have to.
        witness_silence: as the others.
        segment_records: records in the store from which on the oldest go into a segment.
        readers: who may read which sealed fields of the log; a field without readers is stored
            unsealed.
        retention: how long sealed fields are kept.
    """

    robot: RobotId
    version: int | None = None
    peers: dict[str | int, tuple[ClientRole, ...]]
    mediators: tuple[str | int, ...] = ()
    mode: Mode = Mode.ENFORCE
    connections: Positive | None = None
    refusals: int | None = None
    disclosure: Disclosure | None = None
    planner_silence: Quantity | None = None
    estimator_silence: Quantity | None = None
    renew_within: Quantity | None = None
    stand_within: Quantity | None = None
    state_wait: Quantity | None = None
    fold: Quantity | None = None
    reserve: Quantity | None = None
    checkpoint_records: Positive | None = None
    checkpoint: Quantity | None = None
    witnesses: tuple[WitnessPlace, ...] = ()
    quorum: int | None = None
    witness_silence: Quantity | None = None
    segment_records: int | None = None
    readers: tuple[Reader, ...] = ()
    retention: tuple[RetentionForm, ...] = ()


def make_command(
    robot: RobotOption,
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
    peer: Annotated[
        list[str] | None, typer.Option("--peer", help="USER:ROLE,ROLE; repeatable.")
    ] = None,
    mediator: Annotated[
        list[str] | None,
        typer.Option(
            "--mediator",
            help="USER of a node or gateway, which asks for planners that are other users, and "
            "drives; may be repeated.",
        ),
    ] = None,
    mode: Annotated[
        Mode,
        typer.Option(
            "--mode", help="In `shadow` the gate decides and records, and releases no action."
        ),
    ] = Mode.ENFORCE,
    reader: Annotated[
        list[str] | None,
        typer.Option(
            "--reader", help="ROLE:CLASS,CLASS:KEY of a reader of sealed fields; repeatable."
        ),
    ] = None,
    demo: Annotated[
        bool,
        typer.Option("--demo", help="You may use every role; signed at once. For demonstrations."),
    ] = False,
    trust: TrustChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Create a configuration to edit and sign; with --demo, a signed one."""
    if demo == bool(peer or mediator):
        raise typer.BadParameter("name each user, or say --demo", param_hint="--peer")
    peers = every_user() if demo else peers_of(peer or [])
    form = GateConfigForm(
        robot=_robot(robot),
        peers={**peers, **mediators_of(mediator or [], peers)},
        mediators=tuple(mediator or []),
        mode=mode,
        readers=tuple(map(reader_named, reader or [])),
    )
    config = read_form(form, where="--peer")
    note = []
    if demo:
        write_whole(out, sign_object(config, Tag.GATE, _demo_signer(trust)))
        note = ["DEMONSTRATION: one user has every role, so roles are not separated"]
    else:
        write_whole(out, written(config, form).encode("utf-8"))
    emit(_payload(config, out), [*note, *card(config, demo=demo), str(out)], as_json=as_json)
    return 0


def sign_command(
    file: Annotated[Path, typer.Argument(help="A configuration as `make` wrote it (YAML).")],
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    out: OutOption = None,
    trust: TrustChoice = None,
    yes: YesOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Show who may use which role, ask, and sign.

    Run it on the gate's machine: user names are resolved here.
    """
    where = str(file)
    form = convert(read_yaml(read_text(file), where=where), GateConfigForm, where=where)
    config, signer = read_form(form, where=where), open_signer(key, cert, passphrase_file)
    if form.version is None:
        config = replace(config, version=wall_now(None).utc_ms // 1_000)
    return sign_kind(_KIND, config, file, signer, trust=trust, out=out, yes=yes, as_json=as_json)


def show_command(
    token: Annotated[Path, typer.Argument(help="A signed configuration.")],
    trust: TrustChoice = None,
    now: NowOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show who may use which role. With --trust, the signature must be valid."""
    return show_kind(_KIND, token, trust=trust, now=now, as_json=as_json)


def claimed_config(token: Path) -> GateConfig:
    """Return what a token says, without any claim that it is authentic.

    Raises:
        MalformedError: no canonical token of a gate's configuration.
    """
    return claimed(read_file(token), GateConfig, tag=Tag.GATE)


def open_config(token: Path, trust: Path, *, now: str | None = None) -> GateConfig:
    """Return the configuration in a token for the robot that it names, once its signature holds.

    Raises:
        AuthGuardError: unreadable, not canonical or not authentic.
    """
    robot = claimed_config(token).robot
    return open_gate_config(
        read_file(token), verifier=read_trust(trust), now=wall_now(now), robot=robot
    )


def read_form(form: GateConfigForm, *, where: str) -> GateConfig:
    """Return what people wrote as it is signed: users by number, sorted, quantities in units.

    Raises:
        MalformedError: an unknown user, one user twice, a role twice, a bound that cannot be.
        ClarificationError: a quantity without its unit.
    """
    numbers = {who: user_number(who, where=f"{where}:peers") for who in form.peers}
    twice = [uid for uid, count in Counter(numbers.values()).items() if count > 1]
    if twice:
        raise MalformedError(f"user {twice[0]} comes twice", where=f"{where}:peers")
    mediating = {user_number(who, where=f"{where}:mediators") for who in form.mediators}
    if stray := mediating - set(numbers.values()):
        raise MalformedError(f"user {min(stray)} is not in `peers`", where=f"{where}:mediators")
    peers = tuple(
        Peer(
            uid=uid,
            roles=tuple(sorted(set(form.peers[who]))),
            mediates=uid in mediating,
        )
        for who, uid in sorted(numbers.items(), key=lambda item: item[1])
    )
    plain: dict[str, Any] = to_builtins(default_config(form.robot, peers, form.mode))
    given = {name: getattr(form, name) for name in _PLAIN}
    given |= {
        field: to_integer(value, unit, where=f"{where}:{name}")
        for name, field, unit in _BOUNDS
        if (value := getattr(form, name)) is not None
    }
    plain |= {name: value for name, value in given.items() if value is not None}
    given = {
        "witnesses": form.witnesses,
        "readers": readers_of(form.readers),
        "retention": retention_of(form.retention, where=f"{where}:retention"),
    }
    config = convert({**plain, **to_builtins(given)}, GateConfig, where=where)
    for peer in config.peers:
        require_mediator(peer, where=f"{where}:mediators")
    require_witnesses(config, where=where)
    require_segments(config, where=where)
    require_readers(config.readers, where=f"{where}:readers")
    require_retention(config.retention, config.readers, where=f"{where}:retention")
    return config


def written(config: GateConfig, form: GateConfigForm) -> str:
    """Return a configuration as people edit it."""
    peers = "".join(f"  {who}: [{', '.join(roles)}]\n" for who, roles in form.peers.items())
    units = {"ms": "ms", "byte": "B"}
    bounds = "".join(
        f"{name}: {getattr(config, field)} {units[unit]}\n" for name, field, unit in _BOUNDS
    )
    return (
        f"robot: {config.robot}\nmode: {config.mode}\npeers:\n{peers}"
        f"mediators: [{', '.join(map(str, form.mediators))}]\n"
        + "".join(f"{name}: {getattr(config, name)}\n" for name in _PLAIN[1:])
        + bounds
        + "witnesses: []\n"
        + written_readers(config)
        + "retention: []\n"
    )


def card(config: GateConfig, *, demo: bool = False) -> list[str]:
    """Return a configuration for the person who signs it, with what is doubtful about it.

    Args:
        config: what is to be signed.
        demo: one user has every role on purpose, so that is doubtful and not unsafe.
    """
    advice = map(in_demonstration, _advice(config)) if demo else _advice(config)
    lines = [f"gate of `{config.robot}`, mode `{config.mode}`"]
    for peer in config.peers:
        name = user_name(peer.uid) or "no such user here"
        does = "; mediates: no planner runs as this user" if peer.mediates else ""
        lines.append(f"  {peer.uid:6} {name:20} {', '.join(peer.roles)}{does}")
    bounds = (*_PLAIN, *(field for _, field, _ in _BOUNDS))
    lines += [f"  {name} {getattr(config, name)}" for name in bounds]
    lines += [f"  witness {place.key} at {place.url}" for place in config.witnesses]
    lines += sealing_card(config)
    return [*lines, *(f"{a.level.upper()} {a.message} -> {a.mend}" for a in advice)]


def _advice(config: GateConfig) -> list[Advice]:
    return [*user_advice(config, uid=None), *config_advice(config)]


def _payload(config: GateConfig, file: Path) -> dict[str, Any]:
    return {
        "file": str(file),
        "config": to_builtins(config),
        "users": {str(peer.uid): user_name(peer.uid) for peer in config.peers},
        "advice": [to_builtins(item) for item in _advice(config)],
    }


def _robot(name: str) -> RobotId:
    return convert(name, RobotId, where="--robot")


def _demo_signer(trust: Path | None) -> FileSigner:
    """Return the key of a demonstration's site authority; no other folder holds one."""
    if trust is None:
        raise typer.BadParameter("name the folder with --trust", param_hint="--trust")
    if not read_trust(trust).demo:
        raise EnvironmentFault(
            "the root is not for demonstration; sign with `authguard gate-config sign`",
            reason=Reason.CERTIFICATE_INVALID,
            where=str(trust),
        )
    return folder_signer(trust, _SIGNER)


def _open(data: bytes, trust: Trust, now: Now) -> tuple[GateConfig, dict[str, Any]]:
    robot = claimed(data, GateConfig, tag=Tag.GATE).robot
    return open_gate_config(data, verifier=trust, now=now, robot=robot), {}


_KIND = SignedKind(
    tag=Tag.GATE,
    type=GateConfig,
    roles=CONFIG_ROLES,
    card=card,
    payload=_payload,
    open=_open,
)
