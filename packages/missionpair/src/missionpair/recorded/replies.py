# SPDX-License-Identifier: Apache-2.0
"""Replies of a model in the logs of real runs, kept by pair, kind of trial and round.

A log is JSON Lines, one reply a line: `{"pair", "round"?, "kind"?, "refused"?, "inputs"?,
"model"?, "date"?}` with one more field, by its form:

    steps      `steps`: a list of `{"tool", "arguments"}`
    openai     `response`: a chat completion, as its server sent it
    mcp        `calls`: the JSON-RPC requests `tools/call`, in order
    langchain  `messages`: the conversation; every call of the model, in order, else its last words

Calls of a chat completion are kept byte for byte, and words as they are; of the other forms the
names and arguments are kept. With a suite, each line must name one of its pairs.
How-to: docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from datetime import date as date_type
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta, Raw, Struct
from msgspec.structs import asdict

from authguard_r.authoring.model_client.exchange import ModelServerError
from authguard_r.authoring.model_client.protocols import OpenAIProtocol
from authguard_r.core.encoding import b64
from missionpair import suites
from missionpair.briefing import PlannerError
from missionpair.planners._answers import read_answer
from missionpair.planners._client import Completion
from missionpair.recorded.archive import SourceError
from missionpair.words import Channel, TrialKind

FORMAT = "missionpair/replies/1"
#: Longest line, in bytes.
_MAX_LINE = 8 << 20
_UNREADABLE = (
    *(msgspec.DecodeError, ValueError, OverflowError, RecursionError, OSError),
    *(ModelServerError, PlannerError),
)
_Date = Annotated[str, Meta(pattern=r"^[0-9]{4}-[0-9]{2}-[0-9]{2}$")]


class RepliesHead(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first line of a file of replies: whose they are.

    Args:
        format: of the file.
        model: who answered.
        date: when, `2026-11-28`.
        source: name of the log that was imported.
        digest: its SHA-256, base64url.
        suite_digest: SHA-256 of the suite whose pairs were answered; empty: not known.
    """

    format: str
    model: str
    date: _Date
    source: str
    digest: str
    suite_digest: str = ""


