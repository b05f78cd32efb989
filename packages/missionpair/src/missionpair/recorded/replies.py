# SPDX-License-Identifier: Apache-2.0
"""Replies of a model in the logs of real runs, kept by pair, kind of trial and round.

A log is JSON Lines, one reply a line: `{"pair", "round"?, "kind"?, "refused"?, "inputs"?,
"model"?, "date"?}` with one more field, by its form:

    steps      `steps`: a list of `{"tool", "arguments"}`
    openai     `response`: a chat completion, as its server sent it
    mcp        `calls`: the JSON-RPC requests `tools/call`, in order
    langchain  `messages`: the conversation; every call of the model, in order, else its last words

Calls of a chat completion are kept byte for byte, and words as they are; of the other forms the
names and arguments are kept.
How-to: docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
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
    """

    format: str
    model: str
    date: _Date
    source: str
    digest: str


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
    tool_calls: list[_ChainCall] = []
    invalid_tool_calls: list[_ChainCall] = []
    response_metadata: dict[str, Any] = {}
    data: _ChainMessage | None = None
    kwargs: _ChainMessage | None = None


def _steps(record: _Record) -> _ReadAnswer:
    return _ReadAnswer(_plan(bytes(step) for step in record.steps or ()))


def _openai(record: _Record) -> _ReadAnswer:
    raw = bytes(record.response)
    said = msgspec.json.decode(raw, type=_Completion)
    done = Completion(**asdict(OpenAIProtocol().read(raw)))
    raw, refused = read_answer(done, (), model=said.model, where="response")
    date = datetime.fromtimestamp(said.created, UTC).date().isoformat() if said.created else ""
    return _ReadAnswer(raw, said.model, date, refused)


def _mcp(record: _Record) -> _ReadAnswer:
    steps = []
    for call in record.calls or ():
        asked = msgspec.json.decode(call, type=_ToolsCall)
        if asked.method != "tools/call":
            raise ValueError(f"expected the method `tools/call`, got `{asked.method[:80]}`")
        steps.append(_step(asked.params.name, asked.params.arguments))
    return _ReadAnswer(_plan(steps))


def _langchain(record: _Record) -> _ReadAnswer:
    said = [_message(raw) for raw in record.messages or ()]
    answers = [one for one in said if one.type in {"ai", "AIMessage", "AIMessageChunk"}]
    if not answers:
        raise ValueError("expected a message of the model (`type: ai`)")
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


def _text(content: object) -> str:
    if isinstance(content, str):
        return content
    parts = content if isinstance(content, list) else []
    return "".join(str(part.get("text", "")) for part in parts if isinstance(part, dict))


def _step(name: Raw, arguments: Raw) -> bytes:
    return b'{"tool": ' + bytes(name) + b', "arguments": ' + bytes(arguments) + b"}"


def _plan(steps: Any) -> bytes:
    return b'{"plan": [' + b", ".join(steps) + b"]}"


#: What each form is read by, and the field that it has.
FORMS: dict[str, tuple[str, Callable[[_Record], _ReadAnswer]]] = {
    "steps": ("steps", _steps),
    "openai": ("response", _openai),
    "mcp": ("calls", _mcp),
    "langchain": ("messages", _langchain),
}


def import_replies(
    form: str, source: Path, out: Path, *, model: str = "", date: str = ""
) -> tuple[RepliesHead, int]:
    """Read a log of one of the forms, and write a new file of replies.

    Args:
        form: one of `FORMS`.
        source: the log; who wrote it is not trusted.
        out: the new file.
        model: who answered, where the log does not say it.
        date: when, where the log does not say it.

    Returns:
        Whose the replies are, and how many.

    Raises:
        SourceError: a line is no reply of this form, repeats an answer, or is of another model. Or
            the model or the date is missing, or `date` is none of the log's dates.
        FileExistsError: there is such a file.
    """
    models, dates, replies = _said(model), set[str](), dict[tuple[str, str, int], PairReply]()
    for where, record, answer in _read(form, source):
        _agree(models, record.model or answer.model, "the model", where)
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
        replies[key] = reply
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
    )
    try:
        msgspec.convert(msgspec.to_builtins(head), RepliesHead)
        date_type.fromisoformat(head.date)
    except ValueError as error:
        raise SourceError(f"has no date such as 2026-11-28: {error}", where=str(source)) from error
    lines = [msgspec.json.encode(one) + b"\n" for one in (head, *replies.values())]
    with out.open("xb") as file:
        file.writelines(lines)
    return head, len(replies)


def _read(form: str, source: Path) -> Iterator[tuple[str, _Record, _ReadAnswer]]:
    field, reads = FORMS[form]
    for where, line in lines_of(source):
        try:
            record = msgspec.json.decode(line, type=_Record)
            _require_form(record, field)
            answer = reads(record)
            answer.raw.decode()
            day = record.date or answer.date
            _ = day and date_type.fromisoformat(day)
            yield where, record, answer
        except _UNREADABLE as error:
            raise SourceError(f"is no reply of the form `{form}`: {error}", where=where) from error


def _require_form(record: _Record, field: str) -> None:
    fields = {name: getattr(record, name) for name, _ in FORMS.values()}
    given = [name for name, value in fields.items() if value is not None and value != Raw()]
    if given != [field]:
        raise ValueError(f"expected the field `{field}` and no other form's, got {given}")


def lines_of(source: Path) -> Iterator[tuple[str, bytes]]:
    """Yield each line of a file with its place.

    Raises:
        SourceError: it cannot be read, or a line is too long or cut.
    """
    number = 0
    try:
        with source.open("rb") as file:
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                if not line.endswith(b"\n"):
                    text = f"ends in the middle of a line, or is longer than {_MAX_LINE} bytes"
                    raise SourceError(text, where=f"{source}:{number}")
                yield f"{source}:{number}", line
    except OSError as error:
        raise SourceError(f"cannot be read: {error.strerror}", where=str(source)) from error


def _said(value: str) -> set[str]:
    return {value} if value else set()


def _agree(known: set[str], value: str, what: str, where: str) -> None:
    known |= _said(value)
    if len(known) > 1:
        text = f"says that {what} is `{value[:80]}`; an earlier one is another: one file for each"
        raise SourceError(text, where=where)


def _one(known: set[str], missing: str, source: Path) -> str:
    if not known:
        raise SourceError(f"does not say {missing}", where=str(source))
    return next(iter(known))
