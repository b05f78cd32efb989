# SPDX-License-Identifier: Apache-2.0
"""`authguard keys init --no-demo`, `issue` on the authority's machine, `install` on the member's.

How-to: docs/howto/keys.md
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.authority import issue, require_grantable, wider
from authguard_r.authoring.keys.install import (
    OpenedAnswer,
    install_answer,
    open_answer,
    require_root,
)
from authguard_r.authoring.keys.request import OpenedRequest, fingerprint, open_request
from authguard_r.authoring.keys.revoking import signing_here
from authguard_r.authoring.keys.setup import AUTHORITIES, init_folder, read_key, write_revocations
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.inputs import JsonFlag, load_site, wall_now
from authguard_r.cli.key_requests import card_of, wanted_json, wanted_of
from authguard_r.cli.signing_key import (
    CERTIFICATE_END,
    KEY_END,
    REQUEST_END,
    KeyOption,
    PassphraseFile,
    open_signer,
    passphrase_of,
)
from authguard_r.core.errors import AuthenticityError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.files import write_whole
from authguard_r.keys.loading import load
from authguard_r.keys.trust import read_certificates, read_file, read_trust
from authguard_r.wire.output import emit

#: Default number of days until the next update of a list.
LIST_DAYS = 30
DaysOption = Annotated[int, typer.Option("--days", min=1, max=3_650, help="Days of validity.")]
YesFlag = Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")]


def init_authorities(
    folder: Path,
    *,
    site: Path | None,
    authorities: str,
    algorithms: tuple[Algorithm, ...],
    days: int,
    as_json: bool,
) -> int:
    """Write roots and role authorities, no members: the authority's machine, for work.

    Args:
        folder: new or empty.
        site: names the root after this site.
        authorities: which, with commas between.
        algorithms: one for each root.
        days: how long roots and authorities are valid; nothing that they give outlives them.
        as_json: print JSON.
    """
    names = tuple(dict.fromkeys(authorities.split(",")))
    unknown = [name for name in names if name not in AUTHORITIES]
    if unknown:
        raise typer.BadParameter(
            f"expected some of {', '.join(AUTHORITIES)}, got `{unknown[0]}`",
            param_hint="--authorities",
        )
    told = "" if site is None else f" of {load_site(site).id}"
    title = f"AuthGuard-R root{told}"
    if "demo" in title.lower():
        raise typer.BadParameter("a root that says `demo` is for no real gate", param_hint="--site")
    now = datetime.now(UTC)
    init_folder(
        folder, (), now=now, days=days, algorithms=algorithms, title=title, authorities=names
    )
    for name in signing_here(folder):  # a list that is withheld is trusted no longer than this
        write_revocations(
            folder, name, read_key(folder, name), serials=(), now=now, number=1, days=LIST_DAYS
        )
    roots = read_trust(folder).roots
    printed, end = fingerprint(roots), f"{roots[0].not_valid_after_utc:%Y-%m-%dT%H:%M:%SZ}"
    lines = [
        f"{folder}: {title}; its private keys are in keys/ and nowhere else",
        *(f"  {name}: gives {', '.join(AUTHORITIES[name])}" for name in names),
        f"lists are good for {LIST_DAYS} days: authguard keys lists {folder}",
        f"until {end}, and nothing that it gives any longer",
        f"root {printed}",
    ]
    payload = {
        "folder": str(folder),
        "demo": False,
        "principals": [],
        "authorities": list(names),
        "root": printed,
        "until": end,
    }
    emit(payload, lines, as_json=as_json)
    return 0


def issue_command(
    folder: Annotated[Path, typer.Argument(help="The authority's folder.")],
    request: Annotated[Path, typer.Argument(help="A request as `keys request` wrote it.")],
    days: DaysOption = 365,
    out: Annotated[
        Path | None, typer.Option("--out", help="The answer (default: beside the request).")
    ] = None,
    yes: YesFlag = False,
    more: Annotated[
        bool,
        typer.Option("--wider", help="With --yes: also allow more rights than before."),
    ] = False,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """On the authority's machine: show what a request asks for, ask, and write the answer file."""
    opened, now = open_request(read_file(request)), datetime.now(UTC)
    require_grantable(folder, opened, now=now)
    beyond = wider(folder, opened, now=now)
    card = [*card_of(opened), *(f"WIDER    {item}" for item in beyond), f"days     {days}"]
    if not yes:
        confirm_shown(card, "Give exactly this?", as_json=as_json)
    elif beyond and not more:
        raise RefusedError(
            f"`{opened.wanted.principal}` asks for more than it has: {'; '.join(beyond)}; with "
            "`--yes` that is said too: `--wider`",
            reason=Reason.SIGNER_OUT_OF_SCOPE,
            where="request",
        )
    target = out or request.with_name(request.name.removesuffix(REQUEST_END) + ".answer.json")
    said = passphrase_of(passphrase_file)
    issue(folder, opened, now=now, days=days, passphrase=said, out=target)
    payload = {"answer": str(target), "days": days, "wider": list(beyond), **wanted_json(opened)}
    emit(
        payload, [*(card if yes else []), f"answer   {target}: back to its maker"], as_json=as_json
    )
    return 0


