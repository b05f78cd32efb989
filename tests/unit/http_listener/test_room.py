# SPDX-License-Identifier: Apache-2.0
"""Who has to go when too many are connected, and how many files a listener takes.

Source: docs/spec/listeners.md
"""

from __future__ import annotations

import resource
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.errors import EnvironmentFault
from authguard_r.integrations.http_listener.admission import (
    LEAST,
    RESERVE,
    AdmissionControl,
    AdmissionLimits,
    fitting,
)

LIMITS = AdmissionLimits(connections=512, body=0)
ACTS = st.sampled_from(["enter", "serve", "rest", "leave", "stir"])


def test_the_stranger_who_came_first_goes_first() -> None:
    room: AdmissionControl[str] = AdmissionControl(3)
    assert [room.enter(name) for name in "abc"] == [None] * 3
    assert [room.enter(name) for name in "defg"] == ["a", "b", "c", "d"]
    room.stir("e")
    assert room.enter("h") == "f"


def test_whose_request_was_let_in_stays_until_it_is_answered() -> None:
    room: AdmissionControl[str] = AdmissionControl(2)
    room.enter("known")
    room.serve("known")
    for name in "abc":
        assert room.enter(name) != "known"
    room.rest("known")
    assert room.enter("d") == "c"  # after all strangers
    room.serve("d")
    assert room.enter("e") == "known"


def test_when_all_are_served_the_one_who_comes_goes() -> None:
    room: AdmissionControl[str] = AdmissionControl(2)
    for name in "ab":
        room.enter(name)
        room.serve(name)
    assert room.enter("c") == "c"
    assert room.spare() is None
    room.leave("a")
    assert room.enter("c") is None


def test_who_is_gone_is_neither_served_nor_at_rest() -> None:
    room: AdmissionControl[str] = AdmissionControl(1)
    room.enter("a")
    room.leave("a")
    room.serve("a")
    room.rest("a")
    room.stir("a")
    assert room.guests == ()


@given(st.lists(st.tuples(ACTS, st.integers(0, 9))))
def test_there_are_never_more_than_may_be_and_nobody_twice(acts: list[tuple[str, int]]) -> None:
    room: AdmissionControl[int] = AdmissionControl(4)
    for act, who in acts:
        if act != "enter":
            getattr(room, act)(who)
        elif who not in room.guests:
            served = set(room._served)
            assert room.enter(who) not in served
        assert len(room.guests) == len(set(room.guests)) <= 4


@pytest.fixture
def files() -> Iterator[tuple[int, int]]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield before
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_process_that_may_is_allowed_more_files(files: tuple[int, int]) -> None:
    _, hard = files
    resource.setrlimit(resource.RLIMIT_NOFILE, (200, hard))
    assert fitting(LIMITS) == LIMITS
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] >= LIMITS.connections + RESERVE


def test_a_process_that_may_not_takes_fewer_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)
    for files, expected in [(300, range(LEAST, 300 - RESERVE)), (resource.RLIM_INFINITY, [512])]:
        limits = (files, files)
        monkeypatch.setattr(resource, "getrlimit", lambda _, limits=limits: limits)
        assert fitting(LIMITS).connections in expected
    monkeypatch.setattr(resource, "getrlimit", lambda _: (RESERVE, RESERVE))
    with pytest.raises(EnvironmentFault, match="ulimit -n"):
        fitting(LIMITS)
