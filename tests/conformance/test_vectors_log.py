# SPDX-License-Identifier: Apache-2.0
"""Our code, and an independent verifier in another language, give the published answers on logs.

What is published, and what C2SP and the Go project publish of notes, is not ours to change.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import encode64, read_key, read_note
from authguard_r.audit.tree import Frontier, leaf_hash, root_of, verify_consistency
from authguard_r.cli import call
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.keys.notes import verify_note
from fixtures import scenarios
from fixtures.inclusion import verify_inclusion
from fixtures.memory_tree import MemoryTree

Json = dict[str, Any]
VECTORS: Json = json.loads((scenarios.ROOT / "vectors" / "log.json").read_text())
VERIFIER = scenarios.ROOT / "examples" / "verifier" / "verify.mjs"
NODE = shutil.which("node")
#: In continuous integration a missing node is a failure, not a reason to skip.
needs_node = pytest.mark.skipif(
    NODE is None and "AUTHGUARD_COMPLETE" not in os.environ, reason="node is not installed"
)


def named(vector: Json) -> str:
    return str(vector["name"])


def test_the_published_file_is_what_the_generator_writes(tmp_path: Path) -> None:
    script = scenarios.ROOT / "vectors" / "generate_log.py"
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True)
    assert json.loads((tmp_path / "log.json").read_text()) == VECTORS


# the tree


def test_roots_are_those_of_the_published_leaves() -> None:
    tree, frontier = MemoryTree(), Frontier()
    leaves = [leaf_hash(bytes.fromhex(leaf)) for leaf in VECTORS["tree"]["leaves"]]
    for leaf in leaves:
        tree.append(leaf)
    for size, root in enumerate(VECTORS["tree"]["roots"]):
        assert root_of(tree, size).hex() == frontier.grown(leaves[:size]).root().hex() == root


def test_proofs_hold_or_do_not_as_published() -> None:
    tree = VECTORS["tree"]
    roots = [bytes.fromhex(root) for root in tree["roots"]]
    for vector in tree["inclusion"]:
        proof = tuple(map(bytes.fromhex, vector["proof"]))
        leaf, size = bytes.fromhex(vector["leaf"]), vector["size"]
        holds = verify_inclusion(leaf, vector["index"], size, proof, roots[size])
        assert holds is vector["holds"], vector
    for vector in tree["consistency"]:
        proof = tuple(map(bytes.fromhex, vector["proof"]))
        old, size = vector["old"], vector["size"]
        before = bytes.fromhex(vector["old_root"])
        holds = verify_consistency(old, size, before, roots[size], proof)
        assert holds is vector["holds"], vector
    for kind in ("inclusion", "consistency"):
        assert {vector["holds"] for vector in tree[kind]} == {True, False}


# notes and checkpoints

KEYS = [read_key(text, where="") for text in VECTORS["notes"][0]["keys"]]


@pytest.mark.parametrize("vector", VECTORS["notes"][1:], ids=named)
def test_a_note_is_signed_by_whom_it_is_published(vector: Json) -> None:
    def found() -> Json:
        note = read_note(vector["note"].encode(), where="note")
        assert note.encode().decode() == vector["note"]
        return {a.key.name: a.time_s for a in verify_note(note, KEYS, where="note")}

    if isinstance(vector["expect"], str):
        with pytest.raises(AuthGuardError) as caught:
            found()
        assert str(caught.value.reason) == vector["expect"]
    else:
        assert found() == vector["expect"]


@pytest.mark.parametrize("vector", VECTORS["checkpoints"], ids=lambda v: repr(v["text"])[-40:])
def test_a_checkpoint_says_what_is_published(vector: Json) -> None:
    try:
        read = read_checkpoint(vector["text"], where="note")
    except MalformedError:
        assert vector["said"] is None
        return
    said = vector["said"]
    assert (read.origin, read.size, encode64(read.root)) == (
        *(said["origin"], said["size"], said["root"]),
    )
    assert said["chain"] == (None if read.chain is None else encode64(read.chain))


GO_KEY = "PeterNeumann+c74f20a3+ARpc2QcUPDhMQegwxbzhKqiBfsVkmqq/LDE4izWy10TW"
GO_NOTE = (
    "If you think cryptography is the answer to your problem,\n"
    "then you don't know what your problem is.\n\n"
    "\u2014 PeterNeumann x08go/ZJkuBS9UG/SffcvIAQxVBtiFupLLr8pAcElZInNIuGUgYN1FFYC2pZSNXgKvqfqdng"
    "otpRZb6KE6RyyBwJnAM=\n"
)
C2SP_NOTE = (
    "Ognuno sta solo sul cuor della terra\ntrafitto da un raggio di sole:\n\ned è subito sera.\n\n"
    "\u2014 quasimodo.example/salvatore NnugSzTjtVAewIS+Z/iJhUPeFDkO/5QQ2i5ddnGITLlC+EhfLW9oJKONrMo"
    "uFSQU0xMcXxj99ihAQwaqP3ZekRwNtIc=\n"
)
C2SP_CHECKPOINT = (
    "example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n\n"
    "\u2014 example.com/behind-the-sofa Az3grlgtzPICa5OS8npVmf1Myq/5IZniMp+ZJurmRDeOoRDe4URYN7u5/Zh"
    "cyv2q1gGzGku9nTo+zyWE+xeMcTOAYQ8=\n"
    "\u2014 witness.example.com/w1 jWbPPwAAAABkGFDLEZMHwSRaJNiIDoe9DYn/zXcrtPHeolMI5OWXEhZCB9dlrDJs"
    "X3b2oyin1nPZqhf5nNo0xUe+mbIUBkBIfZ+qnA==\n"
)


def test_the_example_of_gos_signed_notes_verifies() -> None:
    key = read_key(GO_KEY, where="")
    assert key.text() == GO_KEY
    (attested,) = verify_note(read_note(GO_NOTE.encode(), where=""), (key,), where="")
    assert attested.key == key
    with pytest.raises(AuthGuardError):
        verify_note(read_note(GO_NOTE.replace("you ", "one ").encode(), where=""), (key,), where="")


def test_the_examples_of_c2sp_are_read_byte_for_byte() -> None:
    for text in (C2SP_NOTE, C2SP_CHECKPOINT):
        assert read_note(text.encode(), where="").encode() == text.encode()
    read = read_note(C2SP_CHECKPOINT.encode(), where="")
    assert read_checkpoint(read.text, where="").size == 20_852_163
    cosignature = read.signatures[1].signature
    assert int.from_bytes(cosignature[:8], "big") == 1_679_315_147  # the time in the specification
    assert len(cosignature) == 8 + 64
    assert "\n\ned è" in read_note(C2SP_NOTE.encode(), where="").text


# whole logs, by us and by a verifier that shares no code with us


def options(vector: Json) -> list[str]:
    given = [] if vector.get("keyless") else ["--key", VECTORS["key"]]
    for key in vector.get("witnesses", ()):
        given += ["--witness", key]
    return given + (["--quorum", str(vector["quorum"])] if "quorum" in vector else [])


def exported(vector: Json, folder: Path) -> Path:
    path = folder / "log.jsonl"
    path.write_text("".join(vector["lines"]), encoding="utf-8")
    return path


def node_said(*arguments: str) -> tuple[int, str, str]:
    """Return the code of the independent verifier, and what it said on either stream."""
    assert NODE is not None, "node is not installed"
    done = subprocess.run(
        [NODE, str(VERIFIER), *arguments], capture_output=True, text=True, check=False, timeout=60
    )
    return done.returncode, done.stdout, done.stderr


def node(*arguments: str) -> tuple[int, str]:
    code, out, errors = node_said(*arguments)
    assert errors == ""
    return code, out


@pytest.mark.parametrize("vector", VECTORS["logs"], ids=named)
def test_our_verifier_gives_the_published_answer(
    vector: Json, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported(vector, tmp_path)
    code = call(["audit", "verify", str(path), *options(vector), "--json"])
    told, expect = json.loads(capsys.readouterr().out), vector["expect"]
    if "refused" in expect:
        assert (code, "error" in told) == (4, True)
        return
    fits = expect["whole"] and not expect.get("missing")  # chained, and nothing was taken from it
    assert (code, told["whole"]) == (0 if fits else 1, expect["whole"])
    if expect["whole"]:
        assert {name: told[name] for name in expect} == expect
    elif expect["record"] is None:
        assert told["where"].startswith("records 0 to ")
    else:
        assert told["where"] == f"record {expect['record']}"


@needs_node
@pytest.mark.parametrize("vector", VECTORS["logs"], ids=named)
def test_the_independent_verifier_gives_the_published_answer(vector: Json, tmp_path: Path) -> None:
    code, out = node(str(exported(vector, tmp_path)), *options(vector))
    expect = vector["expect"]
    if "refused" in expect:
        assert (code, out[:14]) == (4, "NOT VERIFIED: ")
    elif expect["whole"]:
        size, by = expect["anchored_size"], expect["anchored"]
        covers = f", {size} of {expect['size']} records" if by != "unanchored" else ""
        assert code == int("missing" in expect)
        assert out.startswith(f"whole: {expect['size']} records, head ")
        told = [line for line in out.splitlines() if line.startswith("MISSING: ")]
        assert len(told) == len(expect.get("missing", ()))
        assert out.splitlines()[-1] == f"anchored: {by}{covers}"
    else:
        record = r"\d+" if expect["record"] is None else str(expect["record"])
        assert code == 1
        assert re.match(f"NOT WHOLE at record {record}: ", out)


@needs_node
def test_the_independent_verifier_is_short_and_uses_the_standard_library_alone() -> None:
    text = VERIFIER.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 150
    missing = VERIFIER.with_name("missing.mjs").read_text(encoding="utf-8")
    assert len(missing.splitlines()) < 30  # the one other file, which imports nothing
    assert "import" not in missing
    imported = re.findall(r'from "([^"]+)"', text)
    assert imported.count("./missing.mjs") == 1
    assert all(name.startswith("node:") for name in imported if name != "./missing.mjs")
    assert "require(" not in text
    assert "import(" not in text
    for newer in ("isWellFormed", "toWellFormed", "toSorted", "toReversed", "fromAsync"):
        assert newer not in text + missing  # Node 18 has none of these


@needs_node
def test_what_cannot_be_read_is_not_verified_and_never_not_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = exported(next(v for v in VECTORS["logs"] if v["expect"].get("whole")), tmp_path)
    missing = str(tmp_path / "missing")
    for words in (
        [missing],
        [str(tmp_path)],
        [],
        [str(log), "--unknown"],
        [str(log), "--checkpoint", missing],
    ):
        code, out, errors = node_said(*words)
        assert (code, out, len(errors.splitlines())) == (4, "", 1), words
        assert errors.startswith("NOT VERIFIED: ")
    for path in (missing, str(tmp_path)):
        assert call(["audit", "verify", path]) == 4
    assert "Traceback" not in capsys.readouterr().err


@needs_node
def test_an_empty_file_is_no_log(tmp_path: Path) -> None:
    """Somebody who emptied it is not told that nothing was changed."""
    empty = tmp_path / "log.jsonl"
    empty.touch()
    for key in ((), ("--key", VECTORS["key"])):
        assert node(str(empty), *key) == (4, "NOT VERIFIED: the file is empty\n")
        assert call(["audit", "verify", str(empty), *key]) == 4


@needs_node
def test_half_a_character_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    row = {"link": "", "record": '{"open":"\\ud800"}', "sealed": "{}", "seq": 0}
    path.write_text(json.dumps(row, separators=(",", ":")) + "\n")
    assert node(str(path)) == (1, "NOT WHOLE at record 0: a text that is no Unicode\n")
    assert call(["audit", "verify", str(path)]) == 1


@needs_node
def test_the_independent_verifier_reads_a_real_log_and_refuses_changed_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim = scenarios.simulation(store=tmp_path / "robot.db")
    sim.gate.management.activate(scenarios.token())
    for goal in ("station-103", "pharmacy", "office-1"):
        scenarios.propose(sim, scenarios.navigate(sim.robot.state.region, goal))
    sim.gate.ledger.close()
    path = tmp_path / "robot.jsonl"
    assert call(["audit", "export", str(tmp_path / "robot.db"), "--out", str(path)]) == 0
    assert call(["audit", "verify", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    code, out = node(str(path))
    assert (code, out.split(", root")[0]) == (
        0,
        f"whole: {told['size']} records, head {told['head']}",
    )
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    rows = [line for line in lines if not line.startswith('{"checkpoint":')]
    assert len(rows) == told["size"] > 5
    fields = ("time_ms", "salt", "reasons", "mid", "evidence")
    for at in range(len(rows)):
        changed = rows[at].replace(f'{fields[at % 5]}\\":', f'x{fields[at % 5]}\\":', 1)
        wrong = rows[at + 1 :] if changed == rows[at] else [changed, *rows[at + 1 :]]
        path.write_text("".join([*rows[:at], *wrong]), encoding="utf-8")
        code, out = node(str(path))
        if at + 1 < len(rows) or changed != rows[at]:
            assert (code, out.startswith(f"NOT WHOLE at record {at}: ")) == (1, True)


@settings(max_examples=200)
@given(st.data())
def test_no_changed_note_of_the_vectors_verifies_for_more(data: st.DataObject) -> None:
    vector = VECTORS["notes"][1]
    whole = vector["note"].encode()
    at, bit = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 7))
    changed = whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :]
    try:
        note = read_note(changed, where="")
        found = verify_note(note, KEYS, where="")
    except AuthGuardError:
        return
    assert len(found) < len(vector["expect"])
