# SPDX-License-Identifier: Apache-2.0
"""The signed configuration of one gate: who may be what here, and how much of it.

The site authority signs it. Nothing in it grants an action: a role lets a client ask, the mission
says what is granted. Absent is never unlimited: every bound has a value, and a user that is not
named may do nothing, not even stop. Spec page: docs/spec/gate-protocol.md#configuration
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from authguard_r.anchoring.places import WitnessPlace, require_place
from authguard_r.anchoring.sealing.policy import (
    Reader,
    Retention,
    require_readers,
    require_retention,
)
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Count, Positive, RobotId
from authguard_r.core.mission import DataClass
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import ClientRole, Mode

#: Fewest records of a segment.
LEAST_RECORDS = 1_024
CONFIG_ROLES = frozenset({"site_authority"})


class Peer(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What the processes of one operating-system user may be.

    Args:
        uid: the user's number, as the kernel says it of a connected socket.
        roles: sorted and unique.
        mediates: it is the user of an enforcement point alone, such as the node on ROS 2 or a
            gateway: it asks for planners that run as others, and drives. What the signer of this
                configuration states
            that no planner runs as this user.
    """

    uid: Count
    roles: Annotated[tuple[ClientRole, ...], Meta(min_length=1)]
    mediates: bool = False


class GateConfig(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One gate's configuration. What has a default is not written where it has that value.

    Args:
        version: grows with each change; a store goes back to none before it. 0: not versioned.
        robot: the robot it is for.
        mode: `shadow` releases nothing and says so everywhere.
        peers: who may connect, sorted by user.
        connections: most connections of one user at a time.
        planner_silence_ms: a planner with an active mission that says nothing for this long
            raises an alert; 0 raises none.
        estimator_silence_ms: no snapshot for this long raises an alert; 0 raises none.
        refusals: refusals in a row, without a success, that raise the no-progress alert and stop
            the robot; 0 never.
        renew_within_ms: a controller that hears of no renewal for this long stops by itself.
        stand_within_ms: the outcome of an action is unknown when the robot has not confirmed that
            it stands this long after a stop; the mission is suspended.
        disclosure: how much of a refusal a planner sees.
        fold_ms: repeats of one refusal within this time become one counted record.
        reserve_bytes: disk kept free for outcomes, stops and management.
        checkpoint_records: a checkpoint is made after so many records.
        checkpoint_ms: a checkpoint is made after so long, if anything is new.
        witnesses: who cosign the checkpoints, each once.
        quorum: the number of witnesses that make a checkpoint `witnessed`; 0 without witnesses.
        state_wait_ms: a step waits so long for state that was measured after the robot's last
            motion, and is refused then.
        witness_ms: nothing was witnessed for so long, though there is something: an alert; 0: none.
        segment_records: while so many records lie in the store, the oldest go into a sealed
            segment beside it; 0: never.
        readers: who may read which sealed fields of the log; a field without readers is stored
            unsealed.
        retention: how long sealed fields are kept, for each class at most one rule, sorted.
    """

    version: Count = 0
    robot: RobotId
    mode: Mode
    peers: Annotated[tuple[Peer, ...], Meta(min_length=1, max_length=256)]
    connections: Positive
    planner_silence_ms: Count
    estimator_silence_ms: Count
    refusals: Count
    renew_within_ms: Annotated[int, Meta(ge=150, le=10_000)]
    stand_within_ms: Annotated[int, Meta(ge=100, le=60_000)]
    disclosure: Disclosure
    fold_ms: Count
    reserve_bytes: Count
    checkpoint_records: Annotated[int, Meta(ge=1, le=1_000_000)] = 256
    checkpoint_ms: Annotated[int, Meta(ge=100, le=86_400_000)] = 60_000
    witnesses: Annotated[tuple[WitnessPlace, ...], Meta(max_length=16)] = ()
    quorum: Count = 0
    witness_ms: Count = 600_000
    segment_records: Count = 1_000_000
    state_wait_ms: Annotated[int, Meta(ge=0, le=60_000)] = 2_000
    readers: Annotated[tuple[Reader, ...], Meta(max_length=32)] = ()
    retention: Annotated[tuple[Retention, ...], Meta(max_length=len(DataClass))] = ()


def require_mediator(peer: Peer, *, where: str) -> None:
    """Require that a mediator has only these two roles: it may neither attest state nor decide.

    Raises:
        MalformedError: it has other roles.
    """
    needed = {ClientRole.PLANNER, ClientRole.CONTROLLER}
    if peer.mediates and not needed <= set(peer.roles) <= {*needed, ClientRole.AUDITOR}:
        raise MalformedError(
            "expected planner and controller, and auditor at most, of a user that mediates",
            where=where,
            reason=Reason.SCHEMA_INVALID,
        )


def default_config(robot: RobotId, peers: tuple[Peer, ...], mode: Mode) -> GateConfig:
    """Return the configuration with the bounds that a set-up starts with."""
    return GateConfig(
        robot=robot,
        mode=mode,
        peers=peers,
        connections=64,
        planner_silence_ms=60_000,
        estimator_silence_ms=1_000,
        refusals=10,
        renew_within_ms=300,
        stand_within_ms=2_000,
        disclosure=Disclosure.FIELDS,
        fold_ms=60_000,
        reserve_bytes=16 << 20,
    )


def open_gate_config(data: bytes, *, verifier: Verifier, now: Now, robot: RobotId) -> GateConfig:
    """Return the configuration in a token.

    Raises:
        MalformedError: no configuration token, users not sorted, or for another robot.
        AuthenticityError: not signed by a site authority.
    """
    config, _, _ = open_token(
        data, GateConfig, tag=Tag.GATE, roles=CONFIG_ROLES, verifier=verifier, now=now
    )
    uids = [peer.uid for peer in config.peers]
    if sorted(set(uids)) != uids:
        raise MalformedError(
            "expected users sorted, one entry for each",
            where="gate.peers",
            reason=Reason.SCHEMA_INVALID,
        )
    for number, peer in enumerate(config.peers):
        if ClientRole.GATE in peer.roles or sorted(set(peer.roles)) != list(peer.roles):
            raise MalformedError(
                "expected roles of clients, sorted and unique",
                where=f"gate.peers[{number}].roles",
                reason=Reason.SCHEMA_INVALID,
            )
        require_mediator(peer, where=f"gate.peers[{number}].mediates")
    require_witnesses(config)
    require_segments(config)
    require_readers(config.readers, where="gate.readers")
    require_retention(config.retention, config.readers, where="gate.retention")
    if config.robot != robot:
        raise MalformedError(
            f"expected the configuration of `{robot}`, got `{config.robot}`'s",
            where="gate.robot",
            reason=Reason.ROBOT_MISMATCH,
        )
    return config


def require_witnesses(config: GateConfig, *, where: str = "gate") -> None:
    """Refuse a quorum that cannot come together, and one witness that counts twice.

    Raises:
        MalformedError: either, or a witness that cannot be asked.
    """
    keys = [
        require_place(place, where=f"{where}.witnesses[{number}]")
        for number, place in enumerate(config.witnesses)
    ]
    apart = len({key.name for key in keys}) == len({key.public for key in keys}) == len(keys)
    least = 1 if keys else 0
    if not apart or not least <= config.quorum <= len(keys):
        raise MalformedError(
            "expected witnesses with names and keys of their own, and a quorum among them",
            where=f"{where}.quorum" if apart else f"{where}.witnesses",
            reason=Reason.SCHEMA_INVALID,
        )


def require_segments(config: GateConfig, *, where: str = "gate") -> None:
    """Refuse segments that are all but none: each is a file, with a signature.

    Raises:
        MalformedError: less than `LEAST_RECORDS`, and not 0.
    """
    if 0 < config.segment_records < LEAST_RECORDS:
        raise MalformedError(
            f"expected 0, or at least {LEAST_RECORDS}, got {config.segment_records}",
            where=f"{where}.segment_records",
            reason=Reason.SCHEMA_INVALID,
        )


def roles_of(config: GateConfig, uid: int) -> frozenset[ClientRole]:
    """Return what a user's processes may be; empty for a user that is not named."""
    return frozenset(role for peer in config.peers if peer.uid == uid for role in peer.roles)
