# SPDX-License-Identifier: Apache-2.0
"""What is not told is sealed for others, destroyed for everybody, or simply not there.

Source: docs/spec/sealed-fields.md#reading
"""

from __future__ import annotations

import pytest

from authguard_r.audit.closed import Closed, closed_of
from authguard_r.audit.record import Record, read_record
from fixtures.small_logs import log_of

(ROW,) = log_of(1)
ACTION = {"action.act", "action.object", "action.params", "action.regions"}


def record(*names: str) -> Record:
    """Return a record that commits to these."""
    made = read_record(ROW.record, where="")
    return Record(
        link=made.link, kind="decision", open={}, committed=dict.fromkeys(names, made.link.evidence)
    )


def test_a_record_without_boxes_has_nothing_closed() -> None:
    closed = closed_of(record("action", "state"), {"action"})
    assert (bool(closed), closed.words(), closed.why("state")) == (False, "", "")
    assert closed.plain() == {"sealed": [], "destroyed": []}


def test_a_box_that_is_there_is_sealed_and_one_that_is_not_is_destroyed() -> None:
    made = record("box.object", "box.region", "action.object", "action.regions", "why")
    closed = closed_of(made, {"box.region"})
    assert closed.words() == "[sealed: region] [destroyed: object]"
    assert closed.plain() == {"sealed": ["region"], "destroyed": ["object"]}
    assert bool(closed)


def test_a_reader_is_told_the_classes_that_it_lacks() -> None:
    made = record("box.evidence+region", "box.person", "state", "by")
    boxes = {"box.evidence+region", "box.person"}
    assert closed_of(made, boxes, has={"region"}).sealed == ("evidence", "person")
    # its keys of another mission, or of none: then all of them are said
    assert closed_of(made, boxes, has={"region", "evidence", "person"}).sealed == (
        "evidence",
        "person",
        "region",
    )


def test_what_was_sealed_together_with_a_class_that_went_is_not_said_to_be_gone() -> None:
    made = record("box.evidence+object", "box.object+person", "findings")
    assert closed_of(made, set()).destroyed == ("evidence", "object", "person")
    assert closed_of(made, set(), lost={"object", "region"}).destroyed == ("object",)
    assert closed_of(made, set(), lost={"region"}).destroyed == ("evidence", "object", "person")


def test_keys_that_were_destroyed_are_said_of_the_record_that_told_them() -> None:
    made = record("wrap.object", "wrap.region")
    assert closed_of(made, {"wrap.region"}).words() == "[destroyed: object]"
    assert not closed_of(made, {"wrap.region", "wrap.object"})


@pytest.mark.parametrize(
    ("beside", "why"),
    [
        ({"box.evidence", "box.object", "box.parameter", "box.region"}, "sealed"),
        ({"box.evidence", "box.object", "box.parameter", "action.regions"}, "sealed"),
        ({"box.evidence", "box.object", "box.parameter"}, "destroyed"),
        (set[str](), "destroyed"),
        (ACTION, ""),
    ],
)
def test_an_action_is_closed_with_any_of_its_parts(beside: set[str], why: str) -> None:
    boxes = {"box.evidence", "box.object", "box.parameter", "box.region"}
    left = boxes - ({"box.region"} if "action.regions" in beside else set())
    made = record(*ACTION, *(left if beside != ACTION else ()))
    assert closed_of(made, beside).why("action") == why


def test_a_value_is_closed_with_its_own_box_alone() -> None:
    made = record("box.evidence+region", "box.region", "state", "action.regions", "now", "dialect")
    closed = closed_of(made, {"box.evidence+region"})
    assert closed.why("state") == "sealed"
    assert closed.why("action") == "destroyed"
    assert closed.why("now") == ""  # in no box: taken out by itself
    assert closed.why("dialect") == ""  # of a class that has no box of its own here
    assert closed.why("never") == ""  # nobody committed to it


def test_what_opened_is_not_closed() -> None:
    made = record("box.evidence+region", "state", "action.regions")
    assert closed_of(made, {"box.evidence+region", "action.regions"}).why("action") == ""


def test_names_that_no_gate_writes_are_only_shown() -> None:
    made = record("box.", "box.sea+sky", "wrap.", "x")
    closed = closed_of(made, {"box.sea+sky"})
    assert closed == Closed(
        sealed=("sea", "sky"),
        destroyed=("",),
        boxes={("",): True, ("sea", "sky"): False},
        fields=("box.", "wrap.", "x"),
    )
    assert closed.why("x") == ""
