# SPDX-License-Identifier: Apache-2.0
"""`keys protect`, `unprotect`, `public`, and a `--key` that is sealed or in hardware."""

from __future__ import annotations

import io
import json
import os
import pty
import select
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    load_pem_public_key,
)

from authguard_r.authoring.keys.request import fingerprint, open_request
from authguard_r.authoring.keys.setup import read_authority
from authguard_r.cli import call
from authguard_r.cli.app import program
from authguard_r.cli.inputs import wall_now
from authguard_r.core.encoding import encode
from authguard_r.keys.certificate import Role, build_leaf
from authguard_r.keys.envelope import is_sealed, unseal
from authguard_r.keys.pkcs11 import open_key
from authguard_r.keys.signer import FileSigner, certified
from authguard_r.keys.trust import read_trust
from authguard_r.operations.defaults import NAMES
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, RunningGate
from fixtures.hardware_token import Token, needs_token

SAID = "correct horse battery staple"
KEY, CERT = "trust/keys/operator-1.key.pem", "trust/keys/operator-1.cert.pem"
SITE = ["--site", "h/site.yaml"]
PASS = ["--passphrase-file", "said"]
COLLECT = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
#: These hold a robot's own key, which is a plain file or nothing, or only look at one.
SERVICES = {"gate", "advanced stop-process", "doctor"}


