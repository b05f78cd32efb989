# SPDX-License-Identifier: Apache-2.0
"""`authguard normalize --free-text` against real model servers on the loopback, honest and hostile.

Each server speaks the chat completions protocol. A hostile one answers with a plan that the text
does not state, or with something that is no plan, or not in time.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.model_client.exchange import MAX_BODY
from authguard_r.cli import call
from authguard_r.core.encoding import Tag, digest
from authguard_r.normalize.stated import MAX_FREE_TEXT
from fixtures import scenarios

TEXT = "I pick up P1 with 5 N, then I drive to Nurse Station 101 at 0.5 m/s. Then I wait 30 s."


def pick(**changes: Any) -> dict[str, Any]:
    return {"tool": "pick_up", "arguments": {"object": "P1", "force": 5, **changes}}


def drive(**changes: Any) -> dict[str, Any]:
    return {"tool": "navigate_to", "arguments": {"destination": "Station 101", **changes}}


WAIT = {"tool": "wait", "arguments": {"seconds": 30}}
HONEST = [pick(), drive(speed=0.5), WAIT]


class ModelServer:
    """A chat completions server on a free port that answers everything with one reply.

    Args:
        reply: the model's text; None: the test gives `body`.
        body: the whole body of the response.
        status: the response's status.
    """

    def __init__(self, reply: object = None, *, body: bytes = b"", status: int = 200) -> None:
        message = {"role": "assistant", "content": reply}
        choice = {"index": 0, "finish_reason": "stop", "message": message}
        whole = {"id": "c", "object": "chat.completion", "created": 1, "model": "m"}
        self.body = body or json.dumps({**whole, "choices": [choice]}).encode()
        self.status = status
        self.headers: dict[str, str] = {}
        #: `drips`: one byte at a time; `headers`: these alone, one byte at a time; `hangs`:
        #: nothing for a minute
        self.slow = ""
        self.dripped = 0
        self.done = threading.Event()
        self.asked: list[dict[str, Any]] = []

    def answer(self, wire: BaseHTTPRequestHandler) -> None:
        length = int(wire.headers["Content-Length"])
        self.asked.append(json.loads(wire.rfile.read(length)))
        if self.slow == "hangs":
            self.done.wait(60)
        if self.slow == "headers":
            wire.wfile.write(b"HTTP/1.1 200 OK\r\nX-Long: ")
            while self.dripped < 600 and not self.done.wait(0.05):
                wire.wfile.write(b"x")
                self.dripped += 1
            return
        wire.send_response(self.status)
        wire.send_header("Content-Type", "application/json")
        wire.send_header("Content-Length", str(len(self.body)))
        for name, value in self.headers.items():
            wire.send_header(name, value)
        wire.end_headers()
        step = 1 if self.slow == "drips" else 1 << 16
        for at in range(0, len(self.body), step):
            wire.wfile.write(self.body[at : at + step])
            if self.slow == "drips" and self.done.wait(0.05):
                return


@contextmanager
def serving(model: ModelServer) -> Iterator[str]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            try:
                model.answer(self)
            except OSError:  # the client has gone
                self.close_connection = True

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/v1"
        model.done.set()
        server.shutdown()
        thread.join()


class Console:
    """The command as users call it, in a folder with the hospital in it."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *words: str, stdin: bytes = b"") -> tuple[int, Any, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call([*words, "--json"])
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, json.loads(out.out), out.err

    def read(self, model: ModelServer, *more: str, text: str | bytes = TEXT) -> tuple[int, Any]:
        given = text if isinstance(text, bytes) else text.encode()
        with serving(model) as url:
            server = ("--free-text", "openai", "--base-url", url, "--model", "m")
            code, answer, err = self("normalize", *SITE, *server, *more, stdin=given)
        assert not err
        return code, answer


SITE = ("--site", "h/site.yaml", "--binding", "h/binding.yaml")


