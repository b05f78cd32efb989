# SPDX-License-Identifier: Apache-2.0
"""What the tests of MissionPair share: situations, which are made once, and a small suite."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fixtures.suites import file_of, loaded
from fixtures.yards import KeptYard
from missionpair.stage import Yard


@pytest.fixture(scope="session")
def yard() -> Iterator[Yard]:
    """Where situations are made; each is put back for the next test that begins in it."""
    with KeptYard() as made:
        yield made


@pytest.fixture(scope="session")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a suite of two pairs, which is read faster than any named suite is made."""
    hand = loaded("hand")[0]
    return file_of(tmp_path_factory.mktemp("suite") / "few.jsonl", hand, *hand.pairs[:2])
