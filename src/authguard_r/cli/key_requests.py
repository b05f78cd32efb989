# SPDX-License-Identifier: Apache-2.0
"""`authguard keys request` and `rotate`, on the member's machine: the key stays, a file travels.

How-to: docs/howto/keys.md
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.request import (
    CONFINED,
    OF_ONE_ROBOT,
    OpenedRequest,
    WantedCertificate,
    key_fingerprint,
    make_request,
    open_request,
)
from authguard_r.cli.inputs import JsonFlag, TrustOption, load_site, require_robot, wall_now
from authguard_r.cli.signing_key import (
    KEY_END,
    REQUEST_END,
    CertOption,
    KeyOption,
    PassphraseFile,
    certificate_of,
    open_keys,
    open_signer,
)
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import Digest, PrincipalId, RegionId, RobotId, is_identifier
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, algorithm_of, generate
from authguard_r.keys.certificate import Leaf, Role
from authguard_r.keys.files import write_keys, write_whole
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import ROOT_LISTS, pairs, read_certificates, read_trust
from authguard_r.site.model import profile_digest
from authguard_r.wire.output import emit


class Choice(StrEnum):
    """What the keys of a principal sign with; the authority's roots say which it has to be."""

    ED25519 = "ed25519"
    ML_DSA_44 = "ml-dsa-44"
    ML_DSA_65 = "ml-dsa-65"
    ML_DSA_87 = "ml-dsa-87"
    HYBRID = "hybrid"


AlgorithmOption = Annotated[
    Choice,
    typer.Option("--algorithm", help="`hybrid`: an Ed25519 and an ML-DSA-65 key, both sign."),
]


def chosen(choice: Choice) -> tuple[Algorithm, ...]:
    """Return the algorithm of each root."""
    if choice is Choice.HYBRID:
        return (Algorithm.ED25519, Algorithm.ML_DSA_65)
    return (Algorithm(choice),)


