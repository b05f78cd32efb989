# SPDX-License-Identifier: Apache-2.0
"""How long a log may be in one file is signed, and a configuration of before says nothing of it."""

from __future__ import annotations

import pytest

from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.server.log_maintenance import rotation_policy
from unit.server.robots import config
from unit.server.test_config import ONES, opened


@pytest.mark.parametrize("records", [0, 1_024, 1_000_000, 10**9])
def test_a_gate_moves_what_its_configuration_says(records: int) -> None:
    assert rotation_policy(opened(config(segment_records=records))).records == records


@pytest.mark.parametrize("records", [1, 256, 1_023])
def test_segments_that_are_all_but_none_are_refused(records: int) -> None:
    with pytest.raises(MalformedError) as refused:
        opened(config(segment_records=records))
    assert refused.value.where == "gate.segment_records"
    assert refused.value.reason is Reason.SCHEMA_INVALID


def test_where_a_quorum_is_wanted_only_what_it_cosigned_is_moved() -> None:
    assert not rotation_policy(opened(config())).witnessed
    assert rotation_policy(opened(config(witnesses=(ONES,), quorum=1))).witnessed


def test_a_configuration_of_before_there_were_segments_is_the_same_bytes() -> None:
    assert b"segment" not in encode_fast(config())
    assert config().segment_records == 1_000_000
