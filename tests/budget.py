# SPDX-License-Identifier: Apache-2.0
"""The trusted core stays readable in an evening: at most 2,200 lines of code.

Blank lines, comments and docstrings do not count. `tests/layout.py` measures the rest.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CORE = ROOT / "src" / "authguard_r" / "core"
BUDGET = 2_200
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(path: Path) -> int:
    """Return how many lines of a module hold code."""
    text = path.read_text()
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node):
            first = node.body[0]
            documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _SILENT:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - documented)


def faults() -> list[str]:
    """Return everything that is over its budget."""
    total = sum(code_lines(path) for path in CORE.rglob("*.py"))
    return [f"core has {total} lines of code; {BUDGET} are allowed"] if total > BUDGET else []


if __name__ == "__main__":
    problems = faults()
    total = sum(code_lines(path) for path in CORE.rglob("*.py"))
    print("\n".join(problems) or f"core: {total} of {BUDGET} lines of code")
    sys.exit(1 if problems else 0)
