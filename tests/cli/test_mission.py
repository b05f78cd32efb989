# SPDX-License-Identifier: Apache-2.0
"""`authguard mission`: questions, answers, lint, signing, confirmation, and the paper's update."""

from __future__ import annotations

import io
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import worlds
from authguard_r.cli import call

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
    shutil.copytree(worlds.HOSPITAL, tmp_path / "h")
    shutil.copytree(worlds.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{worlds.OTHER}*"):
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
    assert "expected the node content" in text
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
    code, text = shell("mission", "lint", compiled(shell), *SITE)
    assert (code, text.splitlines()[0]) == (
        0,
        (
            "WARNING UNGUARDED_RETURN at actions[5].guards: only order holds `go-home` back: "
            "no guard on trusted state"
        ),
    )
    assert shell("mission", "lint", "m.json", *SITE, "--strict")[0] == 1
    code, found = shell.json("mission", "lint", compiled(shell, UNGUARDED), *SITE)
    assert code == 1
    assert [(f["code"], f["severity"]) for f in found["lint"]] == [("UNGUARDED_RETURN", "error")]
    assert set(found["lint"][0]) == {"code", "where", "message", "mend", "severity"}


def test_a_mission_without_findings_says_so(shell: Shell) -> None:
    guard = "    guards: [{variable: holding, eq: nothing, max_age: 1 s}]\n"
    code, text = shell("mission", "lint", compiled(shell, (UNGUARDED[0], guard)), *SITE, "--strict")
    assert (code, text) == (0, "nothing to look at\n")


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
    for verb in (["review"], ["lint"], ["diff", "m.json"]):
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
    assert sign(shell, "--yes", "--accept", "UNGUARDED_RETURN")[0] == 2  # no site, nothing found
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
        "request": worlds.draft()["task"],
        "by": "operator-1",
        "at_ms": said["at_ms"],
        "how": "interactive",
        "card": card["card_digest"],
    }


def test_without_the_site_no_card_was_shown_and_the_confirmation_claims_none(shell: Shell) -> None:
    compiled(shell, UNGUARDED)
    assert sign(shell, "--yes")[0] == 0
    assert "card" not in json.loads(Path("m.confirmation.json").read_text())


def test_no_is_no_and_leaves_neither_token_nor_confirmation(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, typed="n\n")[0] == 2
    assert sign(shell, *SITE)[0] == 2
    assert not Path("m.token").exists()
    assert not Path("m.confirmation.json").exists()


def test_an_activation_takes_the_confirmation_into_the_log(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    said = ["--confirmation", "m.confirmation.json"]
    assert shell("mission", "activate", "m.token", *AT, *said)[0] == 0
    _, shown = shell.json("audit", "show", "r.db", "--kind", "management")
    (record,) = shown["records"]
    assert set(record["committed"]) == {"confirmation", "token"}
    assert record["values"]["confirmation"] == json.loads(Path("m.confirmation.json").read_text())


def test_a_confirmation_of_something_else_activates_nothing(shell: Shell) -> None:
    compiled(shell)
    assert sign(shell, *SITE, "--yes")[0] == 0
    shutil.copy("m.confirmation.json", "old.json")
    compiled(shell)  # the same draft once more: a fresh nonce, another mission
    assert sign(shell, *SITE, "--yes")[0] == 0
    code, error = shell.json("mission", "activate", "m.token", *AT, "--confirmation", "old.json")
    assert (code, error["error"]["code"]) == (1, "META_MISMATCH")
    Path("junk.json").write_text("{}")
    assert shell("mission", "activate", "m.token", *AT, "--confirmation", "junk.json")[0] == 4
    assert shell("mission", "activate", "m.token", *AT, "--confirmation", "none.json")[0] == 5
    assert shell("mission", "suspend", "m.token", *AT)[0] == 1  # no such mission is here
    assert shell("mission", "activate", "m.token", *AT)[0] == 0


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
        shell("mission", "activate", "m.token", *AT, "--confirmation", "m.confirmation.json")[0]
        == 1
    )


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
    assert shell("mission", "activate", "m2.json", *AT)[0] == 4
    code, text = shell("run", "--token", "m.token", *RUN, *deliver, *there)
    assert (code, "DESTINATION_OUT_OF_SCOPE" in text) == (1, True)
    signed = shell("mission", "sign", "m2.json", *KEY, *SITE, "--out", "m2.token", "--yes")
    assert signed[0] == 0
    assert shell("mission", "activate", "m2.token", *AT)[0] == 0
    code, ran = shell.json("run", "--token", "m2.token", *RUN, *deliver, *there)
    assert code == 0, ran
    assert ran["robot"] == {"region": "station-103", "holding": None}
    _, shown = shell.json("audit", "show", "r.db", "--kind", "management")
    first, update = (r["open"] for r in shown["records"] if r["open"]["verb"] == "activate")
    assert (first["supersedes"], update["supersedes"]) == ("-", first["mission"])
    code, whole = shell.json("audit", "verify", "r.db")
    assert (code, whole["whole"]) == (0, True)
