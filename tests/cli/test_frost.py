# SPDX-License-Identifier: Apache-2.0
"""`authguard advanced frost`: each person's step, and what each refuses."""

from __future__ import annotations

import io
import json
import stat
import subprocess
import sys
from base64 import b64encode
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.setup import init_folder
from authguard_r.cli import call
from authguard_r.core.encoding import encode
from authguard_r.frost.messages import Contribution, Offer, Share, SignatureShare, read
from authguard_r.keys.algorithms import Algorithm
from fixtures import scenarios
from fixtures.threshold_groups import one_more, spoiled

SITE = ("--site", str(scenarios.HOSPITAL / "site.yaml"))
PEOPLE = ("ana", "ben", "cho")
PLAN = {"plan": [{"tool": "navigate_to", "arguments": {"destination": "Pharmacy", "speed": 0.5}}]}


class Desk:
    """A folder in which every step is run; what it printed as JSON, and its exit code."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._capsys = capsys

    def run(self, *words: str) -> tuple[int, Any]:
        self._capsys.readouterr()
        code = call([*words, "--json"])
        out = self._capsys.readouterr().out
        return code, json.loads(out.splitlines()[-1]) if out.strip() else None

    def done(self, *words: str) -> Any:
        code, said = self.run(*words)
        assert code == 0, said
        return said

    def refused(self, *words: str, code: int) -> str:
        got, said = self.run(*words)
        assert got == code, said
        return f"{said['error']['code']}: {said['error']['message']}"

    def __getitem__(self, name: str) -> str:
        return str(self.folder / name)


@pytest.fixture
def desk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Desk:
    monkeypatch.chdir(tmp_path)
    return Desk(tmp_path, capsys)


def members(names: tuple[str, ...] = PEOPLE) -> list[str]:
    return [word for name in names for word in ("--member", name)]


def dealt(desk: Desk, *, threshold: int = 2) -> None:
    group = ("--group", "board-1", "--threshold", str(threshold))
    desk.done("advanced", "frost", "deal", *group, *members(), "--out", "dealt")


def asked(desk: Desk, *, needed: int = 3) -> list[str]:
    """Open a request at a store; return where it is."""
    desk.done("keys", "init", "trust")
    source = (scenarios.HOSPITAL / "mission.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("tau_1: 30", "tau_1: 1"),
        ("tau_2: 60", "tau_2: 2"),
        ("  t: 3", f"  t: {needed}"),
    ):
        assert old in source
        source = source.replace(old, new)
    Path("careful.yaml").write_text(source, encoding="utf-8")
    Path("plan.json").write_text(json.dumps(PLAN), encoding="utf-8")
    desk.done("mission", "compile", "careful.yaml", *SITE, "--out", "careful.json")
    key = ("--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem")
    desk.done("mission", "sign", "careful.json", *key, *SITE, "--yes")
    assert run(desk)[0] == 3
    return ["--store", "robot.db", "--trust", "trust", *SITE]


def run(desk: Desk) -> tuple[int, Any]:
    binding = ("--binding", str(scenarios.HOSPITAL / "binding.yaml"))
    told = ("--token", "careful.token", "--trust", "trust", "--store", "robot.db")
    return desk.run("run", *told, *SITE, *binding, "--plan", "plan.json")


def certified(desk: Desk) -> None:
    scope = ("--every-robot", "--every-region")
    group = ("--group", "dealt/group.json", "--role", "supervisor")
    desk.done("advanced", "frost", "certify", "--trust", "trust", *group, *scope, "--yes")


def commitments(desk: Desk, *names: str) -> list[str]:
    for name in names:
        share = ("--share", f"dealt/{name}.share.json", "--nonces", f"{name}.nonces")
        desk.done("advanced", "frost", "commit", *share, "--out", f"{name}.commitment.json")
    return [word for name in names for word in ("--commitment", f"{name}.commitment.json")]


def share_words(name: str, signers: list[str]) -> list[str]:
    own = ["--share", f"dealt/{name}.share.json", "--nonces", f"{name}.nonces"]
    return [
        "advanced",
        "frost",
        "share",
        *own,
        "--ballot",
        "ballot.json",
        *signers,
        "--out",
        f"{name}.part.json",
    ]


def aggregate_words(*names: str, signers: list[str], cert: str = "board-1") -> list[str]:
    parts = [word for name in names for word in ("--part", f"{name}.part.json")]
    told = ["--group", "dealt/group.json", "--cert", f"trust/keys/{cert}.cert.pem"]
    return [
        "advanced",
        "frost",
        "aggregate",
        *told,
        "--ballot",
        "ballot.json",
        *signers,
        *parts,
        "--out",
        "a.token",
    ]


def ready(
    desk: Desk, *, needed: int = 3, more: tuple[str, ...] = ()
) -> tuple[list[str], list[str]]:
    """Return where requests are and the commitments, with ballot and certificate there."""
    dealt(desk)
    place = asked(desk, needed=needed)
    certified(desk)
    desk.done("advanced", "frost", "ballot", "1", *place, "--out", "ballot.json", *more)
    return place, commitments(desk, "ana", "cho")


def test_two_of_three_approve_with_files_that_move(desk: Desk) -> None:
    place, signers = ready(desk)
    for name in ("ana", "cho"):
        said = desk.done(*share_words(name, signers), "--yes")
        assert said["ballot"]["scope"]["destination"] == "pharmacy"
    said = desk.done(*aggregate_words("ana", "cho", signers=signers))
    assert (said["group"], said["signers"]) == ("board-1", ["ana", "cho"])
    told = desk.done("advanced", "frost", "submit", "a.token", *place)
    assert (told["approver"], told["counts"]) == ("board-1", True)
    code, said = run(desk)
    assert (code, said["robot"]["region"]) == (0, "pharmacy")


def test_an_answer_that_does_not_count_is_exit_1_and_says_why(desk: Desk) -> None:
    place, signers = ready(desk)
    for name in ("ana", "cho"):
        desk.done(*share_words(name, signers), "--yes")
    desk.done(*aggregate_words("ana", "cho", signers=signers))
    desk.done("advanced", "frost", "submit", "a.token", *place)
    assert run(desk)[0] == 0
    code, told = desk.run("advanced", "frost", "submit", "a.token", *place)
    assert (code, told["counts"], told["why_not"]) == (1, False, "APPROVAL_TIMEOUT")


def test_a_group_denies(desk: Desk) -> None:
    place, signers = ready(desk, more=("--deny",))
    for name in ("ana", "cho"):
        desk.done(*share_words(name, signers), "--yes")
    desk.done(*aggregate_words("ana", "cho", signers=signers))
    told = desk.done("advanced", "frost", "submit", "a.token", *place, "--reason", "not today")
    assert told["verdict"] == "deny"
    code, said = run(desk)
    assert (code, said["steps"][0]["reasons"]) == (1, ["APPROVAL_DENIED"])


def test_nobody_signs_what_was_not_shown_and_confirmed(
    desk: Desk, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without `--yes` and without a person nothing is signed, and the nonces are still there."""
    _, signers = ready(desk)
    capsys.readouterr()
    for typed in ("n\n", ""):
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        assert call(share_words("ana", signers)) == 2
    shown = capsys.readouterr().out
    for told in ("APPROVE this one action of robot courier-1", "to pharmacy", "as ana of board-1?"):
        assert told in shown
    assert not Path("ana.part.json").exists()
    desk.done(*share_words("ana", signers), "--yes")


