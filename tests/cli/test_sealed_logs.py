# SPDX-License-Identifier: Apache-2.0
"""A log with sealed fields, read by each of its readers: their own fields, and no others'.

One gate that ran for real; everybody afterwards has its log and a key, or no key.
"""

from __future__ import annotations

import csv
import io
import json
import os
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.anchoring.sealing.policy import Reader, SealingPolicy
from authguard_r.anchoring.sealing.sealer import Sealer
from authguard_r.audit.record import (
    BOX,
    WRAP,
    Entry,
    LogRow,
    Record,
    Sealed,
    append,
    commit,
    read_record,
    read_sealed,
    without,
)
from authguard_r.audit.sealed_envelopes import SEALING
from authguard_r.audit.verify import verify_rows
from authguard_r.auditor.export_format import row_line
from authguard_r.cli import call
from authguard_r.core.encoding import encode_fast
from authguard_r.core.mission import DataClass
from authguard_r.keys.readers import new_reader, read_reader
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios, shadow_logs
from fixtures.gate_process import RunningGate
from fixtures.small_logs import edited, rechained

SAID = "correct horse battery staple"
EVERY = tuple(sorted(DataClass))
#: Who may read what here.
ROLES: dict[str, tuple[DataClass, ...]] = {
    "auditor": EVERY,
    "porter": (DataClass.REGION,),
    "pharmacist": (DataClass.OBJECT, DataClass.PARAMETER),
    "staff": (DataClass.PERSON,),
}
#: The mission's words, by the class that they are of.
WORDS: dict[DataClass, tuple[str, ...]] = {
    DataClass.EVIDENCE: ("navigate",),
    DataClass.OBJECT: ("package-p1",),
    DataClass.PARAMETER: ("speed_mm_s", "force_mn"),
    DataClass.PERSON: ("operator-1",),
    DataClass.REGION: ("pharmacy", "station-103"),
}
NOBODY = ("nobody", "stranger")
Said = tuple[int, str]


class Terminal(io.StringIO):
    """A standard input with a person at it."""

    def isatty(self) -> bool:
        return True


def say(*words: object, stdin: io.StringIO | None = None) -> Said:
    """Run a command; return its exit code and all that it said."""
    told, before = io.StringIO(), sys.stdin
    sys.stdin = stdin or io.StringIO()
    try:
        with redirect_stdout(told), redirect_stderr(told):
            code = call([str(word) for word in words])
    finally:
        sys.stdin = before
    assert "Traceback" not in told.getvalue()
    assert SAID not in told.getvalue()
    return code, told.getvalue()


def say_json(*words: object) -> tuple[int, Any]:
    code, text = say(*words, "--json")
    return code, json.loads(text)


@dataclass
class World:
    """A log, and the key of everybody who may have one."""

    folder: Path
    log: Path
    asked: dict[str, Said]

    def key(self, who: str) -> list[object]:
        """Return the options that name somebody's key; none for nobody."""
        if who == "nobody":
            return []
        sealed = ["--passphrase-file", self.folder / "said"] if who == "staff" else []
        return ["--reader", self.folder / f"{who}.key.pem", *sealed]

    def __call__(self, command: str, who: str, *words: object) -> Said:
        return say("audit", command, self.log, *words, *self.key(who))

    def json(self, command: str, who: str, *words: object) -> tuple[int, Any]:
        code, text = self(command, who, *words, "--json")
        return code, json.loads(text)

    def rows(self) -> list[LogRow]:
        return list(read_rows(self.log))

    def seq(self, kind: str, decision: str, nth: int = 0) -> int:
        """Return the number of a record."""
        found = [read_record(row.record, where="") for row in self.rows()]
        return [
            record.link.seq
            for record in found
            if (record.kind, record.link.decision) == (kind, decision)
        ][nth]

    def told(self, who: str, folder: Path) -> str:
        """Return everything that the commands tell somebody, but for the site in record 0."""
        table = folder / f"{who}.csv"
        assert self("export", who, "--format", "csv", "--out", table)[0] == 0
        lines = table.read_text().splitlines()
        parts = [lines[0], *lines[2:]]
        for words in (["show", "--first", 1], ["show", "--first", 1, "--json"], ["replay"]):
            code, text = self(str(words[0]), who, *words[1:])
            assert code == 0, text
            parts.append(text)
        for seq in range(1, len(self.rows())):
            code, text = self("explain", who, seq, "--json")
            assert code == 0, text
            parts.append(text)
        return "\n".join(parts)


