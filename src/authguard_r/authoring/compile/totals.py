# SPDX-License-Identifier: Apache-2.0
"""What holds for the whole mission: budgets, and who must approve what; each number is said."""

from __future__ import annotations

from typing import Any

from authguard_r.authoring.compile.draft import DraftBudgets, DraftRisk
from authguard_r.authoring.compile.grants import GrantWords, build_guard, unit_of_limit
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.authoring.compile.sources import read_weights

_MS, _BYTE = "ms", "byte"


def build_budgets(given: DraftBudgets, asked: CompileQuestions) -> dict[str, Any]:
    """Return the budgets; each one that is not said is asked about."""
    return {
        "actions": asked.given(given.actions, "How many actions in all?", "budgets.actions"),
        "rate": {
            "count": asked.given(
                given.rate.count, "How many actions at most in a while?", "budgets.rate.count"
            ),
            "per_ms": asked.integer(
                given.rate.per, _MS, field="budgets.rate.per", question="In how long a while?"
            ),
        },
        "motion_ms": asked.integer(
            given.motion, _MS, field="budgets.motion", question="How long in motion in all?"
        ),
        "wait_ms": asked.integer(
            given.waiting, _MS, field="budgets.waiting", question="How long waiting in all?"
        ),
        "recorded_bytes": asked.integer(
            given.recorded_bytes,
            _BYTE,
            field="budgets.recorded_bytes",
            question="How much may be recorded in all?",
        ),
        "prompts": asked.given(given.prompts, "How often may people be asked?", "budgets.prompts"),
        "planner_stops": asked.given(
            given.planner_stops,
            "How many stops may the planner ask for before an alert?",
            "budgets.planner_stops",
        ),
    }


def build_risk(given: DraftRisk, words: GrantWords) -> dict[str, Any]:
    """Return the risk policy; each threshold that is not said is asked about."""
    asked = words.asked
    plain: dict[str, Any] = {
        "types": given.types,
        "region_tags": given.region_tags,
        "object_classes": given.object_classes,
        "parameters": [
            {
                "parameter": item.parameter,
                "full_scale": asked.integer(
                    item.full_scale,
                    unit_of_limit(item.parameter, words, f"risk_policy.parameters[{n}].parameter"),
                    field=f"risk_policy.parameters[{n}].full_scale",
                ),
                "weight": item.weight,
            }
            for n, item in enumerate(given.parameters)
        ],
        "states": [
            {
                "guard": build_guard(item.guard, f"risk_policy.states[{n}].guard", words),
                "weight": item.weight,
            }
            for n, item in enumerate(given.states)
        ],
    }
    for name, question in (
        ("privacy", "How much risk is each step of privacy impact?"),
        ("otherwise", "How much risk has an action that the policy does not list?"),
        ("tau_1", "From which risk must a second person approve?"),
        ("tau_2", "From which risk must `t` people approve?"),
        ("t", "How many people approve the most risky actions, the issuer included?"),
    ):
        plain[name] = asked.given(getattr(given, name), question, f"risk_policy.{name}")
    if given.roles is None:
        asked.ask("Who may approve: `[supervisor, ...]`?", "risk_policy.roles")
    plain["roles"] = sorted(given.roles or ())
    plain["field_weights"] = read_weights(given.field_weights, where="risk_policy.field_weights")
    plain["valid_ms"] = asked.integer(
        given.valid, _MS, field="risk_policy.valid", question="How long does a request live?"
    )
    return plain
