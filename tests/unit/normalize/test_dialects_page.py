# SPDX-License-Identifier: Apache-2.0
"""The page of dialects is true: every dialect has its row, and every example is read as one."""

from __future__ import annotations

import re

from authguard_r.normalize.dialects import Dialect, ReplyForm, read_reply
from authguard_r.normalize.dialects.python_code import MAX_CODE
from authguard_r.normalize.parse import MAX_CALLS, MAX_DEPTH, MAX_TEXT
from fixtures import scenarios
from fixtures.cases import case

PAGE = (scenarios.ROOT / "docs" / "spec" / "normalize.md").read_text(encoding="utf-8")
_EXAMPLE = re.compile(r"^### `(\w+)`\n\n(`{3,})\w+\n(.*?)^\2$", re.MULTILINE | re.DOTALL)
EXAMPLES = [(found[1], found[3]) for found in _EXAMPLE.finditer(PAGE)]
#: What the example of `reply` declares, as the page says.
FORM = ReplyForm(list="steps", tool="action", arguments="params", text=("thought",))


def test_every_dialect_has_its_row_and_its_example() -> None:
    named = [str(dialect) for dialect in Dialect if dialect is not Dialect.AUTO]
    table = PAGE.split("## Dialects")[1].split("###")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == named
    assert [name for name, _ in EXAMPLES] == named


def test_every_example_is_read_in_its_dialect() -> None:
    for name, text in EXAMPLES:
        with case(name, text):
            dialect = Dialect(name)
            plans = text.splitlines() if dialect is Dialect.SPINE else [text]
            for plan in plans:
                calls = read_reply(plan, dialect, FORM).calls
                reading = read_reply(plan, Dialect.AUTO, FORM)
                assert reading.calls == calls or dialect is Dialect.GO2
                assert reading.dialect is (Dialect.CALLS if dialect is Dialect.GO2 else dialect)


def test_the_limits_are_the_ones_of_the_page() -> None:
    told = PAGE.split("## Input")[1].split("## Dialects")[0]
    for limit in (f"{MAX_TEXT:,}", f"{MAX_CODE:,}", str(MAX_DEPTH), str(MAX_CALLS)):
        assert f" {limit}" in told
