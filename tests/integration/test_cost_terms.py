# SPDX-License-Identifier: Apache-2.0
"""The benchmarks measure each term of the paper's cost equations, and add them up as it does.

Each runs here with the least effort: how long something took is not asserted, what was measured is.
Source: section "Complexity and Performance Analysis".
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import encode
from authguard_r.core.token import read_token
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import read_rows
from fixtures import scenarios

FOLDER = str(scenarios.ROOT / "benchmarks")
#: One call in each block, none before.
LEAST = (5, 1, 1, 0)
MEMORY_TERMS = {
    *("T_N.normalize", "T_N.complete"),
    *("T_P.decide", "T_P.decide_refused", "T_P.digest"),
    *("T_A.approval", "T_A.approval_cold"),
    "T_S.assess",
}
DURABLE_TERMS = {
    *("durable.accept", "durable.accept_new_state", "durable.refuse"),
    *("T_L.ledger", "turn.accept", "insert.bare"),
}
#: What is added up for every action, and what for a cold start and for an approval.
ALWAYS = ("T_N.normalize", "T_N.complete", "T_P.decide", "T_P.digest", "T_S.assess")
SUMS = {
    "total_steady": (*ALWAYS, "token.kept"),
    "total_cold": (*ALWAYS, "token.cold"),
    "total_cold_approved": (*ALWAYS, "token.cold", "T_A.approval_cold"),
}


@pytest.fixture(autouse=True)
def _benchmarks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Import the benchmarks' own modules, which are scripts beside the package."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(FOLDER)
    yield
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        if file is not None and file.startswith(FOLDER):
            del sys.modules[name]


def least() -> Any:
    from measure import Effort

    return Effort(*LEAST)


def test_every_term_in_memory_is_measured_apart() -> None:
    """Source: `eq:cost-action`, `eq:latency`, section "Threshold Approval Cost"."""
    from memory import parts, tokens

    timings = parts(least())
    assert set(timings) == MEMORY_TERMS
    timings |= tokens(least())
    assert {"token.cold", "token.kept", "token.signatures", "ed25519.verify"} <= set(timings)
    assert all(one.samples == 5 and one.p50 > 0 for one in timings.values())


def test_the_log_is_a_term_of_its_own(tmp_path: Path) -> None:
    """Source: `eq:cost-action`, `eq:latency`."""
    from durable import turns

    timings = turns(tmp_path, least())
    assert set(timings) == DURABLE_TERMS
    assert all(one.samples == 5 and one.p50 > 0 for one in timings.values())
    kinds = [kind_of(row.record) for row in read_rows(tmp_path / "turns.db")]
    # accepted twice, refused, recorded once by itself, five times each, and once beforehand
    assert kinds.count("decision") == 5 * 4 + 1
    assert kinds.count("outcome") == 5 * 2 + 1


def kind_of(record: bytes) -> str:
    return str(msgspec.json.decode(record)["kind"])


@pytest.mark.parametrize("key", SUMS)
def test_the_latency_of_one_action_is_the_sum_of_its_terms(key: str) -> None:
    """Source: `eq:latency`; each term is a power of two, so that the sum shows which are in it."""
    from figures import figures
    from measure import timing_of

    class Made(dict[str, Any]):
        """Timings by name: what is not given took as long as nothing that is added up."""

        def __missing__(self, name: str) -> Any:
            return timing_of([[1]] * 5)

    names = sorted({name for terms in SUMS.values() for name in terms})
    made = Made({name: timing_of([[2 << place]] * 5) for place, name in enumerate(names)})
    made |= {"T_L.ledger": timing_of([[2 << 20]] * 5), "insert.bare": timing_of([[1 << 20]] * 5)}
    revoked = {"count": 1, "kept_before": True, "refused_next": True, "evicted": True}
    revoked |= {"command_p50_us": 1.0, "next_refusal_p50_us": 1.0}
    (figure,) = [one for one in figures(made, revoked) if one.id == key]
    terms = sum(2 << names.index(name) for name in SUMS[key])
    assert figure.value == (terms + (1 << 20)) / 1e6
    assert set(figure.of) == {*SUMS[key], "T_L.ledger", "insert.bare"}


@pytest.mark.parametrize("length", [1, 3])
def test_a_cold_plan_verifies_its_token_once_however_long_it_is(length: int) -> None:
    """Source: `eq:amortized`; the signed snapshot of each step is verified, too."""
    from durable import MID, _counting, _plan
    from scene import bench, long_mission

    trust = _counting(scenarios.trust_folder())
    held = bench(MemoryStore(), trust=trust)
    held.gate.management.activate(long_mission(MID))
    before = trust.verifications
    assert _plan(held, length)() > 0
    assert trust.verifications == before + 1 + length
    assert held.machine.dispatches == length


def test_plans_of_each_length_are_measured_beside_as_many_bare_inserts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Source: `eq:amortized`."""
    import durable

    monkeypatch.setattr(durable, "LENGTHS", (1, 2))
    timings = durable.plans(tmp_path, least())
    assert set(timings) == {"plan.1", "plan.2", "insert.bare.1", "insert.bare.2"}
    kinds = [kind_of(row.record) for row in read_rows(tmp_path / "plans.db")]
    # five timed and one to warm up, of each length
    assert kinds.count("decision") == 6 * (1 + 2)


