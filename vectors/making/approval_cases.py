# SPDX-License-Identifier: Apache-2.0
"""Where vectors of approvals are written down: answers, what each is worth, what is decided."""

from __future__ import annotations

from typing import Any

from making.answers import GOALS, NOW_MS, Answers, action, request

Json = dict[str, Any]

#: rho and Req of each way while nobody is near, and while somebody is.
NEED = {
    ("pharmacy", "nobody near"): (10, 1),
    ("isolation-room", "nobody near"): (35, 2),
    ("plant-room", "nobody near"): (65, 3),
    ("pharmacy", "somebody near"): (40, 2),
    ("isolation-room", "somebody near"): (65, 3),
    ("plant-room", "somebody near"): (95, 3),
}
#: The only reason when somebody has to be asked, or asked again.
ASK = ["APPROVAL_REQUIRED"]
ACTIONS = {
    **{goal: action(goal) for goal in GOALS},
    "plant-room, faster": action("plant-room", params={"speed_mm_s": 600}),
}
REQUESTS = {
    **{goal: request(goal, tier) for tier, goal in enumerate(GOALS[1:], 2)},
    "isolation-room, somebody near": request("isolation-room", 3, "somebody near"),
    "plant-room, denied": request("plant-room", 3, denied=True),
}
#: Answers with why each does not count; empty when it does.
Given = list[tuple[str, str]]
ONE: tuple[str, str] = ("supervisor-1", "")
TWO: Given = [ONE, ("supervisor-2", "")]


class Cases:
    """The vectors so far, and the answers that they speak of."""

    def __init__(self) -> None:
        self.answers = Answers()
        self.vectors: list[Json] = []
        for by in ("supervisor-1", "supervisor-2", "supervisor-3", "officer-1", "of-courier"):
            self.answers.give(by, by)
        for by in ("supervisor-1", "supervisor-2", "officer-1"):
            self.answers.give(f"{by} denies", by, verdict="deny")
        self.answers.give("for the isolation room", "supervisor-1", "isolation-room")

    def add(
        self,
        name: str,
        given: Given,
        reasons: list[str],
        goal: str = "plant-room",
        *,
        near: str = "nobody near",
        asked: str | None = "",
        refused: dict[str, str] | None = None,
        need: tuple[int, int] | None = None,
        **more: Any,
    ) -> None:
        """Add a vector.

        Args:
            name: what it is about.
            given: answers that are taken in, each with its `why_not`.
            reasons: of the decision.
            goal: where the way leads.
            near: the state.
            asked: the open request's name; empty for the goal's own, None for none.
            refused: answers that are not taken in at all, with the reason.
            need: rho and Req, where they are not the usual.
            more: further fields of the vector.
        """
        verdicts = {(): "accept", ("APPROVAL_REQUIRED",): "request_approval"}
        risk, required = need or NEED[goal, near]
        answers = [{"answer": a, "opened": "ok", "why_not": why} for a, why in given]
        answers += [{"answer": a, "opened": why} for a, why in (refused or {}).items()]
        vector: Json = {
            "name": name,
            "action": goal,
            "asked": goal,
            "state": near,
            "request": goal if asked == "" else asked,
            "answers": answers,
            "now_ms": NOW_MS,
            "opened_ms": more.get("now_ms", NOW_MS),
            "prompts": 1,
            "policies": [],
        }
        expect = {
            "verdict": verdicts.get(tuple(reasons), "reject"),
            "reasons": reasons,
            "required": required,
            "risk": risk,
        }
        self.vectors.append({**vector, **more, "expect": expect})

    def unfit(self, name: str, why: str, by: str = "supervisor-2", **changes: Any) -> None:
        """Add an answer that does not fit, beside one good answer and beside enough of them."""
        answer = self.answers.give(name, by, **changes)
        self.add(name, [ONE, (answer, why)], ASK)
        self.add(f"{name}, beside enough others", [ONE, ("officer-1", ""), (answer, why)], [])
