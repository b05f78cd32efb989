# SPDX-License-Identifier: Apache-2.0
"""Writes `log.json`: what an implementation of the log's format must make of it.

    .venv/bin/python vectors/generate_log.py [FOLDER]

Tree, notes, checkpoints, cosignatures, and whole exported logs, sound and not. Keys come from
seeds and salts are numbered, so that the file changes only when the format does. Schema:
vectors/README.md
"""

from __future__ import annotations

import json
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests")]

from authguard_r.audit.checkpoint import origin_of  # noqa: E402
from authguard_r.audit.note import Note, NoteKey, NoteSignature  # noqa: E402
from authguard_r.audit.record import LogRow  # noqa: E402
from authguard_r.audit.tree import EMPTY_ROOT, consistency_proof, leaf_hash, root_of  # noqa: E402
from authguard_r.auditor.export_format import note_line, row_line  # noqa: E402
from authguard_r.core.identifiers import RobotId  # noqa: E402
from authguard_r.keys.notes import cosign, log_key, witness_key  # noqa: E402
from fixtures.inclusion import inclusion_proof  # noqa: E402
from fixtures.memory_tree import MemoryTree  # noqa: E402
from fixtures.small_logs import ROBOT, checkpoint_of, edited, log_of, rechained  # noqa: E402

Json = dict[str, Any]
#: Leaves of the test data of Certificate Transparency.
CT = ("", "00", "10", "2021", "3031", "40414243", "5051525354555657")
SIZE = 9
AT = 1_763_620_000


def seeded(name: str) -> Ed25519PrivateKey:
    """Return the private key that belongs to a name."""
    return Ed25519PrivateKey.from_private_bytes(sha256(name.encode()).digest())


LOG, OTHER = seeded("log"), seeded("other")
WITNESSES = {name: seeded(name) for name in ("w1.example", "w2.example", "w3.example")}
ORIGIN = origin_of(ROBOT)
KEY = log_key(ORIGIN, LOG.public_key())
WITNESS_KEYS = {n: witness_key(n, key.public_key()) for n, key in WITNESSES.items()}


def tree_vectors() -> Json:
    """Return roots and proofs over published leaves; the wrong ones differ in one thing."""
    leaves = [bytes.fromhex(text) for text in (*CT, "606162636465666768696a6b6c6d6e6f")]
    tree = MemoryTree()
    for leaf in leaves:
        tree.append(leaf_hash(leaf))
    sizes = range(len(leaves) + 1)
    roots = [root_of(tree, size).hex() for size in sizes]
    inclusion: list[Json] = []
    consistency: list[Json] = []
    for size in sizes:
        for index in range(size):
            proof = [node.hex() for node in inclusion_proof(tree, index, size)]
            own = {"index": index, "size": size, "leaf": leaf_hash(leaves[index]).hex()}
            inclusion.append({**own, "proof": proof, "holds": True})
            if size > 1:
                inclusion.append(
                    {**own, "index": (index + 1) % size, "proof": proof, "holds": False}
                )
                inclusion.append({**own, "proof": proof[:-1], "holds": False})
            inclusion.append({**own, "proof": [*proof, EMPTY_ROOT.hex()], "holds": False})
        for old in range(size + 1):
            proof = [node.hex() for node in consistency_proof(tree, old, size)]
            own = {"old": old, "size": size, "old_root": roots[old]}
            consistency.append({**own, "proof": proof, "holds": True})
            consistency.append({**own, "proof": [*proof, EMPTY_ROOT.hex()], "holds": False})
            if proof:
                consistency.append({**own, "proof": proof[1:], "holds": False})
            if old:
                consistency.append(
                    {**own, "old_root": roots[old - 1], "proof": proof, "holds": False}
                )
    return {
        "leaves": [leaf.hex() for leaf in leaves],
        "roots": roots,
        "inclusion": inclusion,
        "consistency": consistency,
    }


def line(key: NoteKey, signature: bytes, *, name: str | None = None) -> NoteSignature:
    """Return a signature line of a key."""
    return NoteSignature(name or key.name, key.id, signature)


def signed_note(rows: list[LogRow], witnesses: tuple[str, ...] = ()) -> Note:
    """Return the log's checkpoint of these rows with the cosignatures of witnesses."""
    text = checkpoint_of(rows).text()
    cosignatures = (cosign(text, name, WITNESSES[name], AT) for name in witnesses)
    return Note(text, (line(KEY, LOG.sign(text.encode())), *cosignatures))


