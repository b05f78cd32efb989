# SPDX-License-Identifier: Apache-2.0
"""The layout of `src/` keeps to its bounds, and a bound follows the code when the code shrinks."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import layout


def contracts_hold(sources: Path) -> tuple[int, str]:
    """Run the import contracts on a copy of the sources; return exit code and output."""
    path = Path(sys.executable).parent / "lint-imports"
    ran = subprocess.run(
        [path, "--no-cache", "--config", layout.ROOT / "pyproject.toml"],
        env={"PYTHONPATH": str(sources), "PATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    return ran.returncode, ran.stdout + ran.stderr


def test_an_import_that_a_part_may_not_have_is_seen(tmp_path: Path) -> None:
    """Drafting proposes; a draft that reads the store would be no proposal any more."""
    copy = tmp_path / "src"
    shutil.copytree(layout.SRC, copy, ignore=shutil.ignore_patterns("__pycache__"))
    module = copy / "authguard_r" / "authoring" / "drafting" / "plan.py"
    module.write_text(module.read_text() + "\nimport authguard_r.store.sqlite\n")
    code, said = contracts_hold(copy)
    assert code == 1
    assert "drafting imports the site and the core BROKEN" in said


def test_every_integration_connects_to_a_gate_by_the_one_reconnecting_client() -> None:
    """A connection of its own would have its own waits, its own checks and its own faults."""
    connects = re.compile(r"GateClient\.connect|open_unix_connection|AF_UNIX")
    found = [
        str(path.relative_to(layout.ROOT))
        for path in (layout.SRC / "authguard_r" / "integrations").rglob("*.py")
        if connects.search(path.read_text())
    ]
    assert found == []


def test_the_layout_keeps_to_its_bounds_and_the_bounds_follow_it() -> None:
    bounds, measures = layout.bounds(), layout.measures()
    assert set(bounds) == set(measures)
    faults: list[str] = []
    for name, counted in measures.items():
        slack = layout.SLACK if name.endswith("_lines") else 0
        if len(counted) > bounds[name]:
            shown = [] if slack else sorted(counted)
            faults.append(f"{name} is {len(counted)}, at most {bounds[name]} {shown}")
        elif len(counted) < bounds[name] - slack:
            faults.append(f"lower `{name}` in tests/layout.toml to {len(counted)}")
    assert not faults, "\n".join(faults)
