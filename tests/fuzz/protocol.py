# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of the gate's protocol: whatever comes is a message, or ends its sender.

`python3 dev.py fuzz [SECONDS]` runs it after the normalizer's. The first byte says what is tried: a
body, a stream in pieces, or a connection to a whole gate in this process. A finding is an exception
that nobody handles, a decision for somebody who was never welcomed, a client that is left behind,
or anything that takes longer than ten seconds.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import atheris

ROOT = Path(__file__).resolve().parent.parent.parent
SECONDS_FOR_ONE = 10
#: Inputs that one gate gets; its log is kept in memory.
FOR_ONE_GATE = 2_000

with atheris.instrument_imports(include=["authguard_r.wire", "authguard_r.server"]):
    import authguard_r.server.service  # noqa: F401 - instrumented at its import
    from authguard_r.audit.record import read_record
    from authguard_r.core.errors import MalformedError
    from authguard_r.wire.frames import Frame, FrameReader, raw_frame, read_body
    from authguard_r.wire.messages import BODY, ClientRole, Kind, request_bound

sys.path.insert(0, str(ROOT / "tests"))
import msgspec  # noqa: E402 - after the instrumented imports

from fixtures import frame_streams  # noqa: E402
from unit.server.demo_site import DemoGate  # noqa: E402

KINDS = tuple(Kind)
BODIES = tuple(BODY.values())
ROLES = (None, *(role for role in ClientRole if role is not ClientRole.GATE))


def body(data: bytes) -> None:
    """Read one body: what is read comes back as it went, what is not has a place."""
    kind = BODIES[data[0] % len(BODIES)]
    try:
        read = read_body(data[1:], kind)
    except MalformedError as refusal:
        if not refusal.where:
            raise RuntimeError(f"a refusal without a place: {refusal}") from refusal
        return
    if read_body(msgspec.json.encode(read), kind) != read:
        raise RuntimeError(f"{read} does not come back")


def split(data: bytes) -> None:
    """Cut one stream, whole and in pieces: the same frames and the same end."""
    role = ROLES[data[0] % len(ROLES)] or ClientRole.PLANNER
    step, stream = data[1] + 1, data[2:]
    bounds = request_bound(role)
    whole, pieces = (FrameReader(lambda kind: bounds.get(kind, 0)) for _ in range(2))
    at_once = cut(whole, [stream])
    if cut(pieces, [stream[at : at + step] for at in range(0, len(stream), step)]) != at_once:
        raise RuntimeError(f"pieces of {step} give other frames")


def cut(reader: FrameReader, chunks: list[bytes]) -> tuple[list[Frame], str]:
    """Return what a reader makes of chunks, and why it stopped."""
    frames: list[Frame] = []
    try:
        for chunk in chunks:
            reader.put(chunk)
            while (item := reader.next()) is not None:
                frames.append(item)
    except MalformedError as refusal:
        return frames, refusal.where
    return frames, ""


