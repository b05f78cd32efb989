# SPDX-License-Identifier: Apache-2.0
"""Certificates as a decision point judges them: in time, unrevoked, of the right role and robot."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.setup import Member, init_folder
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.quantities import Now
from authguard_r.integrations.http.clients import ROLES, Authenticator, Certificates
from authguard_r.integrations.http.faults import RequestError
from authguard_r.keys.certificate import Role
from authguard_r.keys.trust import read_trust
from fixtures import scenarios

LATER = Now(scenarios.START_MS + 366 * 86_400_000, 0)


def chain(name: str, folder: Path | None = None) -> tuple[bytes, ...]:
    path = (folder or scenarios.trust_folder()) / "keys" / f"{name}.cert.pem"
    found = x509.load_pem_x509_certificates(path.read_bytes())
    return tuple(certificate.public_bytes(Encoding.DER) for certificate in found)


def refused(
    shown: tuple[bytes, ...], folder: Path | None = None, now: Now = scenarios.NOW
) -> tuple[int, str]:
    """Return status and code of somebody who is not let in."""
    root = folder or scenarios.trust_folder()
    held = Certificates(lambda: read_trust(root), scenarios.RID, ROLES, lambda: now)
    with pytest.raises(RequestError) as error:
        held.who(shown)
    return error.value.status, error.value.code


def test_who_is_let_in_is_named() -> None:
    held = Certificates(
        lambda: read_trust(scenarios.trust_folder()), scenarios.RID, ROLES, lambda: scenarios.NOW
    )
    assert held.who(chain("operator-1")) == "operator-1"


def test_a_certificate_that_has_expired_is_nobodys() -> None:
    assert refused(chain("operator-1"), now=LATER) == (401, "CERTIFICATE_EXPIRED")


def test_a_chain_that_is_none_is_nobodys() -> None:
    operator, people = chain("operator-1")
    for shown in ((), (operator,), (people, operator), (operator, people, people), (b"", b"")):
        assert refused(shown) == (401, "CERTIFICATE_INVALID")


def test_a_machines_certificate_does_not_ask() -> None:
    assert refused(chain("gate-courier-1")) == (403, "ROLE_DENIED")


def test_an_operator_of_another_robot_does_not_ask(tmp_path: Path) -> None:
    folder = tmp_path / "trust"
    elsewhere = Member(
        id=PrincipalId("operator-9"), role=Role.OPERATOR, robots=(scenarios.OTHER,), regions=None
    )
    init_folder(folder, (elsewhere,), now=datetime.fromtimestamp(scenarios.START_MS / 1000, UTC))
    assert refused(chain("operator-9", folder), folder) == (403, "SIGNER_OUT_OF_SCOPE")


def test_without_a_trust_root_nobody_can_say(tmp_path: Path) -> None:
    assert refused(chain("operator-1"), tmp_path / "gone") == (503, "FILE_UNAVAILABLE")


def test_somebody_is_asked_for_something() -> None:
    with pytest.raises(ValueError, match="expected a token"):
        Authenticator(None, None)
