# SPDX-License-Identifier: Apache-2.0
"""Whether the users that a configuration names keep apart what must be apart.

A role is a user's, so two roles of one user are one: a planner that is also the controller goes
around the gate, one that is also the estimator attests its own state. How-to: docs/howto/deploy.md
"""

from __future__ import annotations

import pwd
from collections.abc import Iterator

from authguard_r.access.gate_config import GateConfig, Peer
from authguard_r.access.peers import OVERFLOW_UID
from authguard_r.operations.checkup.advice import Advice, AdviceCode, unsafe, warning
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import ClientRole, Mode

_APART = "give the planner a user of its own: authguard gate-config make"
#: What a planner's user must never be as well, and what follows when it is.
_NEVER: dict[ClientRole, str] = {
    ClientRole.CONTROLLER: "a planner could drive the robot without the gate",
    ClientRole.ESTIMATOR: "a planner could send the gate a false state",
}
#: What a planner's user should not be as well; what is signed still holds.
_BETTER_NOT: dict[ClientRole, str] = {
    ClientRole.OPERATOR: "a planner could ask what would be allowed, and read the log",
    ClientRole.AUDITOR: "a planner could read the log, with every field that failed",
}
#: Without a person in these roles nothing moves, or no order can be given.
_NEEDED = (
    ClientRole.PLANNER,
    ClientRole.CONTROLLER,
    ClientRole.ESTIMATOR,
    ClientRole.OPERATOR,
)


def user_name(uid: int) -> str | None:
    """Return a user's name on this machine; None when it knows no such user."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return None


def user_advice(config: GateConfig, *, uid: int | None) -> Iterator[Advice]:
    """Yield everything that the configured users do not keep apart.

    Args:
        config: the configuration, signed or about to be.
        uid: the user that the gate runs as; None: it is not known yet.
    """
    if uid == 0:
        yield _root(
            "gate",
            "the gate runs as root: a fault in it affects the whole machine",
            unsafe_too=True,
        )
    for number, peer in enumerate(config.peers):
        yield from _peer_advice(peer, f"gate.peers[{number}]", uid=uid)
    taken = {role for peer in config.peers for role in peer.roles}
    for role in (role for role in _NEEDED if role not in taken):
        yield warning(
            "users",
            AdviceCode.VACANT_ROLE,
            f"no user may be `{role}` here",
            place="gate.peers",
            mend=f"--peer USER:{role}",
        )


def _peer_advice(peer: Peer, place: str, *, uid: int | None) -> Iterator[Advice]:
    name = user_name(peer.uid)
    who = f"`{name}` ({peer.uid})" if name else f"user {peer.uid}"
    planner = ClientRole.PLANNER in peer.roles
    if peer.uid == OVERFLOW_UID:
        message = f"{who} is the overflow user: it stands for every unknown user"
        yield unsafe("users", AdviceCode.USER, message, place=place, mend="name a user of its own")
    elif name is None:
        message = f"{who} does not exist on this machine"
        yield warning(
            "users", AdviceCode.USER, message, place=place, mend=f"useradd -u {peer.uid} NAME"
        )
    if ClientRole.GATE in peer.roles:
        message = f"{who} is `{ClientRole.GATE}`: only a gate's own user is that, wherever it runs"
        yield unsafe("users", AdviceCode.USER, message, place=place, mend="leave the role out")
    if peer.uid == 0:
        yield _root(place, f"root is {', '.join(peer.roles)}", unsafe_too=planner)
    if planner:
        yield from _planner_advice(peer, who, place, uid=uid)


def _planner_advice(peer: Peer, who: str, place: str, *, uid: int | None) -> Iterator[Advice]:
    told = [(role, why, unsafe) for role, why in _NEVER.items() if role in peer.roles]
    told += [(role, why, warning) for role, why in _BETTER_NOT.items() if role in peer.roles]
    if peer.mediates:  # the planners for which it asks are other users, as was signed
        told = []
    for role, why, make in told:
        message = f"{who} is planner and {role}: {why}"
        yield make("users", AdviceCode.SHARED_USER, message, place=place, mend=_APART)
    if peer.uid == uid:
        message = f"{who} is planner and runs the gate: roles are not separated"
        yield unsafe("users", AdviceCode.SHARED_USER, message, place=place, mend=_APART)


def config_advice(config: GateConfig) -> Iterator[Advice]:
    """Yield what a configuration switches off."""
    if config.mode is Mode.SHADOW:
        yield warning(
            "mode",
            AdviceCode.SHADOW,
            "shadow: every action is decided and recorded, none is blocked or released",
            place="gate.mode",
            mend="sign one with `mode: enforce` when the trial is over",
        )
    if config.disclosure is Disclosure.FULL:
        yield warning(
            "disclosure",
            AdviceCode.DISCLOSURE,
            "`full`: a planner sees the expected values, and can search for the limits",
            place="gate.disclosure",
            mend="sign one with `disclosure: fields`, or `codes`",
        )
    for field in ("planner_silence_ms", "estimator_silence_ms", "refusals"):
        if getattr(config, field) == 0:
            yield warning(
                "alerts",
                AdviceCode.SILENT,
                f"`{field}` is 0: that alert never comes",
                place=f"gate.{field}",
                mend="sign a configuration with a bound",
            )
    yield from _reader_advice(config)


def _reader_advice(config: GateConfig) -> Iterator[Advice]:
    """Whether the decisions of the log can be replayed; without sealed fields anyone can."""
    sealed = {data for reader in config.readers for data in reader.classes}
    if sealed and not any(sealed.issubset(reader.classes) for reader in config.readers):
        yield warning(
            "readers",
            AdviceCode.READERS,
            f"no one may read all of {', '.join(sorted(sealed))}: no one can replay this log",
            place="gate.readers",
            mend="name a reader of all that is sealed: authguard audit reader",
        )


def _root(place: str, message: str, *, unsafe_too: bool) -> Advice:
    make = unsafe if unsafe_too else warning
    mend = "run it as a user of its own: deploy/sysusers.d/authguard-r.conf"
    return make("users", AdviceCode.ROOT_USER, message, place=place, mend=mend)
