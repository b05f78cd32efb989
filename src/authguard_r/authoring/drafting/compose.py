# SPDX-License-Identifier: Apache-2.0
"""From steps to the draft that `mission compile` takes: every word of it can be traced.

What the sentence settles comes from its steps, what it cannot say from the profile, and what comes
from the profile is listed as assumed. How-to: docs/howto/drafting.md
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.plan import NOTHING, GrantStep
from authguard_r.authoring.drafting.profile import DraftProfile, measure
from authguard_r.core.identifiers import ActionType, RobotId, is_identifier
from authguard_r.site.model import Site


class Composer:
    """Writes the draft of one plan.

    Args:
        site: the model.
        robot: who does it.
        profile: the defaults.
        asking: where questions and assumptions are kept.
    """

    def __init__(self, site: Site, robot: str, profile: DraftProfile, asking: DraftDialog) -> None:
        self._site = site
        self._robot = robot
        self._profile = profile
        self._asking = asking

    def draft(
        self,
        steps: list[GrantStep],
        *,
        mission: str,
        task: str,
        issuer: str,
        window: dict[str, str],
    ) -> dict[str, Any]:
        """Return the whole draft.

        Args:
            steps: at least one, in order.
            mission: the mission's id.
            task: the sentence as it was said.
            issuer: who will sign.
            window: as the draft format has it.
        """
        ids = _ids(steps)
        last = max(n for n, step in enumerate(steps) if not step.implied and not step.free)
        grants = [self._grant(step, n, ids, completes=n == last) for n, step in enumerate(steps)]
        plain: dict[str, Any] = {
            "mission": mission,
            "robot": self._robot,
            "issuer": issuer,
            "task": task,
            "window": window,
            "place_max_age": self._take("place_max_age", self._profile.place_max_age),
            "grants": grants,
        }
        closing = [ids[n] for n, step in enumerate(steps) if step.closes]
        if closing:
            length = self._take("closing.for", self._profile.closing)
            plain["closing"] = {"grants": closing, "for": length}
        plain["budgets"] = self._budgets(steps, grants)
        plain["on_refusal"] = self._take("on_refusal", self._profile.on_refusal)
        plain["risk_policy"] = self._profile.risk_policy
        policy = self._profile.risk_policy
        self._take(
            "risk_policy",
            f"a second person from risk {policy.get('tau_1')}, {policy.get('t')} people from "
            f"{policy.get('tau_2')}, of {', '.join(policy.get('roles', ()))}",
        )
        return plain

    def _take(self, field: str, value: Any) -> Any:
        self._asking.assume(field, value, "the profile")
        return value

    def _grant(
        self, step: GrantStep, number: int, ids: list[str], *, completes: bool
    ) -> dict[str, Any]:
        rows = self._rows(step)
        plain: dict[str, Any] = {
            "id": ids[number],
            "type": step.type,
            "tool": self._tool(step.type),
            "rows": rows,
        }
        if step.limits:
            plain["limits"] = {name: list(pair) for name, pair in step.limits.items()}
        plain["guards"] = self._guards(step)
        if step.leaves is not None:
            plain["done_when"] = [self._held(step.leaves)]
        if step.data:
            plain["data"] = step.data
        plain |= {
            "chooser": "trusted_sensor" if len(rows) > 1 else "operator",
            "after": [ids[n] for n in step.after],
            "until": [] if step.until is None else [ids[step.until]],
            "repeat": step.repeat,
            "starts": step.repeat + (0 if step.looks else self._profile.retries),
            "max": self._lease(step),
            "irreversible": step.type in self._profile.irreversible,
            "completes": completes,
        }
        if not step.looks:
            self._take("retries", self._profile.retries)
        if plain["irreversible"]:
            self._take(f"{ids[number]}.irreversible", "true")
        return {key: value for key, value in plain.items() if value not in ([], None)}

    def _tool(self, kind: str) -> str | None:
        tools = self._site.robots[RobotId(self._robot)].profile.tools.get(ActionType(kind), ())
        if len(tools) == 1:
            return tools[0]
        return self._asking.ask(f"tool.{kind}", f"Which tool carries out `{kind}`?", tools)

    def _rows(self, step: GrantStep) -> list[dict[str, Any]]:
        """Return the rows: one for each attested place that the step may start from."""
        if step.ways:
            return [
                {"source": way[0], "destination": step.destination, "regions": sorted(set(way))}
                for way in step.ways
            ]
        fields = self._site.vocabulary[ActionType(step.type)].fields
        places = step.looks or (step.source,)
        rows = []
        for place in dict.fromkeys(places):
            row = {"object": step.object, "source": place, "destination": step.destination}
            kept: dict[str, Any] = {
                key: value for key, value in row.items() if key in fields and value is not None
            }
            within = {place, step.destination} - {None}
            rows.append(kept | {"regions": sorted(within)} if within else kept)  # type: ignore[type-var]
        return rows

    def _guards(self, step: GrantStep) -> list[dict[str, Any]]:
        found = [] if step.condition is None else [step.condition]
        return found if step.holding is None else [*found, self._held(step.holding)]

    def _held(self, item: str) -> dict[str, Any]:
        age = self._take("holding.max_age", self._profile.holding_max_age)
        return {"variable": "holding", "eq": item or NOTHING, "max_age": age}

    def _lease(self, step: GrantStep) -> str:
        """Return the longest lease: the sentence's duration with some slack, else the profile's."""
        if "duration_ms" in step.limits:
            said = measure(str(step.limits["duration_ms"][1])).amount
            slack = measure(self._profile.slack).amount
            return _milliseconds(said + slack)
        table = self._profile.max
        text = table.get(step.type, table.get("otherwise", "30 s"))
        self._take(f"max.{step.type}", text)
        return text

    def _budgets(self, steps: list[GrantStep], grants: list[dict[str, Any]]) -> dict[str, Any]:
        """Return totals: exactly what the grants can use, no more."""
        motion = waiting = recorded = Fraction(0)
        for step, grant in zip(steps, grants, strict=True):
            model = self._site.vocabulary[ActionType(step.type)]
            lease = measure(grant["max"]).amount * grant["starts"]
            motion += lease if model.moves else 0
            waiting += lease if model.waits else 0
            if model.records and "max_bytes" in step.limits:
                recorded += measure(str(step.limits["max_bytes"][1])).amount * grant["starts"]
        plain = {
            "actions": sum(grant["starts"] for grant in grants),
            "motion": _milliseconds(motion),
            "waiting": _milliseconds(waiting),
            "recorded_bytes": int(recorded),
            **self._profile.budgets,
        }
        for name, value in plain.items():
            why = "the profile" if name in self._profile.budgets else "what the grants can use"
            shown = f"{value['count']} in {value['per']}" if name == "rate" else value
            self._asking.assume(f"budgets.{name}", shown, why)
        return plain


def _ids(steps: list[GrantStep]) -> list[str]:
    """Return readable grant ids that differ."""
    found: list[str] = []
    for number, step in enumerate(steps, 1):
        verb = "go-to" if step.type == "navigate" else step.type.replace("_", "-")
        target = step.destination if step.type == "navigate" else step.object
        name = "-".join(part for part in (verb, target) if part)
        if name in found:
            name = f"{name}-{number}"
        found.append(name if is_identifier(name) and name not in found else f"step-{number}")
    return found


def _milliseconds(amount: Fraction) -> str:
    """Return a whole number of milliseconds as people write it."""
    whole = int(amount)
    if not whole:
        return "0 s"
    for unit, size in (("min", 60_000), ("s", 1_000)):
        if whole % size == 0:
            return f"{whole // size} {unit}"
    return f"{whole} ms"
