# SPDX-License-Identifier: Apache-2.0
"""The template grammar: no network, no model, the same draft for the same words every time.

A sentence is read whole; a word that is no verb of the grammar, no name of the site, no quantity
and no filler is asked about, because a condition could hide in it. How-to: docs/howto/drafting.md
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.acts import act
from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.clauses import Clause, Sentence
from authguard_r.authoring.drafting.compose import Composer
from authguard_r.authoring.drafting.lexicon import read_lexicon
from authguard_r.authoring.drafting.plan import DraftPlan, GrantStep
from authguard_r.authoring.drafting.profile import DraftProfile
from authguard_r.authoring.drafting.proposal import DraftProposal
from authguard_r.authoring.drafting.reader import read_sentence
from authguard_r.authoring.drafting.resolve import Resolver, field_of
from authguard_r.authoring.drafting.tokens import tokenize
from authguard_r.authoring.drafting.window import window_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site

NAME = "template"
#: The mission language's own bound.
MAX_STEPS = 64


class TemplateProposer(Struct, frozen=True):
    """The default proposer.

    Args:
        profile: what the sentence does not say.
        now_ms: the instant of drafting, milliseconds since 1970, UTC; times of day are read after
            it and nothing else depends on it.
    """

    profile: DraftProfile
    now_ms: int

    def propose(
        self, sentence: str, site: Site, *, robot: str | None, settled: Mapping[str, str]
    ) -> DraftProposal:
        """Return the draft that the sentence means here, or every question that it leaves open.

        Raises:
            MalformedError: text that cannot be signed as a task, a robot that the site does not
                have, or an answer that is none of the candidates or to a question that was not
                asked.
        """
        lexicon = read_lexicon(site, reserved=frames.reserved())
        said = read_sentence(
            sentence,
            tokenize(sentence),
            lexicon,
            liquids=frozenset(self.profile.liquids),
        )
        asking = DraftDialog(settled)
        steps, named = self._plan(said, site, robot, asking)
        window = window_of(said, asking, now_ms=self.now_ms)
        issuer = asking.ask("issuer", "Who signs this mission?")
        draft: dict[str, Any] = {}
        if named is not None and window is not None and issuer is not None and not asking.questions:
            draft = Composer(site, named, self.profile, asking).draft(
                steps,
                mission=self._mission(said, steps, asking),
                task=sentence,
                issuer=issuer,
                window=window,
            )
        asking.require_used()
        questions = tuple(sorted(asking.questions, key=lambda asked: asked.field in _MISSION_WIDE))
        return DraftProposal({} if questions else draft, questions, NAME, tuple(asking.assumed))

    def _plan(
        self, said: Sentence, site: Site, robot: str | None, asking: DraftDialog
    ) -> tuple[list[GrantStep], str | None]:
        """Return the steps and the robot; both empty-handed where something is open."""
        resolver = Resolver(site, said, self.profile, asking)
        named = _robot(said, site, robot, asking)
        plan = DraftPlan(site, named, self.profile, asking, resolver)
        for clause in said.clauses:
            self._clause(plan, clause, said)
        if len(plan.steps) > MAX_STEPS:
            resolver.unknown(None, "count", f"{len(plan.steps)} steps")
        resolver.finish()
        if all(step.implied for step in plan.steps) and not asking.questions:
            asking.ask("task", "What should the robot do? The sentence grants nothing")
        _looks(plan, self.profile)
        return plan.steps, named

    def _clause(self, plan: DraftPlan, clause: Clause, said: Sentence) -> None:
        begin = plan.limits.settle(clause, now_ms=self.now_ms)
        if begin is not None and (said.begin is not None or said.start is not None):
            question = f"`{begin}` is a second begin: say one of them only"
            plan.asking.insist(field_of(clause, "at"), question)
        said.begin = begin or said.begin
        before = len(plan.asking.questions)
        act(plan, clause)
        if len(plan.asking.questions) == before:
            plan.resolver.require_read(clause)
            for slot, text in plan.limits.unused(clause):
                plan.resolver.unknown(clause, slot, text)
        if frames.STAYS_OPEN in clause.extras and clause.number not in plan.kept_open:
            plan.resolver.unknown(clause, "destination", "left open")
        for right in sorted(clause.rights) if clause.frame not in _LOOKING else ():
            plan.resolver.unknown(clause, f"data.{right}", right)

    def _mission(self, said: Sentence, steps: list[GrantStep], asking: DraftDialog) -> str:
        """Return a mission id: what it is about and when it was drafted."""
        given = asking.answer("mission")
        if given is not None:
            if not is_identifier(given):
                raise MalformedError("expected an identifier", where="mission")
            return given
        things = [step.object for step in steps] + [step.destination for step in steps]
        about = next((thing for thing in things if thing), None)
        stamp = str(to_timestamp(self.now_ms)).lower().replace("-", "").replace(":", "")
        name = "-".join(part for part in (said.clauses[0].frame, about, stamp) if part)
        name = name.replace("_", "-")
        found = name if is_identifier(name) else f"{said.clauses[0].frame}-{stamp}"
        asking.assume("mission", found, "what it is about and when it was drafted")
        return found


#: What every sentence leaves open is asked after what this one does.
_MISSION_WIDE = frozenset({"issuer", "robot", "window"})
_LOOKING = frozenset({frames.VerbFrame.INSPECT, frames.VerbFrame.PHOTO, frames.VerbFrame.RECORD})


def _robot(said: Sentence, site: Site, given: str | None, asking: DraftDialog) -> str | None:
    """Return who is meant: answered, given, named, or the only one there is."""
    answer = asking.answer("robot") or given
    if answer is not None:
        if answer not in site.robots:
            raise MalformedError(
                f"the site has no robot `{answer}`", where="robot", reason=Reason.NAME_UNKNOWN
            )
        if said.robots and set(said.robots) != {answer} and asking.answer("robot") is None:
            options = sorted({answer, *said.robots})
            return asking.ask("robot", "The sentence names another robot: which one?", options)
        return answer
    named = sorted(set(said.robots))
    if len(named) == 1:
        return named[0]
    if not named and len(site.robots) == 1:
        (only,) = site.robots
        asking.assume("robot", only, "the site's only robot")
        return str(only)
    return asking.ask("robot", "Which robot is meant?", named or sorted(site.robots))


def _looks(plan: DraftPlan, profile: DraftProfile) -> None:
    """Let the robot look for the things that the sentence names, where they are."""
    if plan.robot is None or not plan.able("find"):
        return
    for item, places in plan.seen.items():
        robot = plan.site.robots[RobotId(plan.robot)]
        where = tuple(dict.fromkeys((*places, *((str(robot.home),) if not places else ()))))
        step = GrantStep(type="find", object=item, implied=True, looks=where, repeat=profile.looks)
        plan.steps.append(step)
        plan.asking.assume(f"find.{item}", f"{profile.looks} times", "named things may be sought")
