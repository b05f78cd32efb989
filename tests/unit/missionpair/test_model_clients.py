# SPDX-License-Identifier: Apache-2.0
"""Models behind servers of two protocols, over real connections: every fault, every cap."""

from __future__ import annotations

import gc
import json
import logging
import pickle
import resource
import socket
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from missionpair.briefing import OfferedTool, PlannerError
from missionpair.planners._client import Completion, make_client
from missionpair.planners._meter import Meter
from missionpair.planners._protocol import AnthropicClient, OpenAIClient
from missionpair.planners._reach import ModelEndpoint, Price
from missionpair.registry import UnknownNameError
from missionpair.servers import SERVERS, StandInServer

KEY = "sk-test-not-a-secret-0123"
KINDS = sorted(SERVERS)
CLIENTS: dict[str, Any] = {"openai": OpenAIClient, "anthropic": AnthropicClient}
GO = OfferedTool("navigate_to", "Go.", {"type": "object", "properties": {"destination": {}}})
PRICE = Price(Fraction(1), Fraction(5))


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", KEY)
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")  # nothing of the environment is used
    monkeypatch.setenv("OPENAI_ORG_ID", "org-of-somebody")
    for name in ("ANTHROPIC_CUSTOM_HEADERS", "OPENAI_CUSTOM_HEADERS"):
        monkeypatch.setenv(name, "x-told: everybody\nauthorization: Bearer another\nhost: other")


def client(kind: str, server: StandInServer, meter: Meter | None = None, **changes: Any) -> Any:
    fields: dict[str, Any] = {
        "protocol": kind,
        "base_url": server.base_url,
        "own": True,
        "model": "scripted-any",
        "timeout_s": 10.0,
        "retries": 2,
        "backoff_s": 0.001,
        "temperature": None,
    }
    pauses: list[float] = []
    made = CLIENTS[kind](
        ModelEndpoint(**{**fields, **changes}), meter or Meter(), pause=pauses.append
    )
    made.pauses = pauses
    return made


def ask(made: Any, *, tools: bool = False, seed: int = 1) -> Completion:
    said = [("user", "hello")]
    done = made.call_tools("be brief", said, (GO,) if tools else (), seed=seed, max_tokens=50)
    assert isinstance(done, Completion)
    return done


@pytest.mark.parametrize("kind", KINDS)
def test_words_come_back_with_their_counts(kind: str) -> None:
    with SERVERS[kind]("odd:nonsense") as server:
        made = client(kind, server)
        done = made.complete("be brief", [("user", "hello")], seed=1, max_tokens=50)
    assert done.text.startswith("Beep")
    assert [done.called, done.declined, done.cut] == [False] * 3
    assert done.tokens > (0, 0)
    assert done.took_us > 0
    assert (done.attempts, done.cost_microusd, done.model) == (1, 0, "scripted-odd")
    assert json.loads(done.raw)["model"] == "scripted-odd"


@pytest.mark.parametrize("kind", KINDS)
def test_an_argument_given_twice_survives_to_the_normalizer(kind: str) -> None:
    with SERVERS[kind]("odd:twice") as server:
        done = ask(client(kind, server), tools=True)
    assert done.called
    assert done.raw.count(b"Pharmacy") == done.raw.count(b"Station 103") == 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_servers_own_refusal_and_a_cut_answer_are_told(kind: str) -> None:
    with SERVERS[kind]("odd:refusal-flag") as server:
        assert ask(client(kind, server)).declined
    with SERVERS[kind]("odd:cut") as server:
        done = ask(client(kind, server))
    assert (done.cut, done.declined) == (True, False)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_of_the_environment_is_sent_but_the_key(kind: str) -> None:
    with SERVERS[kind](key=KEY) as server:
        ask(client(kind, server, key_env="TEST_MODEL_KEY"))
        (_, _, headers, _) = server.seen[0]
    assert headers["authorization"] == f"Bearer {KEY}"
    assert headers["host"] == server.base_url.split("/")[2]
    assert "x-told" not in headers
    assert not any("organization" in name or "stainless" in name for name in headers)


