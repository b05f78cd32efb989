# SPDX-License-Identifier: Apache-2.0
"""A replay holds each repair to the decision that it names: one that only safety refused."""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import LogRow, Record, Sealed, read_record
from authguard_r.auditor.replay.repairs import Repairs
from fixtures import scenarios
from integration.test_replay_from_log import Change, again, destroyed, forged, kinds, rows_of
from unit.safety.test_repair_runs import AROUND, GO, mission, propose, ready

#: The decisions of the log below, in order.
REFUSED, UNSAFE, REPAIR, LATER = range(4)


@cache
def repaired() -> tuple[LogRow, ...]:
    """A log: one action refused by authorization, one unsafe, its repair, and a safe action."""
    sim = ready(mission())
    propose(sim, scenarios.navigate("dock", "station-103"))
    propose(sim, GO)
    propose(sim, scenarios.navigate("pharmacy", "station-101", route=AROUND))
    return tuple(rows_of(sim))


def decided() -> list[int]:
    return kinds(list(repaired()), "decision")


def saying(**told: Any) -> Change:
    """Return a change of a record's open part; None takes a value out."""

    def change(record: Record, _: dict[str, Sealed]) -> Record:
        opened = {name: it for name, it in {**record.open, **told}.items() if it is not None}
        return msgspec.structs.replace(record, open=opened)

    return change


def action_of(seq: int) -> str:
    return str(read_record(repaired()[seq].record, where="").link.action)


def test_a_log_with_a_repair_is_decided_alike_again() -> None:
    found = again(repaired(), scenarios.trust_folder())
    assert (found.agree, found.differ) == (len(decided()), 0)
    assert len(decided()) == 4


@pytest.mark.parametrize("named", [REFUSED, REPAIR, LATER])
def test_a_repair_that_names_no_earlier_unsafe_decision_is_found(named: int) -> None:
    at, seq = decided()[REPAIR], decided()[named]
    forgery = forged(list(repaired()), at, saying(repairs=seq, repairs_action=action_of(seq)))
    assert again(forgery, scenarios.trust_folder()).differ == 1


@pytest.mark.parametrize("seq", [0, -1, -2, 10**6, True, "3", 3.5, [], {}, None])
def test_a_repair_that_names_no_decision_is_found_and_never_a_traceback(seq: Any) -> None:
    forgery = forged(list(repaired()), decided()[REPAIR], saying(repairs=seq))
    assert again(forgery, scenarios.trust_folder()).differ == 1


@pytest.mark.parametrize("action", ["other", 3, None])
def test_a_repair_of_another_action_than_the_named_one_is_found(action: Any) -> None:
    forgery = forged(list(repaired()), decided()[REPAIR], saying(repairs_action=action))
    assert again(forgery, scenarios.trust_folder()).differ == 1


def test_an_action_of_its_own_that_is_called_a_repair_is_found() -> None:
    link = saying(repairs=decided()[REFUSED], repairs_action=action_of(decided()[REFUSED]))
    forgery = forged(list(repaired()), decided()[LATER], link)
    assert again(forgery, scenarios.trust_folder()).differ == 1


def test_a_link_is_held_also_where_the_decision_itself_cannot_be_made_again() -> None:
    at = decided()[REPAIR]
    rows = destroyed(list(repaired()), at, "action")
    assert again(rows, scenarios.trust_folder()).not_replayable == 1
    forgery = forged(rows, at, saying(repairs_action="other"))
    assert again(forgery, scenarios.trust_folder()).differ == 1


def test_what_is_repaired_is_known_when_replay_begins_with_the_repair() -> None:
    first = decided()[REPAIR]
    assert again(repaired(), scenarios.trust_folder(), first=first).differ == 0


def test_a_record_before_this_part_of_a_log_is_not_missed() -> None:
    repairs = Repairs()
    assert repairs.note(read_record(repaired()[decided()[REPAIR]].record, where="")) == ""


def test_a_released_repair_has_a_record_to_name_and_one_that_was_refused_may_have_none() -> None:
    record = read_record(repaired()[decided()[REPAIR]].record, where="")
    unnamed = msgspec.structs.replace(record, open={**record.open, "repairs": -1})
    waited = msgspec.structs.replace(unnamed, open={**unnamed.open, "ticket": "-"})
    assert Repairs().note(unnamed) == "it was released, and `repairs` names no record"
    assert Repairs().note(waited) == ""
