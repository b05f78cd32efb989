# SPDX-License-Identifier: Apache-2.0
"""A gate and its witnesses: one that is ahead stops it, one that is away makes it wait."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from authguard_r.anchoring.anchor import SILENT, WHAT, StoreAnchor
from authguard_r.anchoring.checkpoint_scheduler import CheckpointPolicy, CheckpointScheduler
from authguard_r.anchoring.checkpoints import CHECKPOINT, NEWEST, WITNESSED
from authguard_r.anchoring.evidence import Discrepancy
from authguard_r.anchoring.places import WitnessPlace, require_place
from authguard_r.anchoring.quorum import WitnessPolicy
from authguard_r.anchoring.witnesses import (
    NOTHING,
    Courier,
    WitnessReply,
    cosignature,
    cosigned,
    exchange,
    request,
)
from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import Note, NoteSignature, encode64, read_note, signature_lines
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, StoreClaim, Verb
from authguard_r.keys.notes import cosign, verify_note
from authguard_r.operations.simulation import Simulation
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from fixtures.gate_process import PATIENCE_S, until
from fixtures.restarting_gate import copied, signer
from fixtures.slow_witness import KINDS, SlowWitness
from fixtures.small_witness import ORIGIN, SIZE, SmallWitness, begin, log_keys, policy

GO = scenarios.navigate("dock", "pharmacy")
#: Of an exchange with a slow witness, and how much later it may be over, in seconds: the witness
#: would keep it for far longer.
LIMIT_S, MARGIN_S = 0.5, 10.0
#: A name of many addresses.
MANY = "many.example"


@pytest.fixture
def one() -> Iterator[SmallWitness]:
    with SmallWitness("one") as witness:
        yield witness


@pytest.fixture
def two() -> Iterator[SmallWitness]:
    with SmallWitness("two") as witness:
        yield witness


def irreversible() -> bytes:
    made = scenarios.mission()
    grants = tuple(msgspec.structs.replace(grant, irreversible=True) for grant in made.actions)
    changed = msgspec.structs.replace(made, actions=grants, expiry="2199-01-01T00:00:00Z")
    return scenarios.token(changed)


def held(sim: Simulation, key: str = NEWEST) -> Note:
    data = sim.gate.ledger.peek(lambda turn: turn.get(CHECKPOINT, key))
    assert data
    return read_note(data, where="")


def witness(sim: Simulation) -> dict[str, Any]:
    told = sim.gate.anchor.shown()["witness"]
    assert isinstance(told, dict)
    return told


def states(sim: Simulation) -> list[str]:
    return [one["state"] for one in witness(sim)["witnesses"]]


def settled(sim: Simulation) -> list[Any]:
    """Let the gate's timer run until no witness has a request; return what it told."""
    found: list[Any] = []
    quorum = sim.gate.anchor._scheduler._quorum  # type: ignore[union-attr]

    def still() -> bool:
        found.extend(sim.gate.anchor.tick())
        return not quorum._away()

    until(still, "the witnesses' answers")
    return found


def grow(sim: Simulation) -> None:
    """Let a minute pass, in which something is recorded."""
    sim.gate.enforcer.stop(by="person", is_planner=False)
    sim.robot.pause(60_000)


def ended(sim: Simulation) -> MemoryStore:
    """Return what is on disk after a clean end."""
    store = sim.gate.ledger.store
    assert isinstance(store, MemoryStore)
    sim.gate.ledger.flush(everything=True)
    sim.gate.anchor.end()
    made = copied(store)
    sim.gate.close()
    return made


def accept(sim: Simulation) -> None:
    shown = sim.gate.anchor.shown()
    size, head = sim.gate.ledger.peek(lambda turn: turn.head())
    value = Command(
        verb=Verb.ACCEPT_STORE,
        mid=scenarios.RID,
        version=1,
        mission=shown["store"],
        nonce=b64(scenarios.random_bytes(16)),
        expires_ms=sim.gate.ledger.last_ms() + 60_000,
        accepts=StoreClaim(store=shown["store"], size=size, head=b64(head), number=shown["number"]),
    )
    sim.gate.management.accept_store(sign_object(value, Tag.COMMAND, signer("operator-1")))