def install_command(
    answer: Annotated[Path, typer.Argument(help="The authority's answer.")],
    key: KeyOption,
    folder: Annotated[
        Path, typer.Option("--trust", help="The trust folder; created if it does not exist.")
    ],
    root: Annotated[
        str | None, typer.Option("--root", help="Fingerprint of the root, from the authority.")
    ] = None,
    cert: Annotated[
        Path | None, typer.Option("--cert", help="The certificate (default: beside the key).")
    ] = None,
    request: Annotated[
        Path | None, typer.Option("--request", help="The request (default: beside the key).")
    ] = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """On the member's machine: check the answer against key, request and root, and install it."""
    now = wall_now(None)
    opened = open_answer(read_file(answer), now)
    stem = key.name.removesuffix(KEY_END)
    asked = request or key.with_name(stem + REQUEST_END)
    if asked.exists() or request is not None:
        _require_fits(opened, open_request(read_file(asked)))
    _require_expected(opened, folder, root, as_json=as_json)
    target = cert or key.with_name(stem + CERTIFICATE_END)
    _require_own(opened, key, target, passphrase_file)
    install_answer(folder, opened, now)
    write_whole(target, _pem(opened), mode=0o644)
    leaf, told = opened.leaves[0], fingerprint(opened.trust.roots)
    payload = {
        "principal": leaf.principal,
        "role": str(leaf.role),
        "cert": str(target),
        "trust": str(folder),
        "root": told,
    }
    lines = [
        f"{leaf.principal} ({leaf.role}): {target}",
        f"trust folder {folder}, root {told}",
    ]
    emit(payload, lines, as_json=as_json)
    return 0


def _require_fits(opened: OpenedAnswer, request: OpenedRequest) -> None:
    """Require that the answer fits the request; an authority that mixes up two is reported."""
    if tuple(leaf.key for leaf in opened.leaves) != request.keys:
        raise _unfit("expected certificates of the keys in the request")
    for leaf in opened.leaves:
        if wanted_of(leaf) != request.wanted:
            raise _unfit("expected the role and scope that were asked for")


def _require_expected(
    opened: OpenedAnswer, folder: Path, root: str | None, *, as_json: bool
) -> None:
    """Require the root that was named, that is here already, or that a person compared."""
    got = fingerprint(opened.trust.roots)
    if root is not None:
        require_root(got, root.replace(":", "").lower(), where="--root")
    elif (folder / "root.pem").exists():
        require_root(got, fingerprint(read_certificates(folder / "root.pem")), where=str(folder))
    else:
        confirm_shown([f"root {got}"], "Is this what the authority says?", as_json=as_json)


def _require_own(
    opened: OpenedAnswer, key: Path, target: Path, passphrase_file: Path | None
) -> None:
    """Require that the key is the certificates'; nothing takes the place of those that fit."""
    tried = target.with_name(f"{target.name}.tried")
    try:
        write_whole(tried, _pem(opened))
        open_signer(key, tried, passphrase_file)
    except AuthenticityError as error:
        raise AuthenticityError(error.message, reason=error.reason, where=str(key)) from error
    finally:
        tried.unlink(missing_ok=True)


def _pem(opened: OpenedAnswer) -> bytes:
    return b"".join(
        load(der, where="answer.chains").public_bytes(Encoding.PEM)
        for chain in opened.chains
        for der in chain
    )


def _unfit(message: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.CERTIFICATE_INVALID, where="answer.chains")