def named(plain: Any, names: dict[str, str]) -> Any:
    """Return a draft in which grants are called otherwise: those names lie open in a log."""
    if isinstance(plain, dict):
        return {key: named(value, names) for key, value in plain.items()}
    if isinstance(plain, list):
        return [named(value, names) for value in plain]
    return names.get(plain, plain) if isinstance(plain, str) else plain


def calls(tool: str, **arguments: Any) -> bytes:
    return json.dumps({"tool": tool, "arguments": arguments}).encode()


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("sealed")
    (folder / "said").write_text(f"{SAID}\n")
    (folder / "said").chmod(0o600)
    readers = []
    for role in (*ROLES, "stranger"):
        file = folder / f"{role}.key.pem"
        more = {"staff": ["--passphrase-file", folder / "said"], "porter": ["--hybrid"]}
        code, made = say_json("audit", "reader", file, *more.get(role, []))
        assert (code, made["file"]) == (0, str(file))
        if role in ROLES:
            readers.append(Reader(role=role, classes=ROLES[role], key=made["key"]))
    draft = scenarios.draft()
    grants = {grant["id"]: f"g{number}" for number, grant in enumerate(draft["grants"])}
    with RunningGate(simulate=True, readers=tuple(readers), refusals=0) as gate:
        made = World(folder, gate.store, {})
        gate.activate(gate.token(gate.mission(**named(draft, grants) | {"mission": "m-1"})))
        with gate.client(ClientRole.PLANNER) as planner:
            planner.propose(calls("navigate_to", destination="Pharmacy", speed=1.2))
            planner.propose(calls("navigate_to", destination="Pharmacy", speed=0.8))
            planner.propose(calls("pick_up", object="P1", force=12))
            planner.propose(calls("navigate_to", destination="Station 103", speed=0.8))
            planner.propose(calls("navigate_to", destination="Nowhere", speed=0.8))
        made.asked = {who: made("prompts", who) for who in ("nobody", "auditor")}
        made.asked |= {f"{who} --json": made("prompts", who, "--json") for who in made.asked}
        gate.stop_process("gate")
        yield made


# who sees what


def test_an_outsider_with_the_log_finds_none_of_the_missions_words(world: World) -> None:
    path = world.folder / "log.jsonl"
    assert say("audit", "export", world.log, "--out", path)[0] == 0
    log = b"".join(path.read_bytes().splitlines(keepends=True)[1:]).decode()  # 0 is the site's
    assert len(log) > 10_000
    assert [word for words in WORDS.values() for word in words if word in log] == []
    # and what is exported for others is what was written, whoever exports it
    assert say("audit", "verify", path)[0] == 0


@pytest.mark.parametrize("who", [*ROLES, *NOBODY])
def test_a_role_sees_its_own_fields_and_no_others_in_anything(
    world: World, who: str, tmp_path: Path
) -> None:
    text = world.told(who, tmp_path)
    for data, words in WORDS.items():
        for word in words:
            assert (word in text) == (data in ROLES.get(who, ())), (word, data)


def test_what_stays_closed_is_shown_as_closed(world: World) -> None:
    seq = world.seq("decision", "accept")
    line = {who: world("show", who, "--first", seq, "--last", seq)[1] for who in (*ROLES, *NOBODY)}
    for who in NOBODY:
        _, _, told = line[who].partition(" m-1 ")
        assert " ".join(told.split()) == "- [sealed: evidence, object, parameter, person, region]"
    porter = " dock -> pharmacy [sealed: evidence, object, parameter, person]\n"
    assert line["porter"].endswith(porter)
    assert " speed_mm_s=800 [sealed: evidence, person, region]" in line["pharmacist"]
    assert "planner           navigate dock -> pharmacy speed_mm_s=800" in line["auditor"]
    assert "[" not in line["auditor"]
    _, told = world.json("show", "porter", "--first", seq, "--last", seq)
    (record,) = told["records"]
    assert record["closed"] == {
        "sealed": ["evidence", "object", "parameter", "person"],
        "destroyed": [],
    }
    assert record["values"]["action.regions"]["destination"] == "pharmacy"
    _, told = world.json("show", "auditor", "--first", seq, "--last", seq)
    assert "closed" not in told["records"][0]
    assert told["records"][0]["values"]["action"]["destination"] == "pharmacy"