def test_used_nonces_are_refused_by_the_next_command(desk: Desk) -> None:
    _, signers = ready(desk)
    desk.done(*share_words("ana", signers), "--yes")
    Path("ana.part.json").unlink()
    assert "KEY_REUSED" in desk.refused(*share_words("ana", signers), "--yes", code=1)
    assert not Path("ana.part.json").exists()


def test_a_part_that_does_not_hold_names_its_giver(desk: Desk) -> None:
    _, signers = ready(desk)
    for name in ("ana", "cho"):
        desk.done(*share_words(name, signers), "--yes")
    path = Path("cho.part.json")
    part = read(path.read_bytes(), SignatureShare, where="")
    path.write_bytes(encode(spoiled(part, share=one_more(part.share))))
    said = desk.refused(*aggregate_words("ana", "cho", signers=signers), code=4)
    assert said == "SIGNATURE_INVALID: the share of `cho` is not valid"
    assert not Path("a.token").exists()


def test_too_few_commitments_or_parts_make_nothing(desk: Desk) -> None:
    _, signers = ready(desk)
    said = desk.refused(*share_words("ana", signers[:2]), "--yes", code=1)
    assert "at least 2 members" in said
    desk.done(*share_words("ana", signers), "--yes")
    said = desk.refused(*aggregate_words("ana", signers=signers), code=4)
    assert "missing: `cho`" in said
    assert "commitment of `ben`" in desk.refused(*share_words("ben", signers), "--yes", code=1)