# what is confirmed


def test_a_checkpoint_is_witnessed_once_enough_have_cosigned_it(
    one: SmallWitness, two: SmallWitness
) -> None:
    sim = begin(MemoryStore(), policy(one, two))
    assert sim.gate.anchor.why is None
    note = held(sim)
    keys = (one.named, two.named)
    assert {found.key for found in verify_note(note, keys, where="")} == set(keys)
    assert held(sim, WITNESSED) == note
    told = witness(sim)
    assert (told["quorum"], told["confirmed"], told["witnessed"]) == (2, 2, 1)
    assert told["witnessed_ms"] > 0
    assert states(sim) == ["cosigned", "cosigned"]
    grow(sim)
    assert witness(sim)["unwitnessed"] > 0
    assert settled(sim) == []
    assert (witness(sim)["unwitnessed"], one.size) == (0, two.size)
    # the second time each was told which part it knows, and the proof that led on from there
    assert one.asked[-1].startswith(b"old 1\n")


def test_one_of_two_is_enough_where_it_says_so_and_the_other_catches_up(
    one: SmallWitness, two: SmallWitness
) -> None:
    two.stop()
    sim = begin(MemoryStore(), policy(one, two, quorum=1))
    until(lambda: settled(sim) == [] and states(sim) == ["cosigned", "unreachable"], "the states")
    assert witness(sim)["witnessed"] == 1
    sim.gate.anchor._scheduler.require()  # type: ignore[union-attr]
    two.start()
    grow(sim)
    settled(sim)
    settled(sim)
    assert states(sim) == ["cosigned", "cosigned"]
    keys = (one.named, two.named)
    assert len(verify_note(held(sim), keys, where="")) == 2


def test_what_cannot_be_undone_waits_until_the_quorum_has_confirmed_since_the_start(
    one: SmallWitness,
) -> None:
    """Nothing is consumed by it, and everything else goes on."""
    one.stop()
    sim = begin(MemoryStore(), policy(one))
    sim.gate.management.activate(irreversible())
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.STORE_UNAVAILABLE
    assert report.refusal.where == "witnesses"
    assert sim.robot.trace == []
    one.start()
    sim.robot.pause(60_000)
    settled(sim)
    assert scenarios.propose(sim, GO).outcome == "succeeded"


def test_what_can_be_undone_does_not_wait(one: SmallWitness) -> None:
    one.stop()
    sim = begin(MemoryStore(), policy(one))
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    assert scenarios.propose(sim, GO).outcome == "succeeded"


def test_the_next_start_knows_what_was_witnessed_and_asks_anew(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy(one))
    grow(sim)
    settled(sim)
    store = ended(sim)
    one.stop()
    sim = begin(store, policy(one))
    told = witness(sim)
    assert (told["witnessed"], told["confirmed"]) == (one.size, 0)
    assert told["witnesses"][0]["size"] == one.size
    with pytest.raises(EnvironmentFault):
        sim.gate.anchor.ready(irreversible=True)
    one.start()
    sim.robot.pause(5_000)
    settled(sim)
    sim.gate.anchor.ready(irreversible=True)
    assert one.asked[-1].startswith(f"old {one.size}\n".encode())


def test_a_held_cosignature_that_is_forged_or_too_few_is_none(
    one: SmallWitness, two: SmallWitness
) -> None:
    sim = begin(MemoryStore(), policy(one))
    store = ended(sim)
    note = read_note(store._held[CHECKPOINT, WITNESSED], where="")
    forged = NoteSignature("one", one.named.id, bytes(72))
    store._held[CHECKPOINT, WITNESSED] = Note(note.text, (forged,)).encode()
    one.stop()
    two.stop()
    assert witness(begin(copied(store), policy(one)))["witnessed"] == 0
    store._held[CHECKPOINT, WITNESSED] = note.encode()
    told = witness(begin(store, policy(one, two)))
    assert (told["witnessed"], [w["size"] for w in told["witnesses"]]) == (0, [1, 0])


