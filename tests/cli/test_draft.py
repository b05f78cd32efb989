# SPDX-License-Identifier: Apache-2.0
"""`authguard mission draft`: what it prints, what it asks, and that the compiler takes it."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from pytest_httpserver import HTTPServer

from authguard_r import cli
from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.cli.ask import confirm_shown, prompt
from authguard_r.core.errors import ClarificationError
from authguard_r.core.identifiers import Timestamp
from authguard_r.core.quantities import Now, to_ms
from fixtures import scenarios

NOW = "2026-01-01T10:00:00Z"
SITE = str(scenarios.HOSPITAL / "site.yaml")
DELIVER = "Deliver P1 to station 101 within 25 minutes"
GIVEN = ("--robot", "courier-1", "--issuer", "operator-1")


class Console:
    """The command as users call it, through the product's own error handling."""

    def __init__(self, capsys: Any, monkeypatch: Any) -> None:
        self._capsys = capsys
        self._patch = monkeypatch

    def __call__(self, *arguments: str, typed: str | None = None) -> tuple[int, str, str]:
        stdin = io.StringIO(typed or "")
        self._patch.setattr(stdin, "isatty", lambda: typed is not None, raising=False)
        self._patch.setattr(sys, "stdin", stdin)
        clock = () if "--now" in arguments else ("--now", NOW)
        code = cli.call(["mission", "draft", *arguments, "--site", SITE, *clock])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out, out.err


@pytest.fixture
def console(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Console:
    return Console(capsys, monkeypatch)


def compiles(plain: object) -> Any:
    at = Now(to_ms(Timestamp(NOW), where="now"), 0)
    return compile_plain(plain, scenarios.site(), now=at, nonce="A" * 22)


def test_the_printed_draft_is_yaml_that_the_compiler_takes(console: Console) -> None:
    code, out, _ = console(DELIVER, *GIVEN)
    assert code == 0
    plain = yaml.safe_load(out)
    assert compiles(plain).task == DELIVER
    assert "# assumed limits.force_mn: 1 N to 15 N (" in out
    assert "authorizes nothing until it is signed" in out


def test_a_draft_is_written_with_what_it_assumes(console: Console, tmp_path: Path) -> None:
    target = tmp_path / "draft.yaml"
    code, out, _ = console(DELIVER, *GIVEN, "--out", str(target))
    assert code == 0
    assert str(target) in out
    assert "assumed risk_policy" in out
    assert "# assumed risk_policy" in target.read_text()
    compiles(yaml.safe_load(target.read_text()))


def test_json_is_one_object_with_draft_and_assumptions(console: Console) -> None:
    code, out, _ = console(DELIVER, *GIVEN, "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["proposer"] == "template"
    assert {"field", "value", "why"} == set(answer["assumed"][0])
    compiles(answer["draft"])


def test_questions_are_exit_three_with_all_of_them(console: Console) -> None:
    code, out, _ = console("bring the package to the office", *GIVEN, "--json")
    answer = json.loads(out)
    assert code == 3
    assert answer["error"]["code"] == "CLARIFICATION_NEEDED"
    assert answer["clarification"] == answer["clarifications"][0]
    assert [q["field"] for q in answer["clarifications"]] == ["object", "destination", "window"]
    assert answer["clarifications"][1]["candidates"] == ["office-1", "office-2"]


def test_answers_settle_questions(console: Console) -> None:
    answers = ("object=package-p1", "destination=office-2", "window=20 min")
    options = [part for answer in answers for part in ("--answer", answer)]
    code, out, _ = console("bring the package to the office", *GIVEN, *options, "--json")
    assert code == 0
    assert compiles(json.loads(out)["draft"]).regions == (
        "dock",
        "office-2",
        "pharmacy",
        "public-corridor",
    )


def test_words_that_are_not_understood_are_asked_about_at_their_slot(console: Console) -> None:
    sentence = "gently deliver package A to the wet dock within 5 min"
    code, out, _ = console(sentence, *GIVEN, "--json")
    asked = {q["field"]: q for q in json.loads(out)["clarifications"]}
    assert code == 3
    assert set(asked) == {"object", "destination"}
    assert asked["object"]["question"].startswith('"A" is not understood.')
    assert asked["destination"]["candidates"] == ["dock"]
    answers = ("--answer", "object=package-p1", "--answer", "destination=dock")
    code, out, _ = console(sentence, *GIVEN, *answers, "--json")
    assert code == 0
    assert compiles(json.loads(out)["draft"]).objects == ("package-p1",)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (("--answer", "destination"), 4),
        (("--answer", "=x"), 4),
        (("--answer", "window=1 h", "--answer", "window=2 h"), 4),
        (("--answer", "destination=moon"), 4),
        (("--robot", "rover"), 4),
        (("--proposer", "openai"), 2),
        (("--proposer", "oracle"), 2),
        (("--now", "half past two"), 2),
        (("--profile", "/nonexistent/profile.yaml"), 5),
    ],
)
def test_wrong_options_are_said_in_one_line(
    console: Console, options: tuple[str, ...], code: int
) -> None:
    found, out, _ = console("go to the office within 5 min", *GIVEN, *options, "--json")
    assert found == code
    assert set(json.loads(out)) == {"error"}


def test_a_person_at_the_terminal_is_asked(console: Console) -> None:
    typed = "\nmoon\n1\noffice-2\n25 min\n"
    code, out, err = console("bring the package to the office", *GIVEN, typed=typed)
    assert code == 0
    made = compiles(yaml.safe_load(out))
    assert (made.objects, made.expiry) == (("package-p1",), "2026-01-01T10:25:00Z")
    assert "1) package-p1" in err
    assert "Which destination does `office` mean?" in err