class Shell:
    """One working folder with the hospital and its keys, and nobody at the terminal."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: object) -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"")))
        self._capsys.readouterr()
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        assert SAID not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: object) -> tuple[int, Any]:
        code, out = self(*arguments, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Shell]:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    say(SAID)
    yield Shell(capsys, monkeypatch)
    left = [path for path in tmp_path.rglob("*") if path.name.startswith(".")]
    assert left == []  # nothing half written is left


def say(text: str, path: str = "said") -> None:
    Path(path).write_bytes(text.encode() + b"\n")
    Path(path).chmod(0o600)


def mode(path: str) -> int:
    return stat.S_IMODE(Path(path).stat().st_mode)


# -- protect and unprotect -------------------------------------------------------------------------


def test_a_key_is_sealed_in_its_place_and_opened_again(shell: Shell) -> None:
    plain = Path(KEY).read_bytes()
    code, said = shell.json("keys", "protect", KEY, *PASS)
    assert (code, said) == (0, {"file": KEY, "form": "sealed"})
    assert is_sealed(Path(KEY).read_bytes())
    assert mode(KEY) == 0o600
    code, said = shell.json("keys", "unprotect", KEY, *PASS)
    assert (code, said) == (0, {"file": KEY, "form": "plain"})
    assert Path(KEY).read_bytes() == plain
    assert mode(KEY) == 0o600


def test_with_out_the_file_stays_as_it_is_and_that_is_said(shell: Shell) -> None:
    plain = Path(KEY).read_bytes()
    code, out = shell("keys", "protect", KEY, *PASS, "--out", "mine.pem")
    assert (code, f"{KEY}: left as it is" in out) == (0, True)
    assert Path(KEY).read_bytes() == plain
    assert unseal(Path("mine.pem").read_bytes(), SAID, where="f") == plain
    assert mode("mine.pem") == 0o600


def test_behind_a_link_the_file_is_replaced(shell: Shell) -> None:
    Path("link.pem").symlink_to(KEY)
    assert shell("keys", "protect", "link.pem", *PASS)[0] == 0
    assert Path("link.pem").is_symlink()
    assert is_sealed(Path(KEY).read_bytes())


def test_twice_is_refused_and_changes_nothing(shell: Shell) -> None:
    assert shell("keys", "unprotect", KEY, *PASS)[0] == 1
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    sealed = Path(KEY).read_bytes()
    assert shell("keys", "protect", KEY, *PASS)[0] == 1
    assert Path(KEY).read_bytes() == sealed


def test_what_is_no_plain_key_is_not_sealed(shell: Shell) -> None:
    foreign = Ed25519PrivateKey.generate().private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")
    )
    Path("foreign.pem").write_bytes(foreign)
    Path("list").write_text("milk")
    assert [shell("keys", "protect", name, *PASS)[0] for name in ("list", CERT, "none")] == [
        4,
        4,
        5,
    ]
    code, out = shell("keys", "protect", "foreign.pem", *PASS)
    assert (code, "decrypt it there" in out) == (4, True)
    assert Path("foreign.pem").read_bytes() == foreign


def test_a_wrong_passphrase_opens_nothing(shell: Shell) -> None:
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    sealed = Path(KEY).read_bytes()
    say("incorrect horse battery", "other")
    code, error = shell.json("keys", "unprotect", KEY, "--passphrase-file", "other")
    assert (code, error["error"]["code"], error["error"]["where"]) == (4, "KEY_INVALID", KEY)
    assert Path(KEY).read_bytes() == sealed


def test_where_it_cannot_be_written_nothing_is_lost(shell: Shell) -> None:
    assert shell("keys", "protect", KEY, *PASS, "--out", "none/k.pem")[0] == 5
    Path("folder").mkdir()
    assert shell("keys", "protect", KEY, *PASS, "--out", "folder")[0] == 5
    assert not is_sealed(Path(KEY).read_bytes())


@pytest.mark.parametrize("bits", [0o640, 0o604, 0o660])
def test_a_passphrase_that_others_can_read_is_refused(shell: Shell, bits: int) -> None:
    Path("said").chmod(bits)
    code, out = shell("keys", "protect", KEY, *PASS)
    assert (code, "chmod 600" in out) == (5, True)
    assert not is_sealed(Path(KEY).read_bytes())


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"two\nlines of text\n", b"\xff" * 20, b"x" * 9_000, b"a\tb" * 9]
)
def test_a_passphrase_file_is_one_line_of_text(shell: Shell, data: bytes) -> None:
    Path("said").write_bytes(data)
    assert shell("keys", "protect", KEY, *PASS)[0] == 4
    assert not is_sealed(Path(KEY).read_bytes())


def test_a_short_passphrase_seals_nothing(shell: Shell) -> None:
    say("hunter2")
    assert shell("keys", "protect", KEY, *PASS)[0] == 4
    assert not is_sealed(Path(KEY).read_bytes())


def test_nobody_is_asked_where_nobody_is(shell: Shell) -> None:
    assert shell("keys", "protect", KEY)[0] == 2
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    assert shell("keys", "unprotect", KEY)[0] == 2


# -- a person at a terminal ------------------------------------------------------------------------


def typed(*words: str, answers: list[str]) -> tuple[int, str]:
    """Run a command on a terminal of its own; return its exit code and what the screen showed."""
    person, machine = pty.openpty()
    process = subprocess.Popen(
        [str(AUTHGUARD), *words],
        stdin=machine,
        stdout=machine,
        stderr=machine,
        start_new_session=True,
        env={k: v for k, v in os.environ.items() if not k.startswith("COV")},
    )
    os.close(machine)
    screen, asked, end = b"", 0, time.monotonic() + 60
    try:
        while time.monotonic() < end:
            if not select.select([person], [], [], 1)[0]:
                continue
            try:
                screen += os.read(person, 4_096)
            except OSError:  # the last one closed it
                break
            if screen.endswith(b": ") and screen.count(b": ") > asked and answers:
                asked = screen.count(b": ")
                os.write(person, answers.pop(0).encode() + b"\n")
        return process.wait(60), screen.decode()
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        process.wait(60)
        os.close(person)


def test_a_passphrase_is_typed_twice_and_never_shown(shell: Shell) -> None:
    code, screen = typed("keys", "protect", KEY, answers=[SAID, "something else entirely"])
    assert (code, is_sealed(Path(KEY).read_bytes())) == (4, False), screen
    code, screen = typed("keys", "protect", KEY, answers=[SAID, SAID])
    assert (code, is_sealed(Path(KEY).read_bytes())) == (0, True), screen
    assert SAID not in screen
    code, screen = typed("keys", "unprotect", KEY, answers=[SAID])
    assert (code, is_sealed(Path(KEY).read_bytes())) == (0, False), screen
    assert SAID not in screen


# -- a sealed key signs ----------------------------------------------------------------------------


def compiled(shell: Shell) -> str:
    assert shell("mission", "compile", "h/mission.yaml", *SITE, "--out", "m.json")[0] == 0
    return "m.json"


def test_a_mission_is_signed_and_ordered_about_with_a_sealed_key(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = compiled(shell)
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    sign = ["mission", "sign", mission, "--key", KEY, "--cert", CERT, *SITE, "--yes"]
    monkeypatch.setenv("AUTHGUARD_PASSPHRASE", SAID)  # what others can read is not asked
    code, out = shell(*sign)
    assert (code, "--passphrase-file" in out) == (4, True)
    assert not Path("m.token").exists()
    assert shell(*sign, *PASS)[0] == 0
    on = ["--trust", "trust", *SITE, "--store", "r.db"]
    assert shell("mission", "activate", "m.token", *on, "--new")[0] == 0
    named = ["--key", KEY, "--cert", CERT]
    assert shell("mission", "suspend", "m.token", *on, *named)[0] == 4
    code, said = shell.json("mission", "suspend", "m.token", *on, *named, *PASS)
    assert (code, said["status"]) == (0, "suspended")


def test_a_site_is_signed_with_a_sealed_key(shell: Shell) -> None:
    key = "trust/keys/site-authority-1.key.pem"
    assert shell("keys", "protect", key, *PASS)[0] == 0
    named = ["--key", key, "--cert", "trust/keys/site-authority-1.cert.pem", "--out", "s.token"]
    assert shell("site", "sign", "h/site.yaml", *named)[0] == 4
    assert shell("site", "sign", "h/site.yaml", *named, *PASS)[0] == 0


def test_every_command_that_takes_a_persons_key_takes_a_passphrase_file() -> None:
    found = dict(commands(program(), ""))
    taking = {name for name, options in found.items() if "--key" in options}
    assert len(taking) > 10
    without = {name for name in taking if "--passphrase-file" not in found[name]}
    # a call's key is its name, a log's is public
    assert without <= SERVICES | {"emergency call", "audit verify", "audit segments"}


def test_no_command_takes_a_passphrase_as_an_argument_or_from_the_environment() -> None:
    for name, options in commands(program(), ""):
        assert not {"--passphrase", "--pin", "--password"} & set(options), name
    named = {getattr(option, "envvar", None) for option in every(program())} - {None}
    assert named == {f"AUTHGUARD_{name.upper()}" for name in NAMES}  # paths, never a passphrase


def commands(command: Any, name: str) -> Iterator[tuple[str, list[str]]]:
    """Yield every command's name with the options that it takes."""
    for word, one in getattr(command, "commands", {}).items():
        yield from commands(one, f"{name} {word}".strip())
    if not hasattr(command, "commands"):
        yield name, [opt for param in command.params for opt in param.opts]