def test_a_clean_end_is_shown_to_the_witnesses(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy(one))
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    store = ended(sim)
    assert one.size == len(store._rows)


# what they say against it


def worked(*witnesses: SmallWitness) -> tuple[MemoryStore, MemoryStore]:
    """Return a store as it was and as it is; the witnesses have seen it to the end."""
    sim = begin(MemoryStore(), policy(*witnesses))
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    before = sim.gate.ledger.store
    assert isinstance(before, MemoryStore)
    kept = copied(before)
    assert scenarios.propose(sim, GO).outcome == "succeeded"
    return kept, ended(sim)


def refuses(sim: Simulation, why: Discrepancy, size: int) -> None:
    anchor = sim.gate.anchor
    assert anchor.why is why
    assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK
    assert sim.robot.trace == []
    shown = anchor.shown()
    assert (shown["state"], shown["by"], shown["counted"]) == ("put_back", "one", size)
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    opened = [msgspec.json.decode(record)["open"] for _, record, _, _ in rows]
    (alert,) = [told for told in opened if told.get("what") == WHAT]
    assert (alert["why"], alert["by"], alert["counted"]) == (str(why), "one", size)


def test_a_store_that_was_put_back_is_caught_by_a_witness_alone(one: SmallWitness) -> None:
    kept, _ = worked(one)
    sim = begin(kept, policy(one))
    refuses(sim, Discrepancy.BEHIND, one.size)
    assert states(sim) == ["ahead"]
    assert [told.details for told in sim.gate.anchor.put_back()] == [{"why": "behind", "by": "one"}]


def test_a_store_that_was_deleted_is_caught_however_long_the_new_one_is(
    one: SmallWitness,
) -> None:
    worked(one)
    refuses(begin(MemoryStore(), policy(one)), Discrepancy.BEHIND, one.size)
    sim = begin(MemoryStore(), CheckpointPolicy())
    for _ in range(one.size + 5):
        sim.gate.enforcer.stop(by="person", is_planner=False)
    sim = begin(ended(sim), policy(one))
    refuses(sim, Discrepancy.FORKED, one.size)
    assert states(sim) == ["contradicts"]


def test_another_log_of_the_same_length_is_caught(one: SmallWitness) -> None:
    _, store = worked(one)
    rows = store._rows
    rows[-1] = msgspec.structs.replace(rows[-1], link=bytes(32))
    for key in [key for key in store._held if key[0] in {"tree", CHECKPOINT}]:
        del store._held[key]
    sim = begin(store, policy(one), at_ms=scenarios.START_MS + 3_600_000)
    refuses(sim, Discrepancy.FORKED, one.size)


def test_a_witness_that_comes_late_stops_a_gate_that_serves_already(one: SmallWitness) -> None:
    kept, _ = worked(one)
    one.stop()
    sim = begin(kept, policy(one))
    assert scenarios.propose(sim, GO).outcome == "succeeded"
    one.start()
    one.instead = [(409, SIZE, b"1000\n")]  # it has seen far more than this
    sim.robot.pause(60_000)
    (told,) = settled(sim)
    assert (told.what, told.details, told.recorded) == (WHAT, {"why": "behind", "by": "one"}, True)
    assert sim.gate.anchor.why is Discrepancy.BEHIND
    assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK


def test_after_a_person_accepted_the_store_the_witness_is_lost_until_it_forgets(
    one: SmallWitness,
) -> None:
    """It goes on saying so; only the next start is stopped by it again."""
    kept, _ = worked(one)
    sim = begin(kept, policy(one))
    assert sim.gate.anchor.why is Discrepancy.BEHIND
    accept(sim)
    for _ in range(2):
        assert sim.gate.anchor.why is None
        assert settled(sim) == []
        grow(sim)
    assert sim.gate.anchor.why is None
    with pytest.raises(EnvironmentFault):
        sim.gate.anchor.ready(irreversible=True)
    store = ended(sim)
    sim = begin(store, policy(one))
    assert sim.gate.anchor.why is Discrepancy.FORKED
    accept(sim)
    one.forget()
    sim.robot.pause(60_000)
    settled(sim)
    assert states(sim) == ["cosigned"]
    sim.gate.anchor.ready(irreversible=True)
    assert begin(ended(sim), policy(one)).gate.anchor.why is None


