# SPDX-License-Identifier: Apache-2.0
"""The OpenAPI document says what is read and written, and every way in which it can go wrong."""

from __future__ import annotations

import json
from typing import Any

import pytest
from starlette.routing import compile_path

from authguard_r.cli import call
from authguard_r.integrations.http.operations import ALWAYS, operations_of
from authguard_r.integrations.http.process import openapi


def read(*, propose: bool = True) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(openapi(propose=propose))
    return found


def operations(made: dict[str, Any]) -> dict[str, Any]:
    return {
        f"{method} {path}": operation
        for path, methods in made["paths"].items()
        for method, operation in methods.items()
    }


def test_every_operation_says_every_status_that_can_come() -> None:
    for name, operation in operations(read()).items():
        statuses = set(map(int, operation["responses"]))
        assert statuses >= {200, *ALWAYS}, name
        assert ("requestBody" in operation) is ({408, 413, 415} <= statuses)
        _, _, names = compile_path(name.split()[1])
        places = [p["name"] for p in operation["parameters"] if p["in"] == "path"]
        assert places == list(names)
        assert (404 in statuses) is bool(names)


def test_what_is_not_served_is_not_said() -> None:
    assert set(operations(read())) - set(operations(read(propose=False))) == {"post /v1/proposals"}
    assert len(operations(read())) == len(operations_of(propose=True))


def test_every_reference_leads_somewhere_and_every_pattern_is_portable() -> None:
    text = openapi(propose=True).decode()
    made = json.loads(text)
    named = {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]}
    assert named == set(made["components"]["schemas"])
    assert "\\\\A" not in text
    assert "\\\\Z" not in text


def test_it_is_printed_without_a_gate(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(["serve", "--openapi"]) == 0
    assert json.loads(capsys.readouterr().out) == read(propose=False)
    assert call(["serve", "--openapi", "--propose"]) == 0
    assert json.loads(capsys.readouterr().out) == read()