def every(command: Any) -> Iterator[Any]:
    yield from command.params
    for one in getattr(command, "commands", {}).values():
        yield from every(one)


# -- public keys -----------------------------------------------------------------------------------


def test_the_public_key_of_a_file_is_written_plain_or_sealed(shell: Shell) -> None:
    code, said = shell.json("keys", "public", "--key", KEY)
    assert code == 0
    load_pem_public_key(said["public"].encode())
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    assert shell("keys", "public", "--key", KEY)[0] == 4
    assert shell("keys", "public", "--key", KEY, *PASS, "--out", "public.pem")[0] == 0
    assert Path("public.pem").read_text() == said["public"]


# -- a key in hardware -----------------------------------------------------------------------------


def certify(trust: Path, public: Path, to: Path) -> None:
    """Give operator-1 a certificate of a public key, as the people authority does."""
    people = read_authority(trust, "people")
    key = load_pem_public_key(public.read_bytes())
    leaf = build_leaf(
        key,  # type: ignore[arg-type]
        principal="operator-1",
        role=Role.OPERATOR,
        issuer=people.certificate,
        key=people.key,
        now=datetime.now(UTC),
        days=1,
        robots=None,
        regions=None,
    )
    pair = (leaf, people.certificate)
    to.write_bytes(b"".join(one.public_bytes(Encoding.PEM) for one in pair))