def test_one_acceptance_is_enough_for_all_who_were_heard(
    one: SmallWitness, two: SmallWitness
) -> None:
    kept, _ = worked(one, two)
    sim = begin(kept, policy(one, two))
    assert states(sim) == ["ahead", "ahead"]
    accept(sim)
    for _ in range(2):
        assert settled(sim) == []
        grow(sim)
    assert sim.gate.anchor.why is None
    one.forget()
    sim.robot.pause(60_000)
    assert settled(sim) == []
    assert states(sim)[0] == "cosigned"


def test_a_log_that_was_accepted_against_its_own_checkpoint_is_shown_anew(
    one: SmallWitness,
) -> None:
    sim = begin(MemoryStore(), policy(one))
    store = ended(sim)
    store._held["tree", "frontier"] = b""
    sim = begin(store, policy(one))
    assert sim.gate.anchor.why is Discrepancy.CHECKPOINT_DIFFERS
    accept(sim)
    settled(sim)
    assert (sim.gate.anchor.why, states(sim)) == (None, ["cosigned"])


def test_a_crash_between_commit_and_checkpoint_is_no_rollback(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy(one))
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    store = sim.gate.ledger.store
    assert isinstance(store, MemoryStore)
    assert one.size < len(store._rows)
    sim = begin(copied(store), policy(one))
    assert (sim.gate.anchor.why, one.size) == (None, len(store._rows))


# what they say that is nothing


@pytest.mark.parametrize(
    "reply",
    [
        (404, "text/plain", b""),
        (403, "text/plain", b""),
        (500, "text/plain", b""),
        (422, "text/plain", b""),  # of a proof from nothing, which needs none
        (409, "text/html", b"3\n"),
        (409, SIZE, b"3"),
        (409, SIZE, b"03\n"),
        (409, SIZE, "\u0663\n".encode()),
        (409, SIZE, b"0\n"),
        (200, "text/plain", b""),
        (200, "text/plain", b"signed\n"),
        (200, "text/plain", b"\xff\n"),
        (200, "text/plain", signature_lines((NoteSignature("x", b"abcd", b"s"),)).encode()),
    ],
)
def test_an_answer_that_is_none_confirms_nothing_and_stops_nobody(
    one: SmallWitness, reply: tuple[int, str, bytes]
) -> None:
    one.instead = [reply]
    sim = begin(MemoryStore(), policy(one))
    assert (sim.gate.anchor.why, states(sim)) == (None, ["refuses"])
    assert witness(sim)["confirmed"] == 0
    sim.robot.pause(60_000)
    settled(sim)
    assert states(sim) == ["cosigned"]


def test_sizes_without_an_end_are_no_answer(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy())
    for _ in range(10):
        sim.gate.enforcer.stop(by="person", is_planner=False)
    one.instead = [(409, f"{SIZE}; charset=utf-8", b"%d\n" % size) for size in (1, 2, 3, 4)]
    sim = begin(ended(sim), policy(one))
    assert (sim.gate.anchor.why, states(sim)) == (None, ["refuses"])
    assert len(one.asked) == 4


def test_a_slow_witness_holds_nobody_up_and_is_asked_about_the_newest(
    one: SmallWitness, two: SmallWitness
) -> None:
    sim = begin(MemoryStore(), policy(one, two, quorum=1))
    settled(sim)
    two.open.clear()
    grow(sim)
    until(lambda: [sim.gate.anchor.tick(), witness(sim)["unwitnessed"]][1] == 0, "the first")
    until(lambda: len(two.asked) == 2, "the second's request")
    grow(sim)
    until(lambda: [sim.gate.anchor.tick(), witness(sim)["unwitnessed"]][1] == 0, "the first")
    two.open.set()
    until(lambda: [sim.gate.anchor.tick(), two.size][1] == one.size, "the second")
    settled(sim)
    assert states(sim) == ["cosigned", "cosigned"]
    assert witness(sim)["unwitnessed"] == 0


