# SPDX-License-Identifier: Apache-2.0
"""A whole set-up looked at: what is unsafe, what protects less, and what to do about it (L7).

`authguard doctor` prints it; a gate that is no demonstration does not start with what is unsafe.
How-to: docs/howto/deploy.md
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Leaf, Role
from authguard_r.keys.loading import key_of, load
from authguard_r.keys.trust import read_trust
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.interface import Surface
from authguard_r.operations.checkup.advice import (
    Advice,
    AdviceCode,
    Level,
    fine,
    in_demonstration,
    refuses_start,
    unsafe,
    warning,
)
from authguard_r.operations.checkup.apart import Files, apart_advice
from authguard_r.operations.checkup.certificates import (
    authority_advice,
    certificate_advice,
    issued_advice,
    leaves_of,
    list_advice,
)
from authguard_r.operations.checkup.custody import (
    CERTIFICATE_END,
    KEY_END,
    authority_key_advice,
    file_advice,
    folder_advice,
    key_advice,
    plain_advice,
    role_of,
    stray_advice,
)
from authguard_r.operations.checkup.logbook import counter_advice, store_advice, witness_advice
from authguard_r.operations.checkup.machine import machine_advice, room_advice
from authguard_r.operations.checkup.meaning import binding_advice
from authguard_r.operations.checkup.users import config_advice, user_advice
from authguard_r.site.model import Site, profile_digest

#: The longest path of a Unix socket, in bytes, and the longest name that one has in a run folder.
_LONGEST_SOCKET = 107
_LONGEST_NAME = "/sensors.sock"


class GateSetup(Struct, frozen=True, kw_only=True):
    """The parts of one gate; a part that is None is not checked.

    Args:
        demo: this is declared a demonstration: the risks of one folder for everything are warnings
            then.
        uid: the user that the gate runs as.
        trust: the trust folder.
        key: the gate's private key.
        chain: the gate's certificate chain.
        site: the sound site model.
        binding: the planner's tools.
        model: the site's file, for the advice.
        tools: the binding's file or shipped name, for the advice.
        interface: what these tools say of themselves; empty: the binding is not compared.
        config: the gate's authentic configuration.
        store: the store's file.
        run: the folder of the sockets.
        files: further files that the gate trusts: site, binding, safety, configuration.
        counter: the outside counter's file; looked at together with the store.
        journal: the emergency journal's file.
        deep: read the whole log too; it takes as long as the log.
        around: folders in which a person's own keys and certificates lie.
    """

    demo: bool
    uid: int
    trust: Path | None = None
    key: Path | None = None
    chain: Path | None = None
    site: Site | None = None
    binding: Binding | None = None
    model: Path | None = None
    tools: Path | None = None
    interface: tuple[Surface, ...] = ()
    config: GateConfig | None = None
    store: Path | None = None
    run: Path | None = None
    files: tuple[Path, ...] = ()
    counter: Path | None = None
    journal: Path | None = None
    deep: bool = False
    around: tuple[Path, ...] = ()


def checkup(setup: GateSetup, now: Now) -> tuple[Advice, ...]:
    """Return everything that was checked, in the order in which people fix it."""
    found = [*machine_advice(), *_trust(setup, now), *_custody(setup)]
    if setup.binding is not None and setup.site is not None:
        found += binding_advice(
            setup.binding, setup.site, interface=setup.interface, check=_check(setup)
        )
    if setup.config is not None:
        found += [*user_advice(setup.config, uid=setup.uid), *config_advice(setup.config)]
        found += witness_advice(setup.config)
    found += [*_run(setup), *_store(setup, now), *apart_advice(_files(setup))]
    return tuple(map(in_demonstration, found)) if setup.demo else tuple(found)


def _check(setup: GateSetup) -> str:
    """Return the command that compares the binding, with the files that were named."""
    names = [setup.tools, *(["--site", setup.model] if setup.model else [])]
    words = ["authguard", "binding", "check", *(shlex.quote(str(name)) for name in names if name)]
    # a shipped binding is compared with its own interface; any other needs one
    return " ".join([*words, *([] if setup.interface else ["--interface", "FILE"])])


def require_safe(setup: GateSetup, now: Now) -> tuple[Advice, ...]:
    """Return everything that was looked at, once nothing of it forbids to start.

    Low disk space and a wrong clock do not: with these a gate serves stops, and refuses the rest.

    Raises:
        EnvironmentFault: something is unsafe, in a demonstration so that it destroys what is
            there; the first is named.
    """
    found = checkup(setup, now)
    left = [advice for advice in found if refuses_start(advice, demo=setup.demo)]
    if left:
        first = left[0]
        more = f" (and {len(left) - 1} more: authguard doctor)" if len(left) > 1 else ""
        raise EnvironmentFault(
            f"unsafe: {first.part}: {first.message}; {first.mend}{more}",
            reason=Reason.SETUP_INVALID,
            where=first.place or first.part,
        )
    return found


def _trust(setup: GateSetup, now: Now) -> Iterator[Advice]:
    """Root, lists, certificates, and who the gate is."""
    if setup.trust is None:
        return
    try:
        trust = read_trust(setup.trust)
    except AuthGuardError as error:
        yield unsafe(
            "trust", AdviceCode.TRUST, str(error), place=error.where, mend="authguard keys init DIR"
        )
        return
    if trust.demo:
        yield unsafe(
            "trust",
            AdviceCode.DEMO_ROOT,
            "the root says `demo`: every private key lies in this folder",
            place=str(setup.trust),
            mend="make a set-up whose keys stay on their own machines",
        )
    yield from list_advice(trust, setup.trust, now)
    yield from authority_advice(trust, setup.trust, now)
    yield from issued_advice(sorted(setup.trust.glob("issued/*.cert.pem")), trust, now)
    own = () if setup.chain is None else (setup.chain,)
    beside = _beside(setup, f"*{CERTIFICATE_END}")
    for path in sorted({*setup.trust.glob(f"keys/*{CERTIFICATE_END}"), *beside, *own}):
        found = tuple(certificate_advice(path, trust, now))
        yield from found
        if path == setup.chain and is_safe(found):
            part = f"keys/{path.name}"
            yield from _own_certificate(leaves_of(path, trust, now)[0], part, setup)


def _beside(setup: GateSetup, pattern: str) -> tuple[Path, ...]:
    """Return what lies beside the parts, a person's own key and certificate among it."""
    named = {path.resolve() for path in (setup.key, setup.chain) if path is not None}
    found = sorted(path for folder in setup.around for path in folder.glob(pattern))
    return tuple(path for path in found if path.resolve() not in named)


