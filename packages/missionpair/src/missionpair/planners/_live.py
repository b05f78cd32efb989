# SPDX-License-Identifier: Apache-2.0
"""A language model as the target: it sees a briefing, is asked for a plan, and is never trusted.

Everything that a model says is its answer: nonsense, half a plan, a tool that does not exist. The
normalizer reads the very bytes that its server sent.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from threading import Lock
from typing import Any, NoReturn

from msgspec import Struct

from missionpair.briefing import Briefing, PlannerError, Reply
from missionpair.planners._answers import read_answer
from missionpair.planners._client import ModelClient
from missionpair.planners._meter import Meter
from missionpair.planners._prompt import AnswerForm, prompt_digest, system_text, user_text
from missionpair.planners._reach import SCRIPTED, ModelEndpoint, Price
from missionpair.planners._schema import plan_schema

#: How an answer is decoded: as the model likes, or held to the schema of a plan.
_FREE, _SCHEMA = "free", "schema"
_MILLION = 1_000_000


class LivePlanner:
    """A model that plans.

    Args:
        client: the model.
        name: what tables call it.
        mode: how it gives its plan.
        is_held: its server holds what it writes to the schema of a plan.
        max_tokens: most that one answer may have.
    """

    reads_rules = True

    def __init__(
        self, client: ModelClient, *, name: str, mode: AnswerForm, is_held: bool, max_tokens: int
    ) -> None:
        self.client, self.name, self.simulated = client, name, client.simulated
        self._mode, self._is_held, self._max_tokens = mode, is_held, max_tokens
        #: The same question has the same answer, whatever the dice.
        self.is_greedy = client.parameters.get("temperature") == 0
        self.parameters: dict[str, Any] = {
            **client.parameters,
            "mode": str(mode),
            "decoding": _SCHEMA if is_held else _FREE,
            "max_tokens": max_tokens,
            "prompt": prompt_digest(),
        }

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Return the model's answer; see `Planner.propose`."""
        most = 1 if self._mode is AnswerForm.STEP else None
        done = self.client.call_tools(
            system_text(briefing, self._mode),
            [("user", user_text(briefing))],
            briefing.tools if self._mode is AnswerForm.TOOLS else (),
            seed=seed,
            max_tokens=self._max_tokens,
            schema=plan_schema(briefing.tools, most=most) if self._is_held else None,
        )
        raw, refused = read_answer(done, briefing.tools, model=self.client.name, where="model")
        return Reply(
            raw=raw,
            refused=refused,
            took_us=done.took_us,
            tokens=done.tokens,
            cost_microusd=done.cost_microusd,
        )