def test_one_checkpoint_goes_round_at_a_time(one: SmallWitness, two: SmallWitness) -> None:
    """Two that are never asked about the same one would never agree."""
    sim = begin(MemoryStore(), policy(one, two))
    two.open.clear()
    for _ in range(2):
        grow(sim)
        until(lambda: [sim.gate.anchor.tick(), len(two.asked)][1] == 2, "the second's request")
        until(lambda: [sim.gate.anchor.tick(), states(sim)][1][0] == "cosigned", "the first")
    assert sim.gate.anchor.tick() == ()
    until(
        lambda: [sim.gate.anchor.tick(), one.size][1] == held_size(two.asked[-1]),
        "the first at what the second was asked",
    )
    assert one.size < sim.gate.anchor.shown()["checkpoint"]
    two.open.set()
    until(lambda: [sim.gate.anchor.tick(), witness(sim)["unwitnessed"]][1] == 0, "both")
    assert one.size == two.size


def held_size(body: bytes) -> int:
    """Return the size of the checkpoint in a request."""
    text = read_note(body.partition(b"\n\n")[2], where="").text
    return read_checkpoint(text, where="").size


def test_silence_is_told_of_once_and_so_is_its_end(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy(one, silence_ms=90_000))
    one.stop()
    told: list[Any] = []
    for _ in range(3):
        grow(sim)
        told += settled(sim)
    (alert,) = told
    assert (alert.what, alert.recorded, alert.over) == (SILENT, False, False)
    assert alert.details["records"] > 0
    one.start()
    sim.robot.pause(60_000)
    over = [*settled(sim), *sim.gate.anchor.tick()]
    assert [(item.what, item.over) for item in over] == [(SILENT, True)]


def test_a_quiet_log_is_no_silence(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy(one, silence_ms=90_000))
    one.stop()
    sim.robot.pause(600_000)
    assert settled(sim) == []


def test_a_store_that_cannot_be_written_at_the_start_waits_for_its_witnesses(
    one: SmallWitness,
) -> None:
    store = MemoryStore()
    run, closed = store.run, [True]

    def full(job: Any, *, essential: bool = False) -> Any:
        def looked(turn: Turn) -> Any:
            done = job(turn)
            if closed[0] and any(kind == "tree" for kind, _ in turn.puts):  # type: ignore[attr-defined]
                raise EnvironmentFault("the disk is full", reason=Reason.STORE_FULL)
            return done

        return run(looked, essential=essential)

    store.run = full  # type: ignore[method-assign]
    sim = begin(store, policy(one))
    assert (sim.gate.anchor.why, states(sim)) == (None, ["unasked"])
    assert sim.gate.anchor.tick() == ()
    closed[0] = False
    settled(sim)
    assert states(sim) == ["cosigned"]


# the client


def place(url: str, key: str | None = None) -> WitnessPlace:
    return WitnessPlace(url=url, key=key or SmallWitness("w", ()).named.text())


@pytest.mark.parametrize(
    "url",
    [
        "https://witness.example",
        "https://witness.example:8443/a/b",
        "http://127.0.0.1:1/w",
        "http://127.9.9.9",
        "http://[::1]:80/",
    ],
)
def test_a_witness_is_asked_over_tls_or_on_this_machine(url: str) -> None:
    assert require_place(place(url), where="w").name == "w"


