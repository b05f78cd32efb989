# SPDX-License-Identifier: Apache-2.0
"""`authguard init` and `authguard learn` as people call them: files, exit codes, no traceback."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import Entry
from authguard_r.cli import call
from authguard_r.core.provenance import Label
from authguard_r.provenance.context import Influence
from authguard_r.store.sqlite import read_rows
from fixtures import scenarios
from fixtures import shadow_logs as logs

TOOLS = json.dumps(
    {"tools": [{"name": "go", "inputSchema": {"properties": {"room": {"type": "string"}}}}]}
)
SITE = str(scenarios.HOSPITAL / "site.yaml")
BINDING = str(scenarios.HOSPITAL / "binding.yaml")


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch) -> None:
        self._capsys, self._patch = capsys, patch

    def __call__(self, *words: object, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call([str(word) for word in words])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out or out.err

    def json(self, *words: object, stdin: bytes = b"") -> tuple[int, Any]:
        code, out = self(*words, "--json", stdin=stdin)
        return code, json.loads(out)


@pytest.fixture
def shell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.chdir(tmp_path)
    return Shell(capsys, monkeypatch)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_tool_list_becomes_a_set_up_that_the_check_finds_whole(
    shell: Shell, tmp_path: Path
) -> None:
    (tmp_path / "tools.json").write_text(TOOLS)
    code, told = shell.json("init", "--from", "mcp", "tools.json", "--out", "d", "--robot", "arm-1")
    assert (code, told["robot"], told["tools"], told["unmapped"]) == (0, "arm-1", 1, [])
    assert told["fields"] == {"mapped": 0, "fixed": 0, "refused": 1, "noted": 0}
    assert names(tmp_path / "d") == ["binding.yaml", "interface.yaml", "site.yaml", "trust"]
    check = ["binding", "check", "d/binding.yaml", "--site", "d/site.yaml", "--strict"]
    code, report = shell.json(*check, "--interface", "d/interface.yaml")
    assert (code, report["unmapped"], report["uncompared"], report["faults"]) == (0, [], [], [])
    assert shell(*check, "--interface", "tools.json")[0] == 0
    assert shell("site", "check", "d/site.yaml")[0] == 0
    code, shown = shell.json("keys", "show", "d/trust")
    assert code == 0
    assert "arm-1" in {item["robot"] for item in shown["principals"]}
    plan = json.dumps({"tool": "go", "arguments": {"room": "home"}}).encode()
    code, out = shell.json(
        "normalize", "--site", "d/site.yaml", "--binding", "d/binding.yaml", stdin=plan
    )
    assert (code, out["refusal"]["reason"]) == (4, "STATE_WRITING_REFUSED")


def test_what_is_missing_in_the_binding_is_found_by_its_own_list(
    shell: Shell, tmp_path: Path
) -> None:
    assert (
        shell("init", "--from", "mcp", "-", "--out", "d", "--no-keys", stdin=TOOLS.encode())[0] == 0
    )
    listed = tmp_path / "d" / "interface.yaml"
    listed.write_text(listed.read_text().replace('"room"', '"room speed"'))
    code, report = shell.json(
        "binding", "check", "d/binding.yaml", "--site", "d/site.yaml", "--interface", listed
    )
    assert code == 4
    assert "speed" in report["unmapped"][0]


def test_the_next_steps_are_told_and_can_be_followed(shell: Shell) -> None:
    code, out = shell("init", "--from", "mcp", "-", "--out", "d", stdin=TOOLS.encode())
    assert code == 0
    step = next(line.split() for line in out.splitlines() if "authguard binding" in line)
    assert shell(*step[1:])[0] == 0
    assert "shadow" in out
    assert "authguard learn d/robot.db" in out
    for command in ("gate-config make", "doctor"):
        step = next(line.split() for line in out.splitlines() if f"authguard {command}" in line)
        assert shell(*step[1:])[0] == 0
    code, out = shell("init", "--from", "mcp", "-", "--out", "e", "--no-keys", stdin=TOOLS.encode())
    assert (code, "--trust" in out) == (0, False)


def test_a_folder_that_holds_something_is_left_as_it_is(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "mine").write_text("x")
    (tmp_path / "file").write_text("x")
    for out in ("d", "file"):
        code, told = shell.json("init", "--from", "mcp", "-", "--out", out, stdin=TOOLS.encode())
        assert (code, told["error"]["where"]) == (5, "--out")
    assert names(tmp_path / "d") == ["mine"]


@pytest.mark.parametrize(
    ("words", "stdin", "code"),
    [
        (["--from", "mcp"], b"", 4),
        (["--from", "mcp"], b"\xff\xfe", 4),
        (["--from", "mcp"], b"{" * 1000, 4),
        (["--from", "mcp"], b'{"tools": [{"name": "a"}]}', 4),
        (["--from", "mcp"], b'{"tools": [' + b"1," * 2**20 + b"1]}", 4),
        (["--from", "openai"], b'[{"type": "mcp"}]', 4),
        (["--from", "ros"], b"/a\n/b", 4),
        (["--from", "soap"], TOOLS.encode(), 2),
        ([], TOOLS.encode(), 2),
        (["--from", "mcp", "--robot", "Not An Id"], TOOLS.encode(), 2),
    ],
)
def test_bad_input_is_an_error_and_leaves_nothing_behind(
    shell: Shell, tmp_path: Path, words: list[str], stdin: bytes, code: int
) -> None:
    got, told = shell.json("init", "-", "--out", "d", *words, stdin=stdin)
    assert got == code
    assert told["error"]["message"]
    assert not (tmp_path / "d").exists()


def test_a_list_that_is_not_there_is_the_environments_fault(shell: Shell, tmp_path: Path) -> None:
    for name in ("none.json", str(tmp_path)):
        code, told = shell.json("init", "--from", "mcp", name, "--out", "d")
        assert (code, bool(told["error"]["where"])) == (5, True)


# learn


def shadow(path: Path, *more: Entry) -> Path:
    notice = Influence(
        field="destination",
        value="station-103",
        channel="camera",
        label=Label.CAMERA,
        evidence=logs.EVIDENCE,
    )
    return logs.write(
        path,
        [
            logs.decided(scenarios.navigate("dock", "pharmacy", speed=500)),
            logs.decided(
                scenarios.navigate("pharmacy", "station-103", speed=800),
                at="pharmacy",
                influences=(notice,),
            ),
            logs.decided(scenarios.navigate("dock", "office-1"), marks={"mode": "enforce"}),
            logs.refused(logs.call("go", room="Dock", speed_m_s=0.5)),
            logs.refused(logs.call("go", room="Attic", speed_m_s=0.5)),
            *more,
        ],
    )


def test_a_shadow_run_becomes_proposals_the_influenced_first(shell: Shell, tmp_path: Path) -> None:
    shadow(tmp_path / "run.db")
    code, out = shell("learn", "run.db", "--site", SITE, "--out", "p")
    assert code == 0
    lines = out.splitlines()
    assert lines[0].startswith("log: whole, 6 records")
    assert lines[1] == "used 4 records: 2 actions, 2 plans of 2 calls"
    assert lines[2] == "left out 1 (record 3): not marked `shadow`"
    warned = next(n for n, line in enumerate(lines) if line.startswith("WARNING"))
    assert "station-103" in lines[warned + 1]
    assert "INFLUENCED by camera" in lines[warned + 1]
    assert names(tmp_path / "p") == [f"{n}.proposed.yaml" for n in ("binding", "mission", "site")]
    assert "office-1" not in (tmp_path / "p" / "mission.proposed.yaml").read_text()
    code, told = shell.json(
        "mission", "compile", "p/mission.proposed.yaml", "--site", SITE, "--no-input"
    )
    assert code == 3
    asked = {item["field"] for item in told["clarifications"]}
    assert {"task", "issuer", "window", "on_refusal", "grants[0].chooser"} <= asked
    assert shell("binding", "check", "p/binding.proposed.yaml", "--site", SITE)[0] in {0, 4}


def test_with_a_binding_the_plans_are_read_too(shell: Shell, tmp_path: Path) -> None:
    shadow(tmp_path / "run.db", logs.refused(logs.call("navigate_to", destination="Dock")))
    code, told = shell.json("learn", "run.db", "--site", SITE, "--binding", BINDING, "--out", "p")
    assert code == 0
    assert [row["influenced"] for row in told["rows"]] == [True, False, False]
    assert {item["tool"] for item in told["tools"]} == {"go"}
    assert (told["used"], told["actions"], told["plans"]) == (5, 2, 3)


def test_an_exported_log_says_the_same_as_the_store(shell: Shell, tmp_path: Path) -> None:
    shadow(tmp_path / "run.db")
    (tmp_path / "run.jsonl").write_text(logs.exported(read_rows(tmp_path / "run.db")))
    told = [
        shell.json("learn", name, "--site", SITE, "--out", out)[1]
        for name, out in (("run.db", "a"), ("run.jsonl", "b"))
    ]
    for one in told:
        one.pop("files")
    assert told[0] == told[1]
    for name in names(tmp_path / "a"):
        assert (tmp_path / "a" / name).read_text() == (tmp_path / "b" / name).read_text()


def test_nothing_is_overwritten_and_nothing_is_signed(shell: Shell, tmp_path: Path) -> None:
    shadow(tmp_path / "run.db")
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "mission.proposed.yaml").write_text("mine")
    code, told = shell.json("learn", "run.db", "--site", SITE, "--out", "p")
    assert (code, told["error"]["where"]) == (5, "--out")
    assert names(tmp_path / "p") == ["mission.proposed.yaml"]
    (tmp_path / "p" / "mission.proposed.yaml").unlink()
    (tmp_path / "p" / "binding.proposed.yaml").symlink_to(tmp_path / "elsewhere")
    assert shell("learn", "run.db", "--site", SITE, "--out", "p")[0] == 5
    assert not (tmp_path / "elsewhere").exists()


def test_a_log_that_teaches_nothing_is_refused(shell: Shell, tmp_path: Path) -> None:
    go = scenarios.navigate("dock", "pharmacy")
    logs.write(tmp_path / "enforced.db", [logs.decided(go, marks={})])
    code, told = shell.json("learn", "enforced.db", "--site", SITE, "--out", "p")
    assert (code, "shadow" in told["error"]["message"]) == (1, True)
    shadow(tmp_path / "run.db")
    rows = list(read_rows(tmp_path / "run.db"))
    (tmp_path / "cut.jsonl").write_text(logs.exported([rows[0], *rows[2:]]))
    code, told = shell.json("learn", "cut.jsonl", "--site", SITE, "--out", "p")
    assert (code, "not whole" in told["error"]["message"]) == (1, True)
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    "text",
    [
        "rubbish",
        "{}",
        "[1]",
        '{"seq": "0", "record": "", "sealed": "", "link": ""}',
        '{"seq": 0, "record": "{}", "sealed": "{}", "link": "!"}',
        '{"seq": 0, "record": "\\ud800", "sealed": "{}", "link": ""}',
        "[" * 5000,
    ],
)
def test_a_file_that_is_no_log_is_named_with_its_line(
    shell: Shell, tmp_path: Path, text: str
) -> None:
    (tmp_path / "log").write_text(text)
    code, told = shell.json("learn", "log", "--site", SITE, "--out", "p")
    assert code == 4
    assert "log:1" in told["error"]["where"]


def test_a_log_that_is_missing_empty_or_in_use_says_so(shell: Shell, tmp_path: Path) -> None:
    assert shell("learn", "none.db", "--site", SITE, "--out", "p")[0] == 5
    (tmp_path / "empty").touch()
    assert shell("learn", "empty", "--site", SITE, "--out", "p")[0] == 1
    (tmp_path / "long").write_text("x" * (1 << 22))
    code, told = shell.json("learn", "long", "--site", SITE, "--out", "p")
    assert (code, told["error"]["code"]) == (4, "INPUT_TOO_LARGE")


def test_with_trust_an_unsigned_site_counts_beside_a_demo_root_only(
    shell: Shell, tmp_path: Path
) -> None:
    shadow(tmp_path / "run.db")
    trust = scenarios.trust_folder()
    assert shell("learn", "run.db", "--site", SITE, "--out", "p", "--trust", trust)[0] == 0


def test_the_first_hour_from_a_list_to_a_question(shell: Shell, tmp_path: Path) -> None:
    """Skeleton, a shadow run in which all is refused, then what was heard, as a proposal."""
    shell("init", "--from", "mcp", "-", "--out", "d", "--no-keys", stdin=TOOLS.encode())
    from authguard_r.site.source import read_site

    first = logs.genesis(read_site(tmp_path / "d" / "site.yaml"), robot="robot-1")
    logs.write(tmp_path / "r.db", [logs.refused(logs.call("go", room="Ward 3"))], first=first)
    code, told = shell.json("learn", "r.db", "--site", "d/site.yaml", "--out", "d/learned")
    assert (code, told["robot"], told["rows"]) == (0, "robot-1", [])
    assert told["tools"][0]["unknown"] == {"room": {"Ward 3": 1}}
    check = ["binding", "check", "d/learned/binding.proposed.yaml", "--site", "d/site.yaml"]
    assert shell(*check, "--interface", "d/interface.yaml", "--strict")[0] == 0


# binding check


@pytest.mark.parametrize("looks_at", ["", "succeeds: {$text: {starts_with: arrived}}"])
def test_a_check_warns_of_a_moving_tool_whose_answer_nobody_looks_into(
    shell: Shell, tmp_path: Path, looks_at: str
) -> None:
    text = f"""
