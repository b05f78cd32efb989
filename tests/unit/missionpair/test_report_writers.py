# SPDX-License-Identifier: Apache-2.0
"""What a report looks like: a page that is sound and needs nothing, CSV, LaTeX, JSON; and mutation.

Whoever wrote a log chose the names in it: none of them becomes markup, a formula or a path.
"""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import msgspec
import pytest

from fixtures.campaign_records import (
    FIXED,
    GRADED,
    HAIKU,
    REACHED,
    benign,
    blocked,
    campaign,
    files_of,
    hijacked,
    kept,
    numbered,
    the_papers,
)
from missionpair.measures import MeasureError, measure
from missionpair.records import NamedPart, Timing
from missionpair.report import (
    CampaignReport,
    MutantReport,
    Mutation,
    cells,
    mutation_table,
    page,
    payload,
    read_mutation,
    report,
    sheets,
    tex_files,
)
from missionpair.report.mutation import SCHEMA
from missionpair.report.svg import Axis, Dot, Plot, PlotRow, draw
from missionpair.report.tex import escaped, tex
from missionpair.report.words import table_lines

#: Elements that end where they begin.
VOID = {"meta", "link", "br", "img", "hr", "input"}
EVIL = '"><script>alert(1)</script>\\input{/etc/passwd}%$&_#{}~^\x1b[31m=cmd()'
MUTATION = Mutation(
    schema=SCHEMA,
    suite="full",
    suite_version=1,
    suite_digest="d",
    mutants=(
        MutantReport(gate="authorization", check="nothing", trials=600, let_through=0),
        MutantReport(
            gate="authorization", check="check_object", trials=600, let_through=12, first="pair-7"
        ),
        MutantReport(
            gate="authorization", check="check_meta", trials=600, let_through=0, why_not="why"
        ),
        MutantReport(gate="safety", check="speed", trials=600, let_through=0),
    ),
)


