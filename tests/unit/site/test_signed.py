# SPDX-License-Identifier: Apache-2.0
"""A site speaks for its authority only when its token holds, and only when somebody looked."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import Site, site_digest
from authguard_r.site.signed import (
    SignedSite,
    is_token,
    read_claimed_site,
    read_signed_site,
    sign_site,
)
from fixtures import scenarios

replace = msgspec.structs.replace


def signed(site: Site | None = None, by: str = "site-authority-1") -> bytes:
    return sign_object(
        site or scenarios.site(), Tag.SITE, folder_signer(scenarios.trust_folder(), by)
    )


def read(data: bytes, now: Now = scenarios.NOW) -> SignedSite:
    return read_signed_site(data, verifier=read_trust(scenarios.trust_folder()), now=now, where="x")


def test_what_the_site_authority_signed_is_what_is_read() -> None:
    token = sign_site(
        scenarios.site(), folder_signer(scenarios.trust_folder(), "site-authority-1"), where="x"
    )
    opened = read(token)
    assert opened.site == read_claimed_site(token) == scenarios.site()
    assert opened.digest == site_digest(scenarios.site())
    assert (opened.signer.id, opened.signer.role) == ("site-authority-1", "site_authority")
    assert is_token(token)
    assert not is_token((scenarios.HOSPITAL / "site.yaml").read_bytes())


@pytest.mark.parametrize("by", ["operator-1", "supervisor-1", "safety-officer-1", "gate-courier-1"])
def test_nobody_but_the_site_authority_says_what_words_mean(by: str) -> None:
    with pytest.raises(AuthenticityError) as caught:
        read(signed(by=by))
    assert caught.value.reason is Reason.ROLE_DENIED


def test_a_token_of_another_kind_is_no_site() -> None:
    signer = folder_signer(scenarios.trust_folder(), "site-authority-1")
    token = sign_object(scenarios.mission(), Tag.MISSION, signer)
    for reader in (read, read_claimed_site):
        with pytest.raises(MalformedError) as caught:
            reader(token)  # type: ignore[operator]
        assert caught.value.where == "token.kind"


def test_one_moved_wall_breaks_the_signature() -> None:
    dock = scenarios.site().regions["dock"]
    moved = replace(dock, points=((34000, 0), (38001, 0), (38000, 3000), (34000, 3000)))
    other = replace(scenarios.site(), regions={**scenarios.site().regions, "dock": moved})
    real, forged = msgspec.json.decode(signed()), msgspec.json.decode(signed(other))
    mixed = msgspec.json.encode({**real, "payload": forged["payload"]}, order="sorted")
    with pytest.raises((AuthenticityError, MalformedError)):
        read(mixed)


def test_a_certificate_that_has_ended_signs_nothing() -> None:
    later = Now(scenarios.START_MS + 400 * 86_400_000, 0)
    with pytest.raises(AuthenticityError):
        read(signed(), later)


def test_a_signed_site_with_a_fault_is_refused() -> None:
    broken = replace(scenarios.site(), baseline=("navigate",))
    with pytest.raises(MalformedError) as caught:
        read(signed(broken))
    assert caught.value.where == "x:baseline[0]"
    with pytest.raises(MalformedError):
        sign_site(broken, folder_signer(scenarios.trust_folder(), "site-authority-1"))


def test_an_import_that_nobody_went_through_is_not_signed() -> None:
    signer = folder_signer(scenarios.trust_folder(), "site-authority-1")
    site = scenarios.site()
    dock = replace(site.regions["dock"], tags=("staff", "unreviewed"))
    bin_ = replace(site.objects["sharps-bin"], kind="unreviewed")
    one = replace(site, regions={**site.regions, "dock": dock})
    with pytest.raises(MalformedError) as caught:
        sign_site(one, signer, where="x")
    assert caught.value.where == "x:regions.dock.tags"
    assert "more" not in caught.value.message
    two = replace(one, objects={**site.objects, "sharps-bin": bin_})
    with pytest.raises(MalformedError, match="and 1 more"):
        sign_site(two, signer, where="x")
