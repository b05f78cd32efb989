# SPDX-License-Identifier: Apache-2.0
"""Suite files: what is written is read; whatever else is refused, with its line and the mend."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from missionpair.pair import Input, PriorAct, Scenario, Suite
from missionpair.registry import UnknownNameError
from missionpair.suites import SuiteError, digest_of, load, read_suite, require_suite, write_suite
from missionpair.words import Channel


@pytest.fixture(scope="module")
def hand() -> Suite:
    return load("hand")[0]


@pytest.fixture
def written(hand: Suite, tmp_path: Path) -> Path:
    path = tmp_path / "hand.jsonl"
    assert write_suite(hand, path) == digest_of(hand)
    return path


def edited(path: Path, number: int, change: Callable[[Any], Any]) -> None:
    lines = path.read_text().splitlines()
    plain = change(json.loads(lines[number - 1]))
    lines[number - 1] = json.dumps(plain, separators=(",", ":"), ensure_ascii=False)
    path.write_text("\n".join(lines) + "\n")


def refused(path: Path) -> SuiteError:
    with pytest.raises(SuiteError) as caught:
        read_suite(path)
    return caught.value


def test_what_is_written_is_read(hand: Suite, written: Path) -> None:
    assert read_suite(written) == hand
    assert load(str(written)) == (hand, digest_of(hand))
    again = written.with_name("again.jsonl")
    write_suite(read_suite(written), again)
    assert again.read_bytes() == written.read_bytes()


def test_the_missions_keep_their_order_because_the_first_one_is_attacked(written: Path) -> None:
    missions = [list(pair.missions) for pair in read_suite(written).pairs]
    assert ["v1", "again"] in missions


def test_a_file_that_is_there_is_not_written_over(hand: Suite, written: Path) -> None:
    before = written.read_bytes()
    with pytest.raises(SuiteError, match="path of a new file"):
        write_suite(hand, written)
    assert written.read_bytes() == before


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert "nothing.jsonl" in refused(tmp_path / "nothing.jsonl").where


def test_a_name_that_is_none_says_which_there_are() -> None:
    with pytest.raises(UnknownNameError, match="availability, full, hand, household-rows, live"):
        load("fulll")
    with pytest.raises(UnknownNameError, match="takes no option"):
        load("live:each=2")


def test_an_option_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="`each` is `many`: expected a whole number"):
        load("full:each=many")
    with pytest.raises(SuiteError, match="folder=PATH"):
        load("household-rows")
    with pytest.raises(SuiteError, match=r"no `.jsonl` file"):
        load(f"household-rows:folder={tmp_path}")


@pytest.mark.parametrize(
    ("number", "change", "said"),
    [
        (1, lambda d: {**d, "schema": "missionpair/suite/9"}, "of another version"),
        (1, lambda d: {**d, "digest": "x" * 43}, "not those that the digest is of"),
        (1, lambda d: {**d, "more": 1}, "unknown field `more`"),
        (1, lambda d: {**d, "pairs": 12}, "expected 1 layouts and 12 pairs, got 1 layouts and 11"),
        (1, lambda d: {**d, "pairs": 10}, "expected 10 pairs, got more"),
        (2, lambda d: {"layout": {**d["layout"], "domain": "moon"}}, "Invalid enum value"),
        (3, lambda d: {"pair": {**d["pair"], "layout": "nowhere"}}, "no layout is called"),
        (3, lambda d: {"pair": {**d["pair"], "violates": []}}, "at least one"),
        (3, lambda d: {"pair": {**d["pair"], "channels": ["user"]}}, "one input for each"),
        (3, lambda d: {"pair": {**d["pair"], "update": []}}, "a plan of the attack"),
        (3, lambda d: {"pair": {**d["pair"], "missions": {"v2": {}}}}, "expected `v1`"),
        (4, lambda d: {"pair": {**d["pair"], "id": "hand.goal"}}, "is there already"),
        (5, lambda d: {"pair": {**d["pair"], "task": "Another one."}}, "digest"),
    ],
)
def test_a_line_that_is_not_what_it_has_to_be(
    written: Path, number: int, change: Callable[[Any], Any], said: str
) -> None:
    edited(written, number, change)
    error = refused(written)
    assert said in error.message
    assert error.where.startswith(str(written))
    if "digest" not in said and "expected 1" not in said and "got more" not in said:
        assert f":{number}" in error.where


def test_a_robot_a_mission_or_a_signer_that_is_not_there(hand: Suite) -> None:
    pair = hand.pairs[0]
    scenario = Scenario(robot="nobody", plan=pair.attack.plan)
    for changed, said in (
        (replace(pair, attack=scenario), "no robot of the layout is called `nobody`"),
        (replace(pair, update=(PriorAct(do="activate", mission="v7"),)), "no mission of the pair"),
        (replace(pair, update=(PriorAct(do="approve"),)), "expected somebody in `by`"),
        (replace(pair, inputs=(Input(Channel.USER, "x"),)), "one input for each"),
        (
            replace(pair, commissioned={"fly": "wing"}),
            "no action type of the layout is called `fly`",
        ),
    ):
        with pytest.raises(SuiteError, match=said):
            require_suite(replace(hand, pairs=(changed,)))


def test_two_pairs_of_one_id(hand: Suite) -> None:
    with pytest.raises(SuiteError, match="give it another id"):
        require_suite(replace(hand, pairs=(hand.pairs[0], hand.pairs[0])))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{}\n",
        b"[]\n",
        b"\xff\xfe\n",
        b'{"schema":',
        b"[" * 100_000 + b"\n",
        b'{"schema":"missionpair/suite/1"}\n',
        b"x" * 4_000_001,
    ],
)
def test_bytes_that_are_no_suite(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bad.jsonl"
    path.write_bytes(data)
    assert refused(path).where == f"{path}:1"


def test_a_key_twice_and_a_missing_end_of_line_are_seen(written: Path) -> None:
    data = written.read_bytes()
    twice = data.replace(b'{"pair":{"id":"hand.goal"', b'{"pair":{"id":"x","id":"hand.goal"', 1)
    written.write_bytes(twice)
    assert "a key twice" in refused(written).message
    written.write_bytes(data[:-1])
    assert "no end of line" in refused(written).message


def test_a_file_that_was_cut(written: Path) -> None:
    lines = written.read_bytes().splitlines(keepends=True)
    written.write_bytes(b"".join(lines[:-1]))
    assert "it was cut" in refused(written).message


def test_a_folder_is_no_suite(tmp_path: Path) -> None:
    folder = tmp_path / "folder.jsonl"
    folder.mkdir()
    assert refused(folder).where == str(folder)
