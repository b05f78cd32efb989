# SPDX-License-Identifier: Apache-2.0
"""Measures of the layout of `src/`: loose modules, loaded lines, circles, names, long code.

`python tests/layout.py` prints each measure with its bound of `tests/layout.toml`.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import grimp

from budget import ROOT, code_lines

SRC = ROOT / "src"
#: Where the modules of each distribution are.
ROOTS = (SRC, ROOT / "packages" / "missionpair" / "src")
BOUNDS = ROOT / "tests" / "layout.toml"
PACKAGES = ("authguard_r", "authguard_reference", "missionpair")
#: The programs of the gate's process and of the stop process: what they import is the trusted code.
GATE, STOP = "authguard_r.server.main", "authguard_r.estop.main"
#: The most lines of code of a module.
MODULE = 300
#: The most lines of a function, from `def` to the last line.
FUNCTION = 60
#: A measure in lines may stay this far below its bound; every other measure equals its bound.
SLACK = 100
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_OPERATORS = (ast.operator, ast.unaryop)
_LOADED = """
import sys, {module}
for name, module in sys.modules.items():
    if name.partition(".")[0] in {packages}:
        print(module.__file__)
"""


def bounds() -> dict[str, int]:
    """Return the bound of each measure."""
    return {
        name: int(number) for name, number in tomllib.loads(BOUNDS.read_text())["bounds"].items()
    }


def measures() -> dict[str, list[str]]:
    """Return what each measure counts, one text for each thing counted."""
    return {
        "loose_modules": loose_modules(),
        "gate_process_lines": lines_of(loaded(GATE)),
        "stop_process_lines": lines_of(loaded(STOP)),
        "source_lines": lines_of(sources()),
        "import_circles": [" ".join(circle) for circle in import_circles()],
        "repeated_class_names": repeated_class_names(),
        "long_functions": long_functions(),
        "long_modules": long_modules(),
        "module_numbers": module_numbers(loaded(GATE)),
        "unused_names": unused_names(),
    }


def sources() -> list[Path]:
    """Return every module of the three packages."""
    return sorted(path for root in ROOTS for path in root.rglob("*.py"))


def loose_modules() -> list[str]:
    """Return the modules at the root of `authguard_r`."""
    root = SRC / "authguard_r"
    return [path.name for path in sorted(root.glob("*.py")) if not path.name.startswith("__")]


@cache
def loaded(module: str) -> list[Path]:
    """Return the files of our packages that a fresh interpreter loads for a module."""
    program = _LOADED.format(module=module, packages=PACKAGES)
    command = [sys.executable, "-c", program]
    environment = {**os.environ, "PYTHONPATH": str(SRC)}
    printed = subprocess.check_output(command, env=environment, text=True)
    return [Path(line) for line in printed.splitlines()]


def lines_of(files: list[Path]) -> list[str]:
    """Return one text for each line of code of the files."""
    return [str(path) for path in files for _ in range(_code_lines(path))]


def import_circles() -> list[list[str]]:
    """Return the groups of modules that reach each other by imports."""
    circles: list[list[str]] = []
    for package in PACKAGES:
        graph = grimp.build_graph(package, exclude_type_checking_imports=False, cache_dir=None)
        imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
        reached = {name: _reached(name, imports) for name in imports}
        together = {
            tuple(sorted(other for other in reached[name] if name in reached[other]))
            for name in imports
        }
        circles += [list(circle) for circle in sorted(together) if len(circle) > 1]
    return circles


def repeated_class_names() -> list[str]:
    """Return the class names that more than one class has; the reference is apart."""
    names = Counter(
        node.name
        for path in sources()
        if "authguard_reference" not in path.parts
        for node in _nodes(path)
        if isinstance(node, ast.ClassDef)
    )
    return sorted(name for name, count in names.items() if count > 1)


def long_functions() -> list[str]:
    """Return the functions that are too long, each with its length."""
    return [
        f"{path.relative_to(ROOT)}:{node.name} {length}"
        for path in sources()
        for node in _nodes(path)
        if isinstance(node, _FUNCTIONS)
        and (length := (node.end_lineno or 0) - node.lineno + 1) > FUNCTION
    ]


def long_modules() -> list[str]:
    """Return the modules that are too long, each with its lines of code."""
    return [
        f"{path.relative_to(ROOT)} {length}"
        for path in sources()
        if (length := _code_lines(path)) > MODULE
    ]


def module_numbers(files: list[Path]) -> list[str]:
    """Return the numeric constants at module level."""
    return [
        f"{path.relative_to(ROOT)}:{name}"
        for path in files
        for node in _tree(path).body
        if (name := _number(node))
    ]


def unused_names() -> list[str]:
    """Return the public functions and classes that nothing uses.

    A use is a line of `src/` that reads the name, a command table's text (`"module:function"`),
    an example, a how-to, or the reference for users. Imports and `__all__` alone are none.
    """
    used = {name for path in sources() for name in _used(path)} | _documented()
    return [
        f"{path.relative_to(ROOT)}:{node.name}"
        for path in sources()
        for node in _tree(path).body
        if isinstance(node, (*_FUNCTIONS, ast.ClassDef))
        and not node.name.startswith("_")
        and not node.decorator_list
        and node.name not in used
    ]


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def _nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(_tree(path)))


@cache
def _code_lines(path: Path) -> int:
    return code_lines(path)


def _reached(start: str, imports: dict[str, set[str]]) -> set[str]:
    """Return every module that is reached from one by at least one import."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        fresh = imports[waiting.pop()] - found
        found |= fresh
        waiting += fresh
    return found


def _number(node: ast.stmt) -> str:
    """Return the name that a statement binds to a number, or nothing."""
    if isinstance(node, ast.Assign) and len(node.targets) == 1:
        target: ast.expr = node.targets[0]
    elif isinstance(node, ast.AnnAssign):
        target = node.target
    else:
        return ""
    if not isinstance(target, ast.Name) or node.value is None:
        return ""
    parts = [
        part for part in ast.walk(node.value) if not isinstance(part, (ast.operator, ast.unaryop))
    ]
    allowed = all(isinstance(part, (ast.Constant, ast.BinOp, ast.UnaryOp)) for part in parts)
    values = [part.value for part in parts if isinstance(part, ast.Constant)]
    numeric = all(
        isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
    )
    return target.id if allowed and values and numeric else ""


def _used(path: Path) -> Iterator[str]:
    """Yield every name that a module reads, and the functions that its texts name as commands."""
    for node in _nodes(path):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and ":" in node.value:
            yield node.value.rpartition(":")[2]
            yield f"{node.value.rpartition(':')[2]}_command"  # a table of commands leaves it out


def _documented() -> set[str]:
    """Return every word of the examples, the how-tos and the reference."""
    pages = [*(ROOT / "docs" / "howto").rglob("*.md"), *(ROOT / "docs" / "reference").rglob("*.md")]
    texts = [path.read_text() for path in (*pages, *(ROOT / "examples").rglob("*.py"))]
    return {word for text in texts for word in re.findall(r"\w+", text)}


if __name__ == "__main__":
    allowed = bounds()
    if unknown := set(sys.argv[1:]) - set(allowed):
        sys.exit(f"no measure {', '.join(sorted(unknown))}; the measures are: {', '.join(allowed)}")
    found = measures()
    for name, counted in found.items():
        print(f"{name:22} {len(counted):6} of {allowed[name]}")
        if name in sys.argv[1:]:
            print("  " + "\n  ".join(counted))
    sys.exit(any(len(counted) > allowed[name] for name, counted in found.items()))
