# SPDX-License-Identifier: Apache-2.0
"""The tools that a model is shown take what their binding reads, whatever the model's server."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import pytest

from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.cli import call
from authguard_r.integrations.tools.tool_schemas import ToolForm, tool_schemas
from authguard_r.normalize.binding import Binding, ways
from authguard_r.normalize.rebuild import call_bytes
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures.cases import case
from unit.normalize.bound import NOTED, REFUSED, fixed, load, mapped, site

WORDS = standard_words()
#: Where a tool's name and its schema stand in each form.
PLACES: dict[ToolForm, Any] = {
    ToolForm.OPENAI: lambda tool: (tool["function"]["name"], tool["function"]["parameters"]),
    ToolForm.RESPONSES: lambda tool: (tool["name"], tool["parameters"]),
    ToolForm.ANTHROPIC: lambda tool: (tool["name"], tool["input_schema"]),
    ToolForm.GEMINI: lambda tool: (tool["name"], tool["parametersJsonSchema"]),
    ToolForm.BEDROCK: lambda tool: (
        tool["toolSpec"]["name"],
        tool["toolSpec"]["inputSchema"]["json"],
    ),
    ToolForm.MCP: lambda tool: (tool["name"], tool["inputSchema"]),
}


@pytest.mark.parametrize("name", shipped_names())
def test_every_call_that_a_shipped_binding_reads_keeps_to_its_schema(name: str) -> None:
    binding = convert(binding_source(name), Binding, where=name)
    place = probe_site(binding, WORDS)
    schemas = {schema.name: schema.parameters for schema in tool_schemas(binding, place)}
    sampler, seen = Sampler(place), set()
    for way in ways(binding):
        call = sampler.call(way)
        if WORDS[way.tool.type].state_writing or call is None:
            continue
        with case(way.place):
            arguments = json.loads(call_bytes(call))["arguments"]
            jsonschema.validate(arguments, schemas[call.tool])
            with pytest.raises(jsonschema.ValidationError):
                jsonschema.validate({**arguments, "no_such_field": 1}, schemas[call.tool])
        seen.add(call.tool)
    assert seen == set(schemas)


def test_refused_fields_and_tools_that_write_state_are_not_shown() -> None:
    tools = {
        "go": {
            "type": "navigate",
            "tool": "base",
            "attested": ["source"],
            "arguments": {
                "to": mapped("destination"),
                "speed": mapped("params.speed_mm_s", per_unit="1000", optional=True, default=500),
                "mode": fixed("safe"),
                "tree": REFUSED,
                "why": NOTED,
            },
        },
    }
    place = site()
    (go,) = tool_schemas(load(tools, place), place)
    assert go.description == "Navigate, with the base."
    assert go.parameters["properties"] == {
        "to": {"type": "string", "description": "destination", "enum": [*SQUARES]},
        "speed": {
            "type": "number",
            "description": "in m/s",
            "minimum": 0.001,
            "maximum": 3,
            "default": 0.5,
        },
        "mode": {"enum": ["safe"]},
        "why": {"type": "string", "description": "why, for people"},
    }
    assert go.parameters["required"] == ["to", "mode"]
    assert go.parameters["additionalProperties"] is False


SQUARES = ("Square 1", "Square 2", "Square 3")


@pytest.mark.parametrize("form", ToolForm)
def test_each_form_has_the_same_tools(form: ToolForm, capsys: pytest.CaptureFixture[str]) -> None:
    files = ["examples/hospital/binding.yaml", "--site", "examples/hospital/site.yaml"]
    assert call(["binding", "schemas", *files, "--form", form, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["form"] == form
    listed = told["tools"]
    if form is ToolForm.GEMINI:
        ((listed,),) = (entry.values() for entry in listed)
    assert call(["binding", "schemas", *files, "--form", "mcp"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert [PLACES[form](tool) for tool in listed] == [
        (tool["name"], tool["inputSchema"]) for tool in plain
    ]


def test_a_binding_for_another_site_is_refused_with_its_place(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert call(["binding", "schemas", "spine", "--site", "examples/hospital/site.yaml"]) == 4
    told = capsys.readouterr().err
    assert "tools.explore_region.type" in told
    assert "Traceback" not in told
