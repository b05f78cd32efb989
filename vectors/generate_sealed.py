# SPDX-License-Identifier: Apache-2.0
"""Writes `sealed.json`: what an implementation of sealed fields must read of a log, and refuse.

    .venv/bin/python vectors/generate_sealed.py [FOLDER]

Keys, salts and nonces are numbered. HPKE is not: what was wrapped once is kept from the file as long
as it opens to the same key. Schema: vectors/README.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.mlkem import MLKEM768PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from msgspec.structs import replace

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests")]

from authguard_r.anchoring.sealing.key_ring import KeyRing  # noqa: E402
from authguard_r.anchoring.sealing.wraps import Wrapped, WrappedFor  # noqa: E402
from authguard_r.audit.record import (  # noqa: E402
    BOX,
    WRAP,
    Entry,
    LogRow,
    Sealed,
    append,
    read_record,
    read_sealed,
    without,
)
from authguard_r.audit.sealed_envelopes import (  # noqa: E402
    SEALING,
    Cover,
    DataClass,
    append_covered,
    opened,
)
from authguard_r.audit.verify import verify_rows  # noqa: E402
from authguard_r.core.encoding import b64, encode, encode_fast, unb64  # noqa: E402
from authguard_r.core.errors import AuthGuardError  # noqa: E402
from authguard_r.keys.readers import ReaderKey  # noqa: E402
from fixtures.small_logs import ROBOT, START_MS, Pages  # noqa: E402

Json = dict[str, Any]
#: Number of the record that tells the keys.
KEYS_AT = 1
CLASSES = {one: sha256(f"class {one}".encode()).digest() for one in DataClass}
READERS: dict[str, tuple[DataClass, ...]] = {
    "auditor": tuple(DataClass),
    "pq-auditor": tuple(DataClass),
    "porter": (DataClass.REGION,),
}


def key_of(role: str) -> ReaderKey:
    """Return the private key that belongs to a role; `pq-` ones are hybrid."""
    x25519 = X25519PrivateKey.from_private_bytes(sha256(f"x {role}".encode()).digest())
    if not role.startswith("pq-"):
        return ReaderKey(x25519)
    seed = sha256(f"m {role}".encode()).digest() + sha256(f"z {role}".encode()).digest()
    return ReaderKey(x25519, MLKEM768PrivateKey.from_seed_bytes(seed))


def numbered() -> Callable[[int], bytes]:
    """Return what gives other bytes each time, and the same ones in each run."""
    count = 0

    def salts(size: int) -> bytes:
        nonlocal count
        blocks = b""
        while len(blocks) < size:
            blocks += sha256(f"salt {count}".encode()).digest()
            count += 1
        return blocks[:size]

    return salts


def told(kept: Json) -> Entry:
    """Return the record that tells the keys.

    Args:
        kept: what was wrapped before, by class and role.
    """
    wraps: dict[str, list[Wrapped]] = {}
    for role, classes in READERS.items():
        key = key_of(role)
        for data in classes:
            bound = encode(
                WrappedFor(robot=ROBOT, mid="m-1", keys=KEYS_AT, data=data, reader=key.public.name)
            )
            text = kept.get(f"{data} {role}")
            if text is None or not _opens(key, text, bound, CLASSES[data]):
                text = b64(key.public.wrap(CLASSES[data], bound))
            wrapped = Wrapped(reader=key.public.name, role=role, text=text)
            wraps.setdefault(WRAP + data, []).append(wrapped)
    opened_ = {"classes": list(DataClass), "roles": sorted(READERS), "before": -1}
    return Entry(
        kind=SEALING,
        time_ms=START_MS,
        decision=SEALING,
        mid="m-1",
        open=opened_,
        sealed=wraps,
    )


def _opens(key: ReaderKey, text: str, bound: bytes, secret: bytes) -> bool:
    try:
        return key.unwrap(unb64(text), bound, where="") == secret
    except AuthGuardError:
        return False


def entries() -> list[Entry]:
    """Return what is sealed: an action whole and in part, words of people, what nobody knows."""
    action = {
        "type": "navigate",
        "tool": "base",
        "object": "cart-1",
        "source": "dock",
        "destination": "ward-3",
        "route": ["hall"],
        "params": {"speed_mm_s": 500},
        "provenance": {"destination": "operator"},
    }
    digest = b64(sha256(b"an action").digest())
    at = START_MS + 1
    return [
        Entry(
            kind="decision",
            time_ms=at,
            decision="accept",
            mid="m-1",
            action=digest,
            state=b64(sha256(b"a state").digest()),
            open={"grant": "bring-it", "reasons": [], "approvers": [{"by": "anna"}]},
            sealed={
                "action": action,
                "findings": [],
                "now": {"utc_ms": at, "mono_ms": 7},
                "state": [{"x_mm": 1}],
            },
        ),
        Entry(
            kind="outcome",
            time_ms=at,
            decision="succeeded",
            mid="m-1",
            action=digest,
            open={"reasons": []},
            sealed={"findings": []},
        ),
        Entry(
            kind="stop",
            time_ms=at,
            decision="stop",
            mid="m-1",
            open={"by": "hand", "planner": False},
            sealed={"why": "Zo\u00eb \U0001f916", "of_tomorrow": [1]},
        ),
    ]


def rows(kept: Json) -> list[LogRow]:
    """Return the log."""
    pages, salts = Pages(), numbered()
    genesis = Entry(
        kind="genesis", time_ms=START_MS, decision="genesis", open={"format": 1, "robot": ROBOT}
    )
    append(pages, genesis, salts=b"")
    telling = told(kept)
    append(pages, telling, salts=salts(16 * len(telling.sealed)))
    cover = Cover(robot=ROBOT, keys=KEYS_AT, classes=CLASSES)
    for entry in entries():
        append_covered(pages, entry, cover, salts=salts)
    assert verify_rows(pages.kept).whole
    return pages.kept


def reading(log: list[LogRow], role: str) -> list[Json]:
    """Return what a role reads of each record behind the keys."""
    ring = KeyRing(key_of(role))
    found = []
    for row in log:
        read = ring.opened(row)
        record = read_record(read.record, where="")
        values = read_sealed(read.sealed, where="")
        found.append(
            {
                "action": record.link.action,
                "state": record.link.state,
                "open": record.open,
                "values": {n: one.value for n, one in values.items() if not n.startswith(BOX)},
            }
        )
    return found[KEYS_AT + 1 :]


def changes(log: list[LogRow]) -> list[Json]:
    """Return rows that do not open, each with the box at which that is seen."""
    found: list[Json] = []

    def case(name: str, at: int, box: str, **fields: Any) -> None:
        items = read_sealed(log[at].sealed, where="")
        value = {**items[box].value, **fields}
        items[box] = Sealed(salt=items[box].salt, value=value)
        row = replace(log[at], sealed=encode_fast(items))
        found.append({"name": name, "at": at, "box": box, "sealed": row.sealed.decode()})
        try:
            opened(row, robot=ROBOT, key_of=lambda _, data: CLASSES[data])
        except AuthGuardError:
            return
        raise AssertionError(f"it opens: {name}")

    decision, outcome, stop = KEYS_AT + 1, KEYS_AT + 2, KEYS_AT + 3
    box = read_sealed(log[stop].sealed, where="")["box.person"].value
    case("a flipped bit", stop, "box.person", text="AAAA" + box["text"][4:])
    case("another nonce", stop, "box.person", nonce=b64(bytes(12)))
    case("without its tag", stop, "box.person", text=box["text"][:-22])
    other = read_sealed(log[decision].sealed, where="")["box.person"].value
    case("the box of another record", stop, "box.person", **other)
    findings = "box.evidence+object+parameter+region"
    other = read_sealed(log[decision].sealed, where="")[findings].value
    case("the same classes, another record", outcome, findings, **other)
    return found


def sealed(kept: Json) -> Json:
    """Return everything."""
    log = rows(kept)
    spelled = [
        {"record": row.record.decode(), "sealed": row.sealed.decode(), "link": b64(row.link)}
        for row in log
    ]
    gone = [n for n in read_sealed(log[2].sealed, where="") if "region" in n]
    destroyed = without(log[2].sealed, gone, where="").decode()
    return {
        "robot": ROBOT,
        "rows": spelled,
        "keys": {str(one): b64(CLASSES[one]) for one in DataClass},
        "readers": {
            role: {
                "private": [b64(part) for part in _parts(role)],
                "public": key_of(role).public.text(),
                "classes": list(classes),
                "reads": reading(log, role),
            }
            for role, classes in READERS.items()
        },
        "refused": changes(log),
        "destroyed": {"at": 2, "sealed": destroyed, "gone": gone},
    }


def _parts(role: str) -> list[bytes]:
    """Return the private key as bytes: the seed of ML-KEM first, where there is one."""
    key = key_of(role)
    parts: list[bytes] = []
    for part in key._parts:
        raw = part.private_bytes_raw()
        parts.append(raw)
    return parts


def kept_of(path: Path) -> Json:
    """Return what was wrapped in the file that is there, by class and role."""
    if not path.is_file():
        return {}
    row = json.loads(json.loads(path.read_text())["rows"][KEYS_AT]["sealed"])
    return {
        f"{name.removeprefix(WRAP)} {wrap['role']}": wrap["text"]
        for name, item in row.items()
        for wrap in item["value"]
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "vectors"
    made = sealed(kept_of(ROOT / "vectors" / "sealed.json"))
    text = json.dumps(made, indent=1, sort_keys=True, ensure_ascii=True)
    (folder / "sealed.json").write_text(text + "\n")