class Talks:
    """Connections to a gate that is replaced now and then."""

    def __init__(self) -> None:
        self._house: DemoGate | None = None
        self._left = 0
        self._unhandled: list[dict[str, Any]] = []

    def one(self, data: bytes) -> None:
        """Connect, perhaps be welcomed, say it, hang up."""
        role = ROLES[data[0] % len(ROLES)]
        step, said = data[2] + 1, spoken(data[3:]) if data[1] % 2 else data[3:]
        house = self._gate()
        house.gate.ledger.flush()
        before = house.gate.ledger.run(lambda act: act.head())[0]
        guest = house.knock(role or ClientRole.PLANNER)
        if role is not None:
            house.send(guest, streams_hello(role))
        for at in range(0, len(said), step * 64):
            with suppress(ConnectionError):
                house.send(guest, said[at : at + step * 64])
        guest.pull()
        guest.leave()
        self._require_nothing_left(house)
        if not any(item.kind is Kind.WELCOME for item in guest.got):
            self._require_no_decision(house, before)

    def begin(self) -> None:
        """Start the first gate: what is loaded for it is not the first input's fault."""
        self._gate()

    def _gate(self) -> DemoGate:
        if self._house is None or not self._left:
            if self._house is not None:
                self._house.__exit__(None, None, None)
            self._house = DemoGate(robot=False, estimator=False).__enter__()
            self._house.do(self._listen)
            self._left = FOR_ONE_GATE
        self._left -= 1
        return self._house

    def _listen(self) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: self._unhandled.append(context))

    def _require_nothing_left(self, house: DemoGate) -> None:
        house.settle()
        if self._unhandled:
            context = self._unhandled.pop()
            raise RuntimeError(f"unhandled: {context}") from context.get("exception")
        if house.service._clients or house.service._sessions or house.service._users:
            raise RuntimeError("a client is left behind")

    def _require_no_decision(self, house: DemoGate, before: int) -> None:
        house.gate.ledger.flush()
        rows = house.gate.ledger.run(lambda act: act.rows(before, 1_000))
        kinds = {read_record(row[1], where="log").kind for row in rows}
        if kinds - {"refusal"}:
            raise RuntimeError(f"somebody who was never welcomed is in the log: {kinds}")


def spoken(data: bytes) -> bytes:
    """Return frames with good headers: a byte for the kind, one for the length, then the body."""
    frames, at = b"", 0
    while at + 1 < len(data):
        size = data[at + 1]
        frames += raw_frame(KINDS[data[at] % len(KINDS)], at, data[at + 2 : at + 2 + size])
        at += 2 + size
    return frames


def streams_hello(role: ClientRole) -> bytes:
    """Return the hello of a role."""
    return raw_frame(Kind.HELLO, 0, msgspec.json.encode(frame_streams.hello(role=role)))


TALKS = Talks()
WAYS = (body, split, TALKS.one)


def one(data: bytes) -> None:
    """Try one input."""
    if len(data) >= 4:
        WAYS[data[0] % len(WAYS)](data[1:])


def seeds(folder: Path) -> None:
    """Write the published vectors as the corpus to start from."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {kind.__name__: number for number, kind in enumerate(BODIES)}
    said = [bytes((0, numbers[v["message"]])) + bytes.fromhex(v["hex"])[9:] for v in own()]
    said += [
        bytes((0, numbers[v["message"]])) + bytes.fromhex(v["hex"])
        for v in frame_streams.bodies()
        if v["message"] in numbers
    ]
    for vector in frame_streams.streams():
        whole = b"".join(map(bytes.fromhex, vector["chunks"]))
        role = 0 if vector["role"] in {None, "gate"} else ROLES.index(ClientRole(vector["role"]))
        said += [bytes((1, role, 3)) + whole, bytes((2, role, 0, 7)) + whole]
    said += [bytes((2, 0, 0, 7)) + bytes.fromhex(v["hex"]) for v in frame_streams.hellos()]
    for role in range(1, len(ROLES)):
        asked = [(v["kind"], bytes.fromhex(v["hex"])[9:]) for v in own()]
        talk = [bytes((KINDS.index(Kind(k)), len(b))) + b for k, b in asked if len(b) < 256]
        said += [bytes((2, role, 1, 7)) + part for part in talk]
    for number, data in enumerate(said):
        (folder / f"{number:04}").write_bytes(data)


def own() -> list[dict[str, Any]]:
    """Return the vectors of what clients send."""
    names = {kind.__name__ for kind in BODIES}
    return [vector for vector in frame_streams.accepted() if vector["message"] in names]


if __name__ == "__main__":
    seconds = sys.argv[1] if len(sys.argv) > 1 else "60"
    corpus = ROOT / "build" / "fuzz-protocol"
    seeds(corpus)
    TALKS.begin()
    limits = [f"-max_total_time={seconds}", f"-timeout={SECONDS_FOR_ONE}", "-max_len=16384"]
    atheris.Setup([sys.argv[0], *limits, str(corpus)], one)
    atheris.Fuzz()