def test_an_address_that_leaves_this_machine_in_the_clear_is_refused() -> None:
    for url in [
        "http://witness.example",
        "http://localhost",
        "http://192.168.1.1",
        "ftp://127.0.0.1",
        "https://",
        "https://u:p@witness.example",
        "https://witness.example?x",
        "https://witness.example#x",
        "https://witness.example:0",
        "https://witness.example:99999",
        "https://[witness",
        "https://witn\u00e9ss.example",
        "https://witness.example/a b",
        "https://witness.example/a\n",
    ]:
        with case(url):
            with pytest.raises(MalformedError) as refused:
                require_place(place(url), where="w")
            assert refused.value.where == "w.url"


def test_a_key_that_cosigns_nothing_is_no_witnesss() -> None:
    good = SmallWitness("w", ()).named.text()
    for key in ("", "w", good[:-4], f" {good}", log_keys()[0].text()):
        with pytest.raises(MalformedError) as refused:
            require_place(place("https://w.example", key or "+"), where="w")
        assert refused.value.where == "w.key"


def note_of(witness: SmallWitness) -> Note:
    text = f"{ORIGIN}\n1\n{encode64(bytes(32))}\n"
    return Note(text, (NoteSignature(ORIGIN, b"abcd", b"s"),))


def test_a_cosignature_counts_once_under_its_own_key_and_over_this_text(
    one: SmallWitness, two: SmallWitness
) -> None:
    note = note_of(one)
    mine = cosign(note.text, "one", one.key, 1)
    others = cosign(note.text, "two", two.key, 1)
    of_another = cosign(note.text.replace("\n1\n", "\n2\n"), "one", one.key, 1)
    for said in ((others,), (of_another,), (of_another, mine)):
        answer = WitnessReply(200, "", signature_lines(said).encode())
        assert cosignature(answer, note, one.named) is None
    answer = WitnessReply(200, "", signature_lines((others, mine, mine)).encode())
    merged = cosignature(answer, note, one.named)
    assert merged is not None
    assert merged.signatures == (*note.signatures, mine)
    later = WitnessReply(200, "", signature_lines((cosign(note.text, "one", one.key, 2),)).encode())
    again = cosignature(later, merged, one.named)
    assert again is not None
    assert len(again.signatures) == 2
    assert [found.time_s for found in cosigned(again, (one.named, two.named))] == [2]
    assert cosigned(Note(note.text, (of_another,)), (one.named,)) == ()


def test_a_request_is_what_c2sp_says() -> None:
    note = note_of(SmallWitness("w", ()))
    hashed = encode64(bytes(32))
    assert request(7, (bytes(32),), note) == f"old 7\n{hashed}\n\n".encode() + note.encode()
    assert request(0, (), note) == b"old 0\n\n" + note.encode()
    other = NoteSignature("another witness", b"abcd", bytes(2_428))
    cosigned_too = Note(note.text, (*note.signatures, *[other] * 16))
    assert request(0, (), cosigned_too) == request(0, (), note)


def answered(url: str) -> WitnessReply:
    return exchange(urlsplit(url), b"body", time.monotonic() + PATIENCE_S)


def test_what_is_too_long_or_no_http_is_nothing(one: SmallWitness) -> None:
    url = one.place.url
    one.instead = [(200, "text/plain", bytes(LIMITS.witness_answer_bytes + 1))]
    assert answered(url) == NOTHING
    one.instead = [(200, "text/plain", bytes(LIMITS.witness_answer_bytes))]
    assert answered(url).status == 200
    assert answered(url.replace("http:", "https:")) == NOTHING  # it speaks no TLS
    one.stop()
    assert answered(url) == NOTHING


def certified(folder: Path) -> Path:
    """Return a file with a key and a certificate of this machine's address, signed by itself."""
    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([])
    now, day = datetime.now(UTC), timedelta(days=1)
    address = x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))])
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - day)
        .not_valid_after(now + day)
        .add_extension(address, critical=True)  # it has no other name
        .sign(key, hashes.SHA256())
    )
    plain = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    path = folder / "witness.pem"
    path.write_bytes(plain + made.public_bytes(Encoding.PEM))
    return path


