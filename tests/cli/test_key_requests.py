# SPDX-License-Identifier: Apache-2.0
"""Over several machines: keys stay, requests and answers travel, lists end what was given."""

from __future__ import annotations

import io
import json
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import call
from authguard_r.cli.inputs import wall_now
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.principals import Scope
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import read_signer
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import profile_digest
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD

EVERYWHERE = ("--every-robot", "--every-region")
OPERATOR = ("--role", "operator", "--principal", "operator-1", *EVERYWHERE)


class Machines:
    """An authority's folder and members' folders, and what the last command printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: object, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: object, stdin: bytes = b"") -> tuple[int, Any]:
        code, out = self(*arguments, "--json", stdin=stdin)
        return code, json.loads(out[out.index("{") :])

    def refused(self, code: int, *arguments: object) -> str:
        """Return the reason's code."""
        got, told = self.json(*arguments)
        assert got == code, told
        return str(told["error"]["code"])

    def member(self, name: str, *words: object, days: int = 365) -> Path:
        """Return the stem of a member's key and certificate, after all four steps."""
        assert self("keys", "request", *words, "--out", name)[0] == 0
        (request,) = Path(name).glob("*.request.json")
        assert self("keys", "issue", "auth", request, "--days", days, "--yes")[0] == 0
        (key,) = Path(name).glob("*.key.pem")
        answer = str(request).replace(".request.", ".answer.")
        where = ("--key", key, "--trust", f"{name}/trust", "--root", self.root)
        assert self("keys", "install", answer, *where)[0] == 0
        return key.with_name(key.name.removesuffix(".key.pem"))

    @property
    def root(self) -> str:
        from authguard_r.authoring.keys.request import fingerprint

        return fingerprint(read_trust(Path("auth")).roots)


@pytest.fixture
def machines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Machines:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    made = Machines(capsys, monkeypatch)
    assert made("keys", "init", "auth", "--no-demo", "--site", "h/site.yaml")[0] == 0
    return made


def holds(stem: Path, trust: Path | str) -> Any:
    """Return what the certificate says, under that folder's root."""
    signer = read_signer(Path(f"{stem}.key.pem"), Path(f"{stem}.cert.pem"))
    leaves = [read_trust(Path(trust)).identify(c, wall_now(None)) for c, _ in signer.endorse(b"")]
    return leaves[0]


def test_private_keys_stay_where_they_were_made(machines: Machines) -> None:
    stem = machines.member("op", *OPERATOR)
    assert holds(stem, "op/trust").principal == "operator-1"
    assert not read_trust(Path("op/trust")).demo
    assert stat.S_IMODE(Path("op/operator-1.key.pem").stat().st_mode) == 0o600
    lying = {str(path) for path in Path().rglob("*") if path.is_file()}
    private = {name for name in lying if b"PRIVATE KEY" in Path(name).read_bytes()}
    people = {f"auth/keys/{name}.key.pem" for name in ("root", "people", "site", "machines")}
    assert private == people | {"op/operator-1.key.pem"}


def test_an_authority_may_be_certified_alone(machines: Machines) -> None:
    code, told = machines.json("keys", "init", "one", "--no-demo", "--authorities", "people")
    assert (code, told["authorities"], told["demo"]) == (0, ["people"], False)
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    assert machines("keys", "issue", "one", "op/operator-1.request.json", "--yes")[0] == 0
    machine = ("--role", "witness", "--principal", "witness-1")
    assert machines("keys", "request", *machine, "--out", "w")[0] == 0
    request = "w/witness-1.request.json"
    assert machines.refused(5, "keys", "issue", "one", request, "--yes") == "FILE_UNAVAILABLE"
    assert machines("keys", "init", "two", "--no-demo", "--authorities", "everybody")[0] == 2


def test_a_gate_gets_the_profile_of_its_robot(machines: Machines) -> None:
    words = ("--role", "gate", "--principal", "gate-courier-1", "--robot", "courier-1")
    assert machines("keys", "request", *words, "--out", "gate")[0] == 2  # without its site
    stem = machines.member("gate", *words, "--site", "h/site.yaml")
    leaf = holds(stem, "gate/trust")
    assert leaf.profile == profile_digest(scenarios.site().robots[scenarios.RID].profile)
    assert (leaf.robot, leaf.role) == (scenarios.RID, Role.GATE)
    stranger = ("--role", "gate", "--principal", "g", "--robot", "nobody", "--site", "h/site.yaml")
    assert machines("keys", "request", *stranger, "--out", "x")[0] == 2


