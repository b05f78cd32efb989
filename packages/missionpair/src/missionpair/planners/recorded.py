# SPDX-License-Identifier: Apache-2.0
"""A model as it answered in real runs: replies by pair, kind of trial and round.

Option: `file=FILE`, which `missionpair import steps|openai|mcp|langchain` wrote. Pairs to which it
has no reply are left out of the campaign and counted. How-to:
docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec

from authguard_r.core.encoding import b64
from missionpair.briefing import Briefing, PlannerError, Reply
from missionpair.recorded.archive import SourceError
from missionpair.recorded.replies import FORMAT, PairReply, RepliesHead, lines_of
from missionpair.words import ATTACKED, TrialKind

_Key = tuple[str, str, int]


class RecordedPlanner:
    """A planner that answers what a model answered to the same pair.

    Args:
        head: whose the replies are.
        replies: by pair, kind of trial and round.
        own_digest: of the file of replies; the head's is of the log that was imported.
        where: the file.
    """

    name, simulated = "recorded", False

    def __init__(
        self, head: RepliesHead, replies: dict[_Key, PairReply], *, own_digest: str, where: str
    ) -> None:
        self.parameters: dict[str, Any] = {
            "model": head.model,
            "date": head.date,
            "source": head.source,
            "digest": head.digest,
            "replies": own_digest,
        }
        self.recorded = True
        self.suite_digest = head.suite_digest or None
        self.answered = frozenset(pair for pair, _, _ in replies)
        self._replies, self._where = replies, where
        self._rounds: dict[tuple[str, str], int] = {}
        for pair, kind, number in sorted(replies):  # a round that is missing ends a trial
            if number == self._rounds.get((pair, kind), 0):
                self._rounds[pair, kind] = number + 1

    def knows(self, pair: str, kinds: tuple[str, ...]) -> bool:
        """Return whether it has replies to each kind of trial of a pair.

        The control arm needs at least as many rounds as the attack, which may have ended early
        with a success: more tries are more chances.
        """
        counts = {kind: self._rounds.get((pair, kind), 0) for kind in kinds}
        tries = max(1, counts.get(TrialKind.ATTACK, 1))
        return all(count >= (tries if kind in ATTACKED else 1) for kind, count in counts.items())

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:  # noqa: ARG002 - the pair decides
        """Return the model's answer.

        Raises:
            PlannerError: it has none; of a later round with the code `ended`.
        """
        trial = briefing.trial
        if trial is None or briefing.turns:
            text = "answers pairs of a campaign, one answer a round: run with one turn"
            raise PlannerError(text, code="protocol", where=self._where)
        found = self._replies.get(trial)
        if found is None:
            pair, kind, number = trial
            raise PlannerError(
                f"has no reply to `{pair}`, {kind}, round {number}",
                code="ended" if number else "protocol",
                where=self._where,
            )
        shown = tuple((item.channel, item.text) for item in briefing.inputs)
        if found.inputs is not None and found.inputs != shown:
            text = "answered other `inputs` than it gets now: run the attacker of the log"
            where = f"{self._where}: `{trial[0]}`, {trial[1]}, round {trial[2]}"
            raise PlannerError(text, code="protocol", where=where)
        return Reply(raw=found.raw.encode(), refused=found.refused)


def make(*, file: str = "") -> RecordedPlanner:
    """Return the planner of a file.

    Raises:
        ValueError: no file is named.
        PlannerError: it cannot be read, or is no file of replies.
    """
    if not file:
        raise ValueError("name the file: `file=FILE`")
    try:
        from missionpair.campaign.log import file_stamp

        return _read(Path(file), file_stamp(Path(file)))
    except SourceError as error:
        raise PlannerError(error.message, code="file", where=error.where) from error


@lru_cache(maxsize=2)
def _read(path: Path, stamp: object) -> RecordedPlanner:  # noqa: ARG001 - another file, others
    head: RepliesHead | None = None
    replies: dict[_Key, PairReply] = {}
    digest = sha256()
    for where, line in lines_of(path):
        digest.update(line)
        try:
            if head is None:
                head = msgspec.json.decode(line, type=RepliesHead)
                if head.format != FORMAT:
                    raise ValueError(f"expected the format `{FORMAT}`")  # noqa: TRY301
                continue
            reply = msgspec.json.decode(line, type=PairReply)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            raise SourceError(f"is no file of replies: {error}", where=where) from error
        key = (reply.pair, str(reply.kind), reply.round)
        if key in replies:
            raise SourceError("answers what an earlier line answers", where=where)
        replies[key] = reply
    if head is None:
        raise SourceError("is empty", where=str(path))
    return RecordedPlanner(head, replies, own_digest=b64(digest.digest()), where=str(path))