def note_vectors() -> list[Json]:
    """Return notes with who signed them among the keys, or why the note is refused."""
    rows = log_of(3)
    good = signed_note(rows, ("w1.example", "w2.example"))
    text, (own, first, second) = good.text, good.signatures
    keys = [KEY, *WITNESS_KEYS.values()]

    def vector(name: str, note: str | Note, expect: Any) -> Json:
        shown = note if isinstance(note, str) else note.encode().decode()
        return {"name": name, "note": shown, "expect": expect}

    turned = NoteSignature(own.name, own.key_id, bytes([own.signature[0] ^ 1, *own.signature[1:]]))
    later = NoteSignature(
        first.name, first.key_id, (AT + 1).to_bytes(8, "big") + first.signature[8:]
    )
    as_witness = line(WITNESS_KEYS["w1.example"], AT.to_bytes(8, "big") + own.signature)
    witnessed = {"w1.example": AT, "w2.example": AT}
    said = good.encode().decode()
    return [
        {"keys": [key.text() for key in keys]},
        vector("log and two witnesses", good, {ORIGIN: None, **witnessed}),
        vector("log alone", Note(text, (own,)), {ORIGIN: None}),
        vector("witnesses alone", Note(text, (first, second)), witnessed),
        vector("in another order", Note(text, (second, own, first)), {ORIGIN: None, **witnessed}),
        vector(
            "a stranger's line is not looked at",
            Note(text, (own, line(KEY, b"x", name="s"))),
            {ORIGIN: None},
        ),
        vector(
            "another id is a stranger's",
            Note(text, (own, NoteSignature(ORIGIN, b"0000", b"x"))),
            {ORIGIN: None},
        ),
        vector("twice is once", Note(text, (own, own)), {ORIGIN: None}),
        vector("a bit of the signature", Note(text, (turned,)), "SIGNATURE_INVALID"),
        vector("one good, one turned", Note(text, (own, turned)), "SIGNATURE_INVALID"),
        vector("another text", Note(text.replace("\n3\n", "\n4\n"), (own,)), "SIGNATURE_INVALID"),
        vector(
            "another key", Note(text, (line(KEY, OTHER.sign(text.encode())),)), "SIGNATURE_INVALID"
        ),
        vector("a cosignature at another time", Note(text, (later,)), "SIGNATURE_INVALID"),
        vector("a log's signature as a witness's", Note(text, (as_witness,)), "SIGNATURE_INVALID"),
        vector(
            "a cosignature without a time",
            Note(text, (line(WITNESS_KEYS["w1.example"], b"1234567"),)),
            "MALFORMED",
        ),
        vector("no last newline", said.removesuffix("\n"), "MALFORMED"),
        vector("no blank line", said.replace("\n\n", "\n"), "MALFORMED"),
        vector("no signature", f"{text}\n", "MALFORMED"),
        vector("a line that is no signature", f"{said}more\n", "MALFORMED"),
        vector("a control character", said.replace("\n3\n", "\n3\t\n"), "MALFORMED"),
        vector("a carriage return", said.replace("\n", "\r\n"), "MALFORMED"),
        vector("a hyphen for the dash", said.replace("\u2014", "-"), "MALFORMED"),
        vector("base64url", said.replace("+", "-").replace("/", "_"), "MALFORMED"),
    ]


def checkpoint_vectors() -> list[Json]:
    """Return checkpoint texts with what they say; null: it is none."""
    text = checkpoint_of(log_of(3)).text()
    origin, size, root, chain = text.splitlines()

    def vector(lines: list[str], *, sound: bool = True, end: str = "\n") -> Json:
        said = {"origin": lines[0], "size": int(lines[1]), "root": lines[2]} if sound else None
        chains = [one.removeprefix("chain ") for one in lines[3:] if one.startswith("chain ")]
        whole = said and {**said, "chain": chains[0] if chains else None}
        return {"text": "\n".join(lines) + end, "said": whole}

    return [
        vector([origin, size, root, chain]),
        vector([origin, size, root]),
        vector(["example.com/log", "0", root, "an extension"]),
        vector([origin, "9007199254740991", root]),
        *(
            vector(lines, sound=False)
            for lines in (
                [origin, size],
                ["", size, root],
                [origin, "03", root],
                [origin, "-3", root],
                [origin, "9007199254740992", root],
                [origin, size, root[:-4]],
                [origin, size, root.replace("=", "")],
                [origin, size, root, ""],
                [origin, size, root, chain, chain],
                [origin, size, root, "chain AAAA"],
            )
        ),
        vector([origin, size, root, chain], sound=False, end=""),
    ]


