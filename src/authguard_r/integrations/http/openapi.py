# SPDX-License-Identifier: Apache-2.0
"""The OpenAPI document, made of the very structs that requests are read and answers written with.

Spec page: docs/spec/http.md#openapi
"""

from __future__ import annotations

import re
from typing import Any

import msgspec

from authguard_r.integrations.http.messages import Problem
from authguard_r.integrations.http.operations import Operation

_JSON = "application/json"
_TEMPLATE = "#/components/schemas/{name}"
#: One line of the `Args:` of a struct, with the lines that go on with it.
_FIELD = re.compile(r"^ {8}(\w+): (.*(?:\n {12}.*)*)", re.MULTILINE)
#: What a struct's name ends with where another part of the package has one of the same name.
_SUFFIX = "Message"
_STRUCT = re.compile(rf"\b[A-Z]\w*{_SUFFIX}(?=\")")
_STATUSES = {
    400: "The request is malformed; `where` names the place.",
    401: "Unauthorized: no token or certificate, or one that is not valid.",
    403: "Forbidden: this client may not ask here.",
    404: "There is no such thing.",
    408: "The body did not come in time.",
    413: "The body is too long.",
    415: "The body is no plain `application/json`.",
    421: "The request calls this server by a name that is not its own.",
    409: "The key named another proposal before.",
    431: "The head of the request is too long.",
    500: "A fault of this server; it is no permit.",
    503: "The gate is away, busy or in trouble; it is no permit. Ask again.",
}
#: What a question needs, in itself or in the whole request.
_NEEDED = ("subject", "action", "resource")


def document(operations: tuple[Operation, ...], *, version: str) -> bytes:
    """Return the document.

    Args:
        operations: what is served.
        version: of this program.
    """
    kinds = [kind for op in operations for kind in (*op.gives, op.takes, op.words) if kind]
    _, components = msgspec.json.schema_components((*kinds, Problem), ref_template=_TEMPLATE)
    schemas = {_public(name): _told(_portable(schema)) for name, schema in components.items()}
    _complete(schemas)
    paths: dict[str, Any] = {}
    for operation in operations:
        paths.setdefault(operation.path, {})[operation.method.lower()] = _operation(
            operation, schemas
        )
    for name in {operation.words.__name__ for operation in operations}:
        schemas.pop(name, None)  # parameters stand where they are used
    made = {
        "openapi": "3.1.0",
        "info": {
            "title": "AuthGuard-R decision point",
            "version": version,
            "description": "OpenID AuthZEN Authorization API 1.0 before a robot's gate. A permit "
            "is advice: it consumes nothing and expires immediately.",
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "security": [{"token": []}, {"certificate": []}],
        "paths": paths,
        "components": {
            "schemas": dict(sorted(schemas.items())),
            "securitySchemes": {
                "token": {"type": "http", "scheme": "bearer"},
                "certificate": {"type": "mutualTLS"},
            },
        },
    }
    named = _STRUCT.sub(lambda found: _public(found[0]), msgspec.json.encode(made).decode())
    return msgspec.json.format(named, indent=1).encode()


def _public(name: str) -> str:
    """Return the name of a struct in the document, without the suffix of our own names."""
    return name.removesuffix(_SUFFIX)


def _operation(operation: Operation, schemas: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "operationId": operation.name,
        "summary": operation.summary,
        "parameters": _parameters(operation, schemas),
        "responses": {"200": _answer(operation)}
        | {str(status): _problem(status) for status in operation.statuses},
    }
    if operation.takes is not None:
        body = {"schema": {"$ref": _TEMPLATE.format(name=operation.takes.__name__)}}
        found["requestBody"] = {"required": True, "content": {_JSON: body}}
    return found


def _parameters(operation: Operation, schemas: dict[str, Any]) -> list[dict[str, Any]]:
    found = []
    for name, schema in schemas[operation.words.__name__]["properties"].items():
        in_path = f"{{{name}}}" in operation.path
        place = "path" if in_path else "query"
        found.append({"name": name, "in": place, "required": in_path, "schema": schema})
    if operation.keyed:
        schema = {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$"}
        key = {"name": "Idempotency-Key", "in": "header", "required": True, "schema": schema}
        found.append(key)
    return found


def _answer(operation: Operation) -> dict[str, Any]:
    if operation.text:
        return {"description": "Counts.", "content": {"text/plain": {"schema": {"type": "string"}}}}
    (schemas, _) = msgspec.json.schema_components(operation.gives, ref_template=_TEMPLATE)
    schema = schemas[0] if len(schemas) == 1 else {"anyOf": list(schemas)}
    return {"description": operation.summary, "content": {_JSON: {"schema": schema}}}


def _problem(status: int) -> dict[str, Any]:
    schema = {"schema": {"$ref": _TEMPLATE.format(name=Problem.__name__)}}
    found: dict[str, Any] = {"description": _STATUSES[status], "content": {_JSON: schema}}
    if status == 503:
        found["headers"] = {"Retry-After": {"schema": {"type": "integer"}}}
    return found


def _complete(schemas: dict[str, Any]) -> None:
    """Add what a batch needs and no struct can say: each part here, or in every question."""
    batch = schemas["Evaluations"]
    several = {"required": ["evaluations"], "properties": {"evaluations": {"minItems": 1}}}
    each = [
        {
            "anyOf": [
                {"required": [name]},
                {"properties": {"evaluations": {"items": {"required": [name]}}}},
            ]
        }
        for name in _NEEDED
    ]
    batch["anyOf"] = [{"required": list(_NEEDED)}, {**several, "allOf": each}]


def _portable(schema: Any) -> Any:
    """Return a schema whose patterns every dialect of regular expressions reads alike."""
    if isinstance(schema, dict):
        return {
            name: _anchored(value)
            if name == "pattern" and isinstance(value, str)
            else _portable(value)
            for name, value in schema.items()
        }
    return [_portable(item) for item in schema] if isinstance(schema, list) else schema


def _anchored(pattern: str) -> str:
    return pattern.replace(r"\A", "^").replace(r"\Z", "$")


def _told(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a struct's schema with what its docstring says of each field beside the field."""
    first, _, fields = schema.get("description", "").partition("\n\n")
    properties = dict(schema.get("properties", {}))
    for name, said in _FIELD.findall(fields):
        properties[name] = {**properties[name], "description": " ".join(said.split())}
    found = {**schema, "description": " ".join(first.split())}
    return {**found, "properties": properties} if properties else found
