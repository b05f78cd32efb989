# SPDX-License-Identifier: Apache-2.0
"""The record that a person confirmed a template's signature: once, for all of its missions.

Like a mission's: it lies beside the token, goes sealed into the log, and grants nothing.
How-to: docs/howto/templates.md
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from authguard_r.core.encoding import Tag, decode, digest_of, encode
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import Count, Digest, PrincipalId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.confirmation import ConfirmationMode, LintCode
from authguard_r.enforcement.templates.template import Template, TemplateId


class TemplateConfirmation(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """One confirmation, as it is stored.

    Args:
        schema: version of this record.
        digest: of the template that was signed.
        template: its name.
        by: who signed, as the signing key's certificate must say.
        at_ms: the signing machine's clock, milliseconds since 1970; not attested.
        how: whether a person was asked.
        shown: whether the signer saw card and lint.
        card: digest of the card that was shown; absent when none was.
        accepted: codes of lint errors that the signer accepted by name, sorted.
    """

    schema: Literal["authguard-r/template-confirmation/1"]
    digest: Digest
    template: TemplateId
    by: PrincipalId
    at_ms: Count
    how: ConfirmationMode
    shown: bool
    card: Digest | None = None
    accepted: tuple[LintCode, ...] = ()


def confirm_template(
    template: Template,
    *,
    card: Digest | None,
    how: ConfirmationMode,
    accepted: tuple[LintCode, ...],
    now: Now,
) -> TemplateConfirmation:
    """Return the record of a template being signed now by its issuer."""
    return TemplateConfirmation(
        schema="authguard-r/template-confirmation/1",
        digest=digest_of(Tag.TEMPLATE, template),
        template=template.template,
        by=PrincipalId(template.mission["issuer"]),
        at_ms=now.utc_ms,
        how=how,
        shown=card is not None,
        card=card,
        accepted=tuple(sorted(accepted)),
    )


def template_inputs(
    token: bytes, confirmation: bytes | None, template: Template
) -> dict[str, object]:
    """Return what a template's record seals: the token, and the confirmation or the word `none`.

    Raises:
        MalformedError: the confirmation is not valid.
        RefusedError: it is of another template.
    """
    said: object = "none"
    if confirmation is not None:
        found = decode(confirmation.removesuffix(b"\n"), TemplateConfirmation, where="confirmation")
        again = confirm_template(
            template,
            card=found.card,
            how=found.how,
            accepted=found.accepted,
            now=Now(found.at_ms, 0),
        )
        if found != again:
            raise RefusedError(
                f"expected the confirmation of `{template.template}`, as signed",
                reason=Reason.META_MISMATCH,
                where="confirmation",
            )
        said = found
    return {"token": token.decode("ascii").strip(), "confirmation": said}


def confirmation_bytes(confirmation: TemplateConfirmation) -> bytes:
    """Return the canonical bytes, with a final newline for files."""
    return encode(confirmation) + b"\n"