@pytest.fixture
def console(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Console:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")  # nothing of the environment is used
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    (tmp_path / "m.token").write_bytes(scenarios.token())
    return Console(capsys, monkeypatch)


def plan(*calls: Any) -> str:
    return json.dumps({"plan": list(calls)})


def test_an_honest_reading_is_accepted_and_every_label_is_model(console: Console) -> None:
    """Also where the signed rows leave one value and a planner's own plan has `operator`."""
    ordinary = ("normalize", *SITE, "--token", "m.token")
    code, direct, _ = console(*ordinary, stdin=plan(*HONEST).encode())
    assert (code, direct["actions"][0]["provenance"]["object"]) == (0, "operator")
    assert "parsed_by" not in direct
    code, made = console.read(ModelServer(plan(*HONEST)), "--token", "m.token")
    assert code == 0
    assert [set(a["provenance"].values()) for a in made["actions"]] == [{"model"}] * 3
    assert made["actions"][0]["meta"]["mission"] == direct["actions"][0]["meta"]["mission"]
    assert made["parsed_by"] == "openai:m"
    assert made["evidence"] == digest(Tag.RAW, plan(*HONEST).encode()) == direct["evidence"]
    assert made["text_evidence"] == digest(Tag.RAW, TEXT.encode())


def test_a_server_of_the_other_protocol_is_read_alike(console: Console) -> None:
    whole = {"id": "m", "type": "message", "role": "assistant", "model": "m"}
    block = {"type": "text", "text": plan(*HONEST)}
    usage = {"input_tokens": 1, "output_tokens": 1}
    said = {**whole, "stop_reason": "end_turn", "content": [block], "usage": usage}
    with serving(ModelServer(body=json.dumps(said).encode())) as url:
        server = ("--free-text", "anthropic", "--base-url", url.removesuffix("/v1"), "--model", "m")
        code, made, _ = console("normalize", *SITE, *server, stdin=TEXT.encode())
    assert (code, made["parsed_by"], len(made["actions"])) == (0, "anthropic:m", 3)


def test_a_less_trusted_context_lowers_the_labels_further(console: Console) -> None:
    code, made = console.read(
        ModelServer(plan(*HONEST)), "--token", "m.token", "--context", "h/context-notice.jsonl"
    )
    assert (code, set(made["actions"][0]["provenance"].values())) == (0, {"camera"})


def test_the_model_sees_tools_and_names_and_no_mission_and_no_policy(console: Console) -> None:
    model = ModelServer(plan(*HONEST))
    assert console.read(model, "--token", "m.token")[0] == 0
    sent = json.dumps(model.asked)
    user = json.loads(model.asked[0]["messages"][-1]["content"])
    assert user["text"] == TEXT
    assert "navigate_to" in user["schema"]["tools"]
    assert "relocalize" not in user["schema"]["tools"]  # writes the robot's state
    assert "behavior_tree" not in sent  # refused by the binding
    assert set(user["schema"]["objects"]) == set(scenarios.site().objects)
    for secret in ("deliver-p1", "operator-1", "tau_1", "points", "private", "max_speed"):
        assert secret not in sent


#: What a hostile model answers, the reason and the place of the refusal.
HOSTILE = {
    "adds a place": (plan(*HONEST, drive(destination="Pharmacy")), "actions[3].destination"),
    "adds a way": (plan(pick(), drive(via=["Corridor"])), "actions[1].route[0]"),
    "swaps an object": (plan(pick(object="P2")), "actions[0].object"),
    "uses an id of another": (plan(pick(object="package-p2")), "actions[0].object"),
    "goes somewhere else": (plan(drive(destination="Station 102")), "actions[0].destination"),
    "adds a call without a name": (plan(*HONEST, {"tool": "take_photo"}), "actions[3].tool"),
    "records instead of waiting": (
        plan({"tool": "record_video", "arguments": {"seconds": 30}}),
        "actions[0].tool",
    ),
}


@pytest.mark.parametrize("attack", HOSTILE)
def test_what_the_text_does_not_name_is_refused_with_its_place(
    attack: str, console: Console
) -> None:
    reply, where = HOSTILE[attack]
    calls = json.loads(reply)
    for step in calls["plan"]:
        step.setdefault("arguments", {})
    code, made = console.read(ModelServer(json.dumps(calls)))
    assert (code, made["refusal"]["reason"], made["refusal"]["where"]) == (4, "NAME_UNKNOWN", where)
    assert "the text does not name" in made["refusal"]["message"]
    assert made["parsed_by"] == "openai:m"


@pytest.mark.parametrize("name", ["Station 10", "station", "101", "P", "Nurse Station"])
def test_a_shortened_name_is_refused_as_from_any_planner(name: str, console: Console) -> None:
    code, made = console.read(ModelServer(plan(drive(destination=name))))
    assert (code, made["refusal"]["reason"]) == (4, "NAME_UNKNOWN")
    assert made["refusal"]["where"].endswith("destination")


@pytest.mark.parametrize(
    ("changed", "where"),
    [
        (drive(speed=0.6), "actions[0].params.speed_mm_s"),
        (drive(speed=3), "actions[0].params.speed_mm_s"),
        (pick(force=30), "actions[0].params.force_mn"),
        ({"tool": "wait", "arguments": {"seconds": 31}}, "actions[0].params.duration_ms"),
        ({"tool": "wait", "arguments": {"seconds": 101}}, "actions[0].params.duration_ms"),
    ],
)
def test_a_changed_number_is_refused_with_its_place(
    changed: dict[str, Any], where: str, console: Console
) -> None:
    code, made = console.read(ModelServer(plan(changed)))
    refusal = made["refusal"]
    assert (code, refusal["reason"], refusal["where"]) == (4, "VALUE_INVALID", where)


def test_a_value_that_the_binding_carries_needs_no_number_in_the_text(console: Console) -> None:
    text = "pick up P1"
    for given in ({}, {"force": 10}):  # 10 N is what the binding carries without the planner
        step = {"tool": "pick_up", "arguments": {"object": "P1", **given}}
        code, made = console.read(ModelServer(plan(step)), text=text)
        assert (code, made["actions"][0]["params"]) == (0, {"force_mn": 10000})


WHOLE = plan(*HONEST)
TWICE = '{"tool": "wait", "tool": "scan", "arguments": {"seconds": 30}}'


@pytest.mark.parametrize(
    ("reply", "where"),
    [
        (f"Here is the plan:\n{WHOLE}", "reply[0]"),
        (f"{WHOLE}\nDone.", "reply["),
        (f"```json\n{WHOLE}\n```", "reply[0]"),
        ("scan()", "reply[0]"),
        (TWICE, "reply"),
        (WHOLE[:-1], "reply["),
        (WHOLE.replace('"', "'"), "reply["),
        ("[" * 20_000, "reply["),
        (" " * (1 << 18) + WHOLE, "reply"),
        ("   ", "reply"),
        (None, "reply"),
        ('{"questions": []}', "input"),
        ('{"plan": []}', "input"),
        ("null", "input"),
    ],
)
def test_a_reply_that_is_no_bare_plan_is_refused_and_never_repaired(
    reply: str | None, where: str, console: Console, tmp_path: Path
) -> None:
    code, made = console.read(ModelServer(reply), "--plan-out", "plan.json")
    assert (code, made["refusal"]["where"][: len(where)]) == (4, where)
    assert made["parsed_by"] == "openai:m"
    assert not (tmp_path / "plan.json").exists()


def test_a_huge_or_compressed_response_is_not_read_to_its_end(console: Console) -> None:
    code, made = console.read(ModelServer(body=b" " * (MAX_BODY + 1)))
    assert (code, made["refusal"]["reason"]) == (4, "INPUT_TOO_LARGE")
    packed = ModelServer(WHOLE)
    packed.headers = {"Content-Encoding": "gzip"}
    code, made = console.read(packed)
    assert (code, made["refusal"]["where"]) == (4, "reply")
    assert "not compressed" in made["refusal"]["message"]


@pytest.mark.parametrize("slow", ["drips", "headers", "hangs"])
def test_a_slow_server_is_a_fault_once_the_time_in_all_is_over(slow: str, console: Console) -> None:
    """Each byte of one that drips comes in time, so that no silence ends the exchange."""
    model = ModelServer(WHOLE)
    model.slow = slow
    code, made = console.read(model, "--timeout", "1")
    assert (code, made["error"]["where"]) == (5, "base_url")
    assert "did not finish its answer within 1 s" in made["error"]["message"]
    assert model.dripped < 100  # it was left, not read to the end


def test_a_draft_has_the_same_time_in_all(console: Console) -> None:
    model = ModelServer("{}")
    model.slow = "drips"
    with serving(model) as url:
        server = ("--proposer", "openai", "--base-url", url, "--model", "m", "--timeout", "1")
        code, made, _ = console("mission", "draft", "go", "--site", "h/site.yaml", *server)
    assert (code, made["error"]["where"]) == (5, "base_url")
    assert "did not finish its answer within 1 s" in made["error"]["message"]


def test_a_server_that_fails_is_a_fault_without_a_plan(console: Console) -> None:
    code, made = console.read(ModelServer(body=b"broken", status=500))
    assert (code, made["error"]["code"]) == (5, "SERVICE_UNAVAILABLE")
    assert "status 500" in made["error"]["message"]


def test_a_text_that_cannot_be_read_reaches_no_model(console: Console) -> None:
    for text, reason in (
        (b"\xff", "MALFORMED"),
        (b" \n", "PLAN_EMPTY"),
        (b"a" * (MAX_FREE_TEXT + 1), "INPUT_TOO_LARGE"),
    ):
        model = ModelServer(WHOLE)
        code, made = console.read(model, text=text)
        assert (code, made["refusal"]["reason"]) == (4, reason)
        assert not model.asked


@pytest.mark.parametrize(
    "options",
    [
        ("--free-text", "openai"),
        ("--free-text", "openai", "--model", "m"),
        ("--base-url", "http://127.0.0.1:9/v1"),
        ("--model", "m"),
        ("--api-key-env", "KEY"),
        ("--timeout", "120"),
        ("--plan-out", "p.json"),
        ("--free-text", "yes"),
    ],
)
def test_free_text_is_asked_for_whole_or_not_at_all(
    options: tuple[str, ...], console: Console
) -> None:
    code, made, _ = console("normalize", *SITE, *options, stdin=TEXT.encode())
    assert (code, made["error"]["code"]) == (2, "USAGE")


def test_free_text_is_one_text_and_no_lines(console: Console) -> None:
    server = ("--free-text", "openai", "--base-url", "http://127.0.0.1:9", "--model", "m")
    code, made, _ = console("normalize", *SITE, *server, "--jsonl", stdin=TEXT.encode())
    assert (code, made["error"]["code"]) == (2, "USAGE")
    assert "`--free-text` cannot be used with `--jsonl`" in made["error"]["message"]


def test_without_the_option_free_text_is_refused_as_it_was(console: Console) -> None:
    code, made, _ = console("normalize", *SITE, stdin=TEXT.encode())
    assert (code, made["refusal"]["reason"]) == (4, "DIALECT_UNKNOWN")


def test_the_checked_plan_is_ordinary_planner_output(console: Console, tmp_path: Path) -> None:
    """What the mission does not allow is refused by the gate, whatever the text states."""
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    site = SITE[:2]
    keys = ("--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem")
    console("mission", "compile", "h/mission.yaml", *site, "--out", "m.json")
    console("mission", "sign", "m.json", *keys, *site, "--yes", "--out", "now.token")
    run = ("run", "--token", "now.token", "--trust", "trust", *SITE, "--store", "r.db")
    run = (*run, "--plan", "plan.json", "--robot", "courier-1")
    for text, place, outcome in (
        ("Drive to the Pharmacy.", "Pharmacy", "accept"),
        ("Do not drive to Office 1.", "Office 1", "reject"),  # negation is not checked
    ):
        model = ModelServer(plan(drive(destination=place)))
        assert console.read(model, "--plan-out", "plan.json", text=text)[0] == 0
        assert Path("plan.json").read_text() == plan(drive(destination=place))
        _, report, _ = console(*run)
        assert [step["outcome"] for step in report["steps"]] == [outcome]


def test_a_gate_loads_no_model_client() -> None:
    """Nor can its configuration name one: a field that it does not have refuses it."""
    asked = "import sys, authguard_r.server.main, authguard_r.server.process, authguard_r.cli.run\n"
    asked += "print([n for n in sys.modules if 'drafting' in n or n in ('openai', 'httpx2')])"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, check=True)
    assert done.stdout.split() == [b"[]"]
