# SPDX-License-Identifier: Apache-2.0
"""What a signed configuration may say of readers and retention.

Source: docs/spec/sealed-fields.md#readers
"""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.sealing.policy import (
    Reader,
    Retention,
    require_readers,
    require_retention,
)
from authguard_r.core.encoding import b64
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import DataClass
from fixtures import sealed_logs

REGION, OBJECT = DataClass.REGION, DataClass.OBJECT
READER = sealed_logs.reader("auditor")


@pytest.mark.parametrize(
    ("readers", "where"),
    [
        ((replace(READER, key="AAAA"),), "readers[0].key"),
        ((replace(READER, key=b64(bytes(32))),), "readers[0].key"),  # it keeps no secret
        ((replace(READER, key=b64(bytes(1_216))),), "readers[0].key"),
        ((READER, replace(READER, key="?")), "readers[1].key"),
        ((READER, replace(READER, role="other")), "readers"),
        ((replace(READER, classes=(REGION, OBJECT)),), "readers[0].classes"),
        ((replace(READER, classes=(REGION, REGION)),), "readers[0].classes"),
    ],
)
def test_readers_have_a_key_each_that_keeps_a_secret(
    readers: tuple[Reader, ...], where: str
) -> None:
    with pytest.raises(MalformedError) as refused:
        require_readers(readers, where="readers")
    assert refused.value.where == where


def test_readers_may_be_many() -> None:
    both = (READER, sealed_logs.reader("pq-nurse", OBJECT))
    assert [key.text() for key in require_readers(both, where="readers")] == [r.key for r in both]


@pytest.mark.parametrize(
    ("rules", "where"),
    [
        ((sealed_logs.rule(OBJECT),), "retention[0]"),  # nobody reads it: it is not sealed
        ((sealed_logs.rule(REGION, least_ms=2, most_ms=1),), "retention[0]"),
        ((sealed_logs.rule(REGION), sealed_logs.rule(REGION)), "retention"),
    ],
)
def test_retention_is_of_what_is_sealed_and_contradicts_nothing(
    rules: tuple[Retention, ...], where: str
) -> None:
    with pytest.raises(MalformedError) as refused:
        require_retention(rules, (sealed_logs.reader("porter", REGION),), where="retention")
    assert refused.value.where == where


def test_rules_of_several_classes_stand_sorted() -> None:
    rules = (sealed_logs.rule(OBJECT, least_ms=5), sealed_logs.rule(REGION, least_ms=1, most_ms=5))
    require_retention(rules, (READER,), where="retention")
    with pytest.raises(MalformedError):
        require_retention(rules[::-1], (READER,), where="retention")