def test_the_record_of_the_keys_says_for_whom_they_are(world: World) -> None:
    code, text = world("show", "nobody", "--kind", SEALING)
    assert code == 0
    told = "evidence, object, parameter, person, region for auditor, pharmacist, porter, staff\n"
    assert text.splitlines(keepends=True)[0].endswith(told)


def test_a_person_is_found_by_name_by_whoever_reads_persons(world: World) -> None:
    seq = world.seq("management", "activate")
    for who in ("auditor", "staff"):
        _, told = world.json("show", who, "--client", "operator-1")
        assert [record["seq"] for record in told["records"]] == [seq - 1, seq]  # issued before
    assert world.json("show", "porter", "--client", "operator-1")[1] == {"records": []}


def test_a_refusal_is_explained_as_far_as_a_key_goes(world: World) -> None:
    seq = world.seq("decision", "reject", 1)
    _, text = world("explain", "nobody", seq)
    assert f"record {seq}, " in text
    assert "  DESTINATION_OUT_OF_SCOPE\n" in text
    assert "  [sealed: evidence, object, parameter, person, region]\n" in text
    assert "signed next version" not in text
    _, text = world("explain", "porter", seq)
    assert ": ... source pharmacy destination station-103\n" in text
    _, told = world.json("explain", "porter", seq)
    assert told["closed"]["sealed"] == ["evidence", "object", "parameter", "person"]
    assert told["smallest_change"] is None
    code, text = world("explain", "auditor", seq)
    assert (code, "sealed" in text) == (0, False)
    assert "DESTINATION_OUT_OF_SCOPE at destination: expected" in text
    assert world.json("explain", "auditor", seq)[1].get("closed") is None


def test_the_smallest_change_is_made_from_what_a_reader_of_everything_has(
    world: World, tmp_path: Path
) -> None:
    seq, draft = world.seq("decision", "reject"), tmp_path / "draft.yaml"
    code, _ = world("explain", "porter", seq, "--draft", draft)
    assert (code, draft.exists()) == (1, False)
    code, text = world("explain", "auditor", seq, "--draft", draft)
    assert (code, "signed next version" in text) == (0, True)
    assert "1200" in draft.read_text()


def test_no_change_is_proposed_for_an_action_of_which_a_part_is_gone(
    world: World, tmp_path: Path
) -> None:
    seq, rows = world.seq("decision", "reject"), world.rows()
    left = without(rows[seq].sealed, ["box.object"], where="")
    rows[seq] = msgspec.structs.replace(rows[seq], sealed=left)
    path = written(tmp_path / "log.jsonl", rows)
    code, told = say_json("audit", "explain", path, seq, *world.key("auditor"))
    assert (code, told["smallest_change"]) == (0, None)
    assert told["closed"] == {"sealed": [], "destroyed": ["object"]}
    assert told["what"] == "navigate source dock destination pharmacy speed_mm_s=1200"


def test_a_table_says_what_is_closed(world: World, tmp_path: Path) -> None:
    seq = world.seq("decision", "accept", 1)
    for who, action in (("nobody", ("", "", "")), ("pharmacist", ("", "package-p1", ""))):
        out = tmp_path / f"{who}.csv"
        assert world("export", who, "--format", "csv", "--out", out)[0] == 0
        row = list(csv.DictReader(out.read_text().splitlines()))[seq]
        assert (row["action"], row["object"], row["source"]) == action
        assert row["closed"].startswith("[sealed: evidence")
        assert BOX not in row["sealed"]
    out = tmp_path / "auditor.csv"
    world("export", "auditor", "--format", "csv", "--out", out)
    row = list(csv.DictReader(out.read_text().splitlines()))[seq]
    assert (row["action"], row["object"], row["closed"]) == ("pick", "package-p1", "")


