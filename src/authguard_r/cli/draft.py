# SPDX-License-Identifier: Apache-2.0
"""`authguard mission draft`: from a sentence to a draft that `mission compile` takes."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
import yaml

from authguard_r.authoring.compile.draft import Draft
from authguard_r.authoring.compile.unlisted import unlisted
from authguard_r.authoring.drafting.profile import read_profile
from authguard_r.authoring.drafting.proposal import (
    DraftProposal,
    DraftQuestion,
    Proposer,
    clarification,
)
from authguard_r.authoring.drafting.template import TemplateProposer
from authguard_r.cli.ask import AnswerOption, NoInputFlag, may_ask
from authguard_r.cli.inputs import JsonFlag, NowOption, SiteOption, load_site, wall_now
from authguard_r.cli.model_server import (
    TIMEOUT_S,
    ApiKeyEnvOption,
    BaseUrlOption,
    ModelOption,
    TimeoutOption,
)
from authguard_r.core.errors import MalformedError, shown
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.normalize.parse import read_json
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_text
from authguard_r.wire.output import emit

#: What becomes of a name without a weight.
_WEIGHS = "it weighs `otherwise`; give it a weight in `risk_policy`, or in your --profile"


class ProposerName(StrEnum):
    """Who may propose."""

    TEMPLATE = "template"
    OPENAI = "openai"
    ANTHROPIC = "anthropic"


def draft_command(
    sentence: Annotated[str, typer.Argument(help="What the robot should do.")],
    site: SiteOption,
    robot: Annotated[str | None, typer.Option("--robot", help="The robot.")] = None,
    issuer: Annotated[
        str | None, typer.Option("--issuer", help="Who will sign the mission.")
    ] = None,
    answer: AnswerOption = None,
    proposer: Annotated[
        ProposerName, typer.Option("--proposer", help="The grammar, or a language model.")
    ] = ProposerName.TEMPLATE,
    base_url: BaseUrlOption = None,
    model: ModelOption = None,
    api_key_env: ApiKeyEnvOption = None,
    timeout: TimeoutOption = TIMEOUT_S,
    profile: Annotated[
        Path | None, typer.Option("--profile", help="Your own defaults (YAML).")
    ] = None,
    now: NowOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="File for the draft.")] = None,
    no_input: NoInputFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Draft a mission from a sentence, or print the questions that are open (exit 3)."""
    place = load_site(site)
    settled = _answers(answer or [])
    if issuer is not None:
        settled["issuer"] = issuer
    if proposer is ProposerName.TEMPLATE:
        text = None if profile is None else read_text(profile)
        chosen: Proposer = TemplateProposer(read_profile(text), wall_now(now).utc_ms)
    else:
        chosen = _model(proposer, base_url, model, api_key_env, timeout)
    asks = may_ask(as_json=as_json, no_input=no_input)
    typed: dict[str, DraftQuestion] = {}
    while True:
        try:
            proposal = chosen.propose(sentence, place, robot=robot, settled=settled)
        except MalformedError as error:
            wrong = [field for field in typed if error.where.startswith(field)]
            if not wrong:
                raise
            _tell(f"{error.message} (at {error.where})")
            settled |= {field: _prompt(typed[field]) for field in wrong}
            continue
        if not proposal.questions:
            break
        again = any(question.field in settled for question in proposal.questions)
        if not asks or again:  # no answer settles what was answered and is asked again
            raise clarification(proposal.questions)
        typed |= {question.field: question for question in proposal.questions}
        settled |= {question.field: _prompt(question) for question in proposal.questions}
    return _show(proposal, place, out, as_json=as_json)


def _show(proposal: DraftProposal, site: Site, out: Path | None, *, as_json: bool) -> int:
    """Write the draft, or print it where no file was named; what was assumed is always said."""
    text = yaml.safe_dump(proposal.draft, sort_keys=False, allow_unicode=True, width=100)
    noted = [f"assumed {item.field}: {item.value} ({item.why})" for item in proposal.assumed]
    drafted = check_draft(proposal.draft)
    names = {name for each in drafted.grants for name in unlisted(drafted.risk_policy, site, each)}
    notes = [f"the risk policy does not list {name}: {_WEIGHS}" for name in sorted(names)]
    head = [f"proposed by {proposal.proposer}; it authorizes nothing until it is signed", *noted]
    head += notes
    comments = "".join(f"# {_one_line(line)}\n" for line in head)
    if out is not None:
        write_whole(out, (comments + text).encode("utf-8"), mode=PRIVATE)
    payload = {
        "file": None if out is None else str(out),
        "proposer": proposal.proposer,
        "draft": proposal.draft,
        "assumed": [msgspec.to_builtins(item) for item in proposal.assumed],
        "notes": notes,
    }
    lines = (comments + text).splitlines() if out is None else [str(out), *head]
    emit(payload, lines, as_json=as_json)
    return 0


def _one_line(text: str) -> str:
    """Return text that cannot leave its comment line, nor speak to a terminal."""
    return shown(" ".join(text.split()))


def _answers(given: list[str]) -> dict[str, str]:
    """Return answers by field.

    Raises:
        MalformedError: no `field=value`, or one field twice.
    """
    found: dict[str, str] = {}
    for item in given:
        field, parted, value = item.partition("=")
        if not parted or not field.strip() or not value.strip():
            raise MalformedError(f"expected field=value, got `{item}`", where="--answer")
        if field.strip() in found:
            raise MalformedError(f"expected one answer to `{field}`", where="--answer")
        found[field.strip()] = value.strip()
    return found


def _prompt(question: DraftQuestion) -> str:
    """Return a person's answer, by number or in words; an empty one is asked for again."""
    _tell(f"{question.question} ({question.field})")
    for number, candidate in enumerate(question.candidates, 1):
        _tell(f"  {number}) {candidate}")
    while True:
        said = str(typer.prompt("answer", err=True)).strip()
        if said.isdecimal() and said.isascii() and 1 <= int(said) <= len(question.candidates):
            return question.candidates[int(said) - 1]
        if said and (not question.candidates or said in question.candidates):
            return said
        _tell(f"expected one of {', '.join(question.candidates)}")


def _tell(line: str) -> None:
    """Print a line for a person; a model may have chosen its words, and its control characters."""
    typer.echo(shown(line), err=True)


def _model(
    name: ProposerName,
    base_url: str | None,
    model: str | None,
    api_key_env: str | None,
    total_s: float,
) -> Proposer:
    """Return the language-model proposer that was asked for."""
    from authguard_r.authoring.drafting.models import AnthropicProposer, OpenAIProposer

    if base_url is None or model is None:
        raise typer.BadParameter(f"--proposer {name} needs --base-url and --model")
    kind = OpenAIProposer if name is ProposerName.OPENAI else AnthropicProposer
    return kind(
        base_url=base_url,
        model=model,
        api_key_env=api_key_env,
        schema=draft_schema(),
        read=read_reply,
        check=check_draft,
        total_s=total_s,
    )


def draft_schema() -> dict[str, Any]:
    """Return the JSON schema of a draft, for a model to see."""
    return msgspec.json.schema(Draft)


def read_reply(text: str) -> object:
    """Return the value that a model's bare JSON spells; prose around it is refused (L12)."""
    return read_json(text, where="reply")


def check_draft(plain: object) -> Draft:
    """Return plain data as a draft, strictly."""
    return convert(plain, Draft, where="reply")
