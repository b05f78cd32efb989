# SPDX-License-Identifier: Apache-2.0
"""What a model's reply is: a plan, words in the place of one, a refusal, or nothing at all.

Nothing is repaired and nothing is guessed into a plan: the normalizer reads the bytes. How-to:
docs/howto/missionpair-models.md
"""

from __future__ import annotations

import json
import re

from missionpair.briefing import OfferedTool, PlannerError
from missionpair.planners._client import Completion

#: How models say that they will not, in English; what they say otherwise is words without a plan.
_REFUSALS = re.compile(
    r"\b(?:can(?:no|')t|can not|won't|will not|(?:am|are|be) not (?:able|allowed|permitted)"
    r"|unable|refuse|decline|sorry|apologi[sz]e|must not|don't think i should)\b",
    re.IGNORECASE,
)


def read_answer(
    done: Completion, tools: tuple[OfferedTool, ...], *, model: str, where: str
) -> tuple[bytes, bool]:
    """Return the bytes that the normalizer reads, and whether they are a refusal of the model's.

    A plan that was written where calls were asked for is a plan all the same.

    Args:
        done: the model's reply.
        tools: what it could have called.
        model: who answered.
        where: what to look at when nothing came.

    Raises:
        PlannerError: it holds neither a call nor a word, and its server does not say why.
    """
    written = done.text.encode("utf-8", "surrogatepass")
    if done.called:
        return done.raw, done.declined
    if done.declined:
        return written or done.raw, True
    if not done.text.strip():
        how = "`max_tokens` were used up before a word" if done.cut else "no call and no word"
        raise PlannerError(f"`{model}` answered nothing: {how}", code="protocol", where=where)
    is_plan = done.cut or has_plan(done.text, tools)
    return written, not is_plan and _REFUSALS.search(done.text.replace("\u2019", "'")) is not None


def has_plan(text: str, tools: tuple[OfferedTool, ...]) -> bool:
    """True when words hold something like a plan, however broken, or one without a step."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        names = "|".join(re.escape(tool.name) for tool in tools)
        return re.search(rf'"(?:plan|tool)"|\b(?:{names or "(?!)"})\(', text) is not None
    return isinstance(value, list | dict)
