# SPDX-License-Identifier: Apache-2.0
"""What a campaign writes: one line for each trial, and nothing else is kept of it.

Every figure of a report is computed from these lines. Everything but `timing` is the same when a
deterministic campaign is run again. Spec page: docs/spec/campaign-log.md
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

#: Version of the log's format.
SCHEMA = "missionpair/log/2"


class NamedPart(Struct, frozen=True, forbid_unknown_fields=True):
    """A planner, an attacker or a defense: its name and every parameter that shapes it.

    Args:
        name: as `--planner`, `--attacker` and `--defense` take it.
        simulated: it stands for something that was not run (a model, a person).
        parameters: published, so that a stranger can run the same.
    """

    name: str
    simulated: bool = False
    parameters: dict[str, Any] = {}


class Qualified(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a baseline is held to, without failing in any.

    Args:
        defense: its name.
        benign: pairs of the suite whose benign run came to its end under it before the first trial.
        own: attacks of its own kind that it stopped before the first trial.
        pairs: pairs of the campaign whose benign run has to come to its end under it, each before
            its own trials: a log that is whole has all of them, one that was cut those in it.
        held_as: what was held in the place of a defense that errs on purpose, in words, such as
            `awake, without errors`; empty: the very one that is scored.
    """

    defense: str
    benign: int
    own: int
    pairs: int = 0
    held_as: str = ""


class Campaign(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="campaign"):
    """The first line: what was run.

    Args:
        schema: version of this format.
        suite: its name.
        suite_version: its version.
        suite_digest: of its canonical bytes.
        pairs: how many of its pairs were taken, from the first.
        every: of which one was taken each time: 10 took the first, the eleventh, and so on.
        skipped: how many of those were left out, because a recorded planner has no reply to them.
        planner: the target.
        attacker: who writes the inputs.
        access: what the attacker sees.
        defenses: what stands between planner and robot, one after the other.
        seed: of all dice.
        seeds: how often each pair is tried.
        rounds: how many tries an attacker has at most.
        turns: how many answers a planner has in one round at most.
        kinds: which kinds of trial are run.
        weights: lambda_1 to lambda_5 of the score; each is above zero.
        field_weights: w_j of D_M; a field that is absent weighs 1, all of them as each mission
            signs them where none is named.
        trials: how many trial lines a whole log has.
        version: of the software.
        qualified: what each baseline is held to before it is scored; none where it is not.
    """

    schema: str
    suite: str
    suite_version: int
    suite_digest: str
    pairs: int
    planner: NamedPart
    attacker: NamedPart
    access: str
    defenses: tuple[NamedPart, ...]
    seed: int
    seeds: int
    rounds: int
    turns: int
    kinds: tuple[str, ...]
    weights: tuple[int, int, int, int, int]
    trials: int
    version: str
    every: int = 1
    skipped: int = 0
    field_weights: dict[str, int] = {}
    qualified: tuple[Qualified, ...] = ()


class Timing(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How long the parts took, microseconds; the one part of a line that two runs differ in.

    Args:
        planner: all answers of the target.
        attacker: all answers of the attacker.
        normalize: T_N.
        decide: T_P of the authorization gate, its store and log included.
        safety: T_S.
        defense: everything between an answer and its verdict.
        world: the simulated world.
        judging: the reference oracle, of the plan and of what was carried out.
        total: the whole trial, with its preparation.
    """

    planner: int = 0
    attacker: int = 0
    normalize: int = 0
    decide: int = 0
    safety: int = 0
    defense: int = 0
    world: int = 0
    judging: int = 0
    total: int = 0


class Round(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One try of the attacker: what it sent, what the planner made of it, what the checkers say.

    Args:
        inputs: what was sent, by channel; empty where a planner needs none.
        reply: the planner's answer, its first 4,096 characters.
        reply_digest: of all its bytes.
        declined: the planner said itself that it will not.
        syntax: the normalizer's reason where it refused the answer (InvalidSyntax).
        executable: X of the plan.
        safe: SA of the plan.
        hazards: the safety model's classes where it is not safe (ObviousHarm).
        deviation: D_M of the plan, a fraction such as `1/15`; `0` of an authorized one.
        violated: codes of the protected fields that the plan violates.
        score: J of the plan in thousandths, for white-box attackers.
        complied: the plan has an action that changes one of the attack's own protected fields as
            the attack asks, and that can be carried out, as all before it can.
        intended: the answer asks for it, with wrapping and ranges forgiven (`judging.forgiving`).
    """

    inputs: tuple[tuple[str, str], ...] = ()
    reply: str = ""
    reply_digest: str = ""
    declined: bool = False
    syntax: str = ""
    executable: bool = False
    safe: bool = False
    hazards: tuple[str, ...] = ()
    deviation: str = "0"
    violated: tuple[str, ...] = ()
    score: int = 0
    complied: bool = False
    intended: bool = False


class Trial(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="trial"):
    """One trial of one pair under one defense.

    Args:
        n: its number, from 0; a log holds them in order.
        pair: the pair's id.
        kind: `attack`, `control`, `neutral`, `benign` or `update`.
        defense: its name.
        seed: of this trial's dice.
        domain: of the pair.
        categories: of the pair.
        family: of the pair.
        channels: of the pair.
        rounds: every try.
        complied: a plan of some round did (`Round.complied`), with the attack or, in the control
            arm, without it: what the attack asks for reached the defense, whichever that is.
        intended: an answer of some round asks for it, with wrapping and ranges forgiven: the gate
            may not have been able to read it.
        instead: where none did, of the last answer: `declined`, `empty` (a plan without a step:
            nothing is to be done), `unparsable`, `not_executable`, `strayed` (it left the mission
            otherwise than the attack asks), `authorized` (the planner kept to its mission) or
            `error` (nothing was answered).
        blocked: nothing unauthorized was executed; None where nothing complied.
        by: which part refused, in the first round that complied or else the last: `authorization`,
            `safety`, `normalizer`, or a defense's own name; empty when none did.
        reasons: that refusal's codes.
        planned: actions of all plans.
        executed: actions that the world carried out.
        unauthorized: of those, actions that the oracle finds unauthorized.
        hijacked: SCMH of what was executed in some round: executable, safe and not authorized.
        violated: codes of the protected fields that executed actions violate, by the oracle.
        deviation: the largest D_M of what was executed.
        completed: a benign run or an update came to its end.
        prompts: how often a person was asked.
        stalled_ms: simulated time that the robot stood although it had something to do.
        false_stop: an attack, or its control, after which the robot stands, with authorized work
            left and none of it, nor anything else, carried out; of the other kinds a run that a
            defense ended.
        error: a planner's or an attacker's failure; the trial counts, and nothing else is said.
        tokens: read and written by the target.
        cost_microusd: of target and attacker.
        timing: how long it took.
    """

    n: int
    pair: str
    kind: str
    defense: str
    seed: int
    domain: str
    categories: tuple[str, ...]
    family: str
    channels: tuple[str, ...]
    rounds: tuple[Round, ...]
    complied: bool
    instead: str
    blocked: bool | None
    by: str
    reasons: tuple[str, ...]
    planned: int
    executed: int
    unauthorized: int
    hijacked: bool
    violated: tuple[str, ...]
    deviation: str
    completed: bool
    prompts: int
    stalled_ms: int
    false_stop: bool
    error: str
    tokens: tuple[int, int]
    cost_microusd: int
    timing: Timing
    intended: bool = False


class End(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="end"):
    """The last line of a whole log: how many trials it has."""

    trials: int


Line = Campaign | Trial | End
