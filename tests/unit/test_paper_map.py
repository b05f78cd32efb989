# SPDX-License-Identifier: Apache-2.0
"""The map of the paper is whole and true: every label has a row, everything named exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper-map.md"

#: Every label of the paper's equations, algorithms, tables, figures and definitions.
LABELS = (
    "eq:transition",
    "eq:policy-set",
    "eq:trace-auth",
    "eq:trace-safe",
    "eq:compact-action",
    "eq:action-deviation",
    "eq:plan-deviation",
    "eq:scmh",
    "eq:mission",
    "eq:signature",
    "eq:action",
    "eq:auth-predicate",
    "eq:constrained-attack",
    "eq:score",
    "eq:threshold",
    "eq:log",
    "eq:auth-bound",
    "eq:execute",
    "eq:cost-action",
    "eq:amortized",
    "eq:latency",
    "eq:uasr",
    "eq:scmhr",
    "eq:su",
    "alg:missionpair",
    "alg:authguard",
    "tab:gap",
    "tab:provenance",
    "tab:pilot-results",
    "tab:pilot-category",
    "tab:pilot-live-llm",
    "tab:pilot-adaptive-haiku",
    "tab:pilot-qwen-fixed",
    "tab:pilot-qwen-adaptive",
    "tab:pilot-crossmodel",
    "fig:architecture",
    "def:scmh",
)

#: Every statement of the paper, by its title.
STATEMENTS = (
    "Definition: Authorized action",
    "Definition: Authorized trace",
    "Definition: Safe trace",
    "Definition: Safety-compliant mission hijacking",
    "Proposition: Meaning of MissionPAIR success",
    "Theorem: Completeness of the authorization gate",
    "Theorem: Authorization soundness",
    "Lemma: Action-set non-escalation",
    "Corollary: Plan-level non-escalation",
    "Theorem: Replay resistance",
    "Theorem: Cross-robot rejection",
    "Theorem: Privileged-field noninterference",
    "Theorem: High-risk approval",
    "Theorem: Tamper evidence of the anchored log",
    "Theorem: Trace-level dual-gate soundness",
    "Corollary: Blocking safety-compliant mission hijacking",
)

#: What the paper names as a failure, and what we observe in it: a word of each row.
OBSERVED = (
    "low-battery guard",
    "availability attack",
    "t > expiry",
    "chain alone",
    "approval bypass",
    "nonce alone",
)
QUOTED = re.compile(r"`([^`]+)`")
COLUMNS = ("paper", "code", "tests", "vectors")


def rows() -> list[list[str]]:
    """Return every row's four cells."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if tuple(row) != COLUMNS and set(row[0]) != {"-"}]


def named(column: int) -> list[str]:
    return [item for row in rows() for item in QUOTED.findall(row[column])]


@cache
def symbols(path: Path) -> frozenset[str]:
    """Return the names that a module defines, and `Class.name` for each member."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        mine = _names(node)
        found |= mine
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{name}" for item in node.body for name in _names(item)}
    return frozenset(found)


def _names(node: ast.stmt) -> set[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return {node.name}
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return {node.target.id}
    if isinstance(node, ast.Assign):
        return {target.id for target in node.targets if isinstance(target, ast.Name)}
    return set()


def absent(item: str) -> bool:
    path, _, symbol = item.partition("::")
    place = ROOT / path
    if not place.is_file():
        return True
    return bool(symbol) and symbol not in symbols(place)


def test_every_row_has_four_cells() -> None:
    assert rows()
    assert [row for row in rows() if len(row) != len(COLUMNS) or not all(row)] == []


def test_every_label_of_the_paper_has_one_row() -> None:
    told = [item for item in named(0) if re.fullmatch(r"(eq|alg|tab|fig|def):[a-z-]+", item)]
    assert set(told) == set(LABELS)
    # the table that sums to ten is named a second time, as an observation
    assert sorted(told) == sorted([*LABELS, "tab:pilot-category"])


def test_every_statement_and_observation_has_a_row() -> None:
    told = [row[0] for row in rows()]
    assert [s for s in STATEMENTS if not any(row.startswith(s) for row in told)] == []
    assert [word for word in OBSERVED if not any(word in row for row in told)] == []


def test_every_symbol_of_the_code_exists() -> None:
    assert [item for item in named(1) if absent(item)] == []
    sources = [item for item in named(1) if item.startswith("src/")]
    assert all("::" in item for item in sources)


def test_every_test_exists() -> None:
    assert [item for item in named(2) if absent(item)] == []


def test_every_vector_file_exists() -> None:
    assert [item for item in named(3) if absent(item)] == []


def test_a_symbol_or_file_that_is_gone_would_be_seen() -> None:
    here = "tests/unit/test_paper_map.py"
    assert not absent(f"{here}::rows")
    assert not absent("src/authguard_r/core/finding.py::Finding.step")
    assert absent(f"{here}::gone")
    assert absent("tests/unit/gone.py")
