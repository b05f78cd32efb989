# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`: questions, answers, lint, signing, confirmation, and the paper's update."""

from __future__ import annotations

import io
import json
import os
import pty
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import call
from fixtures import scenarios

SITE = ["--site", "h/site.yaml"]
KEY = ["--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem"]
AT = ["--trust", "trust", *SITE, "--store", "r.db"]
RUN = [*AT, "--binding", "h/binding.yaml"]


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

    def json(self, *arguments: str, typed: str | None = None) -> tuple[int, Any]:
        code, out = self(*arguments, "--json", typed=typed)
        return code, json.loads(out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Iterator[Shell]:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    yield Shell(capsys, monkeypatch)
    assert list(tmp_path.glob("**/*.new")) == []  # nothing half written is left


def edit(*changes: tuple[str, str], to: str = "d.yaml") -> str:
    """Write the shipped draft with pieces of text replaced."""
    text = Path("h/mission.yaml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    Path(to).write_text(text)
    return to


def compiled(shell: Shell, *changes: tuple[str, str]) -> str:
    draft = edit(*changes)
    assert shell("mission", "compile", draft, *SITE, "--out", "m.json")[0] == 0
    return "m.json"


OPEN = (("robot: courier-1\n", ""), ("on_refusal: hold\n", ""), ("    tool: gripper\n", ""))
#: The way home that nothing holds back.
UNGUARDED = ("    after: [place-at-101]\n", "")

# questions and answers


def test_what_says_what_a_robot_is_to_do_is_its_owners_alone(shell: Shell) -> None:
    """A mission names people's rooms: its files are as private as an export of the log."""
    compiled(shell)
    signed = ["mission", "sign", "m.json", *KEY, *SITE, "--out", "m.token", "--yes"]
    assert shell(*signed)[0] == 0
    made = [path for path in Path().iterdir() if path.name.startswith("m.")]
    assert len(made) >= 3  # mission, token, confirmation
    assert {stat.S_IMODE(path.stat().st_mode) for path in made} == {0o600}


def test_every_open_question_is_in_one_answer_of_exit_3(shell: Shell) -> None:
    code, asked = shell.json("mission", "compile", edit(*OPEN), *SITE)
    assert code == 3
    assert asked["error"] == {
        "code": "CLARIFICATION_NEEDED",
        "message": "Which robot is meant?",
        "where": "robot",
    }
    assert asked["clarification"] == asked["clarifications"][0]
    assert asked["clarifications"] == [
        {
            "field": "robot",
            "question": "Which robot is meant?",
            "candidates": ["courier-1", "lifter-1"],
        },
        {
            "field": "on_refusal",
            "question": "What happens after a refusal?",
            "candidates": ["hold", "stop", "ask"],
        },
    ]
    code, text = shell("mission", "compile", "d.yaml", *SITE)
    assert code == 3
    assert "CLARIFICATION_NEEDED: What happens after a refusal? (at on_refusal)\n  hold\n" in text
    assert not Path("d.mission.json").exists()


ANSWERS = ["--answer", "robot=courier-1", "--answer", "on_refusal=hold"]


def test_answers_settle_questions_also_those_that_come_of_answers(shell: Shell) -> None:
    edit(*OPEN)
    code, asked = shell.json("mission", "compile", "d.yaml", *SITE, *ANSWERS)
    assert code == 3
    assert [item["field"] for item in asked["clarifications"]] == ["grants[1].tool"]
    answers = [*ANSWERS, "--answer", "grants[1].tool=gripper"]
    code, made = shell.json("mission", "compile", "d.yaml", *SITE, *answers)
    assert code == 0
    assert made["mission"]["actions"][1]["tool"] == "gripper"


@pytest.mark.parametrize(
    "answer",
    ["grants[1].rows[0].object=package-p2", "robot=lifter-1", "nonsense", "robot=", "a b=1"],
)
def test_an_answer_to_no_question_is_refused(shell: Shell, answer: str) -> None:
    code, refused = shell.json("mission", "compile", "h/mission.yaml", *SITE, "--answer", answer)
    assert code == 4
    assert refused["error"]["where"]
    assert not Path("h/mission.mission.json").exists()


def test_a_person_at_the_terminal_is_asked_until_all_is_said(shell: Shell) -> None:
    edit(*OPEN)
    typed = "\n   \n1\nhold\n\ngripper\n"
    code, text = shell("mission", "compile", "d.yaml", *SITE, "--out", "m.json", typed=typed)
    assert code == 0, text
    assert "  1) courier-1\n  2) lifter-1\n" in text
    assert text.count("Which robot is meant?") == 1
    opened = json.loads(Path("m.json").read_text())
    assert (opened["rid"], opened["on_refusal"]) == ("courier-1", "hold")
    assert opened["actions"][1]["tool"] == "gripper"


def test_a_wrong_answer_at_the_terminal_is_told_and_asked_again(shell: Shell) -> None:
    draft = edit(OPEN[0], ("    limits: {force_mn: [1 N, 20 N]}\n", ""))
    typed = "[\nsomebody\n[1 N, 20 kg]\ncourier-1\n[1 N, 20]\n1\n"
    code, text = shell("mission", "compile", draft, *SITE, "--out", "m.json", typed=typed)
    assert code == 0, text
    assert "node content" in text
    assert "the site has no robot `somebody` (at robot)" in text
    assert "expected a quantity in mN or like it, got `kg`" in text
    assert "`20` has no unit; which one is meant? (grants[1].limits.force_mn[1])" in text
    assert text.count("Which robot is meant?") == 2
    opened = json.loads(Path("m.json").read_text())
    assert opened["actions"][1]["limits"] == [{"parameter": "force_mn", "low": 1000, "high": 20000}]


def test_a_terminal_that_ends_writes_nothing(shell: Shell) -> None:
    code, text = shell("mission", "compile", edit(*OPEN), *SITE, "--out", "m.json", typed="1\n")
    assert (code, "stopped by the user" in text) == (2, True)
    assert not Path("m.json").exists()


@pytest.mark.parametrize("flag", ["--no-input", "--json"])
def test_nobody_is_asked_where_a_script_listens(shell: Shell, flag: str) -> None:
    code, _ = shell("mission", "compile", edit(*OPEN), *SITE, flag, typed="1\nhold\ngripper\n")
    assert code == 3


def test_a_fault_of_the_draft_is_not_asked_about_for_ever(shell: Shell) -> None:
    edit(("robot: courier-1\n", ""), ("type: pick", "type: fly"))
    code, text = shell("mission", "compile", "d.yaml", *SITE, typed="1\n" * 50)
    assert (code, "no action type `fly`" in text) == (4, True)


# lint


def test_lint_names_what_to_look_at_and_fails_on_errors(shell: Shell) -> None:
    code, text = shell("mission", "check", compiled(shell), *SITE)
    assert (code, text.splitlines()[0]) == (
        0,
        (
            "WARNING UNGUARDED_RETURN at actions[5].guards: only the order of grants delays "
            "`go-home`: no guard on trusted state"
        ),
    )
    assert shell("mission", "check", "m.json", *SITE, "--strict")[0] == 1
    code, found = shell.json("mission", "check", compiled(shell, UNGUARDED), *SITE)
    assert code == 1
    assert [(f["code"], f["severity"]) for f in found["lint"]] == [("UNGUARDED_RETURN", "error")]
    assert set(found["lint"][0]) == {"code", "where", "message", "mend", "severity"}


def test_a_mission_without_findings_says_so(shell: Shell) -> None:
    guard = "    guards: [{variable: holding, eq: nothing, max_age: 1 s}]\n"
    code, text = shell(
        "mission", "check", compiled(shell, (UNGUARDED[0], guard)), *SITE, "--strict"
    )
    assert (code, text) == (0, "no findings; next: authguard mission sign\n")


def test_compile_and_review_show_the_findings_too(shell: Shell) -> None:
    code, made = shell.json("mission", "compile", edit(UNGUARDED), *SITE, "--out", "m.json")
    assert (code, [f["code"] for f in made["lint"]]) == (0, ["UNGUARDED_RETURN"])
    code, card = shell.json("mission", "review", "m.json", *SITE)
    assert (code, card["lint"]) == (0, made["lint"])
    assert (card["card"], card["card_digest"]) == (made["card"], made["card_digest"])
    assert "ERROR   UNGUARDED_RETURN" in shell("mission", "review", "m.json", *SITE)[1]
    assert "ERROR   UNGUARDED_RETURN" in shell("mission", "compile", "d.yaml", *SITE)[1]


def test_a_file_that_breaks_a_rule_of_the_language_is_not_even_shown(shell: Shell) -> None:
    text = Path(compiled(shell)).read_text()
    Path("m.json").write_text(text.replace('"after":["pick-p1"]', '"after":["nobody"]'))
    for verb in (["review"], ["check"], ["diff", "m.json"]):
        code, error = shell.json("mission", *verb, "m.json", *SITE)
        assert (code, error["error"]["code"]) == (4, "SCHEMA_INVALID")
    assert sign(shell, *SITE, "--yes")[0] == 4


# signing


def sign(shell: Shell, *more: str, typed: str | None = None) -> tuple[int, str]:
    return shell("mission", "sign", "m.json", *KEY, "--out", "m.token", *more, typed=typed)


def test_an_error_is_not_signed_until_it_is_accepted_by_name(shell: Shell) -> None:
    compiled(shell, UNGUARDED)
    code, text = sign(shell, *SITE, "--yes")
    assert (code, "--accept UNGUARDED_RETURN" in text) == (1, True)
    assert "ERROR   UNGUARDED_RETURN" in text
    code, text = sign(shell, *SITE, "--yes", "--json")
    refused = json.loads(text)
    assert (code, refused["error"]["code"], refused["error"]["where"]) == (
        1,
        "LINT",
        "actions[5].guards",
    )
    assert not Path("m.token").exists()
    assert not Path("m.confirmation.json").exists()
    assert sign(shell, *SITE, "--yes", "--accept", "UNGUARDED_RETURN")[0] == 0
    said = json.loads(Path("m.confirmation.json").read_text())
    assert (said["accepted"], said["how"]) == (["UNGUARDED_RETURN"], "script")


@pytest.mark.parametrize("code", ["NEVER_ASKS", "EVERYTHING", ""])
def test_only_what_was_found_can_be_accepted(shell: Shell, code: str) -> None:
    compiled(shell, UNGUARDED)
    assert sign(shell, *SITE, "--yes", "--accept", code)[0] == 2
    assert sign(shell, "--yes", "--accept", code)[0] == 2
    assert not Path("m.token").exists()


def test_the_confirmation_holds_request_mission_card_and_who(shell: Shell) -> None:
    compiled(shell)
    code, text = sign(shell, *SITE, typed="y\n")
    assert code == 0
    assert text.startswith("Mission deliver-p1, version 1, for robot courier-1\n")
    said = json.loads(Path("m.confirmation.json").read_text())
    _, card = shell.json("mission", "review", "m.json", *SITE)
    assert said == {
        "schema": "authguard-r/confirmation/1",
        "mission": card["digest"],
        "mid": "deliver-p1",
        "version": 1,
        "request": scenarios.draft()["task"],
        "by": "operator-1",
        "at_ms": said["at_ms"],
        "how": "interactive",
        "shown": True,
        "card": card["card_digest"],
    }


def test_a_script_with_the_site_prints_the_card_that_it_confirms(shell: Shell) -> None:
    compiled(shell)
    _, card = shell.json("mission", "review", "m.json", *SITE)
    code, text = sign(shell, *SITE, "--yes")
    assert (code, text.startswith("\n".join(card["card"]))) == (0, True)
    code, text = sign(shell, *SITE, "--yes", "--json")
    signed = json.loads(text)
    assert signed["card"] == card["card"]
    assert signed["confirmation"]["card"] == card["card_digest"]
    assert (signed["confirmation"]["how"], signed["confirmation"]["shown"]) == ("script", True)


@pytest.mark.parametrize("typed", [None, "y\n"])
def test_nobody_signs_what_was_not_shown(shell: Shell, typed: str | None) -> None:
    compiled(shell)
    code, text = sign(shell, typed=typed)
    assert (
        code,
        "name the site with --site: the card that you sign is made from it" in text,
    ) == (2, True)
    assert not Path("m.token").exists()
    assert not Path("m.confirmation.json").exists()


def test_a_script_without_the_site_is_warned_and_the_confirmation_claims_no_card(
    shell: Shell,
) -> None:
    compiled(shell)
    code, text = sign(shell, "--yes")
    assert (code, "WARNING no card was shown" in text) == (0, True)
    said = json.loads(Path("m.confirmation.json").read_text())
    assert ("card" in said, said["shown"], said["how"]) == (False, False, "script")
    code, text = sign(shell, "--yes", "--json")
    warning, answer = text.split("WARNING")[1], json.loads(text.partition("\n")[0])
    assert "no card was shown" in warning
    assert (answer["confirmation"]["card"], answer["confirmation"]["shown"]) == (None, False)
    assert shell("mission", "activate", "m.token", *AT, "--new")[0] == 0


def test_without_the_site_a_way_home_that_nothing_holds_back_still_stops_it(shell: Shell) -> None:
    compiled(shell, UNGUARDED)
    code, text = sign(shell, "--yes")
    assert (code, "ERROR   UNGUARDED_RETURN at actions[5].guards" in text) == (1, True)
    assert not Path("m.token").exists()
    assert sign(shell, "--yes", "--accept", "UNGUARDED_RETURN")[0] == 0
    assert json.loads(Path("m.confirmation.json").read_text())["accepted"] == ["UNGUARDED_RETURN"]


def keys_of(name: str) -> list[str]:
    return ["--key", f"trust/keys/{name}.key.pem", "--cert", f"trust/keys/{name}.cert.pem"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("safety-officer-1", "ISSUER_MISMATCH"),
        ("supervisor-1", "ROLE_DENIED"),
        ("gate-courier-1", "ROLE_DENIED"),
    ],
)
def test_the_attack_another_s_key_signs_in_the_issuer_s_name(
    shell: Shell, name: str, reason: str
) -> None:
    compiled(shell)
    given = ["mission", "sign", "m.json", *keys_of(name), *SITE, "--out", "m.token", "--yes"]
    code, error = shell.json(*given)
    assert (code, error["error"]["code"]) == (1, reason)
    assert not Path("m.token").exists()
    assert not Path("m.confirmation.json").exists()


def test_a_safety_officer_signs_what_names_them_as_issuer(shell: Shell) -> None:
    compiled(shell, ("issuer: operator-1", "issuer: safety-officer-1"))
    given = ["mission", "sign", "m.json", *SITE, "--out", "m.token", "--yes"]
    assert shell(*given, *KEY)[0] == 1
    assert shell(*given, *keys_of("safety-officer-1"))[0] == 0
    assert json.loads(Path("m.confirmation.json").read_text())["by"] == "safety-officer-1"


def test_a_key_away_from_its_trust_folder_is_checked_against_the_one_that_is_named(
    shell: Shell,
) -> None:
    compiled(shell)
    Path("mine").mkdir()
    for name in ("supervisor-1", "operator-1"):
        shutil.copy(f"trust/keys/{name}.key.pem", f"mine/{name}.key.pem")
        shutil.copy(f"trust/keys/{name}.cert.pem", f"mine/{name}.cert.pem")
    given = ["mission", "sign", "m.json", *SITE, "--out", "m.token", "--yes"]
    other = ["--key", "mine/supervisor-1.key.pem", "--cert", "mine/supervisor-1.cert.pem"]
    mine = ["--key", "mine/operator-1.key.pem", "--cert", "mine/operator-1.cert.pem"]
    code, error = shell.json(*given, *other, "--trust", "trust")
    assert (code, error["error"]["code"]) == (1, "ROLE_DENIED")
    assert shell(*given, *mine, "--trust", "nowhere")[0] == 5
    assert not Path("m.token").exists()
    assert shell(*given, *mine, "--trust", "trust")[0] == 0
    code, text = shell(*given, *mine)
    assert (code, "WARNING whose key it is was not checked" in text) == (0, True)


def test_a_key_of_another_root_signs_nothing(shell: Shell) -> None:
    compiled(shell)
    assert shell("keys", "init", "other", *SITE)[0] == 0
    given = ["mission", "sign", "m.json", *KEY, *SITE, "--out", "m.token", "--yes"]
    assert shell(*given, "--trust", "other")[0] == 4
    assert not Path("m.token").exists()


def test_no_is_no_and_leaves_neither_token_nor_confirmation(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, typed="n\n")[0] == 2
    assert sign(shell, *SITE)[0] == 2
    assert not Path("m.token").exists()
    assert not Path("m.confirmation.json").exists()


@contextmanager
def stdin_from(file: int) -> Iterator[None]:
    """Let commands read a real file descriptor, and ask it what it is."""
    held = sys.stdin
    with os.fdopen(file, encoding="utf-8") as there:
        sys.stdin = there
        try:
            yield
        finally:
            sys.stdin = held


@pytest.mark.parametrize(("typed", "code"), [(b"y\n", 0), (b"n\n", 2)])
def test_a_person_at_a_terminal_confirms(shell: Shell, typed: bytes, code: int) -> None:
    compiled(shell)
    person, terminal = pty.openpty()
    os.write(person, typed)
    with stdin_from(terminal):
        assert call(["mission", "sign", "m.json", *KEY, *SITE, "--out", "m.token"]) == code
    os.close(person)
    assert Path("m.token").exists() == (code == 0)
    if code == 0:
        assert json.loads(Path("m.confirmation.json").read_text())["how"] == "interactive"


@pytest.mark.parametrize(("typed", "code"), [(b"y\n", 0), (b"", 2)])
def test_the_attack_a_piped_yes_is_no_person_s(shell: Shell, typed: bytes, code: int) -> None:
    compiled(shell)
    reader, writer = os.pipe()
    os.write(writer, typed)
    os.close(writer)
    with stdin_from(reader):
        assert call(["mission", "sign", "m.json", *KEY, *SITE, "--out", "m.token"]) == code
    assert Path("m.token").exists() == (code == 0)
    if code == 0:
        assert json.loads(Path("m.confirmation.json").read_text())["how"] == "script"


def test_a_key_that_nobody_vouches_for_must_at_least_claim_to_be_the_issuer_s(
    shell: Shell,
) -> None:
    compiled(shell)
    Path("mine").mkdir()
    given = ["mission", "sign", "m.json", *SITE, "--out", "m.token", "--yes"]
    for name, reason in (("supervisor-1", "ROLE_DENIED"), ("safety-officer-1", "ISSUER_MISMATCH")):
        for end in ("key", "cert"):
            shutil.copy(f"trust/keys/{name}.{end}.pem", f"mine/{name}.{end}.pem")
        own = ["--key", f"mine/{name}.key.pem", "--cert", f"mine/{name}.cert.pem"]
        code, text = shell(*given, *own)
        assert (code, reason in text) == (1, True)
        assert not Path("m.token").exists()
        assert not Path("m.confirmation.json").exists()


def test_an_activation_takes_the_confirmation_into_the_log(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    said = ["--confirmation", "m.confirmation.json"]
    assert shell("mission", "activate", "m.token", *AT, "--new", *said)[0] == 0
    record = activation(shell)
    assert set(record["committed"]) == {"confirmation", "token"}
    assert record["values"]["confirmation"] == json.loads(Path("m.confirmation.json").read_text())


def activation(shell: Shell) -> Any:
    """Return the last activation's record as `audit show` prints it."""
    _, shown = shell.json("audit", "show", "r.db", "--kind", "management")
    return [r for r in shown["records"] if r["open"]["verb"] == "activate"][-1]


def test_the_confirmation_beside_the_token_is_taken_unasked(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    code, text = shell("mission", "activate", "m.token", *AT, "--new")
    assert (code, "WARNING" in text) == (0, False)
    said = json.loads(Path("m.confirmation.json").read_text())
    assert activation(shell)["values"]["confirmation"] == said
    assert "no confirmation" not in shell("audit", "show", "r.db")[1]


def test_an_activation_without_a_confirmation_warns_and_the_record_says_so(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    Path("m.confirmation.json").unlink()
    code, text = shell("mission", "activate", "m.token", *AT, "--new")
    assert (code, "WARNING no confirmation lies next to the token" in text) == (0, True)
    assert activation(shell)["values"]["confirmation"] == "none"
    assert "version 1, no confirmation" in shell("audit", "show", "r.db")[1]


def test_the_confirmation_of_another_mission_beside_the_token_activates_nothing(
    shell: Shell,
) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    old = Path("m.confirmation.json").read_bytes()
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    own = Path("m.confirmation.json").rename("own.json")
    Path("m.confirmation.json").write_bytes(old)
    code, error = shell.json("mission", "activate", "m.token", *AT, "--new")
    assert (code, error["error"]["code"]) == (1, "META_MISMATCH")
    assert shell("mission", "activate", "m.token", *AT, "--new", "--confirmation", str(own))[0] == 0


def test_a_confirmation_of_something_else_activates_nothing(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    shutil.copy("m.confirmation.json", "old.json")
    compiled(shell)  # the same draft once more: a fresh nonce, another mission
    assert sign(shell, *SITE, "--yes")[0] == 0
    code, error = shell.json(
        "mission", "activate", "m.token", *AT, "--new", "--confirmation", "old.json"
    )
    assert (code, error["error"]["code"]) == (1, "META_MISMATCH")
    Path("junk.json").write_text("{}")
    assert (
        shell("mission", "activate", "m.token", *AT, "--new", "--confirmation", "junk.json")[0] == 4
    )
    assert (
        shell("mission", "activate", "m.token", *AT, "--new", "--confirmation", "none.json")[0] == 5
    )
    assert shell("mission", "suspend", "m.token", *AT)[0] == 1  # no such mission is here
    assert shell("mission", "activate", "m.token", *AT, "--new")[0] == 0


def test_a_disk_that_fails_while_signing_leaves_what_was_there(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    before = [Path(name).read_bytes() for name in ("m.token", "m.confirmation.json")]
    compiled(shell)
    synced: list[int] = []

    def full(file: int) -> None:
        synced.append(file)
        if len(synced) == failing:
            raise OSError(28, "No space left on device")

    for failing in (1, 2):
        synced.clear()
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", full)
            assert sign(shell, *SITE, "--yes")[0] == 5
        assert Path("m.token").read_bytes() == before[0]
        # the confirmation is written first: alone it is of no token, and says so by its digest
        assert (Path("m.confirmation.json").read_bytes() == before[1]) is (failing == 1)
    assert (
        shell(
            "mission", "activate", "m.token", *AT, "--new", "--confirmation", "m.confirmation.json"
        )[0]
        == 1
    )


# versions


def test_a_mission_that_does_not_supersede_the_other_is_said_first(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    v2 = ["mission", "compile", "h/mission-v2.yaml", *SITE, "--supersedes", "m.token"]
    assert shell(*v2, "--out", "v2.json")[0] == 0
    shutil.copy("m.json", "first.json")
    compiled(shell)  # the same words and another nonce: version 2 does not supersede this one
    review, diff = ["mission", "review", "v2.json", *SITE], ["mission", "diff"]
    for old, follows in (("m.token", True), ("first.json", True), ("m.json", False)):
        told = [shell(*review, "--against", old)[1], shell(*diff, old, "v2.json", *SITE)[1]]
        for text in told:
            first = text.partition("\n")[0]
            assert first.startswith("not the next version of `deliver-p1` version 1") != follows
        assert shell.json(*review, "--against", old)[1]["supersedes"] is follows
        assert shell.json(*diff, old, "v2.json", *SITE)[1]["supersedes"] is follows
    assert shell.json(*review)[1]["supersedes"] is None
    assert shell.json(*diff, "v2.json", "m.token", *SITE)[1]["supersedes"] is False
    compiled(shell, ("mission: deliver-p1", "mission: another"))
    _, text = shell(*diff, "m.token", "m.json", *SITE)
    assert text.startswith("not the next version of `deliver-p1` version 1: `another` version 1")


# choices


CHOICE = ("    chooser: trusted_sensor\n", "    chooser: operator\n")


def choice(shell: Shell) -> list[str]:
    """Activate a mission whose operator picks the way, and return the command that picks."""
    compiled(shell, CHOICE)
    assert sign(shell, *SITE, "--yes")[0] == 0
    assert shell("mission", "activate", "m.token", *AT, "--new")[0] == 0
    return ["mission", "choose", "m.token", *AT, "--grant", "go-to-pharmacy", "--row"]


ROW_1 = "row 1: from public-corridor to pharmacy, within pharmacy, public-corridor"


def test_a_choice_shows_its_row_and_asks(shell: Shell) -> None:
    choose = choice(shell)
    code, text = shell(*choose, "1", typed="n\n")
    assert (code, ROW_1 in text) == (2, True)
    assert "select" not in shell("audit", "show", "r.db")[1]
    code, text = shell(*choose, "1", typed="y\n")
    assert (code, ROW_1 in text) == (0, True)
    shown = shell("audit", "show", "r.db")[1]
    assert "go-to-pharmacy, row 1" in next(
        line for line in shown.splitlines() if " select " in line
    )


@pytest.mark.parametrize("said", [(), ("--yes",)])
def test_where_nobody_can_be_asked_the_command_is_the_order(
    shell: Shell, said: tuple[str, ...]
) -> None:
    choose = choice(shell)
    code, text = shell(*choose, "1", *said)
    assert (code, ROW_1 in text) == (0, True)


@pytest.mark.parametrize(("grant", "row"), [("go-to-pharmacy", "2"), ("nothing", "0")])
def test_nobody_is_asked_to_choose_what_is_not_there(shell: Shell, grant: str, row: str) -> None:
    choose = choice(shell)
    choose[choose.index("go-to-pharmacy")] = grant
    assert shell(*choose, row, typed="y\n")[0] == 2
    assert shell(*choose, row, "--yes")[0] == 1  # a refused order, with its record


def test_rows_have_the_numbers_that_a_choice_takes(shell: Shell) -> None:
    choice(shell)
    assert f"  {ROW_1}" in shell("mission", "show", "m.token")[1]
    assert f"    {ROW_1}" in shell("mission", "review", "m.token", *SITE)[1]
    assert "go-to-pharmacy: navigate, chosen by operator" in shell("mission", "show", "m.token")[1]


# the paper's pair


def test_an_unsigned_change_is_refused_and_the_same_change_signed_is_accepted(
    shell: Shell,
) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    collect = ["--plan", "h/replies/01-collect.json"]
    deliver = ["--plan", "h/replies/03-hijacked-by-notice.json"]
    there = ["--at", "pharmacy", "--holding", "package-p1"]
    assert shell("run", "--token", "m.token", *RUN, *collect)[0] == 0
    code, text = shell("run", "--token", "m.token", *RUN, *deliver, *there)
    assert (code, "DESTINATION_OUT_OF_SCOPE" in text) == (1, True)
    v2 = ["mission", "compile", "h/mission-v2.yaml", *SITE, "--supersedes", "m.token"]
    assert shell(*v2, "--out", "m2.json")[0] == 0
    # compiled is not signed: the file is no token
    assert shell("mission", "activate", "m2.json", *AT, "--new")[0] == 4
    code, text = shell("run", "--token", "m.token", *RUN, *deliver, *there)
    assert (code, "DESTINATION_OUT_OF_SCOPE" in text) == (1, True)
    signed = shell("mission", "sign", "m2.json", *KEY, *SITE, "--out", "m2.token", "--yes")
    assert signed[0] == 0
    assert shell("mission", "activate", "m2.token", *AT, "--new")[0] == 0
    code, ran = shell.json("run", "--token", "m2.token", *RUN, *deliver, *there)
    assert code == 0, ran
    assert ran["robot"] == {"region": "station-103", "holding": None}
    _, shown = shell.json("audit", "show", "r.db", "--kind", "management")
    first, update = (r["open"] for r in shown["records"] if r["open"]["verb"] == "activate")
    assert (first["supersedes"], update["supersedes"]) == ("-", first["mission"])
    shown = shell("audit", "show", "r.db", "--kind", "management")[1]
    assert f"version 2, supersedes {first['mission'][:12]}..." in shown
    code, whole = shell.json("audit", "verify", "r.db")
    assert (code, whole["whole"]) == (0, True)


def test_a_mission_file_of_another_kind_is_named_with_the_next_command(shell: Shell) -> None:
    draft, made = "h/mission.yaml", compiled(shell)
    for words, said in (
        (
            ("review", draft),
            f"a draft, expected a compiled mission; next: authguard mission compile {draft}",
        ),
        (("check", "h/site.yaml"), "a site file, expected a compiled mission"),
        (("compile", made), "a compiled mission, expected a draft"),
    ):
        code, text = shell("mission", *words, *SITE)
        assert (code, f"this file is {said}" in text) == (4, True), text
    code, text = shell("mission", "verify", made, "--trust", "trust")
    wanted = f"a compiled mission, expected a signed mission; next: authguard mission sign {made}"
    assert (code, wanted in text) == (4, True), text


def test_a_name_that_is_no_id_says_what_an_id_is(shell: Shell) -> None:
    text = Path("h/mission.yaml").read_text()
    assert "issuer: operator-1" in text
    Path("b.yaml").write_text(text.replace("issuer: operator-1", 'issuer: "Bad Name!"'))
    code, said = shell("mission", "compile", "b.yaml", *SITE)
    assert (code, "expected an id of at most 64 characters of a-z, 0-9" in said) == (4, True)
    assert "(at draft:issuer)" in said
