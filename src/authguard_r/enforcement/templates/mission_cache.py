# SPDX-License-Identifier: Apache-2.0
"""Missions as they were when they were verified: read again, and held to no certificate.

Who signed a mission may be revoked while it is active. That ends what it authorizes; it must not
prevent its end. Spec page: docs/spec/standing.md#what-a-lost-signature-leaves
"""

from __future__ import annotations

from typing import TypeVar

from msgspec import Struct

from authguard_r.core.encoding import Tag, decode, digest_of, unb64
from authguard_r.core.errors import MalformedError, RefusedError, StoreError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission, require_schema
from authguard_r.core.quantities import to_ms
from authguard_r.core.reasons import Reason
from authguard_r.core.token import read_token
from authguard_r.enforcement.templates.instance import Instance, covered
from authguard_r.enforcement.templates.template import Template, require_sound
from authguard_r.enforcement.templates.template_store import InstancePair, is_pair

T = TypeVar("T")


class HeldMission(Struct, frozen=True, kw_only=True):
    """A mission that was verified when it was accepted; it is not checked again here.

    It says whose the mission is, when it ends and what is left to settle. It is no
    `VerifiedMission`: nothing is decided, resumed, chosen or approved by it.

    Args:
        mission: as signed.
        digest: of its bytes, which the registry holds since they were verified.
        expiry_ms: its last instant.
    """

    mission: Mission
    digest: Digest
    expiry_ms: int


def claimed(token: bytes, kind: type[T], *, tag: Tag) -> T:
    """Return what a token holds; its signature is not checked.

    Raises:
        MalformedError: no canonical token of this kind.
    """
    found = read_token(token)
    if found.kind is not tag:
        text = f"expected a token of kind `{tag}`, got `{found.kind}`"
        raise MalformedError(text, where="token.kind", reason=Reason.WRONG_KIND)
    payload = unb64(found.payload, where="token.payload")
    return decode(payload, kind, where=str(tag).split("/")[1])


def claimed_template(token: bytes) -> Digest:
    """Return the digest of the template that an instance token names; nothing is verified.

    Raises:
        MalformedError: not an instance token.
    """
    return claimed(token, Instance, tag=Tag.INSTANCE).template


def claimed_mission(token: bytes, template: bytes | None = None) -> Mission:
    """Return the mission that a token is, or that it makes of a template; nothing is verified.

    Args:
        token: a mission's, or with `template` an instance's.
        template: the template's token.

    Raises:
        MalformedError: they spell none.
        RefusedError: the instance is not of this template, or outside of it.
    """
    if template is None:
        mission = claimed(token, Mission, tag=Tag.MISSION)
        require_schema(mission)
        return mission
    whole = claimed(template, Template, tag=Tag.TEMPLATE)
    require_sound(whole)
    instance = claimed(token, Instance, tag=Tag.INSTANCE)
    return covered(instance, whole, digest_of(Tag.TEMPLATE, whole))


def held_mission(held: bytes, digest: Digest) -> HeldMission:
    """Return the mission of this digest out of what the store holds under it.

    Args:
        held: a token, or a pair of tokens.
        digest: of the mission that was verified.

    Raises:
        StoreError: it is of another mission, or of none.
    """
    try:
        mission = _read(held)
    except (MalformedError, RefusedError) as error:
        raise _corrupt(f"expected a mission: {error.message}") from error
    found = digest_of(Tag.MISSION, mission)
    if found != digest:
        raise _corrupt(f"expected the token of `{digest}`, got `{found}`'s")
    expiry_ms = to_ms(mission.expiry, where="mission.expiry")
    return HeldMission(mission=mission, digest=digest, expiry_ms=expiry_ms)


def _read(held: bytes) -> Mission:
    if not is_pair(held):
        return claimed_mission(held)
    pair = decode(held, InstancePair, where="token")
    return claimed_mission(pair.instance.encode("utf-8"), pair.template.encode("utf-8"))


def _corrupt(message: str) -> StoreError:
    return StoreError(message, where="mission", reason=Reason.STORE_CORRUPT)
