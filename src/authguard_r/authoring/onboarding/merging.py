# SPDX-License-Identifier: Apache-2.0
"""What was learned, put into the binding that a person has: nothing of theirs is lost or changed.

Only a way that refuses everything (`unheld`, as a skeleton has it) takes on a learned meaning. The
result names every tool and field that the binding named, so what the binding was checked against
fits the proposal too. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.authoring.onboarding.calls import WayKey
from authguard_r.authoring.onboarding.graph import OPERATIONS
from authguard_r.authoring.onboarding.meaning import Meaning
from authguard_r.authoring.onboarding.skeleton import UNHELD
from authguard_r.normalize.binding import Binding, ToolBinding, ToolWay, ways

_REACHED = {operation: name for operation, name, _, _ in OPERATIONS.values()}
_NEVER = "never called in this run"
_UNSET = "never set in this run"
_BOUND = "as it is bound already"
_STILL = "as it is bound already; calls of it could not be read with it"


def merged(meanings: tuple[Meaning, ...], binding: Binding | None) -> tuple[Meaning, ...]:
    """Return every way of the binding, and what was learned of those that refuse everything.

    Args:
        meanings: of the calls that the binding refused.
        binding: a sound one; None: there is nothing but what was learned.
    """
    learned = {meaning.key: meaning for meaning in meanings}
    found = []
    for way in () if binding is None else ways(binding):
        key = _key(way)
        found.append(_joined(key, way.tool, learned.pop(key, None)))
    return (*found, *learned.values())


def _key(way: ToolWay) -> WayKey:
    path = _REACHED.get(way.name, "")
    reached = way.tool.when.get(path)
    return way.name, (path, reached) if isinstance(reached, str) else None


def _joined(key: WayKey, tool: ToolBinding, learned: Meaning | None) -> Meaning:
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(tool))
    plain.setdefault("arguments", {})
    if tool.type == UNHELD and learned is not None:
        return _filled(plain, learned)
    about = _NEVER if tool.type == UNHELD else _BOUND if learned is None else _STILL
    return Meaning(
        key=key,
        plain=plain,
        understood=tool.type != UNHELD,
        fits=(),
        notes={},
        unknown={} if learned is None else learned.unknown,
        kept=True,
        about=about,
    )


def _filled(plain: dict[str, Any], learned: Meaning) -> Meaning:
    """Return the learned way with the message, and the fields that no call had set: refused."""
    seen = learned.plain["arguments"]
    unset = [path for path in plain["arguments"] if not any(_meet(path, name) for name in seen)]
    arguments = {**seen, **{path: {"use": "refused"} for path in unset}}
    held = {name: plain[name] for name in ("when", "message", "body") if name in plain}
    return msgspec.structs.replace(
        learned,
        plain={**learned.plain, **held, "arguments": arguments},
        notes={**learned.notes, **dict.fromkeys(unset, _UNSET)},
    )


def _meet(one: str, other: str) -> bool:
    """True when two paths are one, or one lies within the other."""
    return one == other or one.startswith(f"{other}.") or other.startswith(f"{one}.")
