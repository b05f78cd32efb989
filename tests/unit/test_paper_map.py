# SPDX-License-Identifier: Apache-2.0
"""The map of the paper is complete and true.

Every label has a row, everything named exists, and the tests of a row reach its code; when a test
reaches a module, `fixtures.reached_modules` says.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from fixtures.reached_modules import ROOT, contents, reached

pytestmark = pytest.mark.smoke

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
#: Rows about a page alone: there is no code that a test could run.
UNTESTED = ("Scope of the Proofs", "`tab:gap`")
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


def files(cell: str) -> list[str]:
    """Return the Python files that a cell names, each once."""
    paths = [item.partition("::")[0] for item in QUOTED.findall(cell)]
    return list(dict.fromkeys(path for path in paths if path.endswith(".py")))


def apart(code: str, tests: str) -> list[str]:
    """Return the files of a row's two cells that have nothing to do with the other cell."""
    modules = {name: ROOT / name for name in files(code)}
    found = {name: reached(ROOT / name) for name in files(tests)}
    every = frozenset[Path]().union(*found.values())
    unreached = [name for name, path in modules.items() if path not in every]
    return unreached + [name for name, mine in found.items() if mine.isdisjoint(modules.values())]


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
    sources = [item for item in named(1) if item.startswith(("src/", "packages/"))]
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


def test_every_row_with_code_names_a_test() -> None:
    assert tuple(row[0] for row in rows() if not files(row[2])) == UNTESTED


def test_every_test_reaches_code_of_its_row_and_all_code_is_reached() -> None:
    found = {row[0]: apart(row[1], row[2]) for row in rows() if row[0] not in UNTESTED}
    assert {row: names for row, names in found.items() if names} == {}


ATTACKS = "packages/missionpair/src/missionpair"
SCORE, ITS_TEST = f"{ATTACKS}/score.py", "tests/unit/missionpair/test_score.py"
TABLES, GAME = f"{ATTACKS}/report/paper.py", "tests/games/test_cross_robot_game.py"


@pytest.mark.parametrize(
    ("code", "tests", "found"),
    [
        ((SCORE,), (ITS_TEST,), []),
        # neither reaches the other
        ((SCORE,), (GAME,), [SCORE, GAME]),
        # a test too many
        ((SCORE,), (ITS_TEST, GAME), [GAME]),
        # code that no test of the row reaches
        ((SCORE, TABLES), (ITS_TEST,), [TABLES]),
        # what is no test
        ((SCORE,), (".ci/run",), [SCORE]),
        ((SCORE,), (), [SCORE]),
    ],
)
def test_a_row_whose_tests_do_not_reach_its_code_would_be_seen(
    code: tuple[str, ...], tests: tuple[str, ...], found: list[str]
) -> None:
    symbols_of = ", ".join(f"`{path}::name`" for path in code)
    tests_of = ", ".join(f"`{path}::test_name`" for path in tests)
    assert apart(symbols_of, tests_of) == found


@pytest.mark.parametrize(
    ("module", "test"),
    [
        (SCORE, ITS_TEST),
        # through a helper
        ("src/authguard_r/server/wiring.py", GAME),
        # through one module of ours
        ("src/authguard_r/enforcement/enforcer.py", GAME),
        # through a package
        ("src/authguard_reference/deviation.py", "tests/unit/core/test_edges.py"),
        # as a command in this process, as one in another process, and as a program's text
        ("src/authguard_r/cli/demo_story.py", "tests/cli/test_cli.py"),
        ("src/authguard_r/server/process.py", "tests/integration/test_gate_watching.py"),
        (f"{ATTACKS}/tables.py", "tests/cli/test_missionpair.py"),
    ],
)
def test_a_module_is_reached(module: str, test: str) -> None:
    assert ROOT / module in reached(ROOT / test)


def test_a_module_behind_two_others_is_not_reached() -> None:
    way = ["server/wiring.py", "enforcement/enforcer.py", "core/decide.py"]
    first, second, third = (ROOT / "src" / "authguard_r" / part for part in way)
    assert second in contents(first).imports
    assert third in contents(second).imports
    assert third not in reached(ROOT / GAME)