def test_over_tls_the_machines_own_authorities_say_who_a_witness_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = certified(tmp_path)
    with SmallWitness("one", tls=file) as witness:
        stranger = begin(MemoryStore(), policy(witness))
        assert states(stranger) == ["unreachable"]
        monkeypatch.setenv("SSL_CERT_FILE", str(file))
        assert states(begin(MemoryStore(), policy(witness))) == ["cosigned"]


def test_a_witness_that_says_nothing_is_given_up_and_cut() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        courier = Courier(f"http://127.0.0.1:{server.getsockname()[1]}", limit_s=LIMIT_S)
        courier.send(b"body")
        connection, _ = server.accept()
        with connection:
            while not connection.recv(1 << 16).endswith(b"body"):
                pass
            assert until(courier.answer, "the end") == NOTHING
            assert connection.recv(1) == b""
    assert not courier.away
    assert courier.answer() is None


def test_after_its_time_nobody_is_connected_to() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = urlsplit(f"http://127.0.0.1:{server.getsockname()[1]}")
        assert exchange(url, b"body", time.monotonic()) == NOTHING
        server.setblocking(False)
        with pytest.raises(BlockingIOError):
            server.accept()


def over_in_time(url: str, body: bytes = b"body") -> None:
    """The exchange comes to nothing, long before the witness would let go."""
    began = time.monotonic()
    assert exchange(urlsplit(url), body, began + LIMIT_S) == NOTHING
    assert time.monotonic() - began < LIMIT_S + MARGIN_S


@pytest.mark.parametrize("kind", KINDS)
def test_a_witness_that_keeps_whoever_asks_is_given_up_in_time(kind: str) -> None:
    with SlowWitness(kind) as slow:
        over_in_time(slow.place.url)


