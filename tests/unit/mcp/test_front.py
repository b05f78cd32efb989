# SPDX-License-Identifier: Apache-2.0
"""What a call is named, and what it holds while it waits."""

from __future__ import annotations

from typing import Any

import mcp_types as types
import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.mcp.asking import PersonAnswer, said
from authguard_r.integrations.mcp.front import KEY, named, size_of


def call(meta: dict[str, Any] | None = None, **more: Any) -> types.CallToolRequestParams:
    return types.CallToolRequestParams.model_validate({"name": "scan", "_meta": meta, **more})


def test_a_call_that_is_made_again_has_a_name_of_its_own_of_any_length() -> None:
    assert named(call(), again=False) is None
    assert named(call(), again=True) is None
    for key in ("k", "k" * 64):
        first, second = (named(call({KEY: key}), again=again) for again in (False, True))
        assert first == key
        assert second is not None
        assert (second != key, len(second)) == (True, 40)
    with pytest.raises(MalformedError, match="expected text"):
        named(call({KEY: 7}), again=False)


def test_what_cannot_be_written_down_holds_no_place() -> None:
    assert size_of({}) < size_of({"a": "b" * 100})
    with pytest.raises(MalformedError, match="not JSON"):
        size_of({"n": 10**5_000})


@pytest.mark.parametrize(
    ("action", "read"),
    [("accept", PersonAnswer.ELSE), ("decline", PersonAnswer.NO), ("cancel", PersonAnswer.NO)],
)
def test_of_a_persons_answer_only_a_no_is_read(action: str, read: PersonAnswer) -> None:
    answer = {"approval": {"action": action, "content": {}}}
    assert said(call(inputResponses=answer)) is read
    assert said(call()) is None