def test_a_request_that_ran_out_is_not_signed(desk: Desk) -> None:
    _, signers = ready(desk)
    ballot = json.loads(Path("ballot.json").read_bytes())
    ballot["approval"]["expires_ms"] = 1_000
    Path("ballot.json").write_bytes(encode(ballot))
    assert "APPROVAL_TIMEOUT" in desk.refused(*share_words("ana", signers), "--yes", code=1)


def test_a_ballot_that_shows_another_action_is_no_ballot(desk: Desk) -> None:
    _, signers = ready(desk)
    ballot = json.loads(Path("ballot.json").read_bytes())
    ballot["scope"]["destination"] = "station-101"
    Path("ballot.json").write_bytes(encode(ballot))
    said = desk.refused(*share_words("ana", signers), "--yes", code=4)
    assert "the action that the approval names" in said


def test_a_certificate_of_somebody_else_or_of_other_members_is_refused(desk: Desk) -> None:
    _, signers = ready(desk)
    for name in ("ana", "cho"):
        desk.done(*share_words(name, signers), "--yes")
    said = desk.refused(
        *aggregate_words("ana", "cho", signers=signers, cert="supervisor-1"), code=4
    )
    assert "the certificate of the group's key" in said
    group = json.loads(Path("dealt/group.json").read_bytes())
    Path("other.json").write_bytes(encode({**group, "id": "board-7", "members": ["x", "y", "z"]}))
    scope = ("--every-robot", "--every-region", "--role", "supervisor")
    init_folder(Path("elsewhere"), (), now=datetime.now(UTC))  # here the key is board-1's alone
    desk.done(
        "advanced",
        "frost",
        "certify",
        "--trust",
        "elsewhere",
        "--group",
        "other.json",
        *scope,
        "--yes",
    )
    other = "../../elsewhere/keys/board-7"
    said = desk.refused(*aggregate_words("ana", "cho", signers=signers, cert=other), code=4)
    assert "says the same of the group" in said
    Path("trust/keys/bad.cert.pem").write_text("no certificate", encoding="utf-8")
    said = desk.refused(*aggregate_words("ana", "cho", signers=signers, cert="bad"), code=4)
    assert "expected a PEM certificate" in said
    whole = x509.load_pem_x509_certificates(Path("trust/keys/board-1.cert.pem").read_bytes())[0]
    strange = whole.public_bytes(Encoding.DER).replace(b"\x06\x03+ep\x03!\0", b"\x06\x03+ey\x03!\0")
    text = b64encode(strange).decode()
    Path("trust/keys/bad.cert.pem").write_text(
        f"-----BEGIN CERTIFICATE-----\n{text}\n-----END CERTIFICATE-----\n"
    )
    said = desk.refused(*aggregate_words("ana", "cho", signers=signers, cert="bad"), code=4)
    assert "expected a key of a known algorithm" in said


def test_secrets_are_written_for_their_owner_alone_and_never_over_anything(desk: Desk) -> None:
    dealt(desk)
    for name in PEOPLE:
        assert stat.S_IMODE(Path(f"dealt/{name}.share.json").stat().st_mode) == 0o600
    group = ("--group", "board-1", "--threshold", "2", *members(), "--out", "dealt")
    assert "expected no file" in desk.refused("advanced", "frost", "deal", *group, code=5)
    said = desk.done("advanced", "frost", "show", "dealt/ana.share.json")
    secret = json.loads(Path("dealt/ana.share.json").read_bytes())["secret"]
    assert said["member"] == "ana"
    assert secret not in json.dumps(said)