schema: authguard-r/binding/1
id: test
tools:
  go:
    type: navigate
    tool: base
    attested: [source]
    fixed: {{params.speed_mm_s: 500}}
    monitored: [params.speed_mm_s]
    arguments: {{place: {{use: mapped, to: destination}}}}
    {looks_at}
"""
    (tmp_path / "binding.yaml").write_text(text)
    code, told = shell.json("binding", "check", "binding.yaml")
    assert (code, told["faults"]) == (0, [])
    assert told["assumed"] == ([] if looks_at else ["tools.go"])
    code, out = shell("binding", "check", "binding.yaml")
    warnings = [line for line in out.splitlines() if line.startswith("warning: ")]
    assert code == 0
    assert len(warnings) == len(told["assumed"])
    assert all("`succeeds` or `fails`: tools.go" in line for line in warnings)


def test_the_examples_are_copied_and_nothing_is_overwritten(shell: Shell) -> None:
    code, told = shell.json("examples", "--out", "mine")
    assert code == 0
    assert {"mine/hospital/site.yaml", "mine/hospital/binding.yaml"} <= set(told["files"])
    assert shell("site", "check", "mine/hospital/site.yaml")[0] == 0
    code, told = shell.json("examples", "--out", "mine")
    assert (code, told["error"]["where"]) == (5, "mine")
    Path("file").write_text("")
    assert shell("examples", "--out", "file")[0] == 5
