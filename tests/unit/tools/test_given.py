# SPDX-License-Identifier: Apache-2.0
"""The site that an end of a gate is given: signed, or plain where a demonstration says so."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from authguard_r.access.files import read_binding, trusted_site
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.quantities import Now
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.site.signed import sign_site
from fixtures import scenarios

PLAIN = scenarios.HOSPITAL / "site.yaml"


def test_a_plain_site_counts_beside_a_demonstrations_root_alone(tmp_path: Path) -> None:
    assert trusted_site(PLAIN, read_trust(scenarios.trust_folder())) == scenarios.site()
    folder = tmp_path / "trust"
    init_folder(
        folder, demo_members(scenarios.site(), (scenarios.RID,)), now=now(), title="A real site"
    )
    with pytest.raises(AuthenticityError, match="expected a signed site"):
        trusted_site(PLAIN, read_trust(folder))


def now() -> datetime:
    return datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)


def test_a_signed_site_counts_and_a_forged_one_does_not(tmp_path: Path) -> None:
    trust = read_trust(scenarios.trust_folder())
    path = tmp_path / "site.token"
    token = sign_site(scenarios.site(), folder_signer(scenarios.trust_folder(), "site-authority-1"))
    path.write_bytes(token)
    assert trusted_site(path, trust) == scenarios.site()
    assert trusted_site(path, trust, Now(scenarios.START_MS, 0)) == scenarios.site()
    path.write_bytes(
        sign_site(scenarios.site(), folder_signer(scenarios.trust_folder(), "operator-1"))
    )
    with pytest.raises(AuthenticityError):
        trusted_site(path, trust)


def test_a_binding_of_another_site_is_none() -> None:
    assert (
        read_binding(str(scenarios.HOSPITAL / "binding.yaml"), scenarios.site())
        == scenarios.binding()
    )
    with pytest.raises(MalformedError):
        read_binding("nav2", scenarios.site())