def test_lines_stay_as_they_are_stored_so_no_key_opens_them(world: World, tmp_path: Path) -> None:
    code, text = world("export", "porter", "--out", tmp_path / "opened.jsonl")
    assert (code, "as they are stored" in text) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_what_people_were_asked_a_running_gate_tells_its_readers(world: World) -> None:
    code, text = world.asked["nobody"]
    assert (code, "requests are not counted: missions m-1\n" in text) == (0, True)
    assert json.loads(world.asked["nobody --json"][1])["closed"] == ["m-1"]
    code, text = world.asked["auditor"]
    assert (code, "not counted" in text) == (0, False)
    assert "closed" not in json.loads(world.asked["auditor --json"][1])
    assert world("prompts", "porter")[0] == 0


# verify


@pytest.mark.parametrize("who", ["auditor", "porter", "staff"])
def test_every_box_that_a_key_opens_is_held_to_its_commitments(world: World, who: str) -> None:
    plain, (code, found) = world.json("verify", "nobody")[1], world.json("verify", who)
    told = found.pop("reader")
    assert (code, found) == (0, plain)
    assert (told["classes"], told["closed"] == 0) == (list(ROLES[who]), who == "auditor")
    assert told["opened"] > 0
    assert told["name"] == read_reader(world.folder / f"{who}.key.pem", lambda _: SAID).public.name
    boxes = sum(BOX in name for row in world.rows() for name in read_sealed(row.sealed, where=""))
    assert told["opened"] + told["closed"] == boxes
    code, text = world("verify", who, "--jobs", 2)
    assert (code, f"{told['opened']} boxes opened, each value as it was" in text) == (0, True)


def test_a_key_for_which_nothing_was_wrapped_is_said_plainly(world: World) -> None:
    code, text = world("verify", "stranger")
    assert (code, "nothing in it was wrapped for the key " in text) == (0, True)
    assert "boxes" not in text
    code, found = world.json("verify", "stranger")
    assert (code, found["reader"]["classes"], found["reader"]["opened"]) == (0, [], 0)


Change = Callable[[Record, dict[str, Sealed]], None]


def forged(rows: list[LogRow], seq: int, change: Change) -> list[LogRow]:
    """Return the log with one record changed, every commitment, digest and link made anew."""
    row = rows[seq]
    record, beside = read_record(row.record, where=""), read_sealed(row.sealed, where="")
    change(record, beside)
    committed = dict(record.committed)
    committed |= {name: commit(name, item) for name, item in beside.items()}
    new = edited(msgspec.structs.replace(row, sealed=encode_fast(beside)), committed=committed)
    return rechained([*rows[:seq], new, *rows[seq + 1 :]], seq)


def written(path: Path, rows: list[LogRow]) -> Path:
    path.write_bytes(b"".join(map(row_line, rows)))
    return path


def flipped(name: str, field: str = "text") -> Change:
    """Return a change of one letter in the ciphertext of a box."""

    def change(_: Record, beside: dict[str, Sealed]) -> None:
        text = beside[name].value[field]
        other = text[:-8] + ("A" if text[-8] != "A" else "B") + text[-7:]
        value = {**beside[name].value, field: other}
        beside[name] = msgspec.structs.replace(beside[name], value=value)

    return change


def other_wrap(name: str) -> Change:
    """Return a change of every wrapped key of a class: it opens for nobody any more."""

    def change(_: Record, beside: dict[str, Sealed]) -> None:
        wraps = [{**wrap, "text": wrap["text"][:-8] + "AAAAAAAA"} for wrap in beside[name].value]
        beside[name] = msgspec.structs.replace(beside[name], value=wraps)

    return change


def other_value(name: str) -> Change:
    """Return a change of what a record commits to: what was sealed is another value."""

    def change(record: Record, _: dict[str, Sealed]) -> None:
        record.committed[name] = record.committed[next(n for n in record.committed if n != name)]

    return change


def no_box(name: str) -> Change:
    def change(_: Record, beside: dict[str, Sealed]) -> None:
        beside[name] = msgspec.structs.replace(beside[name], value=["no box"])

    return change


def no_wraps(name: str) -> Change:
    def change(_: Record, beside: dict[str, Sealed]) -> None:
        beside[name] = msgspec.structs.replace(beside[name], value=["no wraps"])

    return change


