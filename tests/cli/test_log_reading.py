# SPDX-License-Identifier: Apache-2.0
"""`audit show` and `audit explain`: a log for people, from a file that nobody has to trust."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import Entry, append, read_record
from authguard_r.cli import call
from authguard_r.cli.listing import Listing, listing
from authguard_r.cli.log_show import _WAITING, Timeline
from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.store.sqlite import open_store, read_rows
from fixtures import scenarios, shadow_logs, templates
from missionpair.bench import approve, make_bench, propose
from missionpair.suite import restricted

#: The records of the demo's story, by what they are.
ACTIVATED, WENT, ARRIVED, HIJACKED, UPDATED, LAST = 2, 3, 4, 7, 9, 16
#: By the operator: two versions, each issued and activated.
ORDERED = [ACTIVATED - 1, ACTIVATED, UPDATED - 1, UPDATED]


class Log:
    """A store, and what commands say of it."""

    def __init__(self, path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.path = path
        self._capsys = capsys

    def __call__(self, command: str, *words: object) -> tuple[int, str]:
        self._capsys.readouterr()
        code = call(["audit", command, str(self.path), *map(str, words)])
        said = self._capsys.readouterr()
        return code, said.out + said.err

    def json(self, command: str, *words: object) -> tuple[int, Any]:
        code, text = self(command, *words, "--json")
        return code, json.loads(text)

    def shown(self, *words: object) -> list[int]:
        code, told = self.json("show", *words)
        assert code == 0
        assert list(told) == ["records"]
        return [record["seq"] for record in told["records"]]


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("story")
    assert call(["demo", "--out", str(folder / "s")]) == 0
    return folder / "s"


@pytest.fixture
def log(story: Path, capsys: pytest.CaptureFixture[str]) -> Log:
    return Log(story / "robot.db", capsys)


@pytest.fixture
def asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Log:
    """A log with a question, two people's answers, and what they allowed."""
    bench = make_bench(tmp_path / "trust")
    scene = restricted(bench)
    scene.sim = bench.simulation(store=tmp_path / "robot.db")
    scene.sim.gate.management.activate(bench.sign(scene.mission))
    propose(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    propose(scene)
    scene.sim.gate.close()
    return Log(tmp_path / "robot.db", capsys)


def find(log: Log, kind: str, decision: str) -> int:
    _, told = log.json("show", "--kind", kind)
    return next(r["seq"] for r in told["records"] if r["link"]["decision"] == decision)


# show


def test_a_timeline_says_who_what_from_where_to_where_and_how_it_ended(log: Log) -> None:
    code, text = log("show")
    lines = text.splitlines()
    assert code == 0
    assert len(lines) == LAST + 1
    assert re.search(
        r" accept +deliver-p1 +planner +navigate dock -> pharmacy speed_mm_s=800 -> succeeded$",
        lines[WENT],
    )
    assert re.search(r" pick package-p1 at pharmacy force_mn=12000 -> succeeded$", lines[WENT + 2])
    assert re.search(rf" succeeded +deliver-p1 .*pharmacy.* \(record {WENT}\)$", lines[ARRIVED])
    assert lines[HIJACKED].endswith("-> station-103 speed_mm_s=800: DESTINATION_OUT_OF_SCOPE")
    assert "operator-1           version 2, supersedes " in lines[UPDATED]
    assert lines[0].endswith("robot courier-1")
    # one column for each, in every line
    assert {line.index("2026") if "2026" in line else line.index("20") for line in lines} == {6}
    assert {lines[n].index("deliver-p1") for n in range(1, LAST)} == {lines[1].index("deliver-p1")}


@pytest.fixture
def unsafe(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Log:
    """A log of one action that the mission grants and the safety gate refused, and a safe one."""
    near = msgspec.structs.replace(scenarios.world(), human_distance_mm=500)
    sim = scenarios.simulation(start=near, store=tmp_path / "robot.db")
    sim.gate.management.activate(scenarios.token())
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome is None
    scenarios.propose(sim, Action(type="scan_obstacles", tool="lidar"))
    sim.gate.close()
    return Log(tmp_path / "robot.db", capsys)


def test_an_action_that_the_safety_gate_alone_refused_is_shown_as_unsafe(unsafe: Log) -> None:
    """The authorization gate said `accept`; a reader is told what both gates say together."""
    _, told = unsafe.json("show", "--kind", "decision")
    refused, released = told["records"]
    assert (refused["link"]["decision"], released["link"]["decision"]) == ("accept", "accept")
    assert refused["open"]["safety"]["hazards"] == ["HUMAN_PROXIMITY"]
    assert (refused["verdict"], released["verdict"]) == ("unsafe", "accept")
    _, text = unsafe("show", "--kind", "decision")
    first, second = text.splitlines()
    assert " unsafe " in first
    assert first.endswith(": HUMAN_PROXIMITY")
    assert " accept " not in first
    assert " accept " in second


def test_the_refused_include_what_the_safety_gate_alone_refused(unsafe: Log) -> None:
    _, told = unsafe.json("show", "--kind", "decision")
    refused = told["records"][0]["seq"]
    assert unsafe.shown("--refused") == [refused]
    assert unsafe.shown("--code", "HUMAN_PROXIMITY") == [refused]
    code, explained = unsafe.json("explain", refused)
    assert (code, explained["verdict"]) == (0, "unsafe")


def test_verify_says_whose_log_it_is(log: Log) -> None:
    """A log that is whole may be another robot's, gate's or site's."""
    code, told = log.json("verify")
    whose = told["log"]
    assert code == 0
    assert (whose["robot"], whose["gate"]) == ("courier-1", "gate-courier-1")
    assert whose["site"] == scenarios.site().id
    code, text = log("verify")
    (line,) = [line for line in text.splitlines() if line.startswith("log of ")]
    assert code == 0
    for name in ("robot", "gate", "site", "root"):
        assert f"{name} {whose[name]}" in line


def test_the_shape_of_a_shown_log_is_what_it_was(log: Log) -> None:
    _, told = log.json("show")
    record = told["records"][WENT]
    assert set(record) == {"seq", "link", "kind", "open", "committed", "values", "verdict"}
    assert record["values"]["action"]["destination"] == "pharmacy"
    assert log.json("show", "--kind", "nothing") == (0, {"records": []})
    assert log("show", "--kind", "nothing") == (0, "no records\n")


def test_each_filter_leaves_what_it_says_and_all_of_them_together(log: Log) -> None:
    assert log.shown("--kind", "management") == ORDERED
    assert log.shown("--refused") == [HIJACKED, LAST]
    assert log.shown("--code", "REPEAT_EXHAUSTED") == [LAST]
    assert log.shown("--mission", "deliver-p1") == list(range(1, LAST + 1))
    assert log.shown("--mission", "another") == []
    assert log.shown("--client", "operator-1") == ORDERED
    assert log.shown("--client", "planner", "--refused") == [HIJACKED, LAST]
    assert log.shown("--first", WENT, "--last", ARRIVED) == [WENT, ARRIVED]
    assert log.shown("--first", LAST + 1) == []
    assert log.shown("--refused", "--kind", "outcome") == []
    assert log.shown("--would-refuse") == []  # nothing of it was in shadow mode


def test_times_are_bounds_that_belong_to_what_they_bound(log: Log) -> None:
    _, told = log.json("show")
    times = [record["link"]["time_ms"] for record in told["records"]]
    at = f"{scenarios._BEGIN:%Y-%m-%d}T14:05:00Z"
    early = [seq for seq, ms in enumerate(times) if ms == scenarios.START_MS]
    assert log.shown("--until", at) == early
    assert log.shown("--since", at) == list(range(LAST + 1))
    assert log.shown("--since", at.replace("14:05:00", "14:05:01")) == list(
        range(ARRIVED, LAST + 1)
    )


def test_a_code_or_a_time_that_is_none_is_wrong_usage(log: Log) -> None:
    for words in (("--code", "NO_SUCH_CODE"), ("--since", "today"), ("--first", "-1")):
        assert log("show", *words)[0] == 2


def test_a_client_is_named_with_or_without_the_number_of_its_user(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = Entry(kind="refusal", time_ms=1, decision="reject", open={"client": "7.arm"})
    log = Log(shadow_logs.write(tmp_path / "x.db", [entry]), capsys)
    assert [log.shown("--client", name) for name in ("7.arm", "arm", "7")] == [[1], [1], []]


def test_answers_are_shown_with_what_they_answer(asked: Log) -> None:
    _, text = asked("show", "--client", "supervisor-1")
    assert re.search(r"management answer .* supervisor-1 +approve request 1$", text.strip())
    _, text = asked("show", "--code", "APPROVAL_REQUIRED")
    assert "request_approval" in text


def test_what_ends_too_late_or_never_is_printed_all_the_same(tmp_path: Path) -> None:
    def entry(kind: str, ticket: str, decision: str) -> Entry:
        return Entry(kind=kind, time_ms=1, decision=decision, open={"ticket": ticket})

    many = [entry("decision", f"t{n}", "accept") for n in range(_WAITING + 5)]
    rows = shadow_logs.in_memory(*many, entry("outcome", "t0", "failed"))
    lines: list[str] = []
    timeline = Timeline(lambda _, line: lines.append(line))
    for row in rows:
        timeline.see(row, read_record(row.record, where=""), {}, wanted=True)
    assert 0 < len(lines) < len(rows)
    timeline.close()
    assert len(lines) == len(rows)
    assert not lines[1].endswith("failed")  # its line was printed before it ended
    assert "(record 1)" in lines[-1]


def test_an_error_in_the_middle_of_a_list_is_still_one_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = open_store(tmp_path / "x.db")
    entry = Entry(kind="alert", time_ms=1, decision="alert", open={"what": "x"})
    store.run(lambda turn: append(turn, entry, salts=b""))
    store.run(lambda turn: turn.append(b"no record", b"{}", bytes(32)))
    store.close()
    log = Log(tmp_path / "x.db", capsys)
    code, told = log.json("show")
    assert (code, len(told["records"]), told["error"]["where"]) == (4, 1, "record 1")
    code, text = log("show")
    assert code == 4
    assert text.splitlines()[0].endswith(" x")
    assert log.json("show", "--first", 1)[1]["error"]["code"]


def test_progress_is_for_people_at_a_terminal_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = Listing("x", as_json=False)
    out.tick(1_000)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    out.tick(999)
    out.tick(1_000)
    out.add({}, "line\x1b")
    said = capsys.readouterr()
    assert said.err == "\r1000 records\r\x1b[K"
    assert said.out == "line\\x1b\n"
    with pytest.raises(MalformedError), listing("x", as_json=True):
        raise MalformedError("before anything was said", where="x")
    assert capsys.readouterr().out == ""


def test_what_is_no_log_is_unreadable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "junk.db").write_bytes(b"SQLite format 3\x00junk")
    for name in ("junk.db", "none.db"):
        assert Log(tmp_path / name, capsys)("show")[0] == 4
        assert Log(tmp_path / name, capsys)("explain", 0)[0] == 4


# explain


def test_a_refusal_is_explained_with_what_influenced_it_and_what_would_allow_it(
    log: Log, tmp_path: Path
) -> None:
    code, told = log.json("explain", HIJACKED)
    assert (code, told["decision"], told["who"]) == (0, "reject", "planner")
    assert told["what"] == "navigate source pharmacy destination station-103 speed_mm_s=800"
    assert told["why"][0].startswith("DESTINATION_OUT_OF_SCOPE at destination")
    assert [item["channel"] for item in told["influenced_by"]] == ["camera"]
    assert told["smallest_change"]["version"] == 2
    assert f"authguard audit explain {log.path} {HIJACKED} --draft FILE" in told["text"][-1]
    draft = tmp_path / "change.yaml"
    code, text = log("explain", HIJACKED, "--draft", draft)
    assert (code, "read it, then: authguard mission compile" in text) == (0, True)
    assert draft.read_text().startswith(f"# PROPOSED: what would have allowed record {HIJACKED}")
    site = scenarios.HOSPITAL / "site.yaml"
    assert call(["mission", "compile", str(draft), "--site", str(site)]) == 0
    assert log("explain", HIJACKED, "--draft", draft)[0] == 5  # it takes nothing's place
    assert log("explain", WENT, "--draft", tmp_path / "none")[0] == 1


def test_the_command_at_a_gate_and_the_command_on_a_file_say_the_same(
    log: Log, capsys: pytest.CaptureFixture[str]
) -> None:
    _, here = log.json("explain", LAST)
    capsys.readouterr()
    assert call(["explain", str(LAST), "--store", str(log.path), "--json"]) == 0
    there = json.loads(capsys.readouterr().out)
    for name in ("what", "who", "why", "influenced_by", "mends", "kind", "time"):
        assert here[name] == there[name]
    assert call(["explain", "--store", str(log.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["seq"] == LAST


@pytest.mark.parametrize(
    ("seq", "said"),
    [
        (0, "genesis"),
        (ACTIVATED, "mission deliver-p1 version 1 (by operator-1)"),
        (WENT, "decision accept: navigate source dock destination pharmacy"),
        (ARRIVED, f"it is how record {WENT} ended"),
    ],
)
def test_every_kind_of_record_is_explained(log: Log, seq: int, said: str) -> None:
    code, text = log("explain", seq)
    assert code == 0
    assert said in text
    assert "signed next version" not in text


def test_a_question_and_its_answers_are_explained(asked: Log) -> None:
    code, told = asked.json("explain", find(asked, "decision", "request_approval"))
    assert (code, told["smallest_change"]) == (0, None)
    assert any("APPROVAL_REQUIRED" in line for line in told["why"])
    code, told = asked.json("explain", find(asked, "management", "answer"))
    assert (code, told["who"]) == (0, "supervisor-1")
    assert told["what"].startswith("approve request 1 of mission ")


def test_a_record_that_is_not_there_is_refused(log: Log) -> None:
    code, told = log.json("explain", 10**6)
    assert (code, told["error"]["code"]) == (1, "VALUE_OUT_OF_RANGE")
    assert log("explain")[0] == log("explain", "-1")[0] == 2


def test_a_mission_that_was_made_of_a_template_has_a_smallest_change_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim = templates.admitted(store=tmp_path / "robot.db")
    sim.gate.management.activate(templates.token())
    scenarios.propose(sim, scenarios.navigate("dock", "pharmacy", speed=1_200))
    sim.gate.close()
    log = Log(tmp_path / "robot.db", capsys)
    _, told = log.json("explain", find(log, "decision", "reject"))
    assert told["smallest_change"] is not None


def test_an_export_is_read_like_the_store(log: Log, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(shadow_logs.exported(read_rows(log.path)))
    _, stored = log.json("explain", HIJACKED)
    _, shown = log.json("show")
    log.path = path
    _, told = log.json("explain", HIJACKED)
    assert (told["why"], told["what"]) == (stored["why"], stored["what"])
    assert told["smallest_change"].keys() == stored["smallest_change"].keys()
    assert log.json("show")[1] == shown
    code, found = log.json("replay")
    assert (code, found["agree"]) == (0, 7)