def request_command(
    role: Annotated[Role, typer.Option("--role", help="The role of the key.")],
    principal: Annotated[str, typer.Option("--principal", help="Name of the principal.")],
    out: Annotated[Path, typer.Option("--out", help="The folder for key and request.")],
    robot: Annotated[
        list[str] | None,
        typer.Option("--robot", help="A robot; repeatable. A gate has exactly one."),
    ] = None,
    every_robot: Annotated[
        bool, typer.Option("--every-robot", help="Every robot, instead of --robot.")
    ] = False,
    region: Annotated[
        list[str] | None,
        typer.Option(
            "--region",
            help="A region; repeatable. Roles that give orders need a region and a robot.",
        ),
    ] = None,
    every_region: Annotated[
        bool, typer.Option("--every-region", help="Every region, instead of --region.")
    ] = False,
    site: Annotated[
        Path | None, typer.Option("--site", help="The site model, for the profile of a gate.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option("--template", help="The template of a scheduler.")
    ] = None,
    algorithm: AlgorithmOption = Choice.ED25519,
    key: Annotated[
        Path | None,
        typer.Option("--key", help="An existing key, a file or `pkcs11:` (default: a new key)."),
    ] = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """On the member's machine: make a private key, which stays there, and a certificate request."""
    for name in (principal, *(robot or ()), *(region or ())):
        if not is_identifier(name):
            raise typer.BadParameter(f"expected an identifier, got `{name}`")
    _require_scope(role, robot or [], region or [], every=(every_robot, every_region))
    wanted = WantedCertificate(
        principal=PrincipalId(principal),
        role=role,
        robots=tuple(sorted(map(RobotId, set(robot or ())))),
        every_robot=every_robot,
        regions=tuple(sorted(map(RegionId, set(region or ())))),
        every_region=every_region,
        profile=_profile(role, robot or [], site),
        template=None if template is None else _template(template),
    )
    if key is not None:
        held = open_keys(key, passphrase_file)
        return _send(
            out / f"{principal}{REQUEST_END}", key, make_request(wanted, held), as_json=as_json
        )
    return _ask(out, principal, wanted, chosen(algorithm), before=None, as_json=as_json)


def _template(path: Path) -> Digest:
    from authguard_r.cli.templates import read_template, template_digest

    return template_digest(read_template(path))


def _require_scope(
    role: Role, robots: list[str], regions: list[str], *, every: tuple[bool, bool]
) -> None:
    """Refuse to ask for a certificate that its holder could sign nothing with.

    What is not named is outside. That is said here, before there is a key, and not by a gate that
    refuses the first mission.

    Args:
        role: what the key shall sign.
        robots: those that were named.
        regions: those that were named.
        every: whether every robot was said, and every region.

    Raises:
        typer.BadParameter: what is missing, by its options.
    """
    if role in OF_ONE_ROBOT and (len(set(robots)) != 1 or every[0]):
        raise typer.BadParameter(
            f"the key of a role `{role}` is one robot's: name that one", param_hint="--robot"
        )
    lacks = [
        f"{one} ID (may be repeated) or {all_of_them}"
        for given, one, all_of_them in (
            (robots or every[0], "--robot", "--every-robot"),
            (regions or every[1], "--region", "--every-region"),
        )
        if role in CONFINED and not given
    ]
    if lacks:
        raise typer.BadParameter(
            f"a key in the role `{role}` signs for what its certificate names and nothing else: "
            f"give {', and '.join(lacks)}",
            param_hint=lacks[0].split()[0],
        )


def _profile(role: Role, robots: list[str], site: Path | None) -> Digest | None:
    if role is not Role.GATE:
        return None
    if site is None:
        raise typer.BadParameter("a gate's profile is in its site: name it", param_hint="--site")
    model = load_site(site)
    return profile_digest(model.robots[require_robot(model, robots[0])].profile)


def rotate_command(
    key: KeyOption,
    trust: TrustOption,
    out: Annotated[Path, typer.Option("--out", help="The folder for key and request.")],
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Make the next key of a name, and a request that the present key signs.

    Both keys are valid until the old one is revoked or expires.
    """
    before = open_signer(key, cert, passphrase_file)
    anchor, now = read_trust(trust), wall_now(None)
    leaves = [
        anchor.identify(tuple(c.public_bytes(Encoding.DER) for c in chain), now)
        for chain in pairs(read_certificates(certificate_of(key, cert), most=2 * len(ROOT_LISTS)))
    ]
    leaf = leaves[0]
    if leaf.members:
        raise typer.BadParameter("a group's key is made by its group", param_hint="--key")
    wanted = wanted_of(leaf)
    kinds = tuple(algorithm_of(one.key) for one in leaves)
    name = _next_name(out, leaf.principal)
    return _ask(out, name, wanted, kinds, before=before, as_json=as_json)


def _next_name(out: Path, principal: str) -> str:
    """Return the first name that no key in the folder has: `operator-1.2`, `operator-1.3`..."""
    number = 2
    while (out / f"{principal}.{number}{KEY_END}").exists():
        number += 1
    return f"{principal}.{number}"


def _ask(
    out: Path,
    name: str,
    wanted: WantedCertificate,
    kinds: tuple[Algorithm, ...],
    *,
    before: FileSigner | None,
    as_json: bool,
) -> int:
    """Write key and request; a key that is there already is never written over."""
    path, request = out / f"{name}{KEY_END}", out / f"{name}{REQUEST_END}"
    if path.exists():
        raise EnvironmentFault(
            f"`{path}` is there already: `keys request --key {path}` asks for its certificate, and "
            "`keys rotate` makes the next key of a name that has one",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(path),
        )
    keys = tuple(generate(kind) for kind in kinds)
    data = make_request(wanted, keys, before=before)
    open_request(data)  # what no authority could grant is refused here, not on the other machine
    out.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_keys(path, *keys)
    return _send(request, path, data, as_json=as_json)


def _send(request: Path, path: Path, data: bytes, *, as_json: bool) -> int:
    """Write a request, once it is known that an authority could grant it, and show it."""
    opened = open_request(data)
    request.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_whole(request, data)
    payload = {"key": str(path), "request": str(request), **wanted_json(opened)}
    lines = [
        *card_of(opened),
        f"key      {path}: stays here",
        f"request  {request}: to the authority",
    ]
    emit(payload, lines, as_json=as_json)
    return 0


def wanted_of(leaf: Leaf) -> WantedCertificate:
    """Return what a request for such a certificate says."""
    robots, regions = leaf.scope.robots, leaf.scope.regions
    return WantedCertificate(
        principal=leaf.principal,
        role=leaf.role,
        robots=tuple(sorted(robots or ())),
        every_robot=robots is None,
        regions=tuple(sorted(regions or ())),
        every_region=regions is None,
        profile=leaf.profile,
        template=leaf.template,
    )


def card_of(opened: OpenedRequest) -> list[str]:
    """Return what is asked for, for the person who gives it."""
    wanted = opened.wanted
    scope = [
        ("robots", _words(wanted.robots, every=wanted.every_robot)),
        ("regions", _words(wanted.regions, every=wanted.every_region)),
        ("profile", wanted.profile),
        ("template", wanted.template),
    ]
    return [
        f"name     {wanted.principal}{' (follows a key of this name)' if opened.renews else ''}",
        f"role     {wanted.role}",
        *(f"{name:8} {value}" for name, value in scope if value is not None),
        *(f"key      {algorithm_of(key)} {key_fingerprint(key)}" for key in opened.keys),
    ]


def _words(names: tuple[str, ...], *, every: bool) -> str:
    return "EVERY ONE" if every else ", ".join(names) or "none"


def wanted_json(opened: OpenedRequest) -> dict[str, Any]:
    """Return what is asked for, for programs."""
    wanted = opened.wanted
    return {
        "principal": wanted.principal,
        "role": str(wanted.role),
        "robots": None if wanted.every_robot else list(wanted.robots),
        "regions": None if wanted.every_region else list(wanted.regions),
        "profile": wanted.profile,
        "template": wanted.template,
        "rotates": bool(opened.renews),
        "keys": [
            {"algorithm": str(algorithm_of(key)), "fingerprint": key_fingerprint(key)}
            for key in opened.keys
        ],
    }