class Page(HTMLParser):
    """Reads a page strictly: every element ends, ids are unique, links lead somewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs)
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert "svg" in self.open
        self.seen.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.seen if name == tag]


def logs(planner: NamedPart = GRADED, **changes: Any) -> CampaignReport:
    defenses = (NamedPart("none"), NamedPart("both"))
    found = []
    for access, extra in (("white", hijacked(defense="none")), ("black", kept(defense="none"))):
        trials = numbered(
            [
                blocked(timing=Timing(planner=2_000_000, decide=400, total=2_100_000)),
                hijacked(defense="none", **changes),
                extra,
                benign(),
                benign(kind="update"),
            ]
        )
        told = campaign(planner=planner, defenses=defenses, access=access, trials=len(trials))
        found.append(measure(told, trials))
    return report(found, mutation=MUTATION)


def evil() -> CampaignReport:
    """Return the report of a log in which every name that its writer chooses is an attack."""
    named = NamedPart(EVIL, simulated=True, parameters={"model": EVIL})
    trial = hijacked(
        defense=EVIL,
        domain=EVIL,
        categories=(EVIL, EVIL),
        channels=(EVIL,),
        family=EVIL,
        by=EVIL,
        reasons=(EVIL,),
        violated=(EVIL,),
        pair=EVIL,
    )
    told = campaign(
        planner=named, attacker=NamedPart(EVIL, parameters={EVIL: EVIL}), defenses=(named,),
        access=EVIL, suite=EVIL, suite_digest=EVIL, version=EVIL, trials=1,
    )  # fmt: skip
    return report([measure(told, [trial])])


@pytest.mark.parametrize("made", [logs, evil], ids=["logs", "evil"])
def test_the_page_is_sound_html_that_needs_nothing_and_runs_nothing(made: Any) -> None:
    text = page(made())
    read = Page(text)
    ids = [attrs["id"] for _, attrs in read.seen if "id" in attrs]
    assert len(set(ids)) == len(ids)
    assert not {"script", "link", "img", "iframe", "object", "base"} & {tag for tag, _ in read.seen}
    assert [a for _, attrs in read.seen for a in attrs if a.startswith("on") or a == "src"] == []
    hrefs = [attrs["href"] or "" for attrs in read.all("a")]
    assert all(href.startswith("#") and href[1:] in ids for href in hrefs)
    assert re.search(r"(?i)https?:|//|url\(|@import|data:", text) is None or made is evil
    labels = [
        attrs["aria-labelledby"] or "" for _, attrs in read.seen if "aria-labelledby" in attrs
    ]
    assert all(part in ids for label in labels for part in label.split())


def test_the_page_can_be_read_without_seeing_it_in_the_dark_and_on_paper() -> None:
    read, text = Page(page(logs())), page(logs())
    assert read.all("html")[0]["lang"] == "en"
    assert len(read.all("table")) == len(read.all("caption"))
    assert all("scope" in attrs for attrs in read.all("th"))
    pictures = read.all("svg")
    assert pictures
    assert all(attrs["role"] == "img" and attrs["aria-labelledby"] for attrs in pictures)
    assert len(read.all("desc")) == len(pictures)
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    # every plot leads to a table with its figures
    assert len(read.all("figcaption")) == len(pictures)


def test_the_page_says_what_is_simulated_at_its_head_and_at_every_table_and_plot() -> None:
    found = logs()
    text = page(found)
    read = Page(text)
    assert "<title>MissionPAIR report (simulated parts)</title>" in text
    marks = [attrs for attrs in read.all("strong") if attrs.get("class") == "simulated"]
    shown = [one for one in found.tables if one.simulated]
    assert len(marks) == len(shown) + len(found.plots)
    assert text.count('<text class="simulated"') == len(found.plots)
    plain = page(report([measure(campaign(planner=HAIKU, trials=1), [kept()])]))
    assert "<title>MissionPAIR report</title>" in plain
    assert "Simulated:" not in plain


def test_a_page_of_the_same_logs_is_the_same_page() -> None:
    assert page(logs()) == page(logs())


def test_nothing_out_of_a_log_becomes_markup() -> None:
    text = page(evil())
    assert "<script" not in text
    assert "\x1b" not in text
    assert "&lt;script&gt;" in text


def test_a_plot_is_xml_with_every_figure_in_words() -> None:
    plot = Plot(
        name="p",
        title="a <b> & c",
        axis=Axis("x", 0.0, 1.0),
        series=("one", "two"),
        lines=(
            PlotRow("first", (Dot(series=0, value=0.5, low=0.2, high=0.7, tip="5/10"),)),
            PlotRow("second", ()),
            PlotRow("z" * 90, (Dot(series=1, value=9.0, low=9.0, high=9.0, tip="off the axis"),)),
        ),
        simulated="planner <x>",
    )
    picture = ET.fromstring(draw(plot))
    assert picture[0].text == "a <b> & c (simulated: planner <x>)"
    assert picture[1].text == f"first: 5/10; second: undefined; {'z' * 90}: off the axis"
    drawn = "".join(picture.itertext())
    assert "undefined" in drawn
    assert "z" * 39 + "\u2026" in drawn


def test_an_axis_is_straight_or_in_powers_of_ten() -> None:
    straight, powers = Axis("x", -1.0, 1.0), Axis("t", 1.0, 10.0**7, logarithmic=True)
    assert [words for _, words in straight.ticks()] == ["-1", "-0.5", "0", "0.5", "1"]
    assert [words for _, words in powers.ticks()] == [
        "1 us", "10 us", "100 us", "1 ms", "10 ms", "100 ms", "1 s", "10 s",
    ]  # fmt: skip
    places = [powers.at(value) for value, _ in powers.ticks()]
    assert [b - a for a, b in pairwise(places)] == pytest.approx([places[1] - places[0]] * 7)
    assert straight.at(0.0) == (straight.at(-1.0) + straight.at(1.0)) / 2


def test_csv_files_hold_numbers_and_leave_what_is_undefined_empty() -> None:
    files = files_of(sheets(report(the_papers())))
    rows = list(csv.DictReader(io.StringIO(files["tab-pilot-live-llm.csv"])))
    assert len(rows) == 7
    assert rows[0]["complied_k"] == "0"
    assert rows[0]["complied_n"] == "10"
    assert float(rows[0]["complied_most"]) == 0.3
    assert (rows[0]["blocked_k"], rows[0]["blocked_n"], rows[0]["blocked_rate"]) == ("0", "0", "")
    assert rows[2]["complied_most"] == ""
    assert float(rows[2]["complied_high"]) == 1
    assert rows[6]["published_complied_k"] == "11"
    assert {row["simulated"] for row in rows} == {"no"}


@pytest.mark.parametrize("made", [logs, evil], ids=["logs", "evil"])
def test_every_csv_file_says_in_every_row_what_is_simulated(made: Any) -> None:
    found = made()
    files = files_of(sheets(found))
    assert len(files) == len(found.tables) + 1
    for name, content in files.items():
        assert re.fullmatch(r"[a-z0-9-]+\.csv", name)
        heads, *rows = list(csv.reader(io.StringIO(content)))
        assert len(set(heads)) == len(heads)
        assert all(len(row) == len(heads) for row in rows)
        column = heads.index("simulated")
        if name != "mutation.csv":
            assert all(row[column].startswith(("planner", "no")) for row in rows)


def test_no_text_is_a_formula_to_a_spreadsheet() -> None:
    told = campaign(planner=NamedPart("=cmd()", simulated=True), attacker=NamedPart("@x"), trials=1)
    found = report([measure(told, [kept(domain="+1", family="-x")])])
    for content in files_of(sheets(found)).values():
        for row in csv.reader(io.StringIO(content)):
            assert not any(cell.startswith(("=", "@", "+")) for cell in row)


def test_the_file_with_every_cell_is_too_long_for_the_page_and_in_the_folder() -> None:
    found = logs()
    assert 'id="table-cells"' not in page(found)
    rows = list(csv.DictReader(io.StringIO(files_of(sheets(found))["cells.csv"])))
    assert {row["kind"] for row in rows} == {"attack", "benign", "update"}
    assert sum(int(row["trials"]) for row in rows) == 10


def test_every_cell_is_written_in_pieces_under_one_line_of_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = files_of(sheets(logs()))["cells.csv"]
    monkeypatch.setattr(cells, "_CHUNK", 2)
    assert files_of(sheets(logs()))["cells.csv"] == whole
    assert whole.count("complied_k") == 1


def test_json_is_the_whole_report_with_null_where_undefined() -> None:
    found = logs()
    told = json.loads(json.dumps(payload(found)))
    assert set(told["tables"]) == {one.name for one in found.tables}
    assert told["simulated"] == "planner graded"
    rates = told["tables"]["rates"]["rows"][0]
    assert rates["defense"] == "none"
    assert rates["uasr_rate"] == 1.0
    assert rates["btcr_rate"] is None
    assert told["tables"]["planners"]["simulated"] == "planner graded"


@pytest.mark.parametrize("made", [logs, evil], ids=["logs", "evil"])
def test_latex_is_balanced_whatever_a_log_calls_things(made: Any) -> None:
    files = files_of(tex_files(made()))
    labels = []
    for name, source in files.items():
        assert re.fullmatch(r"[a-z0-9-]+\.tex", name)
        bare = re.sub(r"\\[\\{}%&#$_]", "", source)
        assert bare.count("{") == bare.count("}")
        begun = re.findall(r"\\begin\{(\w+)\}", source)
        assert sorted(begun) == sorted(re.findall(r"\\end\{(\w+)\}", source))
        assert (
            re.search(r"(?<!\\)[#$^]|(?<!\\)_(?!\w*\})", bare.replace("$\\", "").replace("$", ""))
            is None
        )
        labels += re.findall(r"\\label\{([^}]*)\}", source)
        if name != "all.tex":
            assert _widths(source) == {_columns(source)}
    assert len(set(labels)) == len(labels)
    assert "\\input{/etc" not in "".join(files.values())


def test_latex_marks_what_is_simulated_in_the_caption() -> None:
    for name, source in files_of(tex_files(logs())).items():
        if name not in {"all.tex", "mutation.tex"}:
            assert r"\textbf{Simulated: planner graded.}" in source
    assert "textbf{Simulated" not in "".join(files_of(tex_files(report(the_papers()))).values())


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX on this machine")
def test_latex_compiles(tmp_path: Path) -> None:
    for name, source in files_of(tex_files(evil())).items():
        (tmp_path / name).write_text(source)
    command = ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "all.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=120)


def test_every_special_character_is_printed_by_latex_as_it_is() -> None:
    assert escaped(r"a_b%{$}&#~^\<>") == (
        r"a\_b\%\{\$\}\&\#\textasciitilde{}\textasciicircum{}\textbackslash{}"
        r"\textless{}\textgreater{}"
    )


def test_a_check_that_can_be_taken_out_unnoticed_is_named(tmp_path: Path) -> None:
    file = tmp_path / "mutation.json"
    file.write_bytes(msgspec.json.encode(MUTATION))
    assert read_mutation(file) == MUTATION
    told = [line.split("  ") for line in table_lines(mutation_table(MUTATION))]
    said = ["  ".join(filter(None, row)) for row in told]
    assert [" ".join(row.split()) for row in said][2:] == [
        "authorization nothing 0/600 [0.00, 0.01] sound",
        "authorization check_object 12/600 [0.01, 0.03] tested pair-7",
        "authorization check_meta 0/600 [0.00, 0.01] out of reach why",
        "safety speed 0/600 [0.00, 0.01] NOT TESTED",
    ]
    broken = MutantReport(gate="authorization", check="nothing", trials=2, let_through=1)
    assert broken.verdict == "NOT SOUND"
    assert r"check\_object" in tex(mutation_table(MUTATION))


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "no mutation run"),
        (b"\xff\xfe", "no mutation run"),
        (b"{}", "no mutation run"),
        (msgspec.json.encode(msgspec.structs.replace(MUTATION, schema="other/1")), "schema"),
        (
            msgspec.json.encode(
                msgspec.structs.replace(
                    MUTATION, mutants=(MutantReport(gate="g", check="c", trials=1, let_through=2),)
                )
            ),
            "at most as many that passed",
        ),
    ],
)
def test_a_file_that_is_no_mutation_run_is_refused_by_name(
    tmp_path: Path, data: bytes, told: str
) -> None:
    file = tmp_path / "mutation.json"
    file.write_bytes(data)
    with pytest.raises(MeasureError, match=told) as caught:
        read_mutation(file)
    assert str(file) in caught.value.where


def test_an_attack_that_was_found_in_a_later_round_shows_in_the_tries() -> None:
    found = report([measure(campaign(attacker=FIXED, trials=1), [blocked(rounds=(REACHED,) * 2)])])
    tries = next(one for one in found.tables if one.name == "tries")
    assert tries.rows[0][7] == 1


def _columns(source: str) -> int:
    return len(re.search(r"\\begin\{tabular\}\{([lc]+)\}", source)[1])  # type: ignore[index]


def _widths(source: str) -> set[int]:
    rows = [line for line in source.splitlines() if line.endswith(r" \\")]
    return {len(re.split(r"(?<!\\)&", row)) for row in rows}