def _is_gate(setup: GateSetup) -> bool:
    """True when a gate is looked at, and not a person's or another machine's own files."""
    if any(part is not None for part in (setup.config, setup.store, setup.run)):
        return True
    return role_of(setup.key, setup.chain) in {None, Role.GATE}


def _own_certificate(leaf: Leaf, part: str, setup: GateSetup) -> Iterator[Advice]:
    """The gate's robot and profile come from here, so configuration and site must agree."""
    place = str(setup.chain)
    if not _is_gate(setup):
        return  # it is valid for every role
    if leaf.role is not Role.GATE or leaf.robot is None:
        message = f"expected a gate's certificate, got a `{leaf.role}`'s"
        yield unsafe(part, AdviceCode.CERTIFICATE, message, place=place, mend="name the gate's own")
        return
    if setup.config is not None and setup.config.robot != leaf.robot:
        message = f"it is `{leaf.robot}`'s, the configuration is `{setup.config.robot}`'s"
        yield unsafe(
            "config", AdviceCode.CONFIG, message, place=place, mend="name this robot's own"
        )
    robot = None if setup.site is None else setup.site.robots.get(leaf.robot)
    if setup.site is not None and (robot is None or profile_digest(robot.profile) != leaf.profile):
        message = f"the site's robot `{leaf.robot}` is not the one that this certificate names"
        mend = "sign the site that fits, or issue the gate's certificate again"
        if setup.demo:
            mend = f"make keys for it: authguard keys init FOLDER --site {setup.model}"
        yield unsafe("site", AdviceCode.SITE, message, place=place, mend=mend)