def test_seed_and_temperature_are_sent_where_the_protocol_has_them() -> None:
    with SERVERS["openai"]() as server:
        ask(client("openai", server, temperature=0.5), seed=(1 << 48) + 7)
        ask(client("openai", server, own=False))
        first, second = (json.loads(body) for *_, body in server.seen)
    assert (first["seed"], first["temperature"], first["max_tokens"]) == (7, 0.5, 50)
    assert "temperature" not in second
    assert second["max_completion_tokens"] == 50  # the vendor's own name for it
    with SERVERS["anthropic"]() as server:
        ask(client("anthropic", server))
        ask(client("anthropic", server, temperature=0.5))
        seen = [(headers["anthropic-version"], json.loads(b)) for _, _, headers, b in server.seen]
    assert [version for version, _ in seen] == ["2026-10-21", "2023-06-01"]
    assert ["temperature" in body for _, body in seen] == [False, True]
    assert not any("seed" in body for _, body in seen)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("fault", "code", "says"),
    [
        ("429", "limit", r"status 429.*slow down \(3 attempts\)"),
        ("500", "unreachable", r"status 500.*\(3 attempts\)"),
        ("cut", "unreachable", r"broke the connection off \(3 attempts\)"),
        ("not-json", "protocol", "expected JSON"),
        ("empty", "protocol", "expected one choice|at `content`"),
        ("schema", "protocol", "expected text|at `content"),
        ("huge", "protocol", "more than 8388608 bytes"),
        ("packed", "protocol", "compressed"),
        ("redirect", "refused", "status 307"),
        ("key", "refused", "status 401: check `model` and the key in `TEST_MODEL_KEY`"),
    ],
)
def test_a_fault_of_the_server_is_told_with_its_mend(
    kind: str, fault: str, code: str, says: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    with SERVERS[kind](f"faulty:{fault}") as server:
        with pytest.raises(PlannerError, match=says) as failed:
            ask(client(kind, server, key_env="TEST_MODEL_KEY"))
        assert server.requests == (3 if code in {"limit", "unreachable"} else 1)
        assert all(method == "POST" for method, *_ in server.seen)  # no redirect was followed
    assert failed.value.code == code
    assert KEY not in str(failed.value) + caplog.text
    assert failed.value.__cause__ is None  # a cause could hold the request


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fault", ["timeout", "drip"])
def test_a_server_that_never_ends_is_left_in_time(kind: str, fault: str) -> None:
    with SERVERS[kind](f"faulty:{fault}") as server:
        with pytest.raises(PlannerError, match=r"did not answer within 0\.3 s") as failed:
            ask(client(kind, server, timeout_s=0.3, retries=1))
        assert server.requests == 2
    assert failed.value.code == "unreachable"


@pytest.mark.parametrize("kind", KINDS)
def test_a_reply_that_is_left_between_two_parts_is_closed_without_another_error(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the timer does not end the connection, so that the time is over when the next part comes
    monkeypatch.setattr("authguard_r.authoring.model_client.exchange._Deadline._close", bool)
    with SERVERS[kind]("faulty:drip") as server:
        with pytest.raises(PlannerError, match=r"did not answer within 0\.2 s"):
            ask(client(kind, server, timeout_s=0.2, retries=0))
        gc.collect()  # an error of a generator's end would fail this test


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fault", ["429", "500", "cut"])
def test_a_fault_that_passes_costs_attempts_and_nothing_else(kind: str, fault: str) -> None:
    with SERVERS[kind](f"faulty:{fault}x2") as server:
        made = client(kind, server)
        assert ask(made).attempts == 3
    # a busy server says how long; otherwise each wait is twice the one before
    assert made.pauses == ([1.0, 1.0] if fault == "429" else [0.001, 0.002])


def test_a_server_that_asks_for_too_long_a_wait_is_left() -> None:
    with SERVERS["openai"]("faulty:429x1") as server:
        with pytest.raises(PlannerError, match="asks to wait 1 s") as failed:
            ask(client("openai", server, patience_s=0.5))
        assert server.requests == 1
    assert failed.value.code == "limit"


@pytest.mark.parametrize("kind", KINDS)
def test_no_server_no_key_no_model_and_no_address_are_told(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]  # bound, and nobody listens
        with SERVERS[kind]() as server, pytest.raises(PlannerError, match="cannot be reached"):
            ask(client(kind, server, base_url=f"http://127.0.0.1:{port}", retries=1))
    with SERVERS[kind]() as server:
        for changes, says in (
            ({"model": ""}, "say `model=NAME`"),
            ({"base_url": "127.0.0.1:80"}, "expected an address"),
            ({"base_url": "ftp://127.0.0.1"}, "expected an address"),
            ({"base_url": "http://me:secret@127.0.0.1/v1"}, "expected an address"),
            ({"base_url": "http://127.0.0.1:eighty/v1"}, "expected an address"),
            ({"base_url": "http://[::1/v1"}, "expected an address"),
            ({"base_url": "http://models.example/v1", "key_env": "TEST_MODEL_KEY"}, "in the clear"),
            ({"key_env": "NO_SUCH_KEY"}, "`NO_SUCH_KEY` holds no key"),
        ):
            with pytest.raises(PlannerError, match=says) as failed:
                client(kind, server, **changes)
            assert "secret" not in str(failed.value)
        for local in ("http://localhost:1/v1", "http://[::1]:1/v1", "https://models.example/v1"):
            client(kind, server, base_url=local, key_env="TEST_MODEL_KEY")
        made = client(kind, server, key_env="TEST_MODEL_KEY")
        monkeypatch.setenv("TEST_MODEL_KEY", "two\nlines")
        with pytest.raises(PlannerError, match="holds no key") as failed:
            ask(made)
        assert (failed.value.code, failed.value.where) == ("refused", "key_env")
        with pytest.raises(PlannerError, match="holds no key"):
            client(kind, server, key_env="TEST_MODEL_KEY")
        assert server.requests == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_missing_package_is_told_with_its_mend(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, kind, None)
    with SERVERS[kind]() as server, pytest.raises(PlannerError, match=r"missionpair\[llm\]"):
        client(kind, server)


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_that_is_not_there_and_a_wrong_key_are_told(kind: str) -> None:
    with SERVERS[kind](key="another") as server:
        with pytest.raises(PlannerError, match="status 401") as failed:
            ask(client(kind, server, key_env="TEST_MODEL_KEY"))
        assert failed.value.code == "refused"
    with SERVERS[kind]() as server:
        with pytest.raises(PlannerError, match="no model `gpt-9` here") as failed:
            ask(client(kind, server, model="gpt-9"))
        assert failed.value.code == "refused"


def test_what_a_server_says_is_repeated_without_the_key() -> None:
    with SERVERS["openai"]() as server, pytest.raises(PlannerError, match=r"no model `\[key\]`"):
        ask(client("openai", server, model=KEY, key_env="TEST_MODEL_KEY"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_scripted_stand_in_passes_for_no_model(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SERVERS[kind]() as server:
        monkeypatch.setattr("missionpair.servers._http.SCRIPTED", "")  # it answers to any name
        with pytest.raises(PlannerError, match="`scripted-obedient` answered in place of `real`"):
            ask(client(kind, server, model="real"))


def test_a_server_of_the_other_protocol_is_no_server_of_this_one() -> None:
    with SERVERS["openai"]() as server:
        server.path = "/v1/messages"  # type: ignore[misc] # it answers there, in its own way
        base = server.base_url.removesuffix("/v1")
        with pytest.raises(PlannerError, match="expected a reply of type `message`") as failed:
            ask(client("anthropic", server, base_url=base))
    assert failed.value.code == "protocol"


def test_half_a_character_is_sent_as_a_mark() -> None:
    with SERVERS["openai"]("odd:nonsense") as server:
        client("openai", server).complete("\ud800", [("user", "\udfff")], seed=1, max_tokens=5)
        *_, body = server.seen[0]
    assert [m["content"] for m in json.loads(body)["messages"]] == ["?", "?"]


# caps


def test_money_is_counted_and_a_cap_is_never_exceeded() -> None:
    with SERVERS["openai"]("odd:nonsense") as server:
        meter = Meter(most_microusd=3_000)
        made = client("openai", server, meter, price=PRICE)
        first = ask(made)
        assert first.cost_microusd == first.tokens[0] + 5 * first.tokens[1] > 0
        assert meter.spent_microusd == first.cost_microusd
        with pytest.raises(PlannerError, match="raise `max_cost`") as failed:
            _ = [ask(made) for _ in range(1_000)]
        assert meter.spent_microusd == first.cost_microusd * server.requests <= 3_000
    assert failed.value.code == "cost"


@pytest.mark.parametrize(("fault", "billed"), [("429", False), ("500", False), ("cut", True)])
def test_an_attempt_that_may_have_been_billed_stays_counted(fault: str, *, billed: bool) -> None:
    with SERVERS["openai"](f"faulty:{fault}") as server:
        meter = Meter(most_microusd=1_000_000)
        with pytest.raises(PlannerError):
            ask(client("openai", server, meter, price=PRICE))
    assert (meter.spent_microusd > 0) == billed


def test_a_reply_without_counts_costs_the_most_that_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    with SERVERS["openai"]("odd:nonsense") as server:
        reply = server.reply

        def uncounted(headers: Any, body: bytes) -> tuple[int, bytes]:
            status, value = reply(headers, body)
            usage = {"prompt_tokens": -1, "completion_tokens": "9"}
            return status, json.dumps({**json.loads(value), "usage": usage}).encode()

        monkeypatch.setattr(server, "reply", uncounted)
        meter = Meter(most_microusd=1_000_000)
        done = ask(client("openai", server, meter, price=PRICE))
    assert done.tokens == (0, 0)
    assert meter.spent_microusd > 1_000


def test_a_rate_is_kept_for_retries_too() -> None:
    with SERVERS["openai"]("faulty:500x2") as server:
        clock = Clock()
        meter = Meter(per_minute=1, now=clock.now, sleep=clock.sleep)
        assert ask(client("openai", server, meter)).attempts == 3
    assert clock.slept == 120


class Clock:
    def __init__(self) -> None:
        self.at, self.slept = 1_000.0, 0.0

    def now(self) -> float:
        return self.at

    def sleep(self, seconds: float) -> None:
        self.at += seconds
        self.slept += seconds


def test_a_minute_never_holds_more_requests_than_the_cap() -> None:
    clock = Clock()
    meter = Meter(per_minute=3, now=clock.now, sleep=clock.sleep)
    went = []
    for _ in range(20):
        meter.take_turn()
        went.append(clock.now())
        clock.at += 1.5
    assert all(later - sooner >= 60 for sooner, later in zip(went, went[3:], strict=False))


def test_several_processes_share_a_ledger_and_a_resumed_run_goes_on_from_it(tmp_path: Path) -> None:
    ledger, clock = tmp_path / "spent", Clock()
    caps: dict[str, Any] = {"per_minute": 2, "most_microusd": 100, "ledger": ledger}
    one, two = (Meter(**caps, now=clock.now, sleep=clock.sleep) for _ in range(2))
    one.set_aside(60)
    one.take_turn()
    two.take_turn()
    with pytest.raises(PlannerError, match="raise `max_cost`"):
        two.set_aside(41)
    one.give_back(60)
    assert two.spent_microusd == 0
    assert ledger.stat().st_mode & 0o077 == 0
    assert clock.slept == 0
    two.take_turn()
    assert clock.slept == 60


@pytest.mark.parametrize(
    "held", [b"{", b'{"spent_microusd":-9}', b"[]", b'{"spent_microusd":1,"more":2}', b"\xff"]
)
def test_a_broken_ledger_is_told_and_nothing_is_spent(tmp_path: Path, held: bytes) -> None:
    (tmp_path / "spent").write_bytes(held)
    with SERVERS["openai"]() as server:
        meter = Meter(most_microusd=1_000_000, ledger=tmp_path / "spent")
        with pytest.raises(PlannerError, match="holds something else"):
            ask(client("openai", server, meter, price=PRICE))
        assert server.requests == 0
    assert (tmp_path / "spent").read_bytes() == held
    with pytest.raises(PlannerError, match="Is a directory"):
        Meter(per_minute=1, ledger=tmp_path).take_turn()


def test_a_ledger_that_cannot_grow_spends_nothing(tmp_path: Path) -> None:
    meter = Meter(most_microusd=100, ledger=tmp_path / "spent")
    meter.set_aside(1)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, before[1]))
    try:
        with pytest.raises(PlannerError, match="File too large"):
            Meter(most_microusd=100, ledger=tmp_path / "another").set_aside(1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert meter.spent_microusd == 1


def test_a_fork_does_not_have_the_whole_cap_again(monkeypatch: pytest.MonkeyPatch) -> None:
    meter, free = Meter(per_minute=5), Meter()
    monkeypatch.setattr("os.getpid", lambda: -1)
    with pytest.raises(PlannerError, match="`ledger=FILE`"):
        meter.take_turn()
    free.take_turn()
    free.set_aside(5)


def test_money_set_aside_comes_back_when_somebody_interrupts_the_wait() -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    meter = Meter(most_microusd=1_000_000, per_minute=1, sleep=interrupt)
    with SERVERS["openai"]() as server:
        made = client("openai", server, meter, price=PRICE)
        spent = ask(made).cost_microusd
        with pytest.raises(KeyboardInterrupt):
            ask(made)
    assert meter.spent_microusd == spent > 0


def test_an_error_comes_back_whole_from_another_process() -> None:
    error = PlannerError("what, and the mend", code="cost", where="max_cost")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.message, again.code, again.where) == (
        "what, and the mend",
        "what, and the mend",
        "cost",
        "max_cost",
    )


# by name


def test_a_client_is_made_from_a_planners_specification(monkeypatch: pytest.MonkeyPatch) -> None:
    with SERVERS["openai"]("odd:nonsense") as server:
        made = make_client(f"openai:model=scripted-x;base_url={server.base_url}")
        assert made.complete("s", [("user", "u")], seed=1, max_tokens=9).text.startswith("Beep")
    assert (made.name, made.simulated) == ("openai:scripted-x", True)
    assert make_client("qwen").parameters["model"] == "qwen2.5:7b"
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)
    assert make_client("haiku").parameters["model"].startswith("claude-haiku-4-5")
    with pytest.raises(UnknownNameError, match="no planner is called `gpt`"):
        make_client("gpt")
    with pytest.raises(UnknownNameError, match="takes no option `modle`"):
        make_client("openai:modle=x")
