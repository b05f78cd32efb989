# SPDX-License-Identifier: Apache-2.0
"""`authguard mission template` and `instance`: signed once, filled by a scheduler, counted."""

from __future__ import annotations

import io
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import call
from authguard_r.enforcement.confirmation import ConfirmationMode
from fixtures import scenarios

SITE = ["--site", "h/site.yaml"]
AT = ["--trust", "trust", *SITE, "--store", "r.db"]
ALONE = "no gate answered: this is in the store r.db alone\n"
DEMO_KEY = "key: the one in the demonstration's trust folder\n"
KEY = ["--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem"]
SCHEDULER = ["--key", "trust/keys/scheduler-1.key.pem", "--cert", "trust/keys/scheduler-1.cert.pem"]
FILL = ["--fill", "package=package-p1", "--fill", "station=station-101"]


class Terminal(io.StringIO):
    """Standard input with a person at it."""

    def isatty(self) -> bool:
        return True


class Shell:
    """One working folder with the hospital in it, and what the last command printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: str, typed: str | None = None) -> tuple[int, str]:
        silent = io.TextIOWrapper(io.BytesIO(b""))
        self._patch.setattr(sys, "stdin", silent if typed is None else Terminal(typed))
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: str) -> tuple[int, Any]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"")))
        code = call([*map(str, arguments), "--json"])
        return code, json.loads(self._capsys.readouterr().out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Iterator[Shell]:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    yield Shell(capsys, monkeypatch)
    assert list(tmp_path.glob("**/*.new")) == []  # nothing half written is left


def signed(shell: Shell) -> str:
    """Compile and sign the shipped template, and give it a scheduler."""
    assert (
        shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")[0] == 0
    )
    assert shell("mission", "template", "sign", "t.json", *KEY, *SITE, "--yes")[0] == 0
    code, out = shell("mission", "template", "issue", "t.token", "--trust", "trust")
    assert (code, "keys/scheduler-1.key.pem" in out) == (0, True)
    return "t.token"


def admitted(shell: Shell) -> str:
    token = signed(shell)
    assert shell("mission", "template", "admit", token, *AT, "--new")[0] == 0
    return token


def filled(shell: Shell, token: str, name: str, *more: str) -> str:
    arguments = [*SCHEDULER, *FILL, "--name", name, "--out", f"{name}.token", *more]
    code, out = shell("mission", "instance", "sign", token, *arguments)
    assert code == 0, out
    return f"{name}.token"


def test_one_signature_and_two_missions_make_half_a_prompt_each(shell: Shell) -> None:
    token = admitted(shell)
    for name in ("a", "b"):
        instance = filled(shell, token, name)
        code, out = shell("mission", "activate", instance, *AT)
        assert (code, out) == (0, f"deliver.{name} version 1: active\n{ALONE}")
        ended = shell("mission", "complete", instance, *AT, "--template", token)
        assert ended == (0, f"deliver.{name} version 1: completed\n{ALONE}{DEMO_KEY}")
    code, found = shell.json("audit", "prompts", "r.db")
    assert (code, found) == (
        0,
        {
            "missions": 2,
            "signatures": 1,
            "requests": 0,
            "choices": 0,
            "asked": 1,
            "per_mission": 0.5,
        },
    )
    code, out = shell("audit", "prompts", "r.db")
    head = "0.5 approval requests per mission: a person was asked 1 time(s) for 2 mission(s)"
    assert out.startswith(head)
    assert shell("audit", "verify", "r.db")[0] == 0


def test_a_person_is_shown_every_form_and_asked_once(shell: Shell) -> None:
    shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")
    code, out = shell("mission", "template", "sign", "t.json", *KEY, *SITE, typed="y\n")
    assert code == 0
    assert "Sign exactly this, for 50 missions?" in out
    for station in ("station-101", "station-102", "station-103"):
        assert f"from pharmacy to {station}" in out
    record = json.loads(Path("t.confirmation.json").read_text())
    assert (record["how"], record["shown"]) == (ConfirmationMode.INTERACTIVE, True)
    code, shown = shell.json("mission", "template", "review", "t.token", *SITE)
    assert (code, shown["card_digest"]) == (0, record["card"])
    assert (shown["digest"], shown["combinations"]) == (record["digest"], 6)


def test_a_no_signs_nothing(shell: Shell) -> None:
    shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")
    assert shell("mission", "template", "sign", "t.json", *KEY, *SITE, typed="n\n")[0] == 2
    assert not Path("t.token").exists()


def test_nobody_signs_what_was_not_shown(shell: Shell) -> None:
    shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")
    code, out = shell("mission", "template", "sign", "t.json", *KEY)
    assert (code, "--site" in out) == (2, True)
    code, out = shell("mission", "template", "sign", "t.json", *KEY, "--yes")
    assert (code, "WARNING no card was shown" in out) == (0, True)
    record = json.loads(Path("t.confirmation.json").read_text())
    assert (record["how"], record["shown"], "card" in record) == ("script", False, False)


@pytest.mark.parametrize(
    ("by", "code", "reason"),
    [("supervisor-1", 1, "ROLE_DENIED"), ("operator-2", 1, "ISSUER_MISMATCH")],
)
def test_the_wrong_person_signs_no_template(shell: Shell, by: str, code: int, reason: str) -> None:
    shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")
    key = ["--key", f"trust/keys/{by}.key.pem", "--cert", f"trust/keys/{by}.cert.pem"]
    got, out = shell("mission", "template", "sign", "t.json", *key, *SITE, "--yes")
    assert (got, out.startswith(reason)) == (code, True)
    assert not Path("t.token").exists()


def test_a_lint_error_of_any_combination_is_accepted_by_name_or_not_signed(shell: Shell) -> None:
    text = Path("h/template.yaml").read_text()
    assert "      after: [place]\n" in text
    Path("d.yaml").write_text(text.replace("      after: [place]\n", ""))
    shell("mission", "template", "compile", "d.yaml", *SITE, "--out", "t.json")
    code, out = shell("mission", "template", "sign", "t.json", *KEY, *SITE, "--yes")
    assert (code, "--accept UNGUARDED_RETURN" in out) == (1, True)
    code, out = shell(
        "mission",
        "template",
        "sign",
        "t.json",
        *KEY,
        *SITE,
        "--yes",
        "--accept",
        "UNGUARDED_RETURN",
    )
    assert code == 0
    assert json.loads(Path("t.confirmation.json").read_text())["accepted"] == ["UNGUARDED_RETURN"]


def test_a_value_that_the_site_does_not_have_is_not_signed(shell: Shell) -> None:
    shell("mission", "template", "compile", "h/template.yaml", *SITE, "--out", "t.json")
    plain = Path("t.json").read_text().replace("station-103", "station-109")
    Path("t.json").write_text(plain)
    code, out = shell("mission", "template", "sign", "t.json", *KEY, *SITE, "--yes")
    assert (code, out.startswith("NAME_UNKNOWN")) == (4, True)


def test_what_a_draft_leaves_open_is_asked_about(shell: Shell) -> None:
    text = Path("h/template.yaml").read_text()
    Path("d.yaml").write_text(text.replace("instances: 50\n", "").replace("lasts: 720 h\n", ""))
    code, found = shell.json("mission", "template", "compile", "d.yaml", *SITE)
    assert code == 3
    assert [q["field"] for q in found["clarifications"]] == ["instances", "lasts"]


def test_show_says_what_it_is_without_any_claim(shell: Shell) -> None:
    token = signed(shell)
    code, out = shell("mission", "template", "show", token)
    assert (code, out.splitlines()[-1]) == (0, "(not verified)")
    assert "station (region): station-101, station-102, station-103" in out
    code, plain = shell.json("mission", "template", "show", "t.json")
    assert plain["template"]["template"] == "deliver"


@pytest.mark.parametrize(
    ("data", "code"), [(b"", 4), (b"{}", 4), (b"\xff", 4), (b'{"endorsements":1}', 4)]
)
def test_a_file_that_is_no_template_is_said_to_be_none(
    shell: Shell, data: bytes, code: int
) -> None:
    Path("x.json").write_bytes(data)
    for arguments in (
        ["template", "show", "x.json"],
        ["template", "review", "x.json", *SITE],
        ["template", "sign", "x.json", *KEY, "--yes"],
        ["template", "issue", "x.json", "--trust", "trust"],
        ["template", "admit", "x.json", *AT, "--new"],
        ["template", "withdraw", "x.json", *AT],
        ["instance", "sign", "x.json", *KEY],
    ):
        assert shell("mission", *arguments)[0] == code, arguments


def test_a_scheduler_is_issued_for_an_authentic_template_and_a_new_name(shell: Shell) -> None:
    token = signed(shell)
    issue = ["mission", "template", "issue"]
    assert shell(*issue, token, "--trust", "trust")[0] == 5  # the name is taken
    assert shell(*issue, "t.json", "--trust", "trust", "--name", "s2")[0] == 4
    code, found = shell.json(*issue, token, "--trust", "trust", "--name", "s2", "--days", "3")
    assert (code, found["scheduler"]) == (0, "s2")
    roles = {
        f["principal"]: f["role"] for f in shell.json("keys", "show", "trust")[1]["principals"]
    }
    assert roles["s2"] == roles["scheduler-1"] == "scheduler"


WRONG: dict[str, tuple[list[str], int, str]] = {
    "outside the set": (["--fill", "package=package-p1", "--fill", "station=dock"], 1, "VALUE_OUT"),
    "a hole too few": (["--fill", "package=package-p1"], 1, "SCHEMA_INVALID"),
    "no fill at all": ([], 1, "SCHEMA_INVALID"),
    "an unknown hole": ([*FILL, "--fill", "tool=arm"], 1, "SCHEMA_INVALID"),
    "a hole twice": ([*FILL, "--fill", "station=station-102"], 2, "USAGE"),
    "no value": (["--fill", "package"], 2, "USAGE"),
    "too long": ([*FILL, "--for", "26 min"], 1, "VALUE_OUT_OF_RANGE"),
    "no length": ([*FILL, "--for", "long"], 4, "MALFORMED"),
    "a name that is none": ([*FILL, "--name", "A B"], 4, "SCHEMA_INVALID"),
    "after its end": ([*FILL, "--now", "2099-01-01T00:00:00Z"], 1, "EXPIRED"),
}


@pytest.mark.parametrize("what", WRONG)
def test_an_instance_that_no_gate_would_take_is_not_signed(shell: Shell, what: str) -> None:
    said, code, reason = WRONG[what]
    token = signed(shell)
    got, out = shell("mission", "instance", "sign", token, *SCHEDULER, *said, "--out", "i.token")
    assert (got, out.startswith(reason)) == (code, True), out
    assert not Path("i.token").exists()


def test_a_key_of_somebody_else_signs_no_instance(shell: Shell) -> None:
    token = signed(shell)
    assert shell("mission", "instance", "sign", token, *KEY, *FILL)[0] == 4
    text = Path("h/template.yaml").read_text()
    Path("d.yaml").write_text(text.replace("instances: 50", "instances: 51"))
    shell("mission", "template", "compile", "d.yaml", *SITE, "--out", "other.json")
    code, out = shell("mission", "instance", "sign", "other.json", *SCHEDULER, *FILL)
    assert (code, out.startswith("ROLE_DENIED: the certificate is bound to")) == (1, True)


def test_without_a_trust_folder_nobody_checked_whose_key_it_is(shell: Shell) -> None:
    token = signed(shell)
    for kind in ("key", "cert"):
        shutil.copy(f"trust/keys/scheduler-1.{kind}.pem", f"{kind}.pem")
    key = ["--key", "key.pem", "--cert", "cert.pem"]
    code, out = shell("mission", "instance", "sign", token, *key, *FILL)
    assert (code, "WARNING whose key it is was not checked" in out) == (0, True)


def test_integers_are_filled_as_integers(shell: Shell) -> None:
    text = Path("h/template.yaml").read_text()
    text = text.replace(
        "speed_mm_s: [0.05 m/s, 0.8 m/s]", "speed_mm_s: [0.05 m/s, {hole: fast}]", 1
    )
    hole = "holes:\n  fast: {kind: integer, unit: mm/s, values: [0.5 m/s, 0.8 m/s]}\n"
    Path("d.yaml").write_text(text.replace("holes:\n", hole, 1))
    Path("h/template.yaml").write_text(Path("d.yaml").read_text())
    token = signed(shell)
    arguments = ["mission", "instance", "sign", token, *SCHEDULER, *FILL]
    assert shell(*arguments, "--fill", "fast=500", "--name", "a", "--out", "a.token")[0] == 0
    assert shell(*arguments, "--fill", "fast=fast")[0] == 2
    assert shell(*arguments, "--fill", "fast=501")[0] == 1


def test_orders_about_an_instance_need_its_template(shell: Shell) -> None:
    token = admitted(shell)
    instance = filled(shell, token, "a")
    shell("mission", "activate", instance, *AT)
    code, out = shell("mission", "suspend", instance, *AT)
    assert (code, "--template" in out) == (2, True)
    assert shell("mission", "suspend", instance, *AT, "--template", token)[0] == 0
    assert shell("mission", "resume", instance, *AT, "--template", token)[0] == 0
    grant = ["--grant", "pick", "--row", "0", "--yes"]
    assert shell("mission", "choose", instance, *AT, "--template", token, *grant)[0] == 0
    ticket = ["--ticket", "A" * 43, "--outcome", "failed"]
    assert shell("mission", "resolve", instance, *AT, "--template", token, *ticket)[0] == 1
    assert shell("mission", "revoke", instance, *AT, "--template", token)[0] == 0
    assert shell.json("audit", "prompts", "r.db")[1]["choices"] == 1


def test_an_instance_before_its_template_is_refused(shell: Shell) -> None:
    token = signed(shell)
    code, out = shell("mission", "activate", filled(shell, token, "a"), *AT, "--new")
    assert (code, out.startswith("MISSION_UNKNOWN")) == (1, True)


def test_a_withdrawn_template_says_so(shell: Shell) -> None:
    token = admitted(shell)
    instance = filled(shell, token, "a")
    shell("mission", "activate", instance, *AT)
    officer = "trust/keys/safety-officer-1"
    key = ["--key", f"{officer}.key.pem", "--cert", f"{officer}.cert.pem"]
    assert shell("mission", "template", "withdraw", token, *AT, *key[2:])[0] == 2
    code, found = shell.json("mission", "template", "withdraw", token, *AT, *key[:2])
    assert (code, found["status"], found["template"]["used"]) == (0, "withdrawn", 1)
    assert shell("mission", "template", "withdraw", token, *AT)[0] == 1
    assert shell("mission", "template", "admit", token, *AT, "--new")[0] == 1
    code, out = shell("mission", "activate", filled(shell, token, "b"), *AT)
    assert (code, out.startswith("REVOKED")) == (1, True)
    code, out = shell("audit", "show", "r.db", "--kind", "management")
    for verb in ("template", "activate", "withdraw", "revoke"):
        assert f"management {verb}" in out


def test_without_a_confirmation_the_log_will_say_so(shell: Shell) -> None:
    token = signed(shell)
    Path("t.confirmation.json").unlink()
    code, out = shell("mission", "template", "admit", token, *AT, "--new")
    assert (code, "WARNING no confirmation" in out) == (0, True)
    code, out = shell("mission", "activate", filled(shell, token, "a"), *AT)
    assert (code, "WARNING" in out) == (0, False)