class PairReply(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One reply.

    Args:
        pair: the pair's id.
        kind: of the trial.
        round: from 0.
        raw: what the model wrote.
        refused: it said itself that it will not.
        inputs: what had reached it, channel and text; None: the log does not say.
    """

    pair: str
    kind: TrialKind
    round: Annotated[int, Meta(ge=0)]
    raw: str
    refused: bool = False
    inputs: tuple[tuple[Channel, str], ...] | None = None


class _Record(Struct, forbid_unknown_fields=True, kw_only=True):
    pair: str
    round: Annotated[int, Meta(ge=0)] = 0
    kind: TrialKind = TrialKind.ATTACK
    refused: bool = False
    inputs: tuple[tuple[Channel, str], ...] | None = None
    model: str = ""
    date: _Date | None = None
    steps: list[Raw] | None = None
    response: Raw = Raw()
    calls: list[Raw] | None = None
    messages: list[Raw] | None = None


class _PlanStep(Struct, forbid_unknown_fields=True):
    tool: str
    arguments: dict[str, Raw]


class _ReadAnswer(NamedTuple):
    raw: bytes
    model: str = ""
    date: str = ""
    refused: bool = False


class _Completion(Struct):
    model: str = ""
    created: int = 0


class _Params(Struct):
    name: Raw
    arguments: Raw = Raw(b"{}")


class _ToolsCall(Struct):
    method: str
    params: _Params


class _ChainCall(Struct):
    name: Raw
    args: Raw


class _ChainMessage(Struct):
    type: str = ""
    content: Any = ""
    additional_kwargs: dict[str, Any] = {}
    tool_calls: list[_ChainCall] = []
    invalid_tool_calls: list[_ChainCall] = []
    response_metadata: dict[str, Any] = {}
    data: _ChainMessage | None = None
    kwargs: _ChainMessage | None = None


def _steps(record: _Record) -> _ReadAnswer:
    for step in record.steps or ():
        msgspec.json.decode(step, type=_PlanStep)
    return _ReadAnswer(_plan(bytes(step) for step in record.steps or ()))


def _openai(record: _Record) -> _ReadAnswer:
    raw = bytes(record.response)
    said = msgspec.json.decode(raw, type=_Completion)
    if said.created < 0:
        raise ValueError(f"expected the seconds since 1970 at `created`, got {said.created}")
    done = Completion(**asdict(OpenAIProtocol().read(raw)))
    raw, refused = read_answer(done, (), model=said.model, where="response")
    date = datetime.fromtimestamp(said.created, UTC).date().isoformat() if said.created else ""
    return _ReadAnswer(raw, said.model, date, refused)


def _mcp(record: _Record) -> _ReadAnswer:
    steps = []
    for call in record.calls or ():
        asked = msgspec.json.decode(call, type=_ToolsCall)
        if asked.method != "tools/call":
            text = f"expected the method `tools/call`, got `{asked.method[:80]}`"
            raise ValueError(f"{text}: keep the requests of tools alone")
        steps.append(_step(asked.params.name, asked.params.arguments))
    return _ReadAnswer(_plan(steps))


def _langchain(record: _Record) -> _ReadAnswer:
    said = [_message(raw) for raw in record.messages or ()]
    answers = [one for one in said if one.type in {"ai", "AIMessage", "AIMessageChunk"}]
    if not answers:
        text = "expected a message of the model, with `type: ai` and `content` or `data`"
        raise ValueError(text)
    if any(_hides_calls(one) for one in answers):
        text = "a call stands in `content` or `additional_kwargs` alone: give it in `tool_calls`"
        raise ValueError(text)
    models = {str(one.response_metadata.get("model_name", "")) for one in answers} - {""}
    if len(models) > 1:
        raise ValueError(f"expected one model, got {', '.join(sorted(models))[:80]}")
    model = next(iter(models), "")
    # a call whose arguments are broken text stays one: the normalizer refuses the answer
    calls = [call for one in answers for call in (*one.tool_calls, *one.invalid_tool_calls)]
    if calls:
        return _ReadAnswer(_plan(_step(call.name, call.args) for call in calls), model)
    text = _text(answers[-1].content)
    done = Completion(text=text, raw=text.encode())
    said_last, refused = read_answer(done, (), model=model, where="messages")
    return _ReadAnswer(said_last, model, refused=refused)


def _message(raw: Raw) -> _ChainMessage:
    """Return a message, out of the wrapping that `messages_to_dict` or `dumpd` puts around it."""
    said = msgspec.json.decode(raw, type=_ChainMessage)
    if said.kwargs is not None:
        return said.kwargs
    return said if said.data is None else msgspec.structs.replace(said.data, type=said.type)


def _hides_calls(message: _ChainMessage) -> bool:
    """True when a message has calls in its server's own form, and none in LangChain's."""
    parts = message.content if isinstance(message.content, list) else []
    kinds = {part.get("type") for part in parts if isinstance(part, dict)}
    elsewhere = kinds & {"tool_use", "function_call"} or message.additional_kwargs.get("tool_calls")
    return bool(elsewhere) and not (message.tool_calls or message.invalid_tool_calls)


def _text(content: object) -> str:
    if isinstance(content, str):
        return content
    parts = content if isinstance(content, list) else []
    return "".join(str(part.get("text", "")) for part in parts if isinstance(part, dict))


def _step(name: Raw, arguments: Raw) -> bytes:
    return b'{"tool": ' + bytes(name) + b', "arguments": ' + bytes(arguments) + b"}"


def _plan(steps: Any) -> bytes:
    return b'{"plan": [' + b", ".join(steps) + b"]}"


#: What is allowed, by how a decoder's message begins.
_ALLOWED = {
    "Input data was truncated": "write one whole JSON object a line",
    "JSON is malformed": "write one JSON object a line, as plain UTF-8",
    "Invalid enum value": f"a kind is one of {', '.join(TrialKind)}; a channel of `inputs` one of "
    f"{', '.join(Channel)}",
    "Object contains unknown field": f"a line has {', '.join(_Record.__struct_fields__)}; a step "
    "has tool, arguments",
    "Expected `str` matching regex": "write the day as 2026-11-28",
    "'utf-8' codec": "write plain UTF-8; unpack a `.gz` file first",
}
#: What each form is read by, and the field that it has.
FORMS: dict[str, tuple[str, Callable[[_Record], _ReadAnswer]]] = {
    "steps": ("steps", _steps),
    "openai": ("response", _openai),
    "mcp": ("calls", _mcp),
    "langchain": ("messages", _langchain),
}


def import_replies(
    form: str, source: Path, out: Path, *, model: str = "", date: str = "", suite: str = ""
) -> tuple[RepliesHead, int]:
    """Read a log of one of the forms, and write a new file of replies.

    Args:
        form: one of `FORMS`.
        source: the log; who wrote it is not trusted.
        out: the new file.
        model: who answered, where the log does not say it.
        date: when, where the log does not say it.
        suite: name or file of the suite whose pairs were answered; empty: it is not checked.

    Returns:
        Whose the replies are, and how many.

    Raises:
        SourceError: a line is no reply of this form, repeats an answer, is of another model, or
            answers no pair of the suite. Or there is no line, the model or the date is missing, or
            `date` is none of the log's dates.
        SuiteError: there is no such suite.
        FileExistsError: there is such a file.
    """
    models, dates = _said(model), set[str]()
    asked, digest = suites.load(suite) if suite else (None, "")
    replies = _replies(_read(form, source), models, dates)
    if asked is not None:
        pairs = {pair.id for pair in asked.pairs}
        for where, reply in replies.values():
            if reply.pair not in pairs:
                text = f"answers `{reply.pair[:80]}`, which is no pair of `{suite}`"
                raise SourceError(f"{text}: `missionpair list {suite}` prints them", where=where)
    if not replies:
        raise SourceError("has no reply: give one JSON object on each line", where=str(source))
    if date and dates and date not in dates:
        text = f"says other dates ({', '.join(sorted(dates)[:3])}) than `--date {date}`"
        raise SourceError(text, where=str(source))
    dates = _said(date) or dates
    head = RepliesHead(
        format=FORMAT,
        model=_one(models, "which model answered: say `--model`", source),
        date=_one({min(dates)} if dates else set(), "when: say `--date`", source),
        source=source.name,
        digest=b64(sha256(source.read_bytes()).digest()),
        suite_digest=digest,
    )
    try:
        _require_day(head.date)
        msgspec.convert(msgspec.to_builtins(head), RepliesHead)
    except ValueError as error:
        raise SourceError(f"has no date such as 2026-11-28: {error}", where=str(source)) from error
    written = (head, *(reply for _, reply in replies.values()))
    lines = [msgspec.json.encode(one) + b"\n" for one in written]
    with out.open("xb") as file:
        file.writelines(lines)
    return head, len(replies)


def _replies(
    read: Iterator[tuple[str, _Record, _ReadAnswer]], models: set[str], dates: set[str]
) -> dict[tuple[str, str, int], tuple[str, PairReply]]:
    """Return each reply with its place, by the question; add the models and dates that lines say.

    Raises:
        SourceError: a line repeats an answer, or is of another model.
    """
    replies: dict[tuple[str, str, int], tuple[str, PairReply]] = {}
    for where, record, answer in read:
        _agree(models, record.model or answer.model, "model", where)
        dates |= _said(record.date or answer.date)
        reply = PairReply(
            pair=record.pair,
            kind=record.kind,
            round=record.round,
            raw=answer.raw.decode(),
            refused=record.refused or answer.refused,
            inputs=record.inputs,
        )
        key = (reply.pair, str(reply.kind), reply.round)
        if key in replies:
            text = f"answers `{reply.pair}`, {reply.kind}, round {reply.round} a second time"
            raise SourceError(text, where=where)
        replies[key] = where, reply
    return replies


def _read(form: str, source: Path) -> Iterator[tuple[str, _Record, _ReadAnswer]]:
    field, reads = FORMS[form]
    for where, line in lines_of(source):
        try:
            record = msgspec.json.decode(line, type=_Record)
            _require_once(line)
            _require_form(record, field)
            answer = reads(record)
            answer.raw.decode()
            if day := record.date or answer.date:
                _require_day(day)
            yield where, record, answer
        except _UNREADABLE as error:
            text = f"is no reply of the form `{form}`: {error}{_allowed(str(error))}"
            raise SourceError(text, where=where) from error


def _allowed(message: str) -> str:
    """Return what a decoder's message leaves out: what is allowed there."""
    for begin, told in _ALLOWED.items():
        if message.startswith(begin):
            return f" ({told})"
    return ""


def _require_once(line: bytes) -> None:
    """Refuse a line that has one field twice; what stands inside a reply is the model's."""
    # the hook is called for the outermost object last
    fields: list[list[str]] = [[]]
    json.loads(line, object_pairs_hook=lambda pairs: fields.append([name for name, _ in pairs]))
    twice = sorted({name for name in fields[-1] if fields[-1].count(name) > 1})
    if twice:
        raise ValueError(f"has the field `{twice[0]}` twice")


def _require_day(day: str) -> None:
    """Refuse text that is no date, or a date in the future in every time zone."""
    if date_type.fromisoformat(day) > (datetime.now(UTC) + timedelta(hours=14)).date():
        raise ValueError(f"{day} is in the future")


def _require_form(record: _Record, field: str) -> None:
    fields = {name: getattr(record, name) for name, _ in FORMS.values()}
    given = [name for name, value in fields.items() if value is not None and value != Raw()]
    if given != [field]:
        got = ", ".join(f"`{name}`" for name in given) or "no such field"
        raise ValueError(f"expected the field `{field}` and no other form's, got {got}")


def lines_of(source: Path) -> Iterator[tuple[str, bytes]]:
    """Yield each line of a file with its place.

    Raises:
        SourceError: it cannot be read, or a line is too long or empty.
    """
    number = 0
    try:
        with source.open("rb") as file:
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                where = f"{source}:{number}"
                if len(line) > _MAX_LINE:
                    raise SourceError(f"is longer than {_MAX_LINE} bytes", where=where)
                if not line.strip():
                    raise SourceError("is empty: write one JSON object a line", where=where)
                yield where, line
    except OSError as error:
        raise SourceError(f"cannot be read: {error.strerror}", where=str(source)) from error


def _said(value: str) -> set[str]:
    return {value} if value else set()


def _agree(known: set[str], value: str, what: str, where: str) -> None:
    if value and known - {value}:
        other = next(iter(known))[:80]
        text = f"says that {what} is `{value[:80]}`; `--{what}` or an earlier line says `{other}`"
        raise SourceError(f"{text}: write one file for each", where=where)
    known |= _said(value)


def _one(known: set[str], missing: str, source: Path) -> str:
    if not known:
        raise SourceError(f"does not say {missing}", where=str(source))
    return next(iter(known))
