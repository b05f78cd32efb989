# SPDX-License-Identifier: Apache-2.0
"""A planner's free text, read by a language model and checked word for word.

The model runs on the untrusted side and only where `--free-text` asks for it. Spec page:
docs/spec/normalize.md#free-text
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import typer
from msgspec import Struct

from authguard_r.authoring.compile.units import to_integer
from authguard_r.cli.model_server import TIMEOUT_S
from authguard_r.core.identifiers import ParameterId
from authguard_r.normalize import Dialect, Plan
from authguard_r.normalize.binding import POSE, Argument, ArgumentUse, Binding, ways
from authguard_r.normalize.parse import read_json
from authguard_r.normalize.stated import normalize_stated, read_free_text
from authguard_r.site.model import ActionModel, Site


class ChatProtocol(StrEnum):
    """The protocol that a model server speaks."""

    OPENAI = "openai"
    ANTHROPIC = "anthropic"


class FreeTextReader(Struct, frozen=True, kw_only=True):
    """A language model that turns a free text into calls of a binding's tools.

    Args:
        protocol: the protocol of its server.
        base_url: the only address that is contacted.
        model: the model's name there.
        api_key_env: environment variable with the key; None for a server that asks for none.
        total_s: seconds that the answer may take in all.
    """

    protocol: ChatProtocol
    base_url: str
    model: str
    api_key_env: str | None
    total_s: float

    @property
    def name(self) -> str:
        """Which model it is, for the record."""
        return f"{self.protocol}:{self.model}"

    def read(self, data: bytes, binding: Binding, site: Site, dialect: Dialect) -> FreeTextPlan:
        """Return the model's reply and the plan in it, once the text states all of the plan.

        Raises:
            MalformedError: the text cannot be read, the reply is not bare JSON, the plan is not
                one of the binding's, or the text does not state it.
            ClarificationError: the text names something by a name of several things.
            EnvironmentFault: the model does not answer in time, or a part is missing.
        """
        from authguard_r.authoring.drafting.chat import AnthropicChat, OpenAIChat
        from authguard_r.authoring.drafting.models import parse_free_text
        from authguard_r.authoring.model_client.exchange import ModelAddress

        text = read_free_text(data)
        address = ModelAddress(
            base_url=self.base_url, model=self.model, key_env=self.api_key_env or ""
        )
        chat = OpenAIChat if self.protocol is ChatProtocol.OPENAI else AnthropicChat
        made = parse_free_text(
            chat(address, self.total_s),
            text,
            schema=model_prompt_schema(binding, site),
            read=lambda reply: read_json(reply, where="reply"),
        )
        plan = normalize_stated(
            made.text.encode("utf-8"),
            text,
            site=site,
            binding=binding,
            quantity=lambda said, unit: to_integer(said, unit, where="text"),
            dialect=dialect,
        )
        return FreeTextPlan(made.text, plan)


class FreeTextPlan(Struct, frozen=True):
    """What a model made of a free text, checked.

    Args:
        reply: the model's bare JSON, byte for byte: planner output for `run` and a gate.
        plan: the plan in it.
    """

    reply: str
    plan: Plan


def free_text_reader(
    protocol: ChatProtocol | None,
    base_url: str | None,
    model: str | None,
    api_key_env: str | None,
    total_s: float | None,
) -> FreeTextReader | None:
    """Return the reader that the options ask for; None without `--free-text`.

    Raises:
        BadParameter: `--free-text` without a server and a model, or these without it.
    """
    if protocol is None:
        if not base_url and not model and not api_key_env and total_s is None:
            return None
        raise typer.BadParameter(
            "--base-url, --model, --api-key-env and --timeout need --free-text openai or "
            "--free-text anthropic"
        )
    if not base_url or not model:
        raise typer.BadParameter(f"--free-text {protocol} needs --base-url and --model")
    return FreeTextReader(
        protocol=protocol,
        base_url=base_url,
        model=model,
        api_key_env=api_key_env,
        total_s=TIMEOUT_S if total_s is None else total_s,
    )


def model_prompt_schema(binding: Binding, site: Site) -> dict[str, Any]:
    """Return what a model is shown beside the text: the tools' arguments and the site's names.

    Nothing of a mission, a policy, a limit or a map is in it.
    """
    tools: dict[str, list[dict[str, Any]]] = {}
    for way in ways(binding):
        kind = site.vocabulary[way.tool.type]
        if not kind.state_writing:
            shown = {name: _meaning(a, kind) for name, a in way.tool.arguments.items()}
            constants = {name: {"is": value} for name, value in way.tool.when.items()}
            known = {name: meant for name, meant in shown.items() if meant is not None}
            tools.setdefault(way.name, []).append({**known, **constants})
    return {
        "format": {"plan": [{"tool": "NAME", "arguments": {"ARGUMENT": "VALUE"}}]},
        "tools": tools,
        "places": {item: model.names for item, model in site.regions.items()},
        "objects": {item: model.names for item, model in site.objects.items()},
    }


def _meaning(argument: Argument, kind: ActionModel) -> dict[str, Any] | None:
    """Return what an argument means, for a model; None when it is to be left out."""
    if argument.use is not ArgumentUse.MAPPED:
        return None
    optional: dict[str, Any] = {"optional": True} if argument.optional else {}
    if argument.each:
        fields = {name: _meaning(inner, kind) for name, inner in argument.each.items()}
        return {"list of": fields, **optional}
    if argument.values:
        return {"one of": list(argument.values), **optional}
    if argument.to.startswith("params."):
        unit = kind.params[ParameterId(argument.to.removeprefix("params."))].unit
        return {"number": f"1 is {argument.per_unit} {unit}", **optional}
    if argument.to in POSE:
        return {"is": argument.to, **optional}
    meant = {"object": "an object", "route": "a list of places"}
    return {"is": meant.get(argument.to, "a place"), **optional}