def test_a_dealer_who_cheats_is_named_by_who_looks(desk: Desk) -> None:
    dealt(desk)
    path = Path("dealt/ben.share.json")
    share = read(path.read_bytes(), Share, where="")
    path.write_bytes(encode(spoiled(share, secret=one_more(share.secret))))
    said = desk.refused("advanced", "frost", "show", str(path), code=4)
    assert "the dealer gave `ben` a share that does not fit" in said
    words = (
        "advanced",
        "frost",
        "commit",
        "--share",
        str(path),
        "--nonces",
        "n",
        "--out",
        "c.json",
    )
    assert "the dealer gave `ben`" in desk.refused(*words, code=4)


def offers(desk: Desk) -> list[str]:
    group = ("--group", "board-1", "--threshold", "2", *members())
    desk.done("advanced", "frost", "dkg", "plan", *group, "--out", "dkg.json")
    for name in PEOPLE:
        own = ("--as", name, "--secret", f"{name}/secret.json", "--out", f"{name}.offer.json")
        desk.done("advanced", "frost", "dkg", "offer", "dkg.json", *own)
    return [word for name in PEOPLE for word in ("--offer", f"{name}.offer.json")]


def exchanged(desk: Desk, seen: list[str]) -> None:
    told = {
        desk.done(
            "advanced",
            "frost",
            "dkg",
            "exchange",
            "--secret",
            f"{n}/secret.json",
            *seen,
            "--out",
            "s",
        )["offers"]
        for n in PEOPLE
    }
    assert len(told) == 1


def finish_words(name: str, seen: list[str]) -> list[str]:
    given = [
        word
        for other in PEOPLE
        if other != name
        for word in ("--contribution", f"s/{other}-to-{name}.json")
    ]
    own = ["--secret", f"{name}/secret.json", *seen, *given, "--out", name]
    return ["advanced", "frost", "dkg", "finish", *own]


def test_a_key_without_a_dealer_and_no_secret_is_left(desk: Desk) -> None:
    seen = offers(desk)
    exchanged(desk, seen)
    digests = {desk.done(*finish_words(name, seen))["digest"] for name in PEOPLE}
    assert len(digests) == 1
    for name in PEOPLE:
        assert not Path(name, "secret.json").exists()
        assert desk.done("advanced", "frost", "show", f"{name}/{name}.share.json")["member"] == name
        assert Path(name, "group.json").read_bytes() == Path("ana/group.json").read_bytes()


def test_a_cheater_in_key_generation_is_named_by_the_command(desk: Desk) -> None:
    seen = offers(desk)
    exchanged(desk, seen)
    path = Path("s/ben-to-ana.json")
    honest = path.read_bytes()
    item = read(honest, Contribution, where="")
    path.write_bytes(encode(spoiled(item, sealed="A" * 96)))
    said = desk.refused(*finish_words("ana", seen), code=4)
    assert "the contribution of `ben` does not open" in said
    assert Path("ana/secret.json").exists()
    path.write_bytes(honest)
    offer = read(Path("cho.offer.json").read_bytes(), Offer, where="")
    wrong = spoiled(offer, proof_scalar=one_more(offer.proof_scalar))
    Path("cho.offer.json").write_bytes(encode(wrong))
    said = desk.refused(*finish_words("ana", seen), code=4)
    assert "the offer of `cho` does not prove" in said
    assert not Path("ana/group.json").exists()


def test_who_is_no_member_makes_no_offer(desk: Desk) -> None:
    offers(desk)
    own = ("--as", "eve", "--secret", "e.json", "--out", "e.offer.json")
    said = desk.refused("advanced", "frost", "dkg", "offer", "dkg.json", *own, code=4)
    assert "no member `eve`" in said


