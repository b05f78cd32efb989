# SPDX-License-Identifier: Apache-2.0
"""Names become files, so they are identifiers, distinct, and nobody else's."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from authguard_r.authoring.keys.setup import Member, init_folder
from authguard_r.core.errors import EnvironmentFault
from authguard_r.keys.certificate import Role


@pytest.mark.parametrize(
    "names", [["../../escaped"], ["a", "a"], ["root"], ["people"], ["UPPER"], [""]]
)
def test_a_bad_name_writes_nothing(tmp_path: Path, names: list[str]) -> None:
    members = tuple(
        Member(id=name, role=Role.OPERATOR, robots=None, regions=None) for name in names
    )
    with pytest.raises(EnvironmentFault):
        init_folder(tmp_path / "trust", members, now=datetime.now(UTC))
    assert not (tmp_path / "trust").exists()
    assert list(tmp_path.rglob("*.pem")) == []


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "trust").write_text("mine")
    with pytest.raises(EnvironmentFault):
        init_folder(tmp_path / "trust", (), now=datetime.now(UTC))
    assert (tmp_path / "trust").read_text() == "mine"
