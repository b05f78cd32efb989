# SPDX-License-Identifier: Apache-2.0
"""Every published free text states what a model made of it, or is refused where it is published.

Source: docs/spec/normalize.md#free-text
"""

from __future__ import annotations

import json
from typing import Any

from msgspec.json import encode
from msgspec.structs import replace

from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.normalize.stated import normalize_stated, read_free_text
from authguard_r.site.model import Site
from fixtures import scenarios
from fixtures.cases import case
from fixtures.vectors import load, named, refusal

Json = dict[str, Any]
STATED = load("stated.json")


def read(vector: Json, site: Site) -> Json:
    """Return what the check says, as the vectors have it."""
    try:
        plan = normalize_stated(
            vector["reply"].encode(),
            vector["text"],
            site=site,
            binding=scenarios.binding(),
            quantity=lambda said, unit: to_integer(said, unit, where="text"),
        )
    except ClarificationError as error:
        return {"clarification": {"field": error.field}}
    except MalformedError as error:
        return {"refusal": refusal(error)}
    return {"actions": [json.loads(encode(step.action)) for step in plan.steps]}


def test_every_free_text_states_what_is_published() -> None:
    for vector in STATED["vectors"]:
        with case(named(vector)):
            assert read(vector, scenarios.site()) == vector["expect"]


def test_every_name_of_two_things_is_asked_about_or_named_otherwise() -> None:
    site = scenarios.site()
    for vector in STATED["ambiguous"]:
        with case(named(vector)):
            also = vector["names"]
            more: dict[str, Any] = {
                kind: {
                    item: replace(model, names=(*model.names, also[item]))
                    if item in also
                    else model
                    for item, model in getattr(site, kind).items()
                }
                for kind in ("regions", "objects")
            }
            assert read(vector, replace(site, **more)) == vector["expect"]


def test_a_free_text_is_as_long_as_published_at_most() -> None:
    for vector in STATED["lengths"]:
        with case(vector["character"], vector["count"]):
            text = vector["character"] * vector["count"]
            try:
                found = "ok" if read_free_text(text.encode()) == text else "changed"
            except MalformedError as error:
                found = str(error.reason)
            assert found == vector["expect"]