@needs_token
def test_a_mission_signed_in_hardware_moves_the_robot_of_a_gate(
    shell: Shell, tmp_path: Path
) -> None:
    with Token(tmp_path) as token, RunningGate(simulate=True) as gate:
        token.make("operator-1")
        say(token.pin, "pin")
        key = ["--key", token.uri("operator-1")]
        pin = ["--passphrase-file", "pin"]
        assert shell("keys", "public", *key, *pin, "--out", "public.pem")[0] == 0
        certify(gate.trust, Path("public.pem"), Path("cert.pem"))
        Path("m.json").write_bytes(encode(gate.mission()) + b"\n")
        signer = [*key, "--cert", "cert.pem"]
        sign = ["mission", "sign", "m.json", *signer, "--trust", gate.trust, *SITE, "--yes"]
        assert shell(*sign)[0] == 4  # nobody said the PIN
        say("999999", "wrong")
        code, out = shell(*sign, "--passphrase-file", "wrong")
        assert (code, "the PIN is wrong" in out) == (4, True)
        assert not Path("m.token").exists()
        code, out = shell(*sign, *pin)
        assert (code, token.pin not in out) == (0, True), out
        on = ["--trust", gate.trust, *SITE, "--store", gate.store, "--robot", gate.rid]
        code, said = shell.json("mission", "activate", "m.token", *on, "--new")
        assert (code, said["status"]) == (0, "active")
        told = gate.client(ClientRole.PLANNER, "llm").propose(COLLECT)
        assert [step["outcome"] for step in told["steps"]] == ["accept", "accept"]
        code, said = shell.json("mission", "suspend", "m.token", *on, *signer, *pin)
        assert (code, said["status"]) == (0, "suspended")


@needs_token
def test_a_key_in_hardware_gets_its_certificate_by_request(shell: Shell, tmp_path: Path) -> None:
    with Token(tmp_path) as token:
        token.make("operator-1")
        say(token.pin, "pin")
        key = ["--key", token.uri("operator-1"), "--passphrase-file", "pin"]
        assert shell("keys", "init", "auth", "--no-demo")[0] == 0
        asked = ["--role", "operator", "--principal", "operator-1"]
        asked += ["--every-robot", "--every-region"]
        code, told = shell.json("keys", "request", *asked, *key, "--out", "op")
        assert (code, told["request"]) == (0, "op/operator-1.request.json")
        assert [path.name for path in Path("op").iterdir()] == ["operator-1.request.json"]
        assert shell("keys", "issue", "auth", told["request"], "--yes")[0] == 0
        root = shell.json("keys", "show", "auth")[1]
        assert root["demo"] is False
        answer = ["op/operator-1.answer.json", "--trust", "op/trust", "--cert", "op/o.cert.pem"]
        anchor = read_trust(Path("auth"))
        named = ["--root", fingerprint(anchor.roots), "--request", told["request"]]
        assert shell("keys", "install", *answer, *key, *named)[0] == 0
        with open_signing(token, "op/o.cert.pem") as signer:
            now = wall_now(None)
            found = read_trust(Path("op/trust")).verify(b"go", signer.endorse(b"go"), now)
        assert found.id == "operator-1"


@contextmanager
def open_signing(token: Token, cert: str) -> Iterator[FileSigner]:
    key = open_key(token.uri("operator-1"), lambda _: token.pin)
    yield certified((key,), Path(cert))
    key.close()


def test_a_key_that_is_there_asks_for_its_own_certificate(shell: Shell) -> None:
    """Sealed before anything was asked for: the key was never plain beside its certificate."""
    assert shell("keys", "protect", KEY, *PASS)[0] == 0
    asked = ["--role", "operator", "--principal", "operator-1", "--key", KEY]
    asked += ["--every-robot", "--every-region"]
    assert shell("keys", "request", *asked, "--out", "op")[0] == 4
    assert shell("keys", "request", *asked, *PASS, "--out", "op")[0] == 0
    request = open_request(Path("op/operator-1.request.json").read_bytes())
    (public,) = request.keys
    code, said = shell.json("keys", "public", "--key", KEY, *PASS)
    assert (code, load_pem_public_key(said["public"].encode())) == (0, public)


@needs_token
def test_a_pin_in_the_uri_is_refused_and_not_repeated(shell: Shell, tmp_path: Path) -> None:
    with Token(tmp_path) as token:
        token.make("operator-1")
        uri = token.uri("operator-1").replace("?", f"?pin-value={token.pin}&")
        code, out = shell("keys", "public", "--key", uri)
        assert (code, token.pin in out) == (4, False)


def test_a_plain_key_needs_no_passphrase_and_asks_for_none(shell: Shell) -> None:
    mission = compiled(shell)
    sign = ["mission", "sign", mission, "--key", KEY, "--cert", CERT, *SITE, "--yes"]
    assert shell(*sign)[0] == 0