def test_a_token_is_its_mission_its_signature_its_certificates_and_a_constant() -> None:
    """Source: section "Token and Log Size"."""
    mission = scenarios.mission()
    longer = msgspec.structs.replace(mission, task=mission.task * 3)
    assert len(encode(longer)) > len(encode(mission)) + 20
    assert rest_of(scenarios.token(longer)) == rest_of(scenarios.token(mission))


def rest_of(data: bytes) -> int:
    """Return the bytes of a token beside its mission, signature and certificates."""
    token = read_token(data)
    (endorsement,) = token.endorsements
    parts = (token.payload, endorsement.signature, *endorsement.chain)
    return len(data) - sum(map(len, parts))


def bytes_of(path: Path, kind: str) -> list[list[int]]:
    """Return the bytes of each record of a kind: its open part, its sealed part, its link."""
    return [
        [len(row.record), len(row.sealed), len(row.link)]
        for row in read_rows(path)
        if kind_of(row.record) == kind
    ]


def test_sizes_are_those_of_the_token_and_of_a_log_that_grows_with_each_action(
    tmp_path: Path,
) -> None:
    """Source: section "Token and Log Size"."""
    from durable import sizes
    from log_cost import storage

    found, path = sizes(tmp_path), tmp_path / "sizes.db"
    assert found["token_bytes"] == len(scenarios.token())
    assert found["mission_payload_bytes"] == len(encode(scenarios.mission()))
    kinds = {kind: bytes_of(path, kind) for kind in ("decision", "outcome")}
    assert [len(records) for records in kinds.values()] == [100, 100]
    total = sum(sum(record) for records in kinds.values() for record in records)
    assert found["log_bytes_100_actions"] == total
    each = found["decision_record_bytes"] + found["outcome_record_bytes"]
    assert abs(total - 100 * each) < total // 20
    assert found["file_growth_bytes_100_actions"] >= total

    told = {row["what"]: row for row in storage(tmp_path, path, 200)}
    for kind in kinds:
        records = bytes_of(tmp_path / "mission.db", kind)
        row = told[f"one {kind}'s record, in the mean"]
        means = [round(sum(part) / len(records)) for part in zip(*records, strict=True)]
        assert [row["open"], row["sealed"], row["link"]] == means
        assert row["link"] == 32
    assert told["one action of it"]["open"] > told["one decision's record, in the mean"]["open"]


def test_a_sealed_record_is_measured_beside_the_same_one_in_the_open(tmp_path: Path) -> None:
    """Source: section "Token and Log Size"."""
    from log_cost import sealed

    timings, told = sealed(tmp_path, least())
    assert set(timings) == {"log.sealed", "log.plain"}
    rows = {row["what"]: row for row in told}
    for name in ("sealed", "plain"):
        records = bytes_of(tmp_path / f"{name}.db", "decision")
        row = rows[f"one decision's record, {name}"]
        means = [round(sum(part) / len(records)) for part in zip(*records, strict=True)]
        assert [row["open"], row["sealed"], row["link"]] == means
    assert b'"influences"' not in sealed_values(tmp_path / "sealed.db")
    assert b'"influences"' in sealed_values(tmp_path / "plain.db")


def sealed_values(path: Path) -> bytes:
    return b"".join(row.sealed for row in read_rows(path))