@pytest.mark.parametrize(
    ("kind", "decision", "change", "place"),
    [
        ("decision", "accept", flipped("box.region"), "box.region"),
        ("decision", "accept", flipped("box.region", "nonce"), "box.region"),
        ("decision", "accept", no_box("box.region"), "box.region"),
        ("decision", "accept", other_value("action.regions"), "box.region"),
        (SEALING, SEALING, other_wrap("wrap.region"), "wrap.region"),
        (SEALING, SEALING, no_wraps("wrap.region"), "wrap.region"),
    ],
    ids=["text", "nonce", "no-box", "another-value", "wrap", "no-wraps"],
)
def test_a_box_that_is_not_what_it_should_be_is_named_with_its_record(
    world: World, tmp_path: Path, kind: str, decision: str, change: Change, place: str
) -> None:
    seq = world.seq(kind, decision)
    path = written(tmp_path / "forged.jsonl", forged(world.rows(), seq, change))
    assert say("audit", "verify", path)[0] == 0  # who has no key cannot know
    code, found = say_json("audit", "verify", path, *world.key("porter"))
    assert (code, found["whole"], found["where"]) == (1, False, f"record {seq}: {place}")
    code, text = say("audit", "verify", path, *world.key("porter"))
    assert (code, text.startswith(f"NOT WHOLE at record {seq}: {place}: ")) == (1, True)
    assert "boxes" not in text
    # and nobody decides anything again out of it
    code, found = say_json("audit", "replay", path, *world.key("porter"))
    assert (code, found["differences"][0]["seq"]) == (1, seq)
    assert place in found["differences"][0]["why"]
    assert say("audit", "show", path, *world.key("porter"))[0] == 4
    code, text = say("audit", "explain", path, seq, *world.key("porter"))
    assert (code, place in text) == (4, True)


def test_a_box_of_others_is_not_looked_into(world: World, tmp_path: Path) -> None:
    seq = world.seq("decision", "accept")
    path = written(tmp_path / "f.jsonl", forged(world.rows(), seq, flipped("box.object")))
    assert say("audit", "verify", path, *world.key("porter"))[0] == 0
    assert say("audit", "verify", path, *world.key("pharmacist"))[0] == 1


def test_a_broken_chain_is_said_before_a_box(world: World, tmp_path: Path) -> None:
    seq = world.seq("decision", "accept")
    rows = forged(world.rows(), seq, flipped("box.region"))
    rows[-1] = msgspec.structs.replace(rows[-1], link=bytes(32))
    path = written(tmp_path / "forged.jsonl", rows)
    code, found = say_json("audit", "verify", path, *world.key("porter"))
    assert (code, found["where"]) == (1, f"record {len(rows) - 1}")


# replay


def test_a_reader_of_everything_makes_every_decision_again(world: World) -> None:
    trust = scenarios.trust_folder()
    code, found = world.json("replay", "auditor", "--trust", trust)
    assert (code, found["agree"], found["not_replayable"]) == (0, 4, 0)
    assert found["verified"] is True


@pytest.mark.parametrize("who", ["porter", "staff", *NOBODY])
def test_what_is_sealed_for_a_reader_is_counted_with_its_names(world: World, who: str) -> None:
    code, found = world.json("replay", who)
    assert (code, found["agree"], found["differ"], found["not_replayable"]) == (0, 0, 0, 4)
    assert [item["why"] for item in found["why"]] == ["sealed: action, approvals, standing, state"]


# what was destroyed


def destroyed(
    rows: list[LogRow], data: DataClass, *, keys: bool = True, boxes: bool = True
) -> list[LogRow]:
    """Return the log after fields of a class were destroyed: the links are as they were."""
    left = []
    for row in rows:
        beside = read_sealed(row.sealed, where="")
        kept = {
            name: one
            for name, one in beside.items()
            if not (keys and name == WRAP + data)
            and not (boxes and name.startswith(BOX) and data in name.removeprefix(BOX).split("+"))
        }
        left.append(msgspec.structs.replace(row, sealed=encode_fast(kept)))
    assert verify_rows(left).whole
    return left


