# SPDX-License-Identifier: Apache-2.0
"""The steps of `authguard advanced frost` that make a group and its certificate."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from authguard_r.authoring.keys.authority import issue_group, require_group
from authguard_r.authoring.keys.request import WantedCertificate
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.frost_files import (
    group_lines,
    impossible,
    load,
    load_all,
    load_share,
    names,
    owner,
    plain,
    require_absent,
    store,
)
from authguard_r.cli.signing_key import ask_new_passphrase, passphrase_of
from authguard_r.core.errors import EnvironmentFault, MalformedError, RefusedError
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.frost import dkg
from authguard_r.frost.keys import deal as deal_key
from authguard_r.frost.keys import public_key, require_share
from authguard_r.frost.messages import (
    Contribution,
    Group,
    KeyGenerationPlan,
    Offer,
    Secret,
    digest,
    written,
)
from authguard_r.frost.nonces import write_new
from authguard_r.keys.certificate import Role
from authguard_r.keys.ed25519 import public_key as ed25519_key
from authguard_r.keys.envelope import is_sealed, seal
from authguard_r.keys.key_access import read_passphrase
from authguard_r.keys.trust import read_certificates, read_file
from authguard_r.wire.output import emit

#: What a group may be: it answers, and issues nothing.
ROLES = (Role.SUPERVISOR, Role.SAFETY_OFFICER)


def deal(group: str, threshold: int, members: tuple[str, ...], out: Path, *, as_json: bool) -> int:
    """Write the group and every member's share into a folder."""
    try:
        dealt = deal_key(names((group,))[0], names(members), threshold=threshold)
    except ValueError as error:
        raise impossible(error) from error
    shares = {out / f"{owner(share)}.share.json": share for share in dealt.shares}
    target = out / "group.json"
    require_absent(target, *shares)
    for path, share in shares.items():
        store(path, share)
    store(target, dealt.group)
    payload = {"group": plain(dealt.group), "digest": digest(dealt.group), "file": str(target)}
    secret = [f"{path}: secret, for {owner(share)} alone" for path, share in shares.items()]
    lines = [*group_lines(dealt.group), f"{target}", *secret]
    emit({**payload, "shares": [str(path) for path in shares]}, lines, as_json=as_json)
    return 0


def plan(group: str, threshold: int, members: tuple[str, ...], out: Path, *, as_json: bool) -> int:
    """Write a plan of key generation."""
    try:
        made = dkg.plan(names((group,))[0], names(members), threshold=threshold)
    except ValueError as error:
        raise impossible(error) from error
    store(out, made)
    payload = {"file": str(out), "digest": digest(made)}
    emit(payload, [f"{out}", f"digest {digest(made)}"], as_json=as_json)
    return 0


def offer(plan_file: Path, member: str, secret: Path, out: Path, *, as_json: bool) -> int:
    """Write a member's secret and offer."""
    agreed = load(plan_file, KeyGenerationPlan)
    if member not in agreed.members:
        raise MalformedError(f"the plan has no member `{member}`", where="--as")
    require_absent(secret, out)
    kept, made = dkg.begin(agreed, list(agreed.members).index(names((member,))[0]) + 1)
    store(secret, kept)
    store(out, made)
    lines = [f"{out}: for every member", f"{secret}: secret, stays here"]
    emit({"file": str(out), "secret": str(secret)}, lines, as_json=as_json)
    return 0


def exchange(secret: Path, offers: tuple[Path, ...], out: Path, *, as_json: bool) -> int:
    """Write an encrypted contribution for each other member."""
    kept, seen = load(secret, Secret), load_all(offers, Offer)
    members = kept.plan.members
    given = {
        out / f"{members[kept.identifier - 1]}-to-{members[item.recipient - 1]}.json": item
        for item in dkg.exchange(kept, seen)
    }
    require_absent(*given)
    for path, item in given.items():
        store(path, item)
    same = dkg.transcript(seen)
    lines = [
        *(f"{path}" for path in given),
        f"offers {same}",
        "compare the digest of the offers with the other members: it must be the same",
    ]
    emit({"files": [str(path) for path in given], "offers": same}, lines, as_json=as_json)
    return 0