@pytest.mark.parametrize("words", [["deal"], ["dkg", "plan"]])
def test_a_group_that_cannot_be_is_refused(desk: Desk, words: list[str]) -> None:
    for group, threshold, names, said in (
        ("board-1", "4", PEOPLE, "as many members"),
        ("board-1", "2", ("ana", "ana"), "distinct members"),
        ("board-1", "2", ("Ana", "ben"), "an identifier, got `Ana`"),
        ("Board", "2", PEOPLE, "an identifier, got `Board`"),
    ):
        told = ("--group", group, "--threshold", threshold, *members(names), "--out", "x")
        assert said in desk.refused("advanced", "frost", *words, *told, code=4)
    assert not Path("x").exists()


def test_a_group_takes_no_name_and_no_key_that_somebody_has(desk: Desk) -> None:
    """Under two names one key would be two people; under one name two keys, nobody knows whose."""
    dealt(desk)
    desk.done("keys", "init", "auth", "--no-demo")
    every = ("--every-robot", "--every-region")
    member = ("--role", "operator", "--principal", "operator-1", *every, "--out", "op")
    desk.done("keys", "request", *member)
    desk.done("keys", "issue", "auth", "op/operator-1.request.json", "--yes")
    words = ("--role", "supervisor", *every, "--yes")
    group = json.loads(Path("dealt/group.json").read_bytes())
    Path("taken.json").write_bytes(encode({**group, "id": "operator-1"}))
    certify = ("advanced", "frost", "certify", "--trust", "auth", "--group")
    assert "here in another role" in desk.refused(*certify, "taken.json", *words, code=1)
    desk.done(*certify, "dealt/group.json", *words)
    Path("again.json").write_bytes(encode({**group, "id": "board-2"}))
    assert "the key is `board-1`'s" in desk.refused(*certify, "again.json", *words, code=1)
    desk.done("keys", "revoke", "auth", "board-1")
    assert "the key is `board-1`'s" in desk.refused(*certify, "again.json", *words, code=1)
    Path("auth/keys/board-1.cert.pem").rename("auth/issued/board-1.1.cert.pem")
    said = desk.refused(*certify, "dealt/group.json", *words, code=4)
    assert said.startswith("CERTIFICATE_REVOKED")
    assert not list(Path("auth/keys").glob("*.cert.pem"))