@pytest.mark.parametrize("kind", ["head", "body", "endless"])
def test_a_witness_that_is_slow_inside_tls_is_given_up_in_time(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = certified(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(file))
    with SlowWitness(kind, tls=file) as slow:
        over_in_time(slow.place.url)


@pytest.mark.parametrize("is_tls", [False, True])
def test_a_witness_that_takes_a_request_in_small_pieces_is_given_up_in_time(
    is_tls: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = certified(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(file))
    with SlowWitness("deaf", tls=file if is_tls else None) as slow:
        over_in_time(slow.place.url, bytes(8 << 20))


def many_addresses(monkeypatch: pytest.MonkeyPatch, port: int, count: int) -> None:
    """Have a name that the resolver gives so many addresses."""
    there = (socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", ("127.0.0.1", port))
    asks = socket.getaddrinfo

    def resolver(host: str, *given: Any, **more: Any) -> list[Any]:
        return [there] * count if host == MANY else asks(host, *given, **more)

    monkeypatch.setattr(socket, "getaddrinfo", resolver)


def test_a_name_with_many_addresses_where_nobody_answers_is_given_up_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server, ExitStack() as held:
        port = server.getsockname()[1]
        for _ in range(4):  # its queue is full: whoever comes now is left without a word
            waiting = held.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(("127.0.0.1", port))
        many_addresses(monkeypatch, port, 200)
        over_in_time(f"http://{MANY}:{port}")


def test_the_next_address_of_a_name_is_asked_when_one_refuses(
    one: SmallWitness, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = urlsplit(one.place.url).port
    dead = (socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", ("127.0.0.2", port))
    many_addresses(monkeypatch, port or 0, 1)
    asks = socket.getaddrinfo

    def resolver(host: str, *given: Any, **more: Any) -> list[Any]:
        return [dead] * (host == MANY) + asks(host, *given, **more)

    monkeypatch.setattr(socket, "getaddrinfo", resolver)
    one.instead = [(200, "text/plain", b"here")]
    assert answered(f"http://{MANY}:{port}").body == b"here"


def carrying() -> set[threading.Thread]:
    """Return the threads that carry a request."""
    return {thread for thread in threading.enumerate() if thread.name == "witness"}


def sockets() -> set[str]:
    """Return the sockets of this process."""
    found = set()
    for name in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the folder's own
            found.add(str(name.readlink()))
    return {name for name in found if name.startswith("socket:")}


@pytest.mark.parametrize("kind", KINDS)
def test_a_slow_witness_asked_again_and_again_piles_up_neither_threads_nor_sockets(
    kind: str,
) -> None:
    others, held = carrying(), sockets()
    with SlowWitness(kind) as slow:
        courier = Courier(slow.place.url, limit_s=0.2)
        for _ in range(amount(5, 20)):
            courier.send(b"body")
            assert until(courier.answer, "the end") == NOTHING
            assert len(carrying() - others) <= LIMITS.witness_exchanges
            assert len(sockets() - held) <= LIMITS.witness_exchanges
        until(lambda: not carrying() - others, "the end of every thread")
        assert not sockets() - held


def test_a_name_that_is_looked_up_without_an_end_takes_two_threads_and_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing ends a look-up from outside: those that have not ended are counted."""
    others, found = carrying(), threading.Event()

    def resolver(*_: Any, **__: Any) -> list[Any]:
        found.wait(PATIENCE_S)
        raise socket.gaierror

    monkeypatch.setattr(socket, "getaddrinfo", resolver)
    courier = Courier("https://witness.example", limit_s=0.0)
    for _ in range(20):
        courier.send(b"body")
        assert until(courier.answer, "the end") == NOTHING
        assert len(carrying() - others) <= LIMITS.witness_exchanges
    found.set()
    until(lambda: not carrying() - others, "the end of every thread")


@pytest.mark.parametrize("quorum", [pytest.param(1, marks=pytest.mark.complete), 2])
@pytest.mark.parametrize("kind", KINDS)
def test_an_honest_witness_beside_a_slow_one_cosigns_in_the_same_round(
    kind: str, quorum: int, one: SmallWitness
) -> None:
    with SlowWitness(kind) as slow:
        places = (slow.place, one.place)  # the slow one is asked first
        asked = WitnessPolicy(places=places, quorum=quorum)
        sim = begin(MemoryStore(), CheckpointPolicy(witnesses=asked))
        assert states(sim)[1] == "cosigned"
        assert states(sim)[0] in {"unasked", "unreachable"}  # one without an end is soon over
        assert one.size == sim.gate.anchor.shown()["checkpoint"]
        assert witness(sim)["confirmed"] == 1


def test_one_request_is_on_its_way_at_a_time(one: SmallWitness) -> None:
    one.open.clear()
    courier = Courier(one.place.url)
    courier.send(b"old 0\n\n")
    with pytest.raises(RuntimeError):
        courier.send(b"old 0\n\n")
    one.open.set()
    assert until(courier.answer, "the answer") == NOTHING  # it was no request: it hangs up


def test_a_machine_without_threads_left_asks_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none)
    courier = Courier("http://127.0.0.1:1")
    courier.send(b"body")
    assert courier.answer() == NOTHING


def test_nobody_is_asked_where_no_key_signs(one: SmallWitness) -> None:
    sim = begin(MemoryStore(), policy())
    assert "witness" not in sim.gate.anchor.shown()
    ledger = sim.gate.ledger
    scheduler = CheckpointScheduler(ledger, robot=scenarios.RID, signer=None, policy=policy(one))
    keyless = StoreAnchor(ledger, robot=scenarios.RID, scheduler=scheduler)
    keyless.begin()
    assert (keyless.why, keyless.tick(), one.asked) == (None, (), [])
    with pytest.raises(EnvironmentFault):  # and what has no undo waits for ever
        keyless.ready(irreversible=True)


def test_without_a_scheduler_nothing_is_made_and_nothing_waits() -> None:
    bare = StoreAnchor(begin(MemoryStore(), policy()).gate.ledger, robot=scenarios.RID)
    bare.begin()
    bare.ready(irreversible=True)
    assert bare.covered(irreversible=True) == ()
    assert bare.tick() == ()
    assert "checkpoint" not in bare.shown()
    bare.accepted()
    bare.end()
    assert bare.why is None
