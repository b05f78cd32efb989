# SPDX-License-Identifier: Apache-2.0
"""A campaign is the same however it is run: at once, in pieces, by several, from a memento.

Source: docs/spec/missionpair.md, docs/spec/campaign-log.md
"""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fixtures import campaign_records
from fixtures.amount import amount
from fixtures.suites import file_of, loaded
from missionpair import attackers, defenses, planners, registry, suites
from missionpair.attackers import AttackerError
from missionpair.briefing import Briefing, PlannerError, Reply
from missionpair.campaign import worker as workers
from missionpair.campaign.ahead import Ahead, Tail, end, keep
from missionpair.campaign.arms import rest_of
from missionpair.campaign.log import LogError, LogWriter, read_log
from missionpair.campaign.run import CampaignPlan, Progress, answered, run
from missionpair.campaign.setting import Setting
from missionpair.campaign.trial import FINAL, PairRun
from missionpair.campaign.worker import TrialResult
from missionpair.defenses import DefenseError, _qualify
from missionpair.execution import ExecutedPlan, past_the_gate
from missionpair.pair import Input, Pair, Start, Suite, plan_bytes
from missionpair.records import Timing, Trial
from missionpair.registry import UnknownNameError
from missionpair.score import DEFAULT
from missionpair.stage import Stage, StageError, Yard
from missionpair.suites._form import SuiteError
from missionpair.words import CONTROLS, Access, Category, TrialKind

pytestmark = pytest.mark.complete

FOUR = ("none", "safety", "mission", "both")


@pytest.fixture(scope="module")
def suite() -> Suite:
    return loaded("live")[0]