def test_a_group_is_certified_once_in_a_role_that_answers(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    dealt(desk)
    desk.done("keys", "init", "trust")
    group = (
        "advanced",
        "frost",
        "certify",
        "--trust",
        "trust",
        "--group",
        "dealt/group.json",
        "--yes",
    )
    every = ("--every-robot", "--every-region")
    assert "expected a role" in desk.refused(*group, "--role", "operator", *every, code=4)
    assert "USAGE" in desk.refused(*group, "--role", "supervisor", code=2)
    both = ("--every-robot", "--robot", "courier-1", "--every-region")
    assert "USAGE" in desk.refused(*group, "--role", "supervisor", *both, code=2)
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    assert call([*group[:-1], "--role", "supervisor", *every]) == 2  # nobody said yes
    assert not Path("trust/keys/board-1.cert.pem").exists()
    desk.done(*group, "--role", "safety_officer", "--robot", "courier-1", "--region", "dock")
    assert "expected no file" in desk.refused(*group, "--role", "supervisor", *every, code=5)
    shown = desk.done("keys", "show", "trust")
    (found,) = [p for p in shown["principals"] if p["principal"] == "board-1"]
    assert (found["role"], found["robot"]) == ("safety_officer", "courier-1")


def test_under_two_roots_no_group_is_certified(desk: Desk) -> None:
    dealt(desk)
    folder = Path("hybrid")
    both = (Algorithm.ED25519, Algorithm.ML_DSA_65)
    init_folder(folder, (), now=scenarios._BEGIN, algorithms=both)
    every = ("--role", "supervisor", "--every-robot", "--every-region")
    words = (
        "advanced",
        "frost",
        "certify",
        "--trust",
        "hybrid",
        "--group",
        "dealt/group.json",
        *every,
    )
    assert "Ed25519 alone" in desk.refused(*words, code=5)


def test_a_sealed_share_signs_with_its_passphrase_alone(desk: Desk) -> None:
    _, signers = ready(desk)
    Path("words").write_text("correct horse battery staple\n", encoding="utf-8")
    Path("words").chmod(0o600)
    path = "dealt/ana.share.json"
    secret = json.loads(Path(path).read_bytes())["secret"]
    desk.done("advanced", "frost", "protect", path, "--passphrase-file", "words")
    assert secret.encode() not in Path(path).read_bytes()
    assert stat.S_IMODE(Path(path).stat().st_mode) == 0o600
    assert "sealed already" in desk.refused(
        "advanced", "frost", "protect", path, "--passphrase-file", "words", code=1
    )
    assert "the share is encrypted" in desk.refused(*share_words("ana", signers), "--yes", code=5)
    desk.done(*share_words("ana", signers), "--yes", "--passphrase-file", "words")


def test_every_file_can_be_looked_at_and_no_secret_is_shown(desk: Desk) -> None:
    _, signers = ready(desk)
    desk.done(*share_words("ana", signers), "--yes")
    offers(desk)
    nonces = next(Path("cho.nonces").iterdir())
    for path in (nonces, Path("ben/secret.json")):
        said = desk.done("advanced", "frost", "show", str(path))
        assert set(said) == {"kind"}
    public = ["dealt/group.json", "ballot.json", "ana.part.json", "ana.commitment.json"]
    for name in (*public, "dkg.json", "ana.offer.json"):
        said = desk.done("advanced", "frost", "show", name)
        assert said["digest"]
        assert said["kind"].startswith("frost/")
    Path("noise").write_bytes(b"{}")
    assert "MALFORMED" in desk.refused("advanced", "frost", "show", "noise", code=4)


@pytest.mark.parametrize(
    ("missing", "words", "extra"),
    [
        ("nacl", "advanced frost show x", "frost"),
        ("starlette", "serve --openapi", "http"),
        ("mcp", "mcp --robot courier-1 --gate g --trust t --site s --binding b cat", "mcp"),
    ],
)
def test_without_the_extra_a_command_says_what_to_install(
    missing: str, words: str, extra: str
) -> None:
    program = (
        "import sys; from authguard_r.cli import call; "
        f"sys.modules[{missing!r}] = None; sys.exit(call({words.split()!r}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    said = f"SETUP_INVALID: this command needs `{missing}`: pip install 'authguard-r[{extra}]'"
    assert (done.returncode, done.stderr.startswith(said)) == (5, True), done.stderr


def test_a_store_needs_trust_and_site(desk: Desk) -> None:
    said = desk.refused(
        "advanced", "frost", "ballot", "1", "--store", "robot.db", "--out", "b.json", code=2
    )
    assert "a store needs --trust and --site" in said


def test_a_sealed_share_is_looked_at_with_its_passphrase(desk: Desk) -> None:
    dealt(desk)
    Path("said").write_text("words that nobody else knows\n")
    Path("said").chmod(0o600)
    share, words = "dealt/ana.share.json", ("--passphrase-file", "said")
    desk.done("advanced", "frost", "protect", share, *words)
    said = desk.refused("advanced", "frost", "show", share, code=5)
    assert ("encrypted" in said, "--passphrase-file" in said) == (True, True)
    assert desk.done("advanced", "frost", "show", share, *words)["member"] == "ana"
    Path("said").write_text("others than these\n")
    assert "KEY_INVALID" in desk.refused("advanced", "frost", "show", share, *words, code=4)


def test_a_store_that_is_not_there_is_said_and_not_made(desk: Desk) -> None:
    desk.done("keys", "init", "trust")
    Path("approval.token").write_bytes(b"{}")
    where = ("--store", "mistyped.db", "--trust", "trust", *SITE)
    for words in (("ballot", "1", "--out", "b.json"), ("submit", "approval.token")):
        assert "STORE_UNAVAILABLE: no gate answers and no store is there" in desk.refused(
            "advanced", "frost", *words, *where, code=5
        )
        assert not Path("mistyped.db").exists()
