# SPDX-License-Identifier: Apache-2.0
"""The commands as users and other programs call them: exit codes, shapes, and never a traceback."""

from __future__ import annotations

import io
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from authguard_r.cli import call
from fixtures import scenarios

DECISION = {
    "outcome",
    "reasons",
    "findings",
    "influenced_by",
    "grant",
    "required_approvals",
    "mission",
    "action_digest",
    "retryable",
}
ACTION = {
    "type",
    "object",
    "source",
    "destination",
    "route",
    "params",
    "tool",
    "provenance",
    "meta",
}


class Shell:
    """One working folder with the hospital in it, and what the last command printed."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self.folder = folder
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: str, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call([str(a) for a in arguments])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out or out.err

    def json(self, *arguments: str, stdin: bytes = b"") -> tuple[int, Any]:
        code, out = self(*arguments, "--json", stdin=stdin)
        return code, json.loads(out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for name in (scenarios.OTHER,):
        for path in (tmp_path / "trust" / "keys").glob(f"*{name}*"):
            path.unlink()
    return Shell(tmp_path, capsys, monkeypatch)


@pytest.fixture
def token(shell: Shell) -> str:
    assert (
        shell("mission", "compile", "h/mission.yaml", "--site", "h/site.yaml", "--out", "m.json")[0]
        == 0
    )
    code, _ = shell(
        "mission",
        "sign",
        "m.json",
        "--key",
        "trust/keys/operator-1.key.pem",
        "--cert",
        "trust/keys/operator-1.cert.pem",
        "--site",
        "h/site.yaml",
        "--yes",
        "--out",
        "m.token",
    )
    assert code == 0
    return "m.token"


RUN = [
    "--trust",
    "trust",
    "--site",
    "h/site.yaml",
    "--binding",
    "h/binding.yaml",
    "--store",
    "r.db",
]


def test_the_demo_tells_the_story(shell: Shell) -> None:
    code, story = shell.json("demo", "--out", str(shell.folder / "demo"))
    assert code == 0
    assert story["hijack"]["authorization"]["reasons"] == ["DESTINATION_OUT_OF_SCOPE"]
    assert story["hijack"]["safety_alone"]["safe"] is True
    assert story["hijack"]["executed"] is False
    assert story["hijack"]["authorization"]["influenced_by"][0]["channel"] == "camera"
    assert [step["outcome"] for step in story["update"]["steps"]] == ["accept", "accept"]
    assert story["delivered"] is True
    assert story["audit"]["anchored"] == "signed-terminal"
    code, text = shell("demo")
    assert code == 0
    assert "Deliver all packages to Station 103" in text


def test_keys_are_made_once_and_shown(shell: Shell) -> None:
    code, made = shell.json("keys", "init", "fresh")
    assert code == 0
    wanted = {"operator-1", "supervisor-1", "gate-courier-1", "estimator-courier-1", "witness-1"}
    assert wanted <= set(made["principals"])
    assert shell.json("keys", "init", "fresh") == (
        5,
        {
            "error": {
                "code": "FILE_UNAVAILABLE",
                "message": "expected an empty folder, got `fresh`",
                "where": "fresh",
            }
        },
    )
    code, shown = shell.json("keys", "show", "fresh")
    assert code == 0
    assert shown["demo"] is True
    assert shell("keys", "init", "other", "--robot", "nobody")[0] == 2
    assert shell("keys", "init", "other", "--no-demo")[0] == 0


@pytest.mark.parametrize(
    ("algorithm", "shown"),
    [
        ("ed25519", "ed25519"),
        ("ml-dsa-44", "ml-dsa-44"),
        ("ml-dsa-65", "ml-dsa-65"),
        ("ml-dsa-87", "ml-dsa-87"),
        ("hybrid", "ed25519+ml-dsa-65"),
    ],
)
def test_keys_of_every_algorithm_are_made_shown_and_found_in_order(
    shell: Shell, algorithm: str, shown: str
) -> None:
    code, made = shell.json("keys", "init", "fresh", "--algorithm", algorithm)
    assert (code, made["algorithm"]) == (0, algorithm)
    code, told = shell.json("keys", "show", "fresh")
    assert code == 0
    people = {item["principal"]: item for item in told["principals"]}
    assert {item["algorithm"] for item in people.values()} == {shown}
    assert people["operator-1"]["scope"] == {"robots": None, "regions": None}
    assert people["gate-courier-1"]["scope"] == {"robots": ["courier-1"], "regions": []}
    assert people["witness-1"]["scope"] == {"robots": [], "regions": []}
    assert all(len(item["serials"]) == shown.count("+") + 1 for item in people.values())
    text = shell("keys", "show", "fresh")[1]
    assert f"{shown}, every robot, every region" in text
    assert f"{shown}, courier-1, no region" in text
    code, advice = shell.json("doctor", "--trust", "fresh")
    assert (code, [item["level"] for item in advice["advice"]].count("unsafe")) == (0, 0)


def test_an_algorithm_that_is_none_makes_no_folder(shell: Shell) -> None:
    for word in ("rsa", "ED25519", "", "ml-dsa-65,ed25519"):
        assert shell("keys", "init", "fresh", "--algorithm", word)[0] == 2
        assert not Path("fresh").exists()


def test_half_a_hybrid_certificate_is_found_by_the_doctor(shell: Shell) -> None:
    assert shell("keys", "init", "fresh", "--algorithm", "hybrid")[0] == 0
    path = Path("fresh/keys/gate-courier-1.cert.pem")
    end = b"-----END CERTIFICATE-----\n"
    halves = path.read_bytes().split(end)
    path.write_bytes(end.join(halves[:2]) + end)
    code, told = shell.json("doctor", "--trust", "fresh")
    messages = {item["message"] for item in told["advice"] if item["level"] == "unsafe"}
    assert (code, messages) == (5, {"expected a chain to each of 2 roots, got 1"})
    path.write_bytes(end.join(halves[:3]) + end)
    code, told = shell.json("doctor", "--trust", "fresh")
    messages = {item["message"] for item in told["advice"] if item["level"] == "unsafe"}
    assert code == 5
    assert any("each certificate with its authority's" in message for message in messages)


def test_a_site_is_checked_and_shown(shell: Shell) -> None:
    code, checked = shell.json("site", "check", "h/site.yaml")
    assert (code, checked["faults"]) == (0, [])
    assert shell("site", "show", "h/site.yaml")[0] == 0
    text = Path("h/site.yaml").read_text().replace("home: pharmacy", "home: nowhere")
    Path("bad.yaml").write_text(text)
    code, checked = shell.json("site", "check", "bad.yaml")
    assert code == 4
    assert checked["faults"][0]["where"] == "objects.package-p1.home"
    assert shell("site", "show", "bad.yaml")[0] == 4
    Path("broken.yaml").write_text("a: [1")
    assert shell("site", "check", "broken.yaml")[0] == 4
    assert shell("site", "check", "missing.yaml")[0] == 5


def test_a_mission_is_compiled_reviewed_signed_and_verified(shell: Shell, token: str) -> None:
    code, verified = shell.json("mission", "verify", token, "--trust", "trust")
    assert (code, verified["issuer"], verified["in_time"]) == (0, "operator-1", True)
    late = ["mission", "verify", token, "--trust", "trust", "--now"]
    assert shell(*late, "2026-11-20T10:00:61Z")[0] == 4
    code, card = shell.json("mission", "review", "m.json", "--site", "h/site.yaml")
    assert code == 0
    assert any("does NOT grant" in line for line in card["card"])
    assert shell("mission", "show", token)[0] == 0
    assert Path("m.confirmation.json").exists()
    code, _ = shell(
        "mission",
        "compile",
        "h/mission-v2.yaml",
        "--site",
        "h/site.yaml",
        "--supersedes",
        token,
        "--out",
        "m2.json",
    )
    assert code == 0
    code, diff = shell.json("mission", "diff", token, "m2.json", "--site", "h/site.yaml")
    assert any(line.startswith("ADDS") for line in diff["changes"])
    code, text = shell("mission", "review", "m2.json", "--site", "h/site.yaml", "--against", token)
    assert code == 0
    assert text.startswith("Against the version before")


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("issuer: operator-1\n", "", "issuer"),
        ("robot: courier-1\n", "", "robot"),
        ("window: {for: 25 min}\n", "", "window"),
        (
            "window: {for: 25 min}",
            "window: {not_before: 2026-01-01T00:00:00Z, expiry: '14:30'}",
            "window.expiry",
        ),
        ("place_max_age: 1 s", 'place_max_age: "1"', "place_max_age"),
        ("    chooser: operator\n", "", "grants[1].chooser"),
        ("on_refusal: hold\n", "", "on_refusal"),
        ("  prompts: 5\n", "", "budgets.prompts"),
        ("    limits: {force_mn: [1 N, 20 N]}\n", "", "grants[1].limits.force_mn"),
        ("    tool: gripper\n", "", "grants[1].tool"),
        ("object: package-p1, source: pharmacy,", "source: pharmacy,", "grants[1].rows[0].object"),
    ],
)
def test_what_a_draft_leaves_open_is_asked(shell: Shell, old: str, new: str, field: str) -> None:
    text = Path("h/mission.yaml").read_text()
    assert old in text
    Path("d.yaml").write_text(text.replace(old, new, 1))
    code, asked = shell.json("mission", "compile", "d.yaml", "--site", "h/site.yaml")
    assert code == 3
    assert asked["error"]["where"] == field


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("robot: courier-1", "robot: nobody"),
        ("type: pick", "type: fly"),
        (
            "{source: dock, destination: pharmacy, regions: [dock, pharmacy, public-corridor]}",
            "{source: dock, destination: moon, regions: [dock, moon]}",
        ),
        ("[0.05 m/s, 0.8 m/s]", "[0.05 m/s, 0.8 kg]"),
        ("[0.05 m/s, 0.8 m/s]", "[0.05 m/s, 0.80001 m/s]"),
        ("[0.05 m/s, 0.8 m/s]", "[0.8 m/s, 0.05 m/s]"),
        ("speed_mm_s: [0.05", "weight_g: [0.05"),
        ("ge: 200", "ge: 200, le: 300"),
        ("repeat: 1", "repeat: 0"),
        ("window: {for: 25 min}", "window: {until: 25 min}"),
        ("mission: deliver-p1", "mission: Deliver P1"),
        ("regions: [dock, pharmacy, public-corridor]", "regions: [pharmacy]"),
        ("task: Carry", "extra: 1\ntask: Carry"),
    ],
)
def test_a_draft_with_a_fault_is_refused_with_its_place(shell: Shell, old: str, new: str) -> None:
    text = Path("h/mission.yaml").read_text()
    assert old in text
    Path("d.yaml").write_text(text.replace(old, new, 1))
    code, refused = shell.json("mission", "compile", "d.yaml", "--site", "h/site.yaml")
    assert code == 4
    assert refused["error"]["where"]


def test_a_plan_is_run_refused_and_recorded(shell: Shell, token: str) -> None:
    code, ran = shell.json("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
    assert code == 0
    assert [s["execution"]["outcome"] for s in ran["steps"]] == ["succeeded", "succeeded"]
    assert ran["robot"] == {"region": "pharmacy", "holding": "package-p1"}
    code, ran = shell.json(
        "run",
        "--token",
        token,
        *RUN,
        "--plan",
        "h/replies/03-hijacked-by-notice.json",
        "--context",
        "h/context-notice.jsonl",
        "--at",
        "pharmacy",
        "--holding",
        "package-p1",
    )
    assert code == 1
    assert set(ran["steps"][0]) >= DECISION
    assert set(ran["steps"][0]["action"]) == ACTION
    assert ran["steps"][0]["reasons"] == ["DESTINATION_OUT_OF_SCOPE"]
    assert ran["steps"][0]["action"]["provenance"]["destination"] == "camera"
    assert ran["on_refusal"] == "hold"
    assert ran["alerts"]
    Path("change.yaml").write_text(json.dumps(ran["smallest_change"]))
    assert shell("mission", "compile", "change.yaml", "--site", "h/site.yaml")[0] == 0
    code, whole = shell.json("audit", "verify", "r.db")
    assert (code, whole["anchored"]) == (0, "unanchored")
    code, whole = shell.json(
        "audit", "verify", "r.db", "--checkpoint", "r.checkpoint", "--trust", "trust"
    )
    assert (code, whole["anchored"], whole["whole"]) == (0, "signed-terminal", True)
    code, shown = shell.json("audit", "show", "r.db", "--refused")
    assert [r["kind"] for r in shown["records"]] == ["decision"]
    assert shell("audit", "show", "r.db", "--kind", "decision")[0] == 0
    assert shell("audit", "verify", "r.db", "--checkpoint", "r.checkpoint")[0] == 5


@pytest.mark.parametrize(
    ("plan", "code"),
    [
        ("deliver.bare.json", 1),
        ("deliver.calls.txt", 1),
        ("07-unknown-place.json", 4),
        ("05-records-for-verification.json", 1),
    ],
)
def test_every_dialect_is_read_and_refused_alike(
    shell: Shell, token: str, plan: str, code: int
) -> None:
    got, text = shell("run", "--token", token, *RUN, "--plan", f"h/replies/{plan}")
    assert got == code
    assert "REJECT" in text


def test_a_drifting_robot_is_stopped(shell: Shell, token: str) -> None:
    code, ran = shell.json(
        "run",
        "--token",
        token,
        *RUN,
        "--plan",
        "h/replies/01-collect.json",
        "--drift-to",
        "office-1",
    )
    assert code == 1
    assert ran["steps"][0]["execution"]["outcome"] == "aborted"
    assert "aborted: OUTSIDE_REGIONS" in ran["alerts"]


def test_a_way_to_where_the_robot_is_says_so_and_proposes_no_change(
    shell: Shell, token: str
) -> None:
    words = ("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
    code, text = shell(*words, "--at", "pharmacy", "--store", "there.db")
    there = "the robot is already in `pharmacy`: the planner can leave this step out"
    assert (code, there in text, "a signed next version" in text) == (1, True, False)
    _, told = shell.json("explain", "--store", "there.db")
    assert (told["mends"], told["smallest_change"]) == ([there], None)


def test_wrong_places_and_things_on_the_command_line_are_usage(shell: Shell, token: str) -> None:
    base = ["run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json"]
    assert shell(*base, "--at", "moon")[0] == 2
    assert shell(*base, "--holding", "moon")[0] == 2
    assert shell(*base, "--now", "yesterday")[0] == 2
    assert shell(*base, "--robot", "nobody")[0] == 2
    assert shell(*base, "--context", "missing")[0] == 5


def test_orders_change_authority_on_a_store(shell: Shell, token: str) -> None:
    on = ["--trust", "trust", "--site", "h/site.yaml", "--store", "r.db"]
    code, active = shell.json("mission", "activate", token, *on, "--new")
    assert (code, active["status"]) == (0, "active")
    assert shell("mission", "activate", token, *on, "--new")[0] == 1
    assert shell.json("mission", "suspend", token, *on)[1]["status"] == "suspended"
    assert shell.json("mission", "resume", token, *on)[1]["status"] == "active"
    assert (
        shell("mission", "choose", token, *on, "--grant", "pick-p1", "--row", "0", "--yes")[0] == 0
    )
    assert (
        shell("mission", "choose", token, *on, "--grant", "pick-p1", "--row", "9", "--yes")[0] == 1
    )
    assert (
        shell("mission", "resolve", token, *on, "--ticket", "A" * 43, "--outcome", "failed")[0] == 1
    )
    supervisor = [
        "--key",
        "trust/keys/supervisor-1.key.pem",
        "--cert",
        "trust/keys/supervisor-1.cert.pem",
    ]
    assert shell("mission", "revoke", token, *on, *supervisor)[0] == 4
    assert shell("mission", "revoke", token, *on, *supervisor[2:])[0] == 2
    assert shell("mission", "revoke", token, *on, *supervisor[:2])[0] == 4  # certificate beside it
    officer = [
        "--key",
        "trust/keys/safety-officer-1.key.pem",
        "--cert",
        "trust/keys/safety-officer-1.cert.pem",
    ]
    assert shell.json("mission", "revoke", token, *on, *officer)[1]["status"] == "revoked"
    assert shell("mission", "complete", token, *on)[0] == 1
    code, text = shell("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
    assert (code, "REVOKED" in text) == (1, True)
    assert shell("stop", *on)[0] == 5  # recorded, and no gate answered


ACT = {
    "type": "navigate",
    "object": None,
    "source": "dock",
    "destination": "pharmacy",
    "route": [],
    "params": {"speed_mm_s": 800},
    "tool": "base",
    "provenance": {"destination": "operator"},
    "meta": {"planner": "me"},
}


def state() -> str:
    return json.dumps(json.loads(__import__("msgspec").json.encode(scenarios.state().snapshot)))


def test_a_what_if_decides_and_uses_nothing(shell: Shell, token: str) -> None:
    Path("a.json").write_text(json.dumps(ACT))
    Path("s.json").write_text(state())
    base = ["decide", "--token", token, "--trust", "trust", "--site", "h/site.yaml"]
    code, judged = shell.json(*base, "--state", "s.json", "--action", "a.json")
    assert (code, judged["outcome"], judged["authoritative"]) == (0, "accept", False)
    assert set(judged) >= DECISION
    assert judged["action"]["meta"]["planner"] is None
    assert shell(*base, "--action", "a.json")[0] == 1
    assert shell(*base)[0] == 2
    assert shell(*base, "--state", "s.json", "--action", "a.json", "--store", "none.db")[0] == 5
    Path("n.json").write_text('{"type": NaN}')
    assert shell(*base, "--action", "n.json")[0] == 4
    Path("bad.json").write_text('{"robot": 1}')
    assert shell(*base, "--state", "bad.json", "--action", "a.json")[0] == 4


def test_a_stream_of_what_ifs_answers_line_by_line(shell: Shell, token: str) -> None:
    Path("s.json").write_text(state())
    lines = [
        {"id": 1, "action": ACT},
        {"id": 2, "action": {**ACT, "destination": "office-1"}},
        {"id": "x", "action": {"type": "navigate"}},
        {"id": 4, "action": ACT, "now": "2020-01-01T00:00:00Z"},
        {"id": 5, "action": ACT, "now": "never"},
        {"id": 6, "action": ACT, "state": {}},
        {"id": 7},
    ]
    stdin = "\n".join([*map(json.dumps, lines), "not json", ""]).encode() + b"\xff\n"
    code, out = shell(
        "decide",
        "--token",
        token,
        "--trust",
        "trust",
        "--site",
        "h/site.yaml",
        "--state",
        "s.json",
        "--jsonl",
        stdin=stdin,
    )
    answers = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert [a["id"] for a in answers] == [1, 2, "x", 4, 5, 6, 7, None, None]
    assert [a.get("outcome") for a in answers[:4]] == ["accept", "reject", None, "reject"]
    assert all("error" in a for a in (answers[2], *answers[4:]))


def test_planner_text_is_normalized_or_refused_with_its_place(shell: Shell, token: str) -> None:
    base = ["normalize", "--site", "h/site.yaml", "--binding", "h/binding.yaml"]
    text = Path("h/replies/03-hijacked-by-notice.json").read_bytes()
    code, read = shell.json(
        *base,
        "--token",
        token,
        "--trust",
        "trust",
        "--context",
        "h/context-notice.jsonl",
        stdin=text,
    )
    assert code == 0
    assert set(read["actions"][0]) == ACTION
    fields = ("type", "tool", "destination", "params")
    assert read["actions"][0]["provenance"] == dict.fromkeys(fields, "camera")
    assert read["actions"][1]["provenance"]["object"] == "operator"
    assert shell.json(*base, "--token", token, stdin=text)[0] == 0
    code, refused = shell.json(*base, stdin=b'{"tool": "fly", "arguments": {}}')
    assert (code, refused["refusal"]["reason"]) == (4, "TOOL_UNKNOWN")
    lines = b'{"id": 1, "raw": "scan()"}\n{"id": 2, "raw": "x"}\n[]\n{"id": 3}\nnope\n\n'
    code, out = shell(*base, "--jsonl", stdin=lines)
    answers = [json.loads(line) for line in out.splitlines()]
    assert [a["id"] for a in answers] == [1, 2, None, 3, None]
    assert "actions" in answers[0]
    assert "refusal" in answers[1]
    Path("c.jsonl").write_text('{"channel": "dream", "text": "x"}\n')
    assert shell(*base, "--context", "c.jsonl", stdin=text)[0] == 4
    Path("c.jsonl").write_text('{"channel": "camera"}\n')
    assert shell(*base, "--context", "c.jsonl", stdin=text)[0] == 4


def test_the_doctor_names_what_is_unsafe(shell: Shell, token: str) -> None:
    shell("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
    code, advice = shell.json("doctor", "--trust", "trust", "--store", "r.db")
    assert (code, advice["safe"]) == (0, True)
    assert {a["part"] for a in advice["advice"]} >= {"sqlite", "trust", "store", "anchor"}
    Path("trust/keys/operator-1.key.pem").chmod(0o644)
    code, advice = shell.json("doctor", "--trust", "trust")
    assert (code, advice["safe"]) == (5, False)
    assert shell("doctor", "--trust", "missing")[0] == 5
    assert shell("doctor", "--store", "missing/x.db")[0] == 5
    assert shell("doctor", "--store", "new.db")[0] == 0
    Path("junk.db").write_text("junk")
    assert shell("doctor", "--store", "junk.db")[0] == 5
    assert shell("doctor")[0] == 0


def test_a_tampered_log_is_1_and_an_unreadable_one_4(shell: Shell, token: str) -> None:
    import apsw

    shell("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
    connection = apsw.Connection("r.db")
    connection.execute("DROP TRIGGER audit_only_forgets")
    connection.execute(
        "UPDATE audit SET record = CAST(replace(CAST(record AS TEXT), 'accept', 'reject') AS BLOB)"
        " WHERE seq = 3"
    )
    connection.close()
    code, found = shell.json("audit", "verify", "r.db")
    assert (code, found["whole"], found["where"]) == (1, False, "record 3")
    Path("junk.db").write_text("junk")
    assert shell.json("audit", "verify", "junk.db")[0] == 4
    assert shell.json("audit", "verify", "none.db")[0] == 4


def test_wrong_usage_is_2_with_an_error_object(shell: Shell) -> None:
    assert shell("frobnicate")[0] == 2
    code, error = shell.json("decide")
    assert (code, error["error"]["code"]) == (2, "USAGE")
    assert shell("--help")[0] == 0


def test_signing_asks_and_no_is_no(shell: Shell, token: str) -> None:
    base = [
        "mission",
        "sign",
        "m.json",
        "--key",
        "trust/keys/operator-1.key.pem",
        "--cert",
        "trust/keys/operator-1.cert.pem",
        "--site",
        "h/site.yaml",
        "--out",
        "n.token",
    ]
    assert shell(*base, stdin=b"n\n")[0] == 2
    assert not Path("n.token").exists()
    assert shell(*base, stdin=b"y\n")[0] == 0
    confirmation = json.loads(Path("n.confirmation.json").read_text())
    assert confirmation["how"] == "script"  # a yes that comes through a pipe is a script's


@pytest.mark.parametrize("path", ["m.token", "r.db", "trust/root.pem", "h/site.yaml"])
def test_garbage_in_the_place_of_any_file_is_an_error_not_a_traceback(
    shell: Shell, token: str, path: str
) -> None:
    for junk in (b"", b"\x00\xff" * 50, b"{}", b"[" * 5_000):
        Path(path).write_bytes(junk)
        code, _ = shell("run", "--token", token, *RUN, "--plan", "h/replies/01-collect.json")
        if path == "r.db" and junk == b"":
            assert code == 0  # an empty file is a new store
            Path(path).unlink()
            continue
        assert code in {4, 5}
