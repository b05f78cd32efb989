# SPDX-License-Identifier: Apache-2.0
"""What a log may teach: a whole one, marked `shadow`, and of it only what can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import Entry, LogRow
from authguard_r.authoring.onboarding import evidence
from authguard_r.authoring.onboarding.evidence import MAX_PLAN, ShadowEvidence, gather
from authguard_r.core.encoding import b64
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.provenance import Label
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Dialect
from authguard_r.provenance.context import Influence
from fixtures import scenarios
from fixtures import shadow_logs as logs

GO = scenarios.navigate("dock", "pharmacy")
NOTICE = Influence(
    field="destination",
    value="station-103",
    channel="camera",
    label=Label.CAMERA,
    evidence=logs.EVIDENCE,
)


def gathered(folder: Path, *entries: Entry, first: Entry | None = None) -> ShadowEvidence:
    return gather(logs.rows(folder, *entries, first=first), scenarios.site())


def test_decisions_and_raw_plans_are_taken_with_place_and_influences(tmp_path: Path) -> None:
    found = gathered(
        tmp_path,
        logs.decided(GO),
        logs.decided(scenarios.navigate("pharmacy", "station-103"), influences=(NOTICE,)),
        logs.refused("go()", dialect="calls"),
    )
    assert (found.log.whole, found.log.size, found.robot) == (True, 4, scenarios.RID)
    first, second = found.proposed
    assert (first.seq, first.action, first.place, first.influences) == (
        1,
        GO,
        frozenset({"dock"}),
        (),
    )
    assert second.influences == (NOTICE,)
    (plan,) = found.plans
    assert (plan.seq, plan.data, plan.dialect) == (3, b"go()", Dialect.CALLS)
    assert found.unused == ()


@pytest.mark.parametrize("marks", [{}, {"mode": "enforce"}, {"mode": True}, {"shadow": "shadow"}])
def test_what_is_not_marked_shadow_is_never_learned_from(tmp_path: Path, marks: Any) -> None:
    found = gathered(
        tmp_path,
        logs.decided(GO),
        logs.decided(scenarios.navigate("dock", "office-1"), marks=marks),
        logs.refused("go()", marks=marks),
    )
    assert [item.seq for item in found.proposed] == [1]
    assert [(item.seq, item.why) for item in found.unused] == [
        (2, "not marked `shadow`"),
        (3, "not marked `shadow`"),
    ]
    (tmp_path / "shadow.db").unlink()
    with pytest.raises(RefusedError, match="no record is marked"):
        gathered(tmp_path, logs.decided(GO, marks=marks), logs.refused("go()", marks=marks))


def test_an_empty_log_and_one_of_other_records_teach_nothing(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="no record is marked"):
        gather((), scenarios.site())
    with pytest.raises(RefusedError, match="no record is marked"):
        gathered(tmp_path)


@pytest.mark.parametrize("what", ["changed", "dropped", "swapped", "sealed", "rubbish"])
def test_a_log_that_is_not_whole_is_refused(tmp_path: Path, what: str) -> None:
    rows = logs.rows(tmp_path, logs.decided(GO), logs.refused("go()"), logs.decided(GO))
    changed = {
        "changed": [*rows[:1], edited(rows[1], b'"accept"', b'"reject"'), *rows[2:]],
        "dropped": [*rows[:1], *rows[2:]],
        "swapped": [rows[0], rows[2], rows[1], rows[3]],
        "sealed": [*rows[:1], sealed(rows[1], b'"pharmacy"', b'"office-1"'), *rows[2:]],
        "rubbish": [*rows, LogRow(4, b"{}", b"\xff", bytes(32))],
    }[what]
    with pytest.raises(RefusedError) as caught:
        gather(changed, scenarios.site())
    assert caught.value.reason is Reason.STORE_CORRUPT
    assert caught.value.where.startswith("record")


def edited(row: LogRow, old: bytes, new: bytes) -> LogRow:
    assert old in row.record
    return msgspec.structs.replace(row, record=row.record.replace(old, new))


def sealed(row: LogRow, old: bytes, new: bytes) -> LogRow:
    assert old in row.sealed
    return msgspec.structs.replace(row, sealed=row.sealed.replace(old, new))


def with_value(entry: Entry, name: str, value: Any) -> Entry:
    """Return the entry with one sealed value replaced, or taken away."""
    values = {**entry.sealed, name: value}
    kept = {name: value for name, value in values.items() if value is not None}
    return msgspec.structs.replace(entry, sealed=kept)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("action", None, "`action` is not there"),
        ("action", "go", "a mapping"),
        ("action", {"type": "navigate", "tool": "base", "extra": 1}, "extra"),
        ("action", {"type": "fly", "tool": "base"}, "granted"),
        ("action", {"type": "set_pose", "tool": "base"}, "granted"),
        ("action", {"type": "navigate", "tool": "base", "destination": "cellar"}, "region"),
        ("action", {"type": "navigate", "tool": "base", "route": ["cellar"]}, "region"),
        ("action", {"type": "navigate", "tool": "base", "object": "package-p1"}, "field"),
        ("action", {"type": "pick", "tool": "gripper", "object": "crown"}, "object"),
        ("action", {"type": "wait", "tool": "base", "params": {"speed_mm_s": 1}}, "parameter"),
        ("influences", [{"field": "destination"}], "required"),
        ("state", [{"snapshot": {"robot": "x"}}], "required"),
    ],
)
def test_a_decision_that_cannot_be_read_is_left_out_with_its_reason(
    tmp_path: Path, name: str, value: Any, why: str
) -> None:
    bad = with_value(logs.decided(GO), name, value)
    found = gathered(tmp_path, logs.decided(GO), bad)
    assert [item.seq for item in found.proposed] == [1]
    ((seq, told),) = [(item.seq, item.why) for item in found.unused]
    assert seq == 2
    assert why in told


@pytest.mark.parametrize(
    ("sealed_values", "why"),
    [
        ({"plan": None}, "`plan` is not there"),
        ({"plan": 3}, "at most"),
        ({"plan": "A" * (MAX_PLAN * 2 + 1)}, "at most"),
        ({"plan": "not base64!"}, "base64url"),
        ({"dialect": "klingon"}, "klingon"),
        ({"dialect": 3}, "expected"),
        ({"plan": b64(bytes(MAX_PLAN + 1))}, "at most"),
    ],
)
def test_a_plan_that_cannot_be_read_is_left_out_with_its_reason(
    tmp_path: Path, sealed_values: dict[str, Any], why: str
) -> None:
    found = gathered(tmp_path, logs.refused("go()", **sealed_values))
    assert found.plans == ()
    assert [item.seq for item in found.unused] == [1]
    assert why in found.unused[0].why


def test_refusals_that_a_gate_only_counted_are_said_to_be_missing(tmp_path: Path) -> None:
    counted = logs.marked(
        Entry(
            kind="refusal",
            time_ms=scenarios.START_MS,
            decision="counted",
            open={"repeats": 7, "reasons": ["TOOL_UNKNOWN"]},
            sealed={"where": "plan"},
        )
    )
    found = gathered(tmp_path, counted)
    assert (found.plans, [item.seq for item in found.unused]) == ((), [1])
    assert "counted" in found.unused[0].why


def test_actions_in_the_words_of_another_site_are_left_out_and_plans_are_not(
    tmp_path: Path,
) -> None:
    other = msgspec.structs.replace(scenarios.site(), version=2)
    found = gathered(tmp_path, logs.decided(GO), logs.refused("go()"), first=logs.genesis(other))
    assert (found.proposed, len(found.plans)) == ((), 1)
    assert "another site" in found.unused[0].why


def test_a_robot_that_the_site_does_not_have_is_not_named(tmp_path: Path) -> None:
    found = gathered(tmp_path, logs.decided(GO), first=logs.genesis(robot="stranger-9"))
    assert (found.robot, found.proposed[0].place) == (None, frozenset())


def test_a_value_that_was_destroyed_leaves_the_rest(tmp_path: Path) -> None:
    rows = logs.rows(tmp_path, logs.decided(GO), logs.refused("go()"))
    bare = msgspec.structs.replace(rows[2], sealed=b"{}")
    found = gather([*rows[:2], bare], scenarios.site())
    assert (len(found.proposed), found.plans) == (1, ())


def test_more_than_is_learned_from_at_once_is_refused_or_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = logs.rows(tmp_path, *(logs.refused("go()") for _ in range(3)))
    monkeypatch.setattr(evidence, "MAX_PLANS", 8)
    found = gather(rows, scenarios.site())
    assert ([p.seq for p in found.plans], [u.seq for u in found.unused]) == ([1, 2], [3])
    monkeypatch.setattr(evidence, "MAX_RECORDS", 2)
    with pytest.raises(MalformedError) as caught:
        gather(rows, scenarios.site())
    assert caught.value.reason is Reason.INPUT_TOO_LARGE
