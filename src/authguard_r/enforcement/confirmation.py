# SPDX-License-Identifier: Apache-2.0
"""The record of a signature being meant: what was shown, to whom, when, and what was accepted.

It lies beside the token and goes, sealed, into the log with the activation. It proves nothing by
itself and no check of an action reads it; the signature is the authority. How-to:
docs/howto/missions.md
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

from msgspec import Struct

from authguard_r.core.encoding import Tag, decode, digest_of, encode
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.identifiers import Count, Digest, MissionId, Positive, PrincipalId
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason


class LintCode(StrEnum):
    """Every kind of finding; docs/spec/lint.md says what each means."""

    SITE_DIFFERS = "SITE_DIFFERS"
    UNGUARDED_RETURN = "UNGUARDED_RETURN"
    PARAMETER_UNBOUNDED = "PARAMETER_UNBOUNDED"
    BOUND_WIDE = "BOUND_WIDE"
    WIDER_THAN_TASK = "WIDER_THAN_TASK"
    RETENTION_OPEN = "RETENTION_OPEN"
    THROUGH_SENSITIVE = "THROUGH_SENSITIVE"
    WINDOW_LONG = "WINDOW_LONG"
    NEVER_MATCHES = "NEVER_MATCHES"
    NEVER_ASKS = "NEVER_ASKS"
    STREAM_UNBOUNDED = "STREAM_UNBOUNDED"
    BEYOND_PROFILE = "BEYOND_PROFILE"
    PLANNER_CHOOSES_RISK = "PLANNER_CHOOSES_RISK"
    RISK_UNLISTED = "RISK_UNLISTED"


class ConfirmationMode(StrEnum):
    """Whether a person was asked, or a script went ahead."""

    INTERACTIVE = "interactive"
    SCRIPT = "script"


class Confirmation(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """One confirmation, as it is stored.

    Args:
        schema: version of this record.
        mission: digest of the mission that was signed.
        mid: its name.
        version: its version.
        request: its task, in the operator's words.
        by: who signed: the issuer, as the signing key's certificate must say.
        at_ms: the signing machine's clock, milliseconds since 1970; not attested.
        how: whether a person was asked.
        shown: whether the signer saw card and lint.
        card: digest of the card that was shown; absent when none was.
        accepted: codes of lint errors that the signer accepted by name, sorted.
    """

    schema: Literal["authguard-r/confirmation/1"]
    mission: Digest
    mid: MissionId
    version: Positive
    request: str
    by: PrincipalId
    at_ms: Count
    how: ConfirmationMode
    shown: bool
    card: Digest | None = None
    accepted: tuple[LintCode, ...] = ()


def confirm(
    mission: Mission,
    *,
    card: Digest | None,
    how: ConfirmationMode,
    accepted: tuple[LintCode, ...],
    now: Now,
) -> Confirmation:
    """Return the record of a mission being signed now by its issuer.

    Args:
        mission: the very structure that is signed.
        card: digest of the card that was shown; None when nothing was.
        how: whether a person was asked.
        accepted: lint errors that were accepted by name.
        now: the signing machine's clock.
    """
    return Confirmation(
        schema="authguard-r/confirmation/1",
        mission=digest_of(Tag.MISSION, mission),
        mid=mission.mid,
        version=mission.version,
        request=mission.task,
        by=mission.issuer,
        at_ms=now.utc_ms,
        how=how,
        shown=card is not None,
        card=card,
        accepted=tuple(sorted(accepted)),
    )


def confirmation_bytes(confirmation: Confirmation) -> bytes:
    """Return the canonical bytes, with a final newline for files."""
    return encode(confirmation) + b"\n"


def read_confirmation(data: bytes, *, mission: Mission) -> Confirmation:
    """Return the confirmation in a file, of this very mission.

    Args:
        data: the file's bytes, from anyone.
        mission: the verified mission that it must be of.

    Raises:
        MalformedError: not a canonical confirmation.
        RefusedError: the confirmation of another mission.
    """
    found = decode(data.removesuffix(b"\n"), Confirmation, where="confirmation")
    if list(found.accepted) != sorted(set(found.accepted)):
        raise MalformedError("expected a sorted set", where="confirmation.accepted")
    if found != confirm(
        mission, card=found.card, how=found.how, accepted=found.accepted, now=Now(found.at_ms, 0)
    ):
        raise RefusedError(
            f"expected the confirmation of `{mission.mid}` version {mission.version}, as signed",
            reason=Reason.META_MISMATCH,
            where="confirmation",
        )
    return found


def signed_inputs(token: bytes, confirmation: bytes | None, mission: Mission) -> dict[str, object]:
    """Return what an activation's record seals: the token, and the confirmation or the word `none`.

    Raises:
        MalformedError: the confirmation is not valid.
        RefusedError: it is of another mission.
    """
    said = "none" if confirmation is None else read_confirmation(confirmation, mission=mission)
    return {"token": token.decode("ascii").strip(), "confirmation": said}
