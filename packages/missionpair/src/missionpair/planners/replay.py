# SPDX-License-Identifier: Apache-2.0
"""Answers that were given before: from a campaign's log, or a file of saved replies.

Options: `log=FILE`, with `defense=NAME` where its defenses got different answers, or `file=FILE`
with one `{"pair", "seed", "round", "raw", "refused"?, "inputs"?}` a line, where `seed` is the
trial's and `round` counts from 0. An attack and its control arm have one seed: `inputs`, a list of
`[channel, text]`, tells them apart. What was not asked then is not answered now.
How-to: docs/howto/missionpair-models.md
"""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from authguard_r.core.encoding import b64
from missionpair.briefing import Briefing, PlannerError, Reply
from missionpair.records import Campaign

#: What had reached a planner, channel and text.
Inputs = tuple[tuple[str, str], ...]
#: By seed and what had reached the planner; None: by the seed alone.
_Answers = dict[tuple[int, Inputs | None], "_StoredAnswer"]
#: Longest line of a file of replies, in bytes.
_MAX_LINE = 8 * 1024 * 1024


class ReplayError(PlannerError):
    """What a replay cannot answer, or cannot read; as words, with its place once."""

    def __str__(self) -> str:
        """Return the place and what is wrong there."""
        return f"{self.where}: {self.message}"


class Saved(Struct, frozen=True, forbid_unknown_fields=True):
    """One reply of a file.

    Args:
        pair: the pair's id, for people.
        seed: of the trial.
        round: from 0.
        raw: what the planner wrote.
        refused: it said itself that it will not.
        inputs: what had reached it, channel and text; without it the reply
            answers the first inputs that are asked with its seed, and no others.
    """

    pair: str
    seed: Annotated[int, Meta(ge=0)]
    round: Annotated[int, Meta(ge=0)]
    raw: str
    refused: bool = False
    inputs: Inputs | None = None


class _StoredAnswer(Struct, frozen=True):
    """One answer as it was kept.

    Args:
        raw: its bytes.
        refused: as it said.
        fault: why it cannot be given again; empty when it can.
    """

    raw: bytes
    refused: bool
    fault: str = ""


