# SPDX-License-Identifier: Apache-2.0
"""`authguard advanced frost`: each person's step of a threshold signature, on the own machine.

Only files move between the machines. The steps need the extra `frost`; without it they say so.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.gateway import GateOption
from authguard_r.cli.inputs import JsonFlag, TrustOption
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason

GroupName = Annotated[str, typer.Option("--group", help="The principal that they sign as.")]
ThresholdOption = Annotated[int, typer.Option("--threshold", help="How many sign together.", min=2)]
MembersOption = Annotated[
    list[str], typer.Option("--member", help="A member, in order; repeat for each.")
]
GroupFile = Annotated[Path, typer.Option("--group", help="The group's public file.")]
ShareFile = Annotated[Path, typer.Option("--share", help="Your own secret share.")]
SecretFile = Annotated[Path, typer.Option("--secret", help="Your secret of `dkg offer`.")]
OfferFiles = Annotated[
    list[Path], typer.Option("--offer", help="A member's offer; repeat for each, yours too.")
]
NoncesFolder = Annotated[
    Path, typer.Option("--nonces", help="The folder of your unused nonces; on this machine only.")
]
BallotFile = Annotated[Path, typer.Option("--ballot", help="What is to be signed.")]
CommitmentFiles = Annotated[
    list[Path],
    typer.Option("--commitment", help="The commitment of one who signs; repeat for each."),
]
StoreChoice = Annotated[
    Path | None,
    typer.Option("--store", help="A store that no gate has open; needs --trust and --site."),
]
SiteChoice = Annotated[Path | None, typer.Option("--site", help="The site, with --store.")]
TrustChoice = Annotated[
    Path | None,
    typer.Option("--trust", help="The trust folder; a gate has to prove that it holds its key."),
]
RobotChoice = Annotated[str | None, typer.Option("--robot", help="Which gate, with --store.")]
OutFile = Annotated[Path, typer.Option("--out", help="The file to write; it must be new.")]
OutFolder = Annotated[Path, typer.Option("--out", help="The folder to write into.")]


def deal_command(
    group: GroupName,
    threshold: ThresholdOption,
    member: MembersOption,
    out: OutFolder,
    as_json: JsonFlag = False,
) -> int:
    """Make a group's key and each member's share; the dealer knows all of them (see `dkg`)."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.deal(group, threshold, tuple(member), out, as_json=as_json)


def plan_command(
    group: GroupName,
    threshold: ThresholdOption,
    member: MembersOption,
    out: OutFile,
    as_json: JsonFlag = False,
) -> int:
    """List who makes a key together; every member gets this file."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.plan(group, threshold, tuple(member), out, as_json=as_json)


def offer_command(
    plan: Annotated[Path, typer.Argument(help="The plan.")],
    member: Annotated[str, typer.Option("--as", help="Which member you are.")],
    secret: Annotated[Path, typer.Option("--secret", help="Where your secret goes; keep it.")],
    out: OutFile,
    as_json: JsonFlag = False,
) -> int:
    """Round 1: make your own secret, and an offer for every member."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.offer(plan, member, secret, out, as_json=as_json)


def exchange_command(
    secret: SecretFile, offer: OfferFiles, out: OutFolder, as_json: JsonFlag = False
) -> int:
    """Round 2: check every offer, and make an encrypted contribution for each other member."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.exchange(secret, tuple(offer), out, as_json=as_json)


def finish_command(
    secret: SecretFile,
    offer: OfferFiles,
    contribution: Annotated[
        list[Path],
        typer.Option("--contribution", help="Each contribution made for you; repeatable."),
    ],
    out: OutFolder,
    as_json: JsonFlag = False,
) -> int:
    """Check what the others gave, write your share and the group; destroys the secret."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.finish(secret, tuple(offer), tuple(contribution), out, as_json=as_json)


