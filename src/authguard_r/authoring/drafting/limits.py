# SPDX-License-Identifier: Apache-2.0
"""Bounds of a step's parameters: the sentence's, else the profile's, never above the robot's.

A number without a unit, an amount that is no whole number and a bound beyond the robot are asked
about.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.clauses import Clause
from authguard_r.authoring.drafting.frames import VerbFrame
from authguard_r.authoring.drafting.measures import (
    Measure,
    QuantityDimension,
    instants,
    read_daytime,
    read_measure_text,
)
from authguard_r.authoring.drafting.profile import DraftProfile, bounds, ceiling, measure
from authguard_r.authoring.drafting.resolve import field_of
from authguard_r.authoring.drafting.tokens import tokenize
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import ActionType
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Parameter, Site

_DIMENSIONS = {
    "speed_mm_s": QuantityDimension.SPEED,
    "force_mn": QuantityDimension.FORCE,
    "duration_ms": QuantityDimension.TIME,
    "max_bytes": QuantityDimension.BYTES,
}
_SPELLED = {
    "speed": ("limits.speed_mm_s", ("m/s", "km/h", "mm/s")),
    "force": ("limits.force_mn", ("N", "mN")),
    "duration": ("duration", ("s", "min", "h")),
    "at": ("at", ("m/s", "km/h")),
}
_SLOTS = {
    QuantityDimension.SPEED: "speed",
    QuantityDimension.FORCE: "force",
    QuantityDimension.TIME: "duration",
    QuantityDimension.BYTES: "data.record",
    QuantityDimension.SHARE: "condition",
}
Bounds = tuple[Any, Any]


class StepLimits:
    """Works out bounds for the steps of one sentence, and remembers which quantities they used."""

    def __init__(
        self, site: Site, robot: str | None, profile: DraftProfile, asking: DraftDialog
    ) -> None:
        self._site = site
        self._robot = robot
        self._profile = profile
        self._asking = asking
        self._used: set[tuple[int, QuantityDimension]] = set()

    def settle(self, clause: Clause, *, now_ms: int) -> str | None:
        """Ask for the unit of each bare number of a clause; return the instant one turns out to be.

        Args:
            clause: the clause.
            now_ms: the instant of drafting; `at 2` may be a time after it.
        """
        begin = None
        asked: set[str] = set()
        for meant, digits in clause.bare:
            slot, units = _SPELLED[meant]
            if slot in asked:
                self._second(clause, slot, digits)
                continue
            asked.add(slot)
            question = f"`{digits}` has no unit: which {meant} is meant?"
            options = tuple(f"{digits} {unit}" for unit in units)
            if meant == "at":
                question = f"`at {digits}` has no unit: which time or speed is meant?"
                options += _times(digits, now_ms)
            answer = self._asking.ask(field_of(clause, slot), question, options)
            if answer is not None and "T" in answer:
                begin = answer
            elif answer is not None and measure(answer).dimension in clause.measures:
                self._second(clause, slot, answer)
            elif answer is not None:
                clause.measures[measure(answer).dimension] = measure(answer)
        return begin

    def _second(self, clause: Clause, slot: str, said: str) -> None:
        """Ask about a second value of one quantity: neither is the sentence's last word."""
        question = f"`{said}` is a second value of one quantity: say one of them only"
        self._asking.insist(field_of(clause, slot), question)

    def unused(self, clause: Clause) -> tuple[tuple[str, str], ...]:
        """Return the quantities of a clause that bound nothing, each with its slot."""
        return tuple(
            (_SLOTS[dimension], said.text)
            for dimension, said in clause.measures.items()
            if (clause.number, dimension) not in self._used
        )

    def condition(self, clause: Clause) -> dict[str, Any] | None:
        """Return a clause's condition as the draft spells a guard."""
        said = clause.condition
        if said is None:
            return None
        level = said.permille
        if level is None:
            level = self._profile.battery_low
            self._asking.assume("battery_low", f"{level} permille", "the profile")
        age = self._profile.guard_max_age
        self._asking.assume("guards.max_age", age, "the profile")
        return {"variable": "battery_permille", said.comparison: level, "max_age": age}

    def of(self, clause: Clause, kind: str) -> dict[str, Bounds]:
        """Return the bounds of every parameter that an action type requires."""
        found: dict[str, Bounds] = {}
        for name, parameter in self._site.vocabulary[ActionType(kind)].params.items():
            given = self._one(clause, str(name), parameter)
            if given is not None and parameter.required:
                found[str(name)] = given
        return found

    def said(self, clause: Clause, dimension: QuantityDimension) -> Measure | None:
        """Return what the clause says of a dimension; from then on it counts as used."""
        found = clause.measures.get(dimension)
        if found is not None:
            self._used.add((clause.number, dimension))
        return found

    def _one(self, clause: Clause, name: str, parameter: Parameter) -> Bounds | None:
        if not parameter.required:
            return None
        if name == "liquid_no":
            return self._liquid(clause)
        if name == "duration_ms":
            return self._duration(clause, parameter)
        usual = bounds(self._profile, name, careful=clause.careful)
        if usual is None:
            return self._asked(clause, name)
        return self._bounded(clause, name, parameter, usual)

    def _bounded(
        self, clause: Clause, name: str, parameter: Parameter, usual: tuple[str, str]
    ) -> Bounds | None:
        """Return the sentence's upper bound, else the profile's, below what the robot can do."""
        said = self.said(clause, _DIMENSIONS[name]) if name in _DIMENSIONS else None
        top = None if self._robot is None else ceiling(self._site, self._robot, name)
        top = Fraction(parameter.high) if top is None else min(top, Fraction(parameter.high))
        field = field_of(clause, f"limits.{name}")
        if said is not None:
            said = self._possible(field, said, top, parameter.unit)
            if said is None:
                return None
            low = measure(usual[0])
            return (low.text if low.amount <= said.amount else said.text), said.text
        if name == "speed_mm_s" and clause.frame is VerbFrame.GUIDE:
            usual = min(usual, (usual[0], self._profile.guide_speed), key=_upper)
        high = measure(usual[1])
        text = high.text if high.amount <= top else f"{top} {parameter.unit}"
        low_text = usual[0] if measure(usual[0]).amount <= min(top, high.amount) else text
        why = "the profile's upper bound; the sentence gives none"
        self._asking.assume(field, f"{low_text} to {text}", why)
        return low_text, text

    def _possible(self, field: str, said: Measure, top: Fraction, unit: str) -> Measure | None:
        if said.amount.denominator == 1 and 0 < said.amount <= top:
            return said
        fault = f"is more than the {top} {unit} that the robot can do"
        if said.amount.denominator != 1 or not said.amount:
            fault = f"is no whole number of {unit} above 0"
        answer = self._asking.ask(field, f"`{said.text}` {fault}: which bound is meant?")
        return None if answer is None else _whole(field, answer, said.dimension, top)

    def _duration(self, clause: Clause, parameter: Parameter) -> Bounds | None:
        said = self.said(clause, QuantityDimension.TIME)
        if said is None:
            if any(meant == "duration" for meant, _ in clause.bare):
                return None
            field = field_of(clause, "duration")
            answer = self._asking.ask(field, "How long, with its unit (such as `30 s`)?")
            if answer is None:
                return None
            said = _whole(field, answer, QuantityDimension.TIME, None)
            clause.measures[QuantityDimension.TIME] = said
            self._used.add((clause.number, QuantityDimension.TIME))
        high = self._possible(
            field_of(clause, "duration"), said, Fraction(parameter.high), parameter.unit
        )
        return None if high is None else ("1 ms", high.text)

    def _liquid(self, clause: Clause) -> Bounds | None:
        known = self._profile.liquids
        liquid = clause.liquid
        if liquid is None:
            liquid = self._asking.ask(field_of(clause, "liquid"), "Which liquid is meant?", known)
        if liquid is None:
            return None
        number = known[liquid]
        self._asking.assume(f"liquid.{liquid}", f"liquid_no {number}", "the profile's table")
        return number, number

    def _asked(self, clause: Clause, name: str) -> Bounds | None:
        """Ask for bounds that neither the sentence nor the profile can give."""
        field = field_of(clause, f"limits.{name}")
        answer = self._asking.ask(field, f"Between which bounds may `{name}` lie (`1 m .. 2 m`)?")
        low, parted, high = (answer or "").partition("..")
        return (low.strip(), high.strip()) if parted else None


def _whole(field: str, answer: str, dimension: QuantityDimension, top: Fraction | None) -> Measure:
    """Return the quantity that an answer spells.

    Raises:
        MalformedError: another dimension, no whole number, or out of range.
    """
    found = read_measure_text(answer, tokenize(answer))
    fits = found is not None and found.dimension is dimension and found.amount.denominator == 1
    if found is None or not fits or not 0 < found.amount <= (top or found.amount):
        raise MalformedError(
            f"expected a whole number of {dimension} within what is possible, got `{answer}`",
            where=field,
            reason=Reason.VALUE_INVALID,
        )
    return found


def _times(digits: str, now_ms: int) -> tuple[str, ...]:
    """Return the instants that a bare number can mean as a time of day."""
    time = read_daytime(tokenize(digits), 0)
    return () if time is None else instants(time, now_ms=now_ms)


def _upper(pair: tuple[str, str]) -> Fraction:
    return measure(pair[1]).amount