class PlannerMaker(Struct, frozen=True, kw_only=True):
    """Makes a live planner from the options of a command line.

    Args:
        speaks: the protocol's client.
        protocol: its name.
        vendor_url: the vendor's own server.
        vendor_key: the variable that holds its key; sent to no other server unasked.
        preset: the planner's name while it asks its one model; empty for any model.
        preset_model: that model.
        url: its default address; empty for the vendor's server.
        temperature: in the same way; `none` sends none.
    """

    speaks: Callable[[ModelEndpoint, Meter], ModelClient]
    protocol: str
    vendor_url: str
    vendor_key: str
    preset: str = ""
    preset_model: str = ""
    url: str = ""
    temperature: str = "1"

    def __call__(
        self,
        *,
        model: str = "",
        base_url: str = "",
        key_env: str = "",
        mode: str = "tools",
        decoding: str = _FREE,
        temperature: str = "",
        max_tokens: str = "1024",
        timeout: str = "120",
        retries: str = "3",
        per_minute: str = "",
        max_cost: str = "",
        price_in: str = "",
        price_out: str = "",
        ledger: str = "",
    ) -> LivePlanner:
        """Return the planner; every option is text, as a command line has it.

        Raises:
            ValueError: an option has a value that it cannot have.
            PlannerError: a key, a package or a price is missing.
        """
        model, base_url = model or self.preset_model, base_url or self.url or self.vendor_url
        self._require_own(model)
        if mode not in set(AnswerForm):
            _wrong("mode", mode, "`tools`, `json` or `step`")
        self._require_decoding(decoding, mode)
        price = _price(price_in, price_out)
        own = base_url.rstrip("/") != self.vendor_url
        reach = ModelEndpoint(
            protocol=self.protocol,
            base_url=base_url,
            own=own,
            model=model,
            key_env=key_env or ("" if own else self.vendor_key),
            temperature=_temperature(temperature or self.temperature),
            timeout_s=float(_number("timeout", timeout, above_zero=True)),
            retries=_whole("retries", retries, most=10),
            price=price,
        )
        meter = _meter(
            reach.name,
            base_url,
            _whole("per_minute", per_minute, least=1) if per_minute else None,
            _cap(max_cost, price),
            ledger,
        )
        name = self.preset if self.preset and model == self.preset_model else reach.name
        limit = _whole("max_tokens", max_tokens, least=1)
        return LivePlanner(
            self.speaks(reach, meter),
            name=name,
            mode=AnswerForm(mode),
            is_held=decoding == _SCHEMA,
            max_tokens=limit,
        )

    def _require_decoding(self, decoding: str, mode: str) -> None:
        """A schema holds text alone, and servers of one protocol alone take one."""
        if decoding not in {_FREE, _SCHEMA}:
            _wrong("decoding", decoding, f"`{_FREE}` or `{_SCHEMA}`")
        if decoding == _SCHEMA and (mode == AnswerForm.TOOLS or self.protocol != "openai"):
            expected = f"`{_FREE}`; a schema needs `openai` and mode `json` or `step`"
            _wrong("decoding", decoding, expected)

    def _require_own(self, model: str) -> None:
        """A preset asks its one model, or a stand-in that says what it is."""
        if self.preset and model != self.preset_model and not model.startswith(SCRIPTED):
            expected = f"`{self.preset_model}` or `{SCRIPTED}...`; `{self.protocol}` takes others"
            _wrong("model", model, expected)


_METERS: dict[tuple[str, str, int | None, int | None, str], Meter] = {}
_METERS_LOCK = Lock()


def _meter(
    name: str, base_url: str, per_minute: int | None, most_microusd: int | None, ledger: str
) -> Meter:
    """Return the caps: who asks the same model under the same caps in this process shares them.

    A campaign makes planners and attackers anew for every pair; caps that began anew would have no
    effect.
    """
    key = (name, base_url, per_minute, most_microusd, ledger)
    with _METERS_LOCK:
        if key not in _METERS:
            _METERS[key] = Meter(
                per_minute=per_minute,
                most_microusd=most_microusd,
                ledger=Path(ledger) if ledger else None,
            )
        return _METERS[key]


def _price(price_in: str, price_out: str) -> Price | None:
    """Return dollars for a million tokens, which are millionths of a dollar for one."""
    if not price_in and not price_out:
        return None
    return Price(_number("price_in", price_in), _number("price_out", price_out))


def _cap(max_cost: str, price: Price | None) -> int | None:
    if not max_cost:
        return None
    if price is None:
        raise PlannerError(
            "a cap needs the price: say `price_in` and `price_out` in dollars for a million tokens",
            code="cost",
            where="max_cost",
        )
    return int(_number("max_cost", max_cost) * _MILLION)


def _temperature(text: str) -> float | None:
    return None if text == "none" else float(_number("temperature", text))


def _number(option: str, text: str, *, above_zero: bool = False) -> Fraction:
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", text) or (above_zero and not Fraction(text)):
        _wrong(option, text, "a number such as 0.5")
    return Fraction(text)


def _whole(option: str, text: str, *, least: int = 0, most: int = 1_000_000) -> int:
    if not re.fullmatch(r"[0-9]{1,7}", text) or not least <= int(text) <= most:
        _wrong(option, text, f"a whole number from {least} to {most}")
    return int(text)


def _wrong(option: str, value: str, expected: str) -> NoReturn:
    raise ValueError(f"`{option}` is `{value[:80]}`: expected {expected}")