@pytest.mark.parametrize("algorithm", ["ml-dsa-65", "hybrid"])
def test_every_algorithm_goes_the_same_way(machines: Machines, algorithm: str) -> None:
    shutil.rmtree("auth")
    assert machines("keys", "init", "auth", "--no-demo", "--algorithm", algorithm)[0] == 0
    assert machines("keys", "request", *OPERATOR, "--out", "plain")[0] == 0
    plain = "plain/operator-1.request.json"
    assert machines.refused(4, "keys", "issue", "auth", plain, "--yes") == "KEY_INVALID"
    stem = machines.member("op", *OPERATOR, "--algorithm", algorithm)
    assert holds(stem, "op/trust").principal == "operator-1"
    code, told = machines.json("keys", "revoke", "auth", "operator-1")
    names = [item["authority"] for item in told["lists"]]
    assert (code, names) == (0, ["people", "people-2"] if algorithm == "hybrid" else ["people"])


def test_the_scope_that_was_asked_for_is_shown_and_given(machines: Machines) -> None:
    words = ("--role", "supervisor", "--principal", "s-1", "--robot", "b", "--robot", "a")
    where = ("--region", "ward-b", "--region", "corridor-a")
    assert machines("keys", "request", *words, *where, "--out", "s")[0] == 0
    code, told = machines("keys", "issue", "auth", "s/s-1.request.json", stdin=b"y\n")
    assert code == 0
    for line in ("name     s-1", "role     supervisor", "robots   a, b", "ward-b", "days     365"):
        assert line in told
    found = {
        item["principal"]: item for item in machines.json("keys", "show", "auth")[1]["principals"]
    }
    assert found["s-1"]["scope"] == {"robots": ["a", "b"], "regions": ["corridor-a", "ward-b"]}


def test_who_says_no_gives_nothing(machines: Machines) -> None:
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    for said in (b"n\n", b""):
        assert machines("keys", "issue", "auth", "op/operator-1.request.json", stdin=said)[0] != 0
    assert not Path("auth/issued").exists()
    assert not Path("op/operator-1.answer.json").exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"role":"operator"', b'"role":"safety_officer"'),
        (b'"principal":"operator-1"', b'"principal":"operator-2"'),
        (b'"every_region":true,', b""),
    ],
)
def test_what_a_key_was_proven_for_cannot_be_changed_on_the_way(
    machines: Machines, old: bytes, new: bytes
) -> None:
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    path = Path("op/operator-1.request.json")
    data = path.read_bytes()
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    assert machines.refused(4, "keys", "issue", "auth", path, "--yes") == "SIGNATURE_INVALID"