def finish(
    secret: Path,
    offers: tuple[Path, ...],
    contributions: tuple[Path, ...],
    out: Path,
    *,
    as_json: bool,
) -> int:
    """Write a member's share and the group, and destroy the secret."""
    kept = load(secret, Secret)
    share = dkg.finish(kept, load_all(offers, Offer), load_all(contributions, Contribution))
    target, public = out / f"{owner(share)}.share.json", out / "group.json"
    require_absent(target, public)
    store(public, share.group)
    store(target, share)
    secret.unlink()
    payload = {"file": str(target), "group": plain(share.group), "digest": digest(share.group)}
    lines = [*group_lines(share.group), f"{target}: secret, yours alone"]
    emit(payload, lines, as_json=as_json)
    return 0


def certify(
    trust: Path,
    group_file: Path,
    *,
    role: str,
    robots: tuple[str, ...] | None,
    regions: tuple[str, ...] | None,
    days: int,
    passphrase_file: Path | None,
    yes: bool,
    as_json: bool,
) -> int:
    """Show what would be given, ask, and write the group's certificate chain into the folder."""
    group = load(group_file, Group)
    if role not in ROLES:
        raise MalformedError(f"expected a role of {', '.join(ROLES)}, got `{role}`", where="--role")
    _require_one_root(trust)
    wanted = WantedCertificate(
        principal=group.id,
        role=Role(role),
        robots=tuple(sorted(map(RobotId, set(robots or ())))),
        every_robot=robots is None,
        regions=tuple(sorted(map(RegionId, set(regions or ())))),
        every_region=regions is None,
    )
    key, now = ed25519_key(public_key(group), where="group"), datetime.now(UTC)
    require_group(trust, wanted, key, now=now)
    card = [
        *group_lines(group),
        f"role {role}",
        f"robots {_words(robots)}",
        f"regions {_words(regions)}",
        f"days {days}",
    ]
    if not yes:
        confirm_shown(card, "Give exactly this?", as_json=as_json)
    target = issue_group(
        trust,
        wanted,
        key,
        threshold=group.threshold,
        members=group.members,
        now=now,
        days=days,
        passphrase=passphrase_of(passphrase_file),
    )
    payload = {"file": str(target), "principal": group.id, "digest": digest(group)}
    emit(payload, [*(card if yes else []), f"{target}"], as_json=as_json)
    return 0


def _words(names: tuple[str, ...] | None) -> str:
    return "EVERY ONE" if names is None else ", ".join(names)


def protect(share_file: Path, passphrase_file: Path | None, *, as_json: bool) -> int:
    """Seal a share in its place; the plain one is gone when this returns."""
    if is_sealed(read_file(share_file)):
        raise RefusedError(
            "the share is sealed already", reason=Reason.KEY_INVALID, where=str(share_file)
        )
    share = load_share(share_file)
    require_share(share)
    said = (
        ask_new_passphrase(str(share_file))
        if passphrase_file is None
        else read_passphrase(passphrase_file)
    )
    new = share_file.with_name(f"{share_file.name}.new")
    write_new(new, seal(written(share), said))
    new.replace(share_file)
    emit({"file": str(share_file)}, [f"{share_file}: sealed"], as_json=as_json)
    return 0


def _require_one_root(folder: Path) -> None:
    """Require a set-up in which an Ed25519 signature is enough.

    Raises:
        EnvironmentFault: everything here needs a second signature, which no group can make.
    """
    if len(read_certificates(folder / "root.pem")) > 1:
        raise EnvironmentFault(
            "everything is signed with two algorithms here, and a group's key is Ed25519 alone",
            reason=Reason.SIGNATURE_MISSING,
            where=str(folder),
        )