class ReplayPlanner:
    """A planner that answers what another one answered.

    Args:
        kept: answers.
        simulated: they are a stand-in's, or their author is unknown.
        of: who gave them, for the log.
        where: the file.
        replayed: the campaign of the log; None: a file of replies does not say it.
    """

    def __init__(
        self,
        kept: _Answers,
        *,
        simulated: bool,
        of: dict[str, Any],
        where: str,
        replayed: Campaign | None = None,
    ) -> None:
        self.name, self.simulated, self.parameters = "replay", simulated, of
        self.replayed = replayed
        self.suite_digest = None if replayed is None else replayed.suite_digest
        self._kept, self._where = kept, where
        self._seeds = frozenset(seed for seed, _ in kept)
        #: What had reached it where a reply does not say that: one question for each seed.
        self._first: dict[int, Inputs] = {}

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Return the answer of then.

        Raises:
            PlannerError: it is missing, or it was asked with other inputs.
        """
        inputs = tuple((str(item.channel), item.text) for item in briefing.inputs)
        kept = self._kept.get((seed, inputs)) or self._unnamed(seed, inputs)
        if seed not in self._seeds:
            raise self._missing(f"has no reply to seed {seed}")
        if kept is None:
            text = "was asked it with other inputs: run the same attacker and kinds of trial"
            raise self._missing(f"has no reply to seed {seed} with these inputs; {text}")
        if kept.fault:
            raise self._missing(f"cannot say the reply to seed {seed}: {kept.fault}")
        if briefing.turns:
            raise self._missing("has one reply a round: replay with one turn")
        return Reply(raw=kept.raw, refused=kept.refused)

    def _unnamed(self, seed: int, inputs: Inputs) -> _StoredAnswer | None:
        """Return a reply that says no inputs; to one question alone, not to attack and control."""
        kept = self._kept.get((seed, None))
        if kept is not None and self._first.setdefault(seed, inputs) != inputs:
            text = "attack and control arm alike: give its `inputs`, or run one of them"
            raise self._missing(f"would answer seed {seed} in {text}")
        return kept

    def _missing(self, message: str) -> PlannerError:
        return ReplayError(message, code="protocol", where=self._where)


def make(*, log: str = "", file: str = "", defense: str = "") -> ReplayPlanner:
    """Return a planner that answers from a log or a file.

    Raises:
        ValueError: neither is named, or both.
        PlannerError: it cannot be read, or is broken; its code says which, `log` or `file`.
    """
    if bool(log) == bool(file) or (file and defense):
        raise ValueError("name one of `log=FILE` (with `defense=NAME`) and `file=FILE`")
    return _of_log(Path(log), defense) if log else _of_file(Path(file))


def _of_log(path: Path, defense: str) -> ReplayPlanner:
    from missionpair.campaign.log import LogError, whole_log

    kept: _Answers = {}
    try:
        campaign, trials, digest = whole_log(path)
        names = [named.name for named in campaign.defenses]
        if defense and defense not in names:
            raise _broken(path, f"has no defense `{defense}`: {', '.join(names)}", code="log")
        if campaign.turns > 1:
            text = "is of several turns a round, and keeps one reply of each round"
            raise _broken(path, text, code="log")
        for trial in trials:
            if defense in {"", trial.defense}:
                for number, one in enumerate(trial.rounds):
                    _add(kept, (trial.seed + number, one.inputs), _of_round(one))
    except LogError as error:
        raise ReplayError(error.message, code="log", where=error.where) from error
    of = {"planner": msgspec.to_builtins(campaign.planner), "log": digest}
    simulated = campaign.planner.simulated
    return ReplayPlanner(
        kept,
        simulated=simulated,
        of=of,
        where=str(path),
        replayed=campaign,
    )


def _of_round(one: Any) -> _StoredAnswer:
    raw: bytes = one.reply.encode()
    cut = b64(sha256(raw).digest()) != one.reply_digest
    fault = "the log does not have all of its bytes" if cut else ""
    return _StoredAnswer(raw, one.declined, fault)


def _of_file(path: Path) -> ReplayPlanner:
    kept: _Answers = {}
    for number, saved in _lines(path):
        raw = saved.raw.encode(errors="surrogatepass")
        seed = saved.seed + saved.round
        if (seed, saved.inputs) in kept or (saved.inputs is not None and (seed, None) in kept):
            raise _broken(path, f"answers seed {seed} twice", line=number)
        kept[seed, saved.inputs] = _StoredAnswer(raw, saved.refused)
    # untrusted
    return ReplayPlanner(kept, simulated=True, of={"file": _digest(path)}, where=str(path))


def _lines(path: Path) -> Iterator[tuple[int, Saved]]:
    decoder = msgspec.json.Decoder(Saved)
    try:
        with path.open("rb") as file:
            number = 0
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                if not line.endswith(b"\n"):
                    raise _broken(path, "ends in the middle of a line", line=number)
                yield number, decoder.decode(line)
    except OSError as error:
        raise _broken(path, f"cannot be read: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _broken(path, f"is no saved reply: {error}", line=number) from error


def _add(kept: _Answers, key: tuple[int, Inputs | None], new: _StoredAnswer) -> None:
    """Keep an answer; two different ones to one question are both dropped."""
    old = kept.setdefault(key, new)
    if old != new:
        fault = "defenses got different ones: name one with `defense`"
        kept[key] = msgspec.structs.replace(old, fault=fault)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return b64(sha256(file.read()).digest())


def _broken(path: Path, message: str, *, line: int = 0, code: str = "file") -> PlannerError:
    return ReplayError(message, code=code, where=f"{path}:{line}" if line else str(path))
