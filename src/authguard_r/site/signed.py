# SPDX-License-Identifier: Apache-2.0
"""The site model as the site authority signed it.

A file that an author can change says nothing about a place; a token says what the site authority
says. A gate outside demonstration takes no other. Spec page: docs/spec/site-model.md#signed
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.encoding import Tag, decode, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.principals import Principal, Signer, Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.token import open_token, read_token, sign_object
from authguard_r.site.check import unreviewed
from authguard_r.site.model import Site
from authguard_r.site.source import require_sound

#: Roles that may say what the words of a place mean.
AUTHORITY_ROLES = frozenset({"site_authority"})


class SignedSite(Struct, frozen=True, kw_only=True):
    """A site model whose signature held.

    Args:
        site: the model; without faults.
        digest: what a mission binds.
        signer: the site authority.
    """

    site: Site
    digest: Digest
    signer: Principal


def is_token(data: bytes) -> bool:
    """True when the bytes claim to be a token; what claims it is never read as plain YAML."""
    return b'"endorsements"' in data


def read_signed_site(
    data: bytes, *, verifier: Verifier, now: Now, where: str = "site"
) -> SignedSite:
    """Return the site in a token once the site authority's signature holds.

    Args:
        data: the token's bytes, from anyone.
        verifier: checks chain, revocation and signature.
        now: the instant at which certificates must be valid.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: no canonical token of a site, or a site with faults.
        AuthenticityError: a certificate or signature does not hold, or the signer is no site
            authority.
    """
    site, digest, signer = open_token(
        data, Site, tag=Tag.SITE, roles=AUTHORITY_ROLES, verifier=verifier, now=now
    )
    return SignedSite(site=require_sound(site, where=where), digest=digest, signer=signer)


def read_claimed_site(data: bytes) -> Site:
    """Return the site in a token without any claim that it is authentic; for looking at it.

    Raises:
        MalformedError: no canonical token of a site.
    """
    token = read_token(data)
    if token.kind is not Tag.SITE:
        raise MalformedError(
            f"expected a token of kind `{Tag.SITE}`, got `{token.kind}`", where="token.kind"
        )
    return decode(unb64(token.payload, where="token.payload"), Site, where="site")


def sign_site(site: Site, signer: Signer, *, where: str = "site") -> bytes:
    """Return the token over a site model.

    Args:
        site: what the site authority has read and means.
        signer: the site authority's key; who it really is, the reader of the token checks.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: the site has faults, or an import's `unreviewed` still stands in it: a
            signature says that a person looked.
    """
    require_sound(site, where=where)
    left = unreviewed(site)
    if left:
        more = f" (and {len(left) - 1} more)" if len(left) > 1 else ""
        raise MalformedError(
            f"expected a person's own text instead of `unreviewed`{more}",
            where=f"{where}:{left[0]}",
        )
    return sign_object(site, Tag.SITE, signer)
