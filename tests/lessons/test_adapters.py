# SPDX-License-Identifier: Apache-2.0
"""Lesson L1 around a gate: whatever an adapter can be asked, one road moves a robot.

What each can be asked is enumerated where that adapter is tested, by tests whose names begin with
`test_l1_`; here it is held that none is without, and that there is no second road.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from authguard_r.integrations.http.operations import operations_of
from fixtures import scenarios
from fixtures.decision_point import EVALUATION, GRANTED, serving
from fixtures.gate_process import RunningGate, until

pytestmark = pytest.mark.smoke

SRC = scenarios.ROOT / "src" / "authguard_r" / "integrations"
TESTS = scenarios.ROOT / "tests"
ADAPTERS = ("mcp", "http", "functions", "tools")
#: Where each adapter is held against everything that it can be asked.
PROOFS = {
    "mcp": "test_mcp_gateway.py",
    "http": "../lessons/test_adapters.py",
    "functions.langchain": "test_adapters_langchain.py",
    "functions.openai_agents": "test_adapters_openai_agents.py",
    "functions.pydantic_ai": "test_adapters_pydantic_ai.py",
    "functions.inspect": "test_adapters_inspect.py",
}
#: Packages that run no tool.
HELPFUL = ("msgspec", "pydantic", "pydantic_core", "anyio", "typing_extensions")
#: How a client of a gate changes what is authorized; no adapter does.
ORDERS = ("activate", "command", "select", "accept_store", "shred", "revocations")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def modules(*packages: str) -> dict[str, Path]:
    found = (path for package in packages for path in (SRC / package).rglob("*.py"))
    return {".".join(p.relative_to(SRC).with_suffix("").parts): p for p in found}


def saying(*names: str) -> set[str]:
    """Return the adapters' modules that use one of these names."""
    return {
        name
        for name, path in modules(*ADAPTERS).items()
        for node in ast.walk(tree(path))
        if (isinstance(node, ast.Attribute) and node.attr in names)
        or (isinstance(node, ast.Name) and node.id in names)
    }


def foreign(path: Path) -> set[str]:
    """Return the packages that a module brings in, but for ours and Python's own."""
    named: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            named.add(node.module)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "import_module":
            named |= {word.value for word in node.args if isinstance(word, ast.Constant)}
    roots = {name.partition(".")[0] for name in named}
    return roots - {"authguard_r", *HELPFUL, *sys.stdlib_module_names}


def test_l1_every_adapter_is_held_against_everything_that_it_can_be_asked() -> None:
    frameworks = {name for name, path in modules("functions").items() if foreign(path)}
    assert frameworks | {"mcp", "http"} == set(PROOFS)
    for name, proof in PROOFS.items():
        text = (TESTS / "integration" / proof).read_text()
        assert re.search(r"^def test_l1_", text, re.MULTILINE), name


def test_l1_one_place_proposes_for_planners_and_one_drives() -> None:
    assert saying("PLANNER") == {"tools.planner", "http.process"}
    assert saying("ToolBody") == {"tools.endpoints"}
    assert saying("Driver") == {"tools.endpoints"}
    assert saying("CONTROLLER") == set()  # `client.driver` alone


def test_l1_no_adapter_gives_an_order_or_signs() -> None:
    called = {
        name
        for name, path in modules(*ADAPTERS).items()
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Attribute) and node.attr in ORDERS
    }
    assert called | saying("sign_object") == set()


@pytest.fixture(scope="module")
def house() -> Any:
    with RunningGate(simulate=True) as gate:
        gate.activate()
        with serving(gate, "--propose") as served:
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the first second")
            yield gate, served


def released(gate: RunningGate) -> list[Any]:
    return [r for r in gate.records() if r.kind == "decision" and r.open.get("ticket")]


def test_l1_every_operation_over_http_but_a_proposal_begins_nothing(house: Any) -> None:
    gate, served = house
    asked = 0
    for operation in operations_of(propose=True):
        if operation.name == "proposal":
            continue
        path = re.sub(r"\{\w+\}", "1", operation.path)
        with served.client() as client:
            body = {"json": GRANTED} if operation.method == "POST" else {}
            answer = client.request(operation.method, path, **body)
        assert answer.status_code in {200, 404}, path
        asked += 1
    assert asked > 8
    assert released(gate) == []
    call = {"tool": "scan", "arguments": {}}
    answer = served.post("/v1/proposals", call, headers={"Idempotency-Key": "go-1"})
    assert answer.status_code == 200, answer.text
    assert json.loads(answer.text)["execution"]["outcome"] == "succeeded"
    assert len(released(gate)) == 1
