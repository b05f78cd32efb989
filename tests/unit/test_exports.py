# SPDX-License-Identifier: Apache-2.0
"""The public interface: what its page names, and all that examples and how-tos need."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import authguard_r
import layout
from fixtures.scenarios import ROOT

PAGE = ROOT / "docs" / "reference" / "python.md"
#: What examples and how-tos may import from: names in `__all__`.
PUBLIC = (
    "authguard_r",
    "authguard_r.client",
    "authguard_r.integrations.functions",
    "authguard_r.integrations.ros",
    "missionpair",
    "missionpair.extension",
)
#: One module for each agent framework, with a function for its tools.
FRAMEWORKS = ("inspect", "langchain", "openai_agents", "pydantic_ai")
#: Folders of plugins, which are loaded by name.
PLUGINS = {"attackers", "defenses", "domains", "planners", "suites"}
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
#: A program that a shell block writes or runs.
HEREDOC = re.compile(r"(?:\.py|python -) <<'?(\w+)'?\n(.*?)\n\1\n", re.DOTALL)


def named(part: str) -> list[str]:
    """Return the names in the first column of the first table of a part of the page."""
    rows = re.findall(r"^\| (`.*?) \|", part, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


def imports(text: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of every import of ours in a program."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)


def programs() -> Iterator[tuple[Path, str]]:
    """Yield every example, and every Python program of a page for users."""
    for path in sorted((ROOT / "examples").rglob("*.py")):
        yield path, path.read_text(encoding="utf-8")
    pages = [ROOT / "README.md", ROOT / "packages" / "missionpair" / "README.md"]
    for folder in ("howto", "reference", "tutorial"):
        pages += sorted((ROOT / "docs" / folder).rglob("*.md"))
    for path in pages:
        text = path.read_text(encoding="utf-8")
        yield from ((path, block) for block in BLOCK.findall(text))
        yield from ((path, block) for _, block in HEREDOC.findall(text))


def is_public(module: str, name: str) -> bool:
    if module == "missionpair" and name in PLUGINS:
        return True
    place, _, last = module.rpartition(".")
    if place == "authguard_r.integrations.functions" and last in FRAMEWORKS:
        return name in {"guard_agent", "guard_tools"}  # its framework may not be installed
    return module in PUBLIC and name in import_module(module).__all__


def test_the_page_of_the_library_names_what_is_exported() -> None:
    page = PAGE.read_text(encoding="utf-8")
    library, _, missionpair = page.partition("\n## MissionPAIR")
    told = named(library.partition("\n## ")[0])
    assert sorted(told) == sorted(authguard_r.__all__)
    assert sorted(named(missionpair)) == sorted(import_module("missionpair").__all__)
    assert [n for n in told if getattr(authguard_r, n).__name__ != n] == []
    with pytest.raises(AttributeError, match="no attribute 'decide_all'"):
        _ = authguard_r.decide_all


@pytest.mark.parametrize("module", ["authguard_r", "missionpair"])
def test_a_distribution_exports_ten_to_twenty_names(module: str) -> None:
    assert 10 <= len(set(import_module(module).__all__)) <= 20


@pytest.mark.parametrize(
    "module", ["authguard_r", "authguard_r.client", "missionpair", "missionpair.extension"]
)
def test_the_types_of_the_exported_names_are_those_of_their_homes(module: str) -> None:
    made = import_module(module)
    stub = Path(str(made.__file__)).with_suffix(".pyi")
    ours = ("authguard_r", "missionpair")
    typed = {name: home for home, name in imports(stub.read_text()) if home.startswith(ours)}
    assert set(typed) == set(made.__all__)
    for name, home in typed.items():
        assert getattr(import_module(home), name) is getattr(made, name)


def test_examples_and_how_tos_need_nothing_else() -> None:
    ours = ("authguard_r", "authguard_reference", "missionpair")
    found = [
        f"{path.relative_to(ROOT)}: from {module} import {name}"
        for path, text in programs()
        for module, name in imports(text)
        if module.partition(".")[0] in ours and not is_public(module, name)
    ]
    assert found == []


def test_every_other_folder_says_that_it_is_internal() -> None:
    root, silent = layout.SRC / "authguard_r", []
    for path in sorted(root.glob("*/__init__.py")):
        told = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        if path.parent.name not in {"client", "integrations"} and "Internal" not in told:
            silent.append(path.parent.name)
    assert silent == []
