# SPDX-License-Identifier: Apache-2.0
"""Planner texts, with the actions they mean or why they are refused."""

from __future__ import annotations

from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.normalize import Binder, read_plan
from fixtures import scenarios
from fixtures.decision_cases import plain

Json = dict[str, Any]


def normalize_vectors() -> Json:
    """Planner texts with the actions they mean, or the refusal and its place."""
    go = '{"tool": "navigate_to", "arguments": {"destination": "%s", "speed": %s}}'
    texts: dict[str, str] = {
        "a place by its name": go % ("Station 101", "0.8"),
        "a place by its id": go % ("station-101", "0.8"),
        "rounded against the planner": go % ("Station 101", "0.8001"),
        "by default": '{"tool": "navigate_to", "arguments": {"destination": "Dock"}}',
        "a call": 'navigate_to(destination="Station 101", speed=0.8)',
        "two calls": 'scan()\nsay(text="hello")',
        "another case": go % ("station 101", "0.8"),
        "a stray space": go % ("Station 101 ", "0.8"),
        "a homoglyph": go % ("St\u0430tion 101", "0.8"),
        "no such place": go % ("Station 999", "0.8"),
        "too fast for the type": go % ("Station 101", "3.0001"),
        "no speed at all": go % ("Station 101", "0"),
        "backwards": go % ("Station 101", "-0.8"),
        "not a number": go % ("Station 101", "NaN"),
        "a number in quotes": go % ("Station 101", '"0.8"'),
        "a truth value": go % ("Station 101", "true"),
        "a refused field": '{"tool": "navigate_to", "arguments": {"destination": "Dock", "behavior_tree": "x"}}',
        "an unknown field": '{"tool": "navigate_to", "arguments": {"destination": "Dock", "mission": "x"}}',
        "a missing field": '{"tool": "navigate_to", "arguments": {"speed": 0.5}}',
        "an unknown tool": '{"tool": "fly", "arguments": {}}',
        "one unknown tool among known ones": "scan()\nfly()",
        "what changes belief": '{"tool": "relocalize", "arguments": {"place": "Dock"}}',
        "a duplicate key": '{"tool": "scan", "tool": "wait", "arguments": {}}',
        "an extra key": '{"tool": "scan", "arguments": {}, "mission": "m"}',
        "an empty plan": '{"plan": []}',
        "prose": "I will go to Station 101.",
        "an expression": "navigate_to(destination=open('x').read())",
    }
    binder = Binder(scenarios.site(), scenarios.binding())
    vectors = []
    for name, text in texts.items():
        try:
            plan = read_plan(text.encode(), binder=binder)
            expect: Json = {"actions": [plain(step.action) for step in plan.steps]}
        except MalformedError as error:
            expect = {"refusal": {"reason": str(error.reason), "where": error.where}}
        vectors.append({"name": name, "raw": text, "expect": expect})
    return {
        "site": "examples/hospital/site.yaml",
        "binding": "examples/hospital/binding.yaml",
        "vectors": vectors,
    }