def log_vectors() -> list[Json]:
    """Return exported logs with what a verifier says of them with and without the key."""
    rows = log_of(SIZE)
    note = signed_note(rows, ("w1.example", "w2.example"))
    lines = [row_line(row).decode() for row in rows]
    last = note_line(note.encode()).decode()
    forged = rechained([edited(row, decision="accept") if row.seq == 5 else row for row in rows])
    destroyed = [LogRow(r.seq, r.record, b"{}", r.link) if r.seq == 2 else r for r in rows]
    committed = json.loads(rows[2].record)["committed"]
    missing = [{"mid": "m-1", "name": n, "count": 1, "first": 2} for n in sorted(committed)]
    early = note_line(signed_note(rows[:4]).encode()).decode()
    stranger = note_line(
        Note(note.text, (line(KEY, OTHER.sign(note.text.encode())),)).encode()
    ).decode()
    other = checkpoint_of(rows, RobotId("lifter-1")).text()
    own = log_key(origin_of(RobotId("lifter-1")), LOG.public_key())
    elsewhere = note_line(Note(other, (line(own, LOG.sign(other.encode())),)).encode()).decode()

    def of(name: str, whole: list[str], expect: Json, **more: Any) -> Json:
        return {"name": name, "lines": whole, "expect": expect, **more}

    def fine(size: int = SIZE, by: str = "checkpoint", total: int = SIZE) -> Json:
        return {"whole": True, "size": total, "anchored": by, "anchored_size": size}

    def at(record: int) -> Json:
        return {"whole": False, "record": record}

    def with_(place: int, old: str, new: str) -> list[str]:
        assert old in lines[place]
        return [*lines[:place], lines[place].replace(old, new, 1), *lines[place + 1 :], last]

    refused: Json = {"refused": True}
    witnesses = [key.text() for key in WITNESS_KEYS.values()]
    return [
        of("without a key", [*lines, last], fine(0, "unanchored"), keyless=True),
        of("with the key", [*lines, last], fine()),
        of(
            "two of three witnesses",
            [*lines, last],
            fine(SIZE, "witnessed"),
            witnesses=witnesses,
            quorum=2,
        ),
        of("three of three witnesses", [*lines, last], refused, witnesses=witnesses, quorum=3),
        of("an early checkpoint", [*lines, early], fine(4)),
        of(
            "a value is gone",
            [*(row_line(row).decode() for row in destroyed), last],
            {**fine(), "missing": missing},
        ),
        of("no checkpoint", lines, refused),
        of("no checkpoint, no key", lines, fine(0, "unanchored"), keyless=True),
        of("signed with another key", [*lines, stranger], refused),
        of("another robot's checkpoint", [*lines, elsewhere], refused),
        of("cut off", [*lines[:6], last], at(6)),
        of("cut off, no key", lines[:6], fine(0, "unanchored", 6), keyless=True),
        of("the first is missing", [*lines[1:], last], at(0)),
        of("one is missing", [*lines[:4], *lines[5:], last], at(4)),
        of("one is there twice", [*lines[:4], lines[3], *lines[4:], last], at(4)),
        of("two are reordered", [*lines[:4], lines[5], lines[4], *lines[6:], last], at(4)),
        of("a changed decision", with_(5, "reject", "accept"), at(5)),
        of("a changed open field", with_(5, "RATE_LIMITED", "RATE_LIMITER"), at(5)),
        of("a changed value", with_(2, "room-2", "room-9"), at(2)),
        of("a changed link", with_(3, '{"link":"', '{"link":"A'), at(3)),
        of(
            "chained anew, no key",
            [row_line(row).decode() for row in forged],
            fine(0, "unanchored"),
            keyless=True,
        ),
        of(
            "chained anew",
            [*(row_line(row).decode() for row in forged), last],
            {"whole": False, "record": None},
        ),
    ]


def log() -> Json:
    """Return everything."""
    return {
        "tree": tree_vectors(),
        "notes": note_vectors(),
        "checkpoints": checkpoint_vectors(),
        "key": KEY.text(),
        "logs": log_vectors(),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "vectors"
    text = json.dumps(log(), indent=1, sort_keys=True, ensure_ascii=True)
    (folder / "log.json").write_text(text + "\n")