def test_a_name_has_one_key_until_that_is_revoked(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    assert machines("keys", "request", *OPERATOR, "--out", "thief")[0] == 0
    request = "thief/operator-1.request.json"
    assert machines.refused(1, "keys", "issue", "auth", request, "--yes") == "ISSUER_MISMATCH"
    other = ("--role", "safety_officer", "--principal", "operator-1", *EVERYWHERE)
    assert machines("keys", "request", *other, "--out", "other")[0] == 0
    second = "other/operator-1.request.json"
    assert machines.refused(1, "keys", "issue", "auth", second, "--yes") == "ISSUER_MISMATCH"
    # the same key may be certified again, and a lost one is revoked first
    first = "op/operator-1.request.json"
    assert machines("keys", "issue", "auth", first, "--yes")[0] == 0
    assert machines("keys", "revoke", "auth", "operator-1")[0] == 0
    assert machines("keys", "issue", "auth", request, "--yes")[0] == 0


@pytest.mark.parametrize("name", ["root", "people", "machines-2"])
def test_nobody_has_an_authoritys_name(machines: Machines, name: str) -> None:
    words = ("--role", "operator", "--principal", name, *EVERYWHERE)
    assert machines("keys", "request", *words, "--out", "x")[0] == 0
    request = f"x/{name}.request.json"
    assert machines.refused(1, "keys", "issue", "auth", request, "--yes") == "ISSUER_MISMATCH"


def test_an_answer_fits_its_key_its_request_and_the_root(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    other = ("--role", "operator", "--principal", "operator-2", *EVERYWHERE)
    machines.member("two", *other)
    Path("op/operator-1.cert.pem").unlink()
    root = ("--root", machines.root)
    wrong = ("keys", "install", "two/operator-2.answer.json", "--key", "op/operator-1.key.pem")
    there = ("--trust", "op/fresh", *root)
    assert machines.refused(4, *wrong, *there) == "CERTIFICATE_INVALID"
    Path("op/operator-1.request.json").unlink()  # then the key alone says it
    assert machines.refused(4, *wrong, *there) == "KEY_INVALID"
    right = ("keys", "install", "op/operator-1.answer.json", "--key", "op/operator-1.key.pem")
    foreign = ("--trust", "op/fresh", "--root", "0" * 64)
    assert machines.refused(4, *right, *foreign) == "CERTIFICATE_INVALID"
    assert machines(*right, "--trust", "op/fresh", stdin=b"n\n")[0] != 0
    assert sorted(path.name for path in Path("op").iterdir()) == [
        "operator-1.answer.json",
        "operator-1.key.pem",
        "trust",
    ]
    code, told = machines(*right, "--trust", "op/fresh", stdin=b"y\n")
    assert (code, machines.root in told) == (0, True)


def test_a_trust_folder_keeps_its_root(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    before = Path("op/trust/root.pem").read_bytes()
    shutil.rmtree("auth")
    assert machines("keys", "init", "auth", "--no-demo")[0] == 0
    assert machines("keys", "issue", "auth", "op/operator-1.request.json", "--yes")[0] == 0
    words = ("keys", "install", "op/operator-1.answer.json", "--key", "op/operator-1.key.pem")
    assert machines.refused(4, *words, "--trust", "op/trust") == "CERTIFICATE_INVALID"
    named = ("--trust", "op/trust", "--root", machines.root)
    assert machines.refused(4, *words, *named) == "CERTIFICATE_INVALID"
    assert Path("op/trust/root.pem").read_bytes() == before


def test_a_key_is_never_written_over(machines: Machines) -> None:
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    before = Path("op/operator-1.key.pem").read_bytes()
    words = ("keys", "request", *OPERATOR, "--out", "op")
    assert machines.refused(5, *words) == "FILE_UNAVAILABLE"
    assert Path("op/operator-1.key.pem").read_bytes() == before


@pytest.mark.parametrize("role", ["operator", "supervisor", "safety_officer", "scheduler"])
def test_who_signs_for_what_is_named_is_not_certified_for_nothing(
    machines: Machines, role: str
) -> None:
    words = ("keys", "request", "--role", role, "--principal", "p-1", "--out", "x")
    robots = "--robot ID (may be repeated) or --every-robot"
    regions = "--region ID (may be repeated) or --every-region"
    for scope, lacks in (
        ((), (robots, regions)),
        (("--robot", "courier-1"), (regions,)),
        (("--every-robot",), (regions,)),
        (("--region", "dock"), (robots,)),
        (("--every-region",), (robots,)),
    ):
        code, told = machines.json(*words, *scope)
        assert (code, told["error"]["code"]) == (2, "USAGE")
        for options in (robots, regions):
            assert (options in told["error"]["message"]) == (options in lacks)
    assert not Path("x").exists()
    if role != "scheduler":
        narrow = ("--robot", "courier-1", "--region", "dock")
        assert machines(*words, *narrow)[0] == 0


@pytest.mark.parametrize("role", ["gate", "estimator"])
@pytest.mark.parametrize(
    "robots",
    [
        (),
        ("--every-robot",),
        ("--robot", "courier-1", "--robot", "lifter-1"),
        ("--robot", "courier-1", "--every-robot"),
    ],
)
def test_a_machine_is_of_one_robot(machines: Machines, role: str, robots: tuple[str, ...]) -> None:
    words = ("--role", role, "--principal", "m-1", "--site", "h/site.yaml", "--out", "x")
    code, told = machines.json("keys", "request", *words, *robots)
    assert (code, told["error"]["code"]) == (2, "USAGE")
    assert "--robot" in told["error"]["message"]
    assert not Path("x").exists()


@pytest.mark.parametrize("role", ["site_authority", "witness"])
def test_whose_signatures_are_not_confined_names_no_robot(machines: Machines, role: str) -> None:
    stem = machines.member("m", "--role", role, "--principal", "m-1")
    assert holds(stem, "m/trust").scope == Scope(robots=frozenset(), regions=frozenset())


def test_what_nobody_could_grant_makes_no_key(machines: Machines) -> None:
    for words in (
        ("--role", "scheduler", "--principal", "s", *EVERYWHERE),
        ("--role", "operator", "--principal", "o", *EVERYWHERE, "--robot", "a"),
    ):
        assert machines.refused(4, "keys", "request", *words, "--out", "x") == "MALFORMED"
    words = ("--role", "operator", "--principal", "No", *EVERYWHERE)
    assert machines("keys", "request", *words, "--out", "x")[0] == 2
    assert not Path("x").exists()


def test_a_rotated_key_counts_beside_the_old_until_that_is_revoked(machines: Machines) -> None:
    old = machines.member("op", *OPERATOR)
    where = ("--key", f"{old}.key.pem", "--cert", f"{old}.cert.pem", "--trust", "op/trust")
    code, made = machines.json("keys", "rotate", *where, "--out", "op")
    assert (code, made["rotates"], made["key"]) == (0, True, "op/operator-1.2.key.pem")
    request = made["request"]
    code, told = machines.json("keys", "issue", "auth", request, "--yes")
    assert (code, told["rotates"]) == (0, True)
    words = ("--key", made["key"], "--trust", "op/trust")
    assert machines("keys", "install", told["answer"], *words)[0] == 0
    new = Path("op/operator-1.2")
    first, second = holds(old, "op/trust"), holds(new, "op/trust")
    assert (first.principal, first.scope) == (second.principal, second.scope)
    assert first.key != second.key
    assert machines.json("keys", "rotate", *where, "--out", "op")[1]["key"].endswith("-1.3.key.pem")
    code, told = machines.json("keys", "revoke", "auth", "--serial", first.serial)
    assert (code, told["lists"][0]["serials"]) == (0, [str(first.serial)])
    taken = machines(
        "advanced", "revocations", "install", "auth/revocations/people.json", "--trust", "op/trust"
    )
    assert taken[0] == 0
    assert holds(new, "op/trust").principal == "operator-1"
    with pytest.raises(AuthenticityError, match="revoked"):
        holds(old, "op/trust")


def test_a_name_is_handed_on_by_nobody_but_its_holder(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    stem = machines.member("two", "--role", "operator", "--principal", "operator-2", *EVERYWHERE)
    where = ("--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem", "--trust", "two/trust")
    made = machines.json("keys", "rotate", *where, "--out", "two")[1]
    theirs = json.loads(Path(made["request"]).read_bytes())
    assert machines("keys", "request", *OPERATOR, "--out", "thief")[0] == 0
    path = Path("thief/operator-1.request.json")
    mine = json.loads(path.read_bytes())
    mixed = {**mine, "renews": theirs["renews"]}
    path.write_bytes(json.dumps(mixed, sort_keys=True, separators=(",", ":")).encode() + b"\n")
    assert machines.refused(4, "keys", "issue", "auth", path, "--yes") == "SIGNATURE_INVALID"


def test_a_list_is_signed_anew_before_it_is_stale(machines: Machines) -> None:
    before = {i["authority"]: i for i in machines.json("keys", "show", "auth")[1]["lists"]}
    code, told = machines.json("keys", "lists", "auth", "--days", "7")
    assert code == 0
    after = {item["authority"]: item for item in told["lists"]}
    assert set(after) == set(before) == {"root", "people", "site", "machines"}
    assert {item["number"] for item in after.values()} == {2}
    shown = {i["authority"]: i for i in machines.json("keys", "show", "auth")[1]["lists"]}
    assert shown["people"]["left_days"] in {6, 7}
    text = machines("keys", "show", "auth")[1]
    assert "list of people" in text


def test_an_authority_is_revoked_by_its_root(machines: Machines) -> None:
    stem = machines.member("op", *OPERATOR)
    code, told = machines.json("keys", "revoke", "auth", "people")
    assert (code, [item["authority"] for item in told["lists"]]) == (0, ["root"])
    words = (
        "advanced",
        "revocations",
        "install",
        "auth/revocations/root.json",
        "--trust",
        "op/trust",
    )
    assert machines(*words)[0] == 0
    with pytest.raises(AuthenticityError, match="revoked"):
        holds(stem, "op/trust")


def test_what_was_never_given_cannot_be_revoked(machines: Machines) -> None:
    for words in (("nobody",), ("--serial", "7")):
        assert machines.refused(1, "keys", "revoke", "auth", *words) == "CERTIFICATE_INVALID"
    for words in ((), ("operator-1", "--serial", "7")):
        assert machines("keys", "revoke", "auth", *words)[0] == 2
    lists = machines.json("keys", "show", "auth")[1]["lists"]
    assert {item["number"] for item in lists} == {1}


def test_a_folder_takes_no_older_list_and_no_strangers(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    shutil.copytree("auth/revocations", "older")
    assert machines("keys", "revoke", "auth", "operator-1")[0] == 0
    install = ("advanced", "revocations", "install")
    assert machines(*install, "auth/revocations/people.json", "--trust", "op/trust")[0] == 0
    older = "older/people.json"
    assert machines.refused(4, *install, older, "--trust", "op/trust") == "REVOCATION_STALE"
    assert machines("keys", "init", "foreign", "--no-demo")[0] == 0
    assert machines("keys", "lists", "foreign")[0] == 0
    assert machines("keys", "lists", "foreign")[0] == 0
    stranger = "foreign/revocations/people.json"
    assert machines.refused(4, *install, stranger, "--trust", "op/trust") == "SIGNATURE_INVALID"


def test_revoked_is_shown(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    assert machines("keys", "revoke", "auth", "operator-1")[0] == 0
    code, shown = machines.json("keys", "show", "auth")
    (item,) = shown["principals"]
    assert (code, item["holds"], item["why"]) == (0, False, "CERTIFICATE_REVOKED")
    assert "CERTIFICATE_REVOKED" in machines("keys", "show", "auth")[1]
    assert "CERTIFICATE_REVOKED" not in machines("keys", "show", "op/trust")[1]


@pytest.mark.parametrize("command", ["issue", "install"])
@pytest.mark.parametrize("data", [b"", b"{}", b"\xff", b'{"format":"authguard-r/key-request/2"}'])
def test_what_is_no_such_file_is_refused(machines: Machines, command: str, data: bytes) -> None:
    machines.member("op", *OPERATOR)
    Path("junk.json").write_bytes(data)
    words: tuple[object, ...] = ("auth", "junk.json", "--yes")
    if command == "install":
        words = ("junk.json", "--key", "op/operator-1.key.pem", "--trust", "op/trust")
    code, told = machines.json("keys", command, *words)
    assert (code, "error" in told) == (4, True)


# the authority's machine


def test_four_who_revoke_at_once_all_revoke(machines: Machines) -> None:
    names = [f"operator-{number}" for number in range(1, 5)]
    for name in names:
        words = ("--role", "operator", "--principal", name, *EVERYWHERE, "--out", name)
        assert machines("keys", "request", *words)[0] == 0
        assert machines("keys", "issue", "auth", f"{name}/{name}.request.json", "--yes")[0] == 0
    running = [
        subprocess.Popen([AUTHGUARD, "keys", "revoke", "auth", name], stdout=subprocess.DEVNULL)
        for name in names
    ]
    assert [process.wait() for process in running] == [0, 0, 0, 0]
    shown = machines.json("keys", "show", "auth")[1]
    assert {item["why"] for item in shown["principals"]} == {"CERTIFICATE_REVOKED"}
    assert {i["authority"]: i["number"] for i in shown["lists"]}["people"] == 5


def test_the_issuers_key_gets_no_second_name(machines: Machines) -> None:
    """With one it was two of two people at a gate."""
    stem = machines.member("op", *OPERATOR)
    words = ("--role", "supervisor", "--principal", "shadow", *EVERYWHERE)
    assert machines("keys", "request", *words, "--key", f"{stem}.key.pem", "--out", "s")[0] == 0
    request = "s/shadow.request.json"
    assert machines.refused(1, "keys", "issue", "auth", request, "--yes") == "ISSUER_MISMATCH"
    machines("keys", "revoke", "auth", "operator-1")
    assert machines.refused(1, "keys", "issue", "auth", request, "--yes") == "ISSUER_MISMATCH"


def test_a_request_is_no_way_back_after_a_revocation(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    assert machines("keys", "revoke", "auth", "operator-1")[0] == 0
    again = ("keys", "issue", "auth", "op/operator-1.request.json", "--yes")
    assert machines.refused(4, *again) == "CERTIFICATE_REVOKED"


def test_a_set_up_lasts_as_long_as_was_said_and_nothing_in_it_longer(machines: Machines) -> None:
    code, told = machines.json("keys", "init", "short", "--no-demo", "--days", "30")
    assert code == 0
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    request = ("short", "op/operator-1.request.json", "--yes", "--days", "3650")
    assert machines("keys", "issue", *request)[0] == 0
    (shown,) = machines.json("keys", "show", "short")[1]["principals"]
    assert shown["until"] == told["until"]
    for folder, days in (("auth", 3650), ("demo", 365)):
        if folder == "demo":
            assert machines("keys", "init", "demo")[0] == 0
        root = read_trust(Path(folder)).root
        assert (root.not_valid_after_utc - root.not_valid_before_utc).days == days
    assert machines("keys", "init", "x", "--days", "1")[0] == 2


def test_who_asks_for_more_than_he_has_is_seen(machines: Machines) -> None:
    narrow = ("--role", "operator", "--principal", "operator-1", "--robot", "a", "--region", "dock")
    stem = machines.member("op", *narrow)
    wide = ("--key", f"{stem}.key.pem", "--out", "more")
    assert machines("keys", "request", *OPERATOR, *wide)[0] == 0
    words = ("keys", "issue", "auth", "more/operator-1.request.json")
    assert machines.refused(1, *words, "--yes") == "SIGNER_OUT_OF_SCOPE"
    code, told = machines(*words, stdin=b"n\n")
    assert code != 0
    assert "WIDER    robots: EVERY ONE (has a)" in told
    assert len(list(Path("auth/issued").iterdir())) == 1
    code, said = machines.json(*words, "--yes", "--wider")
    assert (code, len(said["wider"])) == (0, 2)


def test_a_sealed_authority_works_with_its_passphrase(machines: Machines) -> None:
    Path("said").write_text("three words and a number 4\n", encoding="utf-8")
    Path("said").chmod(0o600)
    said = ("--passphrase-file", "said")
    for name in ("people", "root", "site", "machines"):
        assert machines("keys", "protect", f"auth/keys/{name}.key.pem", *said)[0] == 0
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    for words in (
        ("keys", "issue", "auth", "op/operator-1.request.json", "--yes"),
        ("keys", "revoke", "auth", "operator-1"),
        ("keys", "lists", "auth"),
    ):
        code, told = machines.json(*words)
        assert (code, "--passphrase-file" in told["error"]["message"]) == (4, True)
        assert machines(*words, *said)[0] == 0


def test_a_bad_file_among_the_given_is_named_and_stops_nothing(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    Path("auth/issued/noise.cert.pem").write_bytes(b"noise")
    code, told = machines.json("keys", "revoke", "auth", "operator-1")
    assert (code, told["unread"]) == (1, ["auth/issued/noise.cert.pem"])
    assert len(told["lists"][0]["serials"]) == 1
    assert "CANNOT READ auth/issued/noise.cert.pem" in machines("keys", "show", "auth")[1]
    words = ("keys", "revoke", "auth", "--serial", "77")
    assert machines.refused(1, *words) == "CERTIFICATE_INVALID"
    code, told = machines.json(*words, "--authority", "people")
    assert (code, "77" in told["lists"][0]["serials"]) == (0, True)
    assert machines("keys", "revoke", "auth", "operator-1", "--authority", "people")[0] == 2


def test_a_machine_that_holds_no_authority_signs_no_list(machines: Machines) -> None:
    machines.member("op", *OPERATOR)
    assert machines.refused(5, "keys", "lists", "op/trust") == "FILE_UNAVAILABLE"


def test_an_answer_that_cannot_be_written_was_not_given(machines: Machines) -> None:
    assert machines("keys", "request", *OPERATOR, "--out", "op")[0] == 0
    words = ("keys", "issue", "auth", "op/operator-1.request.json", "--yes", "--out")
    assert machines.refused(5, *words, "nodir/x.json") == "FILE_UNAVAILABLE"
    assert list(Path("auth/issued").iterdir()) == []