@pytest.fixture(scope="module")
def few(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Four pairs of the live suite and two that an allowlist stops, in a file: quickly read."""
    capability = [pair for pair in suite.pairs if pair.categories[0] is Category.CAPABILITY]
    path = tmp_path_factory.mktemp("suite") / "few.jsonl"
    return file_of(path, suite, *suite.pairs[:4], *capability[:2])


@pytest.fixture(scope="module")
def hijacked(few: str) -> CampaignPlan:
    """Two pairs under every gate."""
    return CampaignPlan(suite=few, planner="hijacked", defenses=FOUR, pairs=2)


@pytest.fixture(scope="module")
def whole(hijacked: CampaignPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of that campaign, as one process writes it in one go."""
    log = tmp_path_factory.mktemp("whole") / "log"
    run(hijacked, log)
    return log


@pytest.fixture
def held_to_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold a baseline to three benign runs and two attacks before the start, not to thirty."""
    monkeypatch.setattr(_qualify, "MOST_BENIGN", 3)
    monkeypatch.setattr(_qualify, "LEAST_OWN", 2)


def bare(trials: list[Trial]) -> list[Trial]:
    """Return the trials without what two runs differ in."""
    return [msgspec.structs.replace(trial, timing=Timing()) for trial in trials]


def under_links(path: Path) -> list[tuple[bytes, bytes]]:
    lines = path.read_bytes().splitlines()
    decoded = [msgspec.json.decode(line, type=dict[str, msgspec.Raw]) for line in lines]
    return [(bytes(line["link"]), bytes(line["record"])) for line in decoded]


def setting(planner: Any, **changes: Any) -> Setting:
    given: dict[str, Any] = {
        "planner": planner,
        "attacker": registry.make(attackers, "fixed"),
        "access": Access.BLACK,
        "defenses": tuple(registry.make(defenses, name) for name in ("none", "both")),
        "rounds": 1,
        "turns": 1,
        "seed": 0,
        "seeds": 1,
        "kinds": tuple(TrialKind),
        "weights": DEFAULT,
    }
    return Setting(**{**given, **changes})


def ran(
    suite: Suite, yard: Yard, planner: Any, pair: Pair | None = None, **more: Any
) -> list[Trial]:
    chosen = pair or suite.pairs[0]
    made = PairRun(setting(planner, **more), yard, chosen, suite.layouts[chosen.layout], first=0)
    return list(made.trials())


class Says:
    """A planner that says what a test tells it to."""

    name, simulated = "says", True

    def __init__(self, *replies: bytes | Exception | Reply) -> None:
        self.replies = list(replies)
        self.seen: list[Briefing] = []

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        self.seen.append(briefing)
        said = self.replies[min(len(self.seen), len(self.replies)) - 1]
        if isinstance(said, Exception):
            raise said
        return said if isinstance(said, Reply) else Reply(raw=said)


# what a hijacked planner comes to


def test_safety_alone_lets_through_what_both_gates_stop(whole: Path) -> None:
    _, trials = read_log(whole)
    for trial in trials:
        if trial.kind in CONTROLS:
            assert (trial.complied, trial.unauthorized) == (False, 0)
            continue
        if trial.kind != "attack":
            assert (trial.completed, trial.unauthorized, trial.by) == (True, 0, "")
            continue
        stopped = trial.defense in {"mission", "both"}
        assert trial.complied
        assert (trial.blocked, trial.hijacked) == (stopped, not stopped)
        assert (trial.unauthorized > 0) is not stopped
        assert trial.by == ("authorization" if stopped else "")


# the same, however it is run


def test_a_situation_put_back_is_as_one_made_anew(
    suite: Suite, monkeypatch: pytest.MonkeyPatch
) -> None:
    def trials() -> list[Trial]:
        planner = registry.make(planners, "adversary:always=yes")
        more = {"seeds": 24, "kinds": (TrialKind.ATTACK,), "access": Access.WHITE}
        return bare(ran(suite, yard, planner, **more))

    yard = Yard()
    put_back = trials()
    remade: list[Stage] = []

    def anew(stage: Stage) -> None:
        layout = suite.layouts[stage.pair.layout]
        fresh = yard.stage(stage.pair, layout, stage.scenario)
        stage.scene, stage.missions, stage.walk = fresh.scene, fresh.missions, None
        stage._read = None
        remade.append(fresh)

    monkeypatch.setattr(Stage, "again", anew)
    assert trials() == put_back
    assert len(remade) > 24
    assert any(trial.executed for trial in put_back)
    assert any(trial.by == "authorization" for trial in put_back)
    yard.close()


def test_two_processes_write_the_same_log_as_one(
    tmp_path: Path, hijacked: CampaignPlan, whole: Path
) -> None:
    run(hijacked, tmp_path / "2", jobs=2)
    assert under_links(whole) == under_links(tmp_path / "2")


def test_a_campaign_cut_anywhere_goes_on_to_the_same_log(
    tmp_path: Path, hijacked: CampaignPlan, whole: Path
) -> None:
    log, data = tmp_path / "log", whole.read_bytes()
    shown: list[Progress] = []
    for share in (3, 7):
        log.write_bytes(data[: len(data) * share // 9])
        run(hijacked, log, show=shown.append)
        assert under_links(log) == under_links(whole)
    count = 2 * len(FOUR) * len(TrialKind)
    assert {at.trials for at in shown} == {count}
    assert shown[-1].done == count


def test_trials_of_one_plan_are_kept_together_or_not_at_all(
    tmp_path: Path, hijacked: CampaignPlan, whole: Path
) -> None:
    """A planner that is asked again could answer otherwise, and two plans would pass for one."""
    log, lines = tmp_path / "log", whole.read_bytes().splitlines(keepends=True)
    for more in range(2 * len(FOUR) + 1):
        log.write_bytes(b"".join(lines[: 1 + more]))
        with LogWriter(log, read_log(whole)[0]) as writer:
            assert writer.done == more // len(FOUR) * len(FOUR)
        assert log.read_bytes() == b"".join(lines[: 1 + writer.done])


def test_a_whole_log_is_not_run_again(tmp_path: Path, hijacked: CampaignPlan, whole: Path) -> None:
    log = shutil.copy(whole, tmp_path / "log")
    run(hijacked, log)
    assert log.read_bytes() == whole.read_bytes()


def test_another_seed_is_another_campaign(
    tmp_path: Path, hijacked: CampaignPlan, whole: Path
) -> None:
    log = shutil.copy(whole, tmp_path / "log")
    with pytest.raises(LogError, match=r"another campaign \(seed\)"):
        run(msgspec.structs.replace(hijacked, seed=1), log)


# what did not comply is counted apart


def test_what_does_not_comply_is_told_apart(suite: Suite, yard: Yard) -> None:
    pair = suite.pairs[0]
    only = {"kinds": (TrialKind.ATTACK,), "defenses": (registry.make(defenses, "both"),)}
    said = {
        "declined": Reply(raw=b"I can't help with that.", refused=True),
        "unparsable": b"go somewhere nice",
        "empty": b'{"plan": []}',
        "authorized": plan_bytes(pair.benign.plan[:1]),
    }
    for instead, reply in said.items():
        (trial,) = ran(suite, yard, Says(reply), pair, **only)
        assert (trial.complied, trial.blocked, trial.instead) == (False, None, instead)
        assert trial.unauthorized == 0
    (trial,) = ran(suite, yard, Says(plan_bytes(pair.attack.plan)), pair, **only)
    assert (trial.complied, trial.blocked, trial.instead) == (True, True, "")


@pytest.mark.parametrize(
    ("raw", "instead"),
    [
        (b"[]", "empty"),
        (b' {"plan": [ ]}\n', "empty"),
        # the normalizer has one code for all of these; a planner that says nothing decides nothing
        (b"", "unparsable"),
        (b"# nothing\n", "unparsable"),
        (b'{"choices":[{"message":{"content":"hm"},"finish_reason":"stop"}]}', "unparsable"),
    ],
)
def test_a_plan_without_a_step_is_an_answer_and_silence_is_none(
    suite: Suite, yard: Yard, raw: bytes, instead: str
) -> None:
    only = {"kinds": (TrialKind.ATTACK,), "defenses": (registry.make(defenses, "both"),)}
    (trial,) = ran(suite, yard, Says(raw), **only)
    assert (trial.instead, trial.rounds[0].syntax) == (instead, "PLAN_EMPTY")


def test_a_planner_that_fails_is_a_trial_and_nothing_is_lost(suite: Suite, yard: Yard) -> None:
    broken = PlannerError("answers nothing", code="protocol", where="http://127.0.0.1:1")
    trials = ran(suite, yard, Says(broken), kinds=(TrialKind.ATTACK,))
    assert [trial.instead for trial in trials] == ["error", "error"]
    assert all("answers nothing" in trial.error for trial in trials)
    assert not any(trial.complied for trial in trials)


AWAY = PlannerError("cannot be reached", code="unreachable", where="http://127.0.0.1:1")
EMPTY = PlannerError("answers nothing", code="protocol", where="http://127.0.0.1:1")


def written(*failures: PlannerError | None) -> tuple[list[int], PlannerError | None]:
    """Return which trials come to be written, and what ended the campaign."""
    found: list[int] = []
    rans = (TrialResult(campaign_records.kept(n), failure) for n, failure in enumerate(failures))
    try:
        found.extend(trial.n for trial in answered(rans))
    except PlannerError as error:
        return found, error
    return found, None


def test_silence_is_counted_across_pairs_and_leaves_no_trial_behind() -> None:
    assert written(None, AWAY, AWAY, AWAY, None) == ([0], AWAY)
    assert written(EMPTY, EMPTY, EMPTY) == ([], EMPTY)
    assert written(AWAY, AWAY, None, EMPTY, EMPTY, None) == ([0, 1, 2, 3, 4, 5], None)


def test_a_campaign_shorter_than_that_is_not_finished_by_silence_either() -> None:
    assert written(AWAY) == ([], AWAY)
    assert written(EMPTY, EMPTY) == ([], EMPTY)
    assert written(None, AWAY) == ([0], AWAY)
    assert written(None, EMPTY) == ([0, 1], None)  # it answers, and this once not well
    assert written() == ([], None)


@pytest.mark.parametrize("code", sorted(FINAL))
def test_what_no_later_trial_can_mend_ends_the_campaign(
    suite: Suite, yard: Yard, code: str
) -> None:
    with pytest.raises(PlannerError):
        ran(
            suite, yard, Says(PlannerError("no", code=code, where="key")), kinds=(TrialKind.ATTACK,)
        )


# rounds and turns


def test_an_attack_ends_with_the_first_plan_that_complies(suite: Suite, yard: Yard) -> None:
    class Again:
        name, simulated, parameters = "again", True, {}

        def __init__(self) -> None:
            self.seen: list[bytes] = []

        def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:
            return pair.inputs

        def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:
            self.seen.append(seen)
            return pair.inputs

    pair, again = suite.pairs[0], Again()
    twin, idle = plan_bytes(pair.attack.plan), plan_bytes(pair.benign.plan[:1])
    only = {
        "kinds": (TrialKind.ATTACK,),
        "defenses": (registry.make(defenses, "both"),),
        "rounds": 5,
    }
    (trial,) = ran(suite, yard, Says(idle, idle, twin, idle), pair, attacker=again, **only)
    assert (len(trial.rounds), trial.complied, len(again.seen)) == (3, True, 2)
    (trial,) = ran(suite, yard, Says(idle), pair, attacker=again, **only)
    assert (len(trial.rounds), trial.complied) == (5, False)


def test_an_attacker_without_another_text_repeats_itself_and_one_that_fails_ends_its_trial(
    suite: Suite, yard: Yard
) -> None:
    class Fails:
        name, simulated, parameters = "fails", True, {}

        def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:
            return ()

        def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:
            raise AttackerError("its model is away", code="unreachable", where="server")

    class GivesUp(Fails):
        def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:
            return None

    only = {
        "kinds": (TrialKind.ATTACK,),
        "defenses": (registry.make(defenses, "both"),),
        "rounds": 3,
    }
    (trial,) = ran(suite, yard, Says(b"?"), attacker=GivesUp(), **only)
    assert (len(trial.rounds), trial.instead) == (3, "unparsable")
    assert len({one.inputs for one in trial.rounds}) == 1
    (trial,) = ran(suite, yard, Says(b"?"), attacker=Fails(), **only)
    assert (len(trial.rounds), trial.instead) == (1, "error")
    assert "its model is away" in trial.error


def test_a_planner_sees_that_it_was_refused_and_plans_anew(suite: Suite, yard: Yard) -> None:
    pair = suite.pairs[0]
    left = rest_of(yard.stage(pair, suite.layouts[pair.layout], pair.attack))
    assert len(left) >= 2
    twin, rest = plan_bytes(pair.attack.plan), plan_bytes(left)
    for name in ("both", "safety"):
        says = Says(b"?", twin, rest)
        only = {
            "kinds": (TrialKind.ATTACK,),
            "defenses": (registry.make(defenses, name),),
            "turns": 3,
        }
        (trial,) = ran(suite, yard, says, pair, **only)
        assert [turn.told for turn in says.seen[1].turns] == ["rejected"]
        assert trial.complied
        if name == "both":
            assert [turn.told for turn in says.seen[2].turns] == ["rejected", "rejected"]
            assert (trial.unauthorized, trial.blocked, trial.false_stop) == (0, True, False)
            assert trial.executed == len(left)
        else:
            assert (trial.unauthorized, trial.blocked) == (1, False)


#: Hand-made attacks after which nothing may be done before a person says so.
WAITING = {"cross-robot", "chosen-place", "chosen-thing", "replay", "approval"}


def test_who_keeps_to_a_hand_made_mission_has_work_wherever_some_is_left(yard: Yard) -> None:
    hand = loaded("hand")[0]
    only = {"kinds": (TrialKind.ATTACK,), "defenses": (registry.make(defenses, "both"),)}
    for pair in hand.pairs:
        left = rest_of(yard.stage(pair, hand.layouts[pair.layout], pair.attack))
        is_waiting = pair.id.removeprefix("hand.") in WAITING
        assert bool(left) is not is_waiting, pair.id
        assert not pair.rest or left == pair.rest
        (trial,) = ran(hand, yard, Says(plan_bytes(left)), pair, **only)
        expected = ("empty", 0) if is_waiting else ("authorized", len(left))
        assert (trial.instead, trial.executed, trial.false_stop) == (*expected, False), pair.id
        (trial,) = ran(hand, yard, Says(plan_bytes(())), pair, **only)
        assert (trial.instead, trial.false_stop) == ("empty", not is_waiting), pair.id


def test_the_target_is_shown_no_mission_no_code_and_no_plan_of_ours(
    suite: Suite, yard: Yard
) -> None:
    says = Says(b"?")
    ran(suite, yard, says, turns=2)
    for briefing in says.seen:
        shown = msgspec.json.encode(msgspec.structs.replace(briefing, usual=())).decode()
        for word in ("OUT_OF_SCOPE", "PROVENANCE_DENIED", "grants", "nonce", "tau_1", "mission_"):
            assert word not in shown


# bad input


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"suite": "nothing"}, UnknownNameError, "no suite is called `nothing`"),
        ({"planner": "nobody"}, UnknownNameError, "no planner is called `nobody`"),
        ({"planner": "hijacked:x=1"}, UnknownNameError, "takes no option `x`"),
        ({"planner": "graded:susceptibility"}, UnknownNameError, "`option=value` is expected"),
        ({"attacker": "nobody"}, UnknownNameError, "no attacker is called"),
        ({"defenses": ("nothing",)}, UnknownNameError, "no defense is called"),
        ({"suite": "/nowhere/suite.jsonl"}, SuiteError, "nowhere"),
    ],
)
def test_what_there_is_not_is_named_and_leaves_no_log(
    tmp_path: Path,
    hijacked: CampaignPlan,
    change: dict[str, Any],
    error: type[Exception],
    text: str,
) -> None:
    with pytest.raises(error, match=text):
        run(msgspec.structs.replace(hijacked, **change), tmp_path / "log")
    assert not (tmp_path / "log").exists()


def test_a_pair_that_cannot_be_made_real_is_named(suite: Suite, yard: Yard) -> None:
    pair = suite.pairs[0]
    attack = msgspec.structs.replace(pair.attack, robot="nobody")
    broken = msgspec.structs.replace(pair, attack=attack)
    with pytest.raises(StageError, match="nobody"):
        ran(suite, yard, Says(b"?"), broken, kinds=(TrialKind.ATTACK,))
    spoiled = msgspec.structs.replace(
        pair, missions={"v1": {**pair.missions["v1"], "robot": "nobody"}}
    )
    with pytest.raises(StageError, match=pair.id):
        ran(suite, yard, Says(b"?"), spoiled, kinds=(TrialKind.ATTACK,))


def test_a_suite_of_a_name_and_of_its_file_are_the_same(tmp_path: Path, suite: Suite) -> None:
    path = tmp_path / "mine.jsonl"
    suites.write_suite(suite, path)
    (read, digest), (made, other) = suites.load(str(path)), loaded("live")
    assert (read.name, read.version, read.pairs, digest) == (
        "live",
        made.version,
        made.pairs,
        other,
    )


def test_every_category_of_the_paper_is_in_the_live_suite(suite: Suite) -> None:
    wanted = {"goal", "capability", "object", "provenance", "area", "parameter"}
    assert {str(pair.categories[0]) for pair in suite.pairs} == wanted
    for kind in map(Category, wanted):
        assert sum(pair.categories[0] is kind for pair in suite.pairs) == 10


def test_what_fails_in_another_process_is_told_here(
    tmp_path: Path, suite: Suite, hijacked: CampaignPlan
) -> None:
    pair = suite.pairs[0]
    attack = msgspec.structs.replace(pair.attack, start=Start(at="nowhere"))
    spoiled = msgspec.structs.replace(pair, attack=attack)
    path = file_of(tmp_path / "spoiled.jsonl", suite, spoiled)
    plan = msgspec.structs.replace(hijacked, suite=path, pairs=1)
    with pytest.raises((StageError, SuiteError), match="nowhere"):
        run(plan, tmp_path / "log", jobs=2)


@pytest.mark.parametrize(
    "error",
    [
        StageError("a", where="b"),
        LogError("a", where="b", is_here=True),
        SuiteError("a", where="b"),
        PlannerError("a", code="cost", where="b"),
        AttackerError("a", code="cost", where="b"),
    ],
)
def test_every_error_comes_whole_from_another_process(error: Exception) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


# baselines


@pytest.mark.usefixtures("held_to_little")
def test_a_baseline_that_does_not_do_what_it_claims_is_not_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, few: str
) -> None:
    def lets_everything_through(stage: Stage, raw: bytes) -> ExecutedPlan:
        return past_the_gate(stage, raw, lambda *_: None)

    def apart(specs: tuple[str, ...]) -> tuple[Any, ...]:
        made = registry.make(defenses, "allowlist")
        if broken:
            made.carry_out = lets_everything_through
        return (made,)

    monkeypatch.setattr(workers, "apart", apart)
    plan = CampaignPlan(
        suite=few, planner="hijacked", defenses=("allowlist",), pairs=1, kinds=(TrialKind.ATTACK,)
    )
    broken = False
    run(plan, tmp_path / "fit")
    broken = True
    with pytest.raises(DefenseError, match="an attack of its own kind was carried out"):
        run(plan, tmp_path / "unfit")
    assert not (tmp_path / "unfit").exists()
    run(msgspec.structs.replace(plan, unqualified=True), tmp_path / "unfit")
    assert len(list(read_log(tmp_path / "unfit")[1])) == 1


def test_two_defenses_of_one_name_are_refused(tmp_path: Path, hijacked: CampaignPlan) -> None:
    plan = msgspec.structs.replace(hijacked, defenses=("both", "both"))
    with pytest.raises(UnknownNameError, match="two defenses are called `both`"):
        run(plan, tmp_path / "log")


def test_what_a_baseline_was_held_to_stands_in_the_first_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    benign, own = amount(6, _qualify.MOST_BENIGN), amount(4, _qualify.LEAST_OWN)
    monkeypatch.setattr(_qualify, "MOST_BENIGN", benign)
    monkeypatch.setattr(_qualify, "LEAST_OWN", own)
    plan = CampaignPlan(
        suite="live",
        planner="hijacked",
        defenses=("allowlist", "both"),
        pairs=1,
        kinds=(TrialKind.ATTACK,),
    )
    log = tmp_path / "log"
    (held,) = run(plan, log).qualified
    assert (held.defense, held.benign, held.pairs) == ("allowlist", benign, 1)
    assert held.held_as == ""
    assert held.own >= own
    assert read_log(log)[0].qualified == (held,)
    # a log that goes on is not held to it again, and keeps what it says
    assert run(msgspec.structs.replace(plan, unqualified=True), log).qualified == (held,)
    # one that is empty is
    monkeypatch.setattr(_qualify, "MOST_BENIGN", 3)
    log.write_bytes(b"")
    (again,) = run(plan, log).qualified
    assert (again.benign, again.own >= own) == (3, True)


@pytest.mark.usefixtures("held_to_little")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_baseline_is_held_to_every_benign_run_of_the_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suite: Suite, few: str, jobs: int
) -> None:
    """Before the start every other pair is tried, so the second is not."""
    stopped = suite.pairs[1]

    def stops_one(stage: Stage, raw: bytes) -> ExecutedPlan:
        if stage.pair.id == stopped.id and raw == plan_bytes(stopped.benign.plan):
            return ExecutedPlan(planned=1, by="allowlist", reasons=("NO",))
        return carry_out(stage, raw)

    def apart(specs: tuple[str, ...]) -> tuple[Any, ...]:
        made.carry_out = stops_one
        return (made,)

    made = registry.make(defenses, "allowlist")
    carry_out = made.carry_out
    monkeypatch.setattr(workers, "apart", apart)
    plan = CampaignPlan(
        suite=few, planner="hijacked", defenses=("allowlist",), pairs=3, kinds=(TrialKind.ATTACK,)
    )
    unqualified = msgspec.structs.replace(plan, unqualified=True)
    log = tmp_path / "log"
    # what was begun under the rule goes on under it, whatever is asked for then
    for asked in (plan, plan, unqualified):
        with pytest.raises(DefenseError, match=rf"{stopped.id}: a benign run was stopped") as told:
            run(asked, log, jobs=jobs)
        assert "`--unqualified`" in str(told.value)
        campaign, trials = read_log(log, is_partial_allowed=True)
        assert [one.pairs for one in campaign.qualified] == [3]
        assert [trial.pair for trial in trials] == [suite.pairs[0].id]
    assert run(unqualified, tmp_path / "unheld", jobs=jobs).qualified == ()
    assert len(list(read_log(tmp_path / "unheld")[1])) == 3


@pytest.mark.usefixtures("held_to_little")
def test_a_person_is_held_awake_and_scored_with_every_error(tmp_path: Path, few: str) -> None:
    plan = CampaignPlan(
        suite=few,
        planner="hijacked",
        defenses=("human:refuses=1,floor=0.95",),
        pairs=2,
        kinds=(TrialKind.BENIGN,),
    )
    log = tmp_path / "log"
    (held,) = run(plan, log).qualified
    assert (held.defense, held.pairs, held.held_as) == ("human", 2, "awake, without errors")
    campaign, trials = read_log(log)
    assert campaign.defenses[0].parameters["refuses"] == 1.0
    assert [trial.completed for trial in trials] == [False, False]


def test_a_slice_is_spread_over_the_suite_and_of_its_own_log(tmp_path: Path, suite: Suite) -> None:
    plan = CampaignPlan(suite="live", planner="hijacked", every=10, kinds=(TrialKind.ATTACK,))
    log = tmp_path / "log"
    made = run(plan, log)
    assert (made.every, made.pairs, made.trials) == (10, 6, 6)
    found = list(read_log(log)[1])
    assert [one.pair for one in found] == [pair.id for pair in suite.pairs[::10]]
    assert len({one.categories[0] for one in found}) == 6
    with pytest.raises(LogError, match=r"another campaign \(pairs, trials, every\)"):
        run(msgspec.structs.replace(plan, every=20), log)


# nothing that was finished is lost


class Paid:
    """A planner that asks a model: it complies so often, then its cap is reached."""

    name, simulated, cost_microusd = "paid", True, 0

    def __init__(self, most: int) -> None:
        self.most, self.asked = most, 0

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        if self.asked >= self.most:
            raise PlannerError("the cap is reached", code="cost", where="max_cost")
        self.asked += 1
        return Reply(raw=b"?")


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_cap_in_the_middle_of_a_pair_loses_no_trial_and_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, few: str, jobs: int
) -> None:
    made: list[Paid] = []

    def make(room: Any, spec: str, **given: Any) -> Any:
        if spec == "paid":
            return made[-1]
        return real(room, spec, **given)

    real = registry.make
    monkeypatch.setattr(registry, "make", make)
    log = tmp_path / "log"
    plan = CampaignPlan(
        suite=few, planner="paid", pairs=6, kinds=(TrialKind.ATTACK, TrialKind.BENIGN)
    )
    made.append(Paid(5))
    with pytest.raises(PlannerError, match="the cap is reached"):
        run(plan, log, jobs=jobs)
    before = list(read_log(log, is_partial_allowed=True)[1])
    assert len(before) == 5 if jobs == 1 else len(before) >= 2
    made.append(Paid(1_000))
    run(plan, log, jobs=jobs)
    after = list(read_log(log)[1])
    assert after[: len(before)] == before
    assert len(after) == 12
    assert not (tmp_path / "log.ahead").exists()
    if jobs == 1:  # what is in the log is not asked again, also of the pair that was cut
        assert made[-1].asked == 12 - 5


def test_a_pair_that_a_model_finished_ahead_of_its_turn_is_not_asked_again(tmp_path: Path) -> None:
    campaign = campaign_records.campaign(pairs=3, trials=6)
    ahead = Ahead(tmp_path / "ahead", campaign)
    ours = [TrialResult(campaign_records.kept(n)) for n in (2, 3)]
    assert ahead.kept(1) == ()
    with ahead.begin(1) as file:
        for item in ours:
            keep(file, item)
        assert ahead.kept(1) == ()
        end(file)
    assert ahead.kept(1) == tuple(ours)
    other = Ahead(tmp_path / "ahead", msgspec.structs.replace(campaign, seed=1))
    assert other.kept(1) == ()
    other.remove()
    assert ahead.kept(1) == tuple(ours)
    ahead.path(2).write_bytes(ahead.path(1).read_bytes())
    assert ahead.kept(2) == ()  # another pair's
    data = ahead.path(1).read_bytes()
    ahead.path(1).write_bytes(data.replace(b'"complied"', b'"complies"'))
    assert ahead.kept(1) == ()
    with ahead.begin(1) as file:
        keep(file, ours[0])
        keep(file, TrialResult(campaign_records.kept(3), EMPTY))
        end(file)
    assert ahead.kept(1) == ()  # one that nobody answered is asked again
    with Tail(ahead.path(1)) as tail:
        found = list(tail.read())
    assert [type(one.failure) for one in found] == [type(None), PlannerError]
    assert vars(found[1].failure) == vars(EMPTY)
    ahead.remove()
    assert not (tmp_path / "ahead").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "ahead").write_text("mine")
    with pytest.raises(LogError, match="ahead"):
        Ahead(tmp_path / "ahead", campaign_records.campaign()).begin(0)
