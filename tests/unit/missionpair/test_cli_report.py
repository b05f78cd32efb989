# SPDX-License-Identifier: Apache-2.0
"""`missionpair report` and `compare` on real logs: what they write, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from msgspec.structs import replace

from fixtures.campaign_records import (
    FIXED,
    HAIKU,
    PAPER,
    QWEN,
    benign,
    blocked,
    campaign,
    hijacked,
    kept,
    numbered,
    written,
)
from missionpair import cli_report
from missionpair.campaign.log import LogWriter
from missionpair.measures import measure
from missionpair.records import Campaign, NamedPart, Trial
from missionpair.report.compare import NAMED, Verdicts, verdict_of
from missionpair.report.compare import compare as compare_of

app = typer.Typer(add_completion=False)
app.command("report")(cli_report.report_command)
app.command("compare")(cli_report.compare_command)


def call(*words: object) -> int:
    """Run a command as the program does and return its exit code."""
    code: Any = app(args=[str(word) for word in words], standalone_mode=False)
    return int(code)


def told(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> Any:
    """Run a command with `--json` and return its one object."""
    assert call(*words, "--json") == code
    output = capsys.readouterr()
    assert output.err == ""
    return json.loads(output.out)


def paper_log(folder: Path, planner: NamedPart, **changes: Any) -> Path:
    """Write the paper's fixed-template campaign against a planner."""
    counts = PAPER[planner.name, "fixed"]
    trials = numbered(
        (blocked if number < count else kept)(categories=(name,), pair=f"{name}-{number}")
        for name, count in counts.items()
        for number in range(10)
    )
    made = campaign(planner=planner, attacker=FIXED, kinds=("attack",), trials=60, **changes)
    return written(folder / f"{planner.name}.jsonl", made, trials)


def log(path: Path, *trials: Trial, **changes: Any) -> Path:
    made: Campaign = campaign(planner=HAIKU, trials=len(trials), **changes)
    return written(path, made, numbered(trials))


def test_one_command_makes_the_papers_tables_from_logs_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [paper_log(tmp_path, HAIKU), paper_log(tmp_path, QWEN)]
    out = tmp_path / "out"
    options = ["--html", tmp_path / "page.html", "--csv", out, "--latex", out]
    found = told(capsys, "report", *logs, *options)
    files = {Path(name).name for name in found["files"]}
    assert {"page.html", "tab-pilot-live-llm.tex", "tab-pilot-qwen-fixed.csv", "all.tex"} <= files
    assert sorted(found["files"]) == sorted(str(path) for path in tmp_path.rglob("*.*")
                                            if path not in logs)  # fmt: skip
    row = found["tables"]["tab-pilot-live-llm"]["rows"][-1]
    assert (row["complied_k"], row["complied_n"], row["published_complied_k"]) == (11, 60, 11)
    assert "11/60 = 18.3\\%~[0.11, 0.30]" in (out / "tab-pilot-live-llm.tex").read_text()
    assert "11/60 = 18.3% [0.11, 0.30]" in (tmp_path / "page.html").read_text()


def test_people_are_shown_the_first_tables_and_what_was_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    assert call("report", paper_log(tmp_path, HAIKU), "--html", page) == 0
    shown = capsys.readouterr().out
    assert "Pooled (60 trials)     11/60 = 18.3% [0.11, 0.30]  11/11" in shown
    assert shown.endswith(f"written: {page}\n")
    assert "Cross-model summary" in shown
    assert "refusals" not in shown


def test_a_report_is_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = paper_log(tmp_path, HAIKU)
    assert told(capsys, "report", path) == told(capsys, "report", path)


def broken(path: Path, how: str) -> Path:
    """Damage a log in one way."""
    lines = path.read_bytes().splitlines(keepends=True)
    if how == "cut":
        path.write_bytes(b"".join(lines[:-1]))
    elif how == "half a line":
        path.write_bytes(b"".join(lines)[:-20])
    elif how == "edited":
        lines[3] = lines[3].replace(b'"hijacked":false', b'"hijacked":true')
        path.write_bytes(b"".join(lines))
    elif how == "foreign":
        path.write_text('{"hello": "world"}\n')
    elif how == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
    return path


