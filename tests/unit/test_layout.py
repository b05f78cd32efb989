# SPDX-License-Identifier: Apache-2.0
"""The layout of `src/` keeps to its bounds, and a bound follows the code when the code shrinks."""

from __future__ import annotations

import layout


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