def _custody(setup: GateSetup) -> Iterator[Advice]:
    """Files, folders and keys."""
    gates = None if setup.key is None else setup.key.resolve()
    lying = () if setup.trust is None else setup.trust.glob(f"keys/*{KEY_END}")
    keys = sorted({*lying, *_beside(setup, f"*{KEY_END}")})
    for path in (path for path in keys if path.resolve() != gates):
        yield from key_advice(path, uid=None)
    # a shipped binding has a name and no file
    files = (path for path in setup.files if os.path.lexists(path))
    believed = [path for path in (setup.trust, setup.chain, *files) if path]
    believed += [] if setup.trust is None else [setup.trust / "root.pem"]
    for path in believed:
        yield from file_advice(path.name, path, uid=setup.uid)
    around = [*believed, *(path for path in (setup.key, setup.store, setup.run) if path)]
    yield from folder_advice(around, uid=setup.uid)
    if setup.key is not None:
        yield from key_advice(setup.key, uid=setup.uid)
    for path in () if setup.demo else sorted({*keys, *([setup.key] if setup.key else [])}):
        yield from plain_advice(path)
    if not setup.demo:  # in a demonstration they all lie together
        yield from _unused(setup)


def _unused(setup: GateSetup) -> Iterator[Advice]:
    """Private keys that do not belong where they lie."""
    authorities = _authority_keys(setup.trust)
    is_named = any(part is not None for part in (setup.key, setup.chain, setup.config))
    if not is_named or not _is_gate(setup):
        if setup.trust is not None:
            yield from authority_key_advice(setup.trust, authorities)
        return
    own = () if setup.key is None else (setup.key.parent,)
    deep = {*own, *(path for path in (setup.trust,) if path)}
    flat = {path for path in (setup.run, setup.store and setup.store.parent) if path}
    yield from stray_advice(
        sorted(deep), own=setup.key, uid=setup.uid, flat=sorted(flat), authorities=authorities
    )


def _authority_keys(folder: Path | None) -> dict[bytes, str]:
    """Return the name of each root and authority by its public key."""
    try:
        lists = {} if folder is None else read_trust(folder).lists
    except AuthGuardError:
        return {}  # what is wrong with the folder was said
    named = ((load(der, where="authority"), known.authority) for der, known in lists.items())
    return {key_of(cert, where=name).public_bytes_raw(): name for cert, name in named}


def _files(setup: GateSetup) -> Files:
    """Return what is written, and what is read and must not be written over."""
    root = None if setup.trust is None else setup.trust / "root.pem"
    read = (root, setup.key, setup.chain, *setup.files)
    return Files(
        store=setup.store,
        counter=setup.counter,
        journal=setup.journal,
        read=tuple(dict.fromkeys(path for path in read if path is not None)),
    )


def _run(setup: GateSetup) -> Iterator[Advice]:
    """The folder of the sockets."""
    if setup.run is None:
        return
    place = str(setup.run)
    if len(os.fsencode(place + _LONGEST_NAME)) > _LONGEST_SOCKET:
        message = f"its sockets' paths are longer than {_LONGEST_SOCKET} bytes"
        yield unsafe("run", AdviceCode.PATH_LONG, message, place=place, mend="use a shorter path")
    if setup.run.exists() and not setup.run.is_dir():
        mend = "name a folder"
        yield unsafe(
            "run", AdviceCode.MISSING, "expected a folder, got a file", place=place, mend=mend
        )
        return
    if not setup.run.is_dir():
        yield warning(
            "run", AdviceCode.MISSING, "no such folder", place=place, mend=f"mkdir {place}"
        )
        return
    found = tuple(file_advice("run", setup.run, uid=setup.uid))
    yield from found or [fine("run", AdviceCode.WRITABLE, "only its user can write", place=place)]


def _store(setup: GateSetup, now: Now) -> Iterator[Advice]:
    """The store, its folder's room, and how its log is anchored."""
    if setup.store is None:
        return
    folder = setup.store.parent
    if not folder.is_dir():
        yield unsafe(
            "store",
            AdviceCode.MISSING,
            f"no folder `{folder}`",
            place=str(folder),
            mend=f"mkdir -m 700 {folder}",
        )
        return
    if setup.config is not None:
        yield room_advice(folder, setup.config.reserve_bytes)
    yield from store_advice(setup.store, now, uid=setup.uid, deep=setup.deep)
    witnessed = setup.config is not None and bool(setup.config.witnesses)
    yield counter_advice(setup.counter, setup.store, witnessed=witnessed)


def is_safe(found: tuple[Advice, ...]) -> bool:
    """True when nothing that was looked at is unsafe."""
    return not any(advice.level is Level.UNSAFE for advice in found)
