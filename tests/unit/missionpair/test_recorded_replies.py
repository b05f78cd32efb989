# SPDX-License-Identifier: Apache-2.0
"""Logs of real runs become a planner: marked as recorded, chosen by pair, and never more than said.

How-to: docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

import json
import re
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import b64
from fixtures.missionpair_program import told
from missionpair import planners
from missionpair.briefing import Briefing, PlannerError
from missionpair.campaign.log import read_log
from missionpair.campaign.plan import PlanError
from missionpair.campaign.run import CampaignPlan, run
from missionpair.measures import measure
from missionpair.pair import Input, Pair, WordedCall
from missionpair.recorded.archive import SourceError
from missionpair.recorded.replies import import_replies
from missionpair.report.setup import remarks, setup_table
from missionpair.suites import load
from missionpair.words import Channel, TrialKind


def written(path: Path, *lines: object) -> Path:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def record(form: str, pair: str, calls: tuple[WordedCall, ...], **more: Any) -> dict[str, Any]:
    """Return a line of a log: these calls, in one of the forms."""
    plain = [(call.tool, call.arguments) for call in calls]
    match form:
        case "steps":
            field: Any = [{"tool": tool, "arguments": given} for tool, given in plain]
        case "openai":
            called = [
                {
                    "id": str(n),
                    "type": "function",
                    "function": {"name": tool, "arguments": json.dumps(given)},
                }
                for n, (tool, given) in enumerate(plain)
            ]
            message = {"role": "assistant", "content": None, "tool_calls": called}
            field = {
                "id": "x",
                "object": "chat.completion",
                "created": 1_764_288_000,
                "model": "model-1",
                "choices": [{"index": 0, "message": message, "finish_reason": "tool_calls"}],
            }
        case "mcp":
            field = [
                {
                    "jsonrpc": "2.0",
                    "id": n,
                    "method": "tools/call",
                    "params": {"name": tool, "arguments": given},
                }
                for n, (tool, given) in enumerate(plain)
            ]
        case _:
            answered = {
                "type": "ai",
                "content": "",
                "tool_calls": [
                    {"name": tool, "args": given, "id": str(n)}
                    for n, (tool, given) in enumerate(plain)
                ],
                "response_metadata": {"model_name": "model-1"},
            }
            field = [{"type": "human", "content": "Go."}, answered]
    name = {"openai": "response", "mcp": "calls", "langchain": "messages"}.get(form, "steps")
    return {"pair": pair, name: field, **more}


@pytest.fixture
def pairs(few: str) -> tuple[Pair, ...]:
    return load(few)[0].pairs


FORMS = ("steps", "openai", "mcp", "langchain")


def test_every_call_of_a_conversation_counts_and_not_its_last_words_alone(
    tmp_path: Path, pairs: tuple[Pair, ...]
) -> None:
    """An agent calls one tool after the other, and says at the end that it is done."""
    pair = pairs[0]
    plan = pair.benign.plan
    made = [record("langchain", pair.id, (call,))["messages"][1] for call in plan]
    answers = [{"type": "tool", "content": "ok", "tool_call_id": "0"}] * len(made)
    turns = [message for both in zip(made, answers, strict=True) for message in both]
    talk = [{"type": "human", "content": "Go."}, *turns, {"type": "ai", "content": "Done."}]
    source = written(tmp_path / "log.jsonl", {"pair": pair.id, "messages": talk})
    out = tmp_path / "replies.jsonl"
    import_replies("langchain", source, out, model="model-1", date="2026-11-28")
    raw = json.loads(out.read_text().splitlines()[1])["raw"]
    assert [step["tool"] for step in json.loads(raw)["plan"]] == [call.tool for call in plan]


@pytest.mark.parametrize("form", FORMS)
def test_a_log_of_each_form_becomes_a_planner_that_complies_as_the_model_did(
    tmp_path: Path, few: str, pairs: tuple[Pair, ...], form: str
) -> None:
    pair = pairs[0]
    source = written(tmp_path / "log.jsonl", record(form, pair.id, pair.attack.plan))
    out = tmp_path / "replies.jsonl"
    head, count = import_replies(form, source, out, model="model-1", date="2025-11-28")
    assert count == 1
    assert (head.model, head.date, head.source) == ("model-1", "2025-11-28", "log.jsonl")
    assert head.digest == b64(sha256(source.read_bytes()).digest())
    plan = CampaignPlan(
        suite=few,
        planner=f"recorded:file={out}",
        defenses=("none", "both"),
        kinds=(TrialKind.ATTACK,),
    )
    campaign = run(plan, tmp_path / "campaign.jsonl")
    assert (campaign.pairs, campaign.skipped) == (1, len(pairs) - 1)
    assert campaign.planner.simulated is False
    assert campaign.planner.parameters["model"] == "model-1"
    _, trials = read_log(tmp_path / "campaign.jsonl")
    assert [(t.defense, t.complied, t.blocked) for t in trials] == [
        ("none", True, False),
        ("both", True, True),
    ]


def test_a_report_says_that_a_planner_is_recorded_and_what_was_left_out(
    tmp_path: Path, few: str, pairs: tuple[Pair, ...]
) -> None:
    source = written(tmp_path / "log", record("steps", pairs[0].id, pairs[0].attack.plan))
    out = tmp_path / "replies.jsonl"
    import_replies("steps", source, out, model="model-1", date="2025-11-28")
    logs = []
    for name in (f"recorded:file={out}", "hijacked"):
        plan = CampaignPlan(suite=few, planner=name, kinds=(TrialKind.ATTACK,))
        log = tmp_path / f"{name[:8]}.jsonl"
        run(plan, log)
        logs.append(measure(*read_log(log)))
    text = "\n".join(remarks(tuple(logs)))
    assert "Log 1: the planner's answers were recorded before: date 2025-11-28" in text
    assert "model model-1" in text
    assert f"Log 1: {len(pairs) - 1} pairs were left out" in text
    assert "planners are recorded and simulated" in text
    table = setup_table(tuple(logs))
    column = [head.key for head in table.heads].index("standing")
    assert [row[column] for row in table.rows] == ["recorded", "simulated"]
    name = [head.key for head in table.heads].index("planner")
    assert "(recorded)" in str(table.rows[0][name])


def test_rounds_end_where_the_record_ends(
    tmp_path: Path, few: str, pairs: tuple[Pair, ...]
) -> None:
    pair = pairs[0]
    lines = [record("steps", pair.id, (), round=n) for n in range(2)]
    out = tmp_path / "replies.jsonl"
    import_replies("steps", written(tmp_path / "log", *lines), out, model="m", date="2025-11-28")
    plan = CampaignPlan(
        suite=few, planner=f"recorded:file={out}", rounds=3, kinds=(TrialKind.ATTACK,)
    )
    run(plan, tmp_path / "campaign.jsonl")
    (trial,) = read_log(tmp_path / "campaign.jsonl")[1]
    assert (len(trial.rounds), trial.error) == (2, "")


def test_a_record_without_a_kind_that_is_asked_for_is_refused(
    tmp_path: Path, few: str, pairs: tuple[Pair, ...]
) -> None:
    source = written(tmp_path / "log", record("steps", pairs[0].id, ()))
    out = tmp_path / "replies.jsonl"
    import_replies("steps", source, out, model="m", date="2025-11-28")
    plan = CampaignPlan(suite=few, planner=f"recorded:file={out}")
    with pytest.raises(PlannerError, match="choose kinds with `--kind`"):
        run(plan, tmp_path / "campaign.jsonl")


def test_the_bytes_of_a_model_are_kept(tmp_path: Path, pairs: tuple[Pair, ...]) -> None:
    """An argument that is given twice stays so: the normalizer refuses it, as it did live."""
    twice = '{"plan": [{"tool": "go", "arguments": {"to": "a", "to": "b"}}]}'
    line = f'{{"pair": "{pairs[0].id}", "steps": [{twice[10:-2]}]}}\n'
    (tmp_path / "log").write_text(line)
    out = tmp_path / "replies.jsonl"
    import_replies("steps", tmp_path / "log", out, model="m", date="2025-11-28")
    assert json.loads(out.read_text().splitlines()[1])["raw"] == twice


STEPS = {"pair": "p", "steps": []}


@pytest.mark.parametrize(
    ("form", "lines", "message"),
    [
        ("steps", [{"pair": "p"}], "expected the field `steps`"),
        ("steps", [{"pair": "p", "steps": [], "calls": []}], "and no other form's"),
        ("steps", [{"pair": "p", "calls": []}], "expected the field `steps`"),
        ("steps", [STEPS, STEPS], "a second time"),
        ("steps", [{**STEPS, "round": -1}], "is no reply of the form"),
        ("steps", [{**STEPS, "kind": "other"}], "is no reply of the form"),
        ("steps", [{**STEPS, "more": 1}], "is no reply of the form"),
        ("steps", [{**STEPS, "model": "other"}], "an earlier line says `m`"),
        ("steps", ["text"], "is no reply of the form"),
        ("steps", [{**STEPS, "kind": "atack"}], "a kind is one of attack, control"),
        ("steps", [{**STEPS, "inputs": [["sgn", "Go."]]}], "a channel of `inputs` one of "),
        ("steps", [{**STEPS, "more": 1}], "a line has pair, round, kind"),
        ("steps", [{**STEPS, "date": "27.11.2026"}], "write the day as 2026-11-28"),
        ("steps", [{**STEPS, "date": "9999-01-01"}], "is in the future"),
        ("steps", [{"pair": "p", "steps": [{"name": "go", "args": {}}]}], "a step has tool"),
        ("steps", [{"pair": "p", "steps": [{"tool": "go"}]}], "required field `arguments`"),
        ("steps", [{"pair": "p", "steps": ["go"]}], "Expected `object`"),
        ("openai", [{"pair": "p", "response": {"created": -5}}], "seconds since 1970"),
        ("openai", [{"pair": "p", "response": []}], "is no reply of the form"),
        ("mcp", [{"pair": "p", "calls": [{"method": "x", "params": {"name": "a"}}]}], "tools/call"),
        ("langchain", [{"pair": "p", "messages": []}], "expected a message of the model"),
        (
            "langchain",
            [{"pair": "p", "messages": [{"type": "ai", "content": [{"type": "tool_use"}]}]}],
            "give it in `tool_calls`",
        ),
        (
            "langchain",
            [{"pair": "p", "messages": [{"type": "ai", "additional_kwargs": {"tool_calls": [1]}}]}],
            "give it in `tool_calls`",
        ),
    ],
)
def test_a_line_that_is_no_reply_is_refused_by_place(
    tmp_path: Path, form: str, lines: list[Any], message: str
) -> None:
    source = written(tmp_path / "log", *lines)
    with pytest.raises(SourceError, match=message) as caught:
        import_replies(form, source, tmp_path / "out", model="m", date="2025-11-28")
    assert f"{source}:{len(lines)}" in caught.value.where
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no reply"),
        ("\n", "is empty: write one JSON object a line"),
        ('{"pair": "p",\n"steps": []}\n', "one whole JSON object a line"),
        ('{"pair": "p", "pair": "q", "steps": []}', "has the field `pair` twice"),
        ("\x1f\x8b", "plain UTF-8"),
    ],
)
def test_a_log_that_is_no_list_of_objects_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "log").write_text(text)
    with pytest.raises(SourceError, match=message):
        import_replies("steps", tmp_path / "log", tmp_path / "out", model="m", date="2025-11-28")


def test_a_last_line_without_its_end_is_read(tmp_path: Path) -> None:
    (tmp_path / "log").write_text('{"pair": "p", "steps": []}')
    found = import_replies("steps", tmp_path / "log", tmp_path / "o", model="m", date="2025-11-28")
    assert found[1] == 1


def test_replies_to_one_suite_are_no_answers_in_another(
    tmp_path: Path, few: str, pairs: tuple[Pair, ...]
) -> None:
    """`live` and `long` have pairs of one name and of other tasks."""
    shared = "hospital.goal.destination-change.sign.01"
    log, more = written(tmp_path / "log", record("steps", shared, ())), {"model": "m"}
    out = tmp_path / "replies.jsonl"
    import_replies("steps", log, out, **more, date="2025-11-28", suite="live")
    for suite, why in (("long", "another suite than `long`"), (few, "no pair of the suite|than")):
        plan = CampaignPlan(
            suite=suite, planner=f"recorded:file={out}", kinds=(TrialKind.ATTACK,), turns=1
        )
        with pytest.raises((PlanError, PlannerError), match=why):
            run(plan, tmp_path / "campaign.jsonl")
    log = written(tmp_path / "log", record("steps", pairs[0].id, ()), record("steps", "typo", ()))
    with pytest.raises(SourceError, match="`typo`, which is no pair of") as failed:
        import_replies("steps", log, tmp_path / "o", **more, date="2025-11-28", suite=few)
    assert failed.value.where.endswith(":2")
    import_replies("steps", log, tmp_path / "o", **more, date="2025-11-28")
    plan = CampaignPlan(
        suite=few, planner=f"recorded:file={tmp_path / 'o'}", kinds=(TrialKind.ATTACK,)
    )
    with pytest.raises(PlannerError, match="answers `typo`, which is no pair of the suite"):
        run(plan, tmp_path / "campaign.jsonl")


def test_who_answered_and_when_has_to_be_said(tmp_path: Path) -> None:
    source = written(tmp_path / "log", STEPS)
    for more in ({"date": "2025-11-28"}, {"model": "m"}):
        with pytest.raises(SourceError, match="does not say"):
            import_replies("steps", source, tmp_path / "out", **more)


@pytest.mark.parametrize("text", ["", "{}\n", "{", '{"format": "other"}\n'])
def test_a_file_that_is_no_file_of_replies_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "replies.jsonl"
    path.write_text(text)
    with pytest.raises(PlannerError) as caught:
        planners.make(f"recorded:file={path}")
    assert caught.value.code == "file"


def spoken(pair: str, content: str | None) -> dict[str, Any]:
    """Return a completion without a call."""
    message = {"role": "assistant", "content": content}
    choices = [{"index": 0, "message": message, "finish_reason": "stop"}]
    return {"pair": pair, "response": {"model": "m", "created": 1_764_288_000, "choices": choices}}


def imported(tmp_path: Path, *records: dict[str, Any]) -> list[dict[str, Any]]:
    out = tmp_path / "replies.jsonl"
    import_replies("openai", written(tmp_path / "log.jsonl", *records), out)
    return [json.loads(line) for line in out.read_text().splitlines()[1:]]


def test_a_completion_is_read_as_a_live_model_s_is(tmp_path: Path) -> None:
    """A plan that is written in words is that plan, and a refusal is one."""
    plan, no = imported(tmp_path, spoken("a", '{"plan": []}'), spoken("b", "I can't do that."))
    assert (plan["raw"], plan["refused"]) == ('{"plan": []}', False)
    assert (no["raw"], no["refused"]) == ("I can't do that.", True)


def test_a_completion_that_says_nothing_is_refused_by_its_line(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="answered nothing") as failed:
        imported(tmp_path, spoken("a", "words"), spoken("b", None))
    assert failed.value.where.endswith("log.jsonl:2")


def planner_of(tmp_path: Path, *records: dict[str, Any]) -> Any:
    log, out = tmp_path / "log.jsonl", tmp_path / "replies.jsonl"
    import_replies("steps", written(log, *records), out, model="m", date="2026-11-28")
    return planners.make(f"recorded:file={out}")


def test_a_reply_to_other_texts_is_no_answer(tmp_path: Path) -> None:
    planner = planner_of(tmp_path, {"pair": "p", "steps": [], "inputs": [["sign", "Go."]]})
    shown = Briefing(
        rules="", task="", situation="", places=(), things=(), tools=(), trial=("p", "attack", 0)
    )
    same = msgspec.structs.replace(shown, inputs=(Input(Channel.SIGN, "Go."),))
    assert planner.propose(same, seed=1).raw == b'{"plan": []}'
    with pytest.raises(PlannerError, match="answered other `inputs`"):
        planner.propose(shown, seed=1)


def rounds_of(kind: str, *rounds: int) -> list[dict[str, Any]]:
    return [{"pair": "p", "steps": [], "kind": kind, "round": number} for number in rounds]


def test_a_control_arm_needs_as_many_rounds_as_the_attack(tmp_path: Path) -> None:
    """More tries are more chances: an attack with more would differ by that alone."""
    both = ("attack", "control")
    longer = planner_of(tmp_path, *rounds_of("attack", 0, 1), *rounds_of("control", 0))
    assert longer.knows("p", ("attack",))
    assert not longer.knows("p", both)
    assert not longer.knows("p", ("attack", "benign"))
    assert not longer.knows("q", both)
    (tmp_path / "replies.jsonl").unlink()
    gap = planner_of(tmp_path, *rounds_of("attack", 0, 1), *rounds_of("control", 0, 2))
    assert not gap.knows("p", both)


def test_an_attack_that_ended_early_with_a_success_is_not_left_out(tmp_path: Path) -> None:
    planner = planner_of(tmp_path, *rounds_of("attack", 0), *rounds_of("control", 0, 1, 2))
    assert planner.knows("p", ("attack", "control"))


def test_a_planner_names_the_file_of_its_replies_by_digest(tmp_path: Path) -> None:
    """Who edits an answer has another planner: a campaign does not go on with it."""
    first = planner_of(tmp_path, *rounds_of("attack", 0))
    path = tmp_path / "replies.jsonl"
    assert first.parameters["replies"] == b64(sha256(path.read_bytes()).digest())
    path.write_text(path.read_text().replace("[]", "[{}]"))
    second: Any = planners.make(f"recorded:file={path}")
    assert second.parameters["digest"] == first.parameters["digest"]
    assert second.parameters["replies"] != first.parameters["replies"]


def said_by(*messages: dict[str, Any]) -> dict[str, Any]:
    return {"pair": "p", "messages": list(messages), "model": "m", "date": "2026-11-28"}


def chained(tmp_path: Path, *messages: dict[str, Any]) -> dict[str, Any]:
    log, out = tmp_path / "log.jsonl", tmp_path / "replies.jsonl"
    import_replies("langchain", written(log, said_by(*messages)), out)
    found: dict[str, Any] = json.loads(out.read_text().splitlines()[1])
    return found


def test_a_message_of_langchain_is_read_as_a_live_answer_is(tmp_path: Path) -> None:
    refusal = chained(tmp_path, {"type": "ai", "content": "I'm sorry, I can't do that."})
    assert refusal["refused"] is True


def test_a_broken_call_of_langchain_is_an_answer_that_no_gate_can_read(tmp_path: Path) -> None:
    good = {"name": "navigate_to", "args": {"destination": "Station 103"}, "id": "0"}
    bad = {"name": "navigate_to", "args": '{"destination": ', "id": "1", "error": "cut"}
    found = chained(tmp_path, {"type": "ai", "tool_calls": [good], "invalid_tool_calls": [bad]})
    assert [step["arguments"] for step in json.loads(found["raw"])["plan"]] == [
        {"destination": "Station 103"},
        '{"destination": ',
    ]


def test_a_message_that_langchain_dumped_with_its_constructor_is_read(tmp_path: Path) -> None:
    inner = {"type": "ai", "content": "", "tool_calls": [{"name": "x", "args": {}, "id": "0"}]}
    dumped = {"lc": 1, "type": "constructor", "id": ["langchain", "AIMessage"], "kwargs": inner}
    assert json.loads(chained(tmp_path, dumped)["raw"])["plan"] == [{"tool": "x", "arguments": {}}]


@pytest.mark.parametrize(
    ("messages", "says"),
    [
        ([{"type": "ai", "content": ""}], "answered nothing"),
        (
            [
                {"type": "ai", "content": "a", "response_metadata": {"model_name": name}}
                for name in ("one", "two")
            ],
            "expected one model, got one, two",
        ),
    ],
)
def test_what_langchain_cannot_mean_is_refused(
    tmp_path: Path, messages: list[dict[str, Any]], says: str
) -> None:
    with pytest.raises(SourceError, match=says):
        chained(tmp_path, *messages)


@pytest.mark.parametrize("where", ["line", "option"])
def test_a_day_that_is_none_is_refused(tmp_path: Path, where: str) -> None:
    more = {"date": "2026-99-99"} if where == "line" else {}
    log = written(tmp_path / "log.jsonl", {"pair": "p", "steps": [], **more})
    date = "" if where == "line" else "2026-99-99"
    with pytest.raises(SourceError, match=r"99|month"):
        import_replies("steps", log, tmp_path / "out", model="m", date=date)


def test_another_date_than_the_log_s_is_refused(tmp_path: Path) -> None:
    log = written(tmp_path / "log.jsonl", {"pair": "p", "steps": [], "date": "2026-11-27"})
    with pytest.raises(SourceError, match=r"other dates \(2026-11-27\) than `--date 2026-11-28`"):
        import_replies("steps", log, tmp_path / "out", model="m", date="2026-11-28")


def test_one_reply_is_not_counted_for_several_seeds(tmp_path: Path, few: str) -> None:
    pair = load(few)[0].pairs[0]
    planner_of(tmp_path, record("steps", pair.id, pair.attack.plan))
    plan = CampaignPlan(
        suite=few,
        planner=f"recorded:file={tmp_path / 'replies.jsonl'}",
        kinds=(TrialKind.ATTACK,),
        seeds=2,
    )
    with pytest.raises(PlanError, match="--seeds 1"):
        run(plan, tmp_path / "out.jsonl")


def test_on_the_command_line(
    tmp_path: Path,
    pairs: tuple[Pair, ...],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = written(tmp_path / "log", record("openai", pairs[0].id, pairs[0].benign.plan))
    words = ("import", "openai", source, "--out", tmp_path / "replies.jsonl")
    code, said = told(capsys, monkeypatch, *words)
    assert (code, said["replies"], said["model"], said["date"]) == (0, 1, "model-1", "2025-11-28")
    code, said = told(capsys, monkeypatch, *words)
    assert (code, said["error"]["where"]) == (2, "--out")


PAGE = Path(__file__).parents[3] / "docs" / "howto" / "missionpair-models.md"


@pytest.mark.parametrize("form", FORMS)
def test_the_pages_line_of_each_form_is_one(tmp_path: Path, form: str) -> None:
    (line,) = re.findall(rf"^\| `{form}` \|.*\| `(\{{.*\}})` \|$", PAGE.read_text(), re.MULTILINE)
    (tmp_path / "log").write_text(line)
    day = "" if form == "openai" else "2025-11-27"  # a completion says its own
    log, out = tmp_path / "log", tmp_path / "out"
    head, count = import_replies(form, log, out, model="m", date=day, suite="hand")
    assert (count, bool(head.suite_digest)) == (1, True)