@pytest.mark.parametrize("boxes", [True, False], ids=["boxes-too", "keys-alone"])
@pytest.mark.parametrize("who", ["auditor", "nobody"])
def test_what_was_destroyed_is_said_to_be_whoever_asks(
    world: World, tmp_path: Path, who: str, boxes: bool
) -> None:
    rows = destroyed(world.rows(), DataClass.OBJECT, boxes=boxes)
    path, key = written(tmp_path / "log.jsonl", rows), world.key(who)
    seq = world.seq("decision", "accept", 1)
    _, text = say("audit", "show", path, "--first", seq, "--last", seq, *key)
    gone = "[destroyed: object]\n"
    assert text.endswith(gone)
    assert ("at pharmacy force_mn=12000" in text) == (who == "auditor")
    assert ("[sealed: " in text) == (who == "nobody")
    _, text = say("audit", "show", path, "--kind", SEALING, *key)
    assert text.splitlines()[0].endswith(" [destroyed: object]")
    _, text = say("audit", "explain", path, seq, *key)
    assert gone in text
    code, text = say("audit", "replay", path, *key)
    assert code == 1  # no order in the log has destroyed it
    assert "not replayable 4 (record " in text
    assert "destroyed: action, approvals, standing, state\n" in text
    code, found = say_json("audit", "verify", path, *world.key("auditor"))
    assert (code, found["whole"]) == (1, True)
    assert {one["name"] for one in found["missing"]} >= {WRAP + DataClass.OBJECT}


def test_a_mission_whose_token_was_destroyed_is_missed_by_name(
    world: World, tmp_path: Path
) -> None:
    seq, name = world.seq("management", "activate"), BOX + "+".join(EVERY)

    def other_keys(_: Record, beside: dict[str, Sealed]) -> None:
        value = {**beside[name].value, "keys": 0}
        beside[name] = msgspec.structs.replace(beside[name], value=value)

    sealed = gone = world.rows()
    sealed = forged(sealed, seq, other_keys)  # which nobody told
    gone = [
        row
        if row.seq != seq
        else msgspec.structs.replace(row, sealed=without(row.sealed, [name], where=""))
        for row in gone
    ]
    for word, rows in (("sealed", sealed), ("destroyed", gone)):
        path = written(tmp_path / word, rows)
        code, told = say_json("audit", "replay", path, *world.key("auditor"))
        assert (code, told["not_replayable"]) == (int(word == "destroyed"), 4)
        assert [item["why"] for item in told["why"]] == [f"{word}: the mission's token"]


def test_a_box_whose_keys_are_gone_and_that_is_none_is_refused(
    world: World, tmp_path: Path
) -> None:
    seq = world.seq("decision", "accept")
    rows = destroyed(world.rows(), DataClass.REGION, boxes=False)
    path = written(tmp_path / "log.jsonl", forged(rows, seq, no_box("box.region")))
    code, text = say("audit", "show", path)
    assert (code, f"record {seq}: box.region" in text) == (4, True)


# keys


def test_a_new_key_is_its_owners_and_takes_nothings_place(tmp_path: Path) -> None:
    path = tmp_path / "r.key.pem"
    code, text = say("audit", "reader", path)
    assert code == 0
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = path.read_bytes()
    code, shown = say("audit", "reader", path, "--show")
    assert (code, f'key: "{shown.strip()}"}}' in text) == (0, True)
    assert say_json("audit", "reader", path, "--show")[1] == {
        "file": str(path),
        "key": shown.strip(),
        "name": read_reader(path).public.name,
    }
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for taken in (path, tmp_path, tmp_path / "dangling"):
        code, text = say("audit", "reader", taken)
        assert (code, "is there already" in text) == (5, True)
    assert path.read_bytes() == before
    for words in (["--hybrid"], ["--protect"]):
        assert say("audit", "reader", path, "--show", *words)[0] == 2


def test_a_hybrid_key_is_both_keys(tmp_path: Path) -> None:
    path = tmp_path / "r.key.pem"
    assert say("audit", "reader", path, "--hybrid")[0] == 0
    assert path.read_bytes().count(b"BEGIN PRIVATE KEY") == 2
    assert len(read_reader(path).public.raw) == 1_184 + 32


