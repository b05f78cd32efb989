# SPDX-License-Identifier: Apache-2.0
"""A store with an outside counter, at the keyboard: what is refused, what is said, what is left."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from authguard_r.anchoring.evidence import BY_COUNTER, BY_STORE, SAID, Discrepancy
from authguard_r.audit.record import read_record
from authguard_r.cli.status_lines import status_lines
from authguard_r.client import stopping
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.wire.messages import Kind
from cli.test_gate_commands import (
    ON,
    SITE,
    STATUS,
    Shell,
    beside,
    gate_config,
    serving,
    telling,
)
from cli.test_gate_commands import shell as shell  # noqa: PLC0414 - a fixture
from cli.test_gate_commands import token as token  # noqa: PLC0414 - a fixture
from fixtures import scenarios
from fixtures.cases import case
from fixtures.scripted_peer import listening

COUNTER = ["--counter", "other/counter"]
PLAN = ["--binding", "h/binding.yaml", "--plan", "h/replies/06-wrong-package.json"]
STORE = "S" * 43


@pytest.fixture
def counted(shell: Shell, token: str) -> str:
    """A mission that is active in a store that was counted; no gate runs."""
    Path("other").mkdir()
    assert shell("mission", "activate", token, *ON, "--new", *COUNTER)[0] == 0
    assert Path("other/counter").is_file()
    return token


def log() -> list[tuple[str, str]]:
    rows = [read_record(row.record, where="") for row in read_rows(Path("r.db"))]
    return [(record.kind, record.link.decision) for record in rows]


# --- a counter that was not named


@pytest.mark.parametrize(
    "words",
    [
        ("mission", "suspend", "m.token", *ON),
        ("mission", "activate", "m.token", *ON, "--new"),
        ("mission", "choose", "m.token", *ON, "--grant", "pick", "--row", "0", "--yes"),
        ("mission", "resolve", "m.token", *ON, "--ticket", "T" * 43, "--outcome", "aborted"),
        ("stop", *ON),
        ("run", "--token", "m.token", *ON, *PLAN),
        ("advanced", "frost", "ballot", "1", "--out", "b.json", *ON),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_who_forgets_the_counter_raises_no_alarm_and_changes_nothing(
    shell: Shell, counted: str, words: tuple[str, ...]
) -> None:
    before = log(), Path("r.db").read_bytes(), Path("other/counter").read_bytes()
    code, reason, message = shell.refused(*words)
    assert (code, reason) == (5, "STORE_UNAVAILABLE")
    assert "counter_not_named" in message
    assert "start the gate, or name --counter" in message
    assert (log(), Path("r.db").read_bytes(), Path("other/counter").read_bytes()) == before


def test_with_its_counter_an_order_is_carried_out_and_counted(shell: Shell, counted: str) -> None:
    note = Path("other/counter").read_bytes()
    for verb in ("suspend", "resume"):
        assert shell("mission", verb, counted, *ON, *COUNTER)[0] == 0
    assert shell("run", "--token", counted, *ON, *PLAN, *COUNTER)[0] == 1
    assert shell("stop", *ON, *COUNTER)[0] == 5
    assert "alert" not in {kind for kind, _ in log()}
    assert Path("other/counter").read_bytes() != note


def test_a_store_that_really_was_put_back_is_still_recorded(shell: Shell, counted: str) -> None:
    old = Path("r.db").read_bytes()
    assert shell("mission", "suspend", counted, *ON, *COUNTER)[0] == 0
    Path("r.db").write_bytes(old)
    code, reason, _ = shell.refused("mission", "revoke", counted, *ON, *COUNTER)
    assert (code, reason) == (1, "ROLLED_BACK")
    assert ("alert", "alert") in log()


# --- a counter that is another file of the gate


def gate_words(config: str, *more: str) -> tuple[str, ...]:
    on = ("--demo", "--simulate", "--robot", scenarios.RID, "--trust", "trust", "--gate", "run")
    return ("gate", *on, *SITE, "--binding", "h/binding.yaml", "--config", config, *more)


def test_no_gate_starts_whose_counter_would_take_the_stores_place(
    shell: Shell, counted: str
) -> None:
    store, key = Path("r.db").read_bytes(), f"trust/keys/gate-{scenarios.RID}.key.pem"
    config = gate_config(shell)
    secret = Path(key).read_bytes()
    for other in ("r.db", "run/../r.db", "r.db-wal", key, config):
        words = gate_words(config, "--store", "r.db", "--counter", other)
        code, reason, message = shell.refused(*words)
        assert (code, reason, "--counter" in message) == (5, "SETUP_INVALID", True)
    assert (Path("r.db").read_bytes(), Path(key).read_bytes()) == (store, secret)
    code, told = shell.json("doctor", "--store", "r.db", "--counter", "r.db")
    assert code == 5
    assert "SAME_FILE" in [item["code"] for item in told["advice"] if item["level"] == "unsafe"]


def test_no_order_takes_the_store_for_its_counter(shell: Shell, counted: str) -> None:
    before = Path("r.db").read_bytes()
    code, reason, message = shell.refused("mission", "suspend", counted, *ON, "--counter", "r.db")
    assert (code, reason, "--counter" in message) == (5, "STORE_UNAVAILABLE", True)
    assert Path("r.db").read_bytes() == before


def test_a_journal_without_a_policy_is_a_mistake(shell: Shell) -> None:
    words = ("--store", "r.db", "--emergency-journal", "j")
    code, reason, message = shell.refused(*gate_words(gate_config(shell), *words))
    assert (code, reason) == (2, "USAGE")
    assert "--emergency-policy" in message
    assert not Path("r.db").exists()


# --- what status and recover say


def test_each_doubt_names_its_own_way_out() -> None:
    for why in list(Discrepancy):
        with case(why):
            said = {"state": "put_back", "why": str(why), "message": SAID[why]}
            head, way = status_lines({"anchor": said})[1:3]
            assert head.endswith(SAID[why])
            signed_away = why not in {Discrepancy.COUNTER_UNREADABLE, Discrepancy.COUNTER_NOT_NAMED}
            assert ("authguard recover" in way) is signed_away
            is_old = why in {Discrepancy.BEHIND, Discrepancy.FORKED}
            assert head.startswith("STORE ROLLED BACK") is is_old
            if not signed_away:
                assert "--counter" in way


def test_a_doubt_that_is_not_known_here_is_told_all_the_same() -> None:
    said = {"state": "put_back", "why": "something new", "message": "it differs"}
    assert "STORE ROLLED BACK: it differs" in status_lines({"anchor": said})


@pytest.mark.parametrize(
    ("by", "opened", "words"),
    [
        (
            BY_COUNTER,
            1,
            "the counter saw 2 records; this store had 1 when this gate started, has 4",
        ),
        (BY_STORE, 1, "its own checkpoint saw 2 records; this store had 1"),
        ("hall-2", 1, "the witness `hall-2` saw 2 records"),
        (BY_COUNTER, None, "the counter saw 2 records; this store has 4"),
    ],
)
def test_recover_shows_what_was_compared_beside_what_is_there_now(
    shell: Shell, by: str, opened: int | None, words: str, monkeypatch: Any
) -> None:
    anchor = {"state": "put_back", "store": STORE, "number": 3, "why": "behind", "by": by}
    anchor |= {"message": SAID[Discrepancy.BEHIND], "counted": 2, "opened": opened}
    status = {**STATUS, "anchor": anchor, "log": {"size": 4, "head": "h" * 43}, "mission": None}
    shown: list[str] = []
    monkeypatch.setattr(
        "authguard_r.cli.recover.confirm_shown", lambda lines, *_, **__: shown.extend(lines)
    )
    with listening(serving({Kind.STATUS: status, Kind.ORDER: "EXPIRED"})) as path:
        assert shell("recover", "--trust", "trust", "--gate", path)[0] == 1
    assert words in "\n".join(shown)


# --- a store that a gate holds


@pytest.mark.parametrize(
    "words",
    [("run", "--token", "m.token", *ON, *PLAN), ("stop", *ON)],
    ids=["run", "stop"],
)
def test_a_command_that_needs_the_store_itself_says_where_its_gate_is(
    shell: Shell, token: str, words: tuple[str, ...]
) -> None:
    beside(Path("gone.sock"))
    held = open_store(Path("r.db"))
    try:
        code, reason, message = shell.refused(*words)
    finally:
        held.close()
    assert (code, reason) == (5, "STORE_UNAVAILABLE")
    assert (
        "the gate is running (process 4711) and has this store open: use a command with --gate"
        in message
    )
    assert "no process answers" not in message  # none was asked


def test_learning_from_a_store_that_a_gate_holds_names_its_socket(shell: Shell) -> None:
    beside(Path("gone.sock"))
    held = open_store(Path("r.db"))
    try:
        code, reason, message = shell.refused("learn", "r.db", *SITE, "--out", "p")
    finally:
        held.close()
    assert (code, reason) == (5, "STORE_UNAVAILABLE")
    assert "gone.sock" in message


def test_learning_asks_the_gate_that_holds_the_store(shell: Shell, token: str) -> None:
    assert shell("mission", "activate", token, *ON, "--new")[0] == 0
    rows = list(read_rows(Path("r.db")))
    Path("r.db").unlink()
    with listening(telling(rows)) as path:
        beside(path)
        code, reason, message = shell.refused("learn", "r.db", *SITE, "--out", "p")
    assert (code, reason) == (1, "WRONG_KIND")  # it was read: nothing in it is of a shadow run
    assert "shadow" in message


# --- stopping where nobody serves


def test_where_nobody_serves_a_stop_says_so_after_a_restart_s_time(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "GONE_S", 0.3)
    monkeypatch.setattr(stopping, "DEAD_S", 0.6)
    run = shell.folder / "run"
    run.mkdir()
    with socket.socket(socket.AF_UNIX) as gate, socket.socket(socket.AF_UNIX) as lane:
        gate.bind(str(run / "gate.sock"))
        lane.bind(str(run / "stop.sock"))  # nobody listens
        code, reason, message = shell.refused("stop", "--gate", "run")
        assert (code, reason) == (5, "SERVICE_UNAVAILABLE")
        assert "no gate answers" in message
    (run / "gate.sock").unlink()
    (run / "stop.sock").unlink()
    assert "no gate answers" in shell.refused("stop", "--gate", "run")[2]