@pytest.mark.parametrize("how", ["cut", "half a line", "edited", "foreign", "empty", "absent"])
@pytest.mark.parametrize("command", ["report", "compare"])
def test_a_log_that_is_not_whole_is_refused_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str, command: str
) -> None:
    sound = paper_log(tmp_path, HAIKU)
    path = broken(paper_log(tmp_path, QWEN), how)
    error = told(capsys, command, sound, path, code=4)["error"]
    assert error["code"] == "LOG_INVALID"
    assert str(path) in error["where"]
    assert call(command, sound, path) == 4
    assert capsys.readouterr().err.startswith("LOG_INVALID: ")


def test_a_log_that_contradicts_itself_is_refused_with_the_trial(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = log(tmp_path / "log", kept(), replace(kept(), hijacked=True))
    page = tmp_path / "page.html"
    error = told(capsys, "report", path, "--html", page, code=4)["error"]
    assert error["where"] == f"{path}: trial 1"
    assert "hijacked without" in error["message"]
    assert not page.exists()


def test_a_campaign_under_way_is_shown_when_asked_for_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log"
    with LogWriter(path, campaign(planner=HAIKU, trials=9)) as writer:
        writer.add(kept(0))
    assert told(capsys, "report", path, code=4)["error"]["code"] == "LOG_INVALID"
    found = told(capsys, "report", path, "--partial")
    assert found["remarks"] == ["Log 1 is not finished: 1 of 9 trials."]
    assert call("compare", path, path, "--partial") == 0


def test_a_place_that_cannot_be_written_is_the_environments_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = paper_log(tmp_path, HAIKU)
    nowhere = tmp_path / "absent" / "page.html"
    error = told(capsys, "report", path, "--html", nowhere, code=5)["error"]
    assert (error["code"], error["where"]) == ("FILE_UNAVAILABLE", str(nowhere))
    assert told(capsys, "report", path, "--csv", path, code=5)["error"]["where"] == str(path)
    absent = tmp_path / "absent.json"
    assert told(capsys, "report", path, "--mutation", absent, code=5)["error"]["where"]


def test_a_mutation_run_stands_in_the_report_and_a_broken_one_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = paper_log(tmp_path, HAIKU), tmp_path / "mutation.json"
    mutants = [{"gate": "authorization", "check": "check_object", "trials": 60, "let_through": 3}]
    run = {
        "schema": "missionpair/mutation/1",
        "suite": "live",
        "suite_version": 1,
        "suite_digest": "d",
        "mutants": mutants,
    }
    file.write_text(json.dumps(run))
    rows = told(capsys, "report", path, "--mutation", file)["tables"]["mutation"]["rows"]
    assert [(row["check"], row["let_through_k"], row["verdict"]) for row in rows] == [
        ("check_object", 3, "tested")
    ]
    file.write_text("{}")
    error = told(capsys, "report", path, "--mutation", file, code=4)["error"]
    assert error["where"] == str(file)


def test_compare_shows_what_differs_with_intervals_and_the_pairs_that_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = log(
        tmp_path / "one",
        *(hijacked(pair=f"p{n}") for n in range(4)),
        kept(pair="p4", instead="declined"),
        benign(pair="b"),
        defenses=(NamedPart("both"), NamedPart("none")),
    )
    other = log(
        tmp_path / "other",
        *(blocked(pair=f"p{n}") for n in range(4)),
        kept(pair="p4", instead="declined"),
        benign(pair="b", completed=False, by="safety"),
        rounds=1,
    )
    found = told(capsys, "compare", one, other)
    setup = {
        row["field"]: (row["first"], row["second"]) for row in found["tables"]["compare-setup"]
    }
    assert setup["rounds"] == ("3", "1")
    assert set(setup) == {"rounds", "defenses"}
    rates = {row["measure"]: row for row in found["tables"]["compare-rates"]}
    assert (rates["UASR"]["first_k"], rates["UASR"]["second_k"]) == (4, 0)
    assert rates["UASR"]["difference"] == 0.8
    assert rates["UASR"]["tells"] == "yes"
    assert rates["FRR"]["difference"] == -1.0
    assert rates["updates completed"]["difference"] is None
    assert found["tables"]["compare-tries"][0]["first"] == 1.0
    changed = {(row["pair"], row["kind"]): row for row in found["changes"]}
    assert set(changed) == {*((f"p{n}", "attack") for n in range(4)), ("b", "benign")}
    assert changed["p0", "attack"]["first"] == {"hijacked": 1}
    assert changed["p0", "attack"]["second"] == {"blocked": 1}
    assert call("compare", one, other) == 0
    assert "Pairs whose verdict changed: 5\n" in capsys.readouterr().out


def test_comparing_a_log_with_itself_finds_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = paper_log(tmp_path, HAIKU)
    found = told(capsys, "compare", path, path)
    assert found["changes"] == []
    assert found["tables"]["compare-setup"] == []
    assert {row["difference"] for row in found["tables"]["compare-rates"]} <= {0, None}


def test_campaigns_of_other_suites_are_compared_only_when_told_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = log(tmp_path / "one", kept())
    other = log(tmp_path / "other", kept(), suite_digest="another")
    error = told(capsys, "compare", one, other, code=1)["error"]
    assert (error["code"], error["where"]) == ("NOT_COMPARABLE", "suite_digest")
    assert told(capsys, "compare", one, other, "--anyway")["changes"] == []


def test_campaigns_that_share_no_defense_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = log(tmp_path / "one", kept())
    other = log(tmp_path / "other", kept(defense="none"), defenses=(NamedPart("none"),))
    assert told(capsys, "compare", one, other, "--anyway", code=1)["error"]["where"] == "defenses"


def test_more_seeds_alone_change_no_verdict_and_another_share_does() -> None:
    def seen(*trials: Trial) -> tuple[Any, Verdicts]:
        verdicts = Verdicts()
        made = campaign(trials=len(trials))
        return measure(made, verdicts.watch(numbered(trials))), verdicts

    one, first = seen(blocked(pair="p"), kept(pair="p"))
    twice, second = seen(*[blocked(pair="p"), kept(pair="p")] * 2)
    thrice, third = seen(*[blocked(pair="p")] * 2, kept(pair="p"))
    assert compare_of(one, twice, (first, second)).changes == ()
    (change,) = compare_of(one, thrice, (first, third)).changes
    assert (change.first, change.second) == (
        {"blocked": 1, "authorized": 1},
        {"blocked": 2, "authorized": 1},
    )


def test_a_table_names_the_first_changed_pairs_and_says_how_many_there_are() -> None:
    def seen(make: Any) -> tuple[Any, Verdicts]:
        verdicts = Verdicts()
        trials = numbered(make(pair=f"p{n:03}") for n in range(NAMED + 5))
        return measure(campaign(trials=len(trials)), verdicts.watch(trials)), verdicts

    (one, first), (other, second) = seen(blocked), seen(hijacked)
    found = compare_of(one, other, (first, second))
    assert len(found.changes) == NAMED + 5
    assert len(found.tables[3].rows) == NAMED
    assert found.tables[3].title == f"Pairs whose verdict changed: {NAMED + 5}, the first {NAMED}"


@pytest.mark.parametrize(
    ("trial", "verdict"),
    [
        (hijacked(), "hijacked"),
        (hijacked(hijacked=False), "unauthorized"),
        (blocked(), "blocked"),
        (kept(instead="declined"), "declined"),
        (benign(), "completed"),
        (benign(completed=False), "not completed"),
    ],
)
def test_every_trial_has_one_verdict(trial: Trial, verdict: str) -> None:
    assert verdict_of(trial) == verdict
