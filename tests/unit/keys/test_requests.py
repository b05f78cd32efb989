# SPDX-License-Identifier: Apache-2.0
"""Requests and answers as anybody could write them: what does not hold is refused with a place."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec.structs import replace

from authguard_r.authoring.keys.authority import issue
from authguard_r.authoring.keys.folder import given
from authguard_r.authoring.keys.install import install_answer, install_list, open_answer
from authguard_r.authoring.keys.request import (
    CertificateAnswer,
    CertificateRequest,
    WantedCertificate,
    _message,
    make_request,
    open_request,
)
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.authoring.keys.setup import init_folder, read_authority
from authguard_r.core.encoding import b64, encode_fast, unb64
from authguard_r.core.errors import (
    AuthenticityError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
)
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Endorsement
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.certificate import Role
from authguard_r.keys.files import write_whole
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import pairs, read_certificates, read_trust
from fixtures.cases import case
from fixtures.revocation_lists import next_lists

TODAY = datetime(2030, 6, 15, 12, 0, 0, tzinfo=UTC)
NOW = Now(int(TODAY.timestamp()) * 1000, 0)
HYBRID = (Algorithm.ED25519, Algorithm.ML_DSA_65)
OPERATOR = WantedCertificate(
    principal="operator-1", role=Role.OPERATOR, every_robot=True, every_region=True
)


@pytest.fixture
def auth(tmp_path: Path) -> Path:
    init_folder(tmp_path / "auth", (), now=TODAY, title="Test root")
    return tmp_path / "auth"


def key() -> PrivateKey:
    return generate(Algorithm.ED25519)


def answered(auth: Path, wanted: WantedCertificate = OPERATOR, *keys: PrivateKey) -> bytes:
    request = open_request(make_request(wanted, keys or (key(),)))
    return issue(auth, request, now=TODAY, days=30)


def changed(data: bytes, kind: type[Any], **fields: Any) -> bytes:
    """Return a file with fields replaced, spelled as its maker would."""
    return encode_fast(replace(msgspec.json.decode(data, type=kind), **fields)) + b"\n"


def csr(by: Any, *names: x509.GeneralName, hashed: Any = None) -> str:
    builder = x509.CertificateSigningRequestBuilder().subject_name(x509.Name([]))
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return b64(builder.sign(by, hashed).public_bytes(Encoding.DER))


# requests


@pytest.mark.parametrize(
    ("proof", "reason"),
    [
        (b64(b"junk"), Reason.SIGNATURE_INVALID),
        ("", Reason.SIGNATURE_INVALID),
        (csr(key()), Reason.SIGNATURE_INVALID),
        (csr(key(), x509.UniformResourceIdentifier("urn:x:y")), Reason.SIGNATURE_INVALID),
        (csr(rsa.generate_private_key(65537, 2048), hashed=hashes.SHA256()), Reason.KEY_INVALID),
    ],
)
def test_a_proof_is_a_request_by_the_key_for_what_is_wanted(proof: str, reason: Reason) -> None:
    data = changed(make_request(OPERATOR, (key(),)), CertificateRequest, proofs=(proof,))
    with pytest.raises(AuthenticityError) as error:
        open_request(data)
    assert (error.value.reason, error.value.where) == (reason, "request.proofs")


def test_a_proof_whose_signature_was_changed_proves_nothing() -> None:
    data = make_request(OPERATOR, (key(),))
    proof = bytearray(unb64(msgspec.json.decode(data, type=CertificateRequest).proofs[0]))
    proof[-1] ^= 1
    with pytest.raises(AuthenticityError) as error:
        open_request(changed(data, CertificateRequest, proofs=(b64(bytes(proof)),)))
    assert error.value.reason is Reason.SIGNATURE_INVALID


def test_two_keys_are_of_two_algorithms() -> None:
    with pytest.raises(MalformedError, match="different algorithms"):
        open_request(make_request(OPERATOR, (key(), key())))
    assert len(open_request(make_request(OPERATOR, tuple(map(generate, HYBRID)))).keys) == 2


def test_what_no_certificate_can_say_is_refused_before_anybody_looks() -> None:
    for wanted, where in [
        (replace(OPERATOR, robots=("a",)), "request.robots"),
        (replace(OPERATOR, every_region=False, regions=("b", "a")), "request.regions"),
        (replace(OPERATOR, every_region=False, regions=("a", "a")), "request.regions"),
        (replace(OPERATOR, profile="A" * 43), "request.profile"),
        (replace(OPERATOR, template="A" * 43), "request.template"),
        (WantedCertificate(principal="s", role=Role.SCHEDULER), "request.template"),
        (WantedCertificate(principal="g", role=Role.GATE, robots=("a",)), "request.profile"),
        (WantedCertificate(principal="g", role=Role.GATE, profile="A" * 43), "request.robots"),
        (
            WantedCertificate(principal="e", role=Role.ESTIMATOR, robots=("a", "b")),
            "request.robots",
        ),
    ]:
        with case(wanted, where):
            with pytest.raises(MalformedError) as error:
                open_request(make_request(wanted, (key(),)))
            assert error.value.where == where


def test_every_role_can_be_had(auth: Path) -> None:
    more: dict[Role, dict[str, Any]] = {
        Role.GATE: {"robots": ("a",), "profile": "A" * 43},
        Role.ESTIMATOR: {"robots": ("a",)},
        Role.SCHEDULER: {"template": "A" * 43},
    }
    for role in Role:
        wanted = WantedCertificate(principal=f"{role}-1", role=role, **more.get(role, {}))
        (leaf,) = open_answer(answered(auth, wanted), NOW).leaves
        assert (leaf.role, leaf.principal) == (role, f"{role}-1")


# who has a name


def signer(auth: Path, wanted: WantedCertificate, mine: PrivateKey) -> FileSigner:
    opened = open_answer(answered(auth, wanted, mine), NOW)
    return FileSigner(mine, opened.chains[0])


def test_another_name_hands_nothing_on(auth: Path) -> None:
    answered(auth)
    other = signer(auth, replace(OPERATOR, principal="operator-2"), key())
    request = open_request(make_request(OPERATOR, (key(),), before=other))
    with pytest.raises(AuthenticityError) as error:
        issue(auth, request, now=TODAY, days=30)
    assert (error.value.reason, error.value.where) == (Reason.ISSUER_MISMATCH, "request.renews")


def test_a_revoked_key_hands_nothing_on(auth: Path) -> None:
    mine = signer(auth, OPERATOR, key())
    revoke(auth, principal="operator-1", serial=None, now=TODAY, days=30)
    request = open_request(make_request(OPERATOR, (key(),), before=mine))
    with pytest.raises(AuthenticityError) as error:
        issue(auth, request, now=TODAY, days=30)
    assert error.value.reason is Reason.CERTIFICATE_REVOKED


def test_what_the_holder_signed_is_for_these_keys_alone(auth: Path) -> None:
    mine = signer(auth, OPERATOR, key())
    theirs = key()
    honest = msgspec.json.decode(
        make_request(OPERATOR, (key(),), before=mine), type=CertificateRequest
    )
    data = changed(make_request(OPERATOR, (theirs,)), CertificateRequest, renews=honest.renews)
    with pytest.raises(AuthenticityError) as error:
        issue(auth, open_request(data), now=TODAY, days=30)
    assert error.value.reason is Reason.SIGNATURE_INVALID
    assert isinstance(honest.renews[0], Endorsement)
    assert _message(OPERATOR, honest.proofs) != _message(OPERATOR, ("x",))


def test_a_name_is_free_again_once_its_certificates_ended(auth: Path) -> None:
    answered(auth)
    request = open_request(make_request(OPERATOR, (key(),)))
    with pytest.raises(RefusedError):
        issue(auth, request, now=TODAY, days=30)
    late = TODAY + timedelta(days=31)
    assert issue(auth, request, now=late, days=30)


def test_a_strangers_certificate_in_the_folder_is_said(auth: Path, tmp_path: Path) -> None:
    init_folder(tmp_path / "other", (), now=TODAY)
    answered(tmp_path / "other")
    (stranger,) = (tmp_path / "other/issued").iterdir()
    (auth / "issued").mkdir()
    (auth / "issued" / stranger.name).write_bytes(stranger.read_bytes())
    with pytest.raises(AuthenticityError) as error:
        given(auth)
    assert error.value.where == str(auth / "issued" / stranger.name)


def test_a_certificate_without_its_authority_is_no_chain(auth: Path) -> None:
    with pytest.raises(AuthenticityError, match="with its authority"):
        pairs(read_certificates(auth / "root.pem"))


def test_without_the_authoritys_key_nothing_is_given_and_no_list_is_signed(auth: Path) -> None:
    answered(auth)
    before = (auth / "revocations/people.json").read_bytes()
    (auth / "keys/people.key.pem").unlink()
    with pytest.raises(EnvironmentFault):
        answered(auth, replace(OPERATOR, principal="operator-2"))
    with pytest.raises(EnvironmentFault):
        revoke(auth, principal="operator-1", serial=None, now=TODAY, days=30)
    assert (auth / "revocations/people.json").read_bytes() == before
    (auth / "authorities/site.pem").unlink()
    with pytest.raises(EnvironmentFault):
        read_authority(auth, "site")


# answers


def test_an_answer_brings_all_that_is_needed(auth: Path, tmp_path: Path) -> None:
    opened = open_answer(answered(auth), NOW)
    install_answer(tmp_path / "trust", opened, NOW)
    trust = read_trust(tmp_path / "trust")
    assert trust.identify(opened.chains[0], NOW).principal == "operator-1"
    assert {known.authority for known in trust.lists.values()} == {
        "root", "people", "site", "machines"
    }  # fmt: skip
    assert not (tmp_path / "trust/keys").exists()


def test_an_answer_never_brings_an_older_list(auth: Path, tmp_path: Path) -> None:
    older = open_answer(answered(auth), NOW)
    next_lists(auth, {"people": {7}}, now=TODAY, days=30)
    install_answer(tmp_path / "trust", open_answer(answered(auth, _other("b")), NOW), NOW)
    install_answer(tmp_path / "trust", older, NOW)
    lists = read_trust(tmp_path / "trust").lists.values()
    assert {known.authority: known.number for known in lists}["people"] == 2
    next_lists(auth, {"people": set()}, now=TODAY, days=30)
    install_answer(tmp_path / "trust", open_answer(answered(auth, _other("c")), NOW), NOW)
    lists = read_trust(tmp_path / "trust").lists.values()
    assert {known.authority: known.number for known in lists}["people"] == 3


def _other(name: str) -> WantedCertificate:
    return replace(OPERATOR, principal=name)


@pytest.mark.parametrize("fault", ["no list", "a list too many", "an authority called root"])
def test_an_answer_has_the_list_of_each_authority(auth: Path, fault: str) -> None:
    data = answered(auth)
    plain = msgspec.json.decode(data, type=CertificateAnswer)
    lists, authorities = dict(plain.lists), dict(plain.authorities)
    if fault == "no list":
        del lists["people"]
    elif fault == "a list too many":
        lists["zzz"] = lists["people"]
    else:
        authorities["root"] = authorities["people"]
    with pytest.raises(MalformedError) as error:
        open_answer(changed(data, CertificateAnswer, lists=lists, authorities=authorities), NOW)
    assert error.value.where == "answer.lists"


def test_an_answer_is_signed_all_the_way_to_its_root(auth: Path, tmp_path: Path) -> None:
    data = answered(auth)
    init_folder(tmp_path / "other", (), now=TODAY)
    other = msgspec.json.decode(answered(tmp_path / "other"), type=CertificateAnswer)
    for fields in (
        {"roots": other.roots},
        {"chains": other.chains},
        {"authorities": other.authorities},
        {"lists": other.lists},
        {"roots": (b64(b"junk"),)},
        {"authorities": {**other.authorities, "people": ""}},
    ):
        with pytest.raises(AuthenticityError):
            open_answer(changed(data, CertificateAnswer, **fields), NOW)


def test_an_answer_has_a_certificate_under_each_root(tmp_path: Path) -> None:
    init_folder(tmp_path / "auth", (), now=TODAY, algorithms=HYBRID)
    data = answered(tmp_path / "auth", OPERATOR, *map(generate, HYBRID))
    both = msgspec.json.decode(data, type=CertificateAnswer)
    assert [leaf.root for leaf in open_answer(data, NOW).leaves] == [0, 1]
    for chains in (both.chains[:1], both.chains[::-1], (both.chains[0], both.chains[0])):
        with pytest.raises(MalformedError) as error:
            open_answer(changed(data, CertificateAnswer, chains=chains), NOW)
        assert error.value.where == "answer.chains"


# files


def test_a_file_that_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(EnvironmentFault) as error:
        write_whole(tmp_path / "taken", b"x")
    assert error.value.where == str(tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
    with pytest.raises(EnvironmentFault):
        write_whole(tmp_path / "absent" / "x", b"x")


def test_a_list_is_put_in_a_folder_once(auth: Path, tmp_path: Path) -> None:
    install_answer(tmp_path / "trust", open_answer(answered(auth), NOW), NOW)
    data = next_lists(auth, {"people": {7}}, now=TODAY, days=30)["people"].signed
    assert install_list(tmp_path / "trust", data, NOW).number == 2
    path = tmp_path / "trust/revocations/people.json"
    written = path.stat().st_ino
    # the very same is there already, as long as it is not over
    assert install_list(tmp_path / "trust", data, NOW).number == 2
    assert path.stat().st_ino == written
    late = Now(NOW.utc_ms + 31 * 86_400_000, 0)
    other = (auth / "revocations/site.json").read_bytes()
    assert install_list(tmp_path / "trust", other, NOW).number == 1
    with pytest.raises(AuthenticityError) as error:
        install_list(tmp_path / "trust", data, late)
    assert error.value.reason is Reason.REVOCATION_STALE
