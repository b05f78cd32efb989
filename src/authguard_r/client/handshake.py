# SPDX-License-Identifier: Apache-2.0
"""The first two messages: who the client is, and whether it speaks to the gate that it means.

A socket's path proves nothing: any writer of the folder can put another socket there. With a
verifier the client demands a signature over its own fresh nonce by the key of this robot's gate.
Spec page: docs/spec/gate-protocol.md#proof
"""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct

from authguard_r.core.encoding import Tag, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError
from authguard_r.core.identifiers import Digest, Identifier, RobotId
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token, read_token
from authguard_r.wire.messages import PROTOCOL, ClientRole, Hello, Mode, Proof, Welcome

_GATE = frozenset({"gate"})
#: Who acts on what a gate says: a gate that releases nothing is not one to them.
_ENFORCED = frozenset({ClientRole.PLANNER, ClientRole.CONTROLLER})


class GateVerifier(Verifier, Protocol):
    """A verifier that also knows whose gate a certificate speaks for; `keys.trust.Trust` is one."""

    def gate_identity(self, chain: tuple[bytes, ...], now: Now) -> tuple[RobotId, Digest]:
        """Return the robot and the profile that a gate's certificate names.

        Raises:
            AuthenticityError: the chain does not hold or is not a gate's.
        """
        ...


class Speaks(Struct, frozen=True, kw_only=True):
    """The site and binding that a client rebuilds actions with; the gate must have the same.

    Args:
        site: digest of the site model.
        binding: digest of the binding.
    """

    site: Digest
    binding: Digest


class Handshake(Struct, frozen=True, kw_only=True):
    """What a client says first and what it demands of the answer.

    Args:
        role: what it wants to be here.
        client: its name in the gate's log.
        verifier: with one, the gate proves that it holds its key.
        robot: whose gate it must be; None takes any.
        allow_shadow: take a gate that releases nothing; anything but a planner or a controller
            takes it anyway.
        speaks: the gate has to speak these words; None takes any.
    """

    role: ClientRole
    client: Identifier
    verifier: GateVerifier | None = None
    robot: RobotId | None = None
    allow_shadow: bool = False
    speaks: Speaks | None = None


def hello(handshake: Handshake, nonce: str) -> Hello:
    """Return the first message.

    Args:
        handshake: who asks.
        nonce: fresh random bytes, base64url; sent only when a verifier checks the proof.
    """
    return Hello(
        protocol=PROTOCOL,
        role=handshake.role,
        client=handshake.client,
        nonce=nonce if handshake.verifier is not None else None,
    )


def require_welcome(welcome: Welcome, handshake: Handshake, *, nonce: str, now: Now) -> None:
    """Require the answer that was asked for, from the gate that was meant.

    Args:
        welcome: from the peer, not verified yet.
        handshake: what was said and is demanded.
        nonce: the one that was sent.
        now: the instant at which the gate's certificate must be valid.

    Raises:
        MalformedError: another protocol, role or client than was asked for.
        AuthenticityError: not the robot that was meant, or the proof does not hold.
        RefusedError: the gate is in shadow mode, or speaks other words.
    """
    said = (welcome.protocol, welcome.role, welcome.client)
    if said != (PROTOCOL, handshake.role, handshake.client):
        raise MalformedError("expected the welcome of this very hello", where="welcome")
    if handshake.robot is not None and welcome.robot != handshake.robot:
        raise _foreign(f"expected the gate of `{handshake.robot}`, got `{welcome.robot}`'s")
    if handshake.verifier is not None:
        _require_proof(welcome, handshake.verifier, nonce=nonce, now=now)
    if welcome.mode is Mode.SHADOW and handshake.role in _ENFORCED and not handshake.allow_shadow:
        raise RefusedError(
            "the gate is in shadow mode: it records what it would decide and releases nothing",
            reason=Reason.TRANSITION_REFUSED,
            where="welcome.mode",
        )
    if handshake.speaks is not None:
        _require_words(welcome, handshake.speaks)


def _require_words(welcome: Welcome, speaks: Speaks) -> None:
    """Require that what the gate releases means here what it means there."""
    for word in ("site", "binding"):
        mine, said = getattr(speaks, word), getattr(welcome, word)
        if said != mine:
            raise RefusedError(
                f"the gate has another {word} (`{said}`) than this end (`{mine}`): "
                "start both with the same files",
                reason=Reason.SITE_MISMATCH,
                where=f"welcome.{word}",
            )


def _require_proof(welcome: Welcome, verifier: GateVerifier, *, nonce: str, now: Now) -> None:
    """Require a signature over the nonce by the key whose certificate names this very robot."""
    if welcome.proof is None:
        raise AuthenticityError(
            "the gate did not prove its identity",
            reason=Reason.SIGNATURE_INVALID,
            where="welcome.proof",
        )
    data = welcome.proof.encode("utf-8")
    proof, _, _ = open_token(
        data, Proof, tag=Tag.HANDSHAKE, roles=_GATE, verifier=verifier, now=now
    )
    if (proof.role, proof.nonce) != (welcome.role, nonce):
        raise AuthenticityError(
            "the proof answers another hello",
            reason=Reason.SIGNATURE_INVALID,
            where="welcome.proof",
        )
    for endorsement in read_token(data).endorsements:
        chain = tuple(unb64(der, where="welcome.proof") for der in endorsement.chain)
        named, _ = verifier.gate_identity(chain, now)
        if not named == proof.robot == welcome.robot:
            raise _foreign(f"the proof is of `{named}`'s gate, not of `{welcome.robot}`'s")


def _foreign(message: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.ROBOT_MISMATCH, where="welcome.robot")
