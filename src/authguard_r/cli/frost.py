# SPDX-License-Identifier: Apache-2.0
"""`authguard advanced frost`: each person's step of a threshold signature, on the own machine.

Only files move between the machines. The steps need the extra `frost`; without it they say so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.gateway import GateOption
from authguard_r.cli.inputs import JsonFlag, TrustOption
from authguard_r.cli.signing_key import PassphraseFile

GroupName = Annotated[str, typer.Option("--group", help="The name of the group.")]
ThresholdOption = Annotated[
    int, typer.Option("--threshold", help="Number of members that must sign.", min=2)
]
MembersOption = Annotated[
    list[str], typer.Option("--member", help="A member; repeat for each, in order.")
]
GroupFile = Annotated[Path, typer.Option("--group", help="The group's public file.")]
ShareFile = Annotated[Path, typer.Option("--share", help="Your own secret share.")]
SecretFile = Annotated[Path, typer.Option("--secret", help="Your secret of `dkg offer`.")]
OfferFiles = Annotated[
    list[Path], typer.Option("--offer", help="Offer of a member; repeat for each, yours too.")
]
NoncesFolder = Annotated[
    Path, typer.Option("--nonces", help="Folder of your unused nonces; only on this machine.")
]
BallotFile = Annotated[Path, typer.Option("--ballot", help="The ballot.")]
CommitmentFiles = Annotated[
    list[Path],
    typer.Option("--commitment", help="Commitment of a signer; repeat for each."),
]
StoreChoice = Annotated[
    Path | None,
    typer.Option("--store", help="A store that no gate has open; needs --trust and --site."),
]
SiteChoice = Annotated[Path | None, typer.Option("--site", help="The site model, with --store.")]
TrustChoice = Annotated[
    Path | None,
    typer.Option("--trust", help="The trust folder: a gate must prove its identity."),
]
RobotChoice = Annotated[str | None, typer.Option("--robot", help="The robot, with --store.")]
OutFile = Annotated[Path, typer.Option("--out", help="The file to write; it must be new.")]
OutFolder = Annotated[Path, typer.Option("--out", help="Folder for the files.")]


def deal_command(
    group: GroupName,
    threshold: ThresholdOption,
    member: MembersOption,
    out: OutFolder,
    as_json: JsonFlag = False,
) -> int:
    """Make a group's key and each member's share. The dealer knows all shares (see `dkg`)."""
    from authguard_r.cli import frost_keys

    return frost_keys.deal(group, threshold, tuple(member), out, as_json=as_json)


def plan_command(
    group: GroupName,
    threshold: ThresholdOption,
    member: MembersOption,
    out: OutFile,
    as_json: JsonFlag = False,
) -> int:
    """List who makes a key together. Every member needs this file."""
    from authguard_r.cli import frost_keys

    return frost_keys.plan(group, threshold, tuple(member), out, as_json=as_json)


def offer_command(
    plan: Annotated[Path, typer.Argument(help="The plan.")],
    member: Annotated[str, typer.Option("--as", help="Your own name.")],
    secret: Annotated[
        Path, typer.Option("--secret", help="File for your secret; store it safely.")
    ],
    out: OutFile,
    as_json: JsonFlag = False,
) -> int:
    """Round 1: make your own secret, and an offer for every member."""
    from authguard_r.cli import frost_keys

    return frost_keys.offer(plan, member, secret, out, as_json=as_json)


def exchange_command(
    secret: SecretFile, offer: OfferFiles, out: OutFolder, as_json: JsonFlag = False
) -> int:
    """Round 2: check every offer, and make an encrypted contribution for each other member."""
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
    """Check the contributions of the others, write your share and the group; destroy the secret."""
    from authguard_r.cli import frost_keys

    return frost_keys.finish(secret, tuple(offer), tuple(contribution), out, as_json=as_json)


def protect_command(
    share: Annotated[Path, typer.Argument(help="Your own secret share.")],
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Encrypt your share with a passphrase, in its place."""
    from authguard_r.cli import frost_keys

    return frost_keys.protect(share, passphrase_file, as_json=as_json)


def certify_command(
    trust: TrustOption,
    group: GroupFile,
    role: Annotated[str, typer.Option("--role", help="supervisor or safety_officer.")],
    robot: Annotated[list[str] | None, typer.Option("--robot", help="A robot; repeatable.")] = None,
    region: Annotated[
        list[str] | None, typer.Option("--region", help="A region; repeatable.")
    ] = None,
    every_robot: Annotated[bool, typer.Option("--every-robot", help="All robots.")] = False,
    every_region: Annotated[bool, typer.Option("--every-region", help="All regions.")] = False,
    days: Annotated[int, typer.Option("--days", help="Days of validity.", min=1)] = 365,
    passphrase_file: PassphraseFile = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Show, ask, and issue the group's certificate. It needs the people authority's key."""
    if every_robot == bool(robot) or every_region == bool(region):
        raise typer.BadParameter(
            "name robots or --every-robot, and regions or --every-region", param_hint="--robot"
        )
    robots = None if every_robot else tuple(robot or ())
    regions = None if every_region else tuple(region or ())
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
    deny: Annotated[bool, typer.Option("--deny", help="Deny the request.")] = False,
    gate: GateOption = None,
    trust: TrustChoice = None,
    site: SiteChoice = None,
    store: StoreChoice = None,
    robot: RobotChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Write what the group signs: the answer to an open request."""
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
    """Round 1: make two nonces for one signature, and write the commitment to them."""
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
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Round 2: show what is signed, ask, and write your part of the signature."""
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
        list[Path], typer.Option("--part", help="Part of a signer (`share`); repeat for each.")
    ],
    out: OutFile,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="The trust folder (default: the folder of --cert)."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Make the approval token from the parts, or name the signer of an invalid part."""
    from authguard_r.cli import frost_signing

    return frost_signing.aggregate(
        group, cert, ballot, tuple(commitment), tuple(part), out=out, trust=trust, as_json=as_json
    )


def submit_command(
    token: Annotated[Path, typer.Argument(help="An approval token.")],
    why: Annotated[
        str, typer.Option("--reason", help="A text for the log; planners do not see it.")
    ] = "",
    gate: GateOption = None,
    trust: TrustChoice = None,
    site: SiteChoice = None,
    store: StoreChoice = None,
    robot: RobotChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Send the token to a gate or its store; exit 1 when it does not count."""
    from authguard_r.cli import frost_signing

    place = frost_signing.RequestPlace(gate=gate, trust=trust, site=site, store=store, robot=robot)
    return frost_signing.submit(token, place, why=why, as_json=as_json)


def show_command(
    file: Annotated[Path, typer.Argument(help="Any file of `authguard advanced frost`.")],
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Show what a file is and whether it is valid, without its secrets."""
    from authguard_r.cli import frost_signing

    return frost_signing.inspect(file, passphrase_file=passphrase_file, as_json=as_json)