def test_a_passphrase_seals_the_file(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "r.key.pem"
    code, text = say("audit", "reader", path, "--protect")
    assert (code, "no terminal to ask at" in text, path.exists()) == (2, True, False)
    typed = iter([SAID, f"{SAID}!", SAID, SAID])
    monkeypatch.setattr("getpass.getpass", lambda _: next(typed))
    code, text = say("audit", "reader", path, "--protect", stdin=Terminal())
    assert (code, "same passphrase twice" in text, path.exists()) == (4, True, False)
    assert say("audit", "reader", path, "--protect", stdin=Terminal())[0] == 0
    assert b"AUTHGUARD-R ENCRYPTED KEY" in path.read_bytes()
    code, text = say("audit", "reader", path, "--show")
    assert (code, "--passphrase-file" in text) == (4, True)
    assert (
        say("audit", "reader", path, "--show", "--passphrase-file", world.folder / "said")[0] == 0
    )


def test_a_passphrase_file_without_a_key_is_wrong_usage(world: World) -> None:
    for command in ("show", "verify", "replay", "prompts"):
        code, text = say("audit", command, world.log, "--passphrase-file", world.folder / "said")
        assert (code, "without --reader" in text) == (2, True)


def test_a_file_that_is_no_readers_key_opens_nothing(world: World, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong"
    wrong.write_text(f"{SAID} or not\n")
    wrong.chmod(0o600)
    damaged = tmp_path / "damaged.pem"
    key = (world.folder / "staff.key.pem").read_bytes()
    damaged.write_bytes(key.replace(b"\n", b"A\n", 2))
    signs = scenarios.trust_folder() / "keys" / "operator-1.key.pem"
    sealed = ["--passphrase-file", world.folder / "said"]
    staff = ["--reader", world.folder / "staff.key.pem"]
    for words, code in (
        ([*staff, "--passphrase-file", wrong], 4),
        (staff, 4),
        (["--reader", damaged, *sealed], 4),
        (["--reader", signs], 4),
        (["--reader", tmp_path / "none"], 5),
    ):
        for command in ("show", "verify", "prompts"):
            found, text = say("audit", command, world.log, *words)
            assert found == code, text


# learn


def shadow(path: Path, readers: tuple[Reader, ...]) -> Path:
    """Write the log of a shadow run that sealed what it saw."""
    sealer, store = Sealer(scenarios.RID, SealingPolicy(readers=readers)), open_store(path)

    def put(entry: Entry, *, plain: bool = False) -> None:
        if plain:
            store.run(lambda turn: append(turn, entry, salts=os.urandom(16 * len(entry.sealed))))
        else:
            store.run(lambda turn: sealer.append(turn, entry, salts=os.urandom))

    put(shadow_logs.genesis(), plain=True)
    put(shadow_logs.decided(scenarios.navigate("dock", "pharmacy")))
    put(shadow_logs.refused(shadow_logs.call("navigate_to", destination="Pharmacy", speed=0.5)))
    store.close()
    return path


def test_a_reader_of_everything_learns_and_others_are_told_what_is_sealed(tmp_path: Path) -> None:
    auditor, porter = tmp_path / "auditor.pem", tmp_path / "porter.pem"
    readers = []
    for path, classes in ((auditor, EVERY), (porter, (DataClass.REGION,))):
        key = new_reader()
        path.write_bytes(key.pem())
        readers.append(Reader(role=path.stem, classes=classes, key=key.public.text()))
    log = shadow(tmp_path / "shadow.db", tuple(readers))
    site = ["--site", scenarios.HOSPITAL / "site.yaml"]
    code, told = say_json("learn", log, *site, "--out", tmp_path / "a", "--reader", auditor)
    assert (code, told["used"], told["unused"]) == (0, 2, [])
    for number, words in enumerate(([], ["--reader", porter])):
        code, told = say_json("learn", log, *site, "--out", tmp_path / str(number), *words)
        why = ["its `action` is sealed", "its `plan` is sealed"]
        assert (code, [item["why"] for item in told["unused"]]) == (0, why)
    left = destroyed(list(read_rows(log)), DataClass.OBJECT, keys=False)
    path = written(tmp_path / "shadow.jsonl", left)
    code, told = say_json("learn", path, *site, "--out", tmp_path / "d", "--reader", auditor)
    assert [item["why"] for item in told["unused"]] == [
        "its `action` is destroyed",
        "its `plan` is destroyed",
    ]
    rows = forged(list(read_rows(log)), 2, flipped("box.region"))
    path = written(tmp_path / "forged.jsonl", rows)
    code, text = say("learn", path, *site, "--out", tmp_path / "f", "--reader", auditor)
    assert (code, "record 2: box.region" in text) == (4, True)