def protect_command(
    share: Annotated[Path, typer.Argument(help="Your own secret share.")],
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Seal your share with a passphrase, in its place."""
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.protect(share, passphrase_file, as_json=as_json)


def certify_command(
    trust: TrustOption,
    group: GroupFile,
    role: Annotated[str, typer.Option("--role", help="supervisor or safety_officer.")],
    robot: Annotated[
        list[str] | None, typer.Option("--robot", help="A robot it may approve for; repeatable.")
    ] = None,
    region: Annotated[
        list[str] | None, typer.Option("--region", help="A region it may approve in; repeatable.")
    ] = None,
    every_robot: Annotated[bool, typer.Option("--every-robot", help="All robots.")] = False,
    every_region: Annotated[bool, typer.Option("--every-region", help="All regions.")] = False,
    days: Annotated[int, typer.Option("--days", help="How long it is valid.", min=1)] = 365,
    passphrase_file: PassphraseFile = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for scripts.")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Show, ask, and issue the group's certificate; the folder holds the people authority's key."""
    if every_robot == bool(robot) or every_region == bool(region):
        raise typer.BadParameter(
            "name robots or --every-robot, and regions or --every-region", param_hint="--robot"
        )
    robots = None if every_robot else tuple(robot or ())
    regions = None if every_region else tuple(region or ())
    _require_extra()
    from authguard_r.cli import frost_keys

    return frost_keys.certify(
        trust,
        group,
        role=role,
        robots=robots,
        regions=regions,
        days=days,
        passphrase_file=passphrase_file,
        yes=yes,
        as_json=as_json,
    )


def ballot_command(
    counter: Annotated[int, typer.Argument(help="The request's number.", min=1)],
    out: OutFile,
    deny: Annotated[bool, typer.Option("--deny", help="The answer is no.")] = False,
    gate: GateOption = None,
    trust: TrustChoice = None,
    site: SiteChoice = None,
    store: StoreChoice = None,
    robot: RobotChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Write what a group is asked to sign: the answer to an open request."""
    _require_extra()
    from authguard_r.cli import frost_signing

    place = frost_signing.RequestPlace(gate=gate, trust=trust, site=site, store=store, robot=robot)
    return frost_signing.ballot(counter, place, out, deny=deny, as_json=as_json)


def commit_command(
    share: ShareFile,
    nonces: NoncesFolder,
    out: OutFile,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Round 1: make two nonces that are used once, and say what they commit to."""
    _require_extra()
    from authguard_r.cli import frost_signing

    return frost_signing.commit(
        share, nonces, out, passphrase_file=passphrase_file, as_json=as_json
    )


def share_command(
    share: ShareFile,
    nonces: NoncesFolder,
    ballot: BallotFile,
    commitment: CommitmentFiles,
    out: OutFile,
    passphrase_file: PassphraseFile = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for scripts.")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Round 2: show what is signed, ask, and give your part of the signature."""
    _require_extra()
    from authguard_r.cli import frost_signing

    return frost_signing.give(
        share,
        nonces,
        ballot,
        tuple(commitment),
        out,
        passphrase_file=passphrase_file,
        yes=yes,
        as_json=as_json,
    )


def aggregate_command(
    group: GroupFile,
    cert: Annotated[Path, typer.Option("--cert", help="The group's certificate chain.")],
    ballot: BallotFile,
    commitment: CommitmentFiles,
    part: Annotated[
        list[Path], typer.Option("--part", help="A signer's part (`share`); repeat for each.")
    ],
    out: OutFile,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="The trust folder (default: the one that --cert lies in)."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Make the approval token of the parts, or name whose part does not hold."""
    _require_extra()
    from authguard_r.cli import frost_signing

    return frost_signing.aggregate(
        group, cert, ballot, tuple(commitment), tuple(part), out=out, trust=trust, as_json=as_json
    )


def submit_command(
    token: Annotated[Path, typer.Argument(help="An approval token.")],
    why: Annotated[str, typer.Option("--reason", help="For the log; no planner hears of it.")] = "",
    gate: GateOption = None,
    trust: TrustChoice = None,
    site: SiteChoice = None,
    store: StoreChoice = None,
    robot: RobotChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Hand the token in, to a gate or its store; exit 1 when it does not count."""
    _require_extra()
    from authguard_r.cli import frost_signing

    place = frost_signing.RequestPlace(gate=gate, trust=trust, site=site, store=store, robot=robot)
    return frost_signing.submit(token, place, why=why, as_json=as_json)


def show_command(
    file: Annotated[Path, typer.Argument(help="Any file of `authguard advanced frost`.")],
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Say what a file is and whether it holds; secrets are not shown."""
    _require_extra()
    from authguard_r.cli import frost_signing

    return frost_signing.inspect(file, passphrase_file=passphrase_file, as_json=as_json)


def _require_extra() -> None:
    if find_spec("nacl") is None:
        raise EnvironmentFault(
            "threshold signatures need the extra: pip install 'authguard-r[frost]'",
            reason=Reason.STORE_UNAVAILABLE,
            where="nacl",
        )
