# SPDX-License-Identifier: Apache-2.0
"""The two policies that a gate is started with beside its configuration, as it would take them.

What opens them here opens them in the gate, and what holds the organization's against the store
holds it there: a finding is the gate's own refusal, said before the gate is started.
How-to: docs/howto/deploy.md
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.approvals.organization import VerifiedPolicy, open_policy
from authguard_r.cli.emergency import claimed_policy
from authguard_r.core.encoding import unb64
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.token import read_token
from authguard_r.enforcement.emergency.opened import OpenedPolicy, open_emergency
from authguard_r.enforcement.management.policy import hold_policy
from authguard_r.keys.certificate import walk
from authguard_r.keys.trust import (
    ROOT_LISTS,
    Trust,
    pairs,
    read_certificates,
    read_file,
    read_trust,
)
from authguard_r.operations.checkup import GateSetup
from authguard_r.operations.checkup.advice import Advice, AdviceCode, fine, unsafe, warning
from authguard_r.operations.checkup.certificates import SOON_MS
from authguard_r.site.model import Site
from authguard_r.store.clocks import SystemClock
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import read_held
from authguard_r.store.transactions import Ledger

_RISK, _EMERGENCY = "risk policy", "emergency policy"
_SIGN = {_RISK: "authguard risk-policy sign", _EMERGENCY: "authguard emergency policy sign"}
#: Where a store holds the highest version that was in force: docs/spec/store.md.
_HELD = ("risk-policy", "highest")


class Policies(Struct, frozen=True, kw_only=True):
    """The files that a gate's options name; None for a file that they do not name."""

    risk: Path | None = None
    emergency: Path | None = None


def policy_advice(named: Policies, setup: GateSetup, now: Now) -> Iterator[Advice]:
    """Yield whether a gate with this set-up takes its policies, and how long it will.

    Args:
        named: their files.
        setup: the set-up beside them; what of it could not be read was said already.
        now: the wall clock.
    """
    try:
        trust = None if setup.trust is None else read_trust(setup.trust)
    except AuthGuardError:
        return  # what is wrong with the folder was said
    if trust is None:
        return
    yield from _risk(named.risk, trust, setup, now)
    if named.emergency is not None and setup.site is not None:
        yield from _emergency(named.emergency, trust, setup.site, setup, now)


def _risk(path: Path | None, trust: Trust, setup: GateSetup, now: Now) -> Iterator[Advice]:
    """The organization's policy; a missing one counts too, where a whole gate is checked."""
    opened: VerifiedPolicy | None = None
    if path is not None:
        try:
            data = read_file(path)
            opened = open_policy(data, verifier=trust, now=now)
        except AuthGuardError as error:
            yield _refused(_RISK, path, error)
            return
        own = opened.policy
        told = f"`{own.organization}`, version {own.version}, signed by `{opened.signer}`"
        yield _lasting(_RISK, path, told, _certified_ms(data, trust, now), now)
    if path is not None or setup.config is not None:
        yield from _held(opened, setup.store, path)


def _held(policy: VerifiedPolicy | None, store: Path | None, path: Path | None) -> Iterator[Advice]:
    """The policy against the highest that a store has seen, by the gate's own act, on paper."""
    if store is None or not store.exists():
        return
    try:
        seen = read_held(store, *_HELD)
    except StoreError:
        return  # what is wrong with the store, or that a gate holds it, was said
    paper = Ledger(
        MemoryStore(), SystemClock(), robot=RobotId("doctor"), salts=os.urandom, genesis={}
    )
    try:
        if seen is not None:
            paper.run(lambda act: act.put(*_HELD, seen))
        paper.run(lambda act: hold_policy(act, policy))
    except AuthGuardError as error:
        mend = "name the policy that is in force: --risk-policy" if path is None else _mend(_RISK)
        yield unsafe(_RISK, AdviceCode.CONFIG, str(error), place=str(path or store), mend=mend)


def _emergency(
    path: Path, trust: Trust, site: Site, setup: GateSetup, now: Now
) -> Iterator[Advice]:
    """The safety officer's policy, of this robot at this site."""
    try:
        data = read_file(path)
        robot = _robot(trust, setup, now) or claimed_policy(data).robot
        opened = open_emergency(data, verifier=trust, now=now, site=site, robot=robot)
    except AuthGuardError as error:
        yield _refused(_EMERGENCY, path, error)
        return
    own = opened.policy
    told = f"`{own.id}`, version {own.version}, signed by `{opened.signer}`"
    yield _lasting(_EMERGENCY, path, told, _ends_ms(opened, trust, now), now)


def _robot(trust: Trust, setup: GateSetup, now: Now) -> RobotId | None:
    """Return whose gate it is, from its configuration or its certificate; None: neither says."""
    if setup.config is not None:
        return setup.config.robot
    if setup.chain is None:
        return None
    try:
        first = pairs(read_certificates(setup.chain, most=2 * len(ROOT_LISTS)))[0]
        chain = tuple(cert.public_bytes(Encoding.DER) for cert in first)
        return trust.gate_identity(chain, now)[0]
    except AuthGuardError:
        return None  # what is wrong with the certificate was said


def _ends_ms(opened: OpenedPolicy, trust: Trust, now: Now) -> int:
    """Return when the first of the policy and its signer's certificates ends."""
    return min(opened.expiry_ms, _certified_ms(opened.token, trust, now))


def _certified_ms(token: bytes, trust: Trust, now: Now) -> int:
    """Return when the first of the certificates of an authentic token ends; lists apart."""
    chains = (endorsement.chain for endorsement in read_token(token).endorsements)
    return min(
        walk(unb64(leaf), unb64(authority), roots=trust.roots, now=now).not_after_ms
        for leaf, authority in chains
    )


def _lasting(part: str, path: Path, told: str, ends_ms: int, now: Now) -> Advice:
    """Return that a gate takes the policy; a warning when that is over as soon as a certificate."""
    place, until = str(path), to_timestamp(ends_ms)
    if ends_ms - now.utc_ms < SOON_MS:
        message = f"{told}: no gate starts with it after {until}"
        return warning(part, AdviceCode.CONFIG, message, place=place, mend=_mend(part))
    return fine(part, AdviceCode.CONFIG, f"{told}, until {until}", place=place)


def _refused(part: str, path: Path, error: AuthGuardError) -> Advice:
    return unsafe(part, AdviceCode.CONFIG, str(error), place=str(path), mend=_mend(part))


def _mend(part: str) -> str:
    return f"sign the next version: {_SIGN[part]}"
