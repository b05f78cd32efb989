# SPDX-License-Identifier: Apache-2.0
"""A person's answers, put where the questions were asked, and nowhere else.

An answer is draft text like any other: it goes through the same strict schema. An answer to a
question that was not asked is refused, for it would change what was not in question. How-to:
docs/howto/missions.md
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_yaml

#: `grants[1].rows[0].object`; below `limits` a whole parameter name is one step, dots and all.
_STEP = re.compile(
    r"(?<=limits)\.(?P<parameter>[a-z0-9][a-z0-9_.:-]{0,63})"
    r"|(?:^|\.)(?P<name>[a-z][a-z0-9_]{0,63})"
    r"|\[(?P<index>[0-9]{1,4})\]"
)


def compile_plain(plain: object, site: Site, *, now: Now, nonce: str) -> Mission:
    """Return the mission that plain data in the draft format means at this site.

    Args:
        plain: as read from YAML or written by a proposer; trusted in nothing.
        site: gives the words their meaning.
        now: the instant that a relative window starts at.
        nonce: 22 characters of base64url, fresh.

    Raises:
        ClarificationError: what only a person can say, every question at once.
        MalformedError: not a draft, or one that the site or the language refuses.
    """
    return compile_draft(convert(plain, Draft, where="draft"), site, now=now, nonce=nonce)


def compile_answered(
    plain: object, answers: Mapping[str, object], site: Site, *, now: Now, nonce: str
) -> Mission:
    """Return the mission that a draft means with these answers, each to a question it raised.

    Raises:
        ClarificationError: questions that are still open.
        MalformedError: as `compile_plain`, or an answer to a question that was not asked.
    """
    left = dict(answers)
    while True:
        try:
            mission = compile_plain(plain, site, now=now, nonce=nonce)
        except ClarificationError as error:
            wanted = {asked.field for asked in (error, *error.others)}
            taken = {field: value for field, value in left.items() if field in wanted}
            if not taken:
                _require_all_asked(left)
                raise
            plain = apply(plain, taken)
            left = {field: value for field, value in left.items() if field not in taken}
        else:
            _require_all_asked(left)
            return mission


def apply(plain: object, answers: Mapping[str, object]) -> object:
    """Return a copy of a draft with each answer at its path.

    Args:
        plain: plain data in the draft format.
        answers: plain values by draft path (`grants[0].tool`), as `read_answers` gives them.

    Raises:
        MalformedError: a path that leads nowhere in this draft.
    """
    changed = deepcopy(plain)
    for field, value in answers.items():
        _put(changed, _steps(field), value, field)
    return changed


def read_answers(texts: Iterable[str]) -> dict[str, object]:
    """Return answers by draft path from `field=value` texts.

    Raises:
        MalformedError: no such text, an empty value, or a field answered twice.
    """
    answers: dict[str, object] = {}
    for text in texts:
        field, equals, value = text.partition("=")
        if not equals or not field:
            raise MalformedError("expected `field=value`", where=f"answer `{text[:80]}`")
        if field in answers:
            raise MalformedError("expected one answer to a question", where=field)
        answers[field] = read_answer(value, where=field)
    return answers


def read_answer(text: str, *, where: str) -> object:
    """Return what a person typed as the draft would hold it: strict YAML on one line.

    Raises:
        MalformedError: nothing was typed, or it is no such YAML.
    """
    value = read_yaml(text, where=where)
    if value is None:
        raise MalformedError("expected an answer, got nothing", where=where)
    return value


def _require_all_asked(left: Mapping[str, object]) -> None:
    for field in left:
        raise MalformedError("no question has this field: remove the answer", where=field)


def _steps(field: str) -> list[str | int]:
    steps: list[str | int] = []
    end = 0
    for found in _STEP.finditer(field):
        if found.start() != end:
            break
        index = found["index"]
        steps.append(int(index) if index is not None else found["parameter"] or found["name"])
        end = found.end()
    if end != len(field) or not steps:
        raise MalformedError("expected the path of a draft field", where=field[:80])
    return steps


def _put(plain: Any, steps: list[str | int], value: object, field: str) -> None:
    """Put the value at the path; what is not there on the way is made."""
    for number, step in enumerate(steps[:-1]):
        plain = _enter(plain, step, [] if isinstance(steps[number + 1], int) else {}, field)
    _enter(plain, steps[-1], value, field, replace=True)


def _enter(plain: Any, step: str | int, made: Any, field: str, *, replace: bool = False) -> Any:
    """Return what is at one step, made when it is not there."""
    fits = isinstance(plain, dict) if isinstance(step, str) else isinstance(plain, list)
    if not fits or (isinstance(step, int) and step > len(plain)):
        raise MalformedError("the draft has no such place", where=field)
    if isinstance(step, str):
        if replace or plain.get(step) is None:
            plain[step] = made
    elif step == len(plain):
        plain.append(made)
    elif replace:
        plain[step] = made
    return plain[step]