def test_a_question_that_no_answer_settles_is_not_asked_for_ever(console: Console) -> None:
    code, _, err = console(
        "go to station 101 unless it is dark within 5 min", *GIVEN, typed="x\n" * 50
    )
    assert code == 3
    assert err.count("say it otherwise (condition)") == 1


def test_a_bad_answer_is_asked_for_again_and_the_others_stay(console: Console) -> None:
    code, out, err = console("go to station 101", *GIVEN, typed="soon\n5 min\n")
    assert code == 0
    assert yaml.safe_load(out)["window"] == {"for": "5 min"}
    assert err.count("How long, or until which instant") == 2
    assert "`soon`" in err


ESCAPES = "\x1b[2J\x07\u202e\nforged"


def says(server: HTTPServer, reply: object) -> None:
    """Let a chat completions server answer with one reply."""
    message = {"role": "assistant", "content": json.dumps(reply)}
    choice = {"index": 0, "finish_reason": "stop", "message": message}
    whole = {"id": "c", "object": "chat.completion", "created": 1, "model": "m"}
    server.clear()
    server.expect_request("/v1/chat/completions").respond_with_json({**whole, "choices": [choice]})


def test_nothing_that_a_model_says_reaches_the_terminal_raw(
    console: Console, httpserver: HTTPServer, tmp_path: Path
) -> None:
    """Escape sequences could hide a candidate, and a line break could forge one."""
    model = ("--proposer", "openai", "--base-url", httpserver.url_for("/v1"))
    model = (*model, "--model", f"m{ESCAPES}")
    asked = {"field": f"a{ESCAPES}", "question": f"q{ESCAPES}?", "candidates": [f"c{ESCAPES}"]}
    says(httpserver, {"questions": [asked]})
    for typed in (None, "wrong\n1\n"):
        code, out, err = console("go there", *model, typed=typed)
        assert code == 3
        assert not set("\x1b\x07\u202e") & set(out + err)
        assert "\nforged" not in out + err
    target = tmp_path / "draft.yaml"
    draft = {"mission": f"m{ESCAPES}", "task": "go there", "budgets": {"motion": 0.8}}
    says(httpserver, draft)
    for options in ((), ("--out", str(target))):
        code, out, err = console("go there", *model, *options)
        assert (code, err) == (0, "")
        assert not set("\x1b\x07\u202e") & set(out)
    assert "\x1b" not in target.read_text()
    assert yaml.safe_load(target.read_text()) == {**draft, "budgets": {"motion": "0.8"}}


def test_a_question_and_a_card_are_printed_without_control_characters(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a site or a draft calls its things reaches the terminal escaped, and nothing is cut."""
    stdin = io.StringIO("1\ny\n")
    monkeypatch.setattr(stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stdin", stdin)
    question = ClarificationError(
        f"q{ESCAPES}", field=f"f{ESCAPES}", candidates=("7", f"c{ESCAPES}")
    )
    assert prompt(question) == 7
    confirm_shown([f"a{ESCAPES}", "z" * 5_000], "Sign?", as_json=False)
    told = capsys.readouterr()
    assert not set("\x1b\x07\u202e") & set(told.out + told.err)
    assert "\nforged" not in told.err
    assert "z" * 5_000 in told.out


def test_no_input_never_asks_and_end_of_input_stops(console: Console) -> None:
    sentence = "bring the package to the office"
    assert console(sentence, *GIVEN, "--no-input", typed="1\n1\n25 min\n")[0] == 3
    assert console(sentence, *GIVEN, typed="")[0] == 2


def test_a_profile_of_ones_own_is_strict(console: Console, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    shipped = Path(scenarios.ROOT / "src/authguard_r/authoring/drafting/defaults.yaml").read_text()
    own.write_text(shipped.replace("force_mn: [1 N, 15 N]", "force_mn: [1 N, 12 N]"))
    code, out, _ = console(DELIVER, *GIVEN, "--profile", str(own), "--json")
    assert code == 0
    assert json.loads(out)["draft"]["grants"][1]["limits"]["force_mn"] == ["1 N", "12 N"]
    for broken in ("conservative: {}\n", shipped + "  extra: 1\n", "cautious: 1\n"):
        own.write_text(broken)
        assert console(DELIVER, *GIVEN, "--profile", str(own), "--json")[0] == 4


def test_a_sentence_with_line_breaks_cannot_leave_its_comment(console: Console) -> None:
    code, out, _ = console(
        "quietly\ngo to station 101 within 5 min", *GIVEN, "--answer", "speed=leave it out"
    )
    assert code == 0
    assert yaml.safe_load(out)["task"].startswith("quietly\ngo")


def test_a_draft_names_what_its_risk_policy_does_not_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same name is on the card of the compiled mission, and lint finds it."""
    text = Path(SITE).read_text()
    assert "kind: medicine" in text
    site = tmp_path / "site.yaml"
    site.write_text(text.replace("kind: medicine", "kind: tote", 1))
    on, target = ("--site", str(site), "--now", NOW), tmp_path / "draft.yaml"
    assert cli.call(["mission", "draft", DELIVER, *GIVEN, *on, "--out", str(target)]) == 0
    note = "the risk policy does not list object class `tote` (`package-p1`): it weighs `otherwise`"
    assert note in capsys.readouterr().out
    assert f"# {note}" in target.read_text()
    mission = tmp_path / "m.json"
    assert cli.call(["mission", "compile", str(target), *on, "--out", str(mission)]) == 0
    assert "RISK_UNLISTED" in capsys.readouterr().out
    assert cli.call(["mission", "review", str(mission), "--site", str(site)]) == 0
    card = capsys.readouterr().out
    assert (
        "its risk policy does not list object class `tote` (`package-p1`): each weighs 60" in card
    )
