# SPDX-License-Identifier: Apache-2.0
"""Proposals as files: what a person goes through, with what was seen beside each line.

An attacker may have written the words in them, so all foreign text is quoted in ASCII: no word can
end a comment or add a line. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.authoring.onboarding.calls import WayKey, hear
from authguard_r.authoring.onboarding.evidence import ShadowEvidence, Unused
from authguard_r.authoring.onboarding.grants import Learned, SeenGrant, SeenRow, draft_of, learn
from authguard_r.authoring.onboarding.meaning import Meaning, Meanings
from authguard_r.authoring.onboarding.merging import merged
from authguard_r.authoring.onboarding.skeleton import UNHELD, quoted
from authguard_r.authoring.site.proposal import identifier
from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.errors import shown as legible
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding, binding_faults
from authguard_r.site.model import Site
from authguard_r.site.names import shown
from authguard_r.site.strict import convert, read_yaml

BINDING, MISSION, SITE = (f"{name}.proposed.yaml" for name in ("binding", "mission", "site"))
#: The instant and the nonce of a compilation that is only to ask its questions.
_ASKING = Now(0, 0)
_NO_NONCE = "A" * 22
#: Most unknown names that are written down.
_MOST_NAMES = 500
_HEAD = """\
# PROPOSED from a shadow run. Nothing is signed and nothing is in force.
# Other people may have made the planner do some of this: check every line before you keep it.
"""


class LearnedProposals(Struct, frozen=True, kw_only=True):
    """What a log justifies.

    Args:
        files: name and text of each file.
        learned: the grants of the proposed mission.
        meanings: the ways of the proposed binding.
        plans: how many plans were read.
        calls: how many calls they hold.
        questions: what compiling the mission will ask: draft path and question.
        unused: everything that was not learned from, by record.
    """

    files: dict[str, str]
    learned: Learned
    meanings: tuple[Meaning, ...]
    plans: int
    calls: int
    questions: tuple[tuple[str, str], ...]
    unused: tuple[Unused, ...]


def propose(evidence: ShadowEvidence, site: Site, binding: Binding | None) -> LearnedProposals:
    """Return the files that a shadow run justifies, and what of it they leave out.

    Args:
        evidence: of a whole log.
        site: the site, sound.
        binding: sound for the site; None when no tool is bound yet.
    """
    heard = hear(evidence, site, None if binding is None else Binder(site, binding))
    learned = learn((*evidence.proposed, *heard.actions), _homes(site, evidence.robot))
    reader = Meanings(site)
    meanings = tuple(reader.of(key, way) for key, way in heard.ways.items())
    meanings = merged(meanings, binding) if meanings else ()
    files: dict[str, str] = {}
    if meanings:
        files[BINDING] = binding_page(meanings, site)
    unknown = "".join(f"{line}\n" for line in _unknown_lines(meanings))
    if unknown:
        files[SITE] = unknown
    questions: tuple[tuple[str, str], ...] = ()
    if learned.grants:
        plain = draft_of(learned, site, robot=evidence.robot)
        questions = _questions(plain, site)
        files[MISSION] = mission_page(plain, learned, questions, site)
    unused = sorted((*evidence.unused, *heard.unused, *learned.unused), key=lambda item: item.seq)
    return LearnedProposals(
        files=files,
        learned=learned,
        meanings=meanings,
        plans=heard.plans,
        calls=heard.calls,
        questions=questions,
        unused=tuple(unused),
    )


def _homes(site: Site, robot: RobotId | None) -> frozenset[RegionId]:
    """Return where the robot lives; without a robot in the log, the home that all robots share."""
    found = {rid: model.home for rid, model in site.robots.items()}
    return frozenset([found[robot]] if robot in found else found.values())


def ranked(learned: Learned) -> list[tuple[SeenGrant, SeenRow]]:
    """Return every row: those that inputs had mentioned first, then those not searched."""
    rows = [(grant, row) for grant in learned.grants for row in grant.rows]
    return sorted(rows, key=lambda pair: (not pair[1].influences, pair[1].looked))


def row_line(row: SeenRow) -> str:
    """Return a row for people: what it is, how often, and who had mentioned it."""
    ends = (("object", row.object), ("from", row.source), ("to", row.destination))
    what = " ".join(f"{name}={value}" for name, value in ends if value is not None) or "no place"
    times = f"{len(row.seqs)} x, first in record {row.seqs[0]}"
    if row.influences:
        told = ", ".join(
            f"{shown(i.channel)} ({i.label}): it mentions `{shown(i.value)}`"
            for i in row.influences[:4]
        )
        return f"{what}; {times}; INFLUENCED by {told}"
    return f"{what}; {times}{'' if row.looked else '; it is unknown which text mentioned it'}"


def mission_page(
    plain: dict[str, Any], learned: Learned, questions: tuple[tuple[str, str], ...], site: Site
) -> str:
    """Return the draft with what was seen beside each row, and each open question at its place."""
    asked = _OpenQuestions(questions)
    lines = [
        _HEAD.rstrip("\n"),
        "# What the log cannot say is a TODO at its place: write it there,",
    ]
    lines += ["# or let `authguard mission compile` ask for it."]
    lines += [f"mission: {quoted(plain['mission'])}"]
    lines += [f"robot: {quoted(plain['robot'])}"] if "robot" in plain else []
    lines += ["budgets:", *(f"  {name}: {_flow(n)}" for name, n in plain["budgets"].items())]
    lines += asked.below("budgets", "  ")
    grants = [
        line
        for number, seen in enumerate(learned.grants)
        for line in _grant_lines(plain["grants"][number], seen, asked, number, site)
    ]
    lines += [*asked.outer(), "grants:", *grants]
    text = "\n".join(lines) + "\n"
    return _same(text, {**plain, "grants": [_without_empty(grant) for grant in plain["grants"]]})


class _OpenQuestions:
    """The open questions, each at its place.

    Args:
        questions: draft path and question.
    """

    def __init__(self, questions: tuple[tuple[str, str], ...]) -> None:
        self._questions = questions

    def below(self, place: str, indent: str) -> list[str]:
        """Return the questions about what a place holds, but for the rows in it."""
        return [
            self._line(field, text, indent)
            for field, text in self._questions
            if f"{field}.".startswith(f"{place}.") and ".rows[" not in field.removeprefix(place)
        ]

    def outer(self) -> list[str]:
        """Return the questions about everything that is neither a grant's nor a budget's."""
        return [
            self._line(field, text, "")
            for field, text in self._questions
            if not f"{field}.".startswith(("budgets.", "grants["))
        ]

    @staticmethod
    def _line(field: str, text: str, indent: str) -> str:
        return f"{indent}# TODO {legible(field)}: {legible(text)}"


def _grant_lines(
    grant: dict[str, Any], seen: SeenGrant, asked: _OpenQuestions, number: int, site: Site
) -> Iterator[str]:
    yield f"  - id: {quoted(grant['id'])}"
    yield from (f"    {name}: {_flow(grant[name])}" for name in ("type", "tool"))
    if seen.leaves:
        yield "    # a planner with this grant can end the work: say `after: [GRANT]`, or"
        yield "    # guard it: `guards: [{variable: holding, eq: nothing, max_age: 1 s}]`"
    if site.vocabulary[seen.type].moves and any(row.source for row in seen.rows):
        yield "    # the log says where it began and where it was to end, not the way:"
        yield "    # add the regions that the robot has to pass"
    yield "    rows:"
    for place, (row, about) in enumerate(zip(grant["rows"], seen.rows, strict=True)):
        yield f"      # {row_line(about)}"
        yield f"      - {_flow(row)}"
        yield from asked.below(f"grants[{number}].rows[{place}]", "        ")
    yield from [f"    limits: {_flow(grant['limits'])}"] if grant["limits"] else []
    yield f"    repeat: {grant['repeat']}"
    yield f"    starts: {grant['starts']}"
    yield from asked.below(f"grants[{number}]", "    ")


def _without_empty(grant: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in grant.items() if name != "limits" or value}


def _questions(plain: dict[str, Any], site: Site) -> tuple[tuple[str, str], ...]:
    """Return what compiling the draft asks, or why it would not even ask."""
    try:
        compile_plain(plain, site, now=_ASKING, nonce=_NO_NONCE)
    except ClarificationError as error:
        return tuple((asked.field, asked.question) for asked in (error, *error.others))
    except MalformedError as error:
        return ((error.where, error.message),)
    return ()  # pragma: no cover - a window is never proposed


def binding_page(meanings: tuple[Meaning, ...], site: Site) -> str:
    """Return the proposed binding; one that would be unsound as a whole refuses every tool.

    Where the site has no type for what is refused, a refused tool is only mentioned: a tool that is
    not bound is refused too.
    """
    has_refused = UNHELD in site.vocabulary
    plain = _binding(meanings, has_refused=has_refused)
    if any(binding_faults(convert(plain, Binding, where="proposal"), site)):
        meanings = tuple(m if m.kept else _refused(m) for m in meanings)
        plain = _binding(meanings, has_refused=has_refused)
    lines = [_HEAD.rstrip("\n"), "schema: authguard-r/binding/1", "id: proposed"]
    lines.append("tools:" if plain["tools"] else "tools: {}")
    for tool, group in _by_tool(meanings).items():
        mark = "" if has_refused or any(meaning.understood for meaning in group) else "# "
        lines.append(f"{mark}  {quoted(tool)}:")
        for meaning in group:
            first, rest = ("    - ", "      ") if _is_list(group) else ("    ", "    ")
            mark = "" if has_refused or meaning.understood else "# "
            body = enumerate(_way_lines(meaning))
            lines += [f"{mark}{rest if n else first}{line}" for n, line in body]
    return _same("\n".join(lines) + "\n", plain)


def _way_lines(meaning: Meaning) -> Iterator[str]:
    plain = meaning.plain
    yield f"type: {quoted(plain['type'])}{_about(meaning)}"
    yield from (f"{n}: {_flow(plain[n])}" for n in plain if n not in {"type", "arguments"})
    if plain["arguments"]:
        yield "arguments:"
        for path, argument in plain["arguments"].items():
            note = meaning.notes.get(path)
            yield f"  {quoted(path)}: {_flow(argument)}{f'  # {note}' if note else ''}"


def _about(meaning: Meaning) -> str:
    if meaning.about:
        return f"  # {meaning.about}"
    if meaning.understood:
        return "  # the one type of the site that fits these fields; is it what the tool does?"
    if meaning.fits:
        return f"  # nothing says which: {', '.join(meaning.fits[:12])}"
    if meaning.near:
        told = (f"{kind} if {' and '.join(lacks)} were fixed" for kind, lacks in meaning.near[:4])
        return f"  # no type of the site fits these fields; nearest: {'; '.join(told)}"
    return "  # no type of the site fits these fields"


def _refused(meaning: Meaning) -> Meaning:
    held = {n: v for n, v in meaning.plain.items() if n in {"when", "message", "body"}}
    arguments = {path: {"use": "refused"} for path in meaning.plain["arguments"]}
    plain = {"type": UNHELD, "tool": UNHELD, **held, "arguments": arguments}
    return replace(meaning, plain=plain, understood=False)


def _by_tool(meanings: tuple[Meaning, ...]) -> dict[str, list[Meaning]]:
    grouped: dict[str, list[Meaning]] = {}
    for meaning in meanings:
        grouped.setdefault(meaning.key[0], []).append(meaning)
    return grouped


def _binding(meanings: tuple[Meaning, ...], *, has_refused: bool) -> dict[str, Any]:
    told = tuple(meaning for meaning in meanings if has_refused or meaning.understood)
    tools: dict[str, Any] = {}
    for tool, group in _by_tool(told).items():
        ways = [_bare(meaning.plain) for meaning in group]
        tools[tool] = ways if _is_list(group) else ways[0]
    return {"schema": "authguard-r/binding/1", "id": "proposed", "tools": tools}


def _is_list(group: list[Meaning]) -> bool:
    return len(group) > 1 or group[0].key[1] is not None


def _bare(plain: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in plain.items() if name != "arguments" or value}


def _unknown_lines(meanings: tuple[Meaning, ...]) -> Iterator[str]:
    """Yield comments on words that the site does not know; no place is made up."""
    told = [(m.key, path, words) for m in meanings for path, words in m.unknown.items()]
    if not told:
        return
    yield _HEAD.rstrip("\n")
    yield "# Words in calls that name no place and no object of the site. Add what is real to"
    yield "# the site, with where it is and who may go there."
    left = _MOST_NAMES
    for key, path, words in told:
        yield f"# {shown(_named(key))}, `{path}`:"
        yield from ["#   ... and more"] if len(words) > left else []
        for word, count in list(words.items())[:left]:
            left -= 1
            yield f"#   {quoted(word)} ({count} x)"
            yield from _entries(word)


def _entries(word: str) -> Iterator[str]:
    try:
        item = identifier(word, where="name")
    except MalformedError:
        return
    names = quoted(word)
    yield f"#     regions: {{{item}: {{map: ?, floor: ?, points: ?, approach: ?, tags: [unreviewed], names: [{names}]}}}}"  # noqa: E501
    yield f"#     objects: {{{item}: {{kind: unreviewed, home: ?, mass_g: ?, names: [{names}]}}}}"


def _named(key: WayKey) -> str:
    return key[0] if key[1] is None else f"{key[0]} {key[1][1]}"


def _flow(value: Any) -> str:
    """Return plain data on one line, as YAML and JSON both read it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    return quoted(value)


def _key(name: str) -> str:
    return name if name.replace("_", "").isalpha() else quoted(name)


def _same(text: str, plain: dict[str, Any]) -> str:
    """Return the text once it reads as what was to be proposed: no word got out of its quotes.

    Raises:
        MalformedError: it is longer than such a file may be.
    """
    if len(text) > MAX_BYTES:
        message = "the run has more calls than one file may have: learn from a shorter run"
        raise MalformedError(message, where="proposal", reason=Reason.INPUT_TOO_LARGE)
    if read_yaml(text, where="proposal") != plain:
        raise RuntimeError("a proposal was written that reads as another")
    return text
