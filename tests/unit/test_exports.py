# SPDX-License-Identifier: Apache-2.0
"""What the library exports is what its page names, and nothing else."""

from __future__ import annotations

import re

import pytest

import authguard_r
from fixtures.scenarios import ROOT


def test_the_page_of_the_library_names_what_is_exported() -> None:
    page = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| `(\w+)` \|", page.partition("\n## ")[0], re.MULTILINE)
    assert sorted(told) == sorted(authguard_r.__all__)
    assert [n for n in told if getattr(authguard_r, n).__name__ != n] == []
    with pytest.raises(AttributeError, match="no attribute 'decide_all'"):
        _ = authguard_r.decide_all
